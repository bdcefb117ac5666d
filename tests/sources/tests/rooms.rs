//! Checks that the crates, and the top-level modules of `host/detection/src`, `host/solve/src` and `host/calibrate/src` (rooms),
//! use only what the tables in `docs/architecture.md` allow, and that no crate has import cycles between its files.
//!
//! `make rooms` prints what was checked. Tests within the sources may import anything.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{Attribute, File, Item, Macro, UseTree};

/// Path of a module within its crate, such as `["solve", "levenberg"]`; empty for the crate's root.
type Module = Vec<String>;
/// The modules that each module imports from.
type Imports = BTreeMap<Module, BTreeSet<Module>>;

const ARCHITECTURE: &str = include_str!("../../../docs/architecture.md");
/// Beginning of the heading of the table of crates.
const CRATES: &str = "## Crates";
/// The crates whose top-level modules are checked: folders and names in code. No name of a room occurs twice, so the checks treat
/// them like one crate.
const WITH_ROOMS: [(&str, &str); 3] =
    [("host/detection", "evcal_detection"), ("host/solve", "evcal_solve"), ("host/calibrate", "evcal_calibrate")];
/// A crate that is not in the table and must not have import cycles either.
const NOT_IN_TABLE: &str = "python";

/// A row of a table: a crate or a room.
struct Room {
    /// Folder of the crate, or name of the room.
    name: String,
    /// Name of the package; empty for a room.
    package: String,
    may_use: MayUse,
}

enum MayUse {
    Everything,
    Rooms(BTreeSet<String>),
}

impl MayUse {
    fn contains(&self, room: &str) -> bool {
        match self {
            Self::Everything => true,
            Self::Rooms(rooms) => rooms.contains(room),
        }
    }
}

/// Returns the rows of the table below `heading`, in order.
fn table(document: &str, heading: &str) -> Vec<Room> {
    let lines = document.lines().skip_while(|line| !line.starts_with(heading));
    let rows = lines.skip_while(|line| !line.starts_with("|---")).skip(1).take_while(|line| line.starts_with('|'));
    rows.map(|row| {
        let cells: Vec<&str> = row.trim_matches('|').split('|').map(str::trim).collect();
        let last = cells.last().copied().unwrap_or_default();
        let names = last.split('`').skip(1).step_by(2);
        let may_use = match last {
            "everything" => MayUse::Everything,
            _ => MayUse::Rooms(names.map(str::to_owned).collect()),
        };
        let name = |cell: &str| cell.trim_matches('`').to_owned();
        let package = if cells.len() == 4 { name(cells[1]) } else { String::new() };
        Room { name: name(cells[0]), package, may_use }
    })
    .collect()
}

/// Returns the rows of the table of rooms of the crate in `folder`.
fn rooms_of(folder: &str) -> Vec<Room> {
    table(ARCHITECTURE, &format!("### `{folder}/src`"))
}

/// Returns the rows of all tables of rooms, in order.
fn rooms() -> Vec<Room> {
    WITH_ROOMS.iter().flat_map(|(folder, _)| rooms_of(folder)).collect()
}

/// Returns the packages of the workspace that the crate in `folder` depends on, except for its tests.
fn dependencies(folder: &str, packages: &BTreeSet<String>) -> BTreeSet<String> {
    let path = root().join(folder).join("Cargo.toml");
    let manifest = std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut found = BTreeSet::new();
    let mut section = "";
    for line in manifest.lines() {
        if line.starts_with('[') {
            section = line;
        } else if section.ends_with("dependencies]") && !section.contains("dev-") {
            let name = line.split(['.', ' ', '=']).next().unwrap_or_default();
            found.extend(packages.get(name).cloned());
        }
    }
    found
}

/// Returns the folder of the workspace.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Segments of the paths that a file names.
#[derive(Default)]
struct Paths {
    found: Vec<Vec<String>>,
}

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Path>().is_ok_and(|condition| condition.is_ident("test"))
    })
}

impl Paths {
    fn tree(&mut self, before: &[String], tree: &UseTree) {
        let with = |name: &syn::Ident| [before, &[name.to_string()]].concat();
        match tree {
            UseTree::Path(path) => self.tree(&with(&path.ident), &path.tree),
            UseTree::Name(name) => self.found.push(with(&name.ident)),
            UseTree::Rename(rename) => self.found.push(with(&rename.ident)),
            UseTree::Glob(_) => self.found.push(before.to_vec()),
            UseTree::Group(group) => group.items.iter().for_each(|tree| self.tree(before, tree)),
        }
    }

    /// Finds paths in the arguments of a macro, which have no syntax tree: `crate :: a :: b`.
    fn tokens(&mut self, tokens: proc_macro2::TokenStream) {
        let mut path: Vec<String> = Vec::new();
        let mut colons = 0;
        for token in tokens {
            match token {
                proc_macro2::TokenTree::Ident(name) if colons == 2 => path.push(name.to_string()),
                proc_macro2::TokenTree::Ident(name) => {
                    self.found.push(std::mem::replace(&mut path, vec![name.to_string()]));
                }
                proc_macro2::TokenTree::Punct(point) if point.as_char() == ':' => {
                    colons += 1;
                    continue;
                }
                proc_macro2::TokenTree::Group(group) => {
                    self.found.push(std::mem::take(&mut path));
                    self.tokens(group.stream());
                }
                _ => self.found.push(std::mem::take(&mut path)),
            }
            colons = 0;
        }
        self.found.push(path);
    }
}

impl<'a> Visit<'a> for Paths {
    fn visit_item(&mut self, item: &'a Item) {
        match item {
            Item::Mod(module) if is_test(&module.attrs) => {}
            Item::Use(item) if !is_test(&item.attrs) => self.tree(&[], &item.tree),
            item => visit::visit_item(self, item),
        }
    }

    fn visit_path(&mut self, path: &'a syn::Path) {
        self.found.push(path.segments.iter().map(|segment| segment.ident.to_string()).collect());
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'a Macro) {
        self.tokens(item.tokens.clone());
        visit::visit_macro(self, item);
    }
}

/// Resolves a path that `module` names to a module of its crate; `None` if it leads out of the crate. The crate also has the
/// names `also`.
fn resolve(module: &Module, path: &[String], modules: &BTreeSet<Module>, also: &[&str]) -> Option<Module> {
    let mut rest = path;
    let mut found: Module = match path.first().map(String::as_str) {
        Some("crate") => Vec::new(),
        Some(name) if also.contains(&name) => {
            rest = &rest[1..];
            Vec::new()
        }
        Some("self" | "super") => module.clone(),
        // A path may begin with a module that the file declares itself.
        Some(name) if modules.contains(&[module.as_slice(), &[name.to_owned()]].concat()) => {
            return Some([module.as_slice(), &[name.to_owned()]].concat());
        }
        _ => return None,
    };
    while let Some(first) = rest.first() {
        match first.as_str() {
            "crate" | "self" => {}
            "super" => {
                found.pop();
            }
            _ => break,
        }
        rest = &rest[1..];
    }
    for name in rest {
        found.push(name.clone());
        if !modules.contains(&found) {
            found.pop();
            break;
        }
    }
    Some(found)
}

/// Returns the imports of every module of a crate, from the text of its files. The crate also has the names `also`.
fn imports(files: &BTreeMap<Module, String>, also: &[&str]) -> Imports {
    let modules: BTreeSet<Module> = files.keys().cloned().collect();
    let of_file = |(module, text): (&Module, &String)| {
        let file: File = syn::parse_file(text).unwrap_or_else(|error| panic!("{}: {error}", module.join("::")));
        let mut paths = Paths::default();
        paths.visit_file(&file);
        let imported = paths.found.iter().filter_map(|path| resolve(module, path, &modules, also));
        (module.clone(), imported.filter(|other| other != module).collect())
    };
    files.iter().filter(|(module, _)| module.last().is_none_or(|name| name != "tests")).map(of_file).collect()
}

fn walk(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            walk(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

/// Reads the source files of a crate, by module.
fn sources(name: &str) -> BTreeMap<Module, String> {
    let root = root().join(name).join("src");
    let mut files = Vec::new();
    walk(&root, &mut files);
    files
        .into_iter()
        .map(|file| {
            let path = file.strip_prefix(&root).unwrap().with_extension("");
            let mut module: Module = path.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
            if module == ["lib"] {
                module.clear();
            }
            (module, std::fs::read_to_string(&file).unwrap())
        })
        .collect()
}

/// Returns the imports that the table does not allow.
fn outside_of_rows(imports: &Imports, rooms: &[Room]) -> Vec<String> {
    let mut wrong = Vec::new();
    for (module, imported) in imports {
        let Some(own) = module.first() else { continue };
        let Some(room) = rooms.iter().find(|room| room.name == *own) else {
            wrong.push(format!("{} has no row in the table", module.join("::")));
            continue;
        };
        for other_module in imported {
            match other_module.first() {
                Some(other) if other != own && !room.may_use.contains(other) => {
                    wrong.push(format!("{} imports from {}", module.join("::"), other_module.join("::")));
                }
                _ => {}
            }
        }
    }
    wrong
}

/// Returns the groups of files that import each other in a cycle. Imports from the modules that contain the file (`super`) do
/// not count.
fn cycles(imports: &Imports) -> Vec<Vec<Module>> {
    let below = |module: &Module| -> Vec<&Module> {
        let imported = imports.get(module).into_iter().flatten();
        imported.filter(|other| !module.starts_with(other)).collect()
    };
    let reached = |from: &Module| -> BTreeSet<&Module> {
        let mut seen = BTreeSet::new();
        let mut waiting = below(from);
        while let Some(module) = waiting.pop() {
            if seen.insert(module) {
                waiting.extend(below(module));
            }
        }
        seen
    };
    let reach: BTreeMap<&Module, BTreeSet<&Module>> = imports.keys().map(|module| (module, reached(module))).collect();
    let mut groups: BTreeSet<Vec<Module>> = BTreeSet::new();
    for (module, reached) in &reach {
        let group: Vec<Module> = reached
            .iter()
            .filter(|other| reach.get(*other).is_some_and(|back| back.contains(module)))
            .map(|other| (*other).clone())
            .collect();
        if !group.is_empty() {
            groups.insert(group);
        }
    }
    groups.into_iter().collect()
}

fn written(group: &[Module]) -> String {
    group.iter().map(|module| module.join("::")).collect::<Vec<_>>().join(", ")
}

#[test]
fn crates_depend_only_on_the_crates_in_their_row() {
    let crates = table(ARCHITECTURE, CRATES);
    let packages: BTreeSet<String> = crates.iter().map(|row| row.package.clone()).collect();
    let mut wrong = Vec::new();
    for row in &crates {
        let used = dependencies(&row.name, &packages);
        println!("{} uses {}", row.package, used.iter().cloned().collect::<Vec<_>>().join(", "));
        wrong.extend(
            used.iter().filter(|name| !row.may_use.contains(name)).map(|name| format!("{}: {name}", row.package)),
        );
    }
    assert!(wrong.is_empty(), "not allowed by docs/architecture.md:\n{}", wrong.join("\n"));
}

#[test]
fn every_crate_of_the_host_has_a_row() {
    let folders = std::fs::read_dir(root().join("host")).unwrap();
    let there: BTreeSet<String> =
        folders.map(|entry| format!("host/{}", entry.unwrap().file_name().to_str().unwrap())).collect();
    let rows = table(ARCHITECTURE, CRATES).into_iter().map(|row| row.name);
    let rows: BTreeSet<String> = rows.filter(|name| name.starts_with("host/")).collect();
    assert_eq!(there, rows, "folders of host (left) and crates of docs/architecture.md (right)");
}

#[test]
fn rooms_use_only_the_rooms_in_their_row() {
    let rooms = rooms();
    let files = WITH_ROOMS.iter().flat_map(|(folder, _)| sources(folder)).collect();
    let imports = imports(&files, &WITH_ROOMS.map(|(_, name)| name));
    let wrong = outside_of_rows(&imports, &rooms);
    println!("{} rooms, {} files, {} imports outside", rooms.len(), imports.len(), wrong.len());
    assert!(wrong.is_empty(), "not allowed by docs/architecture.md:\n{}", wrong.join("\n"));
}

#[test]
fn rooms_and_rows_of_the_tables_are_the_same() {
    for (folder, _) in WITH_ROOMS {
        let files = sources(folder);
        let there: BTreeSet<&str> = files.keys().filter_map(|module| module.first().map(String::as_str)).collect();
        let rooms = rooms_of(folder);
        let rooms: BTreeSet<&str> = rooms.iter().map(|room| room.name.as_str()).collect();
        assert_eq!(there, rooms, "rooms of {folder} (left) and of docs/architecture.md (right)");
    }
}

#[test]
fn a_row_names_only_rows_above_it() {
    for (name, rows) in [("crates", table(ARCHITECTURE, CRATES)), ("rooms", rooms())] {
        assert!(rows.len() > 10, "{name}: {} rows", rows.len());
        let names: BTreeSet<&str> = rows.iter().map(|row| row.name.as_str()).collect();
        assert_eq!(names.len(), rows.len(), "{name}: a name occurs twice");
        for (index, row) in rows.iter().enumerate() {
            let MayUse::Rooms(may_use) = &row.may_use else { continue };
            for other in may_use {
                let above = rows[..index].iter().any(|above| above.name == *other || above.package == *other);
                assert!(above, "{}: {other} is not above it", row.name);
            }
        }
    }
}

#[test]
fn no_crate_has_import_cycles() {
    let mut all = Vec::new();
    let crates = table(ARCHITECTURE, CRATES).into_iter().map(|row| row.name);
    for name in crates.chain([NOT_IN_TABLE.to_owned()]) {
        let imports = imports(&sources(&name), &[]);
        let groups = cycles(&imports);
        println!("{name}: {} files, {} import cycles", imports.len(), groups.len());
        all.extend(groups.iter().map(|group| format!("{name}: {}", written(group))));
    }
    assert!(all.is_empty(), "{}", all.join("\n"));
}

/// Tests of the checks above, on sources with a known fault.
mod checks {
    use super::*;

    const HEADING: &str = "### Rooms";
    const TABLE: &str = "### Rooms\n\n| room | content | may use |\n|---|---|---|\n\
        | `numerics` | x | |\n| `solve` | x | `numerics` |\n| `cli` | x | everything |\n";

    fn crate_of(files: &[(&str, &str)]) -> Imports {
        let module = |name: &str| name.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect();
        imports(&files.iter().map(|(name, text)| (module(name), (*text).to_owned())).collect(), &["evcal_rooms"])
    }

    #[test]
    fn a_wrong_import_is_found_in_every_syntax() {
        for text in [
            "use crate::solve::step;",
            "use crate::{solve::step, other};",
            "use super::solve;",
            "use evcal_rooms::solve::step;",
            "fn f() { evcal_rooms::solve::step() }",
            "fn f() { crate::solve::step() }",
            "fn f() { println!(\"{}\", crate::solve::step()) }",
            "fn f() -> Option<crate::solve::Step> { None }",
        ] {
            let imports = crate_of(&[("numerics", text), ("solve", "use crate::numerics::huber;"), ("other", "")]);
            let wrong = outside_of_rows(&imports, &table(TABLE, HEADING));
            assert!(wrong.contains(&"numerics imports from solve".to_owned()), "{text}: {wrong:?}");
        }
    }

    #[test]
    fn allowed_imports_and_imports_of_tests_pass() {
        let imports = crate_of(&[
            ("numerics", "#[cfg(test)] mod tests { use crate::solve::step; }"),
            ("solve", "use crate::numerics::huber; use std::fmt; mod part; use part::Part;"),
            ("solve::part", "use super::Problem; use crate::numerics;"),
            ("cli", "use evcal_other::solve::step;"),
        ]);
        assert_eq!(outside_of_rows(&imports, &table(TABLE, HEADING)), Vec::<String>::new());
        assert_eq!(cycles(&imports), Vec::<Vec<Module>>::new());
    }

    #[test]
    fn a_module_without_a_row_is_found() {
        let imports = crate_of(&[("attic::box", "")]);
        assert_eq!(outside_of_rows(&imports, &table(TABLE, HEADING)), ["attic::box has no row in the table"]);
    }

    #[test]
    fn cycles_across_several_files_are_found() {
        let imports = crate_of(&[
            ("a", "use crate::b::B;"),
            ("b", "use crate::c::C;"),
            ("c", "use super::a::A;"),
            ("d", "use crate::a::A;"),
        ]);
        assert_eq!(cycles(&imports).iter().map(|group| written(group)).collect::<Vec<_>>(), ["a, b, c"]);
    }
}

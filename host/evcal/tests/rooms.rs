//! The rooms of `host/src` use each other as the table in `docs/architecture.md` says, and the files of no
//! crate import each other in circles.
//!
//! `make rooms` prints what was looked at. Tests within the sources may import what they like.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{Attribute, File, Item, Macro, UseTree};

/// A module by its path within the crate, `["solve", "levenberg"]`; the root is empty.
type Module = Vec<String>;
/// For each module the modules that it imports from.
type Imports = BTreeMap<Module, BTreeSet<Module>>;

const ARCHITECTURE: &str = include_str!("../../../docs/architecture.md");
/// Crates whose files must not import each other in circles.
const CRATES: [&str; 4] = ["core", "firmware/link", "host", "usb-davis"];
/// Modules of `host/src` that are no rooms: the library's root and the program's.
const ROOTS: [&str; 2] = ["lib", "main"];

/// What a row of the table says.
struct Room {
    name: String,
    may_use: MayUse,
}

enum MayUse {
    Everything,
    Rooms(BTreeSet<String>),
}

impl MayUse {
    fn holds(&self, room: &str) -> bool {
        match self {
            Self::Everything => true,
            Self::Rooms(rooms) => rooms.contains(room),
        }
    }
}

/// The rows of the table of rooms in their order.
fn table(document: &str) -> Vec<Room> {
    let lines = document.lines().skip_while(|line| !line.starts_with("### `host/src`"));
    let rows = lines.skip_while(|line| !line.starts_with("|---")).skip(1).take_while(|line| line.starts_with('|'));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let words = cells[3].split('`').map(str::trim).filter(|word| !word.is_empty());
        let may_use = match cells[3] {
            "everything" => MayUse::Everything,
            _ => MayUse::Rooms(words.map(str::to_owned).collect()),
        };
        Room { name: cells[1].trim_matches('`').to_owned(), may_use }
    })
    .collect()
}

/// Paths that a file names, as their segments.
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

    /// Paths in what a macro is given, where there is no syntax tree: `crate :: a :: b`.
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

/// The place of a module's path in its crate; `None` where it leads out of the crate.
fn resolve(module: &Module, path: &[String], modules: &BTreeSet<Module>) -> Option<Module> {
    let mut rest = path;
    let mut place: Module = match path.first().map(String::as_str) {
        Some("crate") => Vec::new(),
        Some("self" | "super") => module.clone(),
        // A path may begin with a module that the file declares itself.
        Some(name) if modules.contains(&[module.as_slice(), &[name.to_owned()]].concat()) => {
            return Some([module.as_slice(), &[name.to_owned()]].concat());
        }
        // The program uses its library by name.
        Some("evcal") => Vec::new(),
        _ => return None,
    };
    while let Some(first) = rest.first() {
        match first.as_str() {
            "crate" | "self" | "evcal" => {}
            "super" => {
                place.pop();
            }
            _ => break,
        }
        rest = &rest[1..];
    }
    for name in rest {
        place.push(name.clone());
        if !modules.contains(&place) {
            place.pop();
            break;
        }
    }
    Some(place)
}

/// What every module of a crate imports, from the text of its files.
fn imports(files: &BTreeMap<Module, String>) -> Imports {
    let modules: BTreeSet<Module> = files.keys().cloned().collect();
    let of_file = |(module, text): (&Module, &String)| {
        let file: File = syn::parse_file(text).unwrap_or_else(|error| panic!("{}: {error}", module.join("::")));
        let mut paths = Paths::default();
        paths.visit_file(&file);
        let places = paths.found.iter().filter_map(|path| resolve(module, path, &modules));
        (module.clone(), places.filter(|place| place != module).collect())
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

/// The source files of a crate by module.
fn sources(name: &str) -> BTreeMap<Module, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(name).join("src");
    let mut files = Vec::new();
    walk(&root, &mut files);
    files
        .into_iter()
        .map(|file| {
            let place = file.strip_prefix(&root).unwrap().with_extension("");
            let mut module: Module = place.iter().map(|part| part.to_str().unwrap().to_owned()).collect();
            if module == ["lib"] {
                module.clear();
            }
            (module, std::fs::read_to_string(&file).unwrap())
        })
        .collect()
}

/// Imports that the table does not allow.
fn outside_of_rows(imports: &Imports, rooms: &[Room]) -> Vec<String> {
    let mut wrong = Vec::new();
    for (module, places) in imports {
        let Some(own) = module.first().filter(|name| !ROOTS.contains(&name.as_str())) else { continue };
        let Some(room) = rooms.iter().find(|room| room.name == *own) else {
            wrong.push(format!("{} is in no room of the table", module.join("::")));
            continue;
        };
        for place in places {
            match place.first() {
                Some(other) if other != own && !room.may_use.holds(other) => {
                    wrong.push(format!("{} imports from {}", module.join("::"), place.join("::")));
                }
                _ => {}
            }
        }
    }
    wrong
}

/// Groups of files that import each other in circles. A file may use what the files above it in its own branch
/// define (`super`), and that is no circle.
fn circles(imports: &Imports) -> Vec<Vec<Module>> {
    let below = |module: &Module| -> Vec<&Module> {
        let places = imports.get(module).into_iter().flatten();
        places.filter(|place| !module.starts_with(place)).collect()
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
fn rooms_use_only_what_their_row_allows() {
    let rooms = table(ARCHITECTURE);
    let imports = imports(&sources("host"));
    let wrong = outside_of_rows(&imports, &rooms);
    println!("host: {} rooms, {} files, {} imports outside of the table", rooms.len(), imports.len(), wrong.len());
    assert!(wrong.is_empty(), "not allowed by docs/architecture.md:\n{}", wrong.join("\n"));
}

#[test]
fn every_entry_of_the_sources_is_a_room_and_every_room_is_there() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let names = std::fs::read_dir(source).unwrap().map(|entry| {
        let path = entry.unwrap().path();
        path.file_stem().unwrap().to_str().unwrap().to_owned()
    });
    let entries: BTreeSet<String> = names.filter(|name| !ROOTS.contains(&name.as_str())).collect();
    let rooms: BTreeSet<String> = table(ARCHITECTURE).into_iter().map(|room| room.name).collect();
    println!("host: {} entries beside {}", entries.len(), ROOTS.join(" and "));
    assert_eq!(entries, rooms, "entries of host/src (left) and rooms of docs/architecture.md (right)");
}

#[test]
fn a_row_names_only_rooms_above_it() {
    let rooms = table(ARCHITECTURE);
    for (index, room) in rooms.iter().enumerate() {
        let MayUse::Rooms(may_use) = &room.may_use else { continue };
        for other in may_use {
            let above = rooms[..index].iter().any(|above| above.name == *other);
            assert!(above, "{}: {other} does not stand above it", room.name);
        }
    }
}

#[test]
fn no_crate_imports_in_circles() {
    let mut all = Vec::new();
    for name in CRATES {
        let imports = imports(&sources(name));
        let groups = circles(&imports);
        println!("{name}: {} files, {} import circles", imports.len(), groups.len());
        all.extend(groups.iter().map(|group| format!("{name}: {}", written(group))));
    }
    assert!(all.is_empty(), "{}", all.join("\n"));
}

/// The checks above on sources with a known fault.
mod checks {
    use super::*;

    const TABLE: &str = "### `host/src`: the rooms\n\n| room | lives in it | may use |\n|---|---|---|\n\
        | `numerics` | x | |\n| `solve` | x | `numerics` |\n| `cli` | x | everything |\n";

    fn crate_of(files: &[(&str, &str)]) -> Imports {
        let module = |name: &str| name.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect();
        imports(&files.iter().map(|(name, text)| (module(name), (*text).to_owned())).collect())
    }

    #[test]
    fn a_wrong_import_is_found_however_it_is_written() {
        for text in [
            "use crate::solve::step;",
            "use crate::{solve::step, other};",
            "use super::solve;",
            "fn f() { crate::solve::step() }",
            "fn f() { println!(\"{}\", crate::solve::step()) }",
            "fn f() -> Option<crate::solve::Step> { None }",
        ] {
            let imports = crate_of(&[("numerics", text), ("solve", "use crate::numerics::huber;"), ("other", "")]);
            let wrong = outside_of_rows(&imports, &table(TABLE));
            assert!(wrong.contains(&"numerics imports from solve".to_owned()), "{text}: {wrong:?}");
        }
    }

    #[test]
    fn allowed_imports_and_those_of_tests_pass() {
        let imports = crate_of(&[
            ("numerics", "#[cfg(test)] mod tests { use crate::solve::step; }"),
            ("solve", "use crate::numerics::huber; use std::fmt; mod part; use part::Part;"),
            ("solve::part", "use super::Problem; use crate::numerics;"),
            ("cli", "use evcal_calibrate::solve::step;"),
        ]);
        assert_eq!(outside_of_rows(&imports, &table(TABLE)), Vec::<String>::new());
        assert_eq!(circles(&imports), Vec::<Vec<Module>>::new());
    }

    #[test]
    fn a_module_without_a_room_is_found() {
        let imports = crate_of(&[("attic::box", "")]);
        assert_eq!(outside_of_rows(&imports, &table(TABLE)), ["attic::box is in no room of the table"]);
    }

    #[test]
    fn circles_are_found_through_several_files() {
        let imports = crate_of(&[
            ("a", "use crate::b::B;"),
            ("b", "use crate::c::C;"),
            ("c", "use super::a::A;"),
            ("d", "use crate::a::A;"),
        ]);
        assert_eq!(circles(&imports).iter().map(|group| written(group)).collect::<Vec<_>>(), ["a, b, c"]);
    }
}

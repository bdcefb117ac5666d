//! Checks that no library names an option or a subcommand of `evcal` in its messages and documentation. Remedies take them
//! from one table, which has a column for each program.

use std::path::{Path, PathBuf};

use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, File, Item, Lit, LitStr, Macro, Meta};

/// Crates that must not name options. `host/evcal` is the program.
const CRATES: &[&str] = &[
    "core",
    "firmware/link",
    "host/calibrate",
    "host/detection",
    "host/files",
    "host/geometry",
    "host/live",
    "host/opencv",
    "host/recordings",
    "host/report",
    "host/simulator",
    "host/solve",
    "host/squares",
    "usb-davis",
];

/// The table of options.
const TABLE: &str = "host/files/src/remedy.rs";

/// Words that look like options but belong to other programs, and where they come from.
const OF_OTHERS: &[(&str, &str)] = &[
    ("--compression-mode", "ros2 bag record"),
    ("--features", "cargo build"),
    ("--x", ROS_TRANSFORM),
    ("--y", ROS_TRANSFORM),
    ("--z", ROS_TRANSFORM),
    ("--qx", ROS_TRANSFORM),
    ("--qy", ROS_TRANSFORM),
    ("--qz", ROS_TRANSFORM),
    ("--qw", ROS_TRANSFORM),
    ("--frame-id", ROS_TRANSFORM),
    ("--child-frame-id", ROS_TRANSFORM),
];
/// Commands that are part of a file's content.
const NAMES_IN_FILES: &[(&str, &str)] = &[("evcal simulate", "the writer of a simulated dump, in its header")];
const ROS_TRANSFORM: &str = "ros2 run tf2_ros static_transform_publisher, a line of an exported file";

/// The program's single-letter options.
const SHORT_OPTIONS: &[&str] = &["-c", "-o"];

const SUBCOMMANDS: &[&str] = &[
    "board",
    "calibrate",
    "check",
    "compare",
    "completions",
    "convert",
    "detect",
    "devices",
    "evaluate",
    "export",
    "info",
    "live",
    "man",
    "record",
    "repeat",
    "simulate",
    "undistort",
];

/// Returns the options and commands of the program that `text` names.
fn words_of_the_command_line(text: &str) -> Vec<String> {
    let is_part = |letter: char| letter.is_alphanumeric() || letter == '-' || letter == '_';
    let words: Vec<&str> = text.split(|letter| !is_part(letter)).filter(|word| !word.is_empty()).collect();
    let is_option = |word: &&&str| {
        let long =
            word.strip_prefix("--").is_some_and(|name| name.starts_with(|letter: char| letter.is_ascii_lowercase()));
        (long || SHORT_OPTIONS.contains(word)) && !OF_OTHERS.iter().any(|(option, _)| option == *word)
    };
    let options = words.iter().filter(is_option).map(|word| (*word).to_owned());
    let commands = words.windows(2).filter(|pair| pair[0] == "evcal" && SUBCOMMANDS.contains(&pair[1]));
    let commands = commands.map(|pair| pair.join(" "));
    options.chain(commands.filter(|command| !NAMES_IN_FILES.iter().any(|(name, _)| name == command))).collect()
}

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<Meta>().is_ok_and(|condition| match condition {
                Meta::Path(path) => path.is_ident("test"),
                Meta::List(list) => list.path.is_ident("all") && list.tokens.to_string().starts_with("test"),
                Meta::NameValue(_) => false,
            })
    })
}

/// Texts of a source file outside its tests.
#[derive(Default)]
struct Texts {
    /// String literals and documentation.
    found: Vec<String>,
    /// Modules that are compiled for tests only and have their own file.
    tests: Vec<String>,
}

impl Texts {
    fn of(text: &str) -> Self {
        let file: File = syn::parse_file(text).unwrap();
        let mut texts = Self::default();
        texts.visit_file(&file);
        texts
    }

    fn wrong(&self) -> Vec<String> {
        self.found.iter().flat_map(|text| words_of_the_command_line(text)).collect()
    }

    fn tokens(&mut self, tokens: TokenStream) {
        for token in tokens {
            match token {
                TokenTree::Group(group) => self.tokens(group.stream()),
                TokenTree::Literal(literal) => {
                    if let Lit::Str(text) = Lit::new(literal) {
                        self.visit_lit_str(&text);
                    }
                }
                _ => {}
            }
        }
    }
}

impl<'a> Visit<'a> for Texts {
    fn visit_item(&mut self, item: &'a Item) {
        match item {
            Item::Mod(module) if is_test(&module.attrs) => {
                if module.content.is_none() {
                    self.tests.push(module.ident.to_string());
                }
            }
            Item::Fn(function) if is_test(&function.attrs) => {}
            item => visit::visit_item(self, item),
        }
    }

    fn visit_attribute(&mut self, attribute: &'a Attribute) {
        match &attribute.meta {
            // Arguments of a derive, such as the text of an error, have no syntax tree.
            Meta::List(list) => self.tokens(list.tokens.clone()),
            _ => visit::visit_attribute(self, attribute),
        }
    }

    fn visit_macro(&mut self, item: &'a Macro) {
        self.tokens(item.tokens.clone());
    }

    fn visit_lit_str(&mut self, text: &'a LitStr) {
        self.found.push(text.value());
    }
}

/// Collects the options and commands named in `file` and in the files of its modules, except tests.
fn wrong_in(file: &Path, folder: &Path, wrong: &mut Vec<String>) {
    if file.ends_with(TABLE) {
        return;
    }
    let texts = Texts::of(&std::fs::read_to_string(file).unwrap());
    wrong.extend(texts.wrong().into_iter().map(|word| format!("{}: {word}", file.display())));
    let entries = std::fs::read_dir(folder).into_iter().flatten().map(|entry| entry.unwrap().path());
    let mut modules: Vec<PathBuf> = entries.filter(|path| path.extension().is_some_and(|name| name == "rs")).collect();
    modules.sort();
    for module in modules {
        let name = module.file_stem().unwrap().to_str().unwrap().to_owned();
        if module != file && name != "main" && !texts.tests.contains(&name) {
            wrong_in(&module, &folder.join(name), wrong);
        }
    }
}

#[test]
fn libraries_name_no_option_and_no_subcommand() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut wrong = Vec::new();
    for name in CRATES {
        let source = root.join(name).join("src");
        wrong_in(&source.join("lib.rs"), &source, &mut wrong);
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn options_are_found_in_documentation_attributes_and_literals() {
    let source = r##"
        /// Says `--device`.
        #[derive(thiserror::Error)]
        #[error("add --sensor {0}")]
        struct A(u8);
        fn b() { format!("{}", "see evcal calibrate"); let _ = "write with -o"; }
        fn c() { let _ = "a - b -- c, ros2 bag record --compression-mode, evcal reads"; }
        #[cfg(test)]
        mod tests { fn d() { let _ = "--force"; } }
        #[cfg(all(test, unix))]
        mod testing;
    "##;
    let texts = Texts::of(source);
    assert_eq!(texts.wrong(), ["--device", "--sensor", "evcal calibrate", "-o"]);
    assert_eq!(texts.tests, ["testing"]);
}

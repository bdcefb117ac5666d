//! Checks that no function takes a tuple instead of a structure with named fields.
//!
//! Two numbers of one type under one name, such as the size of an image or a time span, are allowed. Functions that implement a
//! trait are exempt because the trait prescribes their parameters.

use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};
use syn::{File, FnArg, ImplItemFn, ItemFn, ItemImpl, Pat, PatType, Signature, TraitItemFn, Type, TypeTuple};

/// Folders with sources, from the root of the repository.
const FOLDERS: [&str; 7] = ["core", "firmware", "fuzz", "host", "python", "tests", "usb-davis"];

/// Names of the functions with tuples among their parameters.
#[derive(Default)]
struct Functions {
    seen: usize,
    with_tuples: Vec<String>,
}

impl Functions {
    fn check(&mut self, signature: &Signature) {
        self.seen += 1;
        let is_structure = |argument: &FnArg| match argument {
            FnArg::Typed(typed) => tuple(&typed.ty).is_some_and(|tuple| !is_pair(typed, tuple)),
            FnArg::Receiver(_) => false,
        };
        if signature.inputs.iter().any(is_structure) {
            self.with_tuples.push(signature.ident.to_string());
        }
    }
}

/// Returns the tuple type of a parameter, also behind a reference.
fn tuple(parameter: &Type) -> Option<&TypeTuple> {
    match parameter {
        Type::Tuple(tuple) => Some(tuple).filter(|tuple| !tuple.elems.is_empty()),
        Type::Reference(reference) => tuple(&reference.elem),
        Type::Paren(inner) => tuple(&inner.elem),
        _ => None,
    }
}

/// `true` if a parameter with this type is two numbers of one type under one name.
fn is_pair(parameter: &PatType, tuple: &TypeTuple) -> bool {
    let number = |element: &Type| match element {
        Type::Path(path) => path.path.get_ident().map(ToString::to_string).filter(|name| {
            let (kind, size) = name.split_at(1);
            matches!(kind, "f" | "i" | "u") && (size == "size" || size.parse::<u8>().is_ok())
        }),
        _ => None,
    };
    let numbers: Option<Vec<String>> = tuple.elems.iter().map(number).collect();
    let has_one_name = matches!(*parameter.pat, Pat::Ident(_));
    has_one_name && numbers.is_some_and(|numbers| matches!(&numbers[..], [first, second] if first == second))
}

impl<'a> Visit<'a> for Functions {
    fn visit_item_fn(&mut self, item: &'a ItemFn) {
        self.check(&item.sig);
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'a ImplItemFn) {
        self.check(&item.sig);
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'a TraitItemFn) {
        self.check(&item.sig);
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_item_impl(&mut self, item: &'a ItemImpl) {
        if item.trait_.is_none() {
            visit::visit_item_impl(self, item);
        }
    }
}

fn functions(file: &File) -> Functions {
    let mut functions = Functions::default();
    functions.visit_file(file);
    functions
}

fn sources(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            if path.file_name().is_some_and(|name| name != "target") {
                sources(&path, files);
            }
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.push(path);
        }
    }
}

#[test]
fn no_parameter_is_a_tuple_instead_of_a_structure() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut files = Vec::new();
    FOLDERS.iter().for_each(|folder| sources(&root.join(folder), &mut files));
    let (mut seen, mut found) = (0, Vec::new());
    for path in files {
        let text = std::fs::read_to_string(&path).unwrap();
        let functions = functions(&syn::parse_file(&text).unwrap());
        seen += functions.seen;
        let name = path.strip_prefix(&root).unwrap().display();
        found.extend(functions.with_tuples.iter().map(|function| format!("{name}: {function}")));
    }
    println!("{seen} functions, {} with tuples instead of structures", found.len());
    assert!(found.is_empty(), "give these parameters a type with names:\n{}", found.join("\n"));
}

#[test]
fn tuples_are_found_in_all_kinds_of_functions() {
    let with_tuples = |text: &str| functions(&syn::parse_file(text).unwrap()).with_tuples;
    let faults = "
        fn f((a, b): (&A, &B)) {}
        impl S { fn g(&self, (x, y): (u16, u16)) {} }
        trait T { fn h(one: &(f64, A)); }
        mod inner { fn outer() { fn i(three: (f64, f64, f64)) {} } }";
    assert_eq!(with_tuples(faults), ["f", "g", "h", "i"]);
    let allowed = "
        fn f(size: (u16, u16), span: (i64, i64), nothing: ()) -> (A, B) { let g = |(a, b): (A, B)| a; }
        impl T for S { fn h(one: &(f64, A)) {} }";
    assert_eq!(with_tuples(allowed), Vec::<String>::new());
}

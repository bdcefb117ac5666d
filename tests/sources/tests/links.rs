//! Checks that every file, heading and source file that a document links to or names exists.

use std::fs;
use std::path::{Path, PathBuf};

/// Collects the Markdown files of the repository, without build output.
fn documents(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if path.is_dir() {
            if !name.starts_with('.') && name != "target" && name != "demo" {
                documents(&path, found);
            }
        } else if name.ends_with(".md") {
            found.push(path);
        }
    }
}

/// Returns the anchor of a heading: its words in lower case, joined by hyphens.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter(|character| character.is_alphanumeric() || "-_ ".contains(*character));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

/// Returns the targets of the links in `text`, which are written as `](…)`, except web addresses.
fn targets(text: &str) -> Vec<String> {
    let after = text.split("](").skip(1);
    let inside = after.filter_map(|rest| rest.split(')').next());
    inside.filter(|target| !target.contains(':') && !target.contains(' ')).map(str::to_owned).collect()
}

/// Returns the paths of this repository's sources that `text` names in code, such as `core/src/spline.rs`.
fn sources(text: &str) -> impl Iterator<Item = &str> {
    let roots = ["core/", "firmware/", "fuzz/", "host/", "python/", "tests/", "tools/", "usb-davis/"];
    let is_path = |word: &&str| word.chars().all(|letter| letter.is_ascii_alphanumeric() || "_-./".contains(letter));
    let is_source = move |word: &&str| roots.iter().any(|root| word.starts_with(root)) && is_path(word);
    // NAME is a placeholder for a file that the reader writes.
    text.split('`').skip(1).step_by(2).filter(is_source).filter(|word| !word.contains("NAME"))
}

#[test]
fn every_named_source_file_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut found = Vec::new();
    documents(&root, &mut found);
    let (mut count, mut missing) = (0, Vec::new());
    for document in &found {
        let text = fs::read_to_string(document).unwrap();
        for source in sources(&text) {
            // Documents of a crate name files relative to the crate.
            let folder = document.parent().unwrap();
            count += 1;
            if !root.join(source).exists() && !folder.join(source).exists() {
                missing.push(format!("{}: {source}", document.display()));
            }
        }
    }
    assert!(count > 100, "{count}");
    assert!(missing.is_empty(), "{missing:#?}");
}

#[test]
fn every_link_target_exists() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut found = Vec::new();
    documents(&root, &mut found);
    assert!(found.len() > 15, "{found:?}");
    let mut broken = Vec::new();
    for document in &found {
        let text = fs::read_to_string(document).unwrap();
        for target in targets(&text) {
            let (path, heading) = target.split_once('#').unwrap_or((&target, ""));
            let file = if path.is_empty() { document.clone() } else { document.parent().unwrap().join(path) };
            let headings = || {
                let text = fs::read_to_string(&file).unwrap_or_default();
                text.lines()
                    .filter(|line| line.starts_with('#'))
                    .any(|line| anchor(line.trim_start_matches('#')) == heading)
            };
            if !file.exists() || !(heading.is_empty() || headings()) {
                broken.push(format!("{}: {target}", document.display()));
            }
        }
    }
    assert!(broken.is_empty(), "{broken:#?}");
}

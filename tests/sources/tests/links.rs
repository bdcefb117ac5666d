//! Links between the documents: every file and every heading that one names is there, and so is every source file.

use std::fs;
use std::path::{Path, PathBuf};

/// All Markdown files of the repository that people read, without those of what is built.
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

/// The anchor that a heading gets: words in small letters, joined by hyphens.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter(|character| character.is_alphanumeric() || "-_ ".contains(*character));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

/// Targets of the links in `text`: what stands in `](…)`, beside addresses of the web.
fn targets(text: &str) -> Vec<String> {
    let after = text.split("](").skip(1);
    let inside = after.filter_map(|rest| rest.split(')').next());
    inside.filter(|target| !target.contains(':') && !target.contains(' ')).map(str::to_owned).collect()
}

/// Paths of this repository's sources that `text` names in code, as in `core/src/spline.rs`.
fn sources(text: &str) -> impl Iterator<Item = &str> {
    let roots = ["core/", "firmware/", "fuzz/", "host/", "python/", "tests/", "tools/", "usb-davis/"];
    let is_path = |word: &&str| word.chars().all(|letter| letter.is_ascii_alphanumeric() || "_-./".contains(letter));
    let is_source = move |word: &&str| roots.iter().any(|root| word.starts_with(root)) && is_path(word);
    // NAME stands for a file that the reader is to write.
    text.split('`').skip(1).step_by(2).filter(is_source).filter(|word| !word.contains("NAME"))
}

#[test]
fn every_source_that_is_named_is_there() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let mut found = Vec::new();
    documents(&root, &mut found);
    let (mut count, mut missing) = (0, Vec::new());
    for document in &found {
        let text = fs::read_to_string(document).unwrap();
        for source in sources(&text) {
            // A crate's own documents name files of the crate.
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
fn every_link_leads_somewhere() {
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

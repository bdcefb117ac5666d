//! The fuzz targets (`fuzz/src/targets.rs`) read the corpus: unchanged, truncated, and with changed bytes.

use std::fs;
use std::path::{Path, PathBuf};

#[path = "../../../fuzz/src/targets.rs"]
mod targets;

use targets::{TARGETS, Target};

/// Largest number of positions per file at which it is cut, or at which a byte is changed.
const MOST_POSITIONS: usize = 400;

fn files(target: &Target) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fuzz/corpus").join(target.name);
    let mut files: Vec<PathBuf> = fs::read_dir(&folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{} has no corpus", target.name);
    files
}

/// `true` if the file is a seed and was not found by a fuzzer.
fn is_seed(file: &Path) -> bool {
    file.file_name().unwrap().to_str().unwrap().starts_with("seed")
}

fn positions(length: usize) -> impl Iterator<Item = usize> {
    (0..length).step_by(length.div_ceil(MOST_POSITIONS).max(1))
}

#[test]
fn the_corpus_is_read_unchanged() {
    for target in TARGETS {
        for file in files(target) {
            let read = target.run(&fs::read(&file).unwrap());
            // Only files that a fuzzer found may have another format.
            assert!(read || !is_seed(&file), "{} is not a {}", file.display(), target.name);
        }
    }
}

/// A seed that is truncated or has another format would not help a fuzzer.
#[test]
fn the_seeds_of_recordings_are_read_to_their_end() {
    for target in TARGETS {
        for file in files(target).iter().filter(|file| is_seed(file)) {
            let events = target.events(&fs::read(file).unwrap());
            assert!(events.as_ref().is_none_or(|events| matches!(events, Ok(1..))), "{}: {events:?}", file.display());
        }
    }
}

/// The target keeps folders whose images cannot be read; the images of the seeds must be readable.
#[test]
fn the_seeds_of_image_folders_are_images() {
    let target = TARGETS.iter().find(|target| target.name == "image-folder").unwrap();
    for file in files(target).iter().filter(|file| is_seed(file)) {
        let images = targets::images_in(&fs::read(file).unwrap());
        assert!(matches!(images, Ok(2)), "{}: {images:?}", file.display());
    }
}

#[test]
fn the_corpus_is_read_truncated() {
    for target in TARGETS {
        for file in files(target) {
            let bytes = fs::read(&file).unwrap();
            for end in positions(bytes.len()) {
                target.run(&bytes[..end]);
            }
        }
    }
}

#[test]
fn the_corpus_is_read_with_changed_bytes() {
    for target in TARGETS {
        for file in files(target) {
            let mut bytes = fs::read(&file).unwrap();
            for position in positions(bytes.len()) {
                for change in [0x01, 0x80, 0xFF] {
                    bytes[position] ^= change;
                    target.run(&bytes);
                    bytes[position] ^= change;
                }
            }
        }
    }
}

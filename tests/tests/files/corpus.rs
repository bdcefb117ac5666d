//! What is fuzzed (`fuzz/src/targets.rs`) reads the corpus again: as it is, cut off, and with changed bytes.

use std::fs;
use std::path::{Path, PathBuf};

#[path = "../../../fuzz/src/targets.rs"]
mod targets;

use targets::{TARGETS, Target};

/// Places at which a file is cut, and at which a byte is changed; all where it has no more bytes.
const PLACES: usize = 400;

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

/// Whether no fuzzer found it.
fn is_seed(file: &Path) -> bool {
    file.file_name().unwrap().to_str().unwrap().starts_with("seed")
}

fn places(length: usize) -> impl Iterator<Item = usize> {
    (0..length).step_by(length.div_ceil(PLACES).max(1))
}

#[test]
fn the_corpus_is_read_as_it_is() {
    for target in TARGETS {
        for file in files(target) {
            let read = target.run(&fs::read(&file).unwrap());
            // Of another format is only what a fuzzer found.
            assert!(read || !is_seed(&file), "{} is no {}", file.display(), target.name);
        }
    }
}

/// Cut off or of another kind, a seed would lead a fuzzer nowhere.
#[test]
fn the_seeds_of_recordings_are_read_to_their_end() {
    for target in TARGETS {
        for file in files(target).iter().filter(|file| is_seed(file)) {
            let events = target.events(&fs::read(file).unwrap());
            assert!(events.as_ref().is_none_or(|events| matches!(events, Ok(1..))), "{}: {events:?}", file.display());
        }
    }
}

/// Images are kept whatever comes of them: those of the seeds are to be read.
#[test]
fn the_seeds_of_image_folders_are_images() {
    let target = TARGETS.iter().find(|target| target.name == "image-folder").unwrap();
    for file in files(target).iter().filter(|file| is_seed(file)) {
        let images = targets::images_in(&fs::read(file).unwrap());
        assert!(matches!(images, Ok(2)), "{}: {images:?}", file.display());
    }
}

#[test]
fn the_corpus_is_read_cut_off() {
    for target in TARGETS {
        for file in files(target) {
            let bytes = fs::read(&file).unwrap();
            for end in places(bytes.len()) {
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
            for place in places(bytes.len()) {
                for change in [0x01, 0x80, 0xFF] {
                    bytes[place] ^= change;
                    target.run(&bytes);
                    bytes[place] ^= change;
                }
            }
        }
    }
}

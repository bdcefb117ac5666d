//! The files of a recording: whether they changed since it was opened, and their checksums.

use std::fs::{File, Metadata};
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::SystemTime;

use sha2::{Digest, Sha256};

use crate::error::{RecordingError, RecordingErrorKind};

/// Number of bytes that are read at once for a checksum.
const BLOCK: usize = 1 << 18;

/// Properties of a file that change with its content.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct State {
    bytes: u64,
    modified: Option<SystemTime>,
    /// Device, inode, and time of the last change of the inode in s and ns, which a program cannot set.
    #[cfg(unix)]
    inode: (u64, u64, i64, i64),
}

impl State {
    fn of(metadata: &Metadata) -> Self {
        #[cfg(unix)]
        use std::os::unix::fs::MetadataExt;
        Self {
            bytes: metadata.len(),
            modified: metadata.modified().ok(),
            #[cfg(unix)]
            inode: (metadata.dev(), metadata.ino(), metadata.ctime(), metadata.ctime_nsec()),
        }
    }
}

/// Size and checksum of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Checksum {
    /// Path of the file.
    pub path: PathBuf,
    /// Size in bytes.
    pub bytes: u64,
    /// SHA-256 of the content, in hexadecimal digits.
    pub sha256: String,
}

/// The files of a recording, as they were when it was opened.
#[derive(Clone, Debug, Default)]
pub struct Files {
    states: Arc<Vec<(PathBuf, State)>>,
    checksums: Arc<Mutex<Option<Vec<Checksum>>>>,
}

impl Files {
    /// Remembers the state of these files. Other paths are left out: a serial port or a pipe cannot be read again.
    pub fn new(paths: impl IntoIterator<Item = PathBuf>) -> Self {
        let state = |path: PathBuf| {
            let metadata = std::fs::metadata(&path).ok().filter(Metadata::is_file)?;
            Some((path, State::of(&metadata)))
        };
        Self { states: Arc::new(paths.into_iter().filter_map(state).collect()), checksums: Arc::default() }
    }

    /// Joins the files of several recordings.
    pub fn joined<'a>(all: impl IntoIterator<Item = &'a Self>) -> Self {
        let states = all.into_iter().flat_map(|files| files.states.iter().cloned()).collect();
        Self { states: Arc::new(states), checksums: Arc::default() }
    }

    /// `true` if there are none.
    pub fn is_empty(&self) -> bool {
        self.states.is_empty()
    }

    /// Returns the size of all files in bytes; `None` if there are none.
    pub fn bytes(&self) -> Option<u64> {
        (!self.is_empty()).then(|| self.states.iter().map(|(_, state)| state.bytes).sum())
    }

    /// Checks that no file has changed.
    ///
    /// # Errors
    /// [`RecordingErrorKind::Changed`] names the first file that has.
    pub fn check(&self) -> Result<(), RecordingError> {
        self.states.iter().try_for_each(|(path, state)| {
            let now = std::fs::metadata(path).map_err(|error| RecordingError::io(path, error))?;
            is_same(path, state, &now)
        })
    }

    /// Returns the checksums of the files. They are computed once.
    ///
    /// # Errors
    /// When a file cannot be read or has changed.
    pub fn checksums(&self) -> Result<Vec<Checksum>, RecordingError> {
        let mut checksums = self.checksums.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = &*checksums {
            return Ok(known.clone());
        }
        let computed = self.states.iter().map(|(path, state)| checksum(path, state)).collect::<Result<Vec<_>, _>>()?;
        Ok(checksums.insert(computed).clone())
    }
}

fn is_same(path: &Path, state: &State, now: &Metadata) -> Result<(), RecordingError> {
    if State::of(now) == *state { Ok(()) } else { Err(RecordingError::new(path, RecordingErrorKind::Changed)) }
}

fn checksum(path: &Path, state: &State) -> Result<Checksum, RecordingError> {
    let io = |error: io::Error| RecordingError::io(path, error);
    let mut file = File::open(path).map_err(io)?;
    is_same(path, state, &file.metadata().map_err(io)?)?;
    let (mut sum, mut bytes, mut block) = (Sha256::new(), 0, vec![0; BLOCK]);
    loop {
        let count = match file.read(&mut block) {
            Ok(0) => break,
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(io(error)),
        };
        bytes += count as u64;
        sum.update(block.get(..count).unwrap_or_default());
    }
    is_same(path, state, &file.metadata().map_err(io)?)?;
    let sha256 = sum.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(Checksum { path: path.to_owned(), bytes, sha256 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The checksum of "abc" in FIPS 180-2, appendix B.
    #[test]
    fn checksums_are_those_of_sha256sum() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        let files = Files::new([path.clone(), directory.path().join("missing"), directory.path().to_owned()]);
        let sha256 = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad".to_owned();
        assert_eq!(files.checksums().unwrap(), [Checksum { path, bytes: 3, sha256 }]);
    }

    #[test]
    fn every_kind_of_change_is_named() {
        let changes: [fn(&Path); 5] = [
            |path| std::fs::write(path, "abcd").unwrap(),
            |path| std::fs::write(path, "abd").unwrap(),
            |path| File::options().write(true).open(path).unwrap().set_len(1).unwrap(),
            |path| {
                let other = path.with_extension("other");
                std::fs::write(&other, "abc").unwrap();
                std::fs::rename(other, path).unwrap();
            },
            // The time of the content is set back.
            |path| {
                let before = std::fs::metadata(path).unwrap().modified().unwrap();
                std::fs::write(path, "xyz").unwrap();
                File::options().write(true).open(path).unwrap().set_modified(before).unwrap();
            },
        ];
        for (index, change) in changes.into_iter().enumerate() {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording");
            std::fs::write(&path, "abc").unwrap();
            let files = Files::new([path.clone()]);
            assert!(files.check().is_ok());
            // Longer than the resolution of a file system's clock.
            std::thread::sleep(std::time::Duration::from_millis(30));
            change(&path);
            for error in [files.check().unwrap_err(), files.checksums().unwrap_err()] {
                assert!(matches!(error.kind, RecordingErrorKind::Changed), "{index}: {error}");
                assert_eq!(error.path, path);
            }
        }
    }
}

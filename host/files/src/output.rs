//! Whether a file may be written where the user wants it.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FileError, is_stream, place, try_out, visible};

/// What becomes of files that are there already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// They stay, and nothing is written.
    Keep,
    /// New ones take their place.
    Replace,
}

/// Why a file cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// There is one of its name.
    #[error("{} is there already", visible::path(.0))]
    Taken(PathBuf),
    /// Two results would have one name, so that the second would replace the first.
    #[error("two results would be written to {}: give each a name of its own", visible::path(.0))]
    Twice(PathBuf),
    /// It is read too: when reading fails half-way, or less is written than was read, the rest would be lost.
    #[error("{} is what is read: choose another name for the result", visible::path(.0))]
    IsInput(PathBuf),
    /// The system refuses.
    #[error("{0}")]
    Unusable(#[from] FileError),
}

/// Whether files can be written at all of `paths`, told before the work and not after it. Those that are also `inputs` never can.
/// Pipes and devices have no content to keep.
///
/// # Errors
/// [`OutputError`] names the first that cannot be written.
pub fn check_outputs<'a>(
    paths: impl IntoIterator<Item = &'a Path>,
    inputs: &[&Path],
    existing: Existing,
) -> Result<(), OutputError> {
    let inputs: Vec<PathBuf> = inputs.iter().filter_map(|input| fs::canonicalize(input).ok()).collect();
    let mut places = Vec::new();
    for path in paths {
        if is_stream(path) {
            continue;
        }
        if let Some(place) = real_place(path) {
            if places.contains(&place) {
                return Err(OutputError::Twice(path.to_owned()));
            }
            places.push(place);
        }
        if path.is_file() && fs::canonicalize(path).is_ok_and(|place| inputs.contains(&place)) {
            return Err(OutputError::IsInput(path.to_owned()));
        }
        if existing == Existing::Keep && path.is_file() {
            return Err(OutputError::Taken(path.to_owned()));
        }
        try_out(path)?;
    }
    Ok(())
}

/// Where a file of this name is or will be, whatever its path is written as.
fn real_place(path: &Path) -> Option<PathBuf> {
    let place = place::target(path).ok()?;
    Some(fs::canonicalize(place::folder(&place)).ok()?.join(place.file_name()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_there_stays_unless_it_may_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [old, new] = ["old.csv", "new.csv"].map(|name| folder.path().join(name));
        fs::write(&old, "old").unwrap();
        let taken = check_outputs([new.as_path(), &old], &[], Existing::Keep).unwrap_err().to_string();
        assert!(taken.ends_with("old.csv is there already"), "{taken}");
        check_outputs([new.as_path(), &old], &[], Existing::Replace).unwrap();
        assert_eq!(fs::read_to_string(&old).unwrap(), "old");
        assert!(!new.exists());
        #[cfg(unix)]
        check_outputs([Path::new("/dev/null")], &[Path::new("/dev/null")], Existing::Keep).unwrap();
        for existing in [Existing::Keep, Existing::Replace] {
            let folder = check_outputs([folder.path()], &[], existing).unwrap_err().to_string();
            assert!(folder.contains("name a file in it"), "{folder}");
        }
    }

    #[test]
    fn two_results_need_two_names() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("table.h");
        let otherwise = folder.path().join(".").join("table.h");
        for existing in [Existing::Keep, Existing::Replace] {
            let told = check_outputs([file.as_path(), &otherwise], &[], existing).unwrap_err().to_string();
            assert!(told.contains("table.h: give each a name of its own"), "{told}");
        }
        fs::write(&file, "old").unwrap();
        let told = check_outputs([otherwise.as_path(), &file], &[], Existing::Replace).unwrap_err().to_string();
        assert!(told.starts_with("two results"), "{told}");
        #[cfg(unix)]
        check_outputs([Path::new("/dev/null"), Path::new("/dev/null")], &[], Existing::Keep).unwrap();
    }

    #[test]
    fn what_is_read_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("events.csv");
        fs::write(&recording, "0,1,2,1").unwrap();
        let otherwise = folder.path().join(".").join("events.csv");
        for existing in [Existing::Keep, Existing::Replace] {
            let told = check_outputs([otherwise.as_path()], &[&recording], existing).unwrap_err().to_string();
            assert!(told.ends_with("events.csv is what is read: choose another name for the result"), "{told}");
        }
    }
}

//! Whether a file may be written where the user wants it.

use std::path::{Path, PathBuf};

use super::{FileError, try_out};

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
    #[error("{} is there already: choose another name, or replace it with --force", .0.display())]
    Taken(PathBuf),
    /// The system refuses.
    #[error(transparent)]
    Unusable(#[from] FileError),
}

/// Whether files can be written at all of `paths`, told before the work and not after it. Pipes and devices have no content to
/// keep.
///
/// # Errors
/// [`OutputError`] names the first that cannot be written.
pub fn check_outputs<'a>(paths: impl IntoIterator<Item = &'a Path>, existing: Existing) -> Result<(), OutputError> {
    for path in paths {
        if existing == Existing::Keep && path.is_file() {
            return Err(OutputError::Taken(path.to_owned()));
        }
        try_out(path)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn what_is_there_stays_unless_it_may_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [old, new] = ["old.csv", "new.csv"].map(|name| folder.path().join(name));
        fs::write(&old, "old").unwrap();
        let taken = check_outputs([new.as_path(), &old], Existing::Keep).unwrap_err().to_string();
        assert!(taken.contains("old.csv is there already") && taken.contains("--force"), "{taken}");
        check_outputs([new.as_path(), &old], Existing::Replace).unwrap();
        assert_eq!(fs::read_to_string(&old).unwrap(), "old");
        assert!(!new.exists());
        #[cfg(unix)]
        check_outputs([Path::new("/dev/null")], Existing::Keep).unwrap();
        for existing in [Existing::Keep, Existing::Replace] {
            let folder = check_outputs([folder.path()], existing).unwrap_err().to_string();
            assert!(folder.contains("name a file in it"), "{folder}");
        }
    }
}

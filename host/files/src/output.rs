//! Checks of output paths before the work begins.

use std::fs;
use std::path::{Path, PathBuf};

use super::{FileError, is_stream, paths, try_out, visible};
use crate::remedies;

/// Treatment of files that already exist.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Existing {
    /// Keep them and return an error.
    Keep,
    /// Replace them.
    Replace,
}

/// Reason why a file cannot be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum OutputError {
    /// A file of this name exists.
    #[error("{} is there already", visible::path(.0))]
    Exists(PathBuf),
    /// Two results have the same path, so the second would replace the first.
    #[error("two results would be written to {}: give each a name of its own", visible::path(.0))]
    Twice(PathBuf),
    /// The file is also an input. If reading failed half-way, or less were written than read, the rest would be
    /// lost.
    #[error("{} is an input file; choose another name for the result", visible::path(.0))]
    IsInput(PathBuf),
    /// The operating system does not allow it.
    #[error("{0}")]
    Unusable(#[from] FileError),
}

remedies! { OutputError, say;
    Self::Exists(_) => "choose another name, or replace it with {}", say.force?;
}

/// Checks before the work that files can be written at all `paths`, and that none of them is one of the `inputs`. Pipes
/// and devices are exempt, because they have no content to protect.
///
/// # Errors
/// [`OutputError`] names the first path that cannot be written.
pub fn check_outputs<'a>(
    paths: impl IntoIterator<Item = &'a Path>,
    inputs: &[&Path],
    existing: Existing,
) -> Result<(), OutputError> {
    let inputs: Vec<PathBuf> = inputs.iter().filter_map(|input| fs::canonicalize(input).ok()).collect();
    let mut seen = Vec::new();
    for path in paths {
        if is_stream(path) {
            continue;
        }
        if let Some(target) = real_path(path) {
            if seen.contains(&target) {
                return Err(OutputError::Twice(path.to_owned()));
            }
            seen.push(target);
        }
        if path.is_file() && fs::canonicalize(path).is_ok_and(|target| inputs.contains(&target)) {
            return Err(OutputError::IsInput(path.to_owned()));
        }
        if existing == Existing::Keep && path.is_file() {
            return Err(OutputError::Exists(path.to_owned()));
        }
        try_out(path)?;
    }
    Ok(())
}

/// Returns the path of the file after links and folders are resolved. The file need not exist.
fn real_path(path: &Path) -> Option<PathBuf> {
    let target = paths::target(path).ok()?;
    Some(fs::canonicalize(paths::folder(&target)).ok()?.join(target.file_name()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_existing_file_is_kept_unless_it_may_be_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let [old, new] = ["old.csv", "new.csv"].map(|name| folder.path().join(name));
        fs::write(&old, "old").unwrap();
        let existing = check_outputs([new.as_path(), &old], &[], Existing::Keep).unwrap_err().to_string();
        assert!(existing.ends_with("old.csv is there already"), "{existing}");
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
    fn two_results_need_different_names() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("table.h");
        let otherwise = folder.path().join(".").join("table.h");
        for existing in [Existing::Keep, Existing::Replace] {
            let error = check_outputs([file.as_path(), &otherwise], &[], existing).unwrap_err().to_string();
            assert!(error.contains("table.h: give each a name of its own"), "{error}");
        }
        fs::write(&file, "old").unwrap();
        let error = check_outputs([otherwise.as_path(), &file], &[], Existing::Replace).unwrap_err().to_string();
        assert!(error.starts_with("two results"), "{error}");
        #[cfg(unix)]
        check_outputs([Path::new("/dev/null"), Path::new("/dev/null")], &[], Existing::Keep).unwrap();
    }

    #[test]
    fn an_input_is_never_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let recording = folder.path().join("events.csv");
        fs::write(&recording, "0,1,2,1").unwrap();
        let otherwise = folder.path().join(".").join("events.csv");
        for existing in [Existing::Keep, Existing::Replace] {
            let error = check_outputs([otherwise.as_path()], &[&recording], existing).unwrap_err().to_string();
            assert!(error.ends_with("events.csv is an input file; choose another name for the result"), "{error}");
        }
    }
}

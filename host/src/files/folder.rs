//! The folder that a program writes its results into.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::{FileError, unfinished};

/// Why results cannot go into a folder.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// It cannot be made, or no file can be written in it.
    #[error("{0}; choose another folder with -o")]
    Unusable(FileError),
    /// It holds results.
    #[error("{} is there already: choose another folder, or replace the results with --force", .0.display())]
    Taken(PathBuf),
}

/// A folder in which files can be written. When dropped it is removed again if it is empty and was made for this.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    /// Folders that were made, outermost first.
    made: Vec<PathBuf>,
}

impl OutputFolder {
    /// Makes the folder, if need be, and tries to write in it.
    ///
    /// # Errors
    /// [`FolderError::Unusable`].
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        let failed = |error: io::Error| FolderError::Unusable(FileError::new(path, error));
        if path.is_file() {
            return Err(failed(io::Error::other("is a file, and results need a folder")));
        }
        let mut made: Vec<PathBuf> = path
            .ancestors()
            .take_while(|folder| !folder.as_os_str().is_empty() && !folder.exists())
            .map(Path::to_owned)
            .collect();
        made.reverse();
        let folder = Self { path: path.to_owned(), made };
        for made in &folder.made {
            unfinished::begin(|| Ok::<_, io::Error>(((), made.clone()))).map_err(failed)?;
        }
        fs::create_dir_all(path).map_err(failed)?;
        tempfile::tempfile_in(path).map_err(failed)?;
        Ok(folder)
    }

    /// As [`OutputFolder::open`], of a folder that holds no results: no file of which `is_result` says so by its path
    /// in the folder.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn open_new(path: &Path, is_result: impl Fn(&Path) -> bool) -> Result<Self, FolderError> {
        match files(path).into_iter().find(|file| is_result(file)) {
            Some(file) => Err(FolderError::Taken(path.join(file))),
            None => Self::open(path),
        }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Replaces the files of which `is_old` says so by those that `fill` writes into the folder that it is given. The
    /// old ones go when all of the new ones are whole.
    ///
    /// # Errors
    /// [`FileError`], that of `fill` too, names the file as it would have been called; what was there stays.
    pub fn replace<T>(
        &self,
        is_old: impl Fn(&Path) -> bool,
        fill: impl FnOnce(&Path) -> Result<T, FileError>,
    ) -> Result<T, FileError> {
        let failed = |error| FileError::new(&self.path, error);
        let new = unfinished::begin(|| {
            let new = tempfile::Builder::new().prefix(".evcal.").suffix(super::UNFINISHED).tempdir_in(&self.path)?;
            let path = new.path().to_owned();
            Ok((new, path))
        })
        .map_err(failed)?;
        let filled = fill(new.path()).map_err(|error| final_place(error, new.path(), &self.path));
        // No signal ends the program between the first file and the last.
        unfinished::end(new.path(), || {
            let filled = filled?;
            self.remove_results(is_old)?;
            for file in files(new.path()) {
                let place = self.path.join(&file);
                let failed = |error| FileError::new(&place, error);
                place.parent().map_or(Ok(()), fs::create_dir_all).map_err(failed)?;
                fs::rename(new.path().join(&file), &place).map_err(failed)?;
            }
            Ok(filled)
        })
    }

    /// Removes the files of which `is_result` says that they are results, by their path in the folder.
    ///
    /// # Errors
    /// [`FileError`] names the file that cannot be removed.
    pub fn remove_results(&self, is_result: impl Fn(&Path) -> bool) -> Result<(), FileError> {
        for file in files(&self.path).into_iter().filter(|file| is_result(file)) {
            let file = self.path.join(file);
            fs::remove_file(&file).map_err(|error| FileError::new(&file, error))?;
        }
        Ok(())
    }
}

/// The path in `folder` of a file in the folder that is renamed to it.
fn final_place(error: FileError, from: &Path, folder: &Path) -> FileError {
    match error.path.strip_prefix(from) {
        Ok(rest) => FileError { path: folder.join(rest), ..error },
        Err(_) => error,
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        for folder in &self.made {
            unfinished::end(folder, || ());
        }
        for folder in self.made.iter().rev() {
            // One that holds something stays.
            if fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
}

/// How many folders deep results may be.
const DEPTH: usize = 2;

/// The files in `folder` and in its folders, down to [`DEPTH`], in the order of their names.
fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    add_files(folder, DEPTH, &mut found);
    found.iter().filter_map(|path| path.strip_prefix(folder).ok()).map(Path::to_owned).collect()
}

fn add_files(folder: &Path, depth: usize, found: &mut Vec<PathBuf>) {
    let mut paths: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        if !path.is_dir() {
            found.push(path);
        } else if depth > 0 {
            add_files(&path, depth - 1, found);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_folder_goes_again_and_a_filled_one_stays() {
        let parent = tempfile::tempdir().unwrap();
        let (outer, inner) = (parent.path().join("a"), parent.path().join("a/b"));
        drop(OutputFolder::open(&inner).unwrap());
        assert!(!outer.exists());
        let folder = OutputFolder::open(&inner).unwrap();
        fs::write(inner.join("camera.yaml"), b"").unwrap();
        drop(folder);
        assert!(inner.join("camera.yaml").exists());
        fs::remove_file(inner.join("camera.yaml")).unwrap();
        // It was there before.
        drop(OutputFolder::open(&inner).unwrap());
        assert!(inner.exists());
    }

    #[test]
    fn results_are_found_and_removed_and_nothing_else_is() {
        let folder = tempfile::tempdir().unwrap();
        let is_result = |path: &Path| path == Path::new("a.json") || path.starts_with("exports");
        drop(OutputFolder::open_new(folder.path(), is_result).unwrap());
        fs::create_dir(folder.path().join("exports")).unwrap();
        for name in ["a.json", "exports/b.yaml", "mine.txt"] {
            fs::write(folder.path().join(name), b"").unwrap();
        }
        let taken = OutputFolder::open_new(folder.path(), is_result).unwrap_err().to_string();
        assert!(taken.contains("a.json") && taken.contains("--force"), "{taken}");
        let open = OutputFolder::open(folder.path()).unwrap();
        open.remove_results(is_result).unwrap();
        assert_eq!(files(folder.path()), [PathBuf::from("mine.txt")]);
    }

    #[test]
    fn old_results_stay_until_the_new_ones_are_whole() {
        let folder = tempfile::tempdir().unwrap();
        let is_result = |path: &Path| path == Path::new("a.json") || path.starts_with("exports");
        let put = |path: PathBuf, text: &str| fs::write(path, text).unwrap();
        put(folder.path().join("a.json"), "old");
        put(folder.path().join("mine.txt"), "mine");
        let open = OutputFolder::open(folder.path()).unwrap();
        let full = open.replace(is_result, |new| {
            put(new.join("a.json"), "new");
            Err::<(), _>(FileError::new(&new.join("b.png"), io::ErrorKind::StorageFull.into()))
        });
        let error = full.unwrap_err();
        assert_eq!(error.path, folder.path().join("b.png"));
        assert_eq!(files(folder.path()), [PathBuf::from("a.json"), PathBuf::from("mine.txt")]);
        assert_eq!(fs::read_to_string(folder.path().join("a.json")).unwrap(), "old");
        let whole = open.replace(is_result, |new| {
            fs::create_dir(new.join("exports")).unwrap();
            put(new.join("exports/b.yaml"), "new");
            Ok(7)
        });
        assert_eq!(whole.unwrap(), 7);
        assert_eq!(files(folder.path()), [PathBuf::from("exports/b.yaml"), PathBuf::from("mine.txt")]);
        assert!(fs::read_dir(folder.path()).unwrap().count() == 2);
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        for path in ["/proc/evcal", "/dev/null/evcal"] {
            let error = OutputFolder::open(Path::new(path)).unwrap_err().to_string();
            assert!(error.contains(path) && error.contains("-o"), "{error}");
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = OutputFolder::open(file.path()).unwrap_err().to_string();
        assert!(error.contains("is a file") && error.contains("-o"), "{error}");
    }
}

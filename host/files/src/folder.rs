//! The folder into which a program writes its results.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::exchange::exchange;
#[cfg(target_os = "linux")]
use super::swap::swap;
use super::unfinished::Begun;
use super::{FileError, paths, remove_scratch, scratch_in, unfinished, visible};
use crate::remedies;

/// Reason why results cannot be written to a folder.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// The folder cannot be created, or no file can be written in it.
    #[error("{0}")]
    Unusable(#[source] FileError),
    /// The folder already contains results.
    #[error("{} is there already", visible::path(.0))]
    Exists(PathBuf),
    /// Another run of the program is writing results into the folder.
    #[error("another run of this program is writing its results into {}", visible::path(.0))]
    Busy(PathBuf),
    /// The name of a result is in use.
    #[error("{0}")]
    Blocked(#[from] Blocked),
}

remedies! { FolderError, say;
    Self::Exists(_) => "choose another folder, or replace the results with {}", say.force?;
    Self::Busy(_) => "wait until it ends, or choose another folder with {}", say.output?;
    Self::Unusable(_) | Self::Blocked(_) => "choose another folder with {}", say.output?;
}

/// File or folder that occupies the name of a result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Blocked {
    /// A folder has the name of a file.
    #[error("{} is a folder, but a result needs its name: move it away", visible::path(.0))]
    Folder(PathBuf),
    /// A file has the name of a folder.
    #[error("{} is not a folder, but results need a folder of this name: move it away", visible::path(.0))]
    NoFolder(PathBuf),
}

impl Blocked {
    /// Converts to an error about the file that is in the way.
    fn into_file_error(self) -> FileError {
        let (path, kind, what) = match self {
            Self::Folder(path) => (path, io::ErrorKind::AlreadyExists, "is a folder, but a result needs its name"),
            Self::NoFolder(path) => (path, io::ErrorKind::NotADirectory, "is not a folder, but results need one there"),
        };
        FileError { path, error: io::Error::new(kind, format!("{what}: move it away")) }
    }
}

/// An error that may contain the path of a file.
pub trait NamesFile: From<FileError> {
    /// Path of the file, if the error is about one.
    fn file_mut(&mut self) -> Option<&mut PathBuf>;
}

impl NamesFile for FileError {
    fn file_mut(&mut self) -> Option<&mut PathBuf> {
        Some(&mut self.path)
    }
}

/// A writable folder. When dropped, it is removed if it is empty and was created by [`OutputFolder::open`].
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    /// Folders that were created, outermost first.
    made: Vec<PathBuf>,
    /// The open folder, locked against other runs; `None` if the system cannot open folders.
    locked: Mutex<Option<File>>,
}

impl OutputFolder {
    /// Creates the folder if needed, and checks that files can be written in it. While it is open, no other run can
    /// open it.
    ///
    /// # Errors
    /// [`FolderError::Unusable`], [`FolderError::Busy`].
    pub fn open(path: &Path) -> Result<Self, FolderError> {
        let failed = |error: io::Error| FolderError::Unusable(FileError::new(path, error));
        if path.is_file() {
            return Err(failed(io::Error::other("is a file, but results need a folder")));
        }
        let mut made: Vec<PathBuf> = path
            .ancestors()
            .take_while(|folder| !folder.as_os_str().is_empty() && !folder.exists())
            .map(Path::to_owned)
            .collect();
        made.reverse();
        let folder = Self { path: path.to_owned(), made, locked: Mutex::default() };
        for made in &folder.made {
            unfinished::begin(Begun::UsersFolder, || Ok::<_, io::Error>(((), made.clone()))).map_err(failed)?;
        }
        fs::create_dir_all(path).map_err(failed)?;
        if let Ok(open) = File::open(path) {
            if !paths::try_lock(&open).map_err(failed)? {
                return Err(FolderError::Busy(path.to_owned()));
            }
            folder.keep(open);
        }
        tempfile::tempfile_in(path).map_err(failed)?;
        Ok(folder)
    }

    /// Opens a folder as [`OutputFolder::open`] does, but fails if it already contains results. `is_result` receives
    /// the path of a file in the folder.
    ///
    /// # Errors
    /// [`FolderError`].
    pub fn open_new(path: &Path, is_result: impl Fn(&Path) -> bool) -> Result<Self, FolderError> {
        match files(path).into_iter().find(|file| is_result(file)) {
            Some(file) => Err(FolderError::Exists(path.join(file))),
            None => Self::open(path),
        }
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Checks, before the work begins, that the names of the results are free: no folder has the name of a result
    /// (according to `is_result`, which receives paths in the folder), and each name in `folders` is a folder or
    /// unused.
    ///
    /// # Errors
    /// [`FolderError::Blocked`].
    pub fn check_paths(&self, is_result: impl Fn(&Path) -> bool, folders: &[&str]) -> Result<(), FolderError> {
        folders.iter().try_for_each(|folder| check_is_folder(&self.path.join(folder)))?;
        match entries(&self.path).folders.into_iter().find(|folder| is_result(folder)) {
            Some(folder) => Err(Blocked::Folder(self.path.join(folder)).into()),
            None => Ok(()),
        }
    }

    /// Checks that these files can be moved into the folder.
    fn check_files(&self, files: &[PathBuf]) -> Result<(), Blocked> {
        for file in files {
            let path = self.path.join(file);
            if path.is_dir() {
                return Err(Blocked::Folder(path));
            }
            let parents = file.ancestors().skip(1).filter(|parent| !parent.as_os_str().is_empty());
            parents.map(|parent| self.path.join(parent)).try_for_each(|parent| check_is_folder(&parent))?;
        }
        Ok(())
    }

    /// Replaces old files (according to `is_old`) by the files that `fill` writes into a temporary folder. The old
    /// files are removed once all new ones are complete and in place.
    ///
    /// # Errors
    /// The error of `fill`, or of a file that cannot be moved. It names the file by its final path, and the old
    /// files stay.
    pub fn replace<T, E: NamesFile>(
        &self,
        is_old: impl Fn(&Path) -> bool,
        fill: impl FnOnce(&Path) -> Result<T, E>,
    ) -> Result<T, E> {
        remove_scratch(&self.path);
        let new = unfinished::begin(Begun::ScratchFolder, || {
            let new = scratch_in(&self.path)?;
            let path = new.path().to_owned();
            Ok((new, path))
        })
        .map_err(|error| FileError::new(&self.path, error))?;
        let filled = fill(new.path()).map_err(|error| final_path(error, new.path(), &self.path));
        let path = new.path().to_owned();
        // From here on no signal ends the program until all files are moved and leftovers removed.
        let replaced: Result<T, E> = unfinished::end(&path, move || {
            let filled = filled?;
            let old: Vec<PathBuf> = files(&self.path).into_iter().filter(|file| is_old(file)).collect();
            let files = files(new.path());
            self.check_files(&files).map_err(Blocked::into_file_error)?;
            #[cfg(target_os = "linux")]
            if let Some(locked) = swap(&self.path, &old, new.path()) {
                self.keep(locked);
                return Ok(filled);
            }
            exchange(&self.path, &old, new.path(), &files)?;
            Ok(filled)
        });
        if replaced.is_ok() {
            self.keep_made_folders();
        }
        replaced
    }

    /// Stores the handle of the open folder, so that the folder stays locked.
    fn keep(&self, open: File) {
        *self.locked.lock().unwrap_or_else(PoisonError::into_inner) = Some(open);
    }

    /// Keeps the created folders when a signal ends the program.
    fn keep_made_folders(&self) {
        for folder in &self.made {
            unfinished::end(folder, || ());
        }
    }
}

/// Replaces the temporary path of a file in an error by its final path.
fn final_path<E: NamesFile>(mut error: E, from: &Path, folder: &Path) -> E {
    if let Some(file) = error.file_mut()
        && let Ok(rest) = file.strip_prefix(from)
    {
        *file = folder.join(rest);
    }
    error
}

/// Checks that `path` does not exist or is a folder (or a link to one).
fn check_is_folder(path: &Path) -> Result<(), Blocked> {
    match path.symlink_metadata().is_ok() && !path.is_dir() {
        true => Err(Blocked::NoFolder(path.to_owned())),
        false => Ok(()),
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        self.keep_made_folders();
        for folder in self.made.iter().rev() {
            // A folder with content stays.
            if fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
}

/// Depth of subfolders that may contain results.
const DEPTH: usize = 2;

/// Files and folders within a folder, down to [`DEPTH`], by their relative paths, sorted by name.
#[derive(Default)]
struct Entries {
    files: Vec<PathBuf>,
    folders: Vec<PathBuf>,
}

fn files(folder: &Path) -> Vec<PathBuf> {
    entries(folder).files
}

fn entries(folder: &Path) -> Entries {
    let mut found = Entries::default();
    add_entries(folder, DEPTH, &mut found);
    let inner = |paths: Vec<PathBuf>| {
        paths.iter().filter_map(|path| path.strip_prefix(folder).ok()).map(Path::to_owned).collect()
    };
    Entries { files: inner(found.files), folders: inner(found.folders) }
}

fn add_entries(folder: &Path, depth: usize, found: &mut Entries) {
    let mut paths: Vec<PathBuf> =
        fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect();
    paths.sort();
    for path in paths {
        if !path.is_dir() {
            found.files.push(path);
            continue;
        }
        if depth > 0 {
            add_entries(&path, depth - 1, found);
        }
        found.folders.push(path);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_folder_is_removed_and_a_filled_one_stays() {
        let parent = tempfile::tempdir().unwrap();
        let (outer, inner) = (parent.path().join("a"), parent.path().join("a/b"));
        drop(OutputFolder::open(&inner).unwrap());
        assert!(!outer.exists());
        let folder = OutputFolder::open(&inner).unwrap();
        fs::write(inner.join("camera.yaml"), b"").unwrap();
        drop(folder);
        assert!(inner.join("camera.yaml").exists());
        fs::remove_file(inner.join("camera.yaml")).unwrap();
        // It existed before.
        drop(OutputFolder::open(&inner).unwrap());
        assert!(inner.exists());
    }

    #[test]
    fn only_results_are_found_and_removed() {
        let folder = tempfile::tempdir().unwrap();
        let is_result = |path: &Path| path == Path::new("a.json") || path.starts_with("exports");
        drop(OutputFolder::open_new(folder.path(), is_result).unwrap());
        fs::create_dir(folder.path().join("exports")).unwrap();
        for name in ["a.json", "exports/b.yaml", "mine.txt"] {
            fs::write(folder.path().join(name), b"").unwrap();
        }
        let existing = OutputFolder::open_new(folder.path(), is_result).unwrap_err().to_string();
        assert!(existing.contains("a.json is there already"), "{existing}");
        let open = OutputFolder::open(folder.path()).unwrap();
        open.replace(is_result, |_| Ok::<_, FileError>(())).unwrap();
        assert_eq!(files(folder.path()), [PathBuf::from("mine.txt")]);
    }

    #[test]
    fn old_results_stay_until_the_new_ones_are_complete() {
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
            Ok::<_, FileError>(7)
        });
        assert_eq!(whole.unwrap(), 7);
        assert_eq!(files(folder.path()), [PathBuf::from("exports/b.yaml"), PathBuf::from("mine.txt")]);
        assert!(fs::read_dir(folder.path()).unwrap().count() == 2);
    }

    #[test]
    fn a_file_in_the_way_of_a_result_is_named_and_nothing_is_lost() {
        let is_result = |path: &Path| path == Path::new("a.json") || path.parent() == Some(Path::new("exports"));
        for (wrong, is_folder) in [("a.json", true), ("exports", false)] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(wrong);
            match is_folder {
                true => fs::create_dir(&path).unwrap(),
                false => fs::write(&path, "mine").unwrap(),
            }
            let old = if is_folder { "exports/b.yaml" } else { "a.json" };
            fs::create_dir_all(folder.path().join(old).parent().unwrap()).unwrap();
            fs::write(folder.path().join(old), "old").unwrap();
            let open = OutputFolder::open(folder.path()).unwrap();
            let error = open.check_paths(is_result, &["exports"]).unwrap_err().to_string();
            assert!(error.contains(path.to_str().unwrap()) && error.contains("move it away"), "{error}");
            let error = open.replace(is_result, |new| {
                fs::create_dir(new.join("exports")).unwrap();
                fs::write(new.join("exports/b.yaml"), "new").unwrap();
                fs::write(new.join("a.json"), "new").unwrap();
                Ok::<_, FileError>(())
            });
            assert_eq!(error.unwrap_err().path, path);
            assert_eq!(fs::read_to_string(folder.path().join(old)).unwrap(), "old");
            assert_eq!(path.is_dir(), is_folder);
            assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        }
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        for path in ["/proc/evcal", "/dev/null/evcal"] {
            let error = OutputFolder::open(Path::new(path)).unwrap_err().to_string();
            assert!(error.contains(path), "{error}");
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        let error = OutputFolder::open(file.path()).unwrap_err().to_string();
        assert!(error.contains("is a file"), "{error}");
    }
    /// A second run into the same folder would replace the results of the first.
    #[test]
    fn a_folder_cannot_be_opened_by_two_runs() {
        let folder = tempfile::tempdir().unwrap();
        let open = OutputFolder::open(folder.path()).unwrap();
        let error = OutputFolder::open(folder.path()).unwrap_err().to_string();
        assert!(error.contains("another run of this program"), "{error}");
        drop(open);
        // A killed run leaves such a folder.
        fs::create_dir(folder.path().join(".evcal.x1y2.part")).unwrap();
        fs::write(folder.path().join(".evcal.x1y2.part/a.json"), "half").unwrap();
        let open = OutputFolder::open(folder.path()).unwrap();
        let fill = |new: &Path| {
            fs::write(new.join("b.json"), "whole").unwrap();
            Ok::<_, FileError>(())
        };
        open.replace(|_| false, fill).unwrap();
        assert_eq!(files(folder.path()), [PathBuf::from("b.json")]);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }
}

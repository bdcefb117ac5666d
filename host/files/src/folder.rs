//! The folder that a program writes its results into.

use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use super::exchange::exchange;
#[cfg(target_os = "linux")]
use super::swap::swap;
use super::unfinished::Begun;
use super::{FileError, place, remove_scratch, scratch_in, unfinished, visible};

/// Why results cannot go into a folder.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FolderError {
    /// It cannot be made, or no file can be written in it.
    #[error("{0}")]
    Unusable(#[source] FileError),
    /// It holds results.
    #[error("{} is there already", visible::path(.0))]
    Taken(PathBuf),
    /// Another program writes results into it.
    #[error("another run of this program writes its results into {}", visible::path(.0))]
    Busy(PathBuf),
    /// A result cannot have its name.
    #[error("{0}")]
    Blocked(#[from] Blocked),
}

/// What no result can take the place of.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Blocked {
    /// A folder where a file belongs.
    #[error("{} is a folder, and a result needs its name: move it away", visible::path(.0))]
    Folder(PathBuf),
    /// A file where a folder belongs.
    #[error("{} is no folder, and results need a folder of this name: move it away", visible::path(.0))]
    NoFolder(PathBuf),
}

impl Blocked {
    /// As an error of the file that is in the way.
    fn into_file_error(self) -> FileError {
        let (path, kind, what) = match self {
            Self::Folder(path) => (path, io::ErrorKind::AlreadyExists, "is a folder, and a result needs its name"),
            Self::NoFolder(path) => (path, io::ErrorKind::NotADirectory, "is no folder, and results need one there"),
        };
        FileError { path, error: io::Error::new(kind, format!("{what}: move it away")) }
    }
}

/// An error that names a file.
pub trait NamesFile: From<FileError> {
    /// The file.
    fn file_mut(&mut self) -> &mut PathBuf;
}

impl NamesFile for FileError {
    fn file_mut(&mut self) -> &mut PathBuf {
        &mut self.path
    }
}

/// A folder in which files can be written. When dropped it is removed again if it is empty and was made for this.
#[derive(Debug)]
pub struct OutputFolder {
    path: PathBuf,
    /// Folders that were made, outermost first.
    made: Vec<PathBuf>,
    /// The open folder, which is held against other runs; `None` where a system cannot open folders.
    held: Mutex<Option<File>>,
}

impl OutputFolder {
    /// Makes the folder, if need be, and tries to write in it. As long as it is open, no other run can open it.
    ///
    /// # Errors
    /// [`FolderError::Unusable`], [`FolderError::Busy`].
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
        let folder = Self { path: path.to_owned(), made, held: Mutex::default() };
        for made in &folder.made {
            unfinished::begin(Begun::UsersFolder, || Ok::<_, io::Error>(((), made.clone()))).map_err(failed)?;
        }
        fs::create_dir_all(path).map_err(failed)?;
        if let Ok(open) = File::open(path) {
            if !place::hold(&open).map_err(failed)? {
                return Err(FolderError::Busy(path.to_owned()));
            }
            folder.keep(open);
        }
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

    /// Whether results can have their names, told before the work and not after it: no folder has the name of a file
    /// of which `is_result` says so by its path in the folder, and what is called as one of `folders` is a folder.
    ///
    /// # Errors
    /// [`FolderError::Blocked`].
    pub fn check_places(&self, is_result: impl Fn(&Path) -> bool, folders: &[&str]) -> Result<(), FolderError> {
        folders.iter().try_for_each(|folder| check_is_folder(&self.path.join(folder)))?;
        match entries(&self.path).folders.into_iter().find(|folder| is_result(folder)) {
            Some(folder) => Err(Blocked::Folder(self.path.join(folder)).into()),
            None => Ok(()),
        }
    }

    /// Whether these files can be put into the folder.
    fn check_files(&self, files: &[PathBuf]) -> Result<(), Blocked> {
        for file in files {
            let place = self.path.join(file);
            if place.is_dir() {
                return Err(Blocked::Folder(place));
            }
            let parents = file.ancestors().skip(1).filter(|parent| !parent.as_os_str().is_empty());
            parents.map(|parent| self.path.join(parent)).try_for_each(|parent| check_is_folder(&parent))?;
        }
        Ok(())
    }

    /// Replaces the files of which `is_old` says so by those that `fill` writes into the folder that it is given. The
    /// old ones go when all of the new ones are whole and in their places.
    ///
    /// # Errors
    /// That of `fill` or of a file that cannot be put in its place. It names the file as it would have been called; what
    /// was there stays.
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
        let filled = fill(new.path()).map_err(|error| final_place(error, new.path(), &self.path));
        let path = new.path().to_owned();
        // No signal ends the program between the first file and the last, nor before what is left is removed.
        let replaced: Result<T, E> = unfinished::end(&path, move || {
            let filled = filled?;
            let old: Vec<PathBuf> = files(&self.path).into_iter().filter(|file| is_old(file)).collect();
            let files = files(new.path());
            self.check_files(&files).map_err(Blocked::into_file_error)?;
            #[cfg(target_os = "linux")]
            if let Some(held) = swap(&self.path, &old, new.path()) {
                self.keep(held);
                return Ok(filled);
            }
            exchange(&self.path, &old, new.path(), &files)?;
            Ok(filled)
        });
        if replaced.is_ok() {
            self.hold();
        }
        replaced
    }

    /// Holds the open folder from now on.
    fn keep(&self, open: File) {
        *self.held.lock().unwrap_or_else(PoisonError::into_inner) = Some(open);
    }

    /// From now on no signal removes a folder that was made.
    fn hold(&self) {
        for folder in &self.made {
            unfinished::end(folder, || ());
        }
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
fn final_place<E: NamesFile>(mut error: E, from: &Path, folder: &Path) -> E {
    let file = error.file_mut();
    if let Ok(rest) = file.strip_prefix(from) {
        *file = folder.join(rest);
    }
    error
}

/// What is there must be a folder, or lead to one.
fn check_is_folder(path: &Path) -> Result<(), Blocked> {
    match path.symlink_metadata().is_ok() && !path.is_dir() {
        true => Err(Blocked::NoFolder(path.to_owned())),
        false => Ok(()),
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        self.hold();
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

/// What is in a folder and in its folders, down to [`DEPTH`], by its path in it, in the order of the names.
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
        assert!(taken.contains("a.json is there already"), "{taken}");
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
            Ok::<_, FileError>(7)
        });
        assert_eq!(whole.unwrap(), 7);
        assert_eq!(files(folder.path()), [PathBuf::from("exports/b.yaml"), PathBuf::from("mine.txt")]);
        assert!(fs::read_dir(folder.path()).unwrap().count() == 2);
    }

    #[test]
    fn what_is_in_the_way_of_a_result_is_told_and_nothing_is_lost() {
        let is_result = |path: &Path| path == Path::new("a.json") || path.parent() == Some(Path::new("exports"));
        for (wrong, is_folder) in [("a.json", true), ("exports", false)] {
            let folder = tempfile::tempdir().unwrap();
            let place = folder.path().join(wrong);
            match is_folder {
                true => fs::create_dir(&place).unwrap(),
                false => fs::write(&place, "mine").unwrap(),
            }
            let old = if is_folder { "exports/b.yaml" } else { "a.json" };
            fs::create_dir_all(folder.path().join(old).parent().unwrap()).unwrap();
            fs::write(folder.path().join(old), "old").unwrap();
            let open = OutputFolder::open(folder.path()).unwrap();
            let told = open.check_places(is_result, &["exports"]).unwrap_err().to_string();
            assert!(told.contains(place.to_str().unwrap()) && told.contains("move it away"), "{told}");
            let error = open.replace(is_result, |new| {
                fs::create_dir(new.join("exports")).unwrap();
                fs::write(new.join("exports/b.yaml"), "new").unwrap();
                fs::write(new.join("a.json"), "new").unwrap();
                Ok::<_, FileError>(())
            });
            assert_eq!(error.unwrap_err().path, place);
            assert_eq!(fs::read_to_string(folder.path().join(old)).unwrap(), "old");
            assert_eq!(place.is_dir(), is_folder);
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
    /// Two runs into one folder both ended well, and the second replaced the results of the first.
    #[test]
    fn a_folder_is_open_once() {
        let folder = tempfile::tempdir().unwrap();
        let open = OutputFolder::open(folder.path()).unwrap();
        let error = OutputFolder::open(folder.path()).unwrap_err().to_string();
        assert!(error.contains("another run of this program"), "{error}");
        drop(open);
        // A killed run left this.
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

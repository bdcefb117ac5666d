//! List of unfinished files and folders, which are removed if a signal ends the program.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf, absolute};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Kind of an unfinished file or folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Begun {
    /// A temporary file of the program.
    ScratchFile,
    /// A temporary folder of the program, which is removed with its content.
    ScratchFolder,
    /// A folder that the user named and the program created. It is removed only if it is empty.
    UsersFolder,
}

/// Absolute paths, so that a folder is sorted before its content.
type List = BTreeMap<PathBuf, Begun>;

static UNFINISHED: Mutex<List> = Mutex::new(List::new());

fn list() -> MutexGuard<'static, List> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the key of `path` in the list. If there is no working directory, all paths are absolute already.
fn name(path: &Path) -> PathBuf {
    absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Creates a file or folder with `make`, and adds the returned path to the list.
pub(super) fn begin<T, E>(begun: Begun, make: impl FnOnce() -> Result<(T, PathBuf), E>) -> Result<T, E> {
    let mut list = list();
    let (made, path) = make()?;
    list.insert(name(&path), begun);
    Ok(made)
}

/// Removes `path` from the list and calls `finish`, without interruption by [`remove_all`].
pub(super) fn end<T>(path: &Path, finish: impl FnOnce() -> T) -> T {
    end_all([path], finish)
}

/// Removes `paths` from the list and calls `finish`, without interruption by [`remove_all`].
pub(super) fn end_all<'a, T>(paths: impl IntoIterator<Item = &'a Path>, finish: impl FnOnce() -> T) -> T {
    let mut list = list();
    for path in paths {
        list.remove(&name(path));
    }
    finish()
}

/// Entry in the list. Dropping it removes the entry.
#[derive(Debug)]
pub(super) struct Listed(PathBuf);

impl Listed {
    /// Refers to the entry of `path`.
    pub(super) fn new(path: &Path) -> Self {
        Self(path.to_owned())
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        end(&self.0, || ());
    }
}

/// While this value exists, nothing can be added to the list or finished.
pub struct Stopped {
    _list: MutexGuard<'static, List>,
}

/// Removes all unfinished files and folders.
pub fn remove_all() -> Stopped {
    let mut list = list();
    let (folders, scratch): (Vec<_>, Vec<_>) =
        std::mem::take(&mut *list).into_iter().rev().partition(|(_, begun)| *begun == Begun::UsersFolder);
    // The content of a folder is removed before the folder.
    for (path, begun) in scratch.into_iter().chain(folders) {
        let _ = match begun {
            Begun::ScratchFile => fs::remove_file(&path),
            // The second attempt also removes files that were created during the first.
            Begun::ScratchFolder => fs::remove_dir_all(&path).or_else(|_| fs::remove_dir_all(&path)),
            Begun::UsersFolder => fs::remove_dir(&path),
        };
    }
    Stopped { _list: list }
}

//! What is begun and not whole yet, to be removed when the program is ended by a signal.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf, absolute};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Whose something that is not whole is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Begun {
    /// A file of the program's own, with a name of its own.
    ScratchFile,
    /// A folder of the program's own, with a name of its own: all that is in it goes.
    ScratchFolder,
    /// A folder that the user named and that was made: it stays if something is in it.
    UsersFolder,
}

/// By absolute paths, so that of two folders the inner one is sorted after the outer one.
type List = BTreeMap<PathBuf, Begun>;

static UNFINISHED: Mutex<List> = Mutex::new(List::new());

fn list() -> MutexGuard<'static, List> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The name of `path` in the list; without a folder to work in there are only absolute paths.
fn name(path: &Path) -> PathBuf {
    absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Begins something at the path that `make` tells.
pub(super) fn begin<T, E>(begun: Begun, make: impl FnOnce() -> Result<(T, PathBuf), E>) -> Result<T, E> {
    let mut list = list();
    let (made, path) = make()?;
    list.insert(name(&path), begun);
    Ok(made)
}

/// Ends with `finish` what was begun at `path`.
pub(super) fn end<T>(path: &Path, finish: impl FnOnce() -> T) -> T {
    let mut list = list();
    list.remove(&name(path));
    finish()
}

/// An entry of the list, which goes when it is dropped.
#[derive(Debug)]
pub(super) struct Listed(PathBuf);

impl Listed {
    /// Of what was begun at `path`.
    pub(super) fn new(path: &Path) -> Self {
        Self(path.to_owned())
    }
}

impl Drop for Listed {
    fn drop(&mut self) {
        end(&self.0, || ());
    }
}

/// As long as it is held, nothing is begun or finished.
pub struct Stopped {
    _list: MutexGuard<'static, List>,
}

/// Removes all that is not whole.
pub fn remove_all() -> Stopped {
    let mut list = list();
    let (folders, scratch): (Vec<_>, Vec<_>) =
        std::mem::take(&mut *list).into_iter().rev().partition(|(_, begun)| *begun == Begun::UsersFolder);
    // What is in a folder goes before it.
    for (path, begun) in scratch.into_iter().chain(folders) {
        let _ = match begun {
            Begun::ScratchFile => fs::remove_file(&path),
            // A file that is made meanwhile is met by the second try.
            Begun::ScratchFolder => fs::remove_dir_all(&path).or_else(|_| fs::remove_dir_all(&path)),
            Begun::UsersFolder => fs::remove_dir(&path),
        };
    }
    Stopped { _list: list }
}

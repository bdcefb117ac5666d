//! What is begun and not whole yet, to be removed when the program is ended by a signal.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Files and folders; of two folders the inner one is sorted after the outer one.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn list() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Begins something at the path that `make` tells.
pub(super) fn begin<T, E>(make: impl FnOnce() -> Result<(T, PathBuf), E>) -> Result<T, E> {
    let mut list = list();
    let (made, path) = make()?;
    list.insert(path);
    Ok(made)
}

/// Ends with `finish` what was begun at `path`.
pub(super) fn end<T>(path: &Path, finish: impl FnOnce() -> T) -> T {
    let mut list = list();
    list.remove(path);
    finish()
}

/// Removes all that is not whole; a folder stays if something else is in it. As long as what is
/// returned is held, nothing is begun or finished.
pub fn remove_all() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    let mut list = list();
    for path in std::mem::take(&mut *list).into_iter().rev() {
        let is_ours = path.extension().is_some_and(|one| one == "part");
        let _ = match path.is_dir() {
            true if is_ours => fs::remove_dir_all(&path),
            true => fs::remove_dir(&path),
            false => fs::remove_file(&path),
        };
    }
    list
}

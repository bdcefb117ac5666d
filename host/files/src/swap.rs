//! Atomic replacement of a folder by another one. Readers see either the old results or the new ones, even if the
//! program is killed.

use std::env;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::paths;

/// Largest number of other files of a folder that are carried over.
const MOST_OTHERS: usize = 10_000;

/// Replaces `folder` by the folder `new` inside it. Files of `folder` that are not in `old` (by their relative paths)
/// are carried over. Returns the new folder, open and locked. Returns `None`, with everything unchanged, if the system
/// or the disk does not support the exchange, or if the working directory of this process is in the folder.
pub(super) fn swap(folder: &Path, old: &[PathBuf], new: &Path) -> Option<File> {
    let folder = fs::canonicalize(folder).ok()?;
    let new = fs::canonicalize(new).ok()?;
    // The working directory would still be the old folder after the exchange.
    if env::current_dir().is_ok_and(|current| current.starts_with(&folder)) {
        return None;
    }
    let temporary = paths::unfinished(&folder);
    // It may be left from a killed run.
    let _ = fs::remove_dir_all(&temporary);
    let mut others = Vec::new();
    list(&folder, Path::new(""), &|path| folder.join(path) == new || old.iter().any(|old| old == path), &mut others)
        .ok()?;
    fs::rename(&new, &temporary).ok()?;
    let mut carried = Vec::new();
    match carry(&folder, &others, &temporary, &mut carried).and_then(|()| exchange(&folder, &temporary)) {
        Ok(locked) => {
            move_late_files(&temporary, old, &folder);
            let _ = fs::remove_dir_all(&temporary);
            Some(locked)
        }
        Err(_) => {
            for path in carried.iter().rev() {
                let _ = if path.is_dir() { fs::remove_dir(path) } else { fs::remove_file(path) };
            }
            let _ = fs::rename(&temporary, &new);
            None
        }
    }
}

/// A file or folder, with its path relative to the folder that was listed.
struct Entry {
    path: PathBuf,
    is_folder: bool,
}

/// Lists everything in `folder` below `inner`, except what `is_left_out` selects. A folder precedes its content.
fn list(folder: &Path, inner: &Path, is_left_out: &dyn Fn(&Path) -> bool, found: &mut Vec<Entry>) -> io::Result<()> {
    for entry in fs::read_dir(folder.join(inner))? {
        let entry = entry?;
        let path = inner.join(entry.file_name());
        if is_left_out(&path) {
            continue;
        }
        let is_folder = entry.file_type()?.is_dir();
        found.push(Entry { path: path.clone(), is_folder });
        if found.len() > MOST_OTHERS {
            return Err(io::ErrorKind::FileTooLarge.into());
        }
        if is_folder {
            list(folder, &path, is_left_out, found)?;
        }
    }
    Ok(())
}

/// Hard-links each of `others` into `temporary`, unless it already has an entry of that path. `carried` receives the
/// new entries.
fn carry(folder: &Path, others: &[Entry], temporary: &Path, carried: &mut Vec<PathBuf>) -> io::Result<()> {
    for Entry { path, is_folder } in others {
        let (from, to) = (folder.join(path), temporary.join(path));
        if to.symlink_metadata().is_ok() {
            continue;
        }
        if *is_folder {
            fs::create_dir(&to)?;
            fs::set_permissions(&to, fs::metadata(&from)?.permissions())?;
        } else {
            fs::hard_link(&from, &to)?;
        }
        carried.push(to);
    }
    fs::set_permissions(temporary, fs::metadata(folder)?.permissions())
}

/// Flushes `temporary` to the disk and exchanges it with `folder`. Returns the folder that is then at `folder`, open
/// and locked.
fn exchange(folder: &Path, temporary: &Path) -> io::Result<File> {
    let locked = File::open(temporary)?;
    paths::try_lock(&locked)?;
    locked.sync_all()?;
    rustix::fs::renameat_with(rustix::fs::CWD, temporary, rustix::fs::CWD, folder, rustix::fs::RenameFlags::EXCHANGE)?;
    // Flushes the exchange itself, if the file system supports it.
    let _ = File::open(paths::folder(folder)).and_then(|parent| parent.sync_all());
    Ok(locked)
}

/// Moves files that were created in the old folder in the meantime from `temporary`, where it is now, to the new
/// folder.
fn move_late_files(temporary: &Path, old: &[PathBuf], folder: &Path) {
    let mut others = Vec::new();
    let _ = list(temporary, Path::new(""), &|path| old.iter().any(|old| old == path), &mut others);
    for Entry { path, .. } in others {
        let to = folder.join(&path);
        if to.symlink_metadata().is_err() {
            let _ = fs::rename(temporary.join(&path), to);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(path: PathBuf, text: &str) {
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    /// Returns every file with its text, and every folder with an empty text.
    fn content(folder: &Path) -> Vec<(String, String)> {
        let mut entries = Vec::new();
        list(folder, Path::new(""), &|_| false, &mut entries).unwrap();
        let text = |entry: &Entry| fs::read_to_string(folder.join(&entry.path)).unwrap_or_default();
        let mut content: Vec<_> =
            entries.iter().map(|entry| (entry.path.to_str().unwrap().to_owned(), text(entry))).collect();
        content.sort();
        content
    }

    fn owned(content: &[(&str, &str)]) -> Vec<(String, String)> {
        content.iter().map(|(name, text)| ((*name).to_owned(), (*text).to_owned())).collect()
    }

    #[test]
    fn new_results_and_all_other_files_are_in_the_new_folder() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("results");
        let others = [("mine.txt", "mine"), ("exports/mine.yaml", "mine"), ("raw/deep/er/still/a.dvraw", "recording")];
        for (name, text) in others.into_iter().chain([("a.json", "old"), ("exports/b.yaml", "old"), ("c.txt", "old")]) {
            write(folder.join(name), text);
        }
        fs::create_dir(folder.join("empty")).unwrap();
        let new = folder.join(".evcal.1.part");
        for name in ["a.json", "exports/b.yaml", "d.txt"] {
            write(new.join(name), "new");
        }
        // A killed run leaves such a folder.
        write(parent.path().join(".results.part/a.json"), "older");
        let old = ["a.json", "exports/b.yaml", "c.txt"].map(PathBuf::from);
        assert!(swap(&folder, &old, &new).is_some());
        let expected = [
            ("a.json", "new"),
            ("d.txt", "new"),
            ("empty", ""),
            ("exports", ""),
            ("exports/b.yaml", "new"),
            ("exports/mine.yaml", "mine"),
            ("mine.txt", "mine"),
            ("raw", ""),
            ("raw/deep", ""),
            ("raw/deep/er", ""),
            ("raw/deep/er/still", ""),
            ("raw/deep/er/still/a.dvraw", "recording"),
        ];
        assert_eq!(content(&folder), owned(&expected));
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 1);
    }

    /// The folder that is the working directory of this process is not replaced.
    #[test]
    fn if_a_swap_is_impossible_nothing_changes() {
        let parent = env::current_dir().unwrap();
        let folder = tempfile::tempdir_in(&parent).unwrap();
        write(folder.path().join("a.json"), "old");
        let new = parent.join("new folder that is not there");
        let before = content(folder.path());
        assert!(swap(folder.path(), &[], &new).is_none());
        assert!(swap(&parent, &[], folder.path()).is_none());
        assert_eq!(content(folder.path()), before);
    }
}

//! A whole folder in the place of another, in one step: whoever looks, and a program that is killed, sees the old results or the new ones.

use std::env;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::place;

/// Other files of a folder that are carried over at most.
const MOST_OTHERS: usize = 10_000;

/// Puts the folder `new`, which is in `folder`, in its place, with all files that `folder` holds beside those of `old` (by their paths in
/// it). Returns the folder, held as it was; `None` where the system, the disk or somebody who works in the folder does not allow it.
/// Then all is as it was.
pub(super) fn swap(folder: &Path, old: &[PathBuf], new: &Path) -> Option<File> {
    let folder = fs::canonicalize(folder).ok()?;
    let new = fs::canonicalize(new).ok()?;
    // Whoever is in it would stay in the old one.
    if env::current_dir().is_ok_and(|current| current.starts_with(&folder)) {
        return None;
    }
    let beside = place::unfinished(&folder);
    // A run that was killed left it.
    let _ = fs::remove_dir_all(&beside);
    let mut others = Vec::new();
    list(&folder, Path::new(""), &|path| folder.join(path) == new || old.iter().any(|old| old == path), &mut others)
        .ok()?;
    fs::rename(&new, &beside).ok()?;
    let mut carried = Vec::new();
    match carry(&folder, &others, &beside, &mut carried).and_then(|()| exchange(&folder, &beside)) {
        Ok(held) => {
            bring_late_files(&beside, old, &folder);
            let _ = fs::remove_dir_all(&beside);
            Some(held)
        }
        Err(_) => {
            for path in carried.iter().rev() {
                let _ = if path.is_dir() { fs::remove_dir(path) } else { fs::remove_file(path) };
            }
            let _ = fs::rename(&beside, &new);
            None
        }
    }
}

/// Something in a folder, by its path in it.
struct Entry {
    path: PathBuf,
    is_folder: bool,
}

/// Lists all in `folder` below `inner`, folders before what is in them, without what `is_left_out`.
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

/// Gives each of `others` a second name in `beside`, unless it has one of that name. What was made there is in `carried`.
fn carry(folder: &Path, others: &[Entry], beside: &Path, carried: &mut Vec<PathBuf>) -> io::Result<()> {
    for Entry { path, is_folder } in others {
        let (from, to) = (folder.join(path), beside.join(path));
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
    fs::set_permissions(beside, fs::metadata(folder)?.permissions())
}

/// Exchanges the two folders when all of `beside` is on the disk. Returns what is at `folder` then, held.
fn exchange(folder: &Path, beside: &Path) -> io::Result<File> {
    let held = File::open(beside)?;
    place::hold(&held)?;
    held.sync_all()?;
    rustix::fs::renameat_with(rustix::fs::CWD, beside, rustix::fs::CWD, folder, rustix::fs::RenameFlags::EXCHANGE)?;
    // The step itself, where the disk allows that.
    let _ = File::open(place::folder(folder)).and_then(|parent| parent.sync_all());
    Ok(held)
}

/// Moves what somebody put into the old folder meanwhile, which is at `beside`, to the new one.
fn bring_late_files(beside: &Path, old: &[PathBuf], folder: &Path) {
    let mut others = Vec::new();
    let _ = list(beside, Path::new(""), &|path| old.iter().any(|old| old == path), &mut others);
    for Entry { path, .. } in others {
        let to = folder.join(&path);
        if to.symlink_metadata().is_err() {
            let _ = fs::rename(beside.join(&path), to);
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

    /// Every file with its text, and every folder without any.
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
    fn new_results_are_there_with_all_that_is_no_result() {
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
        // A run that was killed left this.
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

    /// A folder that somebody works in is not taken away; all stays as it was.
    #[test]
    fn where_it_is_not_possible_nothing_changes() {
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

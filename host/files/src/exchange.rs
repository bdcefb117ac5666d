//! Exchange of old files for new ones in a folder: all of them, or none.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use tempfile::TempDir;

use super::FileError;

/// A change to a folder that can be undone.
enum Step {
    Made(PathBuf),
    Moved { from: PathBuf, to: PathBuf },
}

/// Replaces files in `folder`: moves the files `old` out of it, and the files `new` of the folder `from` into it. Paths
/// are relative to their folders. Files that new ones overwrite are moved out too.
///
/// # Errors
/// [`FileError`] with the file in `folder` that could not be moved. `folder` is then restored, or the error names the
/// folder with the old files that could not be moved back.
pub(super) fn exchange(folder: &Path, old: &[PathBuf], from: &Path, new: &[PathBuf]) -> Result<(), FileError> {
    // The folder for old files is inside `folder`, so that it is on the same disk.
    let aside = super::scratch_in(folder).map_err(|error| FileError::new(folder, error))?;
    let mut steps = Vec::new();
    match put_in(folder, old, &Filled { folder: from, files: new }, aside.path(), &mut steps) {
        Ok(()) => Ok(()),
        Err(error) => Err(match undo(steps) {
            Ok(()) => error,
            Err(_) => kept(error, aside),
        }),
    }
}

/// New files, with paths relative to the folder that contains them.
struct Filled<'a> {
    folder: &'a Path,
    files: &'a [PathBuf],
}

fn put_in(folder: &Path, old: &[PathBuf], new: &Filled, aside: &Path, steps: &mut Vec<Step>) -> Result<(), FileError> {
    let is_replaced = |file: &&PathBuf| !old.contains(file) && folder.join(file).symlink_metadata().is_ok();
    for file in old.iter().chain(new.files.iter().filter(is_replaced)) {
        let path = folder.join(file);
        move_file(file, folder, aside, steps).map_err(|error| FileError::new(&path, error))?;
    }
    for file in new.files {
        move_file(file, new.folder, folder, steps).map_err(|error| FileError::new(&folder.join(file), error))?;
    }
    Ok(())
}

/// Moves `file` from one folder to the same relative path in another.
fn move_file(file: &Path, from: &Path, folder: &Path, steps: &mut Vec<Step>) -> io::Result<()> {
    let mut outer: Vec<&Path> = file.ancestors().skip(1).filter(|path| !path.as_os_str().is_empty()).collect();
    outer.reverse();
    for parent in outer {
        let parent = folder.join(parent);
        if !parent.is_dir() {
            fs::create_dir(&parent)?;
            steps.push(Step::Made(parent));
        }
    }
    let to = folder.join(file);
    let from = from.join(file);
    fs::rename(&from, &to)?;
    steps.push(Step::Moved { from, to });
    Ok(())
}

/// Undoes the steps, the last one first, as far as possible. Returns the first error.
fn undo(steps: Vec<Step>) -> io::Result<()> {
    let back = |step: Step| match step {
        Step::Made(path) => fs::remove_dir(path),
        Step::Moved { from, to } => fs::rename(to, from),
    };
    steps.into_iter().rev().map(back).fold(Ok(()), io::Result::and)
}

/// Extends the error by the folder with old files that could not be moved back.
fn kept(FileError { path, error }: FileError, aside: TempDir) -> FileError {
    // The name must not end in .part, because a later run removes such folders.
    let aside = aside.keep();
    let visible = aside.with_extension("kept");
    let kept = if fs::rename(&aside, &visible).is_ok() { visible } else { aside };
    let text = format!("{error}; files that could not be moved back are in {}: move them from there", kept.display());
    FileError { path, error: io::Error::new(error.kind(), text) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the files and folders below `folder` by their paths, with the content of files.
    fn content(folder: &Path) -> Vec<(PathBuf, Option<String>)> {
        let mut found = Vec::new();
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            found.push((path.clone(), fs::read_to_string(&path).ok()));
            if path.is_dir() {
                found.extend(content(&path));
            }
        }
        found.sort();
        found
    }

    #[test]
    fn a_failed_move_restores_the_folder() {
        let [folder, from] = [(); 2].map(|()| tempfile::tempdir().unwrap());
        fs::create_dir(folder.path().join("exports")).unwrap();
        for name in ["a.json", "b.txt", "exports/c.yaml", "mine.txt"] {
            fs::write(folder.path().join(name), format!("old {name}")).unwrap();
        }
        fs::create_dir(from.path().join("more")).unwrap();
        for name in ["a.json", "mine.txt", "more/d.txt"] {
            fs::write(from.path().join(name), format!("new {name}")).unwrap();
        }
        let before = [content(folder.path()), content(from.path())];
        let old: Vec<PathBuf> = ["a.json", "b.txt", "exports/c.yaml"].map(PathBuf::from).into();
        let mut new: Vec<PathBuf> = ["a.json", "mine.txt", "more/d.txt", "not there"].map(PathBuf::from).into();
        let error = exchange(folder.path(), &old, from.path(), &new).unwrap_err();
        assert_eq!(error.path, folder.path().join("not there"));
        assert_eq!([content(folder.path()), content(from.path())], before);

        new.pop();
        exchange(folder.path(), &old, from.path(), &new).unwrap();
        let after: Vec<String> = content(folder.path()).into_iter().filter_map(|(_, text)| text).collect();
        assert_eq!(after, ["new a.json", "new mine.txt", "new more/d.txt"]);
    }
}

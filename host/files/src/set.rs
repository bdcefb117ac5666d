//! Files that appear together or not at all.

use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

use super::{Content, FileError, NewFile, unfinished};

/// Writes files with these contents. If one of them cannot be written, none is, and all existing files are kept. A signal
/// leaves all old files or all new ones.
///
/// # Errors
/// [`FileError`] names the file that cannot be written.
pub fn write_all(files: &[(&Path, &[u8])]) -> Result<(), FileError> {
    let mut written = Vec::new();
    for (path, content) in files {
        let mut file = NewFile::create(path)?;
        file.write_all(content).map_err(|error| FileError::new(path, error))?;
        written.push(file);
    }
    finish_all(written)
}

/// A complete temporary file, before it gets its name.
struct Complete {
    path: PathBuf,
    is_new: bool,
    file: NamedTempFile,
}

/// A file that has its name.
struct Named {
    path: PathBuf,
    is_new: bool,
    /// The old file, under the name of the temporary one, which is removed with this value.
    old: Option<NamedTempFile>,
}

/// Flushes all files to the disk, then renames them to their final paths.
pub(super) fn finish_all(files: Vec<NewFile>) -> Result<(), FileError> {
    let (mut listed, mut complete) = (Vec::new(), Vec::new());
    for NewFile { path, content, is_new, _listed } in files {
        match content {
            Content::Temporary(file) => {
                let file = file.into_inner().map_err(|error| FileError::new(&path, error.into_error()))?;
                file.as_file().sync_all().map_err(|error| FileError::new(&path, error))?;
                complete.push(Complete { path, is_new, file });
            }
            Content::InPlace(mut file) => file.flush().map_err(|error| FileError::new(&path, error))?,
        }
        listed.push(_listed);
    }
    let temporary: Vec<PathBuf> = complete.iter().map(|complete| complete.file.path().to_owned()).collect();
    // The entries of the list are dropped after this, because that takes the list too.
    unfinished::end_all(temporary.iter().map(PathBuf::as_path), || name_all(complete))
}

/// Gives all files their names, or none.
fn name_all(files: Vec<Complete>) -> Result<(), FileError> {
    let keeps_old = files.len() > 1;
    let mut named = Vec::new();
    for file in files {
        let path = file.path.clone();
        match name(file, keeps_old) {
            Ok(file) => named.push(file),
            Err(error) => {
                named.into_iter().rev().for_each(undo);
                return Err(FileError::new(&path, error));
            }
        }
    }
    Ok(())
}

fn name(Complete { path, is_new, file }: Complete, keeps_old: bool) -> io::Result<Named> {
    if !is_new && keeps_old && exchange(file.path(), &path).is_ok() {
        return Ok(Named { path, is_new, old: Some(file) });
    }
    let persisted = match is_new {
        true => file.persist_noclobber(&path).or_else(|error| match error.error.kind() {
            io::ErrorKind::AlreadyExists => Err(error),
            // Some file systems do not support this.
            _ => error.file.persist(&path),
        }),
        false => file.persist(&path),
    };
    match persisted {
        Ok(_) => Ok(Named { path, is_new, old: None }),
        Err(error) if error.error.kind() == io::ErrorKind::AlreadyExists => Err(io::Error::new(
            io::ErrorKind::AlreadyExists,
            "another program created it in the meantime, so it was not replaced; choose another name",
        )),
        Err(error) => Err(error.error),
    }
}

/// Takes the name back, as far as the file system supports this.
fn undo(Named { path, is_new, old }: Named) {
    let _ = match old {
        Some(old) => exchange(old.path(), &path),
        None if is_new => fs::remove_file(&path),
        None => Ok(()),
    };
}

/// Exchanges two files in one step.
#[cfg(target_os = "linux")]
fn exchange(one: &Path, other: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    Ok(renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE)?)
}

#[cfg(not(target_os = "linux"))]
fn exchange(_: &Path, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn content(folder: &Path) -> Vec<(String, String)> {
        let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
        let mut content: Vec<_> = entries
            .map(|entry| {
                (entry.file_name().into_string().unwrap(), fs::read_to_string(entry.path()).unwrap_or_default())
            })
            .collect();
        content.sort();
        content
    }

    #[test]
    fn all_files_are_replaced_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b, c] = ["a.pdf", "b.svg", "c.txt"].map(|name| folder.path().join(name));
        fs::write(&a, "old").unwrap();
        fs::write(&c, "old").unwrap();
        let before = content(folder.path());
        let three = |last: &Path| write_all(&[(&a, b"new"), (&b, b"new"), (last, b"new")]);
        // The last file cannot be begun: its folder is missing, or it is a folder.
        for last in [folder.path().join("missing/c.txt"), folder.path().to_owned()] {
            assert!(three(&last).is_err());
            assert_eq!(content(folder.path()), before);
        }
        // It cannot get its name, because another program creates it in the meantime.
        let files = [&a, &b, &c].map(|path| {
            let mut file = NewFile::create(path).unwrap();
            file.write_all(b"new").unwrap();
            file
        });
        let d = folder.path().join("d.txt");
        let late = NewFile::create(&d).unwrap();
        fs::write(&d, "of another program").unwrap();
        let error = finish_all(files.into_iter().chain([late]).collect()).unwrap_err();
        assert!(error.path == d && error.to_string().contains("another program created it"), "{error}");
        fs::remove_file(&d).unwrap();
        #[cfg(target_os = "linux")]
        assert_eq!(content(folder.path()), before);
        three(&c).unwrap();
        let names = ["a.pdf", "b.svg", "c.txt"];
        assert_eq!(content(folder.path()), names.map(|name| (name.to_owned(), "new".to_owned())));
    }
}

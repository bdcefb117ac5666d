//! The file for the bytes from a port. Existing files are never overwritten, because a device does not send its data again.

use std::fs::{self, File, Metadata, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

/// Reasons why nothing can be saved.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SaveError {
    /// A file or folder of this name exists.
    #[error("{} is there already: choose another name for save=, as no saved stream is overwritten", .0.display())]
    Taken(PathBuf),
    /// The folder of the file does not exist.
    #[error("{} is not a folder: create it, or choose another folder for save=", .0.display())]
    NoFolder(PathBuf),
    /// The file cannot be created.
    #[error("{}: {error}; choose a writable path with save=", path.display())]
    Failed {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
}

/// Destination of the bytes from a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SaveTo {
    /// In a file of this name, which must not exist yet.
    File(PathBuf),
    /// In this folder, as the first of `NAME.circles`, `NAME-2.circles` and so on that does not exist yet.
    NextIn {
        /// The folder.
        folder: PathBuf,
        /// The name without number.
        name: String,
    },
}

impl SaveTo {
    /// Checks in advance that something can be saved; no file is created.
    pub(super) fn check(&self) -> Result<(), SaveError> {
        let Self::File(path) = self else { return Ok(()) };
        if let Ok(there) = fs::metadata(path) {
            return if is_pipe_or_device(&there) { Ok(()) } else { Err(SaveError::Taken(path.clone())) };
        }
        match path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.is_dir()) {
            Some(folder) => Err(SaveError::NoFolder(folder.to_owned())),
            None => Ok(()),
        }
    }

    /// Creates the file.
    pub(super) fn create(&self) -> Result<File, SaveError> {
        match self {
            Self::File(path) => create_new(path),
            Self::NextIn { folder, name } => {
                let mut number = 1_u32;
                loop {
                    let path = folder.join(match number {
                        1 => format!("{name}.circles"),
                        _ => format!("{name}-{number}.circles"),
                    });
                    match File::create_new(&path) {
                        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && number < u32::MAX => number += 1,
                        created => return created.map_err(|error| SaveError::Failed { path, error }),
                    }
                }
            }
        }
    }
}

/// Pipes and devices have no content that could be overwritten.
fn is_pipe_or_device(there: &Metadata) -> bool {
    !there.is_file() && !there.is_dir()
}

/// Creates a new file, or opens one without content that could be overwritten.
fn create_new(path: &Path) -> Result<File, SaveError> {
    let created = match fs::metadata(path).is_ok_and(|there| is_pipe_or_device(&there)) {
        true => OpenOptions::new().write(true).open(path),
        false => File::create_new(path),
    };
    created.map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => SaveError::Taken(path.to_owned()),
        _ => SaveError::Failed { path: path.to_owned(), error },
    })
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    #[test]
    fn a_stream_gets_the_next_free_name() {
        let folder = tempfile::tempdir().unwrap();
        let save = SaveTo::NextIn { folder: folder.path().to_owned(), name: "ttyACM0".to_owned() };
        fs::write(folder.path().join("ttyACM0.circles"), "first").unwrap();
        fs::write(folder.path().join("ttyACM0-3.circles"), "third").unwrap();
        save.check().unwrap();
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
        for text in ["second", "fourth"] {
            save.create().unwrap().write_all(text.as_bytes()).unwrap();
        }
        for (name, text) in [("", "first"), ("-2", "second"), ("-3", "third"), ("-4", "fourth")] {
            let path = folder.path().join(format!("ttyACM0{name}.circles"));
            assert_eq!(fs::read_to_string(path).unwrap(), text);
        }
    }

    #[test]
    fn a_named_file_is_never_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stream");
        let save = SaveTo::File(path.clone());
        save.check().unwrap();
        assert!(!path.exists());
        save.create().unwrap().write_all(b"first").unwrap();
        for error in [save.check().unwrap_err(), save.create().unwrap_err()] {
            assert!(error.to_string().contains("stream is there already: choose another name"), "{error}");
        }
        assert_eq!(fs::read_to_string(&path).unwrap(), "first");
        let nowhere = SaveTo::File(folder.path().join("missing/stream")).check().unwrap_err().to_string();
        assert!(nowhere.contains("missing is not a folder: create it"), "{nowhere}");
    }
}

#![doc = include_str!("../README.md")]
// These lints hold because no input may cause a panic, and because only the program prints, never a library.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod exchange;
pub mod folder;
pub mod output;
mod paths;
pub mod remedy;
mod set;
pub mod shell_word;
#[cfg(target_os = "linux")]
mod swap;
pub mod text;
pub mod unfinished;
pub mod visible;
pub mod xml;
pub mod yaml;

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::{NamedTempFile, TempDir, TempPath};

use self::paths::UNFINISHED;
pub use self::paths::is_stream;
pub use self::set::write_all;
use self::unfinished::{Begun, Listed};

/// Size of the write buffer in bytes.
const BUFFER: usize = 1 << 18;

/// A file or folder that cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: {}", visible::path(path), message(error))]
pub struct FileError {
    /// Path of the file or folder.
    pub path: PathBuf,
    /// Error of the operating system.
    pub error: io::Error,
}

impl remedy::Remedy for FileError {}

impl FileError {
    /// Creates an error about the file at `path`.
    pub fn new(path: &Path, error: io::Error) -> Self {
        Self { path: path.to_owned(), error }
    }
}

/// Returns the message of the operating system, with advice appended.
pub fn message(error: &io::Error) -> String {
    plain(error) + advice(error.kind())
}

/// Returns the message of the operating system without the name of a temporary file, which means nothing to the user.
fn plain(error: &io::Error) -> String {
    let text = error.to_string();
    match (text.split_once(" at path \""), error.get_ref()) {
        (Some((cause, path)), Some(_)) if path.contains(UNFINISHED) || path.contains(".tmp") => cause.to_owned(),
        _ => text,
    }
}

/// Returns advice on an error of this kind, as text to append to a sentence.
fn advice(kind: io::ErrorKind) -> &'static str {
    match kind {
        io::ErrorKind::NotFound => "; does the folder exist?",
        io::ErrorKind::IsADirectory => "; name a file in it",
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => "; choose a folder where you may write",
        io::ErrorKind::NotSeekable => "; this format cannot go into a pipe: name a file",
        io::ErrorKind::ResourceBusy => "; wait until it ends, or choose another name",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "; free some space there, or choose another disk",
        _ => "",
    }
}

/// A file that is being written. If it is dropped before [`NewFile::finish`], nothing remains.
#[derive(Debug)]
pub struct NewFile {
    /// Final path.
    path: PathBuf,
    content: Content,
    /// `true` if no file of this name existed at the beginning.
    is_new: bool,
    /// Entry in the list of unfinished files; dropped after `content`.
    _listed: Option<Listed>,
}

#[derive(Debug)]
enum Content {
    /// A temporary file in the folder of the final path, renamed when finished.
    Temporary(BufWriter<NamedTempFile>),
    /// The file at the path itself, which is not a regular file (for example a pipe or `/dev/stdout`) and therefore
    /// cannot be replaced.
    InPlace(BufWriter<File>),
}

impl NewFile {
    /// Begins writing the file at `path`.
    ///
    /// # Errors
    /// [`FileError`] if nothing can be written there.
    pub fn create(path: &Path) -> Result<Self, FileError> {
        let failed = |error| FileError::new(path, error);
        let in_place = |file| {
            let content = Content::InPlace(BufWriter::with_capacity(BUFFER, file));
            Self { path: path.to_owned(), content, is_new: false, _listed: None }
        };
        if let Some(stream) = paths::own_stream(path) {
            return stream.map(in_place).map_err(failed);
        }
        let there = fs::metadata(path);
        if there.as_ref().is_ok_and(fs::Metadata::is_dir) {
            return Err(failed(io::Error::from(io::ErrorKind::IsADirectory)));
        }
        if there.as_ref().is_ok_and(|there| !there.is_file()) {
            return File::create(path).map(in_place).map_err(failed);
        }
        // The target of a link is replaced, not the link itself.
        let target = paths::target(path).map_err(failed)?;
        // Checked here, so that the error does not name a temporary file.
        fs::metadata(paths::folder(&target)).map_err(failed)?;
        let begun = unfinished::begin(Begun::ScratchFile, || {
            let path = paths::unfinished(&target);
            let file = paths::claim(&path, &new_file(&target))?;
            Ok((NamedTempFile::from_parts(file, TempPath::try_from_path(&path)?), path))
        });
        let file = begun.map_err(failed)?;
        let listed = Some(Listed::new(file.path()));
        let content = Content::Temporary(BufWriter::with_capacity(BUFFER, file));
        Ok(Self { path: target, content, is_new: there.is_err(), _listed: listed })
    }

    /// Path of the file while it is unfinished, for writers that open the file themselves.
    pub fn unfinished_path(&self) -> &Path {
        match &self.content {
            Content::Temporary(file) => file.get_ref().path(),
            Content::InPlace(_) => &self.path,
        }
    }

    /// Returns a second handle of the file, for writers that need to own one.
    ///
    /// # Errors
    /// The error of the operating system.
    pub fn handle(&self) -> io::Result<File> {
        match &self.content {
            Content::Temporary(file) => file.get_ref().as_file().try_clone(),
            Content::InPlace(file) => file.get_ref().try_clone(),
        }
    }

    /// Flushes the file to the disk and renames it to its final path, replacing a file that existed when
    /// [`NewFile::create`] was called.
    ///
    /// # Errors
    /// [`FileError`] if not everything could be written, or another program created a file of this name in the
    /// meantime.
    pub fn finish(self) -> Result<(), FileError> {
        set::finish_all(vec![self])
    }
}

/// Prefix of temporary folders.
const SCRATCH: &str = ".evcal.";

/// Creates a temporary folder in `folder` for incomplete results.
fn scratch_in(folder: &Path) -> io::Result<TempDir> {
    tempfile::Builder::new().prefix(SCRATCH).suffix(UNFINISHED).tempdir_in(folder)
}

/// Removes temporary folders that a killed program left in `folder`. No other program may be writing into it.
fn remove_scratch(folder: &Path) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        if name.starts_with(SCRATCH) && name.ends_with(UNFINISHED) {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

/// Returns the options to create an unfinished file, with the permissions of the file at `path` or the default ones.
fn new_file(path: &Path) -> fs::OpenOptions {
    let mut options = File::options();
    options.read(true).write(true).create_new(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::{OpenOptionsExt as _, PermissionsExt as _};
        options.mode(fs::metadata(path).map_or(0o666, |there| there.permissions().mode() & 0o7777));
    }
    options
}

/// Creates a file without a name, which is removed when it is closed.
///
/// # Errors
/// The error names the system's folder for temporary files.
pub fn nameless() -> io::Result<File> {
    tempfile::tempfile().map_err(|error| {
        let folder = std::env::temp_dir();
        let text = format!("cannot create a temporary file in {} (TMPDIR): {}", folder.display(), plain(&error));
        io::Error::new(error.kind(), text)
    })
}

impl Write for NewFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match &mut self.content {
            Content::Temporary(file) => file.write(bytes),
            Content::InPlace(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match &mut self.content {
            Content::Temporary(file) => file.flush(),
            Content::InPlace(file) => file.flush(),
        }
    }
}

impl Seek for NewFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        match &mut self.content {
            Content::Temporary(file) => file.seek(to),
            Content::InPlace(file) => file.seek(to),
        }
    }
}

/// Checks that a file can be written at `path`, before a long computation whose result goes there.
///
/// # Errors
/// [`FileError`] if nothing can be written there.
pub fn try_out(path: &Path) -> Result<(), FileError> {
    // Opening and closing a pipe would signal its end to the reader, so streams are not tried.
    if is_stream(path) { Ok(()) } else { NewFile::create(path).map(drop) }
}

/// Writes a file with this content.
///
/// # Errors
/// [`FileError`] if it cannot be written; an existing file is then kept.
pub fn write(path: &Path, content: &[u8]) -> Result<(), FileError> {
    write_with(path, |file| file.write_all(content))
}

/// Writes a file whose content `fill` produces.
///
/// # Errors
/// [`FileError`] if it cannot be written or `fill` fails; an existing file is then kept.
pub fn write_with(path: &Path, fill: impl FnOnce(&mut NewFile) -> io::Result<()>) -> Result<(), FileError> {
    let mut file = NewFile::create(path)?;
    fill(&mut file).map_err(|error| FileError::new(path, error))?;
    file.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> =
            fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_gets_its_name_only_when_complete() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result.csv");
        let mut file = NewFile::create(&path).unwrap();
        file.write_all(b"whole").unwrap();
        assert!(!path.exists());
        assert!(file.unfinished_path().exists());
        file.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(names(folder.path()), ["result.csv"]);
    }

    #[test]
    fn an_impossible_path_is_rejected_before_anything_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let refused = |path: &Path| NewFile::create(path).unwrap_err().to_string();
        assert!(refused(folder.path()).contains("name a file in it"), "{}", refused(folder.path()));
        let nowhere = refused(&folder.path().join("missing/result.csv"));
        assert!(nowhere.ends_with("(os error 2); does the folder exist?"), "{nowhere}");
        assert_eq!(names(folder.path()), [""; 0]);
    }

    #[test]
    fn a_failure_keeps_the_old_file_and_leaves_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result.csv");
        write(&path, b"old").unwrap();
        let error = write_with(&path, |file| {
            file.write_all(b"half of the new")?;
            Err(io::Error::other("disk full"))
        });
        assert!(error.unwrap_err().to_string().contains("result.csv: disk full"));
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["result.csv"]);
    }

    #[cfg(unix)]
    #[test]
    fn devices_links_and_permissions_are_preserved() {
        use std::os::unix::fs::{PermissionsExt as _, symlink};
        write(Path::new("/dev/null"), b"gone").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
        let folder = tempfile::tempdir().unwrap();
        let (real, link, plain) = ("real.csv", "link.csv", "plain.csv");
        let [real, link, plain] = [real, link, plain].map(|name| folder.path().join(name));
        fs::write(&real, b"old").unwrap();
        fs::set_permissions(&real, fs::Permissions::from_mode(0o640)).unwrap();
        symlink(&real, &link).unwrap();
        write(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert_eq!(fs::metadata(&real).unwrap().permissions().mode() & 0o777, 0o640);
        // The permissions of a new file follow the user's umask.
        write(&plain, b"new").unwrap();
        let other = folder.path().join("other.csv");
        fs::write(&other, b"new").unwrap();
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&plain), mode(&other));
    }
    /// The remains of a killed run are removed, and of two simultaneous runs the second fails.
    #[test]
    fn two_runs_cannot_write_the_same_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("result.csv");
        fs::write(folder.path().join(".result.csv.part"), "left by a killed run").unwrap();
        let mut first = NewFile::create(&path).unwrap();
        first.write_all(b"first").unwrap();
        let error = NewFile::create(&path).unwrap_err().to_string();
        assert!(
            error.ends_with(
                "result.csv: another run of this program is writing it; wait until it ends, or choose another name"
            ),
            "{error}"
        );
        first.finish().unwrap();
        // Another program creates the file in the meantime.
        let other = folder.path().join("other.csv");
        let new = NewFile::create(&other).unwrap();
        fs::write(&other, "of another program").unwrap();
        let error = new.finish().unwrap_err().to_string();
        assert!(error.contains("another program created it in the meantime"), "{error}");
        assert_eq!(fs::read(&other).unwrap(), b"of another program");
        assert_eq!(names(folder.path()), ["other.csv", "result.csv"]);
    }

    /// Checking a pipe must not end it for its reader, links to missing files are followed, and names of 252 bytes
    /// and more are possible.
    #[cfg(unix)]
    #[test]
    fn pipes_links_and_files_with_long_names_can_be_written() {
        use std::io::Read as _;
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, 0o600.into(), 0).unwrap();
        let reader = std::thread::spawn({
            let pipe = pipe.clone();
            move || {
                let mut text = String::new();
                File::open(pipe).unwrap().read_to_string(&mut text).unwrap();
                text
            }
        });
        output::check_outputs([pipe.as_path()], &[], output::Existing::Keep).unwrap();
        write(&pipe, b"whole").unwrap();
        assert_eq!(reader.join().unwrap(), "whole");
        let (link, target) = (folder.path().join("link.csv"), folder.path().join("target.csv"));
        symlink("target.csv", &link).unwrap();
        write(&link, b"new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&target).unwrap(), b"new");
        for length in [249, 250, 255] {
            let path = folder.path().join("n".repeat(length));
            try_out(&path).unwrap();
            write(&path, b"new").unwrap();
            assert_eq!(fs::read(&path).unwrap(), b"new");
        }
        assert_eq!(names(folder.path()).len(), 6);
        assert!(is_stream(Path::new("/dev/stdout")) && is_stream(Path::new("/dev/fd/2")) && !is_stream(&target));
    }
}

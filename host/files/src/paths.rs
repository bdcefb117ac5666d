//! Paths: the target of a path, and the unfinished file next to it.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io;
use std::path::{Path, PathBuf};

/// Suffix of an unfinished file.
pub(crate) const UNFINISHED: &str = ".part";
/// Longest file name in bytes on most file systems.
const LONGEST_NAME: usize = 255;
/// Number of bytes of a longer name that are kept.
const KEPT: usize = 200;
/// Largest number of links that are followed.
const MOST_LINKS: usize = 40;
/// Number of attempts to create an unfinished file that another program keeps removing.
const TRIES: usize = 100;

/// `true` if `path` is a pipe, a device or one of the program's own streams such as `/dev/stdout` (wherever it is
/// redirected). Such a file is written once from beginning to end and cannot be replaced.
pub fn is_stream(path: &Path) -> bool {
    own_stream(path).is_some() || fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir())
}

/// Returns the open stream that `path` names. Opening it by name would fail for sockets and truncate files.
pub(crate) fn own_stream(path: &Path) -> Option<io::Result<File>> {
    #[cfg(unix)]
    {
        use std::os::fd::AsFd as _;
        let number = match path.to_str()? {
            "/dev/stdout" => "1",
            "/dev/stderr" => "2",
            path => path.strip_prefix("/dev/fd/").or_else(|| path.strip_prefix("/proc/self/fd/"))?,
        };
        let stream = match number {
            "1" => io::stdout().as_fd().try_clone_to_owned(),
            "2" => io::stderr().as_fd().try_clone_to_owned(),
            _ => return None,
        };
        Some(stream.map(File::from))
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        None
    }
}

/// Follows links from `path` to the file that they lead to, which need not exist.
///
/// # Errors
/// If links form a cycle.
pub(crate) fn target(path: &Path) -> io::Result<PathBuf> {
    let mut target = path.to_owned();
    for _ in 0..MOST_LINKS {
        match fs::read_link(&target) {
            Ok(link) => target = folder(&target).join(link),
            Err(_) => return Ok(target),
        }
    }
    Err(io::Error::other("is a link that leads back to itself"))
}

/// Returns the folder that contains `path`.
pub(crate) fn folder(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Returns the path at which `path` is written until complete. It is always the same, so that two programs notice each
/// other and the remains of a killed program are found again.
pub(crate) fn unfinished(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default();
    let mut unfinished = OsString::from(".");
    if name.len() + 1 + UNFINISHED.len() <= LONGEST_NAME {
        unfinished.push(name);
    } else {
        let mut hasher = DefaultHasher::new();
        name.hash(&mut hasher);
        unfinished.push(beginning(name));
        unfinished.push(format!("~{:016x}", hasher.finish()));
    }
    unfinished.push(UNFINISHED);
    folder(path).join(unfinished)
}

fn beginning(name: &OsStr) -> String {
    let name = name.to_string_lossy();
    let end = (0..=KEPT.min(name.len())).rev().find(|end| name.is_char_boundary(*end));
    // Invalid bytes become replacement characters, which may be longer.
    name.get(..end.unwrap_or(0)).unwrap_or_default().to_owned()
}

/// Creates the unfinished file at `path` and locks it until it is closed. The file of a killed program is removed.
///
/// # Errors
/// [`io::ErrorKind::ResourceBusy`] if this or another program is writing it.
pub(crate) fn claim(path: &Path, new: &fs::OpenOptions) -> io::Result<File> {
    for _ in 0..TRIES {
        match new.open(path) {
            Ok(file) => {
                let is_locked = try_lock(&file)?;
                // Another program may have removed it, taking it for the file of a killed one.
                if is_locked && is_same(&file, path) {
                    return Ok(file);
                }
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                let left = match existing().open(path) {
                    Ok(left) => left,
                    Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                    Err(error) => return Err(error),
                };
                if !try_lock(&left)? {
                    return Err(io::Error::new(
                        io::ErrorKind::ResourceBusy,
                        "another run of this program is writing it",
                    ));
                }
                if is_same(&left, path) {
                    fs::remove_file(path)?;
                }
            }
            Err(error) => return Err(error),
        }
    }
    Err(io::Error::new(io::ErrorKind::ResourceBusy, "another program keeps removing it"))
}

/// Returns the options to open the unfinished file of a killed program.
fn existing() -> fs::OpenOptions {
    let mut options = File::options();
    options.read(true).write(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        // A link that somebody else created is not followed, and a pipe does not block.
        let flags = rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
        options.custom_flags(flags.bits() as i32);
    }
    options
}

/// Locks a file or folder while it is open. Returns `false` if another program has locked it, `true` also if the file
/// system has no locks.
pub(crate) fn try_lock(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(fs::TryLockError::WouldBlock) => Ok(false),
        Err(fs::TryLockError::Error(_)) => Ok(true),
    }
}

/// `true` if the open file is still the one at `path`.
fn is_same(file: &File, path: &Path) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        let both = file.metadata().and_then(|open| Ok((open, fs::symlink_metadata(path)?)));
        both.is_ok_and(|(open, there)| (open.dev(), open.ino()) == (there.dev(), there.ino()))
    }
    #[cfg(not(unix))]
    {
        let _ = (file, path);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_names_have_an_unfinished_path() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["a.csv".to_owned(), "x".repeat(249), "x".repeat(250), "x".repeat(255), "ä".repeat(127)];
        let mut seen = Vec::new();
        for name in names {
            let path = unfinished(&folder.path().join(&name));
            fs::write(&path, "").unwrap();
            assert!(path.file_name().unwrap().len() <= LONGEST_NAME && !seen.contains(&path), "{name}");
            seen.push(path);
        }
        assert!(seen[0].ends_with(".a.csv.part"));
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_to_missing_files() {
        use std::os::unix::fs::symlink;
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        symlink("b", path("a")).unwrap();
        symlink(path("c"), path("b")).unwrap();
        assert_eq!(target(&path("a")).unwrap(), path("c"));
        assert_eq!(target(&path("d")).unwrap(), path("d"));
        symlink("f", path("e")).unwrap();
        symlink("e", path("f")).unwrap();
        assert!(target(&path("e")).unwrap_err().to_string().contains("leads back"));
    }

    #[test]
    fn a_file_is_claimed_once_and_leftovers_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(".a.part");
        let mut new = File::options();
        new.read(true).write(true).create_new(true);
        fs::write(&path, "left by a program that was killed").unwrap();
        let claimed = claim(&path, &new).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"");
        assert_eq!(claim(&path, &new).unwrap_err().kind(), io::ErrorKind::ResourceBusy);
        drop(claimed);
        claim(&path, &new).unwrap();
    }
}

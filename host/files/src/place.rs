//! Places of files: what a path leads to, and the unfinished file next to it.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::io;
use std::path::{Path, PathBuf};

/// Ends the name of a file that is not whole yet.
pub(crate) const UNFINISHED: &str = ".part";
/// Bytes that a name may have on most disks.
const LONGEST_NAME: usize = 255;
/// Bytes of a longer name that are kept.
const KEPT: usize = 200;
/// Links that are followed at most.
const MOST_LINKS: usize = 40;
/// How often an unfinished file is made again if another program removes it.
const TRIES: usize = 100;

/// Returns `true` if `path` is a pipe, a device or one of the program's own streams such as `/dev/stdout`, whatever that is
/// redirected to: something that is written once from its beginning to its end, and that nothing can replace.
pub fn is_stream(path: &Path) -> bool {
    own_stream(path).is_some() || fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir())
}

/// The open stream that `path` is a name of. Opening it by its name fails for sockets, and cuts off files.
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

/// The file that `path` leads to, through links. It need not exist.
///
/// # Errors
/// When links lead in a circle.
pub(crate) fn target(path: &Path) -> io::Result<PathBuf> {
    let mut place = path.to_owned();
    for _ in 0..MOST_LINKS {
        match fs::read_link(&place) {
            Ok(link) => place = folder(&place).join(link),
            Err(_) => return Ok(place),
        }
    }
    Err(io::Error::other("is a link that leads back to itself"))
}

/// The folder that `place` is in.
pub(crate) fn folder(place: &Path) -> &Path {
    place.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Where `place` is written until it is whole: always the same name, so that two programs notice each other, and so that a
/// file which a killed one left is found again.
pub(crate) fn unfinished(place: &Path) -> PathBuf {
    let name = place.file_name().unwrap_or_default();
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
    folder(place).join(unfinished)
}

fn beginning(name: &OsStr) -> String {
    let name = name.to_string_lossy();
    let end = (0..=KEPT.min(name.len())).rev().find(|end| name.is_char_boundary(*end));
    // Letters that stand for bytes which are none may take more room.
    name.get(..end.unwrap_or(0)).unwrap_or_default().to_owned()
}

/// Makes the unfinished file at `path`, held by this program until it is closed. One that a killed program left is removed.
///
/// # Errors
/// [`io::ErrorKind::ResourceBusy`] when another program, or this one, is writing it.
pub(crate) fn claim(path: &Path, new: &fs::OpenOptions) -> io::Result<File> {
    for _ in 0..TRIES {
        match new.open(path) {
            Ok(file) => {
                let held = hold(&file)?;
                // Another program may have taken it for one that was left.
                if held && is_same(&file, path) {
                    return Ok(file);
                }
            }
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                let left = match existing().open(path) {
                    Ok(left) => left,
                    Err(error) if error.kind() == io::ErrorKind::NotFound => continue,
                    Err(error) => return Err(error),
                };
                if !hold(&left)? {
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
    Err(io::Error::new(io::ErrorKind::ResourceBusy, "another program removes it again and again"))
}

/// How a file that was left is opened.
fn existing() -> fs::OpenOptions {
    let mut options = File::options();
    options.read(true).write(true);
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt as _;
        // A link that somebody else put there is not followed, and a pipe does not make it wait.
        let flags = rustix::fs::OFlags::NOFOLLOW | rustix::fs::OFlags::NONBLOCK;
        options.custom_flags(flags.bits() as i32);
    }
    options
}

/// Holds a file or folder as long as it is open; `false` if another program holds it. Where a disk has no locks, nobody does.
pub(crate) fn hold(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(fs::TryLockError::WouldBlock) => Ok(false),
        Err(fs::TryLockError::Error(_)) => Ok(true),
    }
}

/// Whether the open file is still the one at `path`.
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
    fn the_longest_names_have_an_unfinished_file() {
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
    fn links_are_followed_to_files_that_are_not_there_yet() {
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
    fn a_file_is_claimed_once_and_one_that_was_left_is_removed() {
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

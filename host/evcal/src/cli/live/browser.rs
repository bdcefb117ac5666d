//! Opening the page in the person's browser.

use std::ffi::OsString;
use std::io::{self, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;

use tempfile::NamedTempFile;

/// A file that leads to the page, which only this user can read: the address with its token is no argument of a program, which
/// `ps` would show. It is gone when this is.
pub struct Redirect(#[expect(dead_code, reason = "removes the file")] NamedTempFile);

/// Whether there is a desktop of this very person in front of this computer.
pub fn is_desktop(variable: impl Fn(&str) -> Option<OsString>) -> bool {
    let is_set = |name: &str| variable(name).is_some_and(|value| !value.is_empty());
    let is_far = is_set("SSH_CONNECTION") || is_set("SSH_TTY");
    (is_set("DISPLAY") || is_set("WAYLAND_DISPLAY")) && !is_far && !is_root()
}

#[cfg(target_os = "linux")]
fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

#[cfg(not(target_os = "linux"))]
fn is_root() -> bool {
    false
}

/// Opens `url`, by way of a file in `folder`: a browser from a snap sees a person's own folders, not those for temporary files.
///
/// # Errors
/// When the file cannot be written, or there is no `xdg-open`.
pub fn open(url: &str, folder: &Path) -> io::Result<Redirect> {
    // Such files are their user's alone (0600).
    let mut file = tempfile::Builder::new().prefix("open-page-").suffix(".html").tempfile_in(folder)?;
    writeln!(
        file,
        "<!doctype html><meta charset=\"utf-8\"><meta name=\"referrer\" content=\"no-referrer\">\
         <meta http-equiv=\"refresh\" content=\"0; url={url}\"><title>evcal live</title>"
    )?;
    file.flush()?;
    let mut opener = Command::new("xdg-open")
        .arg(file.path())
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()?;
    // Some browsers do not return until they are closed.
    thread::spawn(move || opener.wait());
    Ok(Redirect(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_person_in_front_of_a_desktop_gets_a_browser() {
        let with = |names: &[&str]| is_desktop(|name| names.contains(&name).then(|| OsString::from(":0")));
        for names in [&[][..], &["DISPLAY", "SSH_CONNECTION"], &["WAYLAND_DISPLAY", "SSH_TTY"], &["SSH_CONNECTION"]] {
            assert!(!with(names), "{names:?}");
        }
        for names in [&["DISPLAY"][..], &["WAYLAND_DISPLAY"], &["DISPLAY", "WAYLAND_DISPLAY"]] {
            assert_eq!(with(names), !is_root(), "{names:?}");
        }
        assert!(!is_desktop(|_| Some(OsString::new())));
    }
}

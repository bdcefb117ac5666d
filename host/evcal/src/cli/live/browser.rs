//! Opening the page in a browser.

use std::ffi::OsString;
use std::io::{self, Write as _};
use std::path::Path;
use std::process::{Command, Stdio};
use std::thread;

use tempfile::NamedTempFile;

/// A file that redirects a browser to the page; dropping this removes it. Only this user can read the file: as an argument of a program, the
/// URL with its access token would appear in the list of processes.
pub struct Redirect(#[expect(dead_code, reason = "removes the file")] NamedTempFile);

/// Returns whether this user has a desktop on this computer.
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

/// Opens `url` through a file in `folder`: a browser from a snap cannot read the folder for temporary files.
///
/// # Errors
/// The file cannot be written, or there is no `xdg-open`.
pub fn open(url: &str, folder: &Path) -> io::Result<Redirect> {
    // Temporary files have the permissions 0600.
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
    fn a_browser_opens_only_on_the_desktop_of_this_computer() {
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

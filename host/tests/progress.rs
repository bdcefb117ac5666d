//! What somebody sees who waits: a bar on a terminal, a line for each stage in a pipe.
#![cfg(unix)]
#![expect(unsafe_code, reason = "ends of a terminal are handed on")]

use std::fs::File;
use std::io::Read;
use std::os::fd::{FromRawFd, IntoRawFd};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use serialport::TTYPort;
use tempfile::TempDir;

fn recording() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).with_file_name("fixtures").join("board/events.dvraw")
}

fn convert(output: &str, directory: &TempDir) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    command.arg("convert").arg(recording()).arg(directory.path().join(output));
    command
}

#[test]
fn a_pipe_gets_a_line_for_each_stage() {
    let directory = TempDir::new().unwrap();
    let output = convert("events.aedat4", &directory).output().unwrap();
    assert!(output.status.success());
    let expected = format!("evcal: converting {} ...\n", recording().display());
    assert_eq!(String::from_utf8(output.stderr).unwrap(), expected);
    let output = convert("other.aedat4", &directory).arg("--json").output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty());
}

#[test]
fn a_terminal_gets_a_bar() {
    let directory = TempDir::new().unwrap();
    let (computer, terminal) = TTYPort::pair().unwrap();
    // SAFETY: both descriptors are owned by their port, and given away.
    let (mut computer, terminal) =
        unsafe { (File::from_raw_fd(computer.into_raw_fd()), Stdio::from_raw_fd(terminal.into_raw_fd())) };
    let mut child = convert("events.csv", &directory).stderr(terminal).stdout(Stdio::null()).spawn().unwrap();
    let reading = std::thread::spawn(move || {
        let (mut seen, mut part) = (Vec::new(), [0; 4096]);
        // The end of a terminal is an error.
        while let Ok(count @ 1..) = computer.read(&mut part) {
            seen.extend_from_slice(&part[..count]);
        }
        seen
    });
    assert!(child.wait().unwrap().success());
    let seen = String::from_utf8_lossy(&reading.join().unwrap()).into_owned();
    let bars: Vec<&str> = seen.split(['\r', '\n']).filter(|line| line.contains(" % ")).collect();
    let parts: std::collections::BTreeSet<&str> =
        bars.iter().filter_map(|line| line.split(" % ").next()?.rsplit([' ', '░']).next()).collect();
    assert!(parts.len() > 3, "{seen}");
    assert!(bars.iter().any(|line| line.contains("converting")), "{seen}");
}

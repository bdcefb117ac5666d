//! What somebody sees who waits: a bar on a terminal, a line for each stage in a pipe.
#![cfg(unix)]
#![expect(unsafe_code, reason = "ends of a terminal are handed on")]

use std::fs::File;
use std::io::Read;
use std::ops::ControlFlow;
use std::os::fd::{FromRawFd, IntoRawFd};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use evcal_calibrate::calibrate::error::CalibrateError;
use evcal_calibrate::calibrate::input::Input;
use evcal_calibrate::calibrate::step::Step;
use evcal_calibrate::calibrate::{Task, calibrate};
use event_recordings::{Recording, RecordingOptions};
use serialport::TTYPort;
use tempfile::TempDir;

fn recording() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/board/events.dvraw"))
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
    let expected = "evcal: converting events.dvraw ...\n";
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

/// Words and the part that is done.
type Told = Vec<(String, Option<f64>)>;

/// What a calibration tells until `end` has heard enough, and how it ended.
fn told(end: impl Fn(&Step) -> bool + Sync) -> (Told, Result<(), CalibrateError>) {
    let inputs: [Input; 1] = [Recording::new(recording(), RecordingOptions::default()).unwrap().into()];
    let board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
    let mut told = Vec::new();
    let calibrated = calibrate(&Task::new(&inputs, &board), |step| {
        told.push((step.text.to_owned(), step.done));
        if end(&step) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    (told, calibrated.map(|_| ()))
}

#[test]
fn each_round_of_the_solve_has_a_bar_that_never_goes_back() {
    let (told, calibrated) = told(|_| false);
    calibrated.unwrap();
    let is_round = |text: &str| text.starts_with("joint solve, round ");
    let rounds: Vec<_> = told.chunk_by(|a, b| a.0 == b.0).filter(|steps| is_round(&steps[0].0)).collect();
    assert!(rounds.len() > 1);
    for steps in rounds {
        let done: Vec<f64> = steps.iter().map(|(_, done)| done.unwrap()).collect();
        assert!(done.is_sorted() && done[0] == 0.0 && (0.9..=1.0).contains(&done[done.len() - 1]), "{done:?}");
        // In association and solve.
        assert!(done.iter().any(|done| (0.05..0.25).contains(done)), "{done:?}");
        assert!(done.iter().any(|done| (0.4..0.9).contains(done)), "{done:?}");
    }
}

#[test]
fn a_solve_can_be_ended_between_two_iterations() {
    let (told, calibrated) = told(|step| step.text.starts_with("joint solve") && step.done > Some(0.4));
    assert!(matches!(calibrated, Err(CalibrateError::Stopped)));
    let (text, done) = &told[told.len() - 1];
    assert!(text == "joint solve, round 1" && *done < Some(0.95), "{text}: {done:?}");
}

//! Progress: a bar on a terminal, one line per stage in a pipe.
#![cfg(unix)]
#![expect(unsafe_code, reason = "the ends of a terminal become streams of a child process")]

use std::fs::File;
use std::io::Read;
use std::ops::ControlFlow;
use std::os::fd::{FromRawFd, IntoRawFd};
use std::path::PathBuf;
use std::process::{Command, Stdio};

use evcal_calibrate::calibrate::calibrate;
use evcal_calibrate::task::Task;
use evcal_calibrate::task::error::CalibrateError;
use evcal_calibrate::task::input::Input;
use evcal_calibrate::task::step::Step;
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
        // At the end of a terminal, reading fails.
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

/// Texts of the steps, with the share that is done.
type Steps = Vec<(String, Option<f64>)>;

/// Calibrates until `end` returns true; returns the steps and the result.
fn steps_until(end: impl Fn(&Step) -> bool + Sync) -> (Steps, Result<(), CalibrateError>) {
    let inputs: [Input; 1] = [Recording::new(recording(), RecordingOptions::default()).unwrap().into()];
    let board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
    let mut printed = Vec::new();
    let calibrated = calibrate(&Task::new(&inputs, &board), |step| {
        printed.push((step.text.to_owned(), step.done));
        if end(&step) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    (printed, calibrated.map(|_| ()))
}

#[test]
fn each_round_of_the_solve_has_a_bar_that_never_goes_back() {
    let (printed, calibrated) = steps_until(|_| false);
    calibrated.unwrap();
    let is_round = |text: &str| text.starts_with("joint solve, round ");
    let rounds: Vec<_> = printed.chunk_by(|a, b| a.0 == b.0).filter(|steps| is_round(&steps[0].0)).collect();
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
    let (printed, calibrated) = steps_until(|step| step.text.starts_with("joint solve") && step.done > Some(0.4));
    assert!(matches!(calibrated, Err(CalibrateError::Stopped)));
    let (text, done) = &printed[printed.len() - 1];
    assert!(text == "joint solve, round 1" && *done < Some(0.95), "{text}: {done:?}");
}

//! `evcal live`.

use std::fs;
use std::io::IsTerminal;
use std::ops::ControlFlow;

use evcal::live::recorder::{Moment, RecordingStatus, record};
use evcal::live::{Seen, Tilt, Watcher};

use super::calibrate::{CalibrationArguments, calibrate_recordings};
use super::camera_arguments::CameraArguments;
use super::interrupt::Interrupt;
use super::{print, progress, record as recording};

/// Name of the recording in the folder of the results.
const RECORDING: &str = "recording.dvraw";

/// Arguments of `evcal live`.
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    calibration: CalibrationArguments,
    #[command(flatten)]
    camera: CameraArguments,
}

/// Runs `evcal live`: records while it looks for the board, then calibrates from the recording as
/// `evcal calibrate` does.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let CalibrationArguments { method, output, json, .. } = &arguments.calibration;
    let board = &method.board;
    let settings = method.settings()?;
    let interrupt = Interrupt::catch()?;
    let mut camera = arguments.camera.open()?;
    fs::create_dir_all(output).map_err(|error| format!("{}: {error}", output.display()))?;
    let path = output.join(RECORDING);
    let mut watcher = Watcher::start(&settings, board, &camera.header());
    let bar = progress::spinner(*json);
    let lines = !*json && !std::io::stderr().is_terminal();
    let mut printed = Ok(());
    let mut enough = false;
    let report = record(&mut camera, &path, &arguments.camera.plan(), |moment| {
        match moment {
            Moment::Transfer(transfer) => watcher.take(transfer),
            Moment::Status(status) => {
                let seen = watcher.seen();
                enough = seen.coverage.missing().is_empty();
                let text = as_text(status, &seen);
                if lines && printed.is_ok() {
                    printed = print::line(&text);
                }
                bar.set_message(text);
            }
            Moment::Silence => {}
        }
        if enough || interrupt.is_asked() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    interrupt.release();
    bar.finish_and_clear();
    printed?;
    let seen = watcher.finish();
    if !json {
        print::line(recording::summary(&report))?;
        let missing = seen.coverage.missing();
        if !missing.is_empty() {
            print::line(format!("still missing: {}", missing.join(", ")))?;
        }
    }
    drop(camera);
    let calibrated = calibrate_recordings(&[path], None, &arguments.calibration);
    // That the camera was unplugged does not keep what it sent from being used.
    calibrated.and(recording::good_end(&report))
}

/// One line: how the recording goes, and what was seen of the board.
fn as_text(status: &RecordingStatus, seen: &Seen) -> String {
    let coverage = &seen.coverage;
    let tilts: Vec<String> =
        Tilt::ALL.iter().zip(coverage.tilts()).map(|(tilt, count)| format!("{} {count}", tilt.name())).collect();
    let missing = coverage.missing();
    let advice = if missing.is_empty() { "enough".to_owned() } else { format!("show {}", missing.join(", ")) };
    format!(
        "{:.0} s, {}; {} boards, {:.0} % of the sensor, tilts {}; {} transfers not displayed; {advice}",
        status.seconds,
        recording::as_text(status),
        coverage.boards(),
        100.0 * coverage.covered(),
        tilts.join(" "),
        seen.left_out
    )
}

//! `evcal live`.

use std::io::IsTerminal;

use evcal::live::recorder::RecordingStatus;
use evcal::live::{Seen, Tilt, Watcher, record_board};
use evcal::recording::RecordingOptions;

use super::calibrate::{CalibrationArguments, calibrate_recordings};
use super::camera_arguments::CameraArguments;
use super::interrupt::Interrupt;
use super::{NotGoodEnough, print, progress, record as recording};

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
    let CalibrationArguments { method, json, .. } = &arguments.calibration;
    let board = &method.board;
    let settings = method.settings()?;
    let interrupt = Interrupt::catch()?;
    let folder = arguments.calibration.open_folder()?;
    let mut camera = arguments.camera.open()?;
    let path = folder.path().join(RECORDING);
    let mut watcher = Watcher::start(&settings.detection, &settings.live, board, &camera.header());
    let bar = progress::spinner(*json);
    let lines = !*json && !std::io::stderr().is_terminal();
    let mut printed = Ok(());
    let plan = arguments.camera.plan();
    let report = record_board(
        &mut camera,
        &path,
        &plan,
        &mut watcher,
        || interrupt.is_asked(),
        |status, seen| {
            let text = as_text(status, seen);
            if lines && printed.is_ok() {
                printed = print::line(&text);
            }
            bar.set_message(text);
        },
    )?;
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
    let calibrated = calibrate_recordings(&[path], &RecordingOptions::default(), &arguments.calibration, &folder);
    // That the camera was unplugged does not keep what it sent from being used.
    match calibrated {
        Err(error) if !error.is::<NotGoodEnough>() => Err(error),
        calibrated => recording::good_end(&report).and(calibrated),
    }
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

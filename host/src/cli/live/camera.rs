//! `evcal live` with a camera.

use evcal::files::folder::OutputFolder;
use evcal::live::checkpoint::Telling;
use evcal::live::picture::PictureFeed;
use evcal::live::{Watcher, record_board};
use evcal::page::view::Losses;
use evcal::recording::RecordingOptions;
use evcal::settings::Settings;
use evcal_core::sensor::Sensor;

use super::super::calibrate::{CalibrationArguments, calibrate_recordings};
use super::super::interrupt::Interrupt;
use super::super::{NotGoodEnough, print, record as recording};
use super::lines::Lines;
use super::{Arguments, checkpoint, open_window};

/// Name of the recording in the folder of the results.
const RECORDING: &str = "recording.dvraw";

/// Records until enough was seen, then calibrates.
pub fn run(
    arguments: &Arguments,
    settings: &Settings,
    folder: &OutputFolder,
    interrupt: &Interrupt,
) -> super::super::Outcome {
    let CalibrationArguments { method, json, .. } = &arguments.calibration;
    let board = method.choose_board(&[], &RecordingOptions::default(), &settings.detection)?;
    let mut camera = arguments.camera.open()?;
    let header = camera.header();
    let sensor: Sensor = header.registers.layout().dvs.size().into();
    let path = folder.path().join(RECORDING);
    let checkpoints =
        checkpoint::start(arguments, settings, &board, &path, &RecordingOptions::default(), Telling::WhenReady)?;
    let mut watcher =
        Watcher::start(&settings.detection, &settings.initial, &settings.live, &board, &header, checkpoints);
    let window = open_window(arguments)?;
    let feed = window.as_ref().map(|window| {
        let (mut screen, latest) = (window.screen(), watcher.latest());
        PictureFeed::start(&header, move |picture| screen.show(picture, &latest))
    });
    let mut lines = Lines::new(*json);
    let report = record_board(
        &mut camera,
        &path,
        &arguments.camera.plan(),
        &mut watcher,
        || interrupt.is_asked() || window.as_ref().is_some_and(super::Window::is_finish_asked),
        |transfer| {
            if let Some(feed) = &feed {
                feed.take(transfer);
            }
        },
        |status, seen| {
            if let Some(window) = &window {
                window.set_losses(Losses { dropped: Some(status.dropped), not_shown: seen.left_out });
            }
            lines.tell(seen, Some(status));
        },
    )?;
    interrupt.release();
    drop(feed);
    lines.finish()?;
    let seen = watcher.finish();
    if let Some(window) = &window {
        window.calibrating(sensor, &seen);
    }
    if !json {
        print::line(recording::summary(&report))?;
        let missing = seen.missing();
        if !missing.is_empty() {
            print::line(format!("still wanted: {}", missing.join(", ")))?;
        }
    }
    drop(camera);
    let calibrated = calibrate_recordings(&[path], &RecordingOptions::default(), &arguments.calibration, settings, folder);
    if let Some(window) = window {
        window.finish(sensor, &seen, folder, &calibrated);
    }
    // That the camera was unplugged does not keep what it sent from being used.
    match calibrated {
        Err(error) if !error.is::<NotGoodEnough>() => Err(error),
        calibrated => recording::good_end(&report).and(calibrated),
    }
}

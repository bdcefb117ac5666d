//! `evcal live` with a recording: a whole one, or one that arrives.

use std::ops::ControlFlow;

use evcal_calibrate::advice::Advice;
use evcal_calibrate::check::units::unusual_beginning;
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::PictureUse;
use evcal_detection::detection::search::sensor_of;
use evcal_files::folder::OutputFolder;
use evcal_files::remedy::Words;
use evcal_live::checkpoint::ReportTime;
use evcal_live::latest::Latest;
use evcal_live::observer::Observer;
use evcal_live::replay::replay;
use evcal_live::wanted::words;
use event_recordings::Recording;

use super::super::calibrate::{CameraRecordings, calibrate_recordings};
use super::super::interrupt::Interrupt;
use super::super::print;
use super::super::progress::Waiting;
use super::incoming::Incoming;
use super::lines::Lines;
use super::{Arguments, checkpoint, open_window};

/// A replay shows the result of a checkpoint when its time in the recording is this factor times the length of the
/// checkpoint. At about this time the result would be known during a live recording.
const SHOWN_AT_LENGTH: f64 = 1.5;

/// The recording of a session.
pub enum Source {
    /// It is complete, and is played at the requested speed.
    Whole(Recording),
    /// It is being written, and is shown as it arrives.
    Incoming(Incoming),
}

/// Plays a recording until it is good enough, then calibrates from all of it.
pub fn run(
    arguments: &Arguments,
    source: Source,
    settings: &Settings,
    folder: &OutputFolder,
    interrupt: &Interrupt,
) -> super::super::Outcome {
    let json = arguments.calibration.json;
    let options = arguments.source.options();
    let (recording, speed) = match &source {
        Source::Whole(recording) => (recording, arguments.speed.times()),
        Source::Incoming(incoming) => (&incoming.recording, None),
    };
    let path = recording.path();
    // A recording that is being written cannot be read ahead for its sensor and board.
    let (sensor, known, report_time) = match &source {
        Source::Whole(_) => (sensor_of(recording)?, vec![path.to_owned()], ReportTime::AtLength(SHOWN_AT_LENGTH)),
        Source::Incoming(incoming) => (incoming.sensor, Vec::new(), ReportTime::WhenReady),
    };
    if let (Source::Whole(_), Some(other)) = (&source, unusual_beginning(recording)) {
        print::aside(format!("{other}: {}", Advice::NameTimeUnit(other.unit).worded(&Words::PROGRAM)));
    }
    let method = &arguments.calibration.method;
    let board = &method.choose_board(&known, &options, PictureUse::default(), &settings.detection)?.board;
    let checkpoints = checkpoint::start(arguments, settings, board, &[], path, &options, report_time)?;
    let observer = Observer::new(&settings.detection, &settings.initial, &settings.live, board, sensor)
        .with_checkpoints(checkpoints);
    let latest = Latest::new(observer.seen());
    let with_frames = matches!(source, Source::Whole(_)).then(|| recording.clone());
    let has_frames = with_frames.as_ref().is_some_and(Recording::may_contain_frames);
    let window = open_window(arguments, folder, has_frames)?;
    let mut screen = window.as_ref().map(|window| window.screen(with_frames));
    let mut lines = Lines::new(json, arguments.mirror);
    let report = replay(
        recording,
        sensor,
        speed,
        observer,
        &latest,
        |seen| lines.print_hint(seen, None),
        |picture| {
            if let Some(screen) = &mut screen {
                screen.show(picture, &latest);
            }
            let is_over = interrupt.is_asked() || window.as_ref().is_some_and(super::Window::is_finish_asked);
            if is_over { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        },
    )?;
    let stored = match &source {
        Source::Whole(_) => Ok(()),
        Source::Incoming(incoming) => incoming.end(),
    };
    interrupt.release();
    lines.finish()?;
    let seen = &report.seen;
    if let Some(window) = &window {
        window.calibrating(sensor, seen);
    }
    if !json {
        print::line(match seen.is_enough() {
            true => format!("the recording is good enough after {:.1} s", seen.t),
            false => format!(
                "{:.1} s; still missing: {}",
                report.seconds,
                words(&seen.missing(), arguments.mirror).join(", ")
            ),
        })?;
    }
    if let Some(damage) = &report.damage {
        print::aside(damage);
    }
    let calibrated = calibrate_recordings(
        CameraRecordings::alone(&[path.to_owned()]),
        &options,
        &arguments.calibration,
        settings,
        folder,
        Waiting::of_stages(json).and(window.as_ref().map(|window| window.step_listener(sensor, seen))),
    );
    if let Some(window) = window {
        window.finish(sensor, seen, folder, &calibrated, false);
    }
    calibrated.and(stored)
}

//! `evcal live` with a camera.

use std::path::{Path, PathBuf};
use std::thread;

use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::PictureUse;
use evcal_core::sensor::Sensor;
use evcal_files::folder::OutputFolder;
use evcal_geometry::board::Board;
use evcal_live::checkpoint::ReportTime;
use evcal_live::page::Next;
use evcal_live::page::view::Losses;
use evcal_live::picture::PictureFeed;
use evcal_live::recorder::{RecorderReport, RecordingPlan};
use evcal_live::wanted::words;
use evcal_live::{Memory, Seen, Watcher, record_board};
use event_recordings::RecordingOptions;
use usb_davis::device::Camera;
use usb_davis::dump::Growth;

use super::super::interrupt::Interrupt;
use super::super::progress::Waiting;
use super::super::{Failure, print, record as recording};
use super::ahead::{Ahead, Shared};
use super::lines::Lines;
use super::window::Window;
use super::{Arguments, checkpoint, open_window};

/// Returns the name of a recording in the folder of the results; from the second on, it contains a number.
fn name(number: usize) -> String {
    match number {
        1 => "recording.dvraw".to_owned(),
        _ => format!("recording-{number}.dvraw"),
    }
}

/// Records until the recording is good enough, then calibrates; repeats this as often as the user wants.
pub fn run(
    arguments: &Arguments,
    settings: &Settings,
    folder: &OutputFolder,
    interrupt: &Interrupt,
) -> super::super::Outcome {
    let board = arguments
        .calibration
        .method
        .choose_board(&[], &RecordingOptions::default(), PictureUse::default(), &settings.detection)?
        .board;
    // The camera is opened before the page, so that a missing camera is reported first.
    let mut opened = Some(arguments.camera.open()?);
    let window = open_window(arguments, folder, arguments.camera.has_frames())?;
    // The recordings that are calibrated together.
    let (mut recordings, mut memory) = (Vec::new(), None);
    for number in 1.. {
        let camera = match opened.take() {
            Some(camera) => camera,
            None => arguments.camera.open()?,
        };
        let path = folder.path().join(name(number));
        let shared = Shared::default();
        let before = recordings.clone();
        recordings.push(path.clone());
        let recorded = thread::scope(|scope| {
            let calibration = &arguments.calibration;
            let ahead = Ahead::start(scope, &before, &path, board, calibration, settings, &shared);
            let session = Session { arguments, settings, board: &board, interrupt, window: window.as_ref() };
            let recorded = session.record(camera, &before, &path, &shared.growth, memory.take())?;
            let listener = window.as_ref().map(|window| window.step_listener(recorded.sensor, &recorded.seen));
            let waiting = Waiting::of_stages(calibration.json).and(listener);
            let calibrated = ahead.finish(&recordings, calibration, settings, folder, waiting);
            Ok::<_, Failure>((recorded, calibrated))
        });
        let (Recorded { sensor, seen, report, memory: remembered }, calibrated) = recorded?;
        let next = window.as_ref().map(|window| window.finish(sensor, &seen, folder, &calibrated, true));
        match next {
            Some(Next::Again) => recordings.clear(),
            Some(Next::Add) => memory = remembered,
            // If the camera was disconnected, the calibration uses the data before that.
            Some(Next::Close) | None => {
                return match calibrated {
                    Err(failure) if !failure.is_negative() => Err(failure),
                    calibrated => recording::good_end(&report).and(calibrated),
                };
            }
        }
        interrupt.hold();
    }
    Ok(())
}

/// A finished recording.
struct Recorded {
    sensor: Sensor,
    seen: Seen,
    report: RecorderReport,
    memory: Option<Memory>,
}

/// The parts of a session that are the same for each recording.
#[derive(Clone, Copy)]
struct Session<'a> {
    arguments: &'a Arguments,
    settings: &'a Settings,
    board: &'a Board,
    interrupt: &'a Interrupt,
    window: Option<&'a Window>,
}

impl Session<'_> {
    /// Records `camera` into `path` until the recording is good enough together with the recordings `before`, whose observations are in `memory`.
    fn record(
        self,
        mut camera: Camera,
        before: &[PathBuf],
        path: &Path,
        growth: &Growth,
        memory: Option<Memory>,
    ) -> Result<Recorded, Failure> {
        let Self { arguments, settings, board, interrupt, window } = self;
        let json = arguments.calibration.json;
        let header = camera.header();
        let sensor: Sensor = header.registers.layout().dvs.size().into();
        let checkpoints = checkpoint::start(
            arguments,
            settings,
            board,
            before,
            path,
            &RecordingOptions::default(),
            ReportTime::WhenReady,
        )?;
        let mut watcher =
            Watcher::start(&settings.detection, &settings.initial, &settings.live, board, &header, checkpoints, memory);
        if let Some(window) = window {
            window.begin(before.len());
        }
        let feed = window.map(|window| {
            let (screen, latest) = (window.screen(None), watcher.latest());
            PictureFeed::start(&header, window.frames_wanted(), move |picture, frame| {
                screen.show_with(picture, frame, &latest);
            })
        });
        let mut lines = Lines::new(json, arguments.mirror);
        let report = record_board(
            &mut camera,
            path,
            &RecordingPlan { growth: growth.clone(), ..arguments.camera.plan() },
            &mut watcher,
            || interrupt.is_asked() || window.is_some_and(Window::is_finish_asked),
            |transfer| {
                if let Some(feed) = &feed {
                    feed.take(transfer);
                }
            },
            |status, seen| {
                if let Some(window) = window {
                    let not_drawn = feed.as_ref().map_or(0, PictureFeed::left_out);
                    window.set_losses(Losses { dropped: Some(status.dropped), not_searched: seen.left_out, not_drawn });
                }
                lines.print_hint(seen, Some(status));
            },
        )?;
        // The calibration continues at once, before the display has ended.
        growth.end();
        interrupt.release();
        drop(feed);
        lines.finish()?;
        let (seen, memory) = watcher.finish();
        if let Some(window) = window {
            window.calibrating(sensor, &seen);
        }
        if !json {
            print::line(recording::summary(&report))?;
            let missing = words(&seen.missing(), arguments.mirror);
            if !missing.is_empty() {
                print::line(format!("still missing: {}", missing.join(", ")))?;
            }
        }
        Ok(Recorded { sensor, seen, report, memory })
    }
}

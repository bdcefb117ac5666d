//! The calibration that follows a recording. It begins during the recording and reads the file as it grows, so that only the solve remains
//! at the end. The result is the same as from `evcal calibrate` with the file.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};
use std::thread::{Scope, ScopedJoinHandle};

use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::PictureUse;
use evcal_calibrate::task::board_choice::confirm_board;
use evcal_calibrate::task::input::Input;
use evcal_geometry::board::Board;
use evcal_live::background::workers;
use event_recordings::{Recording, RecordingOptions};
use usb_davis::dump::Growth;

use super::super::calibrate::fixed::FixedCameras;
use super::super::calibrate::work::{Attempt, Work};
use super::super::calibrate::{CalibrationArguments, CameraRecordings, calibrate_recordings};
use super::super::progress::Waiting;
use evcal_files::folder::OutputFolder;

/// State that the calibrating thread shares with its starter.
#[derive(Default)]
pub struct Shared {
    /// Length of the recording that is written so far.
    pub growth: Growth,
    stop: AtomicBool,
    /// Progress, which is shown after the recording ended.
    waiting: Mutex<Option<Waiting>>,
}

/// A running calibration.
pub struct Ahead<'scope, 'env> {
    shared: &'env Shared,
    thread: Option<ScopedJoinHandle<'scope, Option<(Work<'env>, Attempt)>>>,
}

impl<'scope, 'env> Ahead<'scope, 'env> {
    /// Starts a calibration from the finished recordings `before` and the growing one at `path`; `shared` contains its length.
    pub fn start(
        scope: &'scope Scope<'scope, 'env>,
        before: &'env [PathBuf],
        path: &'env Path,
        board: Board,
        arguments: &'env CalibrationArguments,
        settings: &'env Settings,
        shared: &'env Shared,
    ) -> Self {
        let work = move || {
            let options = RecordingOptions::default();
            let growing = Recording::growing(path, options.clone(), shared.growth.clone()).ok()?;
            let mut inputs = Vec::new();
            for path in before {
                inputs.push(Input::open(path, &options, &board).ok()?);
            }
            inputs.push(growing.into());
            let parameters = arguments.parameters().ok()?;
            let work = Work {
                inputs,
                others: Vec::new(),
                rolling_shutter: false,
                fixed: FixedCameras::default(),
                confirmed: board.into(),
                sensor: None,
                parameters,
                arguments,
                settings,
                // Until the recording ends, the calibration only reads and searches for the board.
                readers: Some(workers("reading ahead").ok()?),
            };
            // The threads of the display must not wait for the calibration.
            let pool = rayon::ThreadPoolBuilder::new().build().ok()?;
            let attempt = pool.install(|| {
                work.calibrate(|step| {
                    if shared.stop.load(Ordering::Relaxed) {
                        return ControlFlow::Break(());
                    }
                    if let Some(waiting) = shared.waiting.lock().unwrap_or_else(PoisonError::into_inner).as_mut() {
                        waiting.stage(step.text, step.done);
                    }
                    ControlFlow::Continue(())
                })
            });
            Some((work, attempt))
        };
        Self { shared, thread: Some(scope.spawn(work)) }
    }

    /// Ends the recording, waits for the calibration, writes and prints it. If it could not be started, or if the recordings show
    /// another board, calibrates now.
    pub fn finish(
        mut self,
        recordings: &[PathBuf],
        arguments: &CalibrationArguments,
        settings: &Settings,
        folder: &OutputFolder,
        waiting: Waiting,
    ) -> super::super::Outcome {
        self.shared.growth.end();
        let lock = || self.shared.waiting.lock().unwrap_or_else(PoisonError::into_inner);
        *lock() = Some(waiting);
        let made = self.thread.take().and_then(|thread| match thread.join() {
            Ok(made) => made,
            Err(panic) => std::panic::resume_unwind(panic),
        });
        let waiting = lock().take();
        // The board of the session was not compared with a recording.
        let made = made.filter(|(work, _)| is_confirmed(&work.confirmed.board, recordings, settings));
        match (made, waiting) {
            (Some((work, attempt)), Some(waiting)) => work.finish(attempt, waiting, folder),
            (_, waiting) => calibrate_recordings(
                CameraRecordings::alone(recordings),
                &RecordingOptions::default(),
                arguments,
                settings,
                folder,
                waiting.unwrap_or_else(|| Waiting::of_stages(arguments.json)),
            ),
        }
    }
}

impl Drop for Ahead<'_, '_> {
    fn drop(&mut self) {
        // After an error, nobody waits for the calibration.
        self.shared.stop.store(true, Ordering::Relaxed);
        self.shared.growth.end();
    }
}

/// Returns `true` if the tags of a board are in the recordings as stated. Boards without tags cannot be mistaken for others.
fn is_confirmed(board: &Board, recordings: &[PathBuf], settings: &Settings) -> bool {
    let has_tags = matches!(board, Board::Squares(squares) if !squares.tags().is_empty());
    let opened = recordings.iter().map(|path| Recording::new(path, RecordingOptions::default()));
    let Ok(opened) = opened.collect::<Result<Vec<Recording>, _>>() else { return true };
    let all: Vec<&Recording> = opened.iter().collect();
    !has_tags
        || confirm_board(board, &all, PictureUse::default(), &settings.detection)
            .is_ok_and(|confirmed| confirmed.board == *board && confirmed.finding.is_none())
}

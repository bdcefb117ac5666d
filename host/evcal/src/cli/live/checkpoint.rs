//! Checkpoints: calibrations of the first seconds of a recording, with the options of the command line.

use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use evcal_calibrate::calibrate::beginning::calibrate_beginning;
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::Task;
use evcal_calibrate::task::input::Input;
use evcal_calibrate::task::step::Step;
use evcal_files::remedy::{Remedy as _, Words};
use evcal_geometry::board::Board;
use evcal_live::checkpoint::{Checkpoints, ReportTime, ReportedAccuracy, RunningCalibration};
use evcal_solve::initial::model_choice::ModelRequest;
use event_recordings::{Recording, RecordingOptions};

use super::Arguments;

/// The inputs and options of a checkpoint.
struct Work {
    /// Earlier, finished recordings, which are calibrated together with this one.
    before: Vec<PathBuf>,
    recording: PathBuf,
    options: RecordingOptions,
    board: Board,
    model: ModelRequest,
    settings: Settings,
}

/// Starts checkpoints of the file `recording`, which need not exist yet, together with the recordings `before`.
pub fn start(
    arguments: &Arguments,
    settings: &Settings,
    board: &Board,
    before: &[PathBuf],
    recording: &Path,
    options: &RecordingOptions,
    report_time: ReportTime,
) -> io::Result<Checkpoints> {
    let work = Work {
        before: before.to_vec(),
        recording: recording.to_owned(),
        options: options.clone(),
        board: *board,
        model: arguments.calibration.method.model(),
        settings: settings.clone(),
    };
    let (target, first) = (settings.live.target, settings.live.first_checkpoint());
    Checkpoints::start(report_time, target, first, move |seconds, running| work.state(seconds, running))
}

impl Work {
    /// Calibrates the first `seconds`; returns the reported uncertainty, or the reason of a failure.
    fn state(&self, seconds: f64, running: &RunningCalibration) -> Result<ReportedAccuracy, String> {
        let recording =
            Recording::new(&self.recording, self.options.clone()).map_err(|error| error.advised(&Words::PROGRAM))?;
        let before = self.before.iter().map(|path| Input::open(path, &self.options, &self.board));
        let before: Vec<Input> = before.collect::<Result<_, _>>().map_err(|error| error.advised(&Words::PROGRAM))?;
        let task = Task {
            model: self.model,
            sensor: self.options.sensor,
            settings: &self.settings,
            ..Task::new(&before, &self.board)
        };
        let go_on = |step: Step| {
            running.report(step.text, step.done);
            if running.is_stopped() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let calibrated =
            calibrate_beginning(&recording, seconds, &task, go_on).map_err(|error| error.advised(&Words::PROGRAM))?;
        let split_half = calibrated.events().and_then(|events| events.quality.split_half.as_ref());
        let projection = &calibrated.quality.projection;
        Ok(ReportedAccuracy {
            rms: projection.rms,
            max: projection.max,
            halves_agree: split_half.is_some_and(|halves| halves.consistent()),
        })
    }
}

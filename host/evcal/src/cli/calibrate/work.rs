//! One calibration: its inputs, the calibration itself, and its output.

use std::io::IsTerminal as _;
use std::ops::ControlFlow;
use std::path::Path;

use evcal_calibrate::calibrate::calibrate;
use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::calibrate::inertia::calibrate_inertial;
use evcal_calibrate::calibrate::second::{
    calibrate_against_first, calibrate_lens_separately, calibrate_own_pictures, picture_use_of_second,
};
use evcal_calibrate::quality::verdict::{Cause, Grade};
use evcal_calibrate::result::device_verdicts::{device_verdicts, worst_grade};
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::board_choice::{ConfirmedBoard, LargerBoard, larger_board};
use evcal_calibrate::task::error::CalibrateError;
use evcal_calibrate::task::input::Input;
use evcal_calibrate::task::parameter_request::ParameterRequests;
use evcal_calibrate::task::step::Step;
use evcal_calibrate::task::{PictureUse, Task};
use evcal_core::sensor::Sensor;
use evcal_files::folder::OutputFolder;
use evcal_files::remedy::{Remedy, Words};
use evcal_files::visible;
use evcal_report::output::failure::write_failure;
use evcal_report::output::folder::{Written, write_folder};
use evcal_report::output::summary::Summary;
use evcal_solve::initial::model_choice::ModelRequest;
use evcal_solve::solve::fixed_intrinsics::FixedIntrinsics;
use rayon::ThreadPool;

use super::super::progress::Waiting;
use super::super::{Failure, Negative, Outcome, command_line, print};
use super::CalibrationArguments;
use super::fixed::{FixedCameras, OtherSensor};

/// Another camera on the mount.
pub struct Other {
    /// Its recording.
    pub input: Input,
    /// Its sensor size, if the recording does not contain it.
    pub sensor: Option<Sensor>,
    /// Its camera model.
    pub model: ModelRequest,
}

/// The inputs and options of a calibration.
pub struct Work<'a> {
    /// Recordings of the first camera, or its circles.
    pub inputs: Vec<Input>,
    /// Other cameras on the mount.
    pub others: Vec<Other>,
    /// `true` if the other cameras have a rolling shutter.
    pub rolling_shutter: bool,
    /// Cameras whose intrinsics are fixed in the solve with an IMU or other cameras.
    pub fixed: FixedCameras,
    /// The board in the recordings.
    pub confirmed: ConfirmedBoard,
    /// Sensor size, if the recordings do not contain it.
    pub sensor: Option<Sensor>,
    /// Parameters that are fixed or always estimated.
    pub parameters: ParameterRequests,
    /// Options of the command line.
    pub arguments: &'a CalibrationArguments,
    /// Settings of all stages.
    pub settings: &'a Settings,
    /// Threads that read the recordings; `None` to use the threads of the calibration.
    pub readers: Option<ThreadPool>,
}

/// A finished or failed calibration, before its results are written.
pub struct Attempt {
    calibrated: Result<Calibrated, CalibrateError>,
    /// Stages in the order in which they began.
    stages: Vec<String>,
}

impl Work<'_> {
    fn task<'a>(&'a self, command_line: &'a str) -> Task<'a> {
        let CalibrationArguments { frames_only, joint_frames, with_frames, .. } = self.arguments;
        let pictures = match (frames_only, joint_frames, with_frames) {
            (true, ..) => PictureUse::Only,
            (_, true, _) => PictureUse::Joint,
            (.., true) => PictureUse::SecondCamera,
            // The images in the bag are of another camera.
            _ if self
                .others
                .iter()
                .any(|Other { input, .. }| matches!(input, Input::Images(_)) && self.is_of_first(input)) =>
            {
                PictureUse::Ignore
            }
            (false, false, false) => PictureUse::CrossCheck,
        };
        Task {
            inputs: &self.inputs,
            board: &self.confirmed.board,
            board_finding: self.confirmed.finding.as_ref(),
            model: self.arguments.method.model(),
            sensor: self.sensor,
            pictures,
            parameters: self.parameters,
            settings: self.settings,
            command_line,
            words: &Words::PROGRAM,
            readers: self.readers.as_ref(),
        }
    }

    /// Returns whether the recording of another camera is in a file of the first camera.
    fn is_of_first(&self, other: &Input) -> bool {
        self.inputs.iter().any(|input| input.is_of_file_of(other))
    }

    /// Prints the assumptions of the readers, which the summary contains after a successful calibration.
    fn print_assumptions(&self) {
        for input in &self.inputs {
            if let Input::Events(recording) = input
                && let Ok(reader) = recording.open()
            {
                let notes = &reader.information().notes;
                notes.iter().for_each(|note| print::aside(format!("{}: {note}", input.short_name())));
            }
        }
    }

    /// Calibrates. `progress` receives each step, and can cancel.
    pub fn calibrate(&self, mut progress: impl FnMut(Step) -> ControlFlow<()> + Send) -> Attempt {
        let mut stages: Vec<String> = Vec::new();
        let calibrated = calibrate(&self.task(&command_line()), |step| {
            if stages.last().is_none_or(|last| last != step.text) {
                stages.push(step.text.to_owned());
            }
            progress(step)
        });
        Attempt { calibrated, stages }
    }

    /// Prints the result, the verdict last.
    fn print_result(&self, written: &Written, calibrated: &Calibrated, folder: &Path) -> Outcome {
        let Summary { details, result, verdict, notes } = &written.summary;
        let more = match (self.arguments.verbose, notes) {
            (true, _) => {
                print::line(details)?;
                print::line(format!("\n{}", written.stage_report))?;
                String::new()
            }
            (false, 0) => "; --verbose prints all figures".to_owned(),
            (false, 1) => "; --verbose prints all figures and a note".to_owned(),
            (false, notes) => format!("; --verbose prints all figures and {notes} notes"),
        };
        print::styled(coloured(&visible::lines(result), calibrated))?;
        let report = visible::path(folder.join("report.html"));
        print::line(format!("open {report} first; all results are in {}{more}", visible::path(folder)))?;
        print::styled(coloured(&visible::lines(verdict), calibrated))
    }

    /// Calibrates the IMU and the other cameras, writes the results or the failure into `folder`, and prints them.
    pub fn finish(&self, attempt: Attempt, mut waiting: Waiting, folder: &OutputFolder) -> Outcome {
        let command_line = command_line();
        let task = self.task(&command_line);
        let mut calibrated = match attempt.calibrated {
            Ok(calibrated) => calibrated,
            Err(error) => {
                waiting.finish();
                if !self.arguments.json {
                    self.print_assumptions();
                }
                let text = error.advised(&Words::PROGRAM);
                let written = write_failure(folder.path(), &task, &error, text, attempt.stages)?;
                return Err(Failure::of_calibration(&error, written));
            }
        };
        let inertial = self.add_inertial(&mut calibrated, &task, &mut waiting);
        let others = self.add_others(&mut calibrated, &task, &mut waiting);
        waiting.stage("results", None);
        let written = write_folder(folder, &calibrated, &task, &mut |step| waiting.stage(step.text, step.done))?;
        waiting.finish();
        if self.arguments.json {
            print::whole(&written.json)?;
        } else {
            self.print_result(&written, &calibrated, folder.path())?;
        }
        let is_reported = calibrated.verdict.findings.iter().any(|finding| finding.cause == Cause::LargerBoard);
        if calibrated.verdict.grade == Grade::NotGood
            && !is_reported
            && let Some(LargerBoard { found, board }) = self
                .confirmed
                .board
                .circles()
                .and_then(|board| larger_board(&self.inputs, board, &self.settings.detection))
        {
            print::aside(format!("check the board: the recording shows {found}, --board {board}"));
        }
        // The results of the camera are written nevertheless.
        let failed: Vec<NotCalibrated> = inertial.err().into_iter().chain(others).collect();
        if !failed.is_empty() {
            return Err(Failure::plain(in_words(&failed)));
        }
        match worst_grade(&calibrated) {
            Grade::NotGood if !self.arguments.accept_any => Err(Negative::Calibration.into()),
            _ => Ok(()),
        }
    }
}

/// The IMU or another camera that was not calibrated, with the reason.
struct NotCalibrated {
    what: String,
    reason: Failure,
}

/// Describes what was not calibrated. A failure of one does not prevent the calibration of the others.
fn in_words(failed: &[NotCalibrated]) -> String {
    let line = |NotCalibrated { what, reason }: &NotCalibrated| match reason.advised() {
        reason if reason.starts_with(what.as_str()) => format!("\n  {reason}"),
        reason => format!("\n  {what}: {reason}"),
    };
    match failed {
        // The reason contains the name.
        [alone] => alone.reason.advised(),
        several => format!("{} were not calibrated:{}", several.len(), several.iter().map(line).collect::<String>()),
    }
}

impl Work<'_> {
    /// Calibrates the IMU, if this is requested, and adds it to the camera.
    fn add_inertial(
        &self,
        calibrated: &mut Calibrated,
        task: &Task,
        waiting: &mut Waiting,
    ) -> Result<(), NotCalibrated> {
        let added = self.add_imu(calibrated, task, waiting);
        added.map_err(|reason| NotCalibrated { what: "the IMU".to_owned(), reason })
    }

    fn add_imu(&self, calibrated: &mut Calibrated, task: &Task, waiting: &mut Waiting) -> Outcome {
        let Some(request) = self.arguments.inertial_request() else { return Ok(()) };
        waiting.stage("IMU", None);
        let found = calibrate_inertial(task, calibrated, &request, self.fixed_of_first(calibrated)?);
        Ok(calibrated.add_inertial(found)?)
    }

    fn fixed_of_first(&self, first: &Calibrated) -> Result<Option<&FixedIntrinsics>, OtherSensor> {
        self.fixed.first.as_ref().map(|fixed| fixed.of(first.sensor)).transpose()
    }

    /// Calibrates the other cameras, and adds them to the first; returns the cameras that failed.
    fn add_others(&self, first: &mut Calibrated, task: &Task, waiting: &mut Waiting) -> Vec<NotCalibrated> {
        let mut failed = Vec::new();
        if task.pictures == PictureUse::SecondCamera
            && let Err(reason) = self.add_own_frames(first, waiting)
        {
            failed.push(NotCalibrated { what: "the camera's own frames".to_owned(), reason });
        }
        for (number, other) in self.others.iter().enumerate() {
            if let Err(reason) = self.add_other(first, number, other, task, waiting) {
                failed.push(NotCalibrated { what: other.input.name(), reason });
            }
        }
        failed
    }

    fn add_own_frames(&self, first: &mut Calibrated, waiting: &mut Waiting) -> Outcome {
        waiting.stage("frames as a second camera", None);
        let found = calibrate_own_pictures(first, self.fixed_of_first(first)?);
        Ok(first.add_second(found)?)
    }

    fn add_other(
        &self,
        first: &mut Calibrated,
        number: usize,
        other: &Other,
        task: &Task,
        waiting: &mut Waiting,
    ) -> Outcome {
        let Other { input, sensor, model } = other;
        let inputs = std::slice::from_ref(input);
        let pictures = picture_use_of_second(&self.inputs, input);
        let parameters = ParameterRequests::default();
        let task = Task { inputs, pictures, parameters, sensor: *sensor, model: *model, ..*task };
        let second = calibrate_lens_separately(&task, |step| {
            waiting.stage(step.text, step.done);
            ControlFlow::Continue(())
        });
        let second =
            second.map_err(|error| Failure::plain(format!("{}: {}", input.name(), error.advised(&Words::PROGRAM))))?;
        waiting.stage("both cameras", None);
        let fixed = self.fixed.others.get(number).map(|fixed| fixed.of(second.sensor)).transpose()?;
        let lenses = [self.fixed_of_first(first)?, fixed];
        let found = calibrate_against_first(first, &second, input, self.rolling_shutter, &self.confirmed.board, lenses);
        Ok(first.add_second(found)?)
    }
}

/// Returns the summary; on a terminal, its verdicts are in green, yellow or red.
fn coloured(summary: &str, calibrated: &Calibrated) -> String {
    if !std::io::stdout().is_terminal() || std::env::var_os("NO_COLOR").is_some() {
        return summary.to_owned();
    }
    let of_camera = (calibrated.verdict.grade, calibrated.verdict.sentence.clone());
    let others = device_verdicts(calibrated).into_iter().map(|other| (other.grade, other.sentence));
    std::iter::once(of_camera).chain(others).fold(summary.to_owned(), |summary, (grade, sentence)| {
        let colour = match grade {
            Grade::Good => 32,
            Grade::Usable => 33,
            Grade::NotGood => 31,
        };
        summary.replacen(&sentence, &format!("\x1b[{colour}m{sentence}\x1b[0m"), 1)
    })
}

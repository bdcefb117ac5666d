//! What the calibration does with the camera's own frames.

use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
use evcal_core::sensor::Sensor;

use super::detected::common_sensor;
use super::error::CalibrateError;
use super::{Calibrated, StageReports, Task};
use crate::calibrate::input::Input;
use crate::circles::reference_frame::ReferenceFrame;
use crate::detection::DetectionReport;
use crate::detection::pictures::search::{FrameDetection, FrameDetectionReport};
use crate::initial::InitialModel;
use crate::initial::model_choice::{CANDIDATES, ModelRequest, choose_model};
use crate::picture_calibration::calibration::{FrameCalibration, NoFrameCalibration, calibrate_frames};
use crate::picture_calibration::joint::{JointPoints, joint_points};
use crate::recording::pass::RecordingReport;
use crate::solve::event_bias::bias::Biases;
use crate::solve::event_bias::{CLASS_COUNT, unknown};
use crate::solve::refinement::Refined;
use crate::solve::residual_statistics::ResidualStatistics;
use crate::solve::{FreeParameters, Problem, SolveError, State};
use crate::trajectory::segment::SegmentReport;
use crate::trust::Trust;
use crate::trust::coverage::coverage_of;
use crate::trust::residual_map::ResidualMap;
use crate::trust::uncertainty::Uncertainty;
use crate::trust::uncertainty::projection::projection_uncertainty;
use crate::trust::verdict::verdict;
use crate::trust::witness::{FrameOutcome, frame_witness};

/// The reference frames of all recordings' pictures.
pub(super) struct SeenFrames {
    frames: Vec<ReferenceFrame>,
    report: FrameDetectionReport,
    /// For each input the time from which its frames' times count (s).
    starts: Vec<f64>,
}

/// Looks for the board in all pictures. Their times count from `starts` (s), or else from the first
/// picture of each recording.
pub(super) fn see_frames(
    task: &Task,
    starts: Option<&[f64]>,
    progress: &mut impl FnMut(&str),
) -> Result<SeenFrames, CalibrateError> {
    let fewest = task.settings.detection.fewest_circles(&task.board.pattern);
    let mut detection = FrameDetection::new(task.board, fewest, &task.settings.frames);
    let mut origins = Vec::new();
    for (number, input) in task.inputs.iter().enumerate() {
        let start = starts.and_then(|starts| starts.get(number)).map(|start| (start * 1e6).round() as i64);
        let origin = match input {
            Input::Events(recording) if recording.may_hold_frames() => {
                progress(&format!("looking for the board in the frames of {}", input.name()));
                detection.search(recording, number, start)?
            }
            _ => start.unwrap_or(0),
        };
        origins.push(origin as f64 * 1e-6);
    }
    let (frames, report) = detection.finish();
    Ok(SeenFrames { frames, report, starts: origins })
}

/// The calibration from `seen` alone; `None` where the recordings hold no frames.
pub(super) fn frame_calibration(
    task: &Task,
    seen: SeenFrames,
    sensor: Sensor,
    model: ModelKind,
    progress: &mut impl FnMut(&str),
) -> Option<Result<FrameCalibration, NoFrameCalibration>> {
    if seen.report.frames == 0 {
        return None;
    }
    progress(&format!("calibration from {} frames", seen.frames.len()));
    Some(calibrate_frames(seen.frames, seen.report, task.board, sensor, model, task.settings))
}

/// Compares the result from events with that from frames.
pub(super) fn outcome(
    task: &Task,
    camera: &Camera<f64>,
    uncertainty: &Uncertainty,
    sensor: Sensor,
    frames: &Result<FrameCalibration, NoFrameCalibration>,
) -> FrameOutcome {
    let calibration = match frames {
        Ok(calibration) => calibration,
        Err(silent) => return FrameOutcome::Silent(silent.clone()),
    };
    let witness = frame_witness(camera, &uncertainty.covariance, calibration, sensor, &task.settings.frames);
    witness.map_or_else(FrameOutcome::Silent, |witness| FrameOutcome::Witness(Box::new(witness)))
}

/// The calibration from frames, which there must be.
pub(super) fn needed<'a>(
    task: &Task,
    frames: Option<&'a Result<FrameCalibration, NoFrameCalibration>>,
) -> Result<&'a FrameCalibration, CalibrateError> {
    match frames {
        Some(Ok(calibration)) => Ok(calibration),
        Some(Err(silent)) => Err(CalibrateError::Frames(silent.clone())),
        None => Err(no_frames(task)),
    }
}

/// The centres of dots in the frames as observations for the joint solve, tied to the trajectories of
/// `refined`.
pub(super) fn observations(
    task: &Task,
    refined: &Refined,
    uncertainty: &Uncertainty,
    calibration: &FrameCalibration,
) -> Result<JointPoints, CalibrateError> {
    joint_points(calibration, &refined.state, uncertainty.inflation, task.board, &task.settings.frames)
        .map_err(CalibrateError::JointFrames)
}

fn no_frames(task: &Task) -> CalibrateError {
    let files: Vec<String> = task.inputs.iter().map(Input::name).collect();
    CalibrateError::NoFrames { file: files.join(", ") }
}

/// Calibrates from the camera's own frames alone, as ordinary image calibration does: each frame has
/// its own pose. `progress` is told what is going on, in words.
///
/// # Errors
/// [`CalibrateError`] says what is missing, and what to do.
pub fn calibrate_from_frames(task: &Task, mut progress: impl FnMut(&str)) -> Result<Calibrated, CalibrateError> {
    let sensor = common_sensor(task)?;
    let seen = see_frames(task, None, &mut progress)?;
    let starts = seen.starts.clone();
    let (model, model_choice) = match task.model {
        ModelRequest::Given(model) => (model, None),
        ModelRequest::Auto => {
            let (stage, choice) = (&task.settings.initial, &task.settings.model_choice);
            let told = |model| progress(&format!("initial model {model} from {} frames", seen.frames.len()));
            let (initial, choice) = choose_model(&seen.frames, task.board, sensor, &CANDIDATES, stage, choice, told)?;
            (initial.camera.kind(), Some(choice))
        }
    };
    let found = frame_calibration(task, seen, sensor, model, &mut progress);
    let calibration = needed(task, found.as_ref())?;
    let of_recording = |number: usize| calibration.frames.iter().filter(move |frame| frame.recording == number);
    let recordings = (0..task.inputs.len())
        .map(|number| {
            let end = of_recording(number).map(|frame| frame.end).fold(0.0, f64::max);
            let notes = if number == 0 { calibration.report.detection.notes.clone() } else { Vec::new() };
            RecordingReport { count: of_recording(number).count() as u64, duration: end, notes }
        })
        .collect();
    let residuals =
        ResidualStatistics { count: calibration.report.dots_used, rms: calibration.rms, median: calibration.median };
    let state = State {
        camera: calibration.camera,
        bias: unknown(task.settings.refinement.first_sigma),
        trajectories: Vec::new(),
    };
    let reports = StageReports {
        recordings,
        detection: DetectionReport::default(),
        initial: calibration.initial.report.clone(),
        model_choice,
        segments: SegmentReport::default(),
        segments_without_spline: 0,
        rounds: Vec::new(),
    };
    let trust = trust(task, calibration, sensor)?;
    let verdict = verdict(&calibration.camera, &trust, task.board, sensor, Vec::new(), &task.settings.verdict);
    let problem = Problem {
        sensor,
        circle_centers: (0..task.board.circle_count()).map(|index| task.board.circle_center(index).into()).collect(),
        radius: task.board.radius,
        mean_scale: 1.0,
        point_sigma: calibration.spread,
        associated_latencies: [0.0; CLASS_COUNT],
        segments: Vec::new(),
        free: FreeParameters { intrinsics: [false; MAX_PARAMETERS], biases: [Biases::default(); CLASS_COUNT] },
        settings: task.settings.solve.clone(),
    };
    Ok(Calibrated {
        sensor,
        refined: Refined { state, problem, residuals, rounds: Vec::new() },
        initial: InitialModel { frames: calibration.posed.clone(), ..calibration.initial.clone() },
        frames: calibration.frames.clone(),
        starts,
        witness: Some(FrameOutcome::Only(Box::new(calibration.summary()))),
        joint: None,
        reports,
        trust,
        verdict,
    })
}

/// How far a calibration from frames alone can be trusted.
fn trust(task: &Task, calibration: &FrameCalibration, sensor: Sensor) -> Result<Trust, CalibrateError> {
    let projection = projection_uncertainty(&calibration.camera, &calibration.covariance, sensor)
        .map_err(|_| CalibrateError::Solve(SolveError::Singular))?;
    let frames = || calibration.posed.iter().filter_map(|posed| calibration.frames.get(posed.frame));
    let of_recording = |number: usize| frames().filter(move |frame| frame.recording == number).map(ReferenceFrame::t);
    let duration = (0..task.inputs.len())
        .map(|number| {
            let (first, last) = (of_recording(number).next(), of_recording(number).next_back());
            first.zip(last).map_or(0.0, |(first, last)| last - first)
        })
        .sum();
    let pixels = calibration.posed.iter().flat_map(|posed| posed.circles.iter().map(|circle| circle.center.into()));
    let poses = calibration.posed.iter().map(|posed| posed.pose);
    Ok(Trust {
        uncertainty: Uncertainty {
            covariance: calibration.covariance.clone(),
            bias_sigma: [Biases::default(); CLASS_COUNT],
            inflation: calibration.inflation,
            observations: calibration.report.dots_used,
            blocks: calibration.report.used,
        },
        projection,
        coverage: coverage_of(&calibration.camera, sensor, task.board, pixels, poses, duration),
        split_half: None,
        residuals: ResidualMap::default(),
        radius: None,
    })
}

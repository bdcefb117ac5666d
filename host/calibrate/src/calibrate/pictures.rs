//! Use of the camera's own pictures in the calibration.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::DVector;

use super::calibrated::{Calibrated, Evidence};
use super::detected::common_sensor;
use super::first_model::{FirstModel, model_of};
use crate::calibrate::findings::orientation;
use crate::calibrate::solves::board_solve::BoardSolve;
use crate::calibrate::solves::fixed_values::contradicted_by_pictures;
use crate::picture_calibration::alignment::{Misalignment, misalignment};
use crate::picture_calibration::calibration::{
    NoPictureCalibration, PictureCalibration, PictureReport, PictureSource, calibrate_pictures,
};
use crate::picture_calibration::joint::{JointPoints, joint_points};
use crate::picture_calibration::uneven_board::{UnevenBoard, uneven_board};
use crate::quality::cross_check::{CrossCheckOutcome, FailedCrossCheck, NoCrossCheck, cross_check_pictures};
use crate::quality::examine_pictures;
use crate::quality::uncertainty::Uncertainty;
use crate::quality::uncertainty::projection::projection_uncertainty;
use crate::quality::verdict::{Cause, Finding, Severity, verdict};
use crate::task::PictureUse;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::input::Input;
use crate::task::progress::Progress;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::detection::pictures::pixel_pattern::{PixelPattern, PixelResiduals};
use evcal_detection::detection::pictures::point_fits::{KnownCamera, PointFits};
use evcal_detection::detection::pictures::search::{
    BoardPicture, FoundInPictures, MadeOf, PictureSearch, PictureSearchReport,
};
use evcal_geometry::lens::projection_difference::projection_difference;
use evcal_solve::initial::model_choice::{ModelChoice, ModelRequest, USUAL};
use evcal_solve::solve::refinement::Refined;
use event_recordings::pass::RecordingReport;
use event_recordings::pictures::TimedImage;

/// The reference frames of all recordings' pictures.
pub(super) struct SeenPictures {
    pub(super) frames: Vec<ReferenceFrame>,
    /// For each frame its picture; empty if its points are not measured again.
    pub(super) pictures: Vec<BoardPicture>,
    pub(super) report: PictureSearchReport,
    /// For each input the start of its frames' times (s).
    pub(super) starts: Vec<f64>,
}

/// Facts about the inputs before their pictures are read.
#[derive(Clone, Copy, Default)]
pub(super) struct Files<'a> {
    /// Start of the times of each input's pictures (s); `None` for the time of its first picture.
    pub(super) starts: Option<&'a [f64]>,
    /// For each input, `true` if it is known to contain no pictures; may be empty.
    pub(super) without_pictures: &'a [bool],
    /// Duration of the events of all inputs (s); 0 if unknown.
    pub(super) duration: f64,
}

/// Number of pictures in the cross-check of a short recording. Their calibration is about as precise as the one from the events.
const CHECKED: f64 = 90.0;
/// Number of pictures with the board below which all pictures are searched.
const FEWEST_CHECKED: usize = 45;
/// Longest time between pictures in the cross-check (s). The check of the alignment of pictures and events compares
/// their clocks over only a few seconds.
const LONGEST_BETWEEN: f64 = 0.25;

/// The calibration from pictures, or the reason why it failed.
pub(super) type CalibratedPictures = Result<PictureCalibration, NoPictureCalibration>;

/// The camera's own pictures, in addition to its events.
pub(super) struct PicturesWithEvents {
    /// The calibration from them alone.
    pub(super) calibrated: CalibratedPictures,
    /// Misalignment of pictures and events of the same moment.
    pub(super) misalignment: Option<Misalignment>,
}

/// Calibrates from the pictures of recordings that also contain events, if the task requires it. Returns `None` without pictures,
/// or if they are useless.
///
/// # Errors
/// [`CalibrateError`] if the task requires the pictures and there is no calibration from them, or if pictures and
/// `windows` of events show the board at different positions.
pub(super) fn calibrate_pictures_with_events(
    task: &Task,
    files: Files,
    windows: &[ReferenceFrame],
    sensor: Sensor,
    model: ModelKind,
    progress: &Progress,
) -> Result<Option<PicturesWithEvents>, CalibrateError> {
    let is_needed = match task.pictures {
        PictureUse::Ignore | PictureUse::Only => return Ok(None),
        PictureUse::CrossCheck => false,
        PictureUse::Joint | PictureUse::SecondCamera => true,
    };
    let seen = if is_needed { see_pictures(task, files, 0, progress)? } else { see_enough(task, files, progress)? };
    let misalignment = misalignment(windows, &seen.frames, task.board, sensor);
    if let Some(misalignment) = misalignment.filter(|_| is_needed) {
        return Err(CalibrateError::PicturesMisaligned(misalignment));
    }
    let calibrated = picture_calibration(task, &seen, PictureSource::Frames, sensor, model, progress)?;
    if is_needed {
        require(task, calibrated.as_ref())?;
    }
    Ok(calibrated.map(|calibrated| PicturesWithEvents { calibrated, misalignment }))
}

/// Searches for the board in as many pictures as a cross-check needs, spread evenly over the recordings.
fn see_enough(task: &Task, files: Files, progress: &Progress) -> Result<SeenPictures, CalibrateError> {
    let interval = (1e6 * (files.duration / CHECKED).min(LONGEST_BETWEEN)).round() as i64;
    let seen = see_pictures(task, files, interval, progress)?;
    if seen.frames.len() < FEWEST_CHECKED && seen.report.passed_over > 0 {
        return see_pictures(task, files, 0, progress);
    }
    Ok(seen)
}

/// Searches for the board in the first picture of each `interval` (µs), or in all if that is 0.
fn see_pictures(task: &Task, files: Files, interval: i64, progress: &Progress) -> Result<SeenPictures, CalibrateError> {
    let Files { starts, without_pictures: without, .. } = files;
    let fewest = task.settings.detection.fewest_circles(&task.board.lattice());
    let mut detection = PictureSearch::new(task.board, MadeOf::Light, fewest, task.settings.frames.max_radius)
        .in_intervals_of(interval);
    let mut origins = Vec::new();
    for (number, input) in task.inputs.iter().enumerate() {
        let start = starts.and_then(|starts| starts.get(number)).map(|start| (start * 1e6).round() as i64);
        if let (Input::Circles { frames, start, .. }, PictureUse::Only) = (input, task.pictures) {
            detection.take(number, frames);
            origins.push(*start);
            continue;
        }
        let origin = if may_contain_pictures(input) && without.get(number) != Some(&true) {
            progress.report(format!("looking for frames with the board in {}", input.short_name()))?;
            detection.search(number, start, |visit| visit_pictures(input, visit))?
        } else {
            start.unwrap_or(0)
        };
        origins.push(origin as f64 * 1e-6);
    }
    let FoundInPictures { frames, pictures, report } = detection.finish();
    Ok(SeenPictures { frames, pictures, report, starts: origins })
}

fn may_contain_pictures(input: &Input) -> bool {
    match input {
        Input::Events(recording) => recording.may_contain_frames(),
        Input::Images(_) => true,
        Input::Circles { .. } => false,
    }
}

/// Passes the pictures of `input` to `visit` in order of time. Returns a sentence about a part that could not be read.
fn visit_pictures(input: &Input, visit: &mut dyn FnMut(TimedImage)) -> Result<Option<String>, CalibrateError> {
    match input {
        Input::Events(recording) => Ok(recording.visit_frames(visit)?),
        Input::Images(images) => Ok(images.visit(visit)?),
        Input::Circles { .. } => Ok(None),
    }
}

/// Largest and smallest number of calibrations from the same pictures, each with the points measured with the lens and the
/// pixels' pattern of the one before. The third is the first with a pattern.
const MOST_PASSES: usize = 7;
const FEWEST_PASSES: usize = 3;
/// The points are final if the camera's last change, as a share of its uncertainty, is less than this. The error of a lens
/// shifts corners alike in all pictures, so the scatter between pictures does not show what is left of it. It becomes
/// about ten times smaller with each pass.
const LEAST_CHANGE: f64 = 0.2;

/// The change of the lens by a board that is not as described, over the uncertainty, from which on it is no chance.
const UNEVEN: f64 = 3.0;

/// Calibrates from `seen` alone; `None` if the recordings contain no frames.
///
/// # Errors
/// [`CalibrateError`] if the frames cannot be read again.
fn picture_calibration(
    task: &Task,
    seen: &SeenPictures,
    source: PictureSource,
    sensor: Sensor,
    model: ModelKind,
    progress: &Progress,
) -> Result<Option<CalibratedPictures>, CalibrateError> {
    if seen.report.frames == 0 {
        return Ok(None);
    }
    // The calibration from pictures cannot be cancelled. A request to cancel takes effect after it.
    let _ = progress.report(format!("calibration from {} {source}", seen.frames.len()));
    let calibrate = |frames, report| {
        let (initial, fixed) = (&task.settings.initial, &task.parameters.fixed_intrinsics);
        let report = PictureReport { source, detection: report, ..PictureReport::default() };
        calibrate_pictures(frames, report, task.board, sensor, model, initial, fixed)
    };
    let mut calibrated = calibrate(seen.frames.clone(), seen.report.clone());
    let fits = point_fits(task, source);
    let mut pattern = PixelPattern::none(sensor);
    for pass in 2..=MOST_PASSES {
        let (Some(fits), Ok(before)) = (&fits, &mut calibrated) else { break };
        let mut frames = std::mem::take(&mut before.frames);
        let known = KnownCamera::new(&before.camera, &pattern);
        let mut beyond = PixelResiduals::none(sensor);
        measure_again(task, fits, &known, &mut beyond, &mut frames, &seen.pictures, progress)?;
        pattern = beyond.pattern();
        let (camera, report) = (before.camera, before.report.detection.clone());
        calibrated = calibrate(frames, report);
        if pass >= FEWEST_PASSES && calibrated.as_ref().is_ok_and(|now| is_settled(&camera, now, sensor)) {
            break;
        }
    }
    Ok(Some(calibrated))
}

/// Returns `true` if the camera `now` differs from the one `before` by much less than its uncertainty.
fn is_settled(before: &Camera<f64>, now: &PictureCalibration, sensor: Sensor) -> bool {
    let change = projection_difference(before, &now.camera, sensor);
    let expected = projection_uncertainty(&now.camera, &now.covariance, sensor);
    matches!((change, expected), (Ok(change), Ok(expected)) if change.rms < LEAST_CHANGE * expected.rms)
}

/// Returns the fits of points; `None` if the pictures are made of events.
fn point_fits(task: &Task, source: PictureSource) -> Option<PointFits> {
    match source {
        PictureSource::Frames => PointFits::new(task.board),
        PictureSource::StillViews => None,
    }
}

/// Measures the points in all frames again with the `known` camera, and adds what the pixels show beyond the board to
/// `beyond`.
fn measure_again(
    task: &Task,
    fits: &PointFits,
    known: &KnownCamera<'_>,
    beyond: &mut PixelResiduals,
    frames: &mut [ReferenceFrame],
    mut pictures: &[BoardPicture],
    progress: &Progress,
) -> Result<(), CalibrateError> {
    // Frames are in the order of the recordings.
    for frames in frames.chunk_by_mut(|a, b| a.recording == b.recording) {
        let (of_recording, rest) = pictures.split_at_checked(frames.len()).unwrap_or((pictures, &[]));
        pictures = rest;
        let input = frames.first().and_then(|frame| task.inputs.get(frame.recording));
        let Some(input) = input.filter(|input| may_contain_pictures(input)) else { continue };
        progress.report(format!("{} in {}", fits.points(), input.short_name()))?;
        let hand_on = |visit: &mut dyn FnMut(TimedImage)| visit_pictures(input, visit);
        fits.measure_again(known, beyond, frames, of_recording, hand_on)?;
    }
    Ok(())
}

/// Compares the result from events with the one from pictures.
pub(super) fn cross_check(solve: &BoardSolve, sensor: Sensor, pictures: &PicturesWithEvents) -> CrossCheckOutcome {
    // The pictures are calibrated with the nominal board, so they are compared with the result for that board.
    let (camera, certainty) = match &solve.with_nominal_board {
        Some((camera, certainty)) => (camera, certainty),
        None => (&solve.refined.state.camera, &solve.certainty),
    };
    let covariance = &certainty.intrinsics.covariance;
    let misalignment = pictures.misalignment;
    let calibration = match &pictures.calibrated {
        Ok(calibration) => calibration,
        Err(NoPictureCalibration { reason, report }) => {
            let reason = NoCrossCheck::NoCalibration(reason.clone());
            return CrossCheckOutcome::Failed(FailedCrossCheck { reason, misalignment, report: report.clone() });
        }
    };
    match cross_check_pictures(camera, covariance, calibration, sensor, misalignment) {
        Ok(cross_check) => CrossCheckOutcome::Compared(Box::new(cross_check)),
        Err(reason) => {
            let report = Box::new(calibration.report.clone());
            CrossCheckOutcome::Failed(FailedCrossCheck { reason, misalignment, report })
        }
    }
}

/// Returns the calibration from pictures, or an error if it failed.
pub(super) fn require<'a>(
    task: &Task,
    pictures: Option<&'a CalibratedPictures>,
) -> Result<&'a PictureCalibration, CalibrateError> {
    match pictures {
        Some(Ok(calibration)) => Ok(calibration),
        Some(Err(failure)) => Err(CalibrateError::Pictures(failure.clone())),
        None => Err(no_pictures(task)),
    }
}

/// Returns the centres of dots in the pictures as observations of the joint solve, assigned to the trajectories of `refined`.
pub(super) fn observations(
    task: &Task,
    refined: &Refined,
    uncertainty: &Uncertainty,
    calibration: &PictureCalibration,
) -> Result<JointPoints, CalibrateError> {
    joint_points(calibration, &refined.state, uncertainty.inflation, task.board).map_err(CalibrateError::JointPictures)
}

fn no_pictures(task: &Task) -> CalibrateError {
    let files: Vec<String> = task.inputs.iter().map(Input::name).collect();
    let passed_over = |input: &Input| match input {
        Input::Events(recording) => recording.open_extras().ok()?.passed_over(),
        _ => None,
    };
    CalibrateError::NoPictures { file: files.join(", "), passed_over: task.inputs.iter().find_map(passed_over) }
}

/// Calibrates from the camera's own pictures alone, like an ordinary camera calibration: each picture has its own pose.
///
/// # Errors
/// [`CalibrateError`] names the problem and the remedy.
pub(super) fn calibrate(task: &Task, progress: &Progress) -> Result<Calibrated, CalibrateError> {
    let sensor = common_sensor(task)?;
    let seen = see_pictures(task, Files::default(), 0, progress)?;
    let recordings = (0..task.inputs.len()).map(|number| recording_report(task, &seen, number)).collect();
    calibrate_seen(task, seen, PictureSource::Frames, sensor, recordings, progress)
}

/// Calibrates from pictures that show the board.
///
/// # Errors
/// [`CalibrateError`] names the problem.
pub(super) fn calibrate_seen(
    task: &Task,
    seen: SeenPictures,
    source: PictureSource,
    sensor: Sensor,
    recordings: Vec<RecordingReport>,
    progress: &Progress,
) -> Result<Calibrated, CalibrateError> {
    if task.parameters.has_board() {
        return Err(CalibrateError::BoardOfPictures);
    }
    let starts = seen.starts.clone();
    let choose = |frames: &[ReferenceFrame]| -> Result<(ModelKind, Option<ModelChoice>), CalibrateError> {
        let request = task.model();
        if let ModelRequest::Given(model) = request {
            return Ok((model, None));
        }
        match model_of(task, frames, sensor, source, progress) {
            Ok(FirstModel { initial, choice }) => Ok((initial.camera.kind(), choice)),
            // The calibration fails too, and its error describes the pictures.
            Err(CalibrateError::Initial(_)) if request == ModelRequest::Usual => Ok((USUAL, None)),
            Err(error) => Err(error),
        }
    };
    let calibrate_with = |seen: &SeenPictures, model: ModelKind| {
        picture_calibration(task, seen, source, sensor, model, progress)?.ok_or_else(|| no_pictures(task))?.map_err(
            match source {
                PictureSource::Frames => CalibrateError::Pictures,
                PictureSource::StillViews => CalibrateError::Views,
            },
        )
    };
    let (mut model, mut model_choice) = choose(&seen.frames)?;
    let mut calibration = calibrate_with(&seen, model)?;
    if model_choice.is_some() && source == PictureSource::Frames && task.board.circles().is_none() {
        // The bias of the first corners may have decided the choice.
        let first = model;
        (model, model_choice) = choose(&calibration.frames)?;
        if model != first {
            calibration = calibrate_with(&SeenPictures { frames: calibration.frames, ..seen }, model)?;
        }
    }
    progress.go_on()?;
    let mut quality = examine_pictures(&calibration, task.board, sensor).map_err(CalibrateError::Solve)?;
    let mut findings = Vec::from_iter(orientation::finding_on(task.board, sensor));
    findings.extend(task.board_finding.cloned());
    findings.extend(contradicted_by_pictures(task, &calibration, sensor, quality.projection.rms_95));
    if let Some(finding) = take_uneven_board(task, &mut calibration, sensor, quality.projection.rms) {
        findings.push(finding);
        quality = examine_pictures(&calibration, task.board, sensor).map_err(CalibrateError::Solve)?;
    }
    let verdict = verdict(&calibration.camera, &quality, None, task.board, sensor, findings, &task.settings.verdict);
    let evidence = Evidence::Pictures(Box::new(calibration));
    Ok(Calibrated { sensor, starts, recordings, model_choice, quality, verdict, evidence, inertial: None })
}

/// If the board of `calibration` is not as it is described, adds what this does to the lens to its covariance, and returns the
/// finding. `expected` is the uncertainty of the projection without it (px).
fn take_uneven_board(
    task: &Task,
    calibration: &mut PictureCalibration,
    sensor: Sensor,
    expected: f64,
) -> Option<Finding> {
    let UnevenBoard { camera, farthest } =
        uneven_board(calibration, task.board, sensor, &task.parameters.fixed_intrinsics)?;
    let change = projection_difference(&calibration.camera, &camera, sensor).ok()?.rms;
    if change < UNEVEN * expected {
        return None;
    }
    let [from, to] = [&calibration.camera, &camera].map(Camera::parameters);
    let difference = DVector::from_column_slice(&to) - DVector::from_column_slice(&from);
    calibration.covariance += &difference * difference.transpose();
    Some(Finding {
        cause: Cause::UnevenBoard,
        severity: Severity::Warning,
        reason: format!(
            "the board is not as described: its points are up to {:.2} mm from their places, which changes the projection by {change:.3} px",
            1e3 * farthest
        ),
        advice: "is it flat, and are its lengths right? A calibration from events estimates a smooth bend".into(),
    })
}

/// Returns the contents of recording `number`: pictures with the board, up to the end of the last.
fn recording_report(task: &Task, seen: &SeenPictures, number: usize) -> RecordingReport {
    let of_recording = || seen.frames.iter().filter(move |frame| frame.recording == number);
    let duration = of_recording().map(|frame| frame.end).fold(0.0, f64::max);
    let notes = if number == 0 { seen.report.notes.clone() } else { Vec::new() };
    let information = match task.inputs.get(number) {
        Some(Input::Events(recording)) => recording.open().ok().map(|reader| reader.information().clone()),
        _ => None,
    };
    let (camera_name, began) = information.map(|known| (known.camera_name, known.began)).unwrap_or_default();
    RecordingReport { count: of_recording().count() as u64, duration, camera_name, began, notes }
}

//! Calibration of other cameras on the mount, after the first.

use std::ops::ControlFlow;

use super::calibrate;
use super::calibrated::{Calibrated, EventCalibration, Evidence};
use super::mounted::{SecondCamera, SecondFrames};
use crate::second_camera::calibration::SecondCalibration;
use crate::second_camera::error::SecondCameraError;
use crate::second_camera::frames::{FrameCamera, SeenFrame, calibrate_frames};
use crate::second_camera::joint::Lenses;
use crate::second_camera::{Pictures, SeparateCalibration, calibrate_pictures_against, calibrate_second};
use crate::settings::Settings;
use crate::task::PictureUse;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::input::Input;
use crate::task::step::Step;
use evcal_detection::circles::reference_frame::{ObservedCircle, PointObservation, ReferenceFrame};
use evcal_geometry::board::Board;
use evcal_geometry::board::symmetry::Symmetries;
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_solve::initial::PosedFrame;
use evcal_solve::solve::fixed_intrinsics::FixedIntrinsics;
use evcal_solve::solve::residual_statistics::Measured;
use event_recordings::Files;
use event_recordings::images::Images;

/// Calibrates the lens of another camera on the mount from its own recording, separately from the first camera. Larger
/// errors of frames are accepted than in [`calibrate`], because the rows of frames may be exposed one after the other.
/// The delay of the rows can only be estimated from both cameras. `progress` is as in [`calibrate`].
///
/// # Errors
/// As for [`calibrate`].
pub fn calibrate_lens_separately(
    task: &Task,
    progress: impl FnMut(Step) -> ControlFlow<()> + Send,
) -> Result<Calibrated, CalibrateError> {
    if !task.inputs.iter().any(|input| matches!(input, Input::Images(_))) {
        return calibrate(task, progress);
    }
    let settings = Settings { initial: task.settings.initial.of_rows_in_turn(), ..task.settings.clone() };
    calibrate(&Task { settings: &settings, ..*task }, progress)
}

/// Returns the use of the pictures in `input`, the recording of another camera. If its events come from a file of the
/// `first` camera, the pictures in that file belong to the first camera and are ignored.
pub fn picture_use_of_second(first: &[Input], input: &Input) -> PictureUse {
    match input {
        Input::Images(_) => PictureUse::Only,
        _ if first.iter().any(|own| own.is_of_file_of(input)) => PictureUse::Ignore,
        _ => PictureUse::CrossCheck,
    }
}

/// Calibrates the camera of `second`, which was calibrated separately from `input`, against the camera of `first`. The rows of its
/// images may be exposed one after the other if `rolling_shutter` is `true`.
///
/// # Errors
/// [`SecondCameraError`] describes the problem and what to do; the cameras are calibrated nevertheless.
pub fn calibrate_against_first(
    first: &Calibrated,
    second: &Calibrated,
    input: &Input,
    rolling_shutter: bool,
    board: &Board,
    lenses: Lenses,
) -> Result<SecondCamera, SecondCameraError> {
    let found = match input {
        Input::Images(images) => calibrate_frame_camera(first, second, images, rolling_shutter, board, lenses),
        Input::Events(_) | Input::Circles { .. } => {
            calibrate_second_camera(first, second, &input.name(), board, lenses)
        }
    };
    found.map(|camera| SecondCamera { source_files: input.files_read(), ..camera })
}

/// Calibrates the camera of `second` against the camera of `first`. Both were calibrated separately with the same `board`, from
/// one recording each, the second from `file`. Intrinsics are estimated too, unless `lenses` contains them.
///
/// # Errors
/// [`SecondCameraError`] names the problem and the remedy; the separate calibrations are not affected.
pub fn calibrate_second_camera(
    first: &Calibrated,
    second: &Calibrated,
    file: &str,
    board: &Board,
    lenses: Lenses,
) -> Result<SecondCamera, SecondCameraError> {
    if first.starts.len() != 1 || second.starts.len() != 1 {
        return Err(SecondCameraError::SeveralRecordings);
    }
    let of_first = along_trajectories(first)?;
    let of_second = along_trajectories(second).map_err(|_| SecondCameraError::CirclesOfSecond)?;
    // Two calibrations from the same events are identical to the last bit.
    if of_first.refined.state.camera == of_second.refined.state.camera
        && of_first.refined.problem.segments == of_second.refined.problem.segments
    {
        return Err(SecondCameraError::SameRecording { file: file.to_owned() });
    }
    let calibration = calibrate_second(
        SeparateCalibration { refined: &of_first.refined, uncertainty: &first.quality.uncertainty },
        SeparateCalibration { refined: &of_second.refined, uncertainty: &second.quality.uncertainty },
        &Symmetries::of(board),
        lenses,
    )?;
    Ok(mounted(first, second, file, None, calibration))
}

/// Returns a separately calibrated camera as another camera on the mount of the first one.
fn mounted(
    first: &Calibrated,
    second: &Calibrated,
    file: &str,
    frames: Option<SecondFrames>,
    calibration: SecondCalibration,
) -> SecondCamera {
    let start = |calibrated: &Calibrated| calibrated.starts.first().copied().unwrap_or(0.0);
    SecondCamera {
        file: file.to_owned(),
        source_files: Files::default(),
        sensor: second.sensor,
        camera: CameraDescription::new(second.camera()),
        sigma: CameraDescription::of_values(second.camera().kind(), second.sigma()),
        covered: second.covered_region(),
        lens_grade: (!calibration.fixed[1] && !calibration.rolling_shutter).then_some(second.verdict.grade),
        lens_verdict: second.verdict.sentence.clone(),
        starts: [start(first), start(second)],
        frames,
        calibration,
    }
}

/// Calibrates a frame camera against the camera of `first`; `second` was calibrated separately from `images` alone. With
/// `rolling_shutter` its rows may be exposed one after the other. Intrinsics are estimated too, unless `lenses` contains them.
///
/// # Errors
/// [`SecondCameraError`] names the problem and the remedy; the separate calibrations are not affected.
pub fn calibrate_frame_camera(
    first: &Calibrated,
    second: &Calibrated,
    images: &Images,
    rolling_shutter: bool,
    board: &Board,
    lenses: Lenses,
) -> Result<SecondCamera, SecondCameraError> {
    if first.starts.len() != 1 {
        return Err(SecondCameraError::SeveralRecordings);
    }
    let of_first = along_trajectories(first)?;
    let Evidence::Pictures(pictures) = &second.evidence else { return Err(SecondCameraError::NoTrajectory) };
    let frames: Vec<SeenFrame> = second.posed().map(|(posed, frame)| seen_frame(posed, frame)).collect();
    let sigma = second.sigma();
    let camera = FrameCamera {
        camera: pictures.camera,
        sigma: &sigma,
        sensor: second.sensor,
        frames: &frames,
        point_sigma: pictures.spread,
        rolling_shutter,
    };
    let separate = SeparateCalibration { refined: &of_first.refined, uncertainty: &first.quality.uncertainty };
    let calibration = calibrate_frames(separate, camera, &Symmetries::of(board), lenses)?;
    let used = SecondFrames { used: frames.len(), stamps: images.stamps(), exposure_known: images.exposure_known() };
    Ok(mounted(first, second, &images.name(), Some(used), calibration))
}

/// Returns a frame with its pose and the images of its circles' centres.
fn seen_frame(posed: &PosedFrame, frame: &ReferenceFrame) -> SeenFrame {
    let t = frame.t();
    let circle = |circle: &ObservedCircle| PointObservation { t, pixel: circle.center, circle: circle.index };
    SeenFrame { t, pose: posed.pose, circles: posed.circles.iter().map(circle).collect() }
}

/// Calibrates the camera's own pictures against its events, as if they were pictures of a second camera. Both have the same lens,
/// so the relative pose should be the identity. `first` was calibrated with [`PictureUse::SecondCamera`](crate::task::PictureUse).
///
/// # Errors
/// [`SecondCameraError`] names the problem and the remedy.
pub fn calibrate_own_pictures(
    first: &Calibrated,
    fixed: Option<&FixedIntrinsics>,
) -> Result<SecondCamera, SecondCameraError> {
    if first.starts.len() != 1 {
        return Err(SecondCameraError::SeveralRecordings);
    }
    let of_first = along_trajectories(first)?;
    let pictures = of_first.own_pictures.as_ref().ok_or(SecondCameraError::NoTrajectory)?;
    let separate = SeparateCalibration { refined: &of_first.refined, uncertainty: &first.quality.uncertainty };
    let seen = Pictures {
        camera: pictures.camera,
        sigma: &pictures.sigma,
        points: &pictures.points,
        point_sigma: pictures.report.spread,
    };
    let calibration = calibrate_pictures_against(separate, seen, fixed)?;
    let start = first.starts.first().copied().unwrap_or(0.0);
    Ok(SecondCamera {
        file: "the first camera's own frames".to_owned(),
        source_files: Files::default(),
        sensor: first.sensor,
        camera: CameraDescription::new(&pictures.camera),
        sigma: CameraDescription::of_values(pictures.camera.kind(), pictures.sigma.iter().copied()),
        covered: first.covered_region(),
        lens_grade: None,
        lens_verdict: format!("calibrated from {} frames", pictures.report.frames),
        // Times of the dots are on the clock of the events; the frames' own timestamps are earlier by the offset found before.
        starts: [start, start - pictures.report.time_offset],
        frames: None,
        calibration,
    })
}

fn along_trajectories(calibrated: &Calibrated) -> Result<&EventCalibration, SecondCameraError> {
    match &calibrated.evidence {
        Evidence::Events(events) if events.measured == Measured::EventEdges => Ok(events),
        Evidence::Events(_) | Evidence::Pictures(_) => Err(SecondCameraError::NoTrajectory),
    }
}

//! Initial model (section 5 of method.md): from reference frames to a camera and a pose for every good frame.
//!
//! Frames pass the rotation gate. A camera is calibrated from a diverse subset (by OpenCV, or by a native start if OpenCV fails
//! or is not built in; refined by a robust bundle adjustment). Every frame gets a pose by PnP in RANSAC. The velocity gate and
//! the cross-validation of the circles against the events drop the frames and circles that do not fit, and camera and
//! poses are refined again on the rest.
//!
//! Guarantees: no frame is trusted because it came first, everything that is dropped is in the report with its reason, and the
//! result depends on frames and settings only, not on the number of threads.

mod bundle;
pub mod bundle_adjustment;
mod cross_validation;
mod first_camera;
mod frame_pose;
mod gates;
pub mod held_out;
pub mod information;
pub mod model_choice;
mod native_start;
mod planar_pose;
mod pose;
pub mod provisional;
mod refit;
mod report;
mod settings;
mod sighting;
mod start;
#[cfg(test)]
mod tests;
mod view_selection;

use evcal_core::camera::refit::refits;
use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use rayon::prelude::*;

use bundle::{Bundle, BundleView, bundle};
use cross_validation::cross_validate;
use evcal_detection::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use evcal_geometry::board::Board;
use first_camera::{first_camera, views_differ};
use frame_pose::{FramePose, PoseError, robust_pose, settle_pose};
use gates::rotation_gate::rotation_gate;
use gates::velocity_gate::{Waypoint, velocity_gate};
use settings::HUBER;
use sighting::Sighting;
use view_selection::select_views;

use evcal_geometry::numerics::statistics::median;
pub use planar_pose::{PlanarPose, PlanePoint};
pub use refit::ProjectedCircle;
pub use report::{DropReason, DroppedFrame, InitialError, InitialReport, OpencvStart, Step, ValidationCounts};
pub use settings::{CrossValidationSettings, InitialSettings, MAX_START_RMS, Start, StartedCamera};
pub use sighting::BoardPoint;
pub use start::NativeStart;

/// Longest time between a circle and the same circle in a neighbouring frame over which its motion is taken as straight (s).
const MAX_INTERPOLATION_GAP: f64 = 0.1;
/// Number of views in the last bundle refinement.
const BUNDLE_VIEWS: usize = 400;
/// Largest ratio of a frame's root mean square error to the median of all frames.
const MAX_FRAME_RMS_RATIO: f64 = 5.0;

/// A reference frame with its pose.
#[derive(Clone, Debug, PartialEq)]
pub struct PosedFrame {
    /// Index of the frame in the input.
    pub frame: usize,
    /// `T_world_camera` at the frame's time.
    pub pose: Isometry3<f64>,
    /// The circles that agree with the pose, ordered by board index.
    ///
    /// `center` is the image of the circle's centre at the circle's own time `t`, which is not quite
    /// the centre of its elliptic image. Circles that were found again in the frame's events have the
    /// frame's time and a radius; the others keep their own time and get the velocity that brings
    /// them to the frame's time.
    pub circles: Vec<ObservedCircle>,
    /// Root mean square distance between circles and their projections, in pixels.
    pub rms: f64,
}

/// A camera and the frames that agree with it.
#[derive(Clone, Debug, PartialEq)]
pub struct InitialModel {
    /// The camera.
    pub camera: Camera<f64>,
    /// Standard deviation of each of its parameters, from the residuals of the circle centres.
    pub sigma: Vec<f64>,
    /// The frames in the order of recording and time.
    pub frames: Vec<PosedFrame>,
    /// Statistics of all steps.
    pub report: InitialReport,
}

/// A sighting with its pose.
#[derive(Clone, Debug)]
struct Posed {
    sighting: Sighting,
    /// `T_camera_world`.
    pose: Isometry3<f64>,
    rms: f64,
}

impl From<PoseError> for DropReason {
    fn from(error: PoseError) -> Self {
        match error {
            PoseError::NotFound => Self::NoPose,
            PoseError::TooFewInliers => Self::TooFewInliers,
            PoseError::BehindBoard => Self::BehindBoard,
            PoseError::LargeError => Self::LargeError,
        }
    }
}

/// Keeps the elements whose flag is set and calls `drop` for the others.
fn retain<T>(elements: &mut Vec<T>, keep: &[bool], mut drop: impl FnMut(&T)) {
    let mut flags = keep.iter();
    elements.retain(|element| {
        let keep = flags.next().copied().unwrap_or(false);
        if !keep {
            drop(element);
        }
        keep
    });
}

/// Calibrates a camera of model `kind` on a sensor of (width, height) pixels from `frames`, and estimates the pose of every
/// reliable frame.
pub fn initial_model(
    frames: &[ReferenceFrame],
    board: &Board,
    sensor: Sensor,
    kind: ModelKind,
    settings: &InitialSettings,
) -> Result<InitialModel, InitialError> {
    let mut report = InitialReport { frames_in: frames.len(), ..InitialReport::default() };
    let settings = &settings.of_frames(frames, board);
    let sightings = accepted_sightings(frames, board, settings, &mut report)?;
    let camera = first_camera(&sightings, board, sensor, kind, settings, &mut report)?.camera;

    let mut posed = poses(&camera, sightings, settings, &mut report);
    let kept = velocity_gate(&waypoints(&posed), board, settings);
    retain(&mut posed, &kept, |posed| drop_frame(&mut report, posed.sighting.frame, DropReason::PoseJumps));
    enough(posed.len(), settings, &mut report)?;

    let posed = cross_validate(frames, posed, &camera, board, sensor, settings, &mut report);
    enough(posed.len(), settings, &mut report)?;
    let refined = refine(&camera, &posed, board, sensor, &mut report)?;
    finish(refined, posed, settings, report)
}

impl InitialModel {
    /// Creates a model from frames with poses and a `camera` that was determined from more data than these frames.
    pub fn of_frames(camera: Camera<f64>, frames: Vec<PosedFrame>) -> Self {
        Self { camera, sigma: Vec::new(), frames, report: InitialReport::default() }
    }
}

/// Estimates the poses of the reliable `frames` for a known `camera`; all are of one recording, in order of time. Their circles
/// are not changed.
pub fn posed_frames(
    frames: &[ReferenceFrame],
    board: &Board,
    camera: &Camera<f64>,
    settings: &InitialSettings,
) -> Vec<PosedFrame> {
    let mut report = InitialReport { frames_in: frames.len(), ..InitialReport::default() };
    let settings = &InitialSettings { min_frames: 1, ..settings.of_frames(frames, board) };
    let Ok(sightings) = accepted_sightings(frames, board, settings, &mut report) else { return Vec::new() };
    let mut posed = poses(camera, sightings, settings, &mut report);
    let kept = velocity_gate(&waypoints(&posed), board, settings);
    retain(&mut posed, &kept, |_| ());
    posed.into_iter().map(Posed::into_frame).collect()
}

fn waypoints(posed: &[Posed]) -> Vec<Waypoint> {
    let of = |posed: &Posed| Waypoint { recording: posed.sighting.recording, t: posed.sighting.t, pose: posed.pose };
    posed.iter().map(of).collect()
}

impl Posed {
    fn into_frame(self) -> PosedFrame {
        let Self { sighting, pose, rms } = self;
        PosedFrame { frame: sighting.frame, pose: pose.inverse(), circles: sighting.circles, rms }
    }
}

fn drop_frame(report: &mut InitialReport, frame: usize, reason: DropReason) {
    report.dropped.push(DroppedFrame { frame, reason });
}

fn enough(left: usize, settings: &InitialSettings, report: &mut InitialReport) -> Result<(), InitialError> {
    if left >= settings.min_frames.max(1) {
        return Ok(());
    }
    let mirrored = report.dropped.iter().filter(|dropped| dropped.reason == DropReason::Mirrored).count();
    if 2 * mirrored > report.frames_in {
        return Err(InitialError::Mirrored { mirrored, found: report.frames_in });
    }
    Err(InitialError::TooFewFrames {
        found: report.frames_in,
        left,
        needed: settings.min_frames.max(1),
        reasons: report.reasons(),
    })
}

/// Returns the frames with enough circles that pass the rotation gate, with their point pairs.
fn accepted_sightings(
    frames: &[ReferenceFrame],
    board: &Board,
    settings: &InitialSettings,
    report: &mut InitialReport,
) -> Result<Vec<Sighting>, InitialError> {
    let mut sightings = sighting::sightings(frames, board);
    let kept: Vec<bool> = sightings
        .iter()
        .map(|sighting| sighting.t.is_finite() && sighting.circles.len() >= settings.min_circles)
        .collect();
    retain(&mut sightings, &kept, |sighting| drop_frame(report, sighting.frame, DropReason::TooFewCircles));
    let gate = rotation_gate(&mut sightings, board, settings);
    report.turned = gate.turned;
    for (sighting, verdict) in sightings.iter().zip(&gate.verdicts) {
        if let Some(reason) = verdict {
            drop_frame(report, sighting.frame, *reason);
        }
    }
    let kept: Vec<bool> = gate.verdicts.iter().map(Option::is_none).collect();
    retain(&mut sightings, &kept, |_| ());
    enough(sightings.len(), settings, report)?;
    sighting::estimate_velocities(&mut sightings, MAX_INTERPOLATION_GAP);
    report.without_velocity = sighting::pair_points(&mut sightings, board);
    Ok(sightings)
}

/// Estimates the pose of every sighting; circles that disagree with it are excluded.
fn poses(
    camera: &Camera<f64>,
    sightings: Vec<Sighting>,
    settings: &InitialSettings,
    report: &mut InitialReport,
) -> Vec<Posed> {
    let found: Vec<Result<FramePose, PoseError>> =
        sightings.par_iter().map(|sighting| robust_pose(camera, &sighting.points, settings)).collect();
    settled(sightings.into_iter().zip(found), report)
}

/// Returns the sightings that got a pose, without the circles that disagree with it.
fn settled(
    results: impl Iterator<Item = (Sighting, Result<FramePose, PoseError>)>,
    report: &mut InitialReport,
) -> Vec<Posed> {
    let mut posed = Vec::new();
    for (mut sighting, found) in results {
        match found {
            Ok(FramePose { pose, inliers, rms }) => {
                report.circles.outliers += inliers.iter().filter(|inlier| !**inlier).count();
                sighting.retain(&inliers);
                posed.push(Posed { sighting, pose, rms });
            }
            Err(error) => drop_frame(report, sighting.frame, error.into()),
        }
    }
    posed
}

/// Refines the camera again, on a diverse subset of the posed frames.
fn refine(
    camera: &Camera<f64>,
    posed: &[Posed],
    board: &Board,
    sensor: Sensor,
    report: &mut InitialReport,
) -> Result<Bundle, InitialError> {
    let all: Vec<&[BoardPoint]> = posed.iter().map(|posed| posed.sighting.points.as_slice()).collect();
    let views: Vec<BundleView<'_>> = select_views(&all, board, sensor, BUNDLE_VIEWS)
        .into_iter()
        .filter_map(|position| posed.get(position))
        .map(|posed| BundleView { points: &posed.sighting.points, pose: posed.pose, noise: 1.0 })
        .collect();
    let free = vec![true; camera.kind().parameter_names().len()];
    report.bundle_views = views.len();
    let count = views.len();
    // With few views, the first camera may be in the wrong local minimum of a model that has two, and the refinement cannot move
    // to the other.
    let kind = camera.kind();
    let sides = (kind.expectation().fit_starts.len() > 1).then(|| refits(kind, camera, sensor));
    let starts = std::iter::once(*camera).chain(sides.into_iter().flatten());
    let refined = starts
        .filter_map(|start| bundle(&start, &views, &free, sensor, HUBER))
        .min_by(|a, b| a.rms.total_cmp(&b.rms))
        .ok_or_else(|| InitialError::NoCamera { views: count, reason: "the refinement diverged".to_owned() })?;
    report.bundle_steps = refined.steps;
    views_differ(&refined)?;
    Ok(refined)
}

/// Estimates the final poses of all frames with the refined camera.
fn finish(
    refined: Bundle,
    posed: Vec<Posed>,
    settings: &InitialSettings,
    mut report: InitialReport,
) -> Result<InitialModel, InitialError> {
    let camera = refined.camera;
    let found: Vec<Result<FramePose, PoseError>> =
        posed.par_iter().map(|posed| settle_pose(&camera, &posed.sighting.points, &posed.pose, settings)).collect();
    let sightings = posed.into_iter().map(|posed| posed.sighting);
    let mut posed = settled(sightings.zip(found), &mut report);
    let mut errors: Vec<f64> = posed.iter().map(|posed| posed.rms).collect();
    let typical = median(&mut errors, f64::total_cmp).unwrap_or(0.0);
    // Errors below the scale of the loss do not exclude a frame, however good the others are.
    let bound = (MAX_FRAME_RMS_RATIO * typical).max(HUBER);
    let kept: Vec<bool> = posed.iter().map(|posed| posed.rms <= bound).collect();
    retain(&mut posed, &kept, |posed| drop_frame(&mut report, posed.sighting.frame, DropReason::LargeError));
    enough(posed.len(), settings, &mut report)?;

    report.dropped.sort_by_key(|dropped| dropped.frame);
    report.frames_out = posed.len();
    report.circles.used = posed.iter().map(|posed| posed.sighting.circles.len()).sum();
    let squares: f64 = posed.iter().map(|posed| posed.rms * posed.rms * posed.sighting.circles.len() as f64).sum();
    report.rms = (squares / report.circles.used as f64).sqrt();
    let frames = posed.into_iter().map(Posed::into_frame).collect();
    Ok(InitialModel { camera, sigma: refined.sigma, frames, report })
}

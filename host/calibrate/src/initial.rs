//! Initial model (section 5 of method.md): from reference frames to a camera and a pose for every good frame.
//!
//! Frames pass the rotation gate, a camera is calibrated from a diverse subset (OpenCV, or a native start
//! where OpenCV fails or is not built in; refined by a robust bundle adjustment), every frame gets a pose by PnP in
//! RANSAC, the velocity gate and the cross-validation of the circles against the events drop what
//! does not fit, and camera and poses are refined once more on what is left.
//!
//! What it guarantees: no frame is trusted because it came first, what is dropped is in the report
//! with its reason, and the result depends on frames and settings only, not on the number of threads.

mod bundle;
pub(crate) mod bundle_adjustment;
mod cross_validation;
mod first_camera;
mod frame_pose;
pub mod held_out;
pub mod information;
pub mod model_choice;
mod native_start;
mod neighbour_vote;
mod planar_pose;
mod pose;
pub mod provisional;
mod refit;
mod report;
mod rotation_gate;
mod settings;
mod sighting;
mod start;
#[cfg(test)]
mod tests;
mod velocity_gate;
mod view_selection;

use evcal_core::camera::refit::refits;
use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use rayon::prelude::*;

use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use bundle::{Bundle, BundleView, bundle};
use cross_validation::cross_validate;
use evcal_geometry::board::Board;
use first_camera::{first_camera, views_differ};
use frame_pose::{FramePose, PoseError, robust_pose, settle_pose};
use rotation_gate::rotation_gate;
use sighting::Sighting;
use velocity_gate::{Waypoint, velocity_gate};
use view_selection::select_views;

use evcal_geometry::numerics::statistics::median;
pub use planar_pose::{PlanarPose, PlanePoint};
pub use refit::ProjectedCircle;
pub use report::{DropReason, DroppedFrame, InitialError, InitialReport, OpencvStart, Step, ValidationCounts};
pub use settings::{CrossValidationSettings, InitialSettings, Start, StartedCamera};
pub use sighting::BoardPoint;
pub use start::NativeStart;

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

/// A camera and the frames that it explains.
#[derive(Clone, Debug, PartialEq)]
pub struct InitialModel {
    /// The camera.
    pub camera: Camera<f64>,
    /// Standard deviation of each of its parameters from the residuals of the circle centres.
    pub sigma: Vec<f64>,
    /// The frames in the order of recording and time.
    pub frames: Vec<PosedFrame>,
    /// How it came about.
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

/// Calibrates a camera of model `kind` on a sensor of (width, height) pixels from `frames`, and gives
/// every frame that can be trusted its pose.
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
    let refined = refine(&camera, &posed, board, sensor, settings, &mut report)?;
    finish(refined, posed, settings, report)
}

impl InitialModel {
    /// Frames with poses of a camera that is known better than from them.
    pub fn of_frames(camera: Camera<f64>, frames: Vec<PosedFrame>) -> Self {
        Self { camera, sigma: Vec::new(), frames, report: InitialReport::default() }
    }
}

/// Poses of those of `frames` that can be trusted before a `camera` that is known; all of one recording, in order of time. Their
/// circles are as they were found.
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

/// The frames with enough circles that pass the rotation gate, with their point pairs.
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
    sighting::estimate_velocities(&mut sightings, settings.max_interpolation_gap);
    report.without_velocity = sighting::pair_points(&mut sightings, board);
    Ok(sightings)
}

/// Pose of every sighting; circles that disagree with it are left out.
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

/// Takes the sightings that got a pose, without the circles that disagree with it.
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

/// The camera once more, from a diverse subset of the posed frames.
fn refine(
    camera: &Camera<f64>,
    posed: &[Posed],
    board: &Board,
    sensor: Sensor,
    settings: &InitialSettings,
    report: &mut InitialReport,
) -> Result<Bundle, InitialError> {
    let all: Vec<&[BoardPoint]> = posed.iter().map(|posed| posed.sighting.points.as_slice()).collect();
    let views: Vec<BundleView<'_>> = select_views(&all, board, sensor, settings.bundle_views)
        .into_iter()
        .filter_map(|position| posed.get(position))
        .map(|posed| BundleView { points: &posed.sighting.points, pose: posed.pose })
        .collect();
    let free = vec![true; camera.kind().parameter_names().len()];
    report.bundle_views = views.len();
    let count = views.len();
    // Few views may have led to the wrong side of a model that has two, from where the other is not reached.
    let kind = camera.kind();
    let sides = (kind.expectation().fit_starts.len() > 1).then(|| refits(kind, camera, sensor));
    let starts = std::iter::once(*camera).chain(sides.into_iter().flatten());
    let refined = starts
        .filter_map(|start| bundle(&start, &views, &free, sensor, settings.huber))
        .min_by(|a, b| a.rms.total_cmp(&b.rms))
        .ok_or_else(|| InitialError::NoCamera { views: count, reason: "the refinement diverged".to_owned() })?;
    report.bundle_steps = refined.steps;
    views_differ(&refined, settings)?;
    Ok(refined)
}

/// Last poses of all frames with the refined camera.
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
    // Errors below the scale of the loss are no reason to drop a frame, however good the others are.
    let bound = (settings.max_frame_rms_ratio * typical).max(settings.huber);
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

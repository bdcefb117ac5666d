//! A second camera that takes ordinary frames: circles in its frames on the trajectories of the first camera.
//!
//! Each frame has its own pose at first, from the separate calibration of its lens. In the solve of both cameras a circle has the
//! time of its row: the frame's time plus the line delay for each row below the middle. The line delay is always estimated.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;

use super::calibration::SecondCalibration;
use super::error::SecondCameraError;
use super::estimate::Estimate;
use super::findings::findings;
use super::joint::{Joint, Lenses, Solved, share_of_lenses, solve};
use super::mount::{LINE_DELAY, Mount};
use super::seen::Seen;
use super::{
    Known, SeparateCalibration, add_scale_error, determined, finish, problem_of_points, seen_by_both, start,
    with_board_fixed, with_fixed_lenses,
};
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_geometry::board::symmetry::Symmetries;
use evcal_solve::solve::State;
use evcal_solve::solve::observation::SegmentObservations;
use evcal_solve::trajectory::mean_distance;

/// Number of σ from which a line delay is significant.
const CERTAIN: f64 = 3.0;

/// Expected root mean square distance of centres, in units of their spread along one axis, with Huber's loss from 1.5 on, for
/// normal errors along both axes.
const USUAL_RMS: f64 = 1.36;
/// Largest ratio of two spreads that count as equal.
const SAME_SPREAD: f64 = 1.2;
/// Change of position (m) and rotation (rad) between the cameras, from poses of frames, above which the mount is loose: if rows
/// are exposed one after the other, a pose is shifted by a part of the camera's motion during a frame.
const LOOSE: [f64; 2] = [3.0 * start::LOOSE[0], 3.0 * start::LOOSE[1]];
/// Spread of centres about the first camera's trajectory, with the times of their rows, above which the mount is loose (rad).
const LOOSE_CENTRES: f64 = 4e-3;
/// Largest number of solves for the spread of centres.
const MOST_SOLVES: usize = 4;

/// A frame with the board.
#[derive(Clone, Debug, PartialEq)]
pub struct SeenFrame {
    /// Middle of its exposure; without exposure times, the moment at which it was stamped. Since the first frame of the
    /// recording (s).
    pub t: f64,
    /// `T_world_camera`.
    pub pose: Isometry3<f64>,
    /// Images of the centres of circles, at this time.
    pub circles: Vec<PointObservation>,
}

/// A frame camera that was calibrated separately.
#[derive(Clone, Copy, Debug)]
pub struct FrameCamera<'a> {
    /// The lens.
    pub camera: Camera<f64>,
    /// Standard deviation of each of its parameters.
    pub sigma: &'a [f64],
    /// Size of its sensor.
    pub sensor: Sensor,
    /// Its frames, in order of time.
    pub frames: &'a [SeenFrame],
    /// Spread of a centre along one axis (px).
    pub point_sigma: f64,
    /// `true` if a rolling shutter was requested.
    pub rolling_shutter: bool,
}

/// Calibrates a frame camera, the `second`, against the `first`, with a board that looks the same after the rotations
/// `symmetries`. Intrinsics are estimated too, unless `lenses` contains them.
///
/// # Errors
/// [`SecondCameraError`] names the problem with the recordings or the motion, and the remedy.
pub fn calibrate_frames(
    first: SeparateCalibration,
    second: FrameCamera,
    symmetries: &Symmetries,
    lenses: Lenses,
) -> Result<SecondCalibration, SecondCameraError> {
    let state = &first.refined.state;
    let seen = Seen::in_frames(second.frames.iter().map(|frame| (frame.t, frame.pose)));
    let start = start::start(&state.trajectories, &seen, symmetries, LOOSE)?;
    let mut of_segments: Vec<SegmentObservations> = Vec::new();
    for (frame, seen) in second.frames.iter().zip(&seen.poses) {
        of_segments.resize_with(of_segments.len().max(seen.segment + 1), SegmentObservations::default);
        if let Some(segment) = of_segments.last_mut() {
            segment.points.extend(&frame.circles);
        }
    }
    let segments = seen_by_both(first.refined, &of_segments, &start, &symmetries.rotations);
    let count = |segments: &[SegmentObservations]| segments.iter().map(|one| one.points.len()).sum::<usize>();
    let left_out = 1.0 - count(&segments) as f64 / count(&of_segments).max(1) as f64;
    let mut of_frames = problem_of_points(&first.refined.problem, segments, second.sigma, second.point_sigma);
    of_frames.sensor = second.sensor;
    let of_first = with_board_fixed(&first.refined.problem, first.refined.problem.segments.clone());
    let joint = Joint { first: of_first, second: of_frames };
    let estimate = Estimate {
        first: state.clone(),
        second: State { camera: second.camera, trajectories: Vec::new(), ..state.clone() },
        mount: Mount { line_delay: Some(0.0), ..start.mount },
    };
    let (mut solved, spread) = weighed(joint, estimate, lenses)?;
    let [focal_length, _] = second.camera.axial_focal_lengths().unwrap_or([f64::INFINITY; 2]);
    let angle = spread / focal_length;
    if angle > LOOSE_CENTRES {
        let distance = angle * mean_distance(&state.trajectories);
        return Err(SecondCameraError::NotFixed { distance, degrees: angle.to_degrees() });
    }
    add_scale_error(&mut solved, &first);
    let known = Known {
        correlation: Some(start.correlation),
        seconds: start.seconds,
        left_out,
        own_rms: None,
        // The rows of a rolling shutter have times of their own.
        time_scatter: start.time_scatter.filter(|_| !second.rolling_shutter),
        sensors: [first.refined.problem.sensor, second.sensor],
        lenses,
    };
    let sigma = first.uncertainty.sigma();
    let mut calibration = finish(solved, &known, [(&state.camera, &sigma), (&second.camera, second.sigma)]);
    let line_delay = calibration.mount.line_delay.unwrap_or(0.0);
    let sigma = calibration.sigma(LINE_DELAY);
    if !second.rolling_shutter && line_delay.abs() > CERTAIN * sigma {
        let rows = second.sensor.height;
        return Err(SecondCameraError::RollingShutter { line_delay, sigma, rows });
    }
    calibration.rolling_shutter = second.rolling_shutter;
    calibration.findings = findings(&calibration);
    determined(calibration)
}

/// Solves, and repeats the solve with the resulting spread of centres until it agrees with the assumed one: in the separate
/// calibration, the frames of a rolling shutter fit no lens well. Returns the solution, and that spread (px).
fn weighed(joint: Joint, estimate: Estimate, lenses: Lenses) -> Result<(Solved, f64), SecondCameraError> {
    let (mut joint, estimate) = with_fixed_lenses(joint, estimate, lenses);
    let mut solved = solve(&joint, estimate)?;
    for _ in 1..MOST_SOLVES {
        let ratio = solved.rms / USUAL_RMS;
        if (1.0 / SAME_SPREAD..SAME_SPREAD).contains(&ratio) {
            break;
        }
        joint.second.point_sigma *= ratio;
        solved = solve(&joint, solved.estimate)?;
    }
    if let Some(share) = share_of_lenses(&joint, &solved.estimate, lenses)? {
        solved.covariance += share;
    }
    let spread = joint.second.point_sigma * solved.rms / USUAL_RMS;
    Ok((solved, spread))
}

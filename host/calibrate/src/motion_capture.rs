//! A trajectory against motion capture: markers on the camera form a body that a capture system follows.
//!
//! Where the body sits on the camera, where the board stands in the room and how far both clocks are apart is not known. All of
//! it follows from the two trajectories (hand-eye calibration), and what is left between them is the error of both:
//!
//! T_mocap_body(t + offset) = T_mocap_world · T_world_camera(t) · T_camera_body
//!
//! | module | does |
//! |---|---|
//! | [`file`](mod@file) | reads captures (TUM, EuRoC, OptiTrack Motive) |
//! | [`path`] | the camera's pose at the capture's own stamps |
//! | [`start`] | offset, rotation, translations, each with a test that it was found |
//! | [`fit`] | maximum likelihood of all of it |
//! | [`uncertainty`] | its σ, from the scatter of blocks of time |
//! | [`intrinsics_error`] | what the uncertainty of the intrinsics adds |
//! | [`held_out`](mod@held_out) | what is left in slices of time that were not fitted |

pub mod error;
pub mod file;
pub mod fit;
pub mod held_out;
pub mod intrinsics_error;
pub mod path;
pub mod start;
pub mod uncertainty;

use nalgebra::{Isometry3, Vector3};

use self::error::MotionCaptureError;
use self::fit::{COUNT, DRIFT, Fitted, HandEye, OFFSET, SCALE, Spread};
use self::held_out::{HeldOut, held_out};
use self::intrinsics_error::{IntrinsicsError, variances};
use self::path::Path;
use self::uncertainty::sigmas;
use evcal_geometry::numerics::statistics::median;
use evcal_geometry::timed_pose::TimedPose;

/// Fewest seconds of common poses.
const FEWEST_SECONDS: f64 = 4.0;
/// Lengths differ when their ratio is off by more than this, and by more than three σ.
const SAME_LENGTH: f64 = 0.002;

/// A number with its σ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The number.
    pub value: f64,
    /// Its standard deviation.
    pub sigma: f64,
}

/// A pose with the σ of its translation and rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredPose {
    /// The pose.
    pub pose: Isometry3<f64>,
    /// σ of its translation (m), along the axes of the frame that it maps to.
    pub translation_sigma: Vector3<f64>,
    /// σ of its rotation (rad), about the axes of the frame that it maps from.
    pub rotation_sigma: Vector3<f64>,
}

/// What a capture says of a trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Poses in the capture.
    pub captured: usize,
    /// Those at whose time the camera's pose is known.
    pub used: usize,
    /// Poses a second in the capture.
    pub rate: f64,
    /// Share of the capture's poses that are missing.
    pub missing: f64,
    /// Largest correlation of how fast both turn.
    pub correlation: f64,
    /// The body in the camera's frame, `T_camera_body`.
    pub camera_body: MeasuredPose,
    /// The board in the capture's frame, `T_mocap_world`.
    pub mocap_world: MeasuredPose,
    /// t_mocap = t_events + offset, in the middle of the recording (s).
    pub offset: Measured,
    /// By how much the capture's clock is faster; `None` where the recording is too short to tell.
    pub drift: Option<Measured>,
    /// Lengths in the capture over those on the board.
    pub scale: Measured,
    /// Scatter of both trajectories about each other: position (m) and rotation (rad) of each axis.
    pub spread: Spread,
    /// Whether σ contain the error of the camera's intrinsics.
    pub intrinsics_known: bool,
    /// Errors in the fitted slices of time and in the others.
    pub errors: HeldOut,
}

impl Compared {
    /// Whether capture and board have different lengths.
    pub fn lengths_differ(&self) -> bool {
        let off = (self.scale.value - 1.0).abs();
        off > SAME_LENGTH && off > 3.0 * self.scale.sigma
    }
}

/// Compares the poses of a camera, `T_world_camera` on the clock of its events, with those of a body fixed to it,
/// `T_mocap_body` on the clock of the capture; both in order of time. σ contain the error of the camera's intrinsics, where that is known.
///
/// # Errors
/// [`MotionCaptureError`] says what is wrong with the capture or the motion, and what to do.
pub fn compare(
    camera: &[TimedPose],
    capture: &[TimedPose],
    intrinsics: Option<&IntrinsicsError>,
) -> Result<Compared, MotionCaptureError> {
    let interval = checked_interval(capture)?;
    let path = Path::new(camera)?;
    let start = start::start(camera, capture)?;
    let seconds = start.hand_eye.matched(&path, capture).count() as f64 * interval;
    if seconds < FEWEST_SECONDS {
        return Err(MotionCaptureError::TooShort { seconds, needed: FEWEST_SECONDS });
    }
    let drifts = seconds > fit::LONG_ENOUGH_FOR_DRIFT;
    let all = fit::fit(&path, capture, start.hand_eye, drifts, |_| true)?;
    let scaled = fit::with_scale(&path, capture, &all, drifts)?;
    let sigma = |fitted: &Fitted| {
        let mut sigma = sigmas(&path, capture, fitted)?;
        if let Some(intrinsics) = intrinsics {
            let variances = variances(&path, capture, fitted, intrinsics)?;
            sigma.iter_mut().zip(&variances).for_each(|(sigma, variance)| *sigma = sigma.hypot(variance.sqrt()));
        }
        Ok::<_, MotionCaptureError>(sigma)
    };
    let scale_sigma = sigma(&scaled)?[SCALE];
    let sigma = sigma(&all)?;
    let errors = held_out(&path, capture, &all, drifts, interval)?;
    let HandEye { camera_body, mocap_world, offset, drift, .. } = all.hand_eye;
    let span = capture.last().zip(capture.first()).map_or(0.0, |(last, first)| last.t - first.t);
    Ok(Compared {
        captured: capture.len(),
        used: all.used,
        rate: 1.0 / interval,
        missing: (1.0 - (capture.len() as f64 - 1.0) * interval / span).max(0.0),
        correlation: start.correlation,
        camera_body: measured_pose(&camera_body, &sigma, fit::CAMERA_BODY),
        mocap_world: measured_pose(&mocap_world, &sigma, fit::MOCAP_WORLD),
        offset: Measured { value: offset, sigma: sigma[OFFSET] },
        drift: drifts.then_some(Measured { value: drift, sigma: sigma[DRIFT] }),
        scale: Measured { value: scaled.hand_eye.scale, sigma: scale_sigma },
        spread: all.spread,
        intrinsics_known: intrinsics.is_some(),
        errors,
    })
}

fn measured_pose(pose: &Isometry3<f64>, sigma: &[f64; COUNT], first: usize) -> MeasuredPose {
    let three = |first: usize| Vector3::from_fn(|axis, _| sigma[first + axis]);
    MeasuredPose { pose: *pose, rotation_sigma: three(first), translation_sigma: three(first + 3) }
}

/// The usual time from pose to pose.
fn checked_interval(capture: &[TimedPose]) -> Result<f64, MotionCaptureError> {
    let mut intervals: Vec<f64> = capture.windows(2).map(|pair| pair[1].t - pair[0].t).collect();
    let interval = median(&mut intervals, f64::total_cmp).unwrap_or(0.0);
    if !(1e-5..=0.2).contains(&interval) {
        return Err(MotionCaptureError::Times { interval });
    }
    Ok(interval)
}

#[cfg(test)]
mod tests;

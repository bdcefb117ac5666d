//! Comparison of a trajectory with motion capture: markers on the camera form a marker body that a capture system tracks.
//!
//! The pose of the marker body on the camera, the pose of the board in the room and the offset of the clocks are not known. All
//! of them follow from the two trajectories (hand-eye calibration), and the remaining difference is the error of both:
//!
//! T_mocap_body(t + offset) = T_mocap_world · T_world_camera(t) · T_camera_body
//!
//! | module | content |
//! |---|---|
//! | [`file`](mod@file) | reads captures (TUM, EuRoC, OptiTrack Motive) |
//! | [`path`] | the camera's pose at the capture's timestamps |
//! | [`start`] | offset, rotation, translations, each with a test of its validity |
//! | [`fit`] | maximum likelihood of all parameters |
//! | [`uncertainty`] | their σ, from the scatter of blocks of time |
//! | [`intrinsics_error`] | contribution of the uncertainty of the intrinsics |
//! | [`held_out`](mod@held_out) | errors in slices of time that were not fitted |

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
/// Smallest significant relative difference of lengths, if it is also more than three σ.
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
    /// σ of its translation (m), along the axes of the target frame.
    pub translation_sigma: Vector3<f64>,
    /// σ of its rotation (rad), about the axes of the source frame.
    pub rotation_sigma: Vector3<f64>,
}

/// Result of the comparison of a trajectory with a capture.
#[derive(Clone, Debug, PartialEq)]
pub struct Compared {
    /// Number of poses in the capture.
    pub captured: usize,
    /// Number of poses at whose time the camera's pose is known.
    pub used: usize,
    /// Poses per second in the capture.
    pub rate: f64,
    /// Share of the capture's poses that are missing.
    pub missing: f64,
    /// Largest correlation of the rotation rates.
    pub correlation: f64,
    /// The marker body in the camera's frame, `T_camera_body`.
    pub camera_body: MeasuredPose,
    /// The board in the capture's frame, `T_mocap_world`.
    pub mocap_world: MeasuredPose,
    /// t_mocap = t_events + offset, in the middle of the recording (s).
    pub offset: Measured,
    /// Relative rate by which the capture's clock is faster; `None` if the recording is too short.
    pub drift: Option<Measured>,
    /// Ratio of lengths in the capture to those on the board.
    pub scale: Measured,
    /// Scatter of the trajectories relative to each other: position (m) and rotation (rad) per axis.
    pub spread: Spread,
    /// `true` if σ include the error of the camera's intrinsics.
    pub intrinsics_known: bool,
    /// Errors in the fitted slices of time and in the others.
    pub errors: HeldOut,
}

impl Compared {
    /// Returns `true` if capture and board have different lengths.
    pub fn lengths_differ(&self) -> bool {
        let off = (self.scale.value - 1.0).abs();
        off > SAME_LENGTH && off > 3.0 * self.scale.sigma
    }
}

/// Compares the poses of a camera, `T_world_camera` on the clock of its events, with the poses of a marker body fixed to it,
/// `T_mocap_body` on the clock of the capture; both in order of time. σ include the error of the camera's intrinsics, if it is
/// known.
///
/// # Errors
/// [`MotionCaptureError`] names the problem with the capture or the motion, and the remedy.
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

/// Returns the median time between poses.
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

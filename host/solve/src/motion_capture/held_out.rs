//! Errors between camera and capture, in slices of time that were fitted and in others.
//!
//! Thirteen fitted parameters make an error look too small. So they are fitted to every other slice, and the error in the
//! remaining slices is the error of the trajectory. The capture has noise too: noise that differs from pose to pose shows in
//! third differences, to which a smooth motion does not contribute, and it is subtracted.

use nalgebra::{Isometry3, Vector3};

use super::Measured;
use super::error::MotionCaptureError;
use super::fit::{Fitted, HandEye, fit};
use super::path::Path;
use evcal_geometry::numerics::statistics::Statistics;
use evcal_geometry::timed_pose::TimedPose;

/// Length of a slice (s).
pub const SLICE: f64 = 1.0;
/// Largest relative deviation of the time between poses from the median for third differences.
const EVEN: f64 = 0.2;
/// Sum of the squares of the weights 1, −3, 3, −1.
const THIRD_DIFFERENCE: f64 = 20.0;

/// Errors of one kind in one half of the slices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Errors {
    /// Their sizes.
    pub sizes: Statistics,
    /// Root mean square of the capture's own noise in them.
    pub noise: f64,
    /// Root mean square error without that noise, with its σ.
    pub error: Measured,
}

/// Errors of both kinds in one half of the slices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SliceErrors {
    /// Distance between the camera's centre and its position in the capture (m).
    pub position: Errors,
    /// Angle between both orientations (rad).
    pub rotation: Errors,
}

/// Errors in the fitted slices, and in the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOut {
    /// Errors in the even slices, which were fitted.
    pub fitted: SliceErrors,
    /// Errors in the odd slices, which were not.
    pub held_out: SliceErrors,
}

fn is_even(t: f64) -> bool {
    (t / SLICE).floor().rem_euclid(2.0) == 0.0
}

/// Fits the even slices, starting at `all`, and computes the errors in both halves. Clocks may drift, poses are `interval`
/// seconds apart.
///
/// # Errors
/// [`MotionCaptureError::Singular`] if the even slices do not determine the parameters.
pub fn held_out(
    path: &Path,
    capture: &[TimedPose],
    all: &Fitted,
    drifts: bool,
    interval: f64,
) -> Result<HeldOut, MotionCaptureError> {
    let even = fit(path, capture, all.hand_eye, drifts, is_even)?.hand_eye;
    let of = |wanted: bool| slice_errors(&residuals(path, capture, &even, wanted), &even, interval);
    of(true).zip(of(false)).map(|(fitted, held_out)| HeldOut { fitted, held_out }).ok_or(MotionCaptureError::Singular)
}

/// Residual at one time.
struct Residual {
    t: f64,
    /// Error of the camera's centre (m, frame of the capture).
    position: Vector3<f64>,
    /// Error of the rotation (rad, axes of the body).
    rotation: Vector3<f64>,
}

fn residuals(path: &Path, capture: &[TimedPose], at: &HandEye, even: bool) -> Vec<Residual> {
    let matched = at.matched(path, capture).filter(|(body, _)| is_even(at.event_time(body.t)) == even);
    let residual = |(body, moment): (&TimedPose, super::path::Moment)| {
        let expected = at.mocap_world * moment.pose;
        let found: Isometry3<f64> = body.pose * at.camera_body.inverse();
        let rotation = (expected.rotation * at.camera_body.rotation).inverse() * body.pose.rotation;
        Residual {
            t: body.t,
            position: found.translation.vector - expected.translation.vector,
            rotation: rotation.scaled_axis(),
        }
    };
    matched.map(residual).collect()
}

fn slice_errors(residuals: &[Residual], at: &HandEye, interval: f64) -> Option<SliceErrors> {
    let slice = |residual: &Residual| (at.event_time(residual.t) / SLICE).floor() as i64;
    let slices: Vec<&[Residual]> = residuals.chunk_by(|a, b| slice(a) == slice(b)).collect();
    Some(SliceErrors {
        position: errors(&slices, interval, |one| one.position)?,
        rotation: errors(&slices, interval, |one| one.rotation)?,
    })
}

fn errors(slices: &[&[Residual]], interval: f64, of: fn(&Residual) -> Vector3<f64>) -> Option<Errors> {
    let sizes = Statistics::new(slices.iter().flat_map(|slice| slice.iter()).map(|one| of(one).norm()).collect())?;
    let noises: Vec<(f64, f64)> = slices.iter().map(|slice| noise(slice, interval, of)).collect();
    let (count, sum) = noises.iter().fold((0.0, 0.0), |all, one| (all.0 + one.0, all.1 + one.1));
    let noise = sum / f64::max(count, 1.0);
    // Squared error of each slice without noise, and their scatter.
    let squares: Vec<f64> = slices
        .iter()
        .map(|slice| slice.iter().map(|one| of(one).norm_squared()).sum::<f64>() / slice.len() as f64)
        .zip(&noises)
        .filter(|(_, (count, _))| *count > 0.0)
        .map(|(square, (count, sum))| square - sum / count)
        .collect();
    let scatter = Statistics::new(squares)?;
    let sigma = scatter.std / f64::max(scatter.count as f64 - 1.0, 1.0).sqrt();
    let square = sizes.rmse * sizes.rmse - noise;
    let value = square.max(0.0).sqrt();
    Some(Errors {
        sizes,
        noise: noise.sqrt(),
        error: Measured { value, sigma: 0.5 * sigma / value.max(sigma.sqrt()).max(f64::MIN_POSITIVE) },
    })
}

/// Returns the number of third differences in a slice, and the sum of the squared noise from them.
fn noise(slice: &[Residual], interval: f64, of: fn(&Residual) -> Vector3<f64>) -> (f64, f64) {
    let differences = slice.windows(4).filter_map(|four| {
        let even = four.windows(2).all(|pair| ((pair[1].t - pair[0].t) / interval - 1.0).abs() < EVEN);
        even.then(|| (of(&four[3]) - of(&four[0]) + (of(&four[1]) - of(&four[2])) * 3.0).norm_squared())
    });
    differences.fold((0.0, 0.0), |(count, sum), square| (count + 1.0, sum + square / THIRD_DIFFERENCE))
}

//! What is left between camera and capture, in slices of time that were fitted and in those that were not.
//!
//! Thirteen fitted numbers flatter an error. So they are fitted to every other slice, and what is left in the others is the error of
//! the trajectory. The capture scatters too: noise that differs from pose to pose shows in third differences, in which a
//! smooth motion has no part, and is taken off.

use nalgebra::{Isometry3, Vector3};
use serde::Serialize;

use super::error::MotionCaptureError;
use super::fit::{Fitted, HandEye, fit};
use super::path::Path;
use crate::numerics::statistics::Statistics;
use crate::trajectory::timed_pose::TimedPose;

/// Length of a slice (s).
pub const SLICE: f64 = 1.0;
/// How far the time between poses may be from the usual one where differences are taken, as a share of that.
const EVEN: f64 = 0.2;
/// Sum of the squares of the weights 1, −3, 3, −1.
const THIRD_DIFFERENCE: f64 = 20.0;

/// Errors in one half of the slices.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Errors {
    /// Distances between the camera's centre and where the capture puts it (m).
    pub position: Statistics,
    /// Root mean square of the capture's own noise in them (m).
    pub position_noise: f64,
    /// Angles between both orientations (rad).
    pub rotation: Statistics,
    /// Root mean square of the capture's own noise in them (rad).
    pub rotation_noise: f64,
}

impl Errors {
    /// Root mean square of the distances without the capture's noise (m): the absolute trajectory error.
    pub fn position_error(&self) -> f64 {
        without(self.position.rmse, self.position_noise)
    }

    /// The same of the angles (rad).
    pub fn rotation_error(&self) -> f64 {
        without(self.rotation.rmse, self.rotation_noise)
    }
}

fn without(whole: f64, noise: f64) -> f64 {
    (whole * whole - noise * noise).max(0.0).sqrt()
}

/// Errors in the slices that were fitted, and in the others.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOut {
    /// In the even slices, which were fitted.
    pub fitted: Errors,
    /// In the odd ones, which were not.
    pub held_out: Errors,
}

fn is_even(t: f64) -> bool {
    (t / SLICE).floor().rem_euclid(2.0) == 0.0
}

/// Fits the even slices from `all` on, and compares in both. Clocks may drift, poses are `interval` seconds apart.
///
/// # Errors
/// [`MotionCaptureError::Singular`] when even slices do not determine what lies between.
pub fn held_out(
    path: &Path,
    capture: &[TimedPose],
    all: &Fitted,
    (drifts, interval): (bool, f64),
) -> Result<HeldOut, MotionCaptureError> {
    let even = fit(path, capture, all.hand_eye, drifts, is_even)?.hand_eye;
    let of = |wanted: bool| errors(&residuals(path, capture, &even, wanted), interval);
    of(true).zip(of(false)).map(|(fitted, held_out)| HeldOut { fitted, held_out }).ok_or(MotionCaptureError::Singular)
}

/// What is left at one time.
struct Residual {
    t: f64,
    /// Of the camera's centre (m, frame of the capture).
    position: Vector3<f64>,
    /// Rad, axes of the body.
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

fn errors(residuals: &[Residual], interval: f64) -> Option<Errors> {
    let noise = |of: fn(&Residual) -> Vector3<f64>| {
        let differences = residuals.windows(4).filter_map(|four| {
            let even = four.windows(2).all(|pair| ((pair[1].t - pair[0].t) / interval - 1.0).abs() < EVEN);
            even.then(|| (of(&four[3]) - of(&four[0]) + (of(&four[1]) - of(&four[2])) * 3.0).norm_squared())
        });
        let (count, sum) = differences.fold((0.0, 0.0), |(count, sum), square| (count + 1.0, sum + square));
        (sum / (f64::max(count, 1.0) * THIRD_DIFFERENCE)).sqrt()
    };
    Some(Errors {
        position: Statistics::new(residuals.iter().map(|one| one.position.norm()).collect())?,
        position_noise: noise(|one| one.position),
        rotation: Statistics::new(residuals.iter().map(|one| one.rotation.norm()).collect())?,
        rotation_noise: noise(|one| one.rotation),
    })
}

//! Calibration of cameras from views of a board.

use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;

use super::{OpencvError, View, bridge, usable};

/// Distortion coefficients that `calibrateCamera` estimates; the others stay zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinholeDistortion {
    /// k1, k2, p1, p2.
    RadialTangential4,
    /// k1, k2, p1, p2, k3.
    RadialTangential5,
    /// k1, k2, p1, p2, k3, k4, k5, k6 (rational).
    RadialTangential8,
    /// k1, k2, k3 without tangential terms.
    Radial3,
}

impl PinholeDistortion {
    /// Returns the length of the coefficient vector in OpenCV's order.
    pub fn coefficient_count(self) -> usize {
        match self {
            Self::RadialTangential4 => 4,
            Self::RadialTangential5 | Self::Radial3 => 5,
            Self::RadialTangential8 => 8,
        }
    }
}

/// Camera matrix and distortion in OpenCV's order.
#[derive(Clone, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal lengths fx, fy in pixels.
    pub focal: [f64; 2],
    /// Principal point cx, cy in pixels.
    pub center: [f64; 2],
    /// k1, k2, p1, p2, … of a pinhole camera, k1 … k4 of a fisheye camera.
    pub distortion: Vec<f64>,
}

/// A calibration by OpenCV.
#[derive(Clone, Debug, PartialEq)]
pub struct OpencvCalibration {
    /// The camera.
    pub intrinsics: Intrinsics,
    /// Root mean square of the distances between measured and projected points, in pixels.
    pub rms: f64,
    /// Index of each used view in the input.
    pub views: Vec<usize>,
    /// Root mean square distance of each used view, in pixels.
    pub view_rms: Vec<f64>,
    /// `T_camera_world` of each used view.
    pub poses: Vec<Isometry3<f64>>,
}

/// Largest number of iterations of a calibration, and the relative change of the parameters at which it ends. The
/// bundle adjustment continues from the result.
const CALIBRATION_ITERATIONS: i32 = 40;
const CALIBRATION_CHANGE: f64 = 1e-7;

fn limits(sensor: Sensor, iterations: i32) -> bridge::Limits {
    let (width, height) = (sensor.width.into(), sensor.height.into());
    bridge::Limits { width, height, iterations, change: CALIBRATION_CHANGE }
}

/// Calls OpenCV's `calibrateCamera` (Zhang 2000) on `views` of a planar board.
///
/// `sensor` is the size in pixels, used for the initial principal point. With a `guess` the iteration starts there.
/// Views with fewer than [`MINIMUM_POINTS`](super::MINIMUM_POINTS) points are an error: the caller chooses the views.
pub fn calibrate_pinhole(
    views: &[View],
    sensor: Sensor,
    distortion: PinholeDistortion,
    guess: Option<&Intrinsics>,
) -> Result<OpencvCalibration, OpencvError> {
    if views.is_empty() || !views.iter().all(usable) {
        return Err(OpencvError::Input { call: "calibrateCamera" });
    }
    let mut coefficients = vec![0.0; distortion.coefficient_count()];
    let camera = guess.map(|guess| {
        coefficients.iter_mut().zip(&guess.distortion).for_each(|(start, guess)| *start = *guess);
        let ([fx, fy], [cx, cy]) = (guess.focal, guess.center);
        [fx, fy, cx, cy]
    });
    let views: Vec<&View> = views.iter().collect();
    let tangential = distortion != PinholeDistortion::Radial3;
    let limits = limits(sensor, CALIBRATION_ITERATIONS);
    bridge::calibrate_pinhole(&views, &limits, tangential, coefficients, camera)
}

fn calibrate_fisheye_once(views: &[&View], sensor: Sensor, iterations: i32) -> Result<OpencvCalibration, OpencvError> {
    bridge::calibrate_fisheye(views, &limits(sensor, iterations))
}

/// Returns the views among `indices` that OpenCV's fisheye calibration accepts, found by bisection.
fn digestible(views: &[View], indices: &[usize], sensor: Sensor) -> Vec<usize> {
    // With fewer views the calibration itself is undetermined, so a failure is not informative.
    const SMALLEST_SET: usize = 3;
    let chosen: Vec<&View> = indices.iter().filter_map(|&index| views.get(index)).collect();
    if calibrate_fisheye_once(&chosen, sensor, 3).is_ok() {
        return indices.to_vec();
    }
    if indices.len() < 2 * SMALLEST_SET {
        return Vec::new();
    }
    let (first, second) = indices.split_at(indices.len() / 2);
    let mut kept = digestible(views, first, sensor);
    kept.extend(digestible(views, second, sensor));
    kept
}

/// Calls OpenCV's `fisheye::calibrate` (Kannala-Brandt, k1 … k4) on `views` of a planar board.
///
/// OpenCV throws an exception because of a single unsuitable view; such views are found and excluded.
/// [`OpencvCalibration::views`] lists the views used.
pub fn calibrate_fisheye(views: &[View], sensor: Sensor) -> Result<OpencvCalibration, OpencvError> {
    if views.is_empty() || !views.iter().all(usable) {
        return Err(OpencvError::Input { call: "fisheye::calibrate" });
    }
    let all: Vec<&View> = views.iter().collect();
    let error = match calibrate_fisheye_once(&all, sensor, CALIBRATION_ITERATIONS) {
        Ok(calibration) => return Ok(calibration),
        Err(error) => error,
    };
    let indices: Vec<usize> = (0..views.len()).collect();
    let kept = digestible(views, &indices, sensor);
    if kept.is_empty() || kept.len() == views.len() {
        return Err(error);
    }
    let chosen: Vec<&View> = kept.iter().filter_map(|&index| views.get(index)).collect();
    calibrate_fisheye_once(&chosen, sensor, CALIBRATION_ITERATIONS)
        .map(|calibration| OpencvCalibration { views: kept, ..calibration })
}

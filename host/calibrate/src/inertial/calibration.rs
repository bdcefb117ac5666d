//! What the calibration of an inertial unit gives.

use std::ops::Range;

use evcal_core::camera::Camera;
use nalgebra::DMatrix;

use super::finding::Finding;
use super::joint::{Noise, Residual};
use super::noise::Line;
use super::parameters::{COUNT, InertialParameters};
use super::stream::StreamReport;

/// σ over that before any measurement, from which a parameter was not measured.
const PRIOR_SHARE: f64 = 0.5;

/// A calibrated inertial unit.
#[derive(Clone, Debug)]
pub struct InertialCalibration {
    /// What was found.
    pub parameters: InertialParameters,
    /// Covariance of all parameters, in their order.
    pub covariance: DMatrix<f64>,
    /// σ of each parameter before any measurement.
    pub prior_sigma: [f64; COUNT],
    /// Noise of gyroscope (rad/s/√Hz) and accelerometer (m/s²/√Hz).
    pub noise: [Noise; 2],
    /// Correlation of the turns of camera and unit at the start.
    pub correlation: f64,
    /// What was found in the streams, one a recording.
    pub streams: Vec<StreamReport>,
    /// Samples used.
    pub used: usize,
    /// By how much stamps of the unit were moved before all else because the clocks have different origins (s).
    pub clock_origin: f64,
    /// Stamp of the unit, on the clock of its file, at which the delays are stated (s).
    pub delays_at: f64,
    /// Distance of the knots of the trajectories that were solved for (s).
    pub knot_spacing: f64,
    /// The camera of the solve: with it the unit belongs together.
    pub camera: Camera<f64>,
    /// Largest distance of an intrinsic parameter from that of the camera calibrated alone, in σ of the difference;
    /// `None` where intrinsics of another model were held.
    pub camera_moved: Option<f64>,
    /// The camera at which intrinsics were held; `None` where they were solved for.
    pub held: Option<Camera<f64>>,
    /// Scatter of blocks over the formal variance, the mean over rotation, place and delays.
    pub block_scatter: f64,
    /// Largest angle between gravity and its mean direction, seen from the camera (rad).
    pub tilt: f64,
    /// Residuals of gyroscope (rad/s) and accelerometer (m/s²).
    pub residuals: [Vec<Residual>; 2],
    /// Their spectra, for each axis.
    pub spectra: [Vec<Vec<Line>>; 2],
    /// What speaks against it.
    pub findings: Vec<Finding>,
}

impl InertialCalibration {
    /// Standard deviation of a parameter.
    pub fn sigma(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].max(0.0).sqrt()
    }

    /// Whether the samples tell all of these parameters, such as the scales of a sensor, much better than what is expected of such chips.
    pub fn is_measured(&self, parameters: Range<usize>) -> bool {
        let sigmas = self.prior_sigma.iter().enumerate().skip(parameters.start).take(parameters.len());
        sigmas.into_iter().all(|(index, prior)| self.sigma(index) <= PRIOR_SHARE * prior)
    }

    /// Root mean square of the residuals of gyroscope (rad/s) and accelerometer (m/s²), over all axes.
    pub fn residual_rms(&self) -> [f64; 2] {
        self.residuals.each_ref().map(|residuals| rms(residuals))
    }
}

fn rms(residuals: &[Residual]) -> f64 {
    let sum: f64 = residuals.iter().map(|residual| residual.value.norm_squared()).sum();
    (sum / (3 * residuals.len().max(1)) as f64).sqrt()
}

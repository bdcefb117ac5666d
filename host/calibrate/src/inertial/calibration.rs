//! Result of the calibration of an IMU.

use std::ops::Range;

use evcal_core::camera::Camera;
use nalgebra::DMatrix;

use super::joint::{Noise, Residual};
use super::noise::Line;
use super::parameters::{BOARD_SCALE, COUNT, InertialParameters};
use super::stream::StreamReport;
use crate::quality::verdict::Finding;
use event_recordings::Files;

/// Ratio of σ to its prior value from which a parameter counts as not measured.
const PRIOR_SHARE: f64 = 0.5;

/// A calibrated IMU.
#[derive(Clone, Debug)]
pub struct InertialCalibration {
    /// The file of the samples, if they are not in the recordings of the camera.
    pub source_files: Files,
    /// Estimated parameters.
    pub parameters: InertialParameters,
    /// Covariance of all parameters, in their order.
    pub covariance: DMatrix<f64>,
    /// Prior σ of each parameter.
    pub prior_sigma: [f64; COUNT],
    /// Noise of gyroscope (rad/s/√Hz) and accelerometer (m/s²/√Hz).
    pub noise: [Noise; 2],
    /// Correlation of the rotation rates of camera and IMU at the start.
    pub correlation: f64,
    /// Reports on the streams, one per recording.
    pub streams: Vec<StreamReport>,
    /// Number of samples used.
    pub used: usize,
    /// Time by which timestamps of the IMU were shifted before everything else because the clocks have different origins (s).
    pub clock_origin: f64,
    /// Timestamp of the IMU, on the clock of its file, at which the delays apply (s).
    pub delays_at: f64,
    /// Knot spacing of the trajectories in the solve (s).
    pub knot_spacing: f64,
    /// The camera from the solve: the intrinsics that match the IMU's parameters.
    pub camera: Camera<f64>,
    /// Largest difference between an intrinsic parameter and its value in the calibration of the camera alone, in σ of the
    /// difference; `None` if the intrinsics were fixed at the intrinsics of another model.
    pub camera_moved: Option<f64>,
    /// The camera at which intrinsics were fixed; `None` if they were estimated.
    pub fixed: Option<Camera<f64>>,
    /// Ratio of the scatter of blocks to the formal variance, the mean over rotation, position and delays.
    pub block_scatter: f64,
    /// Largest angle between gravity and its mean direction, as seen from the camera (rad).
    pub tilt: f64,
    /// Residuals of gyroscope (rad/s) and accelerometer (m/s²).
    pub residuals: [Vec<Residual>; 2],
    /// Their spectra, for each axis.
    pub spectra: [Vec<Vec<Line>>; 2],
    /// Problems of the result.
    pub findings: Vec<Finding>,
}

impl InertialCalibration {
    /// Returns the standard deviation of a parameter.
    pub fn sigma(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].max(0.0).sqrt()
    }

    /// Returns `true` if the samples determine all of these parameters, such as the scales of a sensor, much better than the
    /// prior.
    pub fn is_measured(&self, parameters: Range<usize>) -> bool {
        let sigmas = self.prior_sigma.iter().enumerate().skip(parameters.start).take(parameters.len());
        sigmas.into_iter().all(|(index, prior)| self.sigma(index) <= PRIOR_SHARE * prior)
    }

    /// Returns `true` if the accelerometer measured accelerations of the camera: it knows the size of the board.
    pub fn shows_acceleration(&self) -> bool {
        /// Least size of the board, in σ.
        const CERTAIN: f64 = 5.0;
        self.parameters.board_scale > CERTAIN * self.sigma(BOARD_SCALE)
    }

    /// Returns the root mean square of the residuals of gyroscope (rad/s) and accelerometer (m/s²), over all axes.
    pub fn residual_rms(&self) -> [f64; 2] {
        self.residuals.each_ref().map(|residuals| rms(residuals))
    }
}

fn rms(residuals: &[Residual]) -> f64 {
    let sum: f64 = residuals.iter().map(|residual| residual.value.norm_squared()).sum();
    (sum / (3 * residuals.len().max(1)) as f64).sqrt()
}

//! Result of the calibration of a second camera.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;

use super::joint::Misfit;
use super::mount::Mount;
use crate::quality::verdict::Finding;

/// A second camera on the mount of the first.
#[derive(Clone, Debug)]
pub struct SecondCalibration {
    /// Mount: transform and clocks, with times since the first events of both recordings.
    pub mount: Mount,
    /// Covariance of its parameters, in their order.
    pub covariance: DMatrix<f64>,
    /// Ratio of the covariance to that with independent events.
    pub inflation: f64,
    /// Correlation of the rotation rates of both cameras at the start; `None` for pictures of one sensor with its events.
    pub correlation: Option<f64>,
    /// Seconds with the board in view of both cameras.
    pub seconds: f64,
    /// Number of used events, or centres of dots, of the second camera.
    pub used: usize,
    /// Share of its events that were excluded because the first camera has no trajectory at their times.
    pub left_out: f64,
    /// Ratio of the residuals of its events on the trajectory of the first camera to those on its own; `None` if it has none.
    pub looseness: Option<f64>,
    /// Spread (σ) of the errors of the times of its poses (s); `None` if they do not scatter.
    pub time_scatter: Option<f64>,
    /// Misfit of its events, in order of time.
    pub misfit: Vec<Misfit>,
    /// Sensor sizes of both cameras.
    pub sensors: [Sensor; 2],
    /// Both cameras from the solve of both.
    pub cameras: [Camera<f64>; 2],
    /// Largest difference between an intrinsic parameter of each camera and its value in the separate calibration, in its σ;
    /// `None` if the intrinsics were fixed at the intrinsics of another model.
    pub cameras_moved: [Option<f64>; 2],
    /// `true` for each camera whose intrinsics were fixed.
    pub fixed: [bool; 2],
    /// `true` if a rolling shutter was requested for the second camera.
    pub rolling_shutter: bool,
    /// Problems of the result.
    pub findings: Vec<Finding>,
}

impl SecondCalibration {
    /// Returns the standard deviation of a parameter of the mount.
    pub fn sigma(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].max(0.0).sqrt()
    }
}

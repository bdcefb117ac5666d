//! What the calibration of a second camera gives.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::DMatrix;

use super::finding::Finding;
use super::joint::Misfit;
use super::mount::Mount;

/// A second camera on the mount of the first.
#[derive(Clone, Debug)]
pub struct SecondCalibration {
    /// What lies between the cameras, both recordings counted from their first events.
    pub mount: Mount,
    /// Covariance of its parameters, in their order.
    pub covariance: DMatrix<f64>,
    /// How much larger that is than if events were independent.
    pub inflation: f64,
    /// Correlation of the turns of both cameras at the start; `None` for pictures of one sensor with its events.
    pub correlation: Option<f64>,
    /// Seconds with the board before both cameras.
    pub seconds: f64,
    /// Events, or centres of dots, of the second camera that were used.
    pub used: usize,
    /// Share of its events that were left out, for the first camera has no trajectory then.
    pub left_out: f64,
    /// Residuals of its events on the trajectory of the first camera over those on its own; `None` where it has none.
    pub looseness: Option<f64>,
    /// How well its events are explained, in order of time.
    pub misfit: Vec<Misfit>,
    /// Sensor sizes of both cameras.
    pub sensors: [Sensor; 2],
    /// Both cameras as the solve of both has them.
    pub cameras: [Camera<f64>; 2],
    /// Largest distance of an intrinsic parameter of each camera from that of the camera calibrated apart, in its σ; `None` where intrinsics
    /// of another model were held.
    pub cameras_moved: [Option<f64>; 2],
    /// Whether the intrinsics of each camera were held.
    pub held: [bool; 2],
    /// Whether the rows of the second camera's frames were said to be exposed one after the other.
    pub rolling_shutter: bool,
    /// What speaks against it.
    pub findings: Vec<Finding>,
}

impl SecondCalibration {
    /// Standard deviation of a parameter of the mount.
    pub fn sigma(&self, parameter: usize) -> f64 {
        self.covariance[(parameter, parameter)].max(0.0).sqrt()
    }
}

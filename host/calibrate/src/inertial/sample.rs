//! A reading of an IMU.

use nalgebra::Vector3;

/// One reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Timestamp (s).
    pub t: f64,
    /// Acceleration minus gravity (m/s²).
    pub acceleration: Vector3<f64>,
    /// Angular velocity (rad/s).
    pub angular_velocity: Vector3<f64>,
}

//! A reading of an inertial unit.

use nalgebra::Vector3;

/// One reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time stamp (s).
    pub t: f64,
    /// Acceleration less gravity (m/s²).
    pub acceleration: Vector3<f64>,
    /// Angular velocity (rad/s).
    pub angular_velocity: Vector3<f64>,
}

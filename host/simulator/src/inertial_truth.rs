//! Readings of a perfect IMU at the camera.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;

/// Half the time interval over which the motion is differentiated, in seconds.
const STEP: f64 = 1e-4;

/// Ideal readings, without bias, noise and filters, in the axes of the IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialTruth {
    /// Time in microseconds since the start of the recording.
    pub time: u64,
    /// Acceleration minus gravity, in g.
    pub acceleration: Vector3<f64>,
    /// Angular velocity in °/s.
    pub angular_velocity: Vector3<f64>,
}

impl InertialTruth {
    /// Computes the readings at `time` µs for a camera that moves along `pose` (`T_world_camera` at a time in seconds).
    pub fn new(pose: impl Fn(f64) -> Isometry3<f64>, time: u64) -> Self {
        let t = time as f64 * 1e-6;
        let [before, now, after] = [t - STEP, t, t + STEP].map(pose);
        let position = |pose: &Isometry3<f64>| pose.translation.vector;
        let acceleration = (position(&after) - 2.0 * position(&now) + position(&before)) / (STEP * STEP);
        let gravity = Vector3::new(0.0, STANDARD_GRAVITY, 0.0);
        let turn: UnitQuaternion<f64> = before.rotation.inverse() * after.rotation;
        Self {
            time,
            acceleration: now.rotation.inverse() * (acceleration - gravity) / STANDARD_GRAVITY,
            angular_velocity: (turn.scaled_axis() / (2.0 * STEP)).map(f64::to_degrees),
        }
    }
}

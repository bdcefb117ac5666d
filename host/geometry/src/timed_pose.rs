//! A pose of the camera at one time.

use nalgebra::Isometry3;

/// A pose and its time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// Time in seconds; the user of the type defines the clock.
    pub t: f64,
    /// `T_world_camera` in metres.
    pub pose: Isometry3<f64>,
}

//! The pose at the centre of a time bin, and its derivatives by the control points.

use evcal_core::spline::MAX_ORDER;
use nalgebra::{Matrix3, Vector3};

use crate::trajectory::{PoseSample, Trajectory};

/// Pose, velocity and Jacobians that the events of a time bin share.
#[derive(Clone, Debug)]
pub struct PoseBin {
    /// R_world_camera, row-major.
    pub rotation: [[f64; 3]; 3],
    /// Camera centre in world coordinates, metres.
    pub translation: [f64; 3],
    /// Angular velocity in the camera frame, rad/s.
    pub angular_velocity: [f64; 3],
    /// Velocity of the camera centre in world coordinates, m/s.
    pub linear_velocity: [f64; 3],
    /// First control point that the pose depends on.
    pub first: usize,
    /// Number of control points that the pose depends on.
    pub order: usize,
    /// Derivative of the rotation (camera frame) by the rotation of each control point.
    pub rotation_jacobians: [Matrix3<f64>; MAX_ORDER],
    /// Weight of each control point's translation.
    pub weights: [f64; MAX_ORDER],
}

impl PoseBin {
    /// Returns the pose of `trajectory` at time `t` in seconds; `None` outside its knots.
    pub fn new(trajectory: &Trajectory, t: f64) -> Option<Self> {
        Some(Self::of_sample(trajectory.sample(t)?))
    }

    /// Returns the pose of a sample of a trajectory.
    pub fn of_sample(sample: PoseSample) -> Self {
        let rotation = sample.rotation.rotation.to_rotation_matrix();
        let matrix = rotation.matrix();
        Self {
            rotation: std::array::from_fn(|row| std::array::from_fn(|column| matrix[(row, column)])),
            translation: sample.translation.into(),
            angular_velocity: sample.rotation.angular_velocity.into(),
            linear_velocity: sample.linear_velocity.into(),
            first: sample.basis.first,
            order: sample.basis.order,
            rotation_jacobians: sample.rotation.jacobians,
            weights: sample.basis.value,
        }
    }
}

impl PoseBin {
    /// Rotates a vector of the camera frame into the world frame.
    #[inline(always)]
    pub fn to_world(&self, vector: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|row| dot(&self.rotation[row], vector))
    }

    /// Rotates a vector of the world frame into the camera frame.
    #[inline(always)]
    pub fn to_camera(&self, vector: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|column| {
            self.rotation[0][column] * vector[0]
                + self.rotation[1][column] * vector[1]
                + self.rotation[2][column] * vector[2]
        })
    }

    /// Returns the rotation matrix R_world_camera.
    pub fn rotation_matrix(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.rotation[row][column])
    }

    /// Returns the camera centre in world coordinates, metres.
    pub fn translation_vector(&self) -> Vector3<f64> {
        Vector3::from(self.translation)
    }
}

/// Returns the cross product.
#[inline(always)]
pub fn cross(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Returns the dot product.
#[inline(always)]
pub fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

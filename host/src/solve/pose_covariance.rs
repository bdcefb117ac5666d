//! How sure each pose of a trajectory is.
//!
//! Given the global parameters, the control points c of a segment have the covariance A⁻¹, of which only the part
//! near the diagonal matters: a pose depends on neighbouring ones. The global parameters g have the covariance C_g
//! and take the control points with them, by A⁻¹B. So these have the covariance C = A⁻¹ + A⁻¹B C_g (A⁻¹B)ᵀ, and a pose whose
//! derivatives by its control points are J has J C Jᵀ, times the inflation of the intrinsics.

use nalgebra::{Matrix3, SMatrix};

use super::eliminated::ControlCovariance;
use crate::trajectory::Trajectory;

/// Standard deviation of a pose along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSigma {
    /// Of the camera centre along the axes of the world (m).
    pub position: [f64; 3],
    /// Of the rotation about the axes of the camera (rad).
    pub rotation: [f64; 3],
}

/// The covariance of all trajectories of a state.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseCovariance {
    segments: Vec<ControlCovariance>,
    inflation: f64,
}

impl PoseCovariance {
    /// From the covariance of the control points of each segment, which is too small by `inflation`.
    pub fn new(segments: Vec<ControlCovariance>, inflation: f64) -> Self {
        Self { segments, inflation }
    }

    /// How sure the pose of segment number `segment`, whose trajectory is `trajectory`, is at time `t` (s); `None` outside it.
    pub fn sigma(&self, segment: usize, trajectory: &Trajectory, t: f64) -> Option<PoseSigma> {
        let covariance = self.segments.get(segment)?;
        let sample = trajectory.sample(t)?;
        let basis = sample.basis;
        let by_points: Vec<SMatrix<f64, 6, 6>> = basis
            .value
            .iter()
            .zip(&sample.rotation.jacobians)
            .take(basis.order)
            .map(|(weight, jacobian)| {
                let mut by_point = SMatrix::<f64, 6, 6>::zeros();
                by_point.fixed_view_mut::<3, 3>(0, 0).copy_from(jacobian);
                by_point.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Matrix3::identity() * *weight));
                by_point
            })
            .collect();
        let mut variances = [0.0; 6];
        for (row, by_row) in by_points.iter().enumerate() {
            for (column, by_column) in by_points.iter().enumerate().take(row + 1) {
                let moved = by_row * covariance.block(basis.first + row, row - column)?;
                // Each pair of control points counts in both orders.
                let times = if row == column { 1.0 } else { 2.0 };
                for (axis, variance) in variances.iter_mut().enumerate() {
                    *variance += times * moved.row(axis).dot(&by_column.row(axis));
                }
            }
        }
        let [rx, ry, rz, tx, ty, tz] = variances.map(|variance| (self.inflation * variance).max(0.0).sqrt());
        Some(PoseSigma { position: [tx, ty, tz], rotation: [rx, ry, rz] })
    }
}

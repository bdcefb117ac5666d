//! How sure each pose of a trajectory is.
//!
//! Given the global parameters, the control points c of a segment have the covariance A⁻¹, of which only the part
//! near the diagonal matters: a pose depends on neighbouring ones. The global parameters g have the covariance C_g
//! and take the control points with them, by A⁻¹B. A pose whose derivatives by its control points are J has
//! J A⁻¹ Jᵀ + (J A⁻¹B) C_g (J A⁻¹B)ᵀ, times the inflation of the intrinsics.

use nalgebra::{DMatrix, Matrix3, SMatrix};

use super::levenberg::assemble;
use super::stretch::stretches;
use super::system::ControlCovariance;
use super::{Problem, SolveError, State};
use crate::trajectory::{CONTROL_POINT_PARAMETERS as CONTROL_POINT, Trajectory};

/// Standard deviation of a pose along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSigma {
    /// Of the camera centre along the axes of the world (m).
    pub position: [f64; 3],
    /// Of the rotation about the axes of the camera (rad).
    pub rotation: [f64; 3],
}

/// The covariance of all trajectories of a state.
#[derive(Clone, Debug)]
pub struct PoseCovariance {
    segments: Vec<Option<ControlCovariance>>,
    globals: DMatrix<f64>,
    inflation: f64,
}

impl PoseCovariance {
    /// The covariance of the trajectories of `state`, which solves `problem`; formal ones are too small by `inflation`.
    ///
    /// # Errors
    /// [`SolveError::Singular`] when the observations do not determine the free parameters.
    pub fn new(problem: &Problem, state: &State, inflation: f64) -> Result<Self, SolveError> {
        let system = assemble(problem, state, &stretches(&problem.segments));
        let free = problem.free.mask();
        let globals = system.global_covariance(&free).map_err(|_| SolveError::Singular)?;
        Ok(Self { segments: system.control_covariances(&free), globals, inflation })
    }

    /// How sure the pose of segment number `segment`, whose trajectory is `trajectory`, is at time `t` (s); `None` outside it.
    pub fn sigma(&self, segment: usize, trajectory: &Trajectory, t: f64) -> Option<PoseSigma> {
        let covariance = self.segments.get(segment)?.as_ref()?;
        let sample = trajectory.sample(t)?;
        let basis = sample.basis;
        let parts = || {
            let weights = basis.value.iter().zip(&sample.rotation.jacobians).take(basis.order).enumerate();
            weights.map(|(place, (weight, jacobian))| {
                let mut by_point = SMatrix::<f64, 6, 6>::zeros();
                by_point.fixed_view_mut::<3, 3>(0, 0).copy_from(jacobian);
                by_point.fixed_view_mut::<3, 3>(3, 3).copy_from(&(Matrix3::identity() * *weight));
                (CONTROL_POINT * (basis.first + place), by_point)
            })
        };
        let mut own = SMatrix::<f64, 6, 6>::zeros();
        let mut moved = DMatrix::<f64>::zeros(CONTROL_POINT, covariance.follows.len());
        for (row, by_row) in parts() {
            for (column, by_column) in parts() {
                let block = SMatrix::<f64, 6, 6>::from_fn(|a, b| covariance.own.at(row + a, column + b));
                own += by_row * block * by_column.transpose();
            }
            for (global, follows) in covariance.follows.iter().enumerate() {
                let part = SMatrix::<f64, 6, 1>::from_fn(|axis, _| follows.get(row + axis).copied().unwrap_or(0.0));
                let mut column = moved.column_mut(global);
                column += by_row * part;
            }
        }
        let from_globals = &moved * &self.globals * moved.transpose();
        let sigma = |axis: usize| (self.inflation * (own[(axis, axis)] + from_globals[(axis, axis)])).max(0.0).sqrt();
        Some(PoseSigma { position: [sigma(3), sigma(4), sigma(5)], rotation: [sigma(0), sigma(1), sigma(2)] })
    }
}

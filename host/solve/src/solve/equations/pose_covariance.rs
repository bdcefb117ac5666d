//! Uncertainty of each pose of a trajectory.
//!
//! Given the global parameters, the control points c of a segment have the covariance A⁻¹. Only the part near the diagonal is
//! needed, because a pose depends on neighbouring control points. The global parameters g have the covariance C_g, and the
//! control points follow them by A⁻¹B. So the control points have the covariance C = A⁻¹ + A⁻¹B C_g (A⁻¹B)ᵀ. A pose
//! whose derivatives by its control points are J has the covariance J C Jᵀ, times the inflation of the intrinsics.
//!
//! The events around a moment also share the errors that the event biases do not describe. The resulting error of the
//! pose grows with its variance, not with its σ. The inflation includes the usual size of this error in a recording;
//! the σ of a pose that is several times less certain than usual is enlarged further ([`PoseCovariance::new`]).

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::eliminated::ControlCovariance;
use crate::trajectory::Trajectory;
use evcal_geometry::numerics::statistics::median;

/// Standard deviation of a pose along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseSigma {
    /// σ of the camera centre along the axes of the world (m).
    pub position: [f64; 3],
    /// σ of the rotation about the axes of the camera (rad).
    pub rotation: [f64; 3],
    /// Ratio of the pose's σ to the usual σ in its recording, from the scatter of its events alone; 1 if the usual σ is not
    /// known.
    pub weakness: f64,
}

/// Usual σ in a recording (medians) of the centre (m) and of the rotation (rad); each is the length of the vector of three σ.
#[derive(Clone, Copy, Debug, PartialEq)]
struct UsualSigma {
    position: f64,
    rotation: f64,
    /// Errors that the event biases do not describe, as a share of the usual σ.
    model_error: f64,
}

/// The covariance of all trajectories of a state.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseCovariance {
    segments: Vec<ControlCovariance>,
    inflation: f64,
    /// `None` without poses.
    usual: Option<UsualSigma>,
}

/// Time between the poses from which the usual σ is computed (s).
const STEP: f64 = 0.02;

impl PoseCovariance {
    /// Computes the covariance from the covariance of the control points of each segment, which is too small by `inflation`. The
    /// usual σ comes from poses along the `trajectories`. Errors that the event biases do not describe are added: the share
    /// `model_error` of the usual σ, times the square of the ratio of the pose's σ to the usual one.
    pub fn new(
        segments: Vec<ControlCovariance>,
        inflation: f64,
        trajectories: &[Trajectory],
        model_error: f64,
    ) -> Self {
        let of_events = Self { segments, inflation, usual: None };
        let (mut positions, mut rotations) = (Vec::new(), Vec::new());
        for (segment, trajectory) in trajectories.iter().enumerate() {
            let count = ((trajectory.end() - trajectory.start()) / STEP).max(1.0) as usize;
            let times = (0..count).map(|step| trajectory.start() + (step as f64 + 0.5) * STEP);
            for sigma in times.filter_map(|t| of_events.of_events(segment, trajectory, t)) {
                positions.push(length(sigma.position));
                rotations.push(length(sigma.rotation));
            }
        }
        let middle = |values: &mut [f64]| median(values, f64::total_cmp).filter(|sigma| *sigma > 0.0);
        let usual = middle(&mut positions).zip(middle(&mut rotations));
        let usual = usual.map(|(position, rotation)| UsualSigma { position, rotation, model_error });
        Self { usual, ..of_events }
    }

    /// Returns the uncertainty of the pose of segment number `segment`, whose trajectory is `trajectory`, at time `t` (s); `None`
    /// outside it.
    pub fn sigma(&self, segment: usize, trajectory: &Trajectory, t: f64) -> Option<PoseSigma> {
        let sigma = self.of_events(segment, trajectory, t)?;
        Some(self.usual.map_or(sigma, |usual| usual.widened(sigma)))
    }

    /// Returns the uncertainty from the scatter of the events alone.
    fn of_events(&self, segment: usize, trajectory: &Trajectory, t: f64) -> Option<PoseSigma> {
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
        Some(PoseSigma { position: [tx, ty, tz], rotation: [rx, ry, rz], weakness: 1.0 })
    }
}

impl UsualSigma {
    /// Adds the errors that the event biases do not describe to `sigma`, which comes from the scatter of events.
    fn widened(&self, sigma: PoseSigma) -> PoseSigma {
        let (position, rotation) = (length(sigma.position) / self.position, length(sigma.rotation) / self.rotation);
        let with_error = |sigma: [f64; 3], weakness: f64| {
            let larger = libm::hypot(1.0, self.model_error * weakness);
            sigma.map(|sigma| larger * sigma)
        };
        PoseSigma {
            position: with_error(sigma.position, position),
            rotation: with_error(sigma.rotation, rotation),
            weakness: position.max(rotation),
        }
    }
}

fn length(sigma: [f64; 3]) -> f64 {
    Vector3::from(sigma).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sigma_of_a_weakly_determined_pose_is_enlarged() {
        let usual = UsualSigma { position: 2e-3, rotation: 1e-3, model_error: 0.5 };
        let of = |position: f64, rotation: f64| {
            usual.widened(PoseSigma { position: [position, 0.0, 0.0], rotation: [0.0, rotation, 0.0], weakness: 1.0 })
        };
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        // The error of the model is half of the usual σ, and grows with the variance: 16 times half of 2 mm, added to 8 mm.
        let weak = of(8e-3, 1e-3);
        assert!(near(weak.position[0], libm::hypot(8e-3, 16e-3)) && near(weak.weakness, 4.0), "{weak:?}");
        assert!(near(weak.rotation[1], libm::hypot(1e-3, 0.5e-3)), "{weak:?}");
        // The larger of both ratios counts.
        assert!(near(of(2e-3, 3e-3).weakness, 3.0));
        assert_eq!(weak.position[1..], [0.0, 0.0]);
    }
}

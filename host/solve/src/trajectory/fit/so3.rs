//! Gauss-Newton for the control points of an SO(3) spline.
//!
//! Minimises the squared angles between the curve and the samples, plus the pull towards constant angular velocity, over a
//! rotation of every control point that is not fixed. The normal equations are banded with blocks of 3 × 3.

use evcal_core::spline::rotation::{exp, log, right_jacobian_inverse};
use evcal_core::spline::{SplineError, so3};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::super::TrajectoryError;
use super::{Design, EvenPull};
use evcal_geometry::numerics::banded::BandedCholesky;

/// Largest number of Gauss-Newton steps for an SO(3) spline; from the quaternion fit three or four suffice.
const GAUSS_NEWTON_STEPS: usize = 10;

/// Gauss-Newton ends when no control point rotates by more than this, in radians.
const GAUSS_NEWTON_TOLERANCE: f64 = 1e-12;

impl Design<'_> {
    /// Returns the control points of the SO(3) curve nearest to `samples`, by Gauss-Newton from `control`.
    pub(super) fn fit_so3(
        &self,
        samples: &[UnitQuaternion<f64>],
        mut control: Vec<UnitQuaternion<f64>>,
    ) -> Result<Vec<UnitQuaternion<f64>>, TrajectoryError> {
        let smoothness = self.smoothness();
        let (mut cost, mut equations) = self.so3_equations(samples, &smoothness, &control)?;
        for _ in 0..GAUSS_NEWTON_STEPS {
            let step = equations.solve()?;
            let moved: Vec<_> = control
                .iter()
                .zip(&step)
                .map(|(point, turn)| UnitQuaternion::new_normalize((point * exp(turn)).into_inner()))
                .collect();
            let (moved_cost, moved_equations) = self.so3_equations(samples, &smoothness, &moved)?;
            if moved_cost >= cost || moved_cost.is_nan() {
                break;
            }
            (control, cost, equations) = (moved, moved_cost, moved_equations);
            if step.iter().all(|turn| turn.amax() < GAUSS_NEWTON_TOLERANCE) {
                break;
            }
        }
        Ok(control)
    }

    /// Returns the cost of an SO(3) curve and its normal equations.
    fn so3_equations(
        &self,
        samples: &[UnitQuaternion<f64>],
        smoothness: &[EvenPull],
        control: &[UnitQuaternion<f64>],
    ) -> Result<(f64, TurnEquations), TrajectoryError> {
        let mut cost = 0.0;
        let mut equations = TurnEquations::new(control.len(), self.bandwidth());
        for (&t, rotation) in self.times.iter().zip(samples) {
            let basis = self.knots.basis(t)?;
            let sample = so3::evaluate(&basis, control).ok_or(SplineError::TooFewControlPoints)?;
            let residual = log(&(sample.rotation.inverse() * rotation));
            cost += residual.norm_squared();
            equations.add(self, basis.first, &sample.jacobians[..basis.order], &residual);
        }
        for &EvenPull { first, before, after } in smoothness {
            let steps = [first, first + 1].map(|index| log(&(control[index].inverse() * control[index + 1])));
            let residual = steps[0] * before - steps[1] * after;
            cost += residual.norm_squared();
            // A rotation of either end of a step changes it by the inverse Jacobians, left and right.
            let [inverse_before, inverse_after] = steps.map(|step| right_jacobian_inverse(&step));
            let jacobians = [
                inverse_before.transpose() * before,
                -inverse_before * before - inverse_after.transpose() * after,
                inverse_after * after,
            ];
            equations.add(self, first, &jacobians, &residual);
        }
        for index in (0..control.len()).filter(|&index| self.is_fixed(index)) {
            (0..3).for_each(|axis| equations.matrix.add(3 * index + axis, 3 * index + axis, 1.0));
        }
        Ok((cost, equations))
    }
}

/// Normal equations for a rotation of every control point.
struct TurnEquations {
    matrix: BandedCholesky,
    right: Vec<f64>,
}

impl TurnEquations {
    fn new(count: usize, bandwidth: usize) -> Self {
        Self { matrix: BandedCholesky::zeros(3 * count, 3 * bandwidth + 2), right: vec![0.0; 3 * count] }
    }

    /// Adds the equation `Σ jacobians[i] δ_{first + i} = residual`; fixed control points do not rotate.
    fn add(&mut self, design: &Design, first: usize, jacobians: &[Matrix3<f64>], residual: &Vector3<f64>) {
        let free = |index: &(usize, &Matrix3<f64>)| !design.is_fixed(first + index.0);
        for (a, jacobian_a) in jacobians.iter().enumerate().filter(free) {
            for (b, jacobian_b) in jacobians.iter().enumerate().take(a + 1).filter(free) {
                let block = jacobian_a.transpose() * jacobian_b;
                for row in 0..3 {
                    for column in 0..if a == b { row + 1 } else { 3 } {
                        self.matrix.add(3 * (first + a) + row, 3 * (first + b) + column, block[(row, column)]);
                    }
                }
            }
            let pull = jacobian_a.transpose() * residual;
            let right = &mut self.right[3 * (first + a)..];
            right.iter_mut().zip(&pull).for_each(|(right, pull)| *right += pull);
        }
    }

    fn solve(mut self) -> Result<Vec<Vector3<f64>>, TrajectoryError> {
        self.matrix.factor().map_err(|row| TrajectoryError::Undetermined { control_point: row / 3 })?;
        self.matrix.solve_in_place(&mut self.right);
        Ok(self.right.as_chunks().0.iter().map(|&turn: &[f64; 3]| Vector3::from(turn)).collect())
    }
}

//! Least squares with an arrow-shaped matrix: many poses, each with its own residuals, and border parameters shared by
//! all residuals.
//!
//! The normal equations have a 6 × 6 block per pose and a border. Each pose is eliminated by the Schur complement of
//! its block; then the border is solved, and the poses follow from it (Triggs et al. 2000, *Bundle Adjustment: A Modern
//! Synthesis*, section 6.1).

use nalgebra::allocator::Allocator;
use nalgebra::{Cholesky, DefaultAllocator, Dim, Matrix6, OMatrix, OVector, SMatrix, SVector, U6, Vector2, Vector6};

/// The normal equations of one pose and `N` border parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseEquations<const N: usize> {
    /// JᵀJ of the border parameters.
    pub border: SMatrix<f64, N, N>,
    /// Jᵀr of the border parameters.
    pub border_gradient: SVector<f64, N>,
    /// JᵀJ between the border parameters and the pose.
    mixed: SMatrix<f64, N, 6>,
    /// JᵀJ of the pose.
    block: Matrix6<f64>,
    /// Jᵀr of the pose.
    block_gradient: Vector6<f64>,
    /// Sum of the weighted squares of the residuals.
    pub squares: f64,
}

impl<const N: usize> PoseEquations<N> {
    /// Creates equations without residuals.
    pub fn new() -> Self {
        Self {
            border: SMatrix::zeros(),
            border_gradient: SVector::zeros(),
            mixed: SMatrix::zeros(),
            block: Matrix6::zeros(),
            block_gradient: Vector6::zeros(),
            squares: 0.0,
        }
    }

    /// Adds a residual (px) with its derivatives.
    pub fn add(
        &mut self,
        error: Vector2<f64>,
        by_border: &SMatrix<f64, 2, N>,
        by_pose: &SMatrix<f64, 2, 6>,
        weight: f64,
    ) {
        let weighted_border = by_border.transpose() * weight;
        let weighted_pose = by_pose.transpose() * weight;
        self.border += weighted_border * by_border;
        self.border_gradient += weighted_border * error;
        self.mixed += weighted_border * by_pose;
        self.block += weighted_pose * by_pose;
        self.block_gradient += weighted_pose * error;
        self.squares += weight * error.norm_squared();
    }

    /// Eliminates the pose, after raising the diagonal of its block by `damping` times itself; returns `None` if the
    /// residuals do not determine the pose.
    pub fn eliminate(&self, damping: f64) -> Option<Eliminated<N>> {
        let mut block = self.block;
        for index in 0..6 {
            block[(index, index)] *= 1.0 + damping;
        }
        let factor = block.cholesky()?;
        let border = self.mixed * factor.solve(&self.mixed.transpose());
        let gradient = self.mixed * factor.solve(&self.block_gradient);
        Some(Eliminated { border, gradient, factor })
    }

    /// Returns the step of the pose that corresponds to a step of the border.
    pub fn pose_step(&self, eliminated: &Eliminated<N>, border_step: &SVector<f64, N>) -> Vector6<f64> {
        -eliminated.factor.solve(&(self.block_gradient + self.mixed.transpose() * border_step))
    }
}

impl<const N: usize> Default for PoseEquations<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Contribution of an eliminated pose to the border's equations.
#[derive(Clone, Debug)]
pub struct Eliminated<const N: usize> {
    /// To be subtracted from the border's matrix.
    pub border: SMatrix<f64, N, N>,
    /// To be subtracted from the border's gradient.
    pub gradient: SVector<f64, N>,
    /// Factor of the pose's block.
    factor: Cholesky<f64, U6>,
}

/// Returns a symmetric matrix scaled to a unit diagonal, and the scale of its rows and columns; rows without a positive
/// diagonal keep their scale.
pub fn unit_diagonal<D: Dim>(matrix: &OMatrix<f64, D, D>) -> (OMatrix<f64, D, D>, OVector<f64, D>)
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    let scale = matrix.diagonal().map(|value| if value > 0.0 { 1.0 / value.sqrt() } else { 1.0 });
    let (rows, columns) = matrix.shape_generic();
    let entry = |row: usize, column: usize| matrix[(row, column)] * scale[row] * scale[column];
    (OMatrix::from_fn_generic(rows, columns, entry), scale)
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const BORDER: usize = 3;
    const POSES: usize = 4;

    /// The whole system, damped as in [`PoseEquations::eliminate`] and solved at once, has the same solution.
    #[test]
    fn elimination_solves_the_whole_system() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut number = move || random.random_range(-1.0..1.0);
        let size = BORDER + 6 * POSES;
        let (mut matrix, mut right) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut poses = vec![PoseEquations::<BORDER>::new(); POSES];
        for (place, pose) in poses.iter_mut().enumerate() {
            for _ in 0..10 {
                let by_border = SMatrix::<f64, 2, BORDER>::from_fn(|_, _| number());
                let by_pose = SMatrix::<f64, 2, 6>::from_fn(|_, _| number());
                let (error, weight) = (Vector2::new(number(), number()), 0.5 + number().abs());
                pose.add(error, &by_border, &by_pose, weight);
                let mut row = DMatrix::zeros(2, size);
                row.columns_mut(0, BORDER).copy_from(&by_border);
                row.columns_mut(BORDER + 6 * place, 6).copy_from(&by_pose);
                matrix += row.transpose() * &row * weight;
                right += row.transpose() * error * weight;
            }
        }
        let damping = 0.3;
        (BORDER..size).for_each(|index| matrix[(index, index)] *= 1.0 + damping);
        let expected = -matrix.cholesky().unwrap().solve(&right);

        let eliminated: Vec<_> = poses.iter().map(|pose| pose.eliminate(damping).unwrap()).collect();
        let mut border = SMatrix::<f64, BORDER, BORDER>::zeros();
        let mut gradient = SVector::<f64, BORDER>::zeros();
        for (pose, eliminated) in poses.iter().zip(&eliminated) {
            border += pose.border - eliminated.border;
            gradient += pose.border_gradient - eliminated.gradient;
        }
        let (border, scale) = unit_diagonal(&border);
        assert!(border.diagonal().iter().all(|value| (value - 1.0).abs() < 1e-15));
        let step = -border.cholesky().unwrap().solve(&gradient.component_mul(&scale)).component_mul(&scale);
        assert!((step - expected.rows(0, BORDER)).norm() < 1e-9 * expected.norm());
        for (place, (pose, eliminated)) in poses.iter().zip(&eliminated).enumerate() {
            let expected = expected.rows(BORDER + 6 * place, 6);
            assert!((pose.pose_step(eliminated, &step) - expected).norm() < 1e-9 * expected.norm());
        }
    }

    #[test]
    fn a_pose_without_residuals_is_not_determined() {
        assert!(PoseEquations::<BORDER>::new().eliminate(1.0).is_none());
    }
}

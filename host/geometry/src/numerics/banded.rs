//! Cholesky factorisation of symmetric, positive definite, banded matrices.
//!
//! The normal equations of a spline couple only control points that share a knot span, so they are banded: factoring
//! takes `dimension · bandwidth²` steps instead of `dimension³/3`. The lower band is stored row by row, so that the
//! inner loops run over contiguous memory. Sums always have the same order, so the result does not depend on the
//! machine.

use super::panel::{Panel, backward, forward};

/// A symmetric banded matrix `A`, then its factor `L` with `A = L Lᵀ`.
///
/// Fill it with [`BandedCholesky::add`] or [`BandedCholesky::row_mut`], call
/// [`BandedCholesky::factor`], then [`BandedCholesky::solve_in_place`] as often as needed.
///
/// ```
/// let mut matrix = evcal_geometry::numerics::banded::BandedCholesky::zeros(3, 1);
/// for row in 0..3 {
///     matrix.add(row, row, 2.0);
/// }
/// matrix.add(1, 0, -1.0);
/// matrix.add(2, 1, -1.0);
/// assert_eq!(matrix.factor(), Ok(()));
/// let mut solution = [1.0, 0.0, 1.0];
/// matrix.solve_in_place(&mut solution);
/// assert!(solution.iter().all(|value| (value - 1.0).abs() < 1e-15));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct BandedCholesky {
    dimension: usize,
    bandwidth: usize,
    /// Row `i` contains columns `i - bandwidth ..= i`; columns before 0 stay zero. After factoring the diagonal
    /// contains the reciprocals of L's diagonal.
    rows: Vec<f64>,
}

impl BandedCholesky {
    /// Creates the zero matrix of `dimension` rows and columns with `bandwidth` diagonals below the main one.
    pub fn zeros(dimension: usize, bandwidth: usize) -> Self {
        Self { dimension, bandwidth, rows: vec![0.0; dimension * (bandwidth + 1)] }
    }

    /// Returns the number of rows and columns.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Returns the number of diagonals below the main one.
    pub fn bandwidth(&self) -> usize {
        self.bandwidth
    }

    /// Sets every entry to zero, for another matrix of the same shape.
    pub fn clear(&mut self) {
        self.rows.fill(0.0);
    }

    /// Returns the part of row `row` from column `row - bandwidth` (or 0) to the diagonal.
    ///
    /// # Panics
    /// If `row` is not below the dimension.
    pub fn row_mut(&mut self, row: usize) -> &mut [f64] {
        let width = self.bandwidth + 1;
        &mut self.rows[row * width + self.bandwidth.saturating_sub(row)..(row + 1) * width]
    }

    /// Adds `value` to the entry at (`row`, `column`) of the lower triangle.
    ///
    /// # Panics
    /// If the entry lies outside the lower band.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        assert!(
            row < self.dimension && column <= row && row - column <= self.bandwidth,
            "entry ({row}, {column}) lies outside the lower band"
        );
        self.rows[row * self.bandwidth + self.bandwidth + column] += value;
    }

    /// Replaces `A` by its factor.
    ///
    /// # Errors
    /// Returns the row of the first pivot that is not positive, to the precision of its diagonal entry: `A` is not
    /// positive definite. The contents are then undefined.
    pub fn factor(&mut self) -> Result<(), usize> {
        let bandwidth = self.bandwidth;
        let width = bandwidth + 1;
        for i in 0..self.dimension {
            let (done, rest) = self.rows.split_at_mut(i * width);
            let row = &mut rest[..width];
            // Entry c of this row belongs to column i - bandwidth + c.
            let first = bandwidth.saturating_sub(i);
            let above = done[done.len() - (bandwidth - first) * width..].chunks_exact(width);
            for (c, above) in (first..bandwidth).zip(above) {
                // The row above is shifted: its entry of the same column is `bandwidth - c` further.
                let sum = dot(&row[first..c], &above[first + bandwidth - c..bandwidth]);
                row[c] = (row[c] - sum) * above[bandwidth];
            }
            let diagonal = row[bandwidth];
            let pivot = diagonal - dot(&row[first..bandwidth], &row[first..bandwidth]);
            // Written so that a NaN is rejected.
            if !(pivot > diagonal * f64::EPSILON && pivot.is_finite()) {
                return Err(i);
            }
            row[bandwidth] = pivot.sqrt().recip();
        }
        Ok(())
    }

    /// Replaces each right-hand side by the solution of `A x = b`; [`BandedCholesky::factor`] must have succeeded.
    /// `columns` contains one or more right-hand sides, one after the other.
    ///
    /// # Panics
    /// If the length of `columns` is not a multiple of the dimension.
    pub fn solve_in_place(&self, columns: &mut [f64]) {
        if self.dimension == 0 {
            return;
        }
        assert!(columns.len().is_multiple_of(self.dimension), "a right-hand side has the dimension of the matrix");
        let (bandwidth, width) = (self.bandwidth, self.bandwidth + 1);
        for column in columns.chunks_exact_mut(self.dimension) {
            // L y = b
            for (i, row) in self.rows.chunks_exact(width).enumerate() {
                let count = bandwidth.min(i);
                let (solved, rest) = column.split_at_mut(i);
                rest[0] = (rest[0] - dot(&row[bandwidth - count..bandwidth], &solved[i - count..])) * row[bandwidth];
            }
            self.solve_transposed_in_place(column);
        }
    }

    /// Replaces `column` by the solution of `Lᵀ x = column`; [`BandedCholesky::factor`] must have succeeded.
    ///
    /// # Panics
    /// If `column` is shorter than the dimension.
    pub fn solve_transposed_in_place(&self, column: &mut [f64]) {
        let (bandwidth, width) = (self.bandwidth, self.bandwidth + 1);
        for (i, row) in self.rows.chunks_exact(width).enumerate().rev() {
            let count = bandwidth.min(i);
            let (open, solved) = column.split_at_mut(i);
            let value = solved[0] * row[bandwidth];
            solved[0] = value;
            for (open, entry) in open[i - count..].iter_mut().zip(&row[bandwidth - count..bandwidth]) {
                *open -= entry * value;
            }
        }
    }

    /// Replaces each vector b of `panel` by the solution of `L y = b`; [`BandedCholesky::factor`] must have succeeded.
    pub fn forward(&self, panel: &mut Panel) {
        forward(&self.rows, self.bandwidth, panel);
    }

    /// Replaces each vector y of `panel` by the solution of `Lᵀ x = y`; [`BandedCholesky::factor`] must have succeeded.
    pub fn backward(&self, panel: &mut Panel) {
        backward(&self.rows, self.bandwidth, panel);
    }
}

/// Entries of a symmetric matrix near its diagonal.
#[derive(Clone, Debug, PartialEq)]
pub struct SymmetricBand {
    bandwidth: usize,
    rows: Vec<f64>,
}

impl SymmetricBand {
    /// Returns the entry at (`row`, `column`); 0 outside the matrix or the band.
    pub fn at(&self, row: usize, column: usize) -> f64 {
        let (row, column) = (row.max(column), row.min(column));
        if row - column > self.bandwidth {
            return 0.0;
        }
        self.rows.get(row * self.bandwidth + self.bandwidth + column).copied().unwrap_or(0.0)
    }
}

impl BandedCholesky {
    /// Returns the entries of A⁻¹ inside the band, without computing the rest (Takahashi, Fagan and Chin 1973);
    /// [`BandedCholesky::factor`] must have succeeded.
    pub fn inverse_band(&self) -> SymmetricBand {
        let (bandwidth, width) = (self.bandwidth, self.bandwidth + 1);
        let place = |row: usize, column: usize| row * bandwidth + bandwidth + column;
        let mut rows = vec![0.0; self.dimension * width];
        for column in (0..self.dimension).rev() {
            let end = (column + width).min(self.dimension);
            let reciprocal = self.rows[place(column, column)];
            for row in (column..end).rev() {
                let sum: f64 = (column + 1..end)
                    .map(|other| self.rows[place(other, column)] * rows[place(row.max(other), row.min(other))])
                    .sum();
                let own = if row == column { reciprocal } else { 0.0 };
                rows[place(row, column)] = (own - sum) * reciprocal;
            }
        }
        SymmetricBand { bandwidth, rows }
    }
}

/// Returns the dot product, summed in four partial sums, which a compiler keeps in one register.
#[inline]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a_parts, a_rest) = a.as_chunks::<4>();
    let (b_parts, b_rest) = b.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (a, b) in a_parts.iter().zip(b_parts) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::numerics::panel::{PANEL, panel_product};

    /// Returns a random positive definite banded matrix: `B Bᵀ` with a banded, lower triangular `B`, plus a diagonal
    /// that limits the condition number to about 1000.
    fn random(dimension: usize, bandwidth: usize, seed: u64) -> DMatrix<f64> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let factor = DMatrix::from_fn(dimension, dimension, |row, column| {
            if column <= row && row - column <= bandwidth { random.random_range(-1.0..1.0) } else { 0.0 }
        });
        &factor * factor.transpose() + DMatrix::identity(dimension, dimension) * 1e-3 * (1 + bandwidth) as f64
    }

    fn banded(dense: &DMatrix<f64>, bandwidth: usize) -> BandedCholesky {
        let mut banded = BandedCholesky::zeros(dense.nrows(), bandwidth);
        for row in 0..dense.nrows() {
            for column in row.saturating_sub(bandwidth)..=row {
                banded.add(row, column, dense[(row, column)]);
            }
        }
        banded
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn solves_like_a_dense_cholesky(
            dimension in 1..60_usize,
            bandwidth in 0..30_usize,
            columns in 1..4_usize,
            seed in any::<u64>(),
        ) {
            let dense = random(dimension, bandwidth, seed);
            let mut matrix = banded(&dense, bandwidth);
            prop_assert_eq!(matrix.factor(), Ok(()));
            let right = DMatrix::from_fn(dimension, columns, |row, column| ((3 * row + 7 * column) as f64).sin());
            let mut solution = right.clone();
            matrix.solve_in_place(solution.as_mut_slice());
            let expected = dense.cholesky().unwrap().solve(&right);
            prop_assert!((&solution - &expected).norm() <= 1e-10 * expected.norm());
        }

        #[test]
        fn panels_are_solved_like_single_vectors(
            dimension in 1..60_usize,
            bandwidth in 0..30_usize,
            seed in any::<u64>(),
        ) {
            let dense = random(dimension, bandwidth, seed);
            let mut matrix = banded(&dense, bandwidth);
            prop_assert_eq!(matrix.factor(), Ok(()));
            let right = DMatrix::from_fn(dimension, PANEL, |row, column| ((3 * row + 7 * column) as f64).sin());
            let mut panel: Panel =
                (0..dimension).map(|row| std::array::from_fn(|column| right[(row, column)])).collect();
            matrix.forward(&mut panel);
            let half_way = panel.clone();
            matrix.backward(&mut panel);
            let expected = dense.cholesky().unwrap().solve(&right);
            let solution = DMatrix::from_fn(dimension, PANEL, |row, column| panel[row][column]);
            prop_assert!((&solution - &expected).norm() <= 1e-10 * expected.norm());
            // bᵀA⁻¹b = (L⁻¹b)ᵀ(L⁻¹b)
            let product = panel_product(&half_way, &half_way);
            let product = DMatrix::from_fn(PANEL, PANEL, |row, column| product[row][column]);
            let expected = right.transpose() * expected;
            prop_assert!((product - &expected).norm() <= 1e-10 * expected.norm());
        }

        #[test]
        fn the_inverse_near_the_diagonal_equals_that_of_a_dense_matrix(
            dimension in 1..40_usize,
            bandwidth in 0..12_usize,
            seed in any::<u64>(),
        ) {
            let dense = random(dimension, bandwidth, seed);
            let mut matrix = banded(&dense, bandwidth);
            prop_assert_eq!(matrix.factor(), Ok(()));
            let (band, inverse) = (matrix.inverse_band(), dense.try_inverse().unwrap());
            for row in 0..dimension {
                for column in row.saturating_sub(bandwidth)..=row {
                    prop_assert!((band.at(column, row) - inverse[(row, column)]).abs() <= 1e-9 * inverse.norm());
                }
            }
        }

        #[test]
        fn rows_and_entries_fill_the_same_matrix(dimension in 1..20_usize, bandwidth in 0..8_usize) {
            let dense = random(dimension, bandwidth, 1);
            let mut by_row = BandedCholesky::zeros(dimension, bandwidth);
            for row in 0..dimension {
                let first = row.saturating_sub(bandwidth);
                let entries = by_row.row_mut(row);
                prop_assert_eq!(entries.len(), row - first + 1);
                for (column, entry) in entries.iter_mut().enumerate() {
                    *entry = dense[(row, first + column)];
                }
            }
            prop_assert_eq!(by_row, banded(&dense, bandwidth));
        }
    }

    #[test]
    fn a_long_system_is_solved_to_its_residual() {
        let (dimension, bandwidth) = (3000, 23);
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut matrix = BandedCholesky::zeros(dimension, bandwidth);
        for row in 0..dimension {
            matrix.row_mut(row).fill_with(|| random.random_range(-1.0..1.0));
            // Dominant diagonal.
            matrix.add(row, row, 50.0);
        }
        let entry = matrix.clone();
        let expected = DVector::from_fn(dimension, |row, _| (row as f64).cos());
        let at = |row: usize, column: usize| {
            let (row, column) = (row.max(column), row.min(column));
            if row - column > bandwidth { 0.0 } else { entry.rows[row * (bandwidth + 1) + bandwidth + column - row] }
        };
        let mut solution: Vec<f64> = (0..dimension)
            .map(|row| {
                let range = row.saturating_sub(bandwidth)..(row + bandwidth + 1).min(dimension);
                range.map(|column| at(row, column) * expected[column]).sum()
            })
            .collect();
        assert_eq!(matrix.factor(), Ok(()));
        matrix.solve_in_place(&mut solution);
        assert!(solution.iter().zip(&expected).all(|(value, expected)| (value - expected).abs() < 1e-12));
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_names_its_pivot() {
        let mut indefinite = BandedCholesky::zeros(3, 1);
        for (row, column, value) in [(0, 0, 4.0), (1, 0, 2.0), (1, 1, 5.0), (2, 1, 6.0), (2, 2, 9.0)] {
            indefinite.add(row, column, value);
        }
        // Schur complements: 4, 5 - 2²/4 = 4, 9 - 6²/4 = 0.
        assert_eq!(indefinite.clone().factor(), Err(2));
        indefinite.add(1, 1, f64::NAN);
        assert_eq!(indefinite.factor(), Err(1));
        assert_eq!(BandedCholesky::zeros(2, 1).factor(), Err(0));
        assert_eq!(BandedCholesky::zeros(0, 3).factor(), Ok(()));
    }

    #[test]
    #[should_panic(expected = "outside the lower band")]
    fn the_upper_triangle_is_rejected() {
        BandedCholesky::zeros(3, 2).add(0, 1, 1.0);
    }
}

//! The symmetric matrix of the control points of a segment. Only the 6×6 blocks near the diagonal are not zero: for each control
//! point its block with itself (lower triangle) and with the `order − 1` control points before it.

use nalgebra::{DMatrix, SMatrix};

use crate::solve::SolveError;
use evcal_geometry::numerics::banded::BandedCholesky;

/// Number of parameters of a control point.
const POINT: usize = 6;

/// 6×6 block of two control points: rotation first, then translation.
pub type Block = SMatrix<f64, POINT, POINT>;

/// Smallest damping of a control point, relative to the mean diagonal entry of its segment. It keeps control points without
/// observations where they are.
const FLOOR: f64 = 1e-9;

/// Returns the mean diagonal entry of the matrix of control points that has the `blocks` of a banded lower triangle, `order` per
/// control point.
pub fn mean_diagonal(blocks: &[Block], order: usize) -> f64 {
    let diagonal = blocks.iter().step_by(order.max(1));
    let entries = POINT * diagonal.len();
    diagonal.map(|block| block.trace()).sum::<f64>() / entries.max(1) as f64
}

/// Multiplies the symmetric matrix of control points by `columns`, which have six rows per control point. The matrix is given by
/// the `blocks` of its banded lower triangle, `order` per control point from the diagonal backwards.
pub fn banded_times(blocks: &[Block], order: usize, columns: &DMatrix<f64>) -> DMatrix<f64> {
    let mut product = DMatrix::zeros(columns.nrows(), columns.ncols());
    for (index, lines) in blocks.chunks(order.max(1)).enumerate() {
        for (back, block) in lines.iter().take(index + 1).enumerate() {
            let mut block = *block;
            if back == 0 {
                block.fill_upper_triangle_with_lower_triangle();
            }
            let (row, column) = (POINT * index, POINT * (index - back));
            let mut target = product.rows_mut(row, POINT);
            target.gemm(1.0, &block, &columns.rows(column, POINT), 1.0);
            if back > 0 {
                let mut target = product.rows_mut(column, POINT);
                target.gemm_tr(1.0, &block, &columns.rows(row, POINT), 1.0);
            }
        }
    }
    product
}

/// Factors the matrix of control points that is given by `blocks` as in [`banded_times`]. Its diagonal is enlarged by
/// the share `damping` and by a floor in proportion to `scale`, the mean diagonal entry from the observations.
///
/// # Errors
/// [`SolveError::Singular`] if the matrix is not positive definite.
pub fn factored(blocks: &[Block], order: usize, damping: f64, scale: f64) -> Result<BandedCholesky, SolveError> {
    let order = order.max(1);
    let dimension = POINT * (blocks.len() / order);
    let mut band = BandedCholesky::zeros(dimension, (POINT * order - 1).min(dimension.saturating_sub(1)));
    let floor = FLOOR * scale.max(f64::MIN_POSITIVE);
    for (index, lines) in blocks.chunks(order).enumerate() {
        for (back, block) in lines.iter().take(index + 1).enumerate() {
            for row in 0..POINT {
                let last = if back == 0 { row } else { POINT - 1 };
                for column in 0..=last {
                    let mut value = block[(row, column)];
                    if back == 0 && row == column {
                        value += damping * value + floor;
                    }
                    band.add(POINT * index + row, POINT * (index - back) + column, value);
                }
            }
        }
    }
    band.factor().map_err(|_| SolveError::Singular)?;
    Ok(band)
}

//! Sums of outer products of rows.
//!
//! The products with the pose are summed for each time bin, all others for a whole interval; the products with the biases of a
//! class are summed over its events alone. The numbers of rows are rounded to single precision, but the sums are not: the
//! differences between coefficients of a lens with almost the same effect would be lost in rounding.

use multiversion::multiversion;
use multiversion::target::target_cfg_f;

use super::event_row::{ROW, ROW_BIASES};
use crate::solve::rows::event_bias::CLASS_COUNT;
use crate::solve::rows::event_bias::bias::Bias;

/// Number of columns of the pose, at the beginning of a row.
const POSE_COLUMNS: usize = 6;
/// Number of lines that are summed for all classes alike: pose, residual, intrinsics and board.
const COMMON: usize = ROW_BIASES;
/// Number of lines and columns whose sums stay in registers while rows are added.
const TILE_LINES: usize = 4;
const TILE_COLUMNS: usize = 8;
const _: () = assert!(COMMON.is_multiple_of(TILE_LINES) && COMMON.is_multiple_of(TILE_COLUMNS));
const _: () = assert!(ROW.is_multiple_of(TILE_COLUMNS));

/// A row of an event or a circle centre. All its numbers are exact in single precision ([`single`]).
pub type Row = [f64; ROW];

/// Returns the nearest number of single precision.
#[inline(always)]
pub fn single(value: f64) -> f64 {
    f64::from(value as f32)
}

/// Sums of outer products. Only the lower triangle with the diagonal is valid.
pub struct RowProducts {
    /// Lines of pose, residual, intrinsics and board.
    pub common: [[f64; COMMON]; COMMON],
    /// Lines of the biases of each class.
    pub classes: [[[f64; ROW]; Bias::COUNT]; CLASS_COUNT],
    /// `true` for classes that had events since the pose's part was cleared.
    pub touched: [bool; CLASS_COUNT],
    /// `true` if there were rows since then.
    pub is_touched: bool,
}

impl Default for RowProducts {
    fn default() -> Self {
        Self {
            common: [[0.0; COMMON]; COMMON],
            classes: [[[0.0; ROW]; Bias::COUNT]; CLASS_COUNT],
            touched: [false; CLASS_COUNT],
            is_touched: false,
        }
    }
}

impl RowProducts {
    /// Adds rows without biases.
    pub fn add_without_biases(&mut self, rows: &[Row]) {
        self.is_touched |= !rows.is_empty();
        add_common(&mut self.common, rows);
    }

    /// Adds the rows of events, whose `classes` are in the same order.
    pub fn add(&mut self, rows: &[Row], classes: &[u8]) {
        self.add_without_biases(rows);
        let mut rest = rows;
        for run in classes.chunk_by(|a, b| a == b) {
            let (rows, later) = rest.split_at(run.len().min(rest.len()));
            rest = later;
            let class = run.first().map_or(0, |&class| usize::from(class));
            if let (Some(sums), Some(touched)) = (self.classes.get_mut(class), self.touched.get_mut(class)) {
                *touched = true;
                add_biases(sums, rows);
            }
        }
    }

    /// Clears the products with the pose.
    pub fn clear_pose(&mut self) {
        for line in &mut self.common {
            line[..POSE_COLUMNS].fill(0.0);
        }
        for (class, touched) in self.classes.iter_mut().zip(&mut self.touched) {
            if std::mem::take(touched) {
                class.iter_mut().for_each(|line| line[..POSE_COLUMNS].fill(0.0));
            }
        }
        self.is_touched = false;
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma", "x86_64+avx"))]
fn add_common(sums: &mut [[f64; COMMON]; COMMON], rows: &[Row]) {
    const FUSED: bool = target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64"));
    for first in (0..COMMON).step_by(TILE_LINES) {
        // The part right of the diagonal is not needed.
        for column in (0..first + TILE_LINES).step_by(TILE_COLUMNS) {
            add_tile::<FUSED, TILE_LINES, COMMON>(&mut sums[first..first + TILE_LINES], first, column, rows);
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+fma", "x86_64+avx2+fma", "x86_64+avx"))]
fn add_biases(sums: &mut [[f64; ROW]; Bias::COUNT], rows: &[Row]) {
    const FUSED: bool = target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64"));
    for column in (0..ROW).step_by(TILE_COLUMNS) {
        add_tile::<FUSED, { Bias::COUNT }, ROW>(sums, ROW_BIASES, column, rows);
    }
}

/// Adds the products of `LINES` lines from `line` on of `rows` with the columns from `column` to `sums`.
///
/// Each element is a sum in the order of the rows, whatever the vector width. The product of two numbers of single precision is
/// exact in double precision, so a fused multiplication and addition (`FUSED`) rounds like two separate operations: all machines
/// compute the same bits.
#[inline(always)]
fn add_tile<const FUSED: bool, const LINES: usize, const WIDTH: usize>(
    sums: &mut [[f64; WIDTH]],
    line: usize,
    column: usize,
    rows: &[Row],
) {
    let mut tile = [[0.0; TILE_COLUMNS]; LINES];
    for (tile, sums) in tile.iter_mut().zip(sums.iter()) {
        tile.copy_from_slice(&sums[column..column + TILE_COLUMNS]);
    }
    for row in rows {
        for (factor, tile) in row[line..line + LINES].iter().zip(&mut tile) {
            for (value, sum) in row[column..column + TILE_COLUMNS].iter().zip(tile) {
                *sum = if FUSED { factor.mul_add(*value, *sum) } else { *sum + factor * value };
            }
        }
    }
    for (tile, sums) in tile.iter().zip(sums) {
        sums[column..column + TILE_COLUMNS].copy_from_slice(tile);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_cover_all_rows_and_each_class() {
        let count = 271;
        // Inexact sums and long numbers: the order of the sums and their rounding matter.
        let entry = |row: usize, place: usize| single(((row * 31 + place * 17) % 23) as f64 / 7.0 - 1.5);
        let rows: Vec<Row> = (0..count).map(|row| std::array::from_fn(|place| entry(row, place))).collect();
        let class = |row: usize| if row < 153 { 2 } else { 5 };
        let classes: Vec<u8> = (0..count).map(class).collect();
        let mut products = RowProducts::default();
        products.add(&rows, &classes);
        let sum = |line: usize, column: usize, of: Option<u8>| {
            let wanted = (0..count).filter(|&row| of.is_none_or(|of| class(row) == of));
            wanted.fold(0.0, |sum, row| sum + entry(row, line) * entry(row, column))
        };
        for line in 0..COMMON {
            for column in 0..=line {
                assert_eq!(products.common[line][column], sum(line, column, None), "{line} {column}");
            }
        }
        for of in [2, 5] {
            for bias in 0..Bias::COUNT {
                for column in 0..=ROW_BIASES + bias {
                    let found = products.classes[usize::from(of)][bias][column];
                    assert_eq!(found, sum(ROW_BIASES + bias, column, Some(of)));
                }
            }
        }
        assert_eq!(products.classes[3], [[0.0; ROW]; Bias::COUNT]);
        products.clear_pose();
        assert_eq!((products.common[8][5], products.classes[2][0][5]), (0.0, 0.0));
        // The products of the residual with the global parameters are kept.
        assert_eq!(products.common[8][6], sum(8, 6, None));
        assert_eq!(products.classes[2][0][6], sum(ROW_BIASES, 6, Some(2)));
    }
}

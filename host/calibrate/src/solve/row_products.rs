//! Sums of outer products of rows.
//!
//! What concerns the pose is summed for each time bin, all else for a whole stretch; what concerns the biases of a class,
//! for its events alone. Rows are in single precision, but not the sums: coefficients of a lens that hardly differ in what they do
//! would be lost in their rounding.

use multiversion::multiversion;

use super::event_row::{ROW, ROW_BIASES};
use crate::solve::event_bias::CLASS_COUNT;
use crate::solve::event_bias::bias::Bias;

/// Columns that concern the pose: at the beginning of a row.
const POSE_COLUMNS: usize = 6;
/// Lines that are summed for all classes alike: pose, residual, intrinsics.
const COMMON: usize = ROW_BIASES;
/// Rows that are added in one step: those of a class begin at a multiple of it, and empty rows fill the gaps.
pub const STEP: usize = 4;

/// A row of an event or a circle centre.
pub type Row = [f32; ROW];

/// Sums of outer products. Only what is at and left of the diagonal counts.
pub struct RowProducts {
    /// Lines of pose, residual and intrinsics.
    pub common: [[f64; COMMON]; COMMON],
    /// Lines of the biases of each class.
    pub classes: [[[f64; ROW]; Bias::COUNT]; CLASS_COUNT],
    /// Which classes had events since the pose's part was taken.
    pub touched: [bool; CLASS_COUNT],
    /// Whether there were rows since then.
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
    pub fn add_without_biases(&mut self, rows: &[Row; STEP]) {
        self.is_touched = true;
        add_common(&mut self.common, std::array::from_ref(rows));
    }

    /// Adds the rows of events; all rows of a step are of the class that stands in the same place in `classes`.
    pub fn add(&mut self, steps: &[[Row; STEP]], classes: &[u8]) {
        self.is_touched |= !steps.is_empty();
        add_common(&mut self.common, steps);
        let mut rest = steps;
        for run in classes.chunk_by(|a, b| a == b) {
            let (steps, later) = rest.split_at(run.len().min(rest.len()));
            rest = later;
            let class = run.first().map_or(0, |&class| usize::from(class));
            if let (Some(sums), Some(touched)) = (self.classes.get_mut(class), self.touched.get_mut(class)) {
                *touched = true;
                add_biases(sums, steps);
            }
        }
    }

    /// Clears what concerns the pose.
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

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn add_common(sums: &mut [[f64; COMMON]; COMMON], steps: &[[Row; STEP]]) {
    for rows in steps {
        // The part right of the diagonal is not needed, but shorter lines are not made vectors of.
        add_lines::<0, COMMON, COMMON, COMMON>(sums, rows);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn add_biases(sums: &mut [[f64; ROW]; Bias::COUNT], steps: &[[Row; STEP]]) {
    for rows in steps {
        add_lines::<ROW_BIASES, { ROW_BIASES + Bias::COUNT }, ROW, ROW>(sums, rows);
    }
}

/// Adds the products of the lines from `FIRST` to `END` of `rows` with their first columns to `sums`.
///
/// Each element is a sum in the order of the rows, whatever the vector width, so that all machines get the same bits.
#[inline(always)]
fn add_lines<const FIRST: usize, const END: usize, const COLUMNS: usize, const WIDTH: usize>(
    sums: &mut [[f64; WIDTH]],
    rows: &[Row; STEP],
) {
    let mut wide = [[0.0; ROW]; STEP];
    for (wide, row) in wide.iter_mut().zip(rows) {
        wide.iter_mut().zip(row).for_each(|(wide, value)| *wide = f64::from(*value));
    }
    for (line, target) in (FIRST..END).zip(sums) {
        for column in 0..COLUMNS {
            let mut sum = target[column];
            for row in &wide {
                sum += row[line] * row[column];
            }
            target[column] = sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_all_rows_and_of_each_class() {
        let count = 70;
        let entry = |row: usize, place: usize| ((row * 31 + place * 17) % 23) as f32 - 11.0;
        let steps: Vec<[Row; STEP]> = (0..count)
            .map(|step| std::array::from_fn(|row| std::array::from_fn(|place| entry(STEP * step + row, place))))
            .collect();
        let class = |step: usize| if step < 40 { 2 } else { 5 };
        let classes: Vec<u8> = (0..count).map(class).collect();
        let mut products = RowProducts::default();
        products.add(&steps, &classes);
        let sum = |line: usize, column: usize, of: Option<u8>| {
            let wanted = (0..STEP * count).filter(|&row| of.is_none_or(|of| class(row / STEP) == of));
            wanted.map(|row| f64::from(entry(row, line) * entry(row, column))).sum::<f64>()
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
        // What the residual says of the global parameters stays.
        assert_eq!(products.common[8][6], sum(8, 6, None));
        assert_eq!(products.classes[2][0][6], sum(ROW_BIASES, 6, Some(2)));
    }
}

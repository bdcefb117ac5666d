//! The border of the normal equations: products of the control points with the global parameters, one column for each estimated
//! one. The columns are stored in panels of [`PANEL`], so that their number is known only at run time but the inner loops are
//! over a constant number.

use std::ops::Range;

use evcal_geometry::numerics::panel::{PANEL, Panel};
use multiversion::multiversion;
use nalgebra::{DMatrix, DVector, Matrix3};

use crate::solve::GLOBAL_COUNT;
use crate::solve::places;

/// Number of parameters of a control point.
pub const POINT: usize = 6;

/// Where the estimated global parameters of one camera stand in a border. Fixed parameters have no column.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Columns {
    /// First column, in the border of the whole system, of equations with these columns.
    at: usize,
    /// Number of columns of these equations before those of the camera.
    before: usize,
    /// The estimated global parameters, in order.
    globals: Vec<usize>,
    /// For each global parameter its column in these equations.
    places: [Option<u16>; GLOBAL_COUNT],
}

impl Columns {
    /// Returns the columns of the parameters that are `free`, after `before` columns of other parameters.
    pub fn after(before: usize, free: &[bool; GLOBAL_COUNT]) -> Self {
        let globals = places(free);
        let mut places = [None; GLOBAL_COUNT];
        for (column, &global) in (before..).zip(&globals) {
            places[global] = u16::try_from(column).ok();
        }
        Self { at: 0, before, globals, places }
    }

    /// Returns the columns of the parameters that are `free`.
    pub fn new(free: &[bool; GLOBAL_COUNT]) -> Self {
        Self::after(0, free)
    }

    /// Returns no columns: the equations of the control points alone.
    pub fn none() -> Self {
        Self::new(&[false; GLOBAL_COUNT])
    }

    /// Returns the same columns for equations that begin at column `at` of a system.
    pub fn at(self, at: usize) -> Self {
        Self { at, ..self }
    }

    /// Returns the columns of the system that equations with these columns have.
    pub fn range(&self) -> Range<usize> {
        self.at..self.at + self.width()
    }

    /// Returns the number of columns of equations with these columns.
    pub fn width(&self) -> usize {
        self.before + self.globals.len()
    }

    /// Returns the column of a global parameter in these equations; `None` if it is fixed.
    #[inline(always)]
    pub fn place(&self, global: usize) -> Option<usize> {
        self.places[global].map(usize::from)
    }

    /// Returns the columns, in these equations, of those estimated parameters that are also `free`.
    pub fn among(&self, free: &[bool; GLOBAL_COUNT]) -> Vec<usize> {
        (self.before..).zip(&self.globals).filter(|(_, global)| free[**global]).map(|(column, _)| column).collect()
    }

    /// Returns the global parameters of the camera whose columns have the `values` in the whole system; 0 for fixed ones.
    pub fn globals(&self, values: &[f64]) -> [f64; GLOBAL_COUNT] {
        let mut globals = [0.0; GLOBAL_COUNT];
        for (&global, value) in self.globals.iter().zip(values.iter().skip(self.at + self.before)) {
            globals[global] = *value;
        }
        globals
    }
}

/// A border: six rows for each control point. Unused columns of the last panel are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Border {
    panels: Vec<Panel>,
    width: usize,
}

impl Border {
    /// Creates the border of `points` control points with `width` columns.
    pub fn zeros(points: usize, width: usize) -> Self {
        Self { panels: vec![vec![[0.0; PANEL]; POINT * points]; width.div_ceil(PANEL)], width }
    }

    /// Creates a border of `points` control points with these entries.
    pub fn from_fn(points: usize, width: usize, entry: impl Fn(usize, usize) -> f64) -> Self {
        let mut border = Self::zeros(points, width);
        for (number, panel) in border.panels.iter_mut().enumerate() {
            for (row, line) in panel.iter_mut().enumerate() {
                let columns = number * PANEL..width;
                line.iter_mut().zip(columns).for_each(|(place, column)| *place = entry(row, column));
            }
        }
        border
    }

    /// Returns the number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns one entry; 0 outside.
    pub fn at(&self, row: usize, column: usize) -> f64 {
        entry(&self.panels, row, column)
    }

    /// Adds the part of control point number `point` in the products `lines` of a pose. `jacobian` is the derivative of the rotation
    /// by the control point, `weight` the derivative of the translation.
    #[inline]
    pub fn add(&mut self, point: usize, lines: &[[[f64; PANEL]; POINT]], jacobian: &Matrix3<f64>, weight: f64) {
        add_lines(&mut self.panels, POINT * point, lines, jacobian, weight);
    }

    /// Adds another border, whose first control point has the number `point` here and whose first column is column `at` here.
    pub fn merge(&mut self, point: usize, at: usize, part: &Self) {
        let (first, shift) = (at / PANEL, at % PANEL);
        for (number, panel) in (first..).zip(&part.panels) {
            // The columns of a panel fall into one or two panels here.
            let pieces = [(number, 0..PANEL - shift, shift), (number + 1, PANEL - shift..PANEL, 0)];
            for (number, from, to) in pieces {
                let Some(sums) = self.panels.get_mut(number).and_then(|panel| panel.get_mut(POINT * point..)) else {
                    continue;
                };
                for (sums, line) in sums.iter_mut().zip(panel) {
                    sums[to..].iter_mut().zip(&line[from.clone()]).for_each(|(sum, value)| *sum += value);
                }
            }
        }
    }

    /// Multiplies all entries by `weight`.
    pub fn scale(&mut self, weight: f64) {
        self.panels.iter_mut().flatten().flatten().for_each(|entry| *entry *= weight);
    }

    /// Returns the border of these `columns` alone.
    pub fn selected(&self, columns: &[usize]) -> Self {
        let rows = self.panels.first().map_or(0, Vec::len);
        let panel = |columns: &[usize]| -> Panel {
            let line = |row| std::array::from_fn(|lane| columns.get(lane).map_or(0.0, |&column| self.at(row, column)));
            (0..rows).map(line).collect()
        };
        Self { panels: columns.chunks(PANEL).map(panel).collect(), width: columns.len() }
    }

    /// Returns its panels with the `gradient` as one more column.
    pub fn with_gradient(mut self, gradient: &[[f64; POINT]]) -> Vec<Panel> {
        if self.width.is_multiple_of(PANEL) {
            self.panels.push(vec![[0.0; PANEL]; POINT * gradient.len()]);
        }
        let lane = self.width % PANEL;
        if let Some(panel) = self.panels.last_mut() {
            panel.iter_mut().zip(gradient.iter().flatten()).for_each(|(line, value)| line[lane] = *value);
        }
        self.panels
    }

    /// Returns it as a matrix.
    pub fn to_matrix(&self, points: usize) -> DMatrix<f64> {
        DMatrix::from_fn(POINT * points, self.width, |row, column| self.at(row, column))
    }
}

/// Equations of the columns of a border among themselves.
#[derive(Clone, Debug)]
pub struct Corner {
    /// Their matrix C, lower triangle.
    pub matrix: DMatrix<f64>,
    /// Their gradient.
    pub gradient: DVector<f64>,
}

impl Corner {
    /// Creates the empty equations of `width` columns.
    pub fn zeros(width: usize) -> Self {
        Self { matrix: DMatrix::zeros(width, width), gradient: DVector::zeros(width) }
    }

    /// Returns the whole matrix.
    pub fn whole(&self) -> DMatrix<f64> {
        let mut whole = self.matrix.clone();
        whole.fill_upper_triangle_with_lower_triangle();
        whole
    }

    /// Adds equations of columns from column `at` on.
    pub fn add(&mut self, part: &Self, at: usize) {
        for column in 0..part.gradient.len() {
            for row in column..part.gradient.len() {
                self.matrix[(at + row, at + column)] += part.matrix[(row, column)];
            }
            self.gradient[at + column] += part.gradient[column];
        }
    }
}

/// Returns the entry of a row and a column in panels; 0 outside.
pub fn entry(panels: &[Panel], row: usize, column: usize) -> f64 {
    let line = panels.get(column / PANEL).and_then(|panel| panel.get(row));
    line.map_or(0.0, |line| line[column % PANEL])
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn add_lines(panels: &mut [Panel], row: usize, lines: &[[[f64; PANEL]; POINT]], jacobian: &Matrix3<f64>, weight: f64) {
    for (panel, lines) in panels.iter_mut().zip(lines) {
        let Some(sum) = panel.get_mut(row..row + POINT) else { return };
        let [x, y, z, moving @ ..] = lines;
        let (turning, moved) = sum.split_at_mut(3);
        for (axis, line) in turning.iter_mut().enumerate() {
            let [by_x, by_y, by_z] = [jacobian[(0, axis)], jacobian[(1, axis)], jacobian[(2, axis)]];
            for lane in 0..PANEL {
                line[lane] += by_x * x[lane] + by_y * y[lane] + by_z * z[lane];
            }
        }
        for (line, moving) in moved.iter_mut().zip(moving) {
            for lane in 0..PANEL {
                line[lane] += weight * moving[lane];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbered(points: usize, width: usize) -> Border {
        Border::from_fn(points, width, |row, column| (1000 * row + column) as f64 + 0.5)
    }

    /// Columns may begin anywhere in a system, not only with a panel.
    #[test]
    fn a_merged_border_stands_at_its_columns_and_control_points() {
        for (at, width) in [(0, 5), (3, 16), (16, 20), (9, 39)] {
            let part = numbered(2, width);
            let mut whole = Border::zeros(5, at + width + 2);
            whole.merge(1, at, &part);
            whole.merge(1, at, &part);
            for row in 0..5 * POINT {
                for column in 0..at + width + 2 {
                    let inside = (POINT..3 * POINT).contains(&row) && (at..at + width).contains(&column);
                    let wanted = if inside { 2.0 * part.at(row - POINT, column - at) } else { 0.0 };
                    assert_eq!(whole.at(row, column), wanted, "{at} {width}: {row} {column}");
                }
            }
        }
    }

    #[test]
    fn the_gradient_is_the_column_after_the_selected_ones() {
        let border = numbered(2, 20);
        for columns in [vec![1, 3, 19], (0..16).collect::<Vec<_>>()] {
            let panels = border.selected(&columns).with_gradient(&[[7.0; POINT], [8.0; POINT]]);
            assert_eq!(panels.len(), (columns.len() + 1).div_ceil(PANEL));
            for (place, &column) in columns.iter().enumerate() {
                assert_eq!(entry(&panels, 7, place), border.at(7, column));
            }
            assert_eq!((entry(&panels, 5, columns.len()), entry(&panels, 6, columns.len())), (7.0, 8.0));
        }
    }

    #[test]
    fn values_of_a_system_go_to_the_estimated_parameters() {
        let mut free = [false; GLOBAL_COUNT];
        (free[2], free[7], free[100]) = (true, true, true);
        let columns = Columns::after(2, &free).at(5);
        assert_eq!((columns.range(), columns.place(7), columns.place(3)), (5..10, Some(3), None));
        let values: Vec<f64> = (0..12).map(f64::from).collect();
        let globals = columns.globals(&values);
        assert_eq!((globals[2], globals[7], globals[100], globals[3]), (7.0, 8.0, 9.0, 0.0));
        free[7] = false;
        assert_eq!(columns.among(&free), [2, 4]);
    }
}

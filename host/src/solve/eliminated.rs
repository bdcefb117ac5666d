//! A segment whose control points are eliminated from the normal equations.
//!
//! With the matrix A = LLᵀ of the control points, the border B and the gradient g, all that is asked of them follows from
//! F = L⁻¹B and f = L⁻¹g: BᵀA⁻¹B = FᵀF, BᵀA⁻¹g = Fᵀf, and the step of the control points is −L⁻ᵀ(f + Fδ) for a step δ of the
//! global parameters. The vectors of F and f stand side by side in panels.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::normal::{Block, BorderBlock};
use crate::numerics::banded::BandedCholesky;
use crate::numerics::panel::{PANEL, Panel, panel_product};

/// Parameters of a control point.
const POINT: usize = 6;

/// See the [module](self).
pub struct Eliminated {
    factor: BandedCholesky,
    /// F, then f, then zeros.
    panels: Vec<Panel>,
    /// Vectors of F.
    free: usize,
}

impl Eliminated {
    /// Of control points with this `factor` of their matrix, this `border` and `gradient`; the parameters that are `free` of the
    /// global ones.
    pub fn new(factor: BandedCholesky, border: &[BorderBlock], gradient: &[[f64; POINT]], free: &[usize]) -> Self {
        let entry = |point: usize, axis: usize, vector: usize| match free.get(vector) {
            Some(&global) => border[point][axis][global],
            None if vector == free.len() => gradient[point][axis],
            None => 0.0,
        };
        let panels = (0..(free.len() + 1).div_ceil(PANEL)).into_par_iter().map(|number| {
            let row = |row: usize| std::array::from_fn(|lane| entry(row / POINT, row % POINT, number * PANEL + lane));
            let mut panel: Panel = (0..POINT * border.len()).map(row).collect();
            factor.forward(&mut panel);
            panel
        });
        let panels = panels.collect();
        Self { factor, panels, free: free.len() }
    }

    /// BᵀA⁻¹B and −BᵀA⁻¹g.
    pub fn schur(&self) -> (DMatrix<f64>, DVector<f64>) {
        let pairs: Vec<(usize, usize)> =
            (0..self.panels.len()).flat_map(|row| (0..=row).map(move |column| (row, column))).collect();
        let products: Vec<_> =
            pairs.par_iter().map(|&(row, column)| panel_product(&self.panels[row], &self.panels[column])).collect();
        let mut schur = DMatrix::zeros(self.free, self.free);
        let mut right = DVector::zeros(self.free);
        for ((row_panel, column_panel), product) in pairs.into_iter().zip(products) {
            for (row, line) in (row_panel * PANEL..).zip(product) {
                for (column, value) in (column_panel * PANEL..).zip(line) {
                    if row < self.free && column <= row {
                        schur[(row, column)] = value;
                        schur[(column, row)] = value;
                    } else if row == self.free && column < self.free {
                        right[column] = -value;
                    }
                }
            }
        }
        (schur, right)
    }

    /// The step of the control points when the free global parameters move by `globals`.
    pub fn back_substitute(&self, globals: &DVector<f64>) -> Vec<f64> {
        let mut step = vec![0.0; self.factor.dimension()];
        let weights = globals.iter().copied().chain([1.0]).collect::<Vec<_>>();
        for (panel, weights) in self.panels.iter().zip(weights.chunks(PANEL)) {
            for (step, line) in step.iter_mut().zip(panel) {
                *step -= line.iter().zip(weights).map(|(value, weight)| value * weight).sum::<f64>();
            }
        }
        self.factor.solve_transposed_in_place(&mut step);
        step
    }

    /// A⁻¹B: how the control points follow the free global parameters.
    pub fn follows(&self) -> DMatrix<f64> {
        let mut follows = DMatrix::zeros(self.factor.dimension(), self.free);
        let solved: Vec<Panel> = self
            .panels
            .par_iter()
            .map(|panel| {
                let mut panel = panel.clone();
                self.factor.backward(&mut panel);
                panel
            })
            .collect();
        for (column, mut target) in follows.column_iter_mut().enumerate() {
            let from = solved[column / PANEL].iter().map(|line| line[column % PANEL]);
            target.iter_mut().zip(from).for_each(|(target, value)| *target = value);
        }
        follows
    }

    /// Covariance of each control point with itself and the `order − 1` before it, when the global parameters have the
    /// covariance `globals`: that near the diagonal of A⁻¹ + A⁻¹B · globals · (A⁻¹B)ᵀ. `columns` says which of the free global
    /// parameters these are.
    pub fn control_covariance(&self, order: usize, columns: &[usize], globals: &DMatrix<f64>) -> Option<Vec<Block>> {
        let own = self.factor.inverse_band();
        let root = globals.clone().cholesky()?.unpack();
        let moved = self.follows().select_columns(columns) * root;
        // One control point after the other, so that each reads near what the one before it read.
        let moved: Vec<f64> = moved.transpose().as_slice().to_vec();
        let line = |row: usize| &moved[row * columns.len()..(row + 1) * columns.len()];
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let block = |index: usize| {
            let (point, back) = (index / order, index % order);
            if back > point {
                return Block::zeros();
            }
            let (row, column) = (POINT * point, POINT * (point - back));
            Block::from_fn(|a, b| own.at(row + a, column + b) + product(line(row + a), line(column + b)))
        };
        let count = self.factor.dimension() / POINT;
        Some((0..count * order).into_par_iter().with_min_len(64).map(block).collect())
    }
}

//! A segment whose control points are eliminated from the normal equations.
//!
//! With the matrix A = LLᵀ of the control points, the border B and the gradient g, everything follows from F = L⁻¹B and f = L⁻¹g:
//! BᵀA⁻¹B = FᵀF, BᵀA⁻¹g = Fᵀf, and the step of the control points is −L⁻ᵀ(f + Fδ) for a step δ of the global parameters. The
//! vectors of F and f are stored side by side in panels.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::border::{Border, POINT, entry};
use super::control_band::Block;
use evcal_geometry::numerics::banded::BandedCholesky;
use evcal_geometry::numerics::panel::{PANEL, Panel, panel_product};

/// See the [module](self).
pub struct Eliminated {
    factor: BandedCholesky,
    /// F, then f, then zeros.
    panels: Vec<Panel>,
    /// Number of vectors of F.
    free: usize,
    order: usize,
}

impl Eliminated {
    /// Eliminates control points that act together in groups of `order`, given the `factor` of their matrix, their `border` and
    /// their `gradient`.
    pub fn new(factor: BandedCholesky, order: usize, border: Border, gradient: &[[f64; POINT]]) -> Self {
        let free = border.width();
        let mut panels = border.with_gradient(gradient);
        panels.par_iter_mut().for_each(|panel| factor.forward(panel));
        Self { factor, panels, free, order }
    }

    /// Returns BᵀA⁻¹B and −BᵀA⁻¹g.
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

    /// Returns the step of the control points for a step `globals` of the estimated global parameters.
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

    /// Returns the dependence of the control points on the estimated global parameters.
    pub fn into_following(mut self) -> Following {
        let factor = &self.factor;
        self.panels.par_iter_mut().for_each(|panel| factor.backward(panel));
        Following { factor: self.factor, panels: self.panels, free: self.free, order: self.order }
    }
}

/// Derivatives of the control points of a segment by the estimated global parameters, with a minus sign: A⁻¹B, in panels.
pub struct Following {
    factor: BandedCholesky,
    panels: Vec<Panel>,
    free: usize,
    order: usize,
}

impl Following {
    /// Returns the rows of `count` control points from `first` on, six each, with a column for each estimated global parameter.
    pub fn of_points(&self, first: usize, count: usize) -> DMatrix<f64> {
        DMatrix::from_fn(POINT * count, self.free, |row, column| entry(&self.panels, POINT * first + row, column))
    }

    /// Returns the covariance of the control points when the global parameters have the covariance `globals`: the part of A⁻¹ +
    /// A⁻¹B · globals · (A⁻¹B)ᵀ near the diagonal. `columns` are the indices of these parameters among the estimated ones.
    pub fn control_covariance(&self, columns: &[usize], globals: &DMatrix<f64>) -> Option<ControlCovariance> {
        let (own, order) = (self.factor.inverse_band(), self.order);
        let root = globals.clone().cholesky()?.unpack();
        let count = self.factor.dimension() / POINT;
        let moved = |point: usize| self.of_points(point, 1).select_columns(columns) * &root;
        let moved: Vec<DMatrix<f64>> = (0..count).into_par_iter().with_min_len(64).map(moved).collect();
        let block = |index: usize| {
            let (point, back) = (index / order, index % order);
            let Some(other) = point.checked_sub(back) else { return Block::zeros() };
            let from_globals = &moved[point] * moved[other].transpose();
            let (row, column) = (POINT * point, POINT * other);
            Block::from_fn(|a, b| own.at(row + a, column + b) + from_globals[(a, b)])
        };
        let blocks = (0..count * order).into_par_iter().with_min_len(64).map(block).collect();
        Some(ControlCovariance { order, blocks })
    }
}

/// Covariance of the control points of one segment, near its diagonal.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlCovariance {
    order: usize,
    blocks: Vec<Block>,
}

impl ControlCovariance {
    /// Returns the covariance of control point `point` with the one `back` before it; `None` for control points that do not act
    /// together.
    pub fn block(&self, point: usize, back: usize) -> Option<&Block> {
        (back < self.order).then_some(())?;
        self.blocks.get(point * self.order + back)
    }
}

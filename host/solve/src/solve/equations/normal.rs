//! Normal equations of pieces of work.
//!
//! Observations of one time share the pose and the basis weights. They therefore sum only the outer products of short rows
//! ([`row_products`](crate::solve::rows::row_products)), which are expanded to the control points once. Pieces are independent, so they run in
//! parallel and are merged in a fixed order: the result does not depend on the number of threads.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::band::Band;
use super::border::{Border, Columns, Corner, POINT};
use super::control_band::{Block, banded_times};
use super::pose_products::COMMON_PLACES;
use crate::solve::GLOBAL_COUNT;
use crate::solve::SolveError;
use crate::solve::bias_index;
use crate::solve::rows::event_bias::bias::Bias;
use crate::solve::rows::event_row::{ROW_RESIDUAL, row_bias};
use crate::solve::rows::loss::Loss;
use crate::solve::rows::row_products::RowProducts;

/// Normal equations of a piece of work: observations of one segment.
#[derive(Clone, Debug)]
pub struct Equations {
    /// Index of the segment.
    pub segment: usize,
    /// Time of the first observation (s).
    pub t: f64,
    /// Their columns of the border of the whole system.
    pub columns: Range<usize>,
    /// The control points.
    pub band: Band,
    /// The columns among themselves.
    pub corner: Corner,
    /// Information about each global parameter of events with everything else known, for fixed parameters too; empty for other
    /// observations.
    pub information: Vec<f64>,
    /// Loss of the observations.
    pub loss: Loss,
}

impl Equations {
    /// Creates empty equations for the control points of an empty `band`.
    pub fn new(segment: usize, t: f64, columns: Range<usize>, band: Band) -> Self {
        let width = columns.len();
        Self { segment, t, columns, band, corner: Corner::zeros(width), information: Vec::new(), loss: Loss::default() }
    }

    /// Adds the global part of `products`.
    pub fn add_globals(&mut self, products: &RowProducts, columns: &Columns) {
        self.information.resize(GLOBAL_COUNT, 0.0);
        let Corner { matrix, gradient } = &mut self.corner;
        let mut add = |parameter: usize, other: usize, value: f64| {
            if let (Some(row), Some(column)) = (columns.place(parameter), columns.place(other)) {
                matrix[(row, column)] += value;
            }
            if parameter == other {
                self.information[parameter] += value;
            }
        };
        let mut add_gradient = |parameter: usize, value: f64| {
            if let Some(row) = columns.place(parameter) {
                gradient[row] += value;
            }
        };
        for (parameter, place) in COMMON_PLACES.into_iter().enumerate() {
            let line = &products.common[place];
            for (other, place) in COMMON_PLACES.into_iter().enumerate().take(parameter + 1) {
                add(parameter, other, line[place]);
            }
            add_gradient(parameter, line[ROW_RESIDUAL]);
        }
        for (class, lines) in products.classes.iter().enumerate() {
            for (bias, line) in Bias::ALL.into_iter().zip(lines) {
                let global = bias_index(class, bias);
                for (parameter, place) in COMMON_PLACES.into_iter().enumerate() {
                    add(global, parameter, line[place]);
                }
                for other in Bias::ALL.into_iter().take_while(|other| other.index() <= bias.index()) {
                    let other_global = bias_index(class, other);
                    // Shared biases come before a class's own.
                    add(global.max(other_global), global.min(other_global), line[row_bias(other)]);
                }
                add_gradient(global, line[ROW_RESIDUAL]);
            }
        }
    }

    /// Builds equations from the Gram matrix `gram` of some rows. A row has six columns for each of `order` control points from `first`
    /// on, then those of the border, then the residual.
    pub fn of_gram(self, first: usize, order: usize, gram: &DMatrix<f64>) -> Self {
        let (points, width) = (POINT * order, self.columns.len());
        let residual = points + width;
        let mut blocks = vec![Block::zeros(); order * order];
        for row in 0..order {
            for back in 0..=row {
                let part = gram.view((POINT * row, POINT * (row - back)), (POINT, POINT));
                blocks[row * order + back].copy_from(&part);
            }
        }
        let band = Band {
            first,
            order,
            blocks,
            border: Border::from_fn(order, width, |row, column| gram[(row, points + column)]),
            gradient: (0..order)
                .map(|point| std::array::from_fn(|axis| gram[(POINT * point + axis, residual)]))
                .collect(),
        };
        Self {
            band,
            corner: Corner {
                matrix: gram.view((points, points), (width, width)).into_owned(),
                gradient: DVector::from_fn(width, |row, _| gram[(points + row, residual)]),
            },
            ..self
        }
    }

    /// Returns the equations with all observations weighted by `weight`.
    pub fn weighted(mut self, weight: f64) -> Self {
        self.band.blocks.iter_mut().for_each(|block| *block *= weight);
        self.band.border.scale(weight);
        self.band.gradient.iter_mut().flatten().for_each(|entry| *entry *= weight);
        self.corner.matrix *= weight;
        self.corner.gradient *= weight;
        self.loss = self.loss.weighted(weight);
        self
    }

    /// Returns the equations after a step of the control points of each segment and of the columns of the whole border, as if the cost
    /// were a quadratic function of them.
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if the step has other parameters.
    pub fn moved(&self, segments: &[Vec<f64>], globals: &[f64]) -> Result<Self, SolveError> {
        let mut moved = self.clone();
        let (band, count) = (&self.band, POINT * self.band.count());
        let points = segments.get(self.segment).and_then(|step| step.get(POINT * band.first..)?.get(..count));
        let (Some(points), Some(globals)) = (points, globals.get(self.columns.clone())) else {
            return Err(SolveError::OutOfBand);
        };
        let points = DMatrix::from_column_slice(count, 1, points);
        let globals = DVector::from_column_slice(globals);
        let border = band.border.to_matrix(band.count());
        let of_points = banded_times(&band.blocks, band.order, &points).column(0) + &border * &globals;
        let of_globals = border.tr_mul(&points).column(0) + self.corner.whole() * &globals;
        let points = points.column(0);
        let gradient = DVector::from_column_slice(band.gradient.as_flattened());
        moved.loss.cost += gradient.dot(&points) + self.corner.gradient.dot(&globals);
        moved.loss.cost += 0.5 * (points.dot(&of_points) + globals.dot(&of_globals));
        let changes = moved.band.gradient.iter_mut().flatten().zip(&of_points);
        changes.for_each(|(sum, change)| *sum += change);
        moved.corner.gradient += of_globals;
        Ok(moved)
    }

    /// Sums the control points of pieces of one segment, for a border of `width` columns; `None` without observations.
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if they do not fit together.
    pub fn sum_of_bands(pieces: &[&Self], width: usize) -> Result<Option<Band>, SolveError> {
        let concerned = || pieces.iter().filter(|piece| piece.band.count() > 0);
        let first = concerned().map(|piece| piece.band.first).min();
        let end = concerned().map(|piece| piece.band.first + piece.band.count()).max();
        let (Some(first), Some(end), Some(one)) = (first, end, concerned().next()) else { return Ok(None) };
        let mut sum = Band::new(first, end - first, one.band.order, width);
        for piece in concerned() {
            sum.merge(&piece.band, piece.columns.start)?;
        }
        Ok(Some(sum))
    }

    /// Sums pieces of one segment, for a border of `width` columns; `None` without observations.
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if they do not fit together.
    pub fn sum(pieces: &[&Self], width: usize) -> Result<Option<Self>, SolveError> {
        let (Some(band), Some(one)) = (Self::sum_of_bands(pieces, width)?, pieces.first()) else { return Ok(None) };
        let mut sum = Self::new(one.segment, one.t, 0..width, band);
        pieces.iter().for_each(|piece| sum.corner.add(&piece.corner, piece.columns.start));
        Ok(Some(sum))
    }
}

//! Products of the rows of observations that share a pose.

use evcal_core::camera::MAX_PARAMETERS;
use evcal_geometry::numerics::panel::PANEL;
use nalgebra::{Matrix6, SMatrix, Vector6};

use super::border::{Columns, Corner, POINT};
use crate::solve::BOARD_INDEX;
use crate::solve::BOARD_PARAMETERS;
use crate::solve::bias_index;
use crate::solve::rows::event_bias::CLASS_COUNT;
use crate::solve::rows::event_bias::bias::Bias;
use crate::solve::rows::event_row::{ROW_BOARD, ROW_INTRINSICS, ROW_RESIDUAL};
use crate::solve::rows::row_products::RowProducts;

/// Indices in a row of the intrinsics and the board's parameters, which are the first global parameters.
pub const COMMON_PLACES: [usize; BOARD_INDEX + BOARD_PARAMETERS] = {
    let mut places = [0; BOARD_INDEX + BOARD_PARAMETERS];
    let mut global = 0;
    while global < places.len() {
        places[global] =
            if global < MAX_PARAMETERS { ROW_INTRINSICS + global } else { ROW_BOARD + global - BOARD_INDEX };
        global += 1;
    }
    places
};

/// Products of all rows that share a pose.
pub struct PoseProducts {
    /// With the pose: rotation (camera frame), then translation (world).
    pub own: Matrix6<f64>,
    /// With the residual.
    pub gradient: Vector6<f64>,
    /// With the columns of a border, panel by panel.
    pub border: Vec<[[f64; PANEL]; POINT]>,
}

impl PoseProducts {
    /// Creates products with a border of `width` columns.
    pub fn new(width: usize) -> Self {
        let border = vec![[[0.0; PANEL]; POINT]; width.div_ceil(PANEL)];
        Self { own: Matrix6::zeros(), gradient: Vector6::zeros(), border }
    }

    /// Takes the pose's part of `products`, whose global parameters have these `columns`.
    pub fn take(&mut self, products: &RowProducts, columns: &Columns) {
        let common = &products.common;
        self.own = Matrix6::from_fn(|row, column| common[row.max(column)][row.min(column)]);
        self.gradient = Vector6::from_fn(|row, _| common[ROW_RESIDUAL][row]);
        self.border.fill([[0.0; PANEL]; POINT]);
        for (global, place) in COMMON_PLACES.into_iter().enumerate() {
            let Some(column) = columns.place(global) else { continue };
            let lines = &mut self.border[column / PANEL];
            for (line, value) in lines.iter_mut().zip(&common[place]) {
                line[column % PANEL] = *value;
            }
        }
        for class in (0..CLASS_COUNT).filter(|&class| products.touched[class]) {
            for (bias, from) in Bias::ALL.into_iter().zip(&products.classes[class]) {
                let Some(column) = columns.place(bias_index(class, bias)) else { continue };
                let lines = &mut self.border[column / PANEL];
                for (line, value) in lines.iter_mut().zip(from) {
                    line[column % PANEL] += *value;
                }
            }
        }
    }

    /// Returns the products with another pose, on which this one depends. `by` is the derivative of this pose by the other (the first
    /// six columns) and by `count` parameters. These have the first columns of the border, to whose `corner` their own products are
    /// added.
    pub fn carried<const CAUSES: usize>(
        &self,
        by: &SMatrix<f64, POINT, CAUSES>,
        count: usize,
        corner: &mut Corner,
    ) -> Self {
        let turned = |cause: usize, lines: &[[f64; PANEL]; POINT]| -> [f64; PANEL] {
            std::array::from_fn(|lane| (0..POINT).map(|axis| by[(axis, cause)] * lines[axis][lane]).sum())
        };
        let causes: SMatrix<f64, CAUSES, CAUSES> = by.tr_mul(&(self.own * by));
        let gradient = by.tr_mul(&self.gradient);
        let mut border: Vec<[[f64; PANEL]; POINT]> =
            self.border.iter().map(|lines| std::array::from_fn(|axis| turned(axis, lines))).collect();
        for parameter in 0..count {
            let cause = POINT + parameter;
            corner.gradient[parameter] += gradient[cause];
            let mut column = corner.matrix.column_mut(parameter);
            for other in parameter..count {
                column[other] += causes[(POINT + other, cause)];
            }
            for (number, lines) in self.border.iter().enumerate() {
                column.iter_mut().skip(number * PANEL).zip(turned(cause, lines)).for_each(|(sum, value)| *sum += value);
            }
            if let Some(lines) = border.get_mut(parameter / PANEL) {
                for (axis, line) in lines.iter_mut().enumerate() {
                    line[parameter % PANEL] += causes[(axis, cause)];
                }
            }
        }
        Self {
            own: causes.fixed_view::<POINT, POINT>(0, 0).into_owned(),
            gradient: gradient.fixed_rows::<POINT>(0).into_owned(),
            border,
        }
    }
}

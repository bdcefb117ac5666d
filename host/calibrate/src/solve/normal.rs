//! The normal equations of an interval of a trajectory, and their assembly.
//!
//! Events of one time bin share the pose and the basis weights. A bin therefore sums only the outer products of short rows
//! ([`row_products`](super::row_products)) and expands them to the control points once. Intervals are independent, so they run in
//! parallel and are merged in a fixed order: the result does not depend on the number of threads.

use evcal_core::camera::MAX_PARAMETERS;
use multiversion::multiversion;
use nalgebra::{DMatrix, Matrix3, Vector3};

use crate::solve::event_bias::CLASS_COUNT;
use crate::solve::event_bias::bias::Bias;

use super::control_band::Block;
use super::event_row::{ROW_BOARD, ROW_INTRINSICS, ROW_RESIDUAL, row_bias};
use super::loss::Loss;
use super::pose_bin::PoseBin;
use super::row_products::RowProducts;
use super::{BOARD_INDEX, BOARD_PARAMETERS, GLOBAL_COUNT, bias_index};

/// Indices in a row of the intrinsics and the board's parameters, which are the first global parameters.
const COMMON_PLACES: [usize; BOARD_INDEX + BOARD_PARAMETERS] = {
    let mut places = [0; BOARD_INDEX + BOARD_PARAMETERS];
    let mut global = 0;
    while global < places.len() {
        places[global] =
            if global < MAX_PARAMETERS { ROW_INTRINSICS + global } else { ROW_BOARD + global - BOARD_INDEX };
        global += 1;
    }
    places
};

/// 6 × globals block of a control point, row by row.
pub type BorderBlock = [[f64; GLOBAL_COUNT]; 6];

/// Normal equations of an interval of one segment.
#[derive(Clone, Debug)]
pub struct RangeEquations {
    /// Index of the first control point concerned.
    pub first: usize,
    /// Number of control points that act at one time.
    pub order: usize,
    /// For each control point its blocks with itself and the `order − 1` before it.
    pub blocks: Vec<Block>,
    /// For each control point its block with the global parameters.
    pub border: Vec<BorderBlock>,
    /// For each control point its gradient Jᵀr.
    pub gradient: Vec<[f64; 6]>,
    /// Global part, lower triangle.
    pub corner: DMatrix<f64>,
    /// Global gradient.
    pub corner_gradient: [f64; GLOBAL_COUNT],
    /// Loss of the observations.
    pub loss: Loss,
}

impl RangeEquations {
    /// Creates empty equations for `count` control points from `first` on.
    pub fn new(first: usize, count: usize, order: usize) -> Self {
        Self {
            first,
            order,
            blocks: vec![Block::zeros(); count * order],
            border: vec![[[0.0; GLOBAL_COUNT]; 6]; count],
            gradient: vec![[0.0; 6]; count],
            corner: DMatrix::zeros(GLOBAL_COUNT, GLOBAL_COUNT),
            corner_gradient: [0.0; GLOBAL_COUNT],
            loss: Loss::default(),
        }
    }

    /// Returns the number of control points.
    pub fn control_point_count(&self) -> usize {
        self.border.len()
    }

    /// Expands the pose part of `products` to the control points of `pose`, and clears that part.
    pub fn add_bin(&mut self, pose: &PoseBin, products: &mut RowProducts) {
        if !products.is_touched {
            return;
        }
        let common = &products.common;
        let block = |row: usize, column: usize| {
            Matrix3::from_fn(|i, j| {
                let (line, other) = (row + i, column + j);
                common[line.max(other)][line.min(other)]
            })
        };
        let (rotation, mixed, translation) = (block(0, 0), block(0, 3), block(3, 3));
        let gradient = &common[ROW_RESIDUAL];
        let turning = Vector3::new(gradient[0], gradient[1], gradient[2]);
        let border = border_of(products);
        let order = self.order;
        for (a, (jacobian, &weight)) in pose.rotation_jacobians.iter().zip(&pose.weights).take(order).enumerate() {
            let Some(index) = (pose.first + a).checked_sub(self.first) else { continue };
            if index >= self.border.len() {
                continue;
            }
            let transposed = jacobian.transpose();
            let (rotation_a, mixed_a) = (transposed * rotation, transposed * mixed);
            for (b, (jacobian_b, &weight_b)) in
                pose.rotation_jacobians.iter().zip(&pose.weights).take(a + 1).enumerate()
            {
                let block = &mut self.blocks[index * order + (a - b)];
                let mut add = |row: usize, column: usize, part: Matrix3<f64>| {
                    let mut view = block.fixed_view_mut::<3, 3>(row, column);
                    view += part;
                };
                add(0, 0, rotation_a * jacobian_b);
                add(0, 3, mixed_a * weight_b);
                add(3, 0, (mixed.transpose() * jacobian_b) * weight);
                add(3, 3, translation * (weight * weight_b));
            }
            add_border(&mut self.border[index], &border, jacobian, weight);
            let sum = &mut self.gradient[index];
            let turned = transposed * turning;
            for axis in 0..3 {
                sum[axis] += turned[axis];
                sum[3 + axis] += gradient[3 + axis] * weight;
            }
        }
        products.clear_pose();
    }

    /// Adds the global part of `products`.
    pub fn add_globals(&mut self, products: &RowProducts) {
        let corner = &mut self.corner;
        for (parameter, place) in COMMON_PLACES.into_iter().enumerate() {
            let line = &products.common[place];
            for (other, place) in COMMON_PLACES.into_iter().enumerate().take(parameter + 1) {
                corner[(parameter, other)] += line[place];
            }
            self.corner_gradient[parameter] += line[ROW_RESIDUAL];
        }
        for (class, lines) in products.classes.iter().enumerate() {
            for (bias, line) in Bias::ALL.into_iter().zip(lines) {
                let global = bias_index(class, bias);
                for (parameter, place) in COMMON_PLACES.into_iter().enumerate() {
                    corner[(global, parameter)] += line[place];
                }
                for other in Bias::ALL.into_iter().take_while(|other| other.index() <= bias.index()) {
                    let other_global = bias_index(class, other);
                    // Shared biases come before a class's own.
                    corner[(global.max(other_global), global.min(other_global))] += line[row_bias(other)];
                }
                self.corner_gradient[global] += line[ROW_RESIDUAL];
            }
        }
    }
}

/// Returns the products of the pose with the global parameters.
pub fn border_of(products: &RowProducts) -> BorderBlock {
    let mut border = [[0.0; GLOBAL_COUNT]; 6];
    for (axis, line) in border.iter_mut().enumerate() {
        for (entry, place) in line.iter_mut().zip(COMMON_PLACES) {
            *entry = products.common[place][axis];
        }
    }
    for class in (0..CLASS_COUNT).filter(|&class| products.touched[class]) {
        for (bias, from) in Bias::ALL.into_iter().zip(&products.classes[class]) {
            for (line, value) in border.iter_mut().zip(from) {
                line[bias_index(class, bias)] += *value;
            }
        }
    }
    border
}

/// Adds the part of a control point. `jacobian` is the derivative of the rotation by the control point, `weight` the derivative
/// of the translation.
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn add_border(sum: &mut BorderBlock, border: &BorderBlock, jacobian: &Matrix3<f64>, weight: f64) {
    let [x, y, z, moving @ ..] = border;
    let (turning, moved) = sum.split_at_mut(3);
    for (axis, line) in turning.iter_mut().enumerate() {
        let [by_x, by_y, by_z] = [jacobian[(0, axis)], jacobian[(1, axis)], jacobian[(2, axis)]];
        for (global, sum) in line.iter_mut().enumerate() {
            *sum += by_x * x[global] + by_y * y[global] + by_z * z[global];
        }
    }
    for (line, moving) in moved.iter_mut().zip(moving) {
        for (sum, value) in line.iter_mut().zip(moving) {
            *sum += weight * value;
        }
    }
}

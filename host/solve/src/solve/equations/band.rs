//! Normal equations of consecutive control points: a block-banded matrix with a border.

use nalgebra::{Matrix3, Vector3};

use super::border::{Border, POINT};
use super::control_band::{Block, factored};
use super::eliminated::Eliminated;
use super::pose_products::PoseProducts;
use crate::solve::SolveError;
use crate::solve::rows::pose_bin::PoseBin;

/// Damping of the control points, as a share of the damping of the global parameters. If the board is hardly tilted, the control
/// points compensate nearly all of a change of the focal length; fully damped, they would stop the focal length far from its
/// minimum.
const OF_CONTROL_POINTS: f64 = 1e-3;

/// A (block-banded), B (border) and gradient of consecutive control points of one segment.
#[derive(Clone, Debug)]
pub struct Band {
    /// Index of the first control point.
    pub first: usize,
    /// Number of control points that act at one time; 1 without observations.
    pub order: usize,
    /// For each control point its blocks of A with itself (lower triangle) and the `order − 1` before it.
    pub blocks: Vec<Block>,
    /// For each control point its rows of B.
    pub border: Border,
    /// For each control point its gradient Jᵀr.
    pub gradient: Vec<[f64; POINT]>,
}

impl Band {
    /// Creates empty equations of `count` control points from `first` on, with `width` columns of the border.
    pub fn new(first: usize, count: usize, order: usize, width: usize) -> Self {
        Self {
            first,
            order,
            blocks: vec![Block::zeros(); count * order],
            border: Border::zeros(count, width),
            gradient: vec![[0.0; POINT]; count],
        }
    }

    /// Returns the number of control points.
    pub fn count(&self) -> usize {
        self.gradient.len()
    }

    /// Expands the `products` of a pose to its control points.
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if the pose depends on control points that are not here.
    pub fn add(&mut self, pose: &PoseBin, products: &PoseProducts) -> Result<(), SolveError> {
        let order = self.order;
        let start = pose.first.checked_sub(self.first).ok_or(SolveError::OutOfBand)?;
        if pose.order != order || start + order > self.count() {
            return Err(SolveError::OutOfBand);
        }
        let part = |row: usize, column: usize| products.own.fixed_view::<3, 3>(row, column).into_owned();
        let (rotation, mixed, translation) = (part(0, 0), part(0, 3), part(3, 3));
        let gradient = &products.gradient;
        let turning = Vector3::new(gradient[0], gradient[1], gradient[2]);
        for (a, (jacobian, &weight)) in pose.rotation_jacobians.iter().zip(&pose.weights).take(order).enumerate() {
            let index = start + a;
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
            self.border.add(index, &products.border, jacobian, weight);
            let sum = &mut self.gradient[index];
            let turned = transposed * turning;
            for axis in 0..3 {
                sum[axis] += turned[axis];
                sum[3 + axis] += gradient[3 + axis] * weight;
            }
        }
        Ok(())
    }

    /// Adds equations whose first column is column `at` here.
    ///
    /// # Errors
    /// [`SolveError::OutOfBand`] if they have other control points.
    pub fn merge(&mut self, part: &Self, at: usize) -> Result<(), SolveError> {
        if part.count() == 0 {
            return Ok(());
        }
        let index = part.first.checked_sub(self.first).ok_or(SolveError::OutOfBand)?;
        if part.order != self.order
            || index + part.count() > self.count()
            || at + part.border.width() > self.border.width()
        {
            return Err(SolveError::OutOfBand);
        }
        let blocks = self.blocks.iter_mut().skip(index * self.order);
        blocks.zip(&part.blocks).for_each(|(sum, block)| *sum += block);
        self.border.merge(index, at, &part.border);
        for (sum, part) in self.gradient.iter_mut().skip(index).zip(&part.gradient) {
            sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        Ok(())
    }

    /// Multiplies the matrix of the control points by `columns`, a vector of six per control point.
    pub fn times(&self, columns: &[[f64; POINT]]) -> Vec<[f64; POINT]> {
        let mut product = vec![[0.0; POINT]; columns.len()];
        for index in 0..columns.len().min(self.count()) {
            for back in 0..self.order.min(index + 1) {
                let block = &self.blocks[index * self.order + back];
                for row in 0..POINT {
                    for column in 0..POINT {
                        if back == 0 {
                            let entry = block[(row.max(column), row.min(column))];
                            product[index][row] += entry * columns[index][column];
                        } else {
                            let entry = block[(row, column)];
                            product[index][row] += entry * columns[index - back][column];
                            product[index - back][column] += entry * columns[index][row];
                        }
                    }
                }
            }
        }
        product
    }

    /// Eliminates the control points. Their matrix is damped along with global parameters that are damped by `damping`; `scale` is
    /// its mean diagonal entry from the observations alone.
    ///
    /// # Errors
    /// [`SolveError::Singular`] if the observations do not determine the control points.
    pub fn eliminated(&self, damping: f64, scale: f64) -> Result<Eliminated, SolveError> {
        let factor = factored(&self.blocks, self.order, OF_CONTROL_POINTS * damping, scale)?;
        Ok(Eliminated::new(factor, self.order, self.border.clone(), &self.gradient))
    }

    /// Does the same and consumes the equations.
    ///
    /// # Errors
    /// As [`Band::eliminated`].
    pub fn into_eliminated(self, damping: f64, scale: f64) -> Result<Eliminated, SolveError> {
        let factor = factored(&self.blocks, self.order, OF_CONTROL_POINTS * damping, scale)?;
        drop(self.blocks);
        Ok(Eliminated::new(factor, self.order, self.border, &self.gradient))
    }
}

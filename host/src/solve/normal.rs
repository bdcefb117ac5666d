//! The normal equations of a stretch of trajectory, and their assembly.
//!
//! Events of one time bin share the pose and the basis weights. A bin therefore only sums the outer
//! products of short rows (pose, intrinsics, offset, latency, residual) and expands them to the
//! control points once. Stretches of bins are independent, so they run in parallel and are merged
//! in a fixed order: the result does not depend on the number of threads.

use evcal_core::camera::MAX_PARAMETERS;
use multiversion::multiversion;
use nalgebra::{DMatrix, Matrix3, SMatrix};

use crate::solve::event_bias::bias::Bias;

use super::event_row::{ROW, ROW_INTRINSICS, ROW_RESIDUAL, row_bias};
use super::pose_bin::PoseBin;
use super::{GLOBAL_COUNT, bias_index};

/// Sum of outer products of rows; only the part at and left of the diagonal's block of eight
/// columns is filled.
pub type RowProduct = [[f64; ROW]; ROW];

/// One past the last line that is used.
const END: usize = ROW_RESIDUAL + 1;

/// Adds the outer products of `rows` to `product`.
///
/// Each element is a sum in the order of the rows, whatever the vector width, so that all machines
/// get the same bits.
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
pub fn add_outer_products(product: &mut RowProduct, rows: &[[f64; ROW]]) {
    let (quads, rest) = rows.as_chunks::<4>();
    for quad in quads {
        add_columns::<8, 0, 8, 4>(product, quad);
        add_columns::<16, 8, 16, 4>(product, quad);
        add_columns::<24, 16, 24, 4>(product, quad);
        add_columns::<32, 24, END, 4>(product, quad);
    }
    for row in rest {
        let single = std::array::from_ref(row);
        add_columns::<8, 0, 8, 1>(product, single);
        add_columns::<16, 8, 16, 1>(product, single);
        add_columns::<24, 16, 24, 1>(product, single);
        add_columns::<32, 24, END, 1>(product, single);
    }
}

#[inline(always)]
fn add_columns<const COLUMNS: usize, const FIRST: usize, const END: usize, const COUNT: usize>(
    product: &mut RowProduct,
    rows: &[[f64; ROW]; COUNT],
) {
    for line in FIRST..END {
        let target = &mut product[line];
        for column in 0..COLUMNS {
            let mut sum = target[column];
            for row in rows {
                sum += row[line] * row[column];
            }
            target[column] = sum;
        }
    }
}

/// 6×6 block of two control points: rotation first, then translation.
pub type Block = SMatrix<f64, 6, 6>;
/// 6 × globals block of a control point.
pub type BorderBlock = SMatrix<f64, 6, GLOBAL_COUNT>;

/// Normal equations of a stretch of one segment.
#[derive(Clone, Debug)]
pub struct StretchEquations {
    /// First control point concerned.
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
    pub corner: Box<SMatrix<f64, GLOBAL_COUNT, GLOBAL_COUNT>>,
    /// Global gradient.
    pub corner_gradient: [f64; GLOBAL_COUNT],
    /// Sum of ρ over the rows.
    pub cost: f64,
    /// Number of observations.
    pub count: usize,
}

impl StretchEquations {
    /// Empty equations for `count` control points from `first` on.
    pub fn new(first: usize, count: usize, order: usize) -> Self {
        Self {
            first,
            order,
            blocks: vec![Block::zeros(); count * order],
            border: vec![BorderBlock::zeros(); count],
            gradient: vec![[0.0; 6]; count],
            corner: Box::new(SMatrix::zeros()),
            corner_gradient: [0.0; GLOBAL_COUNT],
            cost: 0.0,
            count: 0,
        }
    }

    /// Number of control points.
    pub fn control_point_count(&self) -> usize {
        self.border.len()
    }

    /// The block-banded symmetric matrix of the control points times `columns`, which has six rows a
    /// control point.
    pub fn banded_times(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let mut product = DMatrix::zeros(columns.nrows(), columns.ncols());
        for index in 0..self.control_point_count() {
            for back in 0..self.order.min(index + 1) {
                let mut block = self.blocks[index * self.order + back];
                if back == 0 {
                    block.fill_upper_triangle_with_lower_triangle();
                }
                let (row, column) = (6 * index, 6 * (index - back));
                let mut target = product.rows_mut(row, 6);
                target.gemm(1.0, &block, &columns.rows(column, 6), 1.0);
                if back > 0 {
                    let mut target = product.rows_mut(column, 6);
                    target.gemm_tr(1.0, &block, &columns.rows(row, 6), 1.0);
                }
            }
        }
        product
    }
}

/// The rows of one time bin, summed, before they are expanded to control points.
pub struct BinEquations {
    pose: Block,
    border: BorderBlock,
    gradient: [f64; 6],
    empty: bool,
}

impl Default for BinEquations {
    fn default() -> Self {
        Self { pose: Block::zeros(), border: BorderBlock::zeros(), gradient: [0.0; 6], empty: true }
    }
}

impl BinEquations {
    /// Adds the rows of one event class; `product` is cleared.
    pub fn add_class(&mut self, product: &mut RowProduct, class: usize, equations: &mut StretchEquations) {
        self.empty = false;
        let at =
            |line: usize, column: usize| if line >= column { product[line][column] } else { product[column][line] };
        for line in 0..6 {
            for column in 0..=line {
                self.pose[(line, column)] += at(line, column);
            }
            for parameter in 0..MAX_PARAMETERS {
                self.border[(line, parameter)] += at(ROW_INTRINSICS + parameter, line);
            }
            for bias in Bias::ALL {
                self.border[(line, bias_index(class, bias))] += at(row_bias(bias), line);
            }
            self.gradient[line] += at(ROW_RESIDUAL, line);
        }
        let corner = &mut equations.corner;
        for parameter in 0..MAX_PARAMETERS {
            let line = ROW_INTRINSICS + parameter;
            for other in 0..=parameter {
                corner[(parameter, other)] += at(line, ROW_INTRINSICS + other);
            }
            equations.corner_gradient[parameter] += at(ROW_RESIDUAL, line);
        }
        for bias in Bias::ALL {
            let (global, line) = (bias_index(class, bias), row_bias(bias));
            for parameter in 0..MAX_PARAMETERS {
                corner[(global, parameter)] += at(line, ROW_INTRINSICS + parameter);
            }
            for other in Bias::ALL.into_iter().take_while(|other| other.index() <= bias.index()) {
                corner[(global, bias_index(class, other))] += at(line, row_bias(other));
            }
            equations.corner_gradient[global] += at(ROW_RESIDUAL, line);
        }
        *product = [[0.0; ROW]; ROW];
    }

    /// Expands the bin to the control points of `pose` and clears it.
    pub fn expand(&mut self, pose: &PoseBin, equations: &mut StretchEquations) {
        if std::mem::replace(&mut self.empty, true) {
            return;
        }
        self.pose.fill_upper_triangle_with_lower_triangle();
        let rotation: Matrix3<f64> = self.pose.fixed_view::<3, 3>(0, 0).into();
        let mixed: Matrix3<f64> = self.pose.fixed_view::<3, 3>(0, 3).into();
        let translation: Matrix3<f64> = self.pose.fixed_view::<3, 3>(3, 3).into();
        let border_rotation: SMatrix<f64, 3, GLOBAL_COUNT> = self.border.fixed_view::<3, GLOBAL_COUNT>(0, 0).into();
        let border_translation: SMatrix<f64, 3, GLOBAL_COUNT> = self.border.fixed_view::<3, GLOBAL_COUNT>(3, 0).into();
        let gradient_rotation = nalgebra::Vector3::new(self.gradient[0], self.gradient[1], self.gradient[2]);
        let order = equations.order;
        for (a, (jacobian, &weight)) in pose.rotation_jacobians.iter().zip(&pose.weights).take(order).enumerate() {
            let Some(index) = (pose.first + a).checked_sub(equations.first) else { continue };
            if index >= equations.border.len() {
                continue;
            }
            let transposed = jacobian.transpose();
            let rotation_a = transposed * rotation;
            let mixed_a = transposed * mixed;
            for (b, (jacobian_b, &weight_b)) in
                pose.rotation_jacobians.iter().zip(&pose.weights).take(a + 1).enumerate()
            {
                let block = &mut equations.blocks[index * order + (a - b)];
                let mut add = |row: usize, column: usize, part: Matrix3<f64>| {
                    let mut view = block.fixed_view_mut::<3, 3>(row, column);
                    view += part;
                };
                add(0, 0, rotation_a * jacobian_b);
                add(0, 3, mixed_a * weight_b);
                add(3, 0, (mixed.transpose() * jacobian_b) * weight);
                add(3, 3, translation * (weight * weight_b));
            }
            let border = &mut equations.border[index];
            let mut view = border.fixed_view_mut::<3, GLOBAL_COUNT>(0, 0);
            view += transposed * border_rotation;
            let mut view = border.fixed_view_mut::<3, GLOBAL_COUNT>(3, 0);
            view += border_translation * weight;
            let gradient = &mut equations.gradient[index];
            let turned = transposed * gradient_rotation;
            for axis in 0..3 {
                gradient[axis] += turned[axis];
                gradient[3 + axis] += self.gradient[3 + axis] * weight;
            }
        }
        *self = Self::default();
    }
}

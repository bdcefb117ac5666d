//! The rows of one circle centre: its reprojection error and derivatives.
//!
//! With `T_world_camera` = (R, p), the centre X on the board and x = Rᵀ(X − p): r = π(x) − m,
//! ∂x/∂ω = \[x\]× (rotation perturbed in the camera frame), ∂x/∂p = −Rᵀ.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use nalgebra::{Vector2, Vector3};

use super::event_row::{ROW, ROW_INTRINSICS, ROW_RESIDUAL};
use super::pose_bin::PoseBin;

/// Both rows (x and y) of a centre seen at `pixel`, unweighted; `None` where the model cannot
/// project it.
pub fn point_rows(
    camera: &Camera<f64>,
    pose: &PoseBin,
    center: Vector2<f64>,
    pixel: Vector2<f64>,
) -> Option<[[f64; ROW]; 2]> {
    let transposed = pose.rotation_matrix().transpose();
    let point = transposed * (Vector3::new(center.x, center.y, 0.0) - pose.translation_vector());
    let projection = camera.project_with_jacobians(&point)?;
    let by_rotation = projection.by_point * point.cross_matrix();
    let by_translation = -projection.by_point * transposed;
    let residual = projection.pixel - pixel;
    Some(std::array::from_fn(|axis| {
        let mut row = [0.0; ROW];
        for column in 0..3 {
            row[column] = by_rotation[(axis, column)];
            row[3 + column] = by_translation[(axis, column)];
        }
        for parameter in 0..MAX_PARAMETERS {
            row[ROW_INTRINSICS + parameter] = projection.by_parameters[(axis, parameter)];
        }
        row[ROW_RESIDUAL] = residual[axis];
        row
    }))
}

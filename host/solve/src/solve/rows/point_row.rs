//! The rows of one circle centre: its reprojection error and derivatives.
//!
//! With `T_world_camera` = (R, p), the centre X on the board and x = Rᵀ(X − p): r = π(x) − m,
//! ∂x/∂ω = \[x\]× (rotation perturbed in the camera frame), ∂x/∂p = −Rᵀ.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use nalgebra::{Vector2, Vector3};

use super::event_row::{ROW, ROW_BOARD, ROW_INTRINSICS, ROW_RESIDUAL};
use super::pose_bin::PoseBin;
use evcal_geometry::board::shape::{BoardShape, CircleArea, Surface};

/// Returns both rows (x and y) of a centre seen at `pixel`, unweighted; `None` if the model cannot project it. `center` is its
/// position on the print of a board of this `shape` with circles in `area`.
pub fn point_rows(
    camera: &Camera<f64>,
    area: &CircleArea,
    shape: &BoardShape,
    pose: &PoseBin,
    center: [f64; 2],
    pixel: Vector2<f64>,
) -> Option<[[f64; ROW]; 2]> {
    let transposed = pose.rotation_matrix().transpose();
    let place = if shape.is_flat() { [center[0], center[1], 0.0] } else { Surface::new(area, shape).place(center) };
    let point = transposed * (Vector3::from(place) - pose.translation_vector());
    let projection = camera.project_with_jacobians(&point)?;
    let by_rotation = projection.by_point * point.cross_matrix();
    let by_translation = -projection.by_point * transposed;
    let residual = projection.pixel - pixel;
    let on_board = projection.by_point * transposed;
    let half = 0.5 / shape.print_ratio;
    let [x, y] = [place[0] - area.middle[0], place[1] - area.middle[1]];
    let rise = area.rise([place[0], place[1]]);
    Some(std::array::from_fn(|axis| {
        let mut row = [0.0; ROW];
        for column in 0..3 {
            row[column] = by_rotation[(axis, column)];
            row[3 + column] = by_translation[(axis, column)];
        }
        for parameter in 0..MAX_PARAMETERS {
            row[ROW_INTRINSICS + parameter] = projection.by_parameters[(axis, parameter)];
        }
        row[ROW_BOARD] = half * (on_board[(axis, 0)] * x - on_board[(axis, 1)] * y);
        row[ROW_BOARD + 1] = on_board[(axis, 2)] * rise[0];
        row[ROW_BOARD + 2] = on_board[(axis, 2)] * rise[1];
        row[ROW_RESIDUAL] = residual[axis];
        row
    }))
}

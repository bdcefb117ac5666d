//! How the projection over the sensor answers to a change of the camera's parameters.
//!
//! A bearing goes through the lens to a pixel; how far would it land elsewhere, were a parameter another?
//! Part of that is only a camera frame turned by a little, which no user of a calibration can notice: the
//! rotation that fits best over the sensor is taken out, as in [`projection_difference`](super::projection_difference)
//! (and as mrcal's projection uncertainty does).

use evcal_core::camera::Camera;
use nalgebra::{DMatrix, Matrix2x3, Matrix2xX, Matrix3, Vector2};

/// The answer of the projection at some pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct ProjectionSensitivity {
    /// For each pixel the derivative of the projection by the parameters (2 × parameters, px per unit of the
    /// parameter), the rotation taken out; `None` where the lens model ends.
    pub changes: Vec<Option<Matrix2xX<f64>>>,
    /// Sum over the pixels of CᵀC for each change C (parameters × parameters).
    pub squares: DMatrix<f64>,
    /// Pixels that the lens sees.
    pub seen: usize,
}

/// The sensitivity of `camera` at `pixels`; `None` when the lens sees fewer than 3 of them.
pub fn projection_sensitivity(camera: &Camera<f64>, pixels: &[Vector2<f64>]) -> Option<ProjectionSensitivity> {
    let count = camera.parameters().len();
    // At each pixel: derivatives of the projection by the parameters, and by a turn of the camera.
    let places: Vec<Option<(DMatrix<f64>, Matrix2x3<f64>)>> = pixels
        .iter()
        .map(|pixel| {
            let bearing = camera.unproject(pixel)?;
            let projection = camera.project_with_jacobians(&bearing)?;
            let by_parameters = DMatrix::from_fn(2, count, |row, column| projection.by_parameters[(row, column)]);
            Some((by_parameters, -projection.by_point * bearing.cross_matrix()))
        })
        .collect();
    let seen = places.iter().flatten().count();
    let mut turns = Matrix3::zeros();
    let mut mixed = DMatrix::zeros(3, count);
    for (by_parameters, by_turn) in places.iter().flatten() {
        turns += by_turn.transpose() * by_turn;
        mixed += by_turn.transpose() * by_parameters;
    }
    let (Some(turns), true) = (turns.cholesky(), seen >= 3) else { return None };
    let turn_by_parameters = -turns.solve(&mixed);
    let mut squares = DMatrix::zeros(count, count);
    let changes = places
        .into_iter()
        .map(|place| {
            let (by_parameters, by_turn) = place?;
            let change = by_parameters + by_turn * &turn_by_parameters;
            squares += change.transpose() * &change;
            Some(change)
        })
        .collect();
    Some(ProjectionSensitivity { changes, squares, seen })
}

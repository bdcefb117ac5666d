//! Sensitivity of the projection over the sensor to the camera's parameters.
//!
//! It is the change of a bearing's pixel when a parameter changes. A part of that change is a small rotation of the
//! camera frame, which has no effect on users of a calibration. Therefore the rotation that fits best over the sensor
//! is removed, as in [`projection_difference`](super::projection_difference) (and in mrcal's projection uncertainty).

use evcal_core::camera::Camera;
use nalgebra::{DMatrix, Matrix2x3, Matrix2xX, Matrix3, Vector2};

/// Derivatives of the projection at some pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct ProjectionSensitivity {
    /// For each pixel the derivative of the projection with respect to the parameters (2 × parameters, px per unit of
    /// the parameter), with the rotation removed; `None` outside the domain of the lens model.
    pub changes: Vec<Option<Matrix2xX<f64>>>,
    /// Sum over the pixels of CᵀC for each change C (parameters × parameters).
    pub squares: DMatrix<f64>,
    /// Number of pixels that the lens sees.
    pub seen: usize,
}

/// Computes the sensitivity of `camera` at `pixels`; `None` if the lens sees fewer than 3 of them.
pub fn projection_sensitivity(camera: &Camera<f64>, pixels: &[Vector2<f64>]) -> Option<ProjectionSensitivity> {
    let count = camera.parameters().len();
    // At each pixel: derivatives of the projection with respect to the parameters and to a rotation of the camera.
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

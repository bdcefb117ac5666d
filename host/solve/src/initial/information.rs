//! Fisher information of views of the board about the intrinsics.
//!
//! The normal equations of a view contain the camera's parameters and the view's pose. Elimination of the pose (Schur complement)
//! leaves the view's Fisher information about the intrinsics. The information of several views adds up.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, Isometry3, Point3, SMatrix, Vector2};

use evcal_geometry::lens::projection_difference::grid;
use evcal_geometry::lens::projection_sensitivity::projection_sensitivity;
use evcal_geometry::numerics::arrow::PoseEquations;

/// Inverse covariance of a camera's parameters, in their order; rows and columns beyond them are zero.
pub type Information = SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>;

/// Standard deviation of a circle's centre in a window, in px and in each direction; larger than its scatter, because
/// neighbouring windows have errors in common.
const CENTER_SIGMA: f64 = 0.24;
/// Prior standard deviation of the focal lengths (px).
const FOCAL_SIGMA: f64 = 100.0;
/// Prior standard deviation of the principal point (px).
const MIDDLE_SIGMA: f64 = 40.0;
/// Prior standard deviation of a distortion coefficient.
const COEFFICIENT_SIGMA: f64 = 0.5;

/// Returns the prior information about a camera.
pub fn prior(camera: &Camera<f64>) -> Information {
    let mut information = Information::zeros();
    for index in 0..camera.parameters().len() {
        let sigma = match index {
            0 | 1 => FOCAL_SIGMA,
            2 | 3 => MIDDLE_SIGMA,
            _ => COEFFICIENT_SIGMA,
        };
        information[(index, index)] = 1.0 / (sigma * sigma);
    }
    information
}

/// Returns the information of one view of `points` (board plane, m) at `pose` (`T_camera_world`); `None` if the points do not
/// determine the pose or one of them is outside the lens's domain.
pub fn view_information(
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
    points: impl Iterator<Item = Vector2<f64>>,
) -> Option<Information> {
    let mut equations = PoseEquations::<MAX_PARAMETERS>::new();
    let weight = 1.0 / (CENTER_SIGMA * CENTER_SIGMA);
    for point in points {
        let seen = (pose * Point3::new(point.x, point.y, 0.0)).coords;
        let projection = camera.project_with_jacobians(&seen)?;
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&(-projection.by_point * seen.cross_matrix()));
        by_pose.fixed_columns_mut::<3>(3).copy_from(&projection.by_point);
        equations.add(Vector2::zeros(), &projection.by_parameters, &by_pose, weight);
    }
    let information = equations.border - equations.eliminate(0.0)?.border;
    information.iter().all(|value| value.is_finite()).then_some(information)
}

/// Returns the root mean square of the projection's standard deviation (px) in each cell of the sensor divided into `columns` ×
/// `rows`, row by row. A cell outside the lens's domain has `None`; the result is `None` if `information` does not determine the
/// parameters.
pub fn sigma_in_cells(
    camera: &Camera<f64>,
    sensor: Sensor,
    columns: u16,
    rows: u16,
    information: &Information,
) -> Option<Vec<Option<f64>>> {
    let pixels = places(sensor);
    let sensitivity = projection_sensitivity(camera, &pixels)?;
    let count = camera.parameters().len();
    let covariance = information.view((0, 0), (count, count)).into_owned().cholesky()?.inverse();
    let cell = |position: f64, size: u16, cells: u16| {
        let cell = (position + 0.5) / f64::from(size) * f64::from(cells);
        (cell.max(0.0) as usize).min(usize::from(cells).saturating_sub(1))
    };
    let mut sums = vec![(0.0, 0.0); usize::from(columns) * usize::from(rows)];
    for (pixel, change) in pixels.iter().zip(&sensitivity.changes) {
        let index = cell(pixel.y, sensor.height, rows) * usize::from(columns) + cell(pixel.x, sensor.width, columns);
        if let (Some(change), Some((sum, seen))) = (change, sums.get_mut(index)) {
            *sum += (change * &covariance * change.transpose()).trace();
            *seen += 1.0;
        }
    }
    Some(sums.into_iter().map(|(sum, seen)| (seen > 0.0).then(|| (sum / seen).max(0.0).sqrt())).collect())
}

/// Returns every third pixel of the grid: a mean over 900 positions is as good as one over 2,800.
fn places(sensor: Sensor) -> Vec<Vector2<f64>> {
    grid(sensor).into_iter().step_by(3).collect()
}

/// Converts a covariance of parameters to the mean square error of the projection over the sensor.
#[derive(Clone, Debug)]
pub struct ProjectionMeasure {
    /// Mean over the sensor of CᵀC, where C is the derivative of the projection by the parameters.
    mean_square: DMatrix<f64>,
}

impl ProjectionMeasure {
    /// Creates the measure for `camera` on `sensor`; `None` if the lens covers almost nothing of the sensor.
    pub fn new(camera: &Camera<f64>, sensor: Sensor) -> Option<Self> {
        let sensitivity = projection_sensitivity(camera, &places(sensor))?;
        Some(Self { mean_square: sensitivity.squares / sensitivity.seen as f64 })
    }

    /// Returns the root mean square over the sensor of the projection's standard deviation, in px; `None` if `information` does
    /// not determine the parameters.
    pub fn sigma(&self, information: &Information) -> Option<f64> {
        let count = self.mean_square.nrows();
        let information = information.view((0, 0), (count, count)).into_owned();
        let variance = information.cholesky()?.solve(&self.mean_square).trace();
        (variance.is_finite() && variance >= 0.0).then(|| variance.sqrt())
    }
}

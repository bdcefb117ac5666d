//! Difference between the projections of two calibrations, with the implied rotation removed.
//!
//! A calibration determines the camera frame only up to its own errors: a principal point moved by one pixel and a
//! camera rotated by the angle of one pixel have nearly the same effect. Therefore each pixel of a grid is unprojected
//! by the first lens, rotated by the one rotation that fits best over the whole grid, and projected by the second lens.
//! The remainder is the difference (as in mrcal's `show-projection-diff` without distance). It depends on the position
//! on the sensor, so its root mean square, its maximum and a map are reported.

use std::fmt;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{Matrix2x3, Matrix3, UnitQuaternion, Vector2, Vector3};
use serde::Serialize;

use crate::numerics::rigid::best_rotation;

/// Number of columns of the grid of pixels.
const COLUMNS: u16 = 61;
/// Largest number of Gauss-Newton iterations.
const ROUNDS: usize = 30;
/// Change of the rotation in radians below which it has converged.
const CONVERGED: f64 = 1e-12;

/// The difference at one pixel of the grid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct GridDifference {
    /// The pixel in the first calibration.
    pub pixel: [f64; 2],
    /// The pixel in the second calibration minus the pixel in the first; `None` outside the domain of one of the lens
    /// models, and where they are more than the diagonal of the sensor apart.
    pub difference: Option<[f64; 2]>,
}

/// The projection difference of two calibrations over the sensor.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ProjectionDifference {
    /// Columns of the grid, from the first to the last pixel of a row.
    pub columns: u16,
    /// Rows of the grid, from the first to the last pixel of a column.
    pub rows: u16,
    /// The differences, row by row.
    pub grid: Vec<GridDifference>,
    /// The implied rotation, which maps bearings of the first camera to bearings of the second, as a rotation vector in
    /// radians.
    pub rotation: [f64; 3],
    /// Root mean square of the differences in pixels.
    pub rms: f64,
    /// Largest difference in pixels.
    pub max: f64,
    /// The pixel of the largest difference.
    pub max_at: [f64; 2],
    /// Number of grid pixels outside the domain of one of the lens models.
    pub uncovered: usize,
}

/// Reason why two calibrations cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the lens models share only {covered} of {total} points of the sensor, a quarter is needed: are both for this sensor size?"
)]
pub struct NoCommonView {
    /// Number of pixels in the domain of both models.
    pub covered: usize,
    /// Number of pixels examined.
    pub total: usize,
}

/// Computes the projection difference of `second` to `first` over `sensor`.
pub fn projection_difference(
    first: &Camera<f64>,
    second: &Camera<f64>,
    sensor: Sensor,
) -> Result<ProjectionDifference, NoCommonView> {
    let unproject = |pixel: &Vector2<f64>| first.unproject(pixel);
    let unproject_second = |pixel: &Vector2<f64>| second.unproject(pixel);
    let project = |point: &Vector3<f64>| {
        let projection = second.project_with_jacobians(point)?;
        Some((projection.pixel, projection.by_point))
    };
    difference(unproject, unproject_second, project, sensor)
}

fn difference(
    unproject_first: impl Fn(&Vector2<f64>) -> Option<Vector3<f64>>,
    unproject_second: impl Fn(&Vector2<f64>) -> Option<Vector3<f64>>,
    project_second: impl Fn(&Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)>,
    sensor: Sensor,
) -> Result<ProjectionDifference, NoCommonView> {
    let pixels = grid(sensor);
    let bearings: Vec<Option<Vector3<f64>>> = pixels.iter().map(unproject_first).collect();
    let seen = || pixels.iter().zip(&bearings).filter_map(|(pixel, bearing)| Some((pixel, (*bearing)?)));

    let start = best_rotation(seen().filter_map(|(pixel, bearing)| Some((unproject_second(pixel)?, bearing))));
    let mut rotation = UnitQuaternion::from_rotation_matrix(&start);
    for _ in 0..ROUNDS {
        let (mut normal, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
        for (pixel, bearing) in seen() {
            let turned = rotation * bearing;
            if let Some((projected, by_point)) = project_second(&turned) {
                // A further small rotation ω moves the point by ω × p.
                let by_turn = -by_point * turned.cross_matrix();
                normal += by_turn.transpose() * by_turn;
                gradient += by_turn.transpose() * (projected - pixel);
            }
        }
        let Some(factor) = normal.cholesky() else { break };
        let turn = -factor.solve(&gradient);
        rotation = UnitQuaternion::new(turn) * rotation;
        if turn.norm() < CONVERGED {
            break;
        }
    }

    let diagonal = f64::from(sensor.width).hypot(f64::from(sensor.height));
    let differences: Vec<Option<Vector2<f64>>> = pixels
        .iter()
        .zip(&bearings)
        .map(|(pixel, bearing)| Some(project_second(&(rotation * (*bearing)?))?.0 - pixel))
        // Beyond that the second camera does not see the bearing, whatever its lens model extrapolates.
        .map(|difference| difference.filter(|difference| difference.norm() < diagonal))
        .collect();
    let covered = differences.iter().flatten().count();
    let worst = pixels
        .iter()
        .zip(&differences)
        .filter_map(|(pixel, difference)| Some((pixel, (*difference)?.norm())))
        .max_by(|a, b| a.1.total_cmp(&b.1));
    // The rotation would fit a few points of any two cameras.
    let (Some((max_at, max)), true) = (worst, covered >= 3 && 4 * covered >= pixels.len()) else {
        return Err(NoCommonView { covered, total: pixels.len() });
    };
    let sum: f64 = differences.iter().flatten().map(|difference| difference.norm_squared()).sum();
    let (columns, rows) = grid_size(sensor);
    Ok(ProjectionDifference {
        columns,
        rows,
        rotation: rotation.scaled_axis().into(),
        rms: (sum / covered as f64).sqrt(),
        max,
        max_at: (*max_at).into(),
        uncovered: pixels.len() - covered,
        grid: pixels
            .iter()
            .zip(&differences)
            .map(|(pixel, difference)| GridDifference {
                pixel: (*pixel).into(),
                difference: difference.map(Into::into),
            })
            .collect(),
    })
}

/// Returns the columns and rows of the grid of pixels on a sensor.
pub fn grid_size(sensor: Sensor) -> (u16, u16) {
    let rows = (f64::from(COLUMNS) * f64::from(sensor.height) / f64::from(sensor.width.max(1))).round();
    (COLUMNS, rows.clamp(2.0, 1000.0) as u16)
}

/// Returns the grid of pixels on a sensor, row by row.
pub fn grid(sensor: Sensor) -> Vec<Vector2<f64>> {
    let (columns, rows) = grid_size(sensor);
    let place = |index: u16, count: u16, size: u16| {
        f64::from(index) * (f64::from(size) - 1.0) / f64::from(count.saturating_sub(1).max(1))
    };
    (0..rows)
        .flat_map(|row| {
            (0..columns)
                .map(move |column| Vector2::new(place(column, columns, sensor.width), place(row, rows, sensor.height)))
        })
        .collect()
}

/// Columns and rows of the map in the text form.
const MAP: (usize, usize) = (8, 6);

impl ProjectionDifference {
    /// Returns the root mean square of the differences in each cell of a `columns` × `rows` division of the sensor, row
    /// by row; `None` for cells without grid pixels.
    pub fn map(&self, columns: usize, rows: usize) -> Vec<Option<f64>> {
        let mut sums = vec![(0.0, 0u32); columns * rows];
        let (grid_columns, grid_rows) = (usize::from(self.columns), usize::from(self.rows));
        for (index, point) in self.grid.iter().enumerate() {
            let cell =
                index / grid_columns * rows / grid_rows * columns + index % grid_columns * columns / grid_columns;
            if let (Some([x, y]), Some((sum, count))) = (point.difference, sums.get_mut(cell)) {
                *sum += x * x + y * y;
                *count += 1;
            }
        }
        sums.iter().map(|&(sum, count)| (count > 0).then(|| (sum / f64::from(count)).sqrt())).collect()
    }
}

impl fmt::Display for ProjectionDifference {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y] = self.max_at;
        writeln!(
            f,
            "projection difference, implied rotation of {:.4} deg removed: rms {:.4} px, max {:.4} px at ({x:.0}, {y:.0})",
            Vector3::from(self.rotation).norm().to_degrees(),
            self.rms,
            self.max
        )?;
        if self.uncovered > 0 {
            writeln!(f, "{} of {} points are outside one of the lens models", self.uncovered, self.grid.len())?;
        }
        write!(f, "rms by part of the sensor, px:")?;
        for row in self.map(MAP.0, MAP.1).chunks(MAP.0) {
            writeln!(f)?;
            for cell in row {
                match cell {
                    Some(rms) => write!(f, " {rms:7.3}")?,
                    None => write!(f, " {:>7}", "-")?,
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use nalgebra::Rotation3;

    use evcal_core::sensor::Sensor;

    use super::*;

    const SIZE: Sensor = Sensor::new(346, 260);

    fn camera(kind: ModelKind, parameters: &[f64]) -> Camera<f64> {
        Camera::from_parameters(kind, parameters).unwrap()
    }

    fn radtan() -> Camera<f64> {
        camera(ModelKind::Radtan, &[331.6, 331.1, 176.9, 134.2, -0.352, 0.149, -0.0004, 0.0005, -0.03])
    }

    fn kannala_brandt() -> Camera<f64> {
        camera(ModelKind::KannalaBrandt, &[196.4, 196.0, 169.3, 126.1, -0.018, 0.006, -0.003, 0.0006])
    }

    #[test]
    fn a_camera_does_not_differ_from_itself() {
        for camera in [radtan(), kannala_brandt()] {
            let same = projection_difference(&camera, &camera, SIZE).unwrap();
            assert!(same.max < 1e-8 && Vector3::from(same.rotation).norm() < 1e-10, "{same}");
            assert_eq!(same.uncovered, 0);
        }
    }

    #[test]
    fn a_known_rotation_is_removed_exactly() {
        for lens in [radtan(), kannala_brandt()] {
            let turn = Rotation3::new(Vector3::new(0.03, -0.02, 0.4));
            let project = |point: &Vector3<f64>| {
                let projection = lens.project_with_jacobians(&(turn.inverse() * point))?;
                Some((projection.pixel, projection.by_point * turn.inverse().matrix()))
            };
            let unproject_second = |pixel: &Vector2<f64>| Some(turn * lens.unproject(pixel)?);
            let result = difference(|pixel| lens.unproject(pixel), unproject_second, project, SIZE).unwrap();
            assert!(result.max < 1e-8, "{result}");
            assert!((Vector3::from(result.rotation) - turn.scaled_axis()).norm() < 1e-10);
        }
    }

    /// To first order a rotation by `a` about y moves the pixel of the image point (x, y) of a pinhole camera by
    /// f a (1 + x², x y): this least-squares problem has a solution in closed form.
    #[test]
    fn a_shifted_principal_point_is_partly_a_rotation() {
        let (focal, shift) = (300.0, 0.1);
        let first = camera(ModelKind::Radtan4, &[focal, focal, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0]);
        let second = camera(ModelKind::Radtan4, &[focal, focal, 172.5 + shift, 129.5, 0.0, 0.0, 0.0, 0.0]);
        let result = projection_difference(&first, &second, SIZE).unwrap();

        let points: Vec<(f64, f64)> =
            grid(SIZE).iter().map(|pixel| ((pixel.x - 172.5) / focal, (pixel.y - 129.5) / focal)).collect();
        let (mut numerator, mut denominator) = (0.0, 0.0);
        for (x, y) in &points {
            numerator += 1.0 + x * x;
            denominator += (1.0 + x * x).powi(2) + (x * y).powi(2);
        }
        let turn = shift * numerator / denominator;
        let square: f64 =
            points.iter().map(|(x, y)| (shift - turn * (1.0 + x * x)).powi(2) + (turn * x * y).powi(2)).sum();
        let expected = (square / points.len() as f64).sqrt();
        assert!((result.rms - expected).abs() < 1e-3 * expected, "{} and {expected}", result.rms);
        assert!((Vector3::from(result.rotation).norm() - turn / focal).abs() < 1e-3 * turn / focal);
        assert!(result.rms < 0.2 * shift);
    }

    #[test]
    fn a_focal_length_is_not_a_rotation() {
        let first = camera(ModelKind::Radtan4, &[300.0, 300.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0]);
        let second = camera(ModelKind::Radtan4, &[303.0, 303.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0]);
        let result = projection_difference(&first, &second, SIZE).unwrap();
        let corner = (172.5f64.powi(2) + 129.5f64.powi(2)).sqrt();
        assert!((result.max - 0.01 * corner).abs() < 1e-6, "{result}");
        assert!(Vector3::from(result.rotation).norm() < 1e-9);
        assert!([0.0, 345.0].contains(&result.max_at[0]) && [0.0, 259.0].contains(&result.max_at[1]));
        let map = result.map(2, 2);
        let [Some(a), Some(b), Some(c), Some(d)] = map[..] else { panic!("{map:?}") };
        assert!([b, c, d].iter().all(|cell| (cell - a).abs() < 0.1 * a));
    }

    /// With this fx the lens sees one column of the grid. The rotation fitted it, and the cameras were called the same.
    #[test]
    fn cameras_that_share_a_few_points_are_not_called_the_same() {
        let parameters = [250.1, 250.3, 172.5, 129.8, -0.35, 0.12, 0.0, 0.0];
        let second = camera(ModelKind::Radtan4, &parameters);
        for fx in [1e-308, 1e-300, 1e-3, 1.0] {
            let first = camera(ModelKind::Radtan4, &[&[fx], &parameters[1..]].concat());
            match projection_difference(&first, &second, SIZE) {
                Ok(compared) => assert!((20.0..1e3).contains(&compared.rms), "{fx}: {compared}"),
                Err(NoCommonView { covered, total }) => assert!(covered < total / 4, "{fx}: {covered} of {total}"),
            }
        }
        assert!(projection_difference(&second, &second, SIZE).is_ok());
    }

    #[test]
    fn points_beyond_a_lens_model_are_counted() {
        // Strong barrel distortion folds over before the corners.
        let narrow = camera(ModelKind::Radtan4, &[200.0, 200.0, 172.5, 129.5, -0.5, 0.0, 0.0, 0.0]);
        let wide = camera(ModelKind::KannalaBrandt, &[200.0, 200.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0]);
        let result = projection_difference(&wide, &narrow, SIZE).unwrap();
        assert!(result.uncovered > 0 && result.uncovered < result.grid.len());
        assert_eq!(result.grid.iter().filter(|point| point.difference.is_none()).count(), result.uncovered);
    }
}

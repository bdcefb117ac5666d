//! The camera without distortion that replaces a calibrated one.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use evcal_files::remedies;
use nalgebra::Vector2;

/// Number of points along each side of the grid that samples the field of view, as in OpenCV.
const GRID: u16 = 9;

/// Projection of the new camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum TargetProjection {
    /// As a pinhole: straight lines stay straight.
    #[default]
    Pinhole,
    /// Distance from the principal point = f · angle from the axis, for lenses whose field of view is too wide for a pinhole.
    Equidistant,
}

/// Reasons why there is no such camera.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TargetError {
    /// The border of the sensor is outside the range of the projection.
    #[error(
        "the view at the edge of the sensor is too wide for this projection: keep the camera matrix, or take the projection equidistant"
    )]
    RimUnseen,
    /// The calibrated camera cannot be inverted.
    #[error("no undistorted camera can be made from this calibration: fx or fy is not positive")]
    Impossible,
}

remedies! { TargetError, say;
    Self::RimUnseen => "leave out {}, or use {}", say.alpha?, say.equidistant?;
}

impl TargetProjection {
    /// All projections.
    pub const ALL: &[Self] = &[Self::Pinhole, Self::Equidistant];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Pinhole => "pinhole",
            Self::Equidistant => "equidistant",
        }
    }

    /// Returns a short description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Pinhole => "Straight lines stay straight",
            Self::Equidistant => "For wide lenses, whose outer parts a pinhole camera cannot show",
        }
    }

    /// Returns the camera with this projection and fx, fy, cx, cy.
    pub fn camera(self, matrix: [f64; 4]) -> Option<Camera<f64>> {
        let kind = match self {
            // Without coefficients it is a pinhole.
            Self::Pinhole => ModelKind::Radtan4,
            Self::Equidistant => ModelKind::KannalaBrandt,
        };
        let [fx, fy, cx, cy] = matrix;
        Camera::from_parameters(kind, &[fx, fy, cx, cy, 0.0, 0.0, 0.0, 0.0])
    }
}

/// Returns the camera without distortion that replaces `camera` on a `sensor`: `alpha` determines the part of the image that is
/// kept ([`optimal_matrix`]); without it the camera matrix is kept ([`same_matrix`]).
///
/// # Errors
/// [`TargetError`] if no such camera exists.
pub fn target_camera(
    camera: &Camera<f64>,
    projection: TargetProjection,
    sensor: Sensor,
    alpha: Option<f64>,
) -> Result<Camera<f64>, TargetError> {
    match alpha {
        Some(alpha) => optimal_matrix(camera, projection, sensor, alpha),
        None => same_matrix(camera, projection),
    }
}

/// Returns the camera with the matrix of `camera` and no distortion.
///
/// # Errors
/// [`TargetError::Impossible`] if the camera is invalid.
pub fn same_matrix(camera: &Camera<f64>, projection: TargetProjection) -> Result<Camera<f64>, TargetError> {
    let parameters = camera.parameters();
    let (matrix, _) = parameters.split_first_chunk::<4>().ok_or(TargetError::Impossible)?;
    projection.camera(*matrix).ok_or(TargetError::Impossible)
}

/// Returns the camera without distortion that shows the largest rectangle without black corners (`alpha` 0) of the field of view
/// of `camera` on a `sensor` (width, height), all of it (1), or something in between.
///
/// As OpenCV's `getOptimalNewCameraMatrix`: one rectangle fits inside the border points, the other encloses all points of a grid
/// of 9 × 9 pixels that spans the sensor; focal lengths and principal point are interpolated between them.
///
/// # Errors
/// [`TargetError`] if no such camera exists.
pub fn optimal_matrix(
    camera: &Camera<f64>,
    projection: TargetProjection,
    sensor: Sensor,
    alpha: f64,
) -> Result<Camera<f64>, TargetError> {
    let normalised = projection.camera([1.0, 1.0, 0.0, 0.0]).ok_or(TargetError::Impossible)?;
    let size = [f64::from(sensor.width) - 1.0, f64::from(sensor.height) - 1.0];
    let mut inner = Rectangle { least: [f64::NEG_INFINITY; 2], most: [f64::INFINITY; 2] };
    let mut outer = Rectangle { least: [f64::INFINITY; 2], most: [f64::NEG_INFINITY; 2] };
    for (row, column) in (0..GRID).flat_map(|row| (0..GRID).map(move |column| (row, column))) {
        let along = |index: u16, size: f64| size * f64::from(index) / f64::from(GRID - 1);
        let pixel = Vector2::new(along(column, size[0]), along(row, size[1]));
        let bearing = camera.unproject(&pixel).ok_or(TargetError::RimUnseen)?;
        let seen = normalised.project(&bearing).ok_or(TargetError::RimUnseen)?;
        for (axis, (at, index)) in [(seen.x, column), (seen.y, row)].into_iter().enumerate() {
            let (Some(inner_least), Some(inner_most)) = (inner.least.get_mut(axis), inner.most.get_mut(axis)) else {
                continue;
            };
            if index == 0 {
                *inner_least = inner_least.max(at);
            } else if index == GRID - 1 {
                *inner_most = inner_most.min(at);
            }
            let (Some(outer_least), Some(outer_most)) = (outer.least.get_mut(axis), outer.most.get_mut(axis)) else {
                continue;
            };
            *outer_least = outer_least.min(at);
            *outer_most = outer_most.max(at);
        }
    }
    let (inner, outer) = (inner.filling(size), outer.filling(size));
    let mut matrix = [0.0; 4];
    for (value, (inner, outer)) in matrix.iter_mut().zip(inner.into_iter().zip(outer)) {
        *value = inner * (1.0 - alpha) + outer * alpha;
    }
    projection.camera(matrix).ok_or(TargetError::RimUnseen)
}

/// A rectangle at distance 1.
struct Rectangle {
    least: [f64; 2],
    most: [f64; 2],
}

impl Rectangle {
    /// Returns fx, fy, cx, cy of the camera for which it fills an image of `size`.
    fn filling(&self, size: [f64; 2]) -> [f64; 4] {
        let ([left, top], [right, bottom]) = (self.least, self.most);
        let (fx, fy) = (size[0] / (right - left), size[1] / (bottom - top));
        [fx, fy, -fx * left, -fy * top]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::undistort::PixelMap;

    const SENSOR: Sensor = Sensor::new(346, 260);

    fn barrel() -> Camera<f64> {
        let parameters = [330.0, 331.0, 170.0, 131.0, -0.36, 0.14, 0.001, -0.0005];
        Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap()
    }

    #[test]
    fn alpha_zero_leaves_no_black_and_alpha_one_loses_nothing() {
        for projection in [TargetProjection::Pinhole, TargetProjection::Equidistant] {
            let full = optimal_matrix(&barrel(), projection, SENSOR, 0.0).unwrap();
            let all = optimal_matrix(&barrel(), projection, SENSOR, 1.0).unwrap();
            let back = PixelMap::new(&full, &barrel(), SENSOR);
            let there = PixelMap::new(&barrel(), &all, SENSOR);
            for (x, y) in (0..346).flat_map(|x| (0..260).map(move |y| (x, y))) {
                let [u, v] = back.get(x, y).unwrap();
                assert!(u > -1.0 && v > -1.0 && u < 346.0 && v < 260.0, "{projection:?} ({x}, {y}): {u}, {v}");
                assert!(there.get_on_sensor(x, y).is_some(), "{projection:?} ({x}, {y})");
            }
        }
    }

    #[test]
    fn an_undistorted_camera_does_not_change() {
        let camera = TargetProjection::Pinhole.camera([330.0, 331.0, 170.0, 131.0]).unwrap();
        assert_eq!(same_matrix(&camera, TargetProjection::Pinhole), Ok(camera));
        for alpha in [0.0, 0.4, 1.0] {
            let found = optimal_matrix(&camera, TargetProjection::Pinhole, SENSOR, alpha).unwrap();
            for (found, expected) in found.parameters().iter().zip(&camera.parameters()) {
                assert!((found - expected).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn a_field_of_view_too_wide_for_a_pinhole_is_refused() {
        let wide = [100.0, 100.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0];
        let wide: Camera<f64> = Camera::from_parameters(ModelKind::KannalaBrandt, &wide).unwrap();
        assert_eq!(optimal_matrix(&wide, TargetProjection::Pinhole, SENSOR, 1.0), Err(TargetError::RimUnseen));
        assert!(optimal_matrix(&wide, TargetProjection::Equidistant, SENSOR, 1.0).is_ok());
        assert!(same_matrix(&wide, TargetProjection::Pinhole).is_ok());
    }
}

//! The omnidirectional model of Mei: the unified model followed by radial and tangential distortion.
//!
//! **Parameters**: fx fy cx cy xi k1 k2 p1 p2, with xi > -1. OpenCV's `omnidir` without skew, Kalibr's
//! omni-radtan. The focal length on the axis is fx / (1 + xi). Without distortion it is
//! [`super::ucm`] with alpha = xi / (1 + xi) and focal lengths fx / (1 + xi).
//!
//! **Projection** of (X, Y, Z), with d = √(X² + Y² + Z²) and q = Z + ξ d:
//! ```text
//! x = X / q, y = Y / q                       s = x² + y²
//! u = x (1 + k1 s + k2 s²) + 2 p1 x y + p2 (s + 2 x²)        pixel x = fx u + cx
//! v = y (1 + k1 s + k2 s²) + 2 p2 x y + p1 (s + 2 y²)        pixel y = fy v + cy
//! ```
//! **Jacobian**: the Jacobian of (u, v) with respect to (x, y) as in [`super::radtan`], times the Jacobian of (x, y) as
//! in module `denominator` with q_s = ξ / 2 d, q_Z = 1 + ξ Z / d, q_ξ = d.
//!
//! **Domain**: q > 0, q_Z > 0 (Z > -ξ d for ξ ≤ 1, Z > -d / ξ for ξ > 1), and (x, y) in the domain of the distortion.
//!
//! **Unprojection**: (x, y) by damped Newton iteration as in `radtan`; then, with S = √(1 + (1 - ξ²) s),
//! ```text
//! bearing = ((S + ξ) x, (S + ξ) y, S - ξ s) / (1 + s)
//! ```
//! Source: C. Mei and P. Rives, "Single view point omnidirectional camera calibration from planar
//! grids", ICRA 2007; documentation of OpenCV's module `ccalib`, "Omnidirectional Camera Calibration";
//! Kalibr's wiki, "Supported models".

use nalgebra::{Matrix3x2, RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, parameter_names};
use super::denominator::{Denominator, distance_of};
use super::radtan::Radtan4;
use super::{CameraModel, MAX_COEFFICIENTS, MAX_PARAMETERS, Projection, Unprojection};
use crate::camera::expectation::{CoefficientEffect, Expectation};

/// Omnidirectional camera with xi k1 k2 p1 p2.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Omni<T> {
    xi: T,
    /// Distortion and camera matrix.
    plane: Radtan4<T>,
}

/// A bearing and the quantities that its derivatives need.
struct Lifted<T> {
    plane: Vector2<T>,
    bearing: Vector3<T>,
    denominator: Denominator<T, 1>,
}

impl<T: RealField + Copy> Omni<T> {
    fn denominator(&self, point: &Vector3<T>) -> Option<Denominator<T, 1>> {
        let across = point.xy().norm_squared();
        let square = across + point.z * point.z;
        let distance = distance_of(square)?;
        let denominator = Denominator {
            value: point.z + self.xi * distance,
            by_square: self.xi / (distance + distance),
            by_depth: T::one() + self.xi * point.z / distance,
            by_coefficients: [distance],
        };
        denominator.in_domain(across)
    }

    /// Returns (x, y) of a point and the denominator there.
    fn plane(&self, point: &Vector3<T>) -> Option<(Vector2<T>, Denominator<T, 1>)> {
        let denominator = self.denominator(point)?;
        let plane = denominator.image(point);
        self.plane.contains(&plane).then_some((plane, denominator))
    }

    fn lift(&self, image: &Vector2<T>) -> Option<Lifted<T>> {
        let plane = self.plane.undistort(image)?;
        let one = T::one();
        let square = plane.norm_squared();
        let radicand = one + (one - self.xi * self.xi) * square;
        // Written so that a NaN is rejected too.
        let positive = radicand > T::zero();
        if !positive {
            return None;
        }
        let root = radicand.sqrt();
        let scale = one / (one + square);
        let factor = scale * (root + self.xi);
        let bearing = Vector3::new(plane.x * factor, plane.y * factor, scale * (root - self.xi * square));
        // Rounding may move a bearing at the edge of the domain across it.
        let (_, denominator) = self.plane(&bearing)?;
        Some(Lifted { plane, bearing, denominator })
    }
}

impl<T: RealField + Copy> CameraModel<T> for Omni<T> {
    const NAME: &'static str = "omni";
    const PARAMETER_NAMES: &'static [&'static str] = parameter_names!["xi", "k1", "k2", "p1", "p2"];
    const EXPECTATION: Expectation = Expectation {
        effects: &[
            CoefficientEffect::Shape(1.0),
            CoefficientEffect::Radial(1),
            CoefficientEffect::Radial(2),
            CoefficientEffect::Free,
            CoefficientEffect::Free,
        ],
        fit_starts: &[&[1.0], &[]],
        usual: [&[0.4], &[1.2]],
    };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, [xi, k1, k2, p1, p2]) = CameraMatrix::split(parameters)?;
        let plane = Radtan4::from_parameters(&matrix.parameters(&[k1, k2, p1, p2]))?;
        (xi > -T::one()).then_some(Self { xi, plane })
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        let [k1, k2, p1, p2, ..]: [T; MAX_COEFFICIENTS] = self.plane.coefficients();
        self.plane.matrix().parameters(&[self.xi, k1, k2, p1, p2])
    }

    fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
        let (plane, _) = self.plane(point)?;
        let radial = self.plane.radial_factor(plane.norm_squared());
        Some(self.plane.matrix().pixel(&self.plane.distort(&plane, &radial).image))
    }

    fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
        let (plane, denominator) = self.plane(point)?;
        let radial = self.plane.radial_factor(plane.norm_squared());
        let distorted = self.plane.distort(&plane, &radial);
        let by_plane = distorted.by_ideal();
        let image_by_point = by_plane * denominator.image_by_point(point);
        let by_xi = denominator.image_by_coefficients(&plane).map(|column| by_plane * column);
        let by_coefficients = by_xi.chain(Radtan4::by_coefficients(&plane, &radial));
        Some(self.plane.matrix().projection(&distorted.image, &image_by_point, by_coefficients))
    }

    fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
        Some(self.lift(&self.plane.matrix().image(pixel))?.bearing)
    }

    fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>> {
        let image = self.plane.matrix().image(pixel);
        let Lifted { plane, bearing, denominator } = self.lift(&image)?;
        let radial = self.plane.radial_factor(plane.norm_squared());
        let distorted = self.plane.distort(&plane, &radial);
        let by_plane = denominator.bearing_by_image(&bearing);
        let by_image: Matrix3x2<T> = Matrix3x2::from_columns(&[
            by_plane * distorted.solve(&Vector2::x()),
            by_plane * distorted.solve(&Vector2::y()),
        ]);
        let by_distortion = Radtan4::by_coefficients(&plane, &radial).map(|column| by_image * -column);
        let by_coefficients = denominator.bearing_by_coefficients(&bearing).chain(by_distortion);
        Some(self.plane.matrix().unprojection(&image, bearing, &by_image, by_coefficients))
    }
}

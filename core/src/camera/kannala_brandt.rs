//! The fisheye model of Kannala and Brandt, in OpenCV's form.
//!
//! **Parameters**: fx fy cx cy k1 k2 k3 k4.
//!
//! **Projection** of (X, Y, Z), with r = √(X² + Y²) and θ the angle to the optical axis:
//! ```text
//! θ = atan2(r, Z)
//! f(θ) = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)
//! u = f(θ) X / r        pixel x = fx u + cx
//! v = f(θ) Y / r        pixel y = fy v + cy
//! ```
//! **Jacobian** with respect to the point, with n = (X, Y) / r and ρ² = r² + Z²: the radial part is f'(θ) Z / ρ² along
//! n, the transverse part f(θ) / r, and ∂(u, v)/∂Z = -f'(θ) r / ρ² n.
//!
//! **Domain**: angles from 0 to the first maximum of f, less than 180°. If f still increases at 90°, points behind the
//! plane Z = 0 belong to it.
//!
//! **Unprojection**: safeguarded Newton iteration for θ in f(θ) = √(u² + v²), then bearing = (sin θ n, cos θ) with n =
//! (u, v) / √(u² + v²). Implicit derivatives: ∂θ/∂f = 1 / f'(θ), ∂θ/∂k_i = -θ^(2i+1) / f'(θ).
//!
//! Source: J. Kannala and S. S. Brandt, "A generic camera model and calibration method for
//! conventional, wide-angle, and fish-eye lenses", PAMI 28 (2006), eq. 6 without its asymmetric
//! terms; OpenCV documentation of `cv::fisheye`, which scales the leading term to 1.

use nalgebra::{Matrix3x2, RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, direction, is_off_axis, parameter_names};
use super::polynomial::RadialFunction;
use super::{CameraModel, MAX_PARAMETERS, PointJacobian, Projection, Unprojection};
use crate::camera::expectation::{CoefficientEffect, Expectation};

/// Fisheye camera with k1 k2 k3 k4.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KannalaBrandt<T> {
    matrix: CameraMatrix<T>,
    /// f(θ).
    radius: RadialFunction<T, 4>,
}

/// A point in cylindrical coordinates around the optical axis.
struct Cylindrical<T> {
    /// Unit vector from the axis to the point; (1, 0) on the axis.
    direction: Vector2<T>,
    /// Distance from the axis.
    radius: T,
    /// Angle to the axis.
    angle: T,
}

impl<T: RealField + Copy> KannalaBrandt<T> {
    fn cylindrical(&self, point: &Vector3<T>) -> Option<Cylindrical<T>> {
        let square = point.norm_squared();
        let radius = point.xy().norm();
        let angle = radius.atan2(point.z);
        if !(square > T::zero() && square.is_finite() && angle < self.radius.limit()) {
            return None;
        }
        let direction = if is_off_axis(angle) { point.xy() / radius } else { Vector2::x() };
        Some(Cylindrical { direction, radius, angle })
    }
}

/// Returns θ³, θ⁵, θ⁷, θ⁹: the derivatives of f(θ) with respect to k1 to k4.
fn by_coefficients<T: RealField + Copy>(angle: T) -> impl Iterator<Item = T> {
    let square = angle * angle;
    let third = angle * square;
    let fifth = third * square;
    let seventh = fifth * square;
    [third, fifth, seventh, seventh * square].into_iter()
}

impl<T: RealField + Copy> CameraModel<T> for KannalaBrandt<T> {
    const NAME: &'static str = "kannala-brandt";
    const PARAMETER_NAMES: &'static [&'static str] = parameter_names!["k1", "k2", "k3", "k4"];
    const EXPECTATION: Expectation = Expectation {
        effects: &[
            CoefficientEffect::Radial(1),
            CoefficientEffect::Radial(2),
            CoefficientEffect::Radial(3),
            CoefficientEffect::Radial(4),
        ],
        fit_starts: &[&[]],
        usual: [&[0.0], &[0.0]],
    };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, coefficients) = CameraMatrix::split(parameters)?;
        Some(Self { matrix, radius: RadialFunction::new::<5>(coefficients, T::pi()) })
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        self.matrix.parameters(self.radius.coefficients())
    }

    fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
        let Cylindrical { direction, angle, .. } = self.cylindrical(point)?;
        Some(self.matrix.pixel(&(direction * self.radius.value_and_slope(angle).0)))
    }

    fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
        let Cylindrical { direction, radius, angle } = self.cylindrical(point)?;
        let (value, slope) = self.radius.value_and_slope(angle);
        let slope_by_square = slope / point.norm_squared();
        let along = slope_by_square * point.z;
        let across = if is_off_axis(angle) { value / radius } else { along };
        let (x, y) = (direction.x, direction.y);
        let by_z = -slope_by_square * radius;
        let image_by_point = PointJacobian::new(
            along * x * x + across * y * y,
            (along - across) * x * y,
            by_z * x,
            (along - across) * x * y,
            along * y * y + across * x * x,
            by_z * y,
        );
        let by_coefficients = by_coefficients(angle).map(|factor| direction * factor);
        Some(self.matrix.projection(&(direction * value), &image_by_point, by_coefficients))
    }

    fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
        let image = self.matrix.image(pixel);
        let value = image.norm();
        let (sine, cosine) = self.radius.invert(value)?.sin_cos();
        let direction = direction(&image, value);
        Some(Vector3::new(direction.x * sine, direction.y * sine, cosine))
    }

    fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>> {
        let image = self.matrix.image(pixel);
        let value = image.norm();
        let angle = self.radius.invert(value)?;
        let (sine, cosine) = angle.sin_cos();
        let direction = direction(&image, value);
        let (x, y) = (direction.x, direction.y);
        let inverse_slope = T::one() / self.radius.value_and_slope(angle).1;
        let by_angle = Vector3::new(cosine * x, cosine * y, -sine);
        let by_value = by_angle * inverse_slope;
        let across = if is_off_axis(value) { sine / value } else { T::one() };
        let by_image = Matrix3x2::from([
            [by_value.x * x + across * y * y, by_value.y * x - across * x * y, by_value.z * x],
            [by_value.x * y - across * x * y, by_value.y * y + across * x * x, by_value.z * y],
        ]);
        let by_coefficients = by_coefficients(angle).map(|factor| by_value * -factor);
        let bearing = Vector3::new(x * sine, y * sine, cosine);
        Some(self.matrix.unprojection(&image, bearing, &by_image, by_coefficients))
    }
}

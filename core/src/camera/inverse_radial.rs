//! Inverse radial distortion: a polynomial from the distorted to the ideal image.
//!
//! **Parameters**: fx fy cx cy k1 k2 k3 k4 k5.
//!
//! **Unprojection** in closed form: with (u, v) = ((x - cx) / fx, (y - cy) / fy) and a² = u² + v²,
//! ```text
//! β = 1 + k1 a² + k2 a⁴ + k3 a⁶ + k4 a⁸ + k5 a¹⁰
//! bearing ∝ (β u, β v, 1)
//! ```
//! **Jacobian** of (β u, β v) with respect to (u, v): β I + 2 β' (u, v)(u, v)ᵀ with β' = ∂β/∂a².
//!
//! **Domain**: radii a from 0 to the first maximum of a β(a²), at most 100, and Z > 0.
//!
//! **Projection** of (X, Y, Z): safeguarded Newton iteration for a in a β(a²) = r with r = √(X² + Y²) / Z, then (u, v)
//! = a n with n = (X, Y) / (r Z). Implicit derivatives, with e the slope of a β(a²): 1 / e along n, a / r across,
//! ∂a/∂k_i = -a^(2i+1) / e.
//!
//! This is the model of the paper. k1 has the opposite sign of an ordinary radial k1; [`super::conversion`] converts
//! between the two.
//!
//! Source: P. Drap and J. Lefèvre, "An exact formula for calculating inverse radial lens
//! distortions", Sensors 16 (2016); K. Huang, Y. Wang and L. Kneip, "Dynamic event camera
//! calibration", IROS 2021, section III-C.

use nalgebra::{Matrix2, Matrix2x3, RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, bearing_through, direction, is_off_axis, parameter_names};
use super::polynomial::RadialFunction;
use super::{CameraModel, MAX_PARAMETERS, Projection, Unprojection};
use crate::camera::expectation::{CoefficientEffect, Expectation};

/// Largest radius in any domain.
const RADIUS_CAP: f64 = 100.0;

/// Inverse radial distortion with k1 k2 k3 k4 k5.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InverseRadial<T> {
    matrix: CameraMatrix<T>,
    /// a β(a²).
    radius: RadialFunction<T, 5>,
}

impl<T: RealField + Copy> InverseRadial<T> {
    /// Returns the camera matrix.
    pub(super) fn matrix(&self) -> &CameraMatrix<T> {
        &self.matrix
    }

    /// Returns the ideal radius as a function of the distorted one.
    pub(super) fn radius(&self) -> &RadialFunction<T, 5> {
        &self.radius
    }

    /// Returns the ideal image point and 1 / Z of a point in front of the camera.
    fn ideal(point: &Vector3<T>) -> Option<(Vector2<T>, T)> {
        let inverse_depth = T::one() / point.z;
        (point.z > T::zero()).then_some((point.xy() * inverse_depth, inverse_depth))
    }

    /// Returns the image point of a pixel and its squared radius, if it is in the domain.
    fn image(&self, pixel: &Vector2<T>) -> Option<(Vector2<T>, T)> {
        let image = self.matrix.image(pixel);
        let square = image.norm_squared();
        (square < self.radius.limit() * self.radius.limit()).then_some((image, square))
    }
}

impl<T: RealField + Copy> CameraModel<T> for InverseRadial<T> {
    const NAME: &'static str = "inverse-radial";
    const PARAMETER_NAMES: &'static [&'static str] = parameter_names!["k1", "k2", "k3", "k4", "k5"];
    const EXPECTATION: Expectation = Expectation {
        effects: &[
            CoefficientEffect::Radial(1),
            CoefficientEffect::Radial(2),
            CoefficientEffect::Radial(3),
            CoefficientEffect::Radial(4),
            CoefficientEffect::Radial(5),
        ],
        fit_starts: &[&[]],
        usual: [&[0.0], &[0.3]],
    };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, coefficients) = CameraMatrix::split(parameters)?;
        Some(Self { matrix, radius: RadialFunction::new::<6>(coefficients, nalgebra::convert(RADIUS_CAP)) })
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        self.matrix.parameters(self.radius.coefficients())
    }

    fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
        let (ideal, _) = Self::ideal(point)?;
        let ideal_radius = ideal.norm();
        let radius = self.radius.invert(ideal_radius)?;
        Some(self.matrix.pixel(&(direction(&ideal, ideal_radius) * radius)))
    }

    fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
        let (ideal, inverse_depth) = Self::ideal(point)?;
        let ideal_radius = ideal.norm();
        let radius = self.radius.invert(ideal_radius)?;
        let along = T::one() / self.radius.value_and_slope(radius).1;
        let direction = direction(&ideal, ideal_radius);
        let across = if is_off_axis(ideal_radius) { radius / ideal_radius } else { T::one() };
        let (x, y) = (direction.x, direction.y);
        let mixed = (along - across) * x * y;
        let by_x = Vector2::new(along * x * x + across * y * y, mixed) * inverse_depth;
        let by_y = Vector2::new(mixed, along * y * y + across * x * x) * inverse_depth;
        let image_by_point = Matrix2x3::from_columns(&[by_x, by_y, -(by_x * ideal.x + by_y * ideal.y)]);
        let square = radius * radius;
        let by_k1 = direction * (-along * radius * square);
        let by_k2 = by_k1 * square;
        let by_k3 = by_k2 * square;
        let by_k4 = by_k3 * square;
        let by_k5 = by_k4 * square;
        let by_coefficients = [by_k1, by_k2, by_k3, by_k4, by_k5].into_iter();
        Some(self.matrix.projection(&(direction * radius), &image_by_point, by_coefficients))
    }

    fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
        let (image, square) = self.image(pixel)?;
        Some(bearing_through(&(image * self.radius.factor(square).0)).0)
    }

    fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>> {
        let (image, square) = self.image(pixel)?;
        let (factor, slope) = self.radius.factor(square);
        let (bearing, by_ideal) = bearing_through(&(image * factor));
        let (x, y) = (image.x, image.y);
        let twice_slope = slope + slope;
        let mixed = twice_slope * x * y;
        let ideal_by_image = Matrix2::new(factor + twice_slope * x * x, mixed, mixed, factor + twice_slope * y * y);
        let by_k1 = by_ideal * (image * square);
        let by_k2 = by_k1 * square;
        let by_k3 = by_k2 * square;
        let by_k4 = by_k3 * square;
        let by_k5 = by_k4 * square;
        let by_coefficients = [by_k1, by_k2, by_k3, by_k4, by_k5].into_iter();
        Some(self.matrix.unprojection(&image, bearing, &(by_ideal * ideal_by_image), by_coefficients))
    }
}

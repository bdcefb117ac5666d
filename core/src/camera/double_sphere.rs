//! The double sphere camera model: projection onto two spheres in turn.
//!
//! **Parameters**: fx fy cx cy xi alpha, with xi > -1. With xi = 0 it is [`super::ucm`]. The focal
//! length on the axis is fx / (1 + xi).
//!
//! **Projection** of (X, Y, Z):
//! ```text
//! d₁ = √(X² + Y² + Z²)     Z' = Z + ξ d₁
//! d₂ = √(X² + Y² + Z'²)    q = α d₂ + (1 - α) Z'
//! u = X / q                pixel x = fx u + cx
//! v = Y / q                pixel y = fy v + cy
//! ```
//! **Jacobian**: see module `denominator`. With g = α Z' / d₂ + 1 - α: q_s = α / 2 d₂ + g ξ / 2 d₁, q_Z = g (1 + ξ Z /
//! d₁), q_ξ = g d₁, q_α = d₂ - Z'.
//!
//! **Domain**: d₁ + ξ Z > 0, so that the first sphere is one-to-one (always true for ξ ≤ 1), g > 0 and q > 0, as for
//! `ucm` at the point (X, Y, Z'). For |ξ| ≤ 1 and with the w of `ucm` this is Z > -(ξ (1 - w²) + w √(1 - ξ² (1 - w²)))
//! d₁; for ξ ≥ 0 the w₂ of the paper excludes slightly more.
//!
//! **Unprojection** in closed form: `ucm` gives the unit vector (S u, S v, C) towards (X, Y, Z'); its angle to the axis
//! and the bearing's angle differ by the arc sine of e = ξ S ρ, ρ² = u² + v²:
//! ```text
//! bearing = (S (√(1 - e²) + ξ C) u, S (√(1 - e²) + ξ C) v, C √(1 - e²) - ξ S² ρ²)
//! ```
//! Source: V. Usenko, N. Demmel and D. Cremers, "The double sphere camera model", 3DV 2018, section 3. The domain for
//! ξ > 1 and this form of the bearing, which has no cancellation on the axis, are derived here.

use nalgebra::{RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, parameter_names};
use super::denominator::{Denominator, distance_of, through_denominator};
use super::ucm::{Lifted, lift};
use super::{CameraModel, MAX_PARAMETERS, Projection, Unprojection};
use crate::camera::expectation::{CoefficientEffect, Expectation};

/// Double sphere camera with xi and alpha.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DoubleSphere<T> {
    matrix: CameraMatrix<T>,
    xi: T,
    alpha: T,
}

impl<T: RealField + Copy> DoubleSphere<T> {
    fn denominator(&self, point: &Vector3<T>) -> Option<Denominator<T, 2>> {
        let (xi, alpha) = (self.xi, self.alpha);
        let rest = T::one() - alpha;
        let across = point.xy().norm_squared();
        let first_square = across + point.z * point.z;
        let first = distance_of(first_square)?;
        let depth = point.z + xi * first;
        let depth_by_depth = T::one() + xi * point.z / first;
        let second = (across + depth * depth).sqrt();
        if !(depth_by_depth > T::zero() && second > T::zero()) {
            return None;
        }
        let by_depth = alpha * depth / second + rest;
        let denominator = Denominator {
            value: alpha * second + rest * depth,
            by_square: alpha / (second + second) + by_depth * xi / (first + first),
            by_depth: by_depth * depth_by_depth,
            by_coefficients: [by_depth * first, second - depth],
        };
        denominator.in_domain(across)
    }

    /// Returns the bearing of an image point and the denominator there.
    fn bearing(&self, image: &Vector2<T>) -> Option<(Vector3<T>, Denominator<T, 2>)> {
        let square = image.norm_squared();
        let Lifted { factor, depth } = lift(self.alpha, square)?;
        let between = self.xi * factor;
        let radicand = T::one() - between * between * square;
        // Written so that a NaN is rejected too.
        let positive = radicand > T::zero();
        if !positive {
            return None;
        }
        let root = radicand.sqrt();
        let factor_there = factor * (root + self.xi * depth);
        let depth_there = depth * root - between * factor * square;
        let bearing = Vector3::new(image.x * factor_there, image.y * factor_there, depth_there);
        Some((bearing, self.denominator(&bearing)?))
    }
}

impl<T: RealField + Copy> CameraModel<T> for DoubleSphere<T> {
    const NAME: &'static str = "double-sphere";
    const PARAMETER_NAMES: &'static [&'static str] = parameter_names!["xi", "alpha"];
    // At xi = 0, where the model equals `ucm`, xi and alpha change the camera equally, so the cost has a local minimum
    // on each side and a fit cannot move from one to the other.
    const EXPECTATION: Expectation = Expectation {
        effects: &[CoefficientEffect::Shape(0.0), CoefficientEffect::Free],
        fit_starts: &[&[-0.2, 0.5], &[0.4, 0.5]],
        usual: [&[-0.2, 0.4], &[-0.2, 0.6]],
    };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, [xi, alpha]) = CameraMatrix::split(parameters)?;
        (xi > -T::one()).then_some(Self { matrix, xi, alpha })
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        self.matrix.parameters(&[self.xi, self.alpha])
    }

    through_denominator!();
}

//! The unified camera model with one coefficient: a sphere seen from a point on the axis.
//!
//! **Parameters**: fx fy cx cy alpha. Ordinary lenses have an alpha from 0 (pinhole) to 1 (orthographic); other values
//! are defined too.
//!
//! **Projection** of (X, Y, Z):
//! ```text
//! d = √(X² + Y² + Z²)     q = α d + (1 - α) Z
//! u = X / q               pixel x = fx u + cx
//! v = Y / q               pixel y = fy v + cy
//! ```
//! **Jacobian**: see module `denominator`, with q_s = α / 2 d, q_Z = α Z / d + 1 - α, q_α = d - Z.
//!
//! **Domain**: q > 0 and q_Z > 0, which is Z > -w d with w = α / (1 - α) for α ≤ ½ and (1 - α) / α for α > ½. Points
//! behind the plane Z = 0 belong to it for 0 < α < 1. The image extends to the limit of module `denominator` for α ≤ ½,
//! and to u² + v² < 1 / (2 α - 1) for α > ½.
//!
//! **Unprojection** in closed form: with ρ² = u² + v² and S = √(1 + (1 - 2 α) ρ²)
//! ```text
//! bearing = ((α + (1 - α) S) u, (α + (1 - α) S) v, S - α (1 - α) ρ²) / (1 + (1 - α)² ρ²)
//! ```
//! (the usual form, (u, v, (1 - α² ρ²) / (α S + 1 - α)) normalised, is 0/0 on a circle when α is not
//! between 0 and 1).
//!
//! Source: C. Geyer and K. Daniilidis, "A unifying theory for central panoramic systems", ECCV 2000; V. Usenko, N.
//! Demmel and D. Cremers, "The double sphere camera model", 3DV 2018, section 2.2, for this parametrisation. The
//! bearing is derived from the triangle of the sphere's centre, the point on the sphere and the projection centre on
//! the axis.

use nalgebra::{RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, parameter_names};
use super::denominator::{Denominator, distance_of, through_denominator};
use super::{CameraModel, MAX_PARAMETERS, Projection, Unprojection};
use crate::camera::expectation::{CoefficientEffect, Expectation};

/// Unified camera with alpha.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ucm<T> {
    matrix: CameraMatrix<T>,
    alpha: T,
}

/// Conversion of an image point to a bearing: `bearing ∝ (factor u, factor v, depth)`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lifted<T> {
    /// Ratio of bearing to image point.
    pub factor: T,
    /// z of the bearing.
    pub depth: T,
}

/// Returns the bearing, of length 1, of image points with the squared radius `square`; `None` beyond the largest image.
pub(super) fn lift<T: RealField + Copy>(alpha: T, square: T) -> Option<Lifted<T>> {
    let one = T::one();
    let rest = one - alpha;
    let radicand = one + (rest - alpha) * square;
    if !(radicand > T::zero() && radicand.is_finite()) {
        return None;
    }
    let root = radicand.sqrt();
    let scale = one / (one + rest * rest * square);
    Some(Lifted { factor: scale * (alpha + rest * root), depth: scale * (root - alpha * rest * square) })
}

impl<T: RealField + Copy> Ucm<T> {
    fn denominator(&self, point: &Vector3<T>) -> Option<Denominator<T, 1>> {
        let alpha = self.alpha;
        let rest = T::one() - alpha;
        let across = point.xy().norm_squared();
        let square = across + point.z * point.z;
        let distance = distance_of(square)?;
        let denominator = Denominator {
            value: alpha * distance + rest * point.z,
            by_square: alpha / (distance + distance),
            by_depth: alpha * point.z / distance + rest,
            by_coefficients: [distance - point.z],
        };
        denominator.in_domain(across)
    }

    /// Returns the bearing of an image point and the denominator there.
    fn bearing(&self, image: &Vector2<T>) -> Option<(Vector3<T>, Denominator<T, 1>)> {
        let Lifted { factor, depth } = lift(self.alpha, image.norm_squared())?;
        let bearing = Vector3::new(image.x * factor, image.y * factor, depth);
        Some((bearing, self.denominator(&bearing)?))
    }
}

impl<T: RealField + Copy> CameraModel<T> for Ucm<T> {
    const NAME: &'static str = "ucm";
    const PARAMETER_NAMES: &'static [&'static str] = parameter_names!["alpha"];
    const EXPECTATION: Expectation =
        Expectation { effects: &[CoefficientEffect::Free], fit_starts: &[&[0.5]], usual: [&[0.3], &[0.6]] };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, [alpha]) = CameraMatrix::split(parameters)?;
        Some(Self { matrix, alpha })
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        self.matrix.parameters(&[self.alpha])
    }

    through_denominator!();
}

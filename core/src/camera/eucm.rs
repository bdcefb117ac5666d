//! The enhanced unified camera model: an ellipsoid seen from a point on the axis.
//!
//! **Parameters**: fx fy cx cy alpha beta, with beta > 0. With beta = 1 it is [`super::ucm`].
//!
//! **Projection** of (X, Y, Z):
//! ```text
//! d = √(β (X² + Y²) + Z²)     q = α d + (1 - α) Z
//! u = X / q                   pixel x = fx u + cx
//! v = Y / q                   pixel y = fy v + cy
//! ```
//! **Jacobian**: see module `denominator`, with q_s = α β / 2 d, q_Z = α Z / d + 1 - α, q_α = d - Z, q_β = α (X² + Y²)
//! / 2 d.
//!
//! **Domain**: q > 0 and q_Z > 0, which is Z > -w d with w = α / (1 - α) for α ≤ ½ and (1 - α) / α for α > ½. The image
//! extends to the limit of module `denominator` for α ≤ ½, and to u² + v² < 1 / β (2 α - 1) for α > ½.
//!
//! **Unprojection** in closed form: with X, Y, u and v multiplied by √β it is the unified model. The bearing is that of
//! `ucm` with ρ² = β (u² + v²), normalised.
//!
//! Source: B. Khomutenko, G. Garcia and P. Martinet, "An enhanced unified camera model", RA-L 1
//! (2016); V. Usenko, N. Demmel and D. Cremers, "The double sphere camera model", 3DV 2018, section
//! 2.3.

use nalgebra::{RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, parameter_names};
use super::denominator::{Denominator, distance_of, through_denominator};
use super::ucm::{Lifted, lift};
use super::{CameraModel, MAX_PARAMETERS, Projection, Unprojection};
use crate::camera::expectation::{CoefficientEffect, Expectation};

/// Enhanced unified camera with alpha and beta.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eucm<T> {
    matrix: CameraMatrix<T>,
    alpha: T,
    beta: T,
}

impl<T: RealField + Copy> Eucm<T> {
    fn denominator(&self, point: &Vector3<T>) -> Option<Denominator<T, 2>> {
        let (alpha, beta) = (self.alpha, self.beta);
        let rest = T::one() - alpha;
        let across = point.xy().norm_squared();
        let square = beta * across + point.z * point.z;
        let distance = distance_of(square)?;
        let half = alpha / (distance + distance);
        let denominator = Denominator {
            value: alpha * distance + rest * point.z,
            by_square: half * beta,
            by_depth: alpha * point.z / distance + rest,
            by_coefficients: [distance - point.z, half * across],
        };
        denominator.in_domain(across)
    }

    /// Returns the bearing of an image point and the denominator there.
    fn bearing(&self, image: &Vector2<T>) -> Option<(Vector3<T>, Denominator<T, 2>)> {
        let Lifted { factor, depth } = lift(self.alpha, self.beta * image.norm_squared())?;
        let along = Vector3::new(image.x * factor, image.y * factor, depth);
        let bearing = along / along.norm();
        Some((bearing, self.denominator(&bearing)?))
    }
}

impl<T: RealField + Copy> CameraModel<T> for Eucm<T> {
    const NAME: &'static str = "eucm";
    const PARAMETER_NAMES: &'static [&'static str] = parameter_names!["alpha", "beta"];
    const EXPECTATION: Expectation = Expectation {
        effects: &[CoefficientEffect::Free, CoefficientEffect::Shape(1.0)],
        fit_starts: &[&[0.5, 1.0]],
        usual: [&[0.3, 1.0], &[0.6, 1.0]],
    };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, [alpha, beta]) = CameraMatrix::split(parameters)?;
        (beta > T::zero()).then_some(Self { matrix, alpha, beta })
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        self.matrix.parameters(&[self.alpha, self.beta])
    }

    through_denominator!();
}

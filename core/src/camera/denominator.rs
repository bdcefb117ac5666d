//! Models that divide a point by a function of it: `(u, v) = (X, Y) / q(s, Z)` with s = X² + Y².
//!
//! q is homogeneous of degree 1 in (X, Y, Z), so a point and its multiples have the same image. Subscripts are
//! derivatives.
//!
//! **Jacobian** with respect to the point: `I / q - (u, v)ᵀ (2 X q_s, 2 Y q_s, q_Z) / q`; with respect to a coefficient
//! c: `-(u, v) q_c / q`.
//!
//! **Domain**: on the unit sphere, at the angle θ to the axis, the image radius is sin θ / q. The slope of this radius
//! with respect to θ is q_Z / q², because q = 2 s q_s + Z q_Z by Euler's theorem. The image is therefore one-to-one
//! from the axis up to the angle at which q or q_Z reaches 0. Images farther than 100 from the axis, where q is nearly
//! 0, are excluded.
//!
//! **Jacobian of the bearing** b with respect to the image. It follows from that slope in the direction of the radius,
//! and from q across it:
//! ```text
//! ∂(b_x, b_y)/∂(u, v) = q I + q (2 q_s b_z / q_Z - 1) (b_x, b_y)ᵀ (b_x, b_y)
//! ∂b_z/∂(u, v)        = -q² / q_Z (b_x, b_y)
//! ∂b/∂c               = q_c / q_Z (b_x b_z, b_y b_z, -b_x² - b_y²)
//! ```
//! These equations are valid on the axis, too.

use nalgebra::{Matrix3x2, RealField, Vector2, Vector3};

use super::camera_matrix::CameraMatrix;
use super::{PointJacobian, Projection, Unprojection};

/// Largest distance of an image point from the axis.
const IMAGE_RADIUS_CAP: f64 = 100.0;

/// Returns the distance whose square is given; `None` for zero, infinity and NaN.
pub(super) fn distance_of<T: RealField + Copy>(square: T) -> Option<T> {
    (square > T::zero() && square.is_finite()).then(|| square.sqrt())
}

/// q at one point, with its derivatives with respect to s, Z and `N` coefficients.
#[derive(Clone, Copy, Debug)]
pub(super) struct Denominator<T, const N: usize> {
    /// q.
    pub value: T,
    /// q_s.
    pub by_square: T,
    /// q_Z.
    pub by_depth: T,
    /// q_c.
    pub by_coefficients: [T; N],
}

impl<T: RealField + Copy, const N: usize> Denominator<T, N> {
    /// Returns the denominator if a point with this squared distance from the axis is in the domain.
    pub fn in_domain(self, square: T) -> Option<Self> {
        let cap = nalgebra::convert::<f64, T>(IMAGE_RADIUS_CAP * IMAGE_RADIUS_CAP);
        let one_to_one = self.value > T::zero() && self.by_depth > T::zero();
        (one_to_one && square < cap * self.value * self.value).then_some(self)
    }

    /// Returns the image point of `point`.
    pub fn image(&self, point: &Vector3<T>) -> Vector2<T> {
        point.xy() / self.value
    }

    /// Returns the derivative of the image point with respect to the point.
    pub fn image_by_point(&self, point: &Vector3<T>) -> PointJacobian<T> {
        let scale = T::one() / self.value;
        let image = point.xy() * scale;
        let twice = self.by_square + self.by_square;
        let along = image * scale;
        let (by_x, by_y) = (twice * point.x, twice * point.y);
        PointJacobian::new(
            scale - along.x * by_x,
            -along.x * by_y,
            -along.x * self.by_depth,
            -along.y * by_x,
            scale - along.y * by_y,
            -along.y * self.by_depth,
        )
    }

    /// Returns the derivatives of the image point with respect to the coefficients.
    pub fn image_by_coefficients(&self, image: &Vector2<T>) -> impl Iterator<Item = Vector2<T>> {
        let along = -image / self.value;
        self.by_coefficients.into_iter().map(move |by_coefficient| along * by_coefficient)
    }

    /// Returns the derivative of the `bearing`, at which the denominator was computed, with respect to the image point.
    pub fn bearing_by_image(&self, bearing: &Vector3<T>) -> Matrix3x2<T> {
        let (x, y) = (bearing.x, bearing.y);
        let ratio = self.value / self.by_depth;
        let mixed = (self.by_square + self.by_square) * bearing.z * ratio - self.value;
        let down = -self.value * ratio;
        Matrix3x2::from([
            [self.value + mixed * x * x, mixed * x * y, down * x],
            [mixed * x * y, self.value + mixed * y * y, down * y],
        ])
    }

    /// Returns the derivatives of the `bearing`, at which the denominator was computed, with respect to the
    /// coefficients.
    pub fn bearing_by_coefficients(&self, bearing: &Vector3<T>) -> impl Iterator<Item = Vector3<T>> {
        let outwards = Vector3::new(bearing.x * bearing.z, bearing.y * bearing.z, -bearing.xy().norm_squared());
        let outwards = outwards / self.by_depth;
        self.by_coefficients.into_iter().map(move |by_coefficient| outwards * by_coefficient)
    }

    /// Returns the pixel of `point` with its derivatives.
    pub fn projection(&self, matrix: &CameraMatrix<T>, point: &Vector3<T>) -> Projection<T> {
        let image = self.image(point);
        matrix.projection(&image, &self.image_by_point(point), self.image_by_coefficients(&image))
    }

    /// Returns the `bearing` of an image point, at which the denominator was computed, with its derivatives.
    pub fn unprojection(&self, matrix: &CameraMatrix<T>, image: &Vector2<T>, bearing: Vector3<T>) -> Unprojection<T> {
        let by_image = self.bearing_by_image(&bearing);
        matrix.unprojection(image, bearing, &by_image, self.bearing_by_coefficients(&bearing))
    }
}

/// Implements the projections of a model that has a `matrix`, a method `denominator` of a point, and a method `bearing`
/// of an image point that also returns the denominator.
macro_rules! through_denominator {
    () => {
        fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
            Some(self.matrix.pixel(&self.denominator(point)?.image(point)))
        }

        fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
            Some(self.denominator(point)?.projection(&self.matrix, point))
        }

        fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
            Some(self.bearing(&self.matrix.image(pixel))?.0)
        }

        fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>> {
            let image = self.matrix.image(pixel);
            let (bearing, denominator) = self.bearing(&image)?;
            Some(denominator.unprojection(&self.matrix, &image, bearing))
        }
    };
}

pub(super) use through_denominator;

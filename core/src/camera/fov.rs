//! The field-of-view model of Devernay and Faugeras, known as ATAN.
//!
//! **Parameters**: fx fy cx cy w, with 0 ≤ w < π, in radians; w = 0 is a pinhole camera. The focal
//! length on the axis is fx 2 tan(w/2) / w.
//!
//! **Projection** of (X, Y, Z), with r = √(X² + Y²) and a = 2 tan(w/2):
//! ```text
//! φ = atan2(a r, Z)
//! u = φ / w  X / r        pixel x = fx u + cx
//! v = φ / w  Y / r        pixel y = fy v + cy
//! ```
//! **Jacobian** with respect to the point, with n = (X, Y) / r and D = a² r² + Z²: the radial part is a Z / (w D) along
//! n, the transverse part φ / (w r), and ∂(u, v)/∂Z = -a r / (w D) n. With respect to w: n (w / sin w  sin 2φ / 2 - φ)
//! / w².
//!
//! **Domain**: all points except those on the axis behind the camera (φ < π); for w = 0 those with Z > 0.
//!
//! **Unprojection** in closed form: φ = w √(u² + v²), bearing ∝ (sin φ n, a cos φ) with
//! n = (u, v) / √(u² + v²).
//!
//! Source: F. Devernay and O. Faugeras, "Straight lines have to be straight", Machine Vision and
//! Applications 13 (2001), section 4.2; V. Usenko, N. Demmel and D. Cremers, "The double sphere camera
//! model", 3DV 2018, section 2.5, for points behind the camera.

use nalgebra::{Matrix3x2, RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, direction, is_off_axis, parameter_names};
use super::{CameraModel, MAX_PARAMETERS, PointJacobian, Projection, Unprojection};
use crate::camera::expectation::{CoefficientEffect, Expectation};

/// Field-of-view camera with w.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fov<T> {
    matrix: CameraMatrix<T>,
    w: T,
    /// 2 tan(w/2).
    a: T,
}

/// A point in cylindrical coordinates around the optical axis, and its image radius.
struct Imaged<T> {
    /// Unit vector from the axis to the point; (1, 0) on the axis.
    direction: Vector2<T>,
    /// Distance of the point from the axis.
    radius: T,
    /// Distance of the image point from the axis.
    image_radius: T,
    /// Derivative of `image_radius` with respect to `radius` / Z.
    by_radius: T,
}

/// A bearing and the quantities that its derivatives need.
struct Seen<T> {
    direction: Vector2<T>,
    image_radius: T,
    bearing: Vector3<T>,
    /// Sine of the angle to the axis.
    sine: T,
    /// Derivative of the angle to the axis with respect to `image_radius`.
    angle_by_image: T,
}

impl<T: RealField + Copy> Fov<T> {
    /// Computes the image radius of a point, φ / w.
    fn imaged(&self, point: &Vector3<T>) -> Option<Imaged<T>> {
        let radius = point.xy().norm();
        let zero = T::zero();
        let reach = self.a * radius;
        let square = reach * reach + point.z * point.z;
        let in_front = point.z > zero;
        let inside = square > zero && radius.is_finite() && square.is_finite();
        if !inside || !(in_front || (self.w > zero && reach > zero)) {
            return None;
        }
        let direction = direction(&point.xy(), radius);
        if self.w > zero {
            let image_radius = reach.atan2(point.z) / self.w;
            Some(Imaged { direction, radius, image_radius, by_radius: self.a / (self.w * square) })
        } else {
            Some(Imaged { direction, radius, image_radius: radius / point.z, by_radius: T::one() / square })
        }
    }

    fn seen(&self, image: &Vector2<T>) -> Option<Seen<T>> {
        let image_radius = image.norm();
        if !image_radius.is_finite() {
            return None;
        }
        let angle = self.w * image_radius;
        let below_half_turn = angle < T::pi();
        if !below_half_turn {
            return None;
        }
        let direction = direction(image, image_radius);
        // `radius` and `depth` are r and Z up to a common factor. `turn` is r² + Z² times the derivative of the angle
        // to the axis with respect to the image radius.
        let (radius, depth, turn) = if self.w > T::zero() {
            let (sine, cosine) = angle.sin_cos();
            (sine, self.a * cosine, self.a * self.w)
        } else {
            (image_radius, T::one(), T::one())
        };
        let square = radius * radius + depth * depth;
        let length = square.sqrt();
        let (sine, cosine) = (radius / length, depth / length);
        let bearing = Vector3::new(direction.x * sine, direction.y * sine, cosine);
        let behind = cosine < T::zero() && sine <= T::zero();
        let seen = Seen { direction, image_radius, bearing, sine, angle_by_image: turn / square };
        (square.is_finite() && !behind).then_some(seen)
    }

    /// Returns the derivative of the image radius with respect to w.
    fn by_w(&self, image_radius: T) -> T {
        let angle = self.w * image_radius;
        // The two terms of the closed form nearly cancel when w and φ are small.
        let small = T::default_epsilon().sqrt().sqrt();
        if self.w < small && angle < small {
            let (two_thirds, sixth) = (nalgebra::convert::<f64, T>(2.0 / 3.0), nalgebra::convert::<f64, T>(1.0 / 6.0));
            return angle * (sixth - two_thirds * image_radius * image_radius);
        }
        let (sine, cosine) = angle.sin_cos();
        (self.w / self.w.sin() * sine * cosine - angle) / (self.w * self.w)
    }
}

impl<T: RealField + Copy> CameraModel<T> for Fov<T> {
    const NAME: &'static str = "fov";
    const PARAMETER_NAMES: &'static [&'static str] = parameter_names!["w"];
    const EXPECTATION: Expectation =
        Expectation { effects: &[CoefficientEffect::Free], fit_starts: &[&[0.9]], usual: [&[0.4], &[0.9]] };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, [w]) = CameraMatrix::split(parameters)?;
        let half = (w * nalgebra::convert::<f64, T>(0.5)).tan();
        let a = half + half;
        // The tangent becomes negative if w equals π at the precision of `T`.
        (w >= T::zero() && w < T::pi() && a >= T::zero()).then_some(Self { matrix, w, a })
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        self.matrix.parameters(&[self.w])
    }

    fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
        let Imaged { direction, image_radius, .. } = self.imaged(point)?;
        Some(self.matrix.pixel(&(direction * image_radius)))
    }

    fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
        let Imaged { direction, radius, image_radius, by_radius } = self.imaged(point)?;
        let along = by_radius * point.z;
        let across = if is_off_axis(image_radius) { image_radius / radius } else { along };
        let (x, y) = (direction.x, direction.y);
        let by_z = -by_radius * radius;
        let mixed = (along - across) * x * y;
        let image_by_point = PointJacobian::new(
            along * x * x + across * y * y,
            mixed,
            by_z * x,
            mixed,
            along * y * y + across * x * x,
            by_z * y,
        );
        let by_w = core::iter::once(direction * self.by_w(image_radius));
        Some(self.matrix.projection(&(direction * image_radius), &image_by_point, by_w))
    }

    fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
        Some(self.seen(&self.matrix.image(pixel))?.bearing)
    }

    fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>> {
        let image = self.matrix.image(pixel);
        let Seen { direction, image_radius, bearing, sine, angle_by_image } = self.seen(&image)?;
        let (x, y) = (direction.x, direction.y);
        let by_angle = Vector3::new(bearing.z * x, bearing.z * y, -sine);
        let along = by_angle * angle_by_image;
        let across = if is_off_axis(image_radius) { sine / image_radius } else { angle_by_image };
        let by_image = Matrix3x2::from([
            [along.x * x + across * y * y, along.y * x - across * x * y, along.z * x],
            [along.x * y - across * x * y, along.y * y + across * x * x, along.z * y],
        ]);
        let by_w = core::iter::once(along * -self.by_w(image_radius));
        Some(self.matrix.unprojection(&image, bearing, &by_image, by_w))
    }
}

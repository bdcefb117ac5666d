//! The camera matrix that all models share: `pixel = (fx u + cx, fy v + cy)`.
//!
//! (u, v) is the image point after distortion, on the plane at distance 1. The functions here turn
//! a model's derivatives of and by the image point into those of and by the pixel, and put the
//! columns of fx, fy, cx, cy in front of the coefficients'.

use nalgebra::{Matrix3x2, RealField, SMatrix, Vector2, Vector3};

use super::{MAX_COEFFICIENTS, MAX_PARAMETERS, PointJacobian, Projection, Unprojection};

/// Names of the camera matrix' parameters.
macro_rules! parameter_names {
    ($($coefficient:literal),* $(,)?) => {
        &["fx", "fy", "cx", "cy", $($coefficient),*]
    };
}
pub(super) use parameter_names;

/// Focal lengths and principal point, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CameraMatrix<T> {
    fx: T,
    fy: T,
    cx: T,
    cy: T,
}

impl<T: RealField + Copy> CameraMatrix<T> {
    /// Splits a parameter vector into the camera matrix and exactly `N` coefficients.
    ///
    /// `None` if the length is wrong, a value is not finite or a focal length is not positive.
    pub fn split<const N: usize>(parameters: &[T]) -> Option<(Self, [T; N])> {
        let (&[fx, fy, cx, cy], coefficients) = parameters.split_first_chunk()?;
        let coefficients: [T; N] = coefficients.try_into().ok()?;
        let usable = parameters.iter().all(|value| value.is_finite()) && fx > T::zero() && fy > T::zero();
        usable.then_some((Self { fx, fy, cx, cy }, coefficients))
    }

    /// The parameter vector with these coefficients.
    pub fn parameters(&self, coefficients: &[T]) -> heapless::Vec<T, MAX_PARAMETERS> {
        let mut parameters = heapless::Vec::new();
        for &value in self.values().iter().chain(coefficients.iter().take(MAX_COEFFICIENTS)) {
            // Cannot be full: 4 + MAX_COEFFICIENTS values.
            let _ = parameters.push(value);
        }
        parameters
    }

    /// The pixel of an image point.
    pub fn pixel(&self, image: &Vector2<T>) -> Vector2<T> {
        Vector2::new(self.fx * image.x + self.cx, self.fy * image.y + self.cy)
    }

    /// The image point of a pixel.
    pub fn image(&self, pixel: &Vector2<T>) -> Vector2<T> {
        Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy)
    }

    /// The largest distance of a pixel of a `width` × `height` sensor from the axis, in the image plane.
    pub fn corner_radius(&self, width: u16, height: u16) -> T {
        let far = |size: u16, centre: T, focal: T| {
            let last = nalgebra::convert::<f64, T>(f64::from(size.saturating_sub(1)));
            centre.abs().max((last - centre).abs()) / focal
        };
        far(width, self.cx, self.fx).hypot(far(height, self.cy, self.fy))
    }

    /// fx, fy, cx, cy.
    pub fn values(&self) -> [T; 4] {
        [self.fx, self.fy, self.cx, self.cy]
    }

    /// Focal lengths, in pixels.
    pub fn focal_lengths(&self) -> Vector2<T> {
        Vector2::new(self.fx, self.fy)
    }

    /// Completes the derivatives of an image point to those of the pixel.
    pub fn projection(
        &self,
        image: &Vector2<T>,
        image_by_point: &PointJacobian<T>,
        image_by_coefficients: &[Vector2<T>; MAX_COEFFICIENTS],
    ) -> Projection<T> {
        let (zero, one) = (T::zero(), T::one());
        let focal = self.focal_lengths();
        let scaled = |column: &Vector2<T>| [focal.x * column.x, focal.y * column.y];
        let [c1, c2, c3, c4, c5, c6, c7, c8] = image_by_coefficients;
        let [[ux, vx], [uy, vy], [uz, vz]] = image_by_point.data.0;
        Projection {
            pixel: self.pixel(image),
            by_point: PointJacobian::new(
                focal.x * ux,
                focal.x * uy,
                focal.x * uz,
                focal.y * vx,
                focal.y * vy,
                focal.y * vz,
            ),
            by_parameters: SMatrix::from([
                [image.x, zero],
                [zero, image.y],
                [one, zero],
                [zero, one],
                scaled(c1),
                scaled(c2),
                scaled(c3),
                scaled(c4),
                scaled(c5),
                scaled(c6),
                scaled(c7),
                scaled(c8),
            ]),
        }
    }

    /// Completes the derivatives of a bearing by the image point to those by pixel and parameters.
    pub fn unprojection(
        &self,
        image: &Vector2<T>,
        bearing: Vector3<T>,
        bearing_by_image: &Matrix3x2<T>,
        bearing_by_coefficients: &[Vector3<T>; MAX_COEFFICIENTS],
    ) -> Unprojection<T> {
        let [by_u, by_v] = bearing_by_image.data.0;
        let by_x = Vector3::from(by_u) / self.fx;
        let by_y = Vector3::from(by_v) / self.fy;
        let [c1, c2, c3, c4, c5, c6, c7, c8] = *bearing_by_coefficients;
        Unprojection {
            bearing,
            by_pixel: Matrix3x2::from([by_x.into(), by_y.into()]),
            by_parameters: SMatrix::from([
                (by_x * -image.x).into(),
                (by_y * -image.y).into(),
                (-by_x).into(),
                (-by_y).into(),
                c1.into(),
                c2.into(),
                c3.into(),
                c4.into(),
                c5.into(),
                c6.into(),
                c7.into(),
                c8.into(),
            ]),
        }
    }
}

/// The bearing through (x, y, 1), and its derivative by (x, y).
pub(super) fn bearing_through<T: RealField + Copy>(ideal: &Vector2<T>) -> (Vector3<T>, Matrix3x2<T>) {
    let scale = T::one() / (T::one() + ideal.norm_squared()).sqrt();
    let (x, y) = (ideal.x * scale, ideal.y * scale);
    let one = T::one();
    let bearing = Vector3::new(x, y, scale);
    let by_ideal = Matrix3x2::new(one - x * x, -x * y, -x * y, one - y * y, -x * scale, -y * scale) * scale;
    (bearing, by_ideal)
}

/// Whether a radius or angle is large enough to have a direction.
///
/// Below ε² the pixel is that of the axis to any precision, while squares begin to underflow.
pub(super) fn is_off_axis<T: RealField + Copy>(radius: T) -> bool {
    radius > T::default_epsilon() * T::default_epsilon()
}

/// The unit vector along `vector` of length `radius`; (1, 0) on the axis.
pub(super) fn direction<T: RealField + Copy>(vector: &Vector2<T>, radius: T) -> Vector2<T> {
    if is_off_axis(radius) { vector / radius } else { Vector2::x() }
}

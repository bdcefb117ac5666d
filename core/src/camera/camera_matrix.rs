//! The camera matrix that all models share: `pixel = (fx u + cx, fy v + cy)`.
//!
//! (u, v) is the image point after distortion, in the plane at distance 1. The functions here convert a model's
//! derivatives with respect to the image point into derivatives with respect to the pixel, and prepend the columns of
//! fx, fy, cx, cy to the columns of the coefficients.

use nalgebra::{Matrix3x2, RealField, SMatrix, Vector2, Vector3};

use super::{MAX_COEFFICIENTS, MAX_PARAMETERS, PointJacobian, Projection, Unprojection};
use crate::sensor::Sensor;

/// Names of a model's parameters: the camera matrix, then the coefficients.
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
    /// Returns `None` if the length is wrong, a value is not finite or a focal length is not positive.
    pub fn split<const N: usize>(parameters: &[T]) -> Option<(Self, [T; N])> {
        let (&[fx, fy, cx, cy], coefficients) = parameters.split_first_chunk()?;
        let coefficients: [T; N] = coefficients.try_into().ok()?;
        let usable = parameters.iter().all(|value| value.is_finite()) && fx > T::zero() && fy > T::zero();
        usable.then_some((Self { fx, fy, cx, cy }, coefficients))
    }

    /// Returns the parameter vector with these coefficients.
    pub fn parameters<'a>(&self, coefficients: impl IntoIterator<Item = &'a T>) -> heapless::Vec<T, MAX_PARAMETERS> {
        let mut parameters = heapless::Vec::new();
        for value in self.values().into_iter().chain(coefficients.into_iter().copied().take(MAX_COEFFICIENTS)) {
            // Cannot be full: 4 + MAX_COEFFICIENTS values.
            let _ = parameters.push(value);
        }
        parameters
    }

    /// Returns the pixel of an image point.
    #[inline]
    pub fn pixel(&self, image: &Vector2<T>) -> Vector2<T> {
        Vector2::new(self.fx * image.x + self.cx, self.fy * image.y + self.cy)
    }

    /// Returns the image point of a pixel.
    #[inline]
    pub fn image(&self, pixel: &Vector2<T>) -> Vector2<T> {
        Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy)
    }

    /// Returns the largest distance of a pixel of `sensor` from the axis, in the image plane.
    pub fn corner_radius(&self, sensor: Sensor) -> T {
        let far = |size: u16, centre: T, focal: T| {
            let last = nalgebra::convert::<f64, T>(f64::from(size.saturating_sub(1)));
            centre.abs().max((last - centre).abs()) / focal
        };
        far(sensor.width, self.cx, self.fx).hypot(far(sensor.height, self.cy, self.fy))
    }

    /// Returns fx, fy, cx, cy.
    pub fn values(&self) -> [T; 4] {
        [self.fx, self.fy, self.cx, self.cy]
    }

    /// Converts the derivatives of an image point to derivatives of the pixel.
    #[inline(always)]
    pub fn projection(
        &self,
        image: &Vector2<T>,
        image_by_point: &PointJacobian<T>,
        image_by_coefficients: impl Iterator<Item = Vector2<T>>,
    ) -> Projection<T> {
        let (zero, one) = (T::zero(), T::one());
        let scaled = |[u, v]: [T; 2]| [self.fx * u, self.fy * v];
        let [by_x, by_y, by_z] = image_by_point.data.0;
        let mut by_parameters = [[zero; 2]; MAX_PARAMETERS];
        let by_matrix = [[image.x, zero], [zero, image.y], [one, zero], [zero, one]];
        fill(&mut by_parameters, by_matrix, image_by_coefficients.map(|column| scaled(column.into())));
        Projection {
            pixel: self.pixel(image),
            by_point: PointJacobian::from([scaled(by_x), scaled(by_y), scaled(by_z)]),
            by_parameters: SMatrix::from(by_parameters),
        }
    }

    /// Converts the derivatives of a bearing with respect to the image point to those with respect to pixel and
    /// parameters.
    #[inline(always)]
    pub fn unprojection(
        &self,
        image: &Vector2<T>,
        bearing: Vector3<T>,
        bearing_by_image: &Matrix3x2<T>,
        bearing_by_coefficients: impl Iterator<Item = Vector3<T>>,
    ) -> Unprojection<T> {
        let [by_u, by_v] = bearing_by_image.data.0;
        let by_x = Vector3::from(by_u) / self.fx;
        let by_y = Vector3::from(by_v) / self.fy;
        let mut by_parameters = [[T::zero(); 3]; MAX_PARAMETERS];
        let by_matrix = [(by_x * -image.x).into(), (by_y * -image.y).into(), (-by_x).into(), (-by_y).into()];
        fill(&mut by_parameters, by_matrix, bearing_by_coefficients.map(Into::into));
        Unprojection {
            bearing,
            by_pixel: Matrix3x2::from([by_x.into(), by_y.into()]),
            by_parameters: SMatrix::from(by_parameters),
        }
    }
}

/// Writes the columns of fx, fy, cx, cy and then the columns of the coefficients into `columns`.
#[inline(always)]
fn fill<T: Copy, const R: usize>(
    columns: &mut [[T; R]; MAX_PARAMETERS],
    by_matrix: [[T; R]; 4],
    by_coefficients: impl Iterator<Item = [T; R]>,
) {
    let [fx, fy, cx, cy, coefficients @ ..] = columns;
    [*fx, *fy, *cx, *cy] = by_matrix;
    for (slot, column) in coefficients.iter_mut().zip(by_coefficients) {
        *slot = column;
    }
}

/// Returns the bearing through (x, y, 1), and its derivative with respect to (x, y).
#[inline]
pub(super) fn bearing_through<T: RealField + Copy>(ideal: &Vector2<T>) -> (Vector3<T>, Matrix3x2<T>) {
    let scale = T::one() / (T::one() + ideal.norm_squared()).sqrt();
    let (x, y) = (ideal.x * scale, ideal.y * scale);
    let one = T::one();
    let bearing = Vector3::new(x, y, scale);
    let by_ideal = Matrix3x2::new(one - x * x, -x * y, -x * y, one - y * y, -x * scale, -y * scale) * scale;
    (bearing, by_ideal)
}

/// Returns `true` if a radius or angle is large enough to define a direction.
///
/// Below ε² the pixel equals the principal point at any precision, while squares begin to underflow.
pub(super) fn is_off_axis<T: RealField + Copy>(radius: T) -> bool {
    radius > T::default_epsilon() * T::default_epsilon()
}

/// Returns the unit vector along `vector` of length `radius`; (1, 0) on the axis.
#[inline]
pub(super) fn direction<T: RealField + Copy>(vector: &Vector2<T>, radius: T) -> Vector2<T> {
    if is_off_axis(radius) { vector / radius } else { Vector2::x() }
}

//! Radial and tangential distortion: the Brown-Conrady model in OpenCV's form.
//!
//! **Parameters**: fx fy cx cy, then k1 k2 p1 p2 (`radtan4`), k1 k2 p1 p2 k3 (`radtan`) or k1 k2 p1 p2 k3 k4 k5 k6
//! (`radtan8`). One implementation covers all three; absent coefficients are 0.
//!
//! **Projection** of (X, Y, Z), Z > 0, with x = X / Z, y = Y / Z, s = x² + y²:
//! ```text
//! d(s) = (1 + k1 s + k2 s² + k3 s³) / (1 + k4 s + k5 s² + k6 s³)
//! u = x d + 2 p1 x y + p2 (s + 2 x²)        pixel x = fx u + cx
//! v = y d + 2 p2 x y + p1 (s + 2 y²)        pixel y = fy v + cy
//! ```
//! **Jacobian** with respect to (x, y), symmetric because (u, v) is the gradient of a potential; d' = ∂d/∂s:
//! ```text
//! u_x = d + 2 x² d' + 2 p1 y + 6 p2 x      u_y = v_x = 2 x y d' + 2 p1 x + 2 p2 y
//! v_y = d + 2 y² d' + 6 p1 y + 2 p2 x
//! ```
//! **Domain**: the disc s < s_max on which a bound guarantees that this Jacobian is positive definite, so that the
//! potential is strictly convex and (u, v) one-to-one. In polar coordinates and with q = (p2, p1), whose radial and
//! transverse parts are a and b, the Jacobian is `[[E + 6 r a, 2 r b], [2 r b, d + 2 r a]]` with E = d + 2 s d', the
//! slope of r d(r²). It is positive definite if E > 3 |q| (1 + s) from the axis to r: then E > 6 r |q|, and by
//! integration d > 3 |q| (1 + s/3) ≥ 2 √3 r |q|, for which the smallest determinant, at a = -|q|, is (E - 6 r |q|) (d -
//! 2 r |q|) > 0. The denominator of d must be positive, too. s_max is the smallest root of these polynomials in s, and
//! at most 10⁴ (89.4° from the axis).
//!
//! **Unprojection**: damped Newton iteration on (u, v), starting from the first terms of the inverse series. The Newton
//! direction always reduces the error because the Jacobian is positive definite; steps that leave the disc or do not
//! reduce the error are halved. Derivatives follow from the implicit function theorem: ∂(x, y)/∂(u, v) = J⁻¹ and ∂(x,
//! y)/∂k = -J⁻¹ ∂(u, v)/∂k.
//!
//! Source: D. C. Brown, "Close-range camera calibration" (1971); OpenCV documentation of `calib3d`,
//! section "Camera Calibration and 3D Reconstruction". The domain is derived above.

use nalgebra::{Matrix2, Matrix3x2, RealField, Vector2, Vector3};

use super::camera_matrix::{CameraMatrix, bearing_through, parameter_names};
use super::expectation::CoefficientEffect::{self, Free, Radial};
use super::expectation::Expectation;
use super::polynomial::{positive_until, product};
use super::{CameraModel, MAX_COEFFICIENTS, MAX_PARAMETERS, PointJacobian, Projection, Unprojection};

/// Radial and tangential distortion with k1 k2 p1 p2.
pub type Radtan4<T> = Radtan<T, 4>;
/// Radial and tangential distortion with k1 k2 p1 p2 k3.
pub type Radtan5<T> = Radtan<T, 5>;
/// Rational radial and tangential distortion with k1 k2 p1 p2 k3 k4 k5 k6.
pub type Radtan8<T> = Radtan<T, 8>;

/// Largest number of points tried in one unprojection.
const MAX_TRIALS: usize = 256;

/// Largest x² + y² in any domain.
const SQUARED_RADIUS_CAP: f64 = 1e4;

/// Radial and tangential distortion with the first `N` of k1 k2 p1 p2 k3 k4 k5 k6; `N` is 4, 5 or 8.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Radtan<T, const N: usize> {
    matrix: CameraMatrix<T>,
    /// k1 k2 p1 p2 k3 k4 k5 k6; 0 from the `N`-th on.
    coefficients: [T; MAX_COEFFICIENTS],
    /// First coefficients of the series 1 + b1 s + b2 s² that roughly inverts d, where s = u² + v².
    start: [T; 2],
    /// s_max of the module documentation.
    squared_radius_limit: T,
    /// Upper bound of u² + v² in the domain.
    squared_image_limit: T,
}

/// A number of distortion coefficients.
#[derive(Clone, Copy, Debug)]
pub struct Coefficients<const N: usize>;

/// The numbers of coefficients that define a model; other instances of [`Radtan`] are not cameras.
pub trait Named {
    /// Name of the model.
    const MODEL: &'static str;
    /// Names of the parameters.
    const PARAMETERS: &'static [&'static str];
    /// Effect of each coefficient.
    const EFFECTS: &'static [CoefficientEffect];
}

impl Named for Coefficients<4> {
    const MODEL: &'static str = "radtan4";
    const PARAMETERS: &'static [&'static str] = parameter_names!["k1", "k2", "p1", "p2"];
    const EFFECTS: &'static [CoefficientEffect] = &[Radial(1), Radial(2), Free, Free];
}

impl Named for Coefficients<5> {
    const MODEL: &'static str = "radtan";
    const PARAMETERS: &'static [&'static str] = parameter_names!["k1", "k2", "p1", "p2", "k3"];
    const EFFECTS: &'static [CoefficientEffect] = &[Radial(1), Radial(2), Free, Free, Radial(3)];
}

impl Named for Coefficients<8> {
    const MODEL: &'static str = "radtan8";
    const PARAMETERS: &'static [&'static str] = parameter_names!["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
    const EFFECTS: &'static [CoefficientEffect] =
        &[Radial(1), Radial(2), Free, Free, Radial(3), Radial(1), Radial(2), Radial(3)];
}

/// The radial factor at one point.
pub(super) struct RadialFactor<T> {
    /// d(s).
    factor: T,
    /// ∂d/∂s.
    slope: T,
    /// 1 over the denominator of d.
    inverse_denominator: T,
}

/// The distorted image point and its symmetric Jacobian with respect to (x, y).
pub(super) struct Distorted<T> {
    pub(super) image: Vector2<T>,
    u_x: T,
    u_y: T,
    v_y: T,
}

impl<T: RealField + Copy> Distorted<T> {
    fn determinant(&self) -> T {
        self.u_x * self.v_y - self.u_y * self.u_y
    }

    fn trace(&self) -> T {
        self.u_x + self.v_y
    }

    /// Returns J, the Jacobian with respect to (x, y).
    pub(super) fn by_ideal(&self) -> Matrix2<T> {
        Matrix2::new(self.u_x, self.u_y, self.u_y, self.v_y)
    }

    /// Returns J⁻¹ times a vector.
    #[inline]
    pub(super) fn solve(&self, right: &Vector2<T>) -> Vector2<T> {
        let inverse_determinant = T::one() / self.determinant();
        Vector2::new(
            (self.v_y * right.x - self.u_y * right.y) * inverse_determinant,
            (self.u_x * right.y - self.u_y * right.x) * inverse_determinant,
        )
    }
}

/// State of the Newton iteration.
struct Iterate<T> {
    ideal: Vector2<T>,
    squared_error: T,
    step: Vector2<T>,
    /// `true` if `ideal + step` is as accurate as `T` allows.
    converged: bool,
}

impl<T: RealField + Copy, const N: usize> Radtan<T, N> {
    fn new(matrix: CameraMatrix<T>, coefficients: [T; MAX_COEFFICIENTS]) -> Self {
        let [k1, k2, p1, p2, _, k4, k5, _] = coefficients;
        // d = 1 + slope s + curvature s² + …
        let slope = k1 - k4;
        let curvature = k2 - k5 - slope * k4;
        let three = nalgebra::convert::<f64, T>(3.0);
        let start = [-slope, three * slope * slope - curvature];
        let limit = domain(coefficients);
        let unlimited =
            Self { matrix, coefficients, start, squared_radius_limit: limit, squared_image_limit: T::zero() };
        // Radial distortion increases up to the edge of the disc; tangential distortion is at most 3 |q| s long.
        let image_limit = limit.sqrt() * unlimited.radial_factor(limit).factor + three * p1.hypot(p2) * limit;
        Self { squared_image_limit: image_limit * image_limit, ..unlimited }
    }

    /// Returns the same camera without tangential distortion.
    pub(super) fn radial_part(&self) -> Self {
        let [k1, k2, _, _, k3, k4, k5, k6] = self.coefficients;
        Self::new(self.matrix, [k1, k2, T::zero(), T::zero(), k3, k4, k5, k6])
    }

    /// Returns k1 k2 p1 p2 k3 k4 k5 k6; absent coefficients are 0.
    pub(super) fn coefficients(&self) -> [T; MAX_COEFFICIENTS] {
        self.coefficients
    }

    /// Returns the camera matrix.
    pub(super) fn matrix(&self) -> &CameraMatrix<T> {
        &self.matrix
    }

    /// Returns d and its slope at a squared radius.
    #[inline]
    pub(super) fn radial_factor(&self, square: T) -> RadialFactor<T> {
        let [k1, k2, _, _, k3, k4, k5, k6] = self.coefficients;
        let one = T::one();
        let (two, three) = (nalgebra::convert::<f64, T>(2.0), nalgebra::convert::<f64, T>(3.0));
        let numerator = one + square * (k1 + square * (k2 + square * k3));
        let numerator_slope = k1 + square * (two * k2 + three * square * k3);
        if N < MAX_COEFFICIENTS {
            return RadialFactor { factor: numerator, slope: numerator_slope, inverse_denominator: one };
        }
        let denominator = one + square * (k4 + square * (k5 + square * k6));
        let denominator_slope = k4 + square * (two * k5 + three * square * k6);
        let inverse_denominator = one / denominator;
        let factor = numerator * inverse_denominator;
        let slope = (numerator_slope - factor * denominator_slope) * inverse_denominator;
        RadialFactor { factor, slope, inverse_denominator }
    }

    /// Returns the distorted image point of (x, y), whose radial factor is `radial`.
    #[inline]
    pub(super) fn distort(&self, ideal: &Vector2<T>, radial: &RadialFactor<T>) -> Distorted<T> {
        let [_, _, p1, p2, ..] = self.coefficients;
        let (x, y) = (ideal.x, ideal.y);
        let (two, three) = (nalgebra::convert::<f64, T>(2.0), nalgebra::convert::<f64, T>(3.0));
        let square = x * x + y * y;
        let tangential = two * (p2 * x + p1 * y);
        let factor = radial.factor + tangential;
        let twice_slope = two * radial.slope;
        Distorted {
            image: Vector2::new(x * factor + p2 * square, y * factor + p1 * square),
            u_x: radial.factor + twice_slope * x * x + two * (p1 * y + three * p2 * x),
            u_y: twice_slope * x * y + two * (p1 * x + p2 * y),
            v_y: radial.factor + twice_slope * y * y + two * (three * p1 * y + p2 * x),
        }
    }

    /// Returns the derivatives of (u, v) with respect to the `N` coefficients.
    #[inline]
    pub(super) fn by_coefficients(ideal: &Vector2<T>, radial: &RadialFactor<T>) -> impl Iterator<Item = Vector2<T>> {
        let (x, y) = (ideal.x, ideal.y);
        let two = nalgebra::convert::<f64, T>(2.0);
        let square = ideal.norm_squared();
        let by_k1 = ideal * (square * radial.inverse_denominator);
        let by_k2 = by_k1 * square;
        let by_k3 = by_k2 * square;
        [
            by_k1,
            by_k2,
            Vector2::new(two * x * y, square + two * y * y),
            Vector2::new(square + two * x * x, two * x * y),
            by_k3,
            by_k1 * -radial.factor,
            by_k2 * -radial.factor,
            by_k3 * -radial.factor,
        ]
        .into_iter()
        .take(N)
    }

    /// Returns (x, y) of a point and 1 / Z, if the point is in the domain.
    fn ideal(&self, point: &Vector3<T>) -> Option<(Vector2<T>, T)> {
        let inverse_depth = T::one() / point.z;
        let ideal = Vector2::new(point.x * inverse_depth, point.y * inverse_depth);
        (point.z > T::zero() && self.contains(&ideal)).then_some((ideal, inverse_depth))
    }

    /// Returns `true` if (x, y) is in the domain.
    #[inline]
    pub(super) fn contains(&self, ideal: &Vector2<T>) -> bool {
        ideal.norm_squared() < self.squared_radius_limit
    }

    /// Returns the ideal radius that radial distortion maps to `distorted`, and the slope of the map there.
    ///
    /// Only for cameras without tangential distortion.
    pub(super) fn undistort_radius(&self, distorted: T) -> Option<(T, T)> {
        let ideal = self.undistort(&Vector2::new(distorted, T::zero()))?;
        let radial = self.radial_factor(ideal.norm_squared());
        Some((ideal.x, self.distort(&ideal, &radial).u_x))
    }

    /// Returns the (x, y) in the domain that is distorted to `image`.
    pub(super) fn undistort(&self, image: &Vector2<T>) -> Option<Vector2<T>> {
        let size = image.norm_squared();
        let within_reach = size < self.squared_image_limit;
        if !within_reach {
            return None;
        }
        let half = nalgebra::convert::<f64, T>(0.5);
        let [b1, b2] = self.start;
        let series = image * (T::one() + size * (b1 + size * b2));
        let start =
            if self.contains(&series) { series } else { image * (half * (self.squared_radius_limit / size).sqrt()) };
        let mut current = self.iterate(image, start);
        let mut step = current.step;
        for _ in 0..MAX_TRIALS {
            if current.converged {
                return Some(current.ideal + current.step).filter(|ideal| self.contains(ideal));
            }
            let trial = current.ideal + step;
            if self.contains(&trial) {
                let next = self.iterate(image, trial);
                if next.squared_error < current.squared_error {
                    step = next.step;
                    current = next;
                    continue;
                }
            }
            step *= half;
        }
        None
    }

    /// Computes the Newton step from `ideal` towards the point that is distorted to `image`.
    #[inline]
    fn iterate(&self, image: &Vector2<T>, ideal: Vector2<T>) -> Iterate<T> {
        let distorted = self.distort(&ideal, &self.radial_factor(ideal.norm_squared()));
        let error = image - distorted.image;
        let step = distorted.solve(&error);
        // The error after a step is about step² |F''| / 2 λ, with λ the smallest eigenvalue of the Jacobian, at least
        // determinant / trace. Near a fold F'' is of order 1; where the image is stretched, F'' / λ is of order 1.
        let precision = T::default_epsilon() * nalgebra::convert(0.01);
        let (trace, determinant) = (distorted.trace(), distorted.determinant());
        let converged = step.norm_squared() * trace <= precision * determinant.min(trace);
        Iterate { ideal, squared_error: error.norm_squared(), step, converged }
    }
}

/// Returns s_max of the module documentation; 0 if the model cannot be inverted even at the axis.
fn domain<T: RealField + Copy>(coefficients: [T; MAX_COEFFICIENTS]) -> T {
    let [k1, k2, p1, p2, k3, k4, k5, k6] = coefficients;
    let (zero, one) = (T::zero(), T::one());
    let (two, three) = (nalgebra::convert::<f64, T>(2.0), nalgebra::convert::<f64, T>(3.0));
    let cap = nalgebra::convert::<f64, T>(SQUARED_RADIUS_CAP);
    let numerator = [one, k1, k2, k3];
    let denominator = [one, k4, k5, k6];
    // s times the derivatives of numerator and denominator.
    let numerator_slope = [zero, k1, two * k2, three * k3];
    let denominator_slope = [zero, k4, two * k5, three * k6];
    let squared: [T; 7] = product(&denominator, &denominator);
    let bound = three * p1.hypot(p2);
    // (E - 3 |q| (1 + s)) times the squared denominator.
    let mut margin: [T; 8] = product(&squared, &[-bound, -bound]);
    let value: [T; 8] = product(&numerator, &denominator);
    let rise: [T; 8] = product(&numerator_slope, &denominator);
    let fall: [T; 8] = product(&numerator, &denominator_slope);
    for (slot, ((value, rise), fall)) in margin.iter_mut().zip(value.into_iter().zip(rise).zip(fall)) {
        *slot += value + two * (rise - fall);
    }
    positive_until(&margin, cap).min(positive_until(&denominator, cap))
}

impl<T: RealField + Copy, const N: usize> CameraModel<T> for Radtan<T, N>
where
    Coefficients<N>: Named,
{
    const NAME: &'static str = Coefficients::<N>::MODEL;
    const PARAMETER_NAMES: &'static [&'static str] = Coefficients::<N>::PARAMETERS;
    const EXPECTATION: Expectation =
        Expectation { effects: Coefficients::<N>::EFFECTS, fit_starts: &[&[]], usual: [&[0.0], &[-0.3]] };

    fn from_parameters(parameters: &[T]) -> Option<Self> {
        let (matrix, own) = CameraMatrix::split::<N>(parameters)?;
        let mut coefficients = [T::zero(); MAX_COEFFICIENTS];
        for (slot, coefficient) in coefficients.iter_mut().zip(own) {
            *slot = coefficient;
        }
        Some(Self::new(matrix, coefficients)).filter(|camera| camera.squared_radius_limit > T::zero())
    }

    fn parameters(&self) -> heapless::Vec<T, MAX_PARAMETERS> {
        self.matrix.parameters(self.coefficients.iter().take(N))
    }

    fn project(&self, point: &Vector3<T>) -> Option<Vector2<T>> {
        let (ideal, _) = self.ideal(point)?;
        let radial = self.radial_factor(ideal.norm_squared());
        Some(self.matrix.pixel(&self.distort(&ideal, &radial).image))
    }

    fn project_with_jacobians(&self, point: &Vector3<T>) -> Option<Projection<T>> {
        let (ideal, inverse_depth) = self.ideal(point)?;
        let radial = self.radial_factor(ideal.norm_squared());
        let Distorted { image, u_x, u_y, v_y } = self.distort(&ideal, &radial);
        let by_point =
            PointJacobian::new(u_x, u_y, -(u_x * ideal.x + u_y * ideal.y), u_y, v_y, -(u_y * ideal.x + v_y * ideal.y))
                * inverse_depth;
        Some(self.matrix.projection(&image, &by_point, Self::by_coefficients(&ideal, &radial)))
    }

    fn unproject(&self, pixel: &Vector2<T>) -> Option<Vector3<T>> {
        let ideal = self.undistort(&self.matrix.image(pixel))?;
        Some(bearing_through(&ideal).0)
    }

    fn unproject_with_jacobians(&self, pixel: &Vector2<T>) -> Option<Unprojection<T>> {
        let image = self.matrix.image(pixel);
        let ideal = self.undistort(&image)?;
        let radial = self.radial_factor(ideal.norm_squared());
        let distorted = self.distort(&ideal, &radial);
        let (bearing, by_ideal) = bearing_through(&ideal);
        let by_image: Matrix3x2<T> = Matrix3x2::from_columns(&[
            by_ideal * distorted.solve(&Vector2::x()),
            by_ideal * distorted.solve(&Vector2::y()),
        ]);
        let by_coefficients = Self::by_coefficients(&ideal, &radial).map(|column| by_image * -column);
        Some(self.matrix.unprojection(&image, bearing, &by_image, by_coefficients))
    }
}

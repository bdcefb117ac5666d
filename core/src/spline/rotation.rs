//! Exponential and logarithm of SO(3) and the right Jacobian, accurate down to angle zero.
//!
//! Rotation vectors `φ = θ a` are in radians. Formulae: J. Solà et al., *A micro Lie theory for state estimation in
//! robotics*, equations 132, 133, 143 and 144. Below half a radian, where the closed forms lose digits and most angles
//! of a spline lie, power series are summed to the precision of `f64`; this also avoids the trigonometric functions.

use nalgebra::{Matrix3, Quaternion, RealField, UnitQuaternion, Vector3, convert};

/// Squared angle below which the series are used.
const SERIES_LIMIT: f64 = 0.25;

/// Returns `Σ coefficients[k] x^k`.
fn polynomial<T: RealField + Copy>(coefficients: &[f64], x: T) -> T {
    coefficients.iter().rev().fold(T::zero(), |sum, &coefficient| sum * x + convert(coefficient))
}

/// `sin(θ)/θ` with `x = θ²`: alternating reciprocals of 1!, 3!, 5! …
const SINC: [f64; 7] =
    [1.0, -1.0 / 6.0, 1.0 / 120.0, -1.0 / 5040.0, 1.0 / 362_880.0, -1.0 / 39_916_800.0, 1.0 / 6_227_020_800.0];
/// `cos(θ)` with `x = θ²`: alternating reciprocals of 0!, 2!, 4! …
const COSINE: [f64; 8] = [
    1.0,
    -1.0 / 2.0,
    1.0 / 24.0,
    -1.0 / 720.0,
    1.0 / 40_320.0,
    -1.0 / 3_628_800.0,
    1.0 / 479_001_600.0,
    -1.0 / 87_178_291_200.0,
];
/// `(1 - cos θ)/θ²` with `x = θ²`: alternating reciprocals of 2!, 4!, 6! …
const VERSINE: [f64; 7] = [
    1.0 / 2.0,
    -1.0 / 24.0,
    1.0 / 720.0,
    -1.0 / 40_320.0,
    1.0 / 3_628_800.0,
    -1.0 / 479_001_600.0,
    1.0 / 87_178_291_200.0,
];
/// `(θ - sin θ)/θ³` with `x = θ²`: alternating reciprocals of 3!, 5!, 7! …
const CUBIC: [f64; 7] = [
    1.0 / 6.0,
    -1.0 / 120.0,
    1.0 / 5040.0,
    -1.0 / 362_880.0,
    1.0 / 39_916_800.0,
    -1.0 / 6_227_020_800.0,
    1.0 / 1_307_674_368_000.0,
];
/// `(1 - (θ/2) cot(θ/2))/θ²` with `x = θ²`: Bernoulli numbers `|B_2k|/(2k)!`.
const COTANGENT: [f64; 8] = [
    1.0 / 12.0,
    1.0 / 720.0,
    1.0 / 30_240.0,
    1.0 / 1_209_600.0,
    1.0 / 47_900_160.0,
    691.0 / 1_307_674_368_000.0,
    1.0 / 74_724_249_600.0,
    3617.0 / 10_670_622_842_880_000.0,
];

/// Returns `true` if the series are accurate for the squared angle `x`.
fn is_small<T: RealField + Copy>(x: T) -> bool {
    x < convert(SERIES_LIMIT)
}

/// Returns the cross product matrix: `skew(a) b = a × b`.
pub fn skew<T: RealField + Copy>(v: &Vector3<T>) -> Matrix3<T> {
    let zero = T::zero();
    Matrix3::new(zero, -v.z, v.y, v.z, zero, -v.x, -v.y, v.x, zero)
}

/// Returns the rotation by the rotation vector `phi` (radians).
pub fn exp<T: RealField + Copy>(phi: &Vector3<T>) -> UnitQuaternion<T> {
    let half = phi * convert::<f64, T>(0.5);
    let x = half.norm_squared();
    let (cosine, sinc) = if is_small(x) {
        (polynomial(&COSINE, x), polynomial(&SINC, x))
    } else {
        let angle = x.sqrt();
        let (sine, cosine) = angle.sin_cos();
        (cosine, sine / angle)
    };
    UnitQuaternion::new_unchecked(Quaternion::from_parts(cosine, half * sinc))
}

/// Returns the rotation vector of `rotation`, of length at most π (radians).
pub fn log<T: RealField + Copy>(rotation: &UnitQuaternion<T>) -> Vector3<T> {
    // q and -q are the same rotation; the one with w ≥ 0 has the short rotation vector.
    let sign = if rotation.w < T::zero() { -T::one() } else { T::one() };
    let cosine = rotation.w * sign;
    let vector = rotation.imag() * sign;
    let sine = vector.norm();
    // Down to the smallest sine, atan2(s, c)/s keeps all digits; below it the quotient is 1/c.
    let half_angle_by_sine =
        if sine > T::default_epsilon() * T::default_epsilon() { sine.atan2(cosine) / sine } else { cosine.recip() };
    vector * (half_angle_by_sine * convert(2.0))
}

/// Returns the right Jacobian: `exp(φ + ε) ≈ exp(φ) exp(J_r(φ) ε)`. Its transpose is the left Jacobian.
pub fn right_jacobian<T: RealField + Copy>(phi: &Vector3<T>) -> Matrix3<T> {
    let x = phi.norm_squared();
    let (linear, quadratic) = if is_small(x) {
        (polynomial(&VERSINE, x), polynomial(&CUBIC, x))
    } else {
        let angle = x.sqrt();
        let (sine, cosine) = angle.sin_cos();
        ((T::one() - cosine) / x, (angle - sine) / (x * angle))
    };
    quadratic_in_skew(phi, x, -linear, quadratic)
}

/// Returns the inverse of the right Jacobian: `log(exp(φ) exp(ε)) ≈ φ + J_r⁻¹(φ) ε`, for angles below 2π. Its transpose
/// is the inverse of the left Jacobian.
pub fn right_jacobian_inverse<T: RealField + Copy>(phi: &Vector3<T>) -> Matrix3<T> {
    let x = phi.norm_squared();
    let quadratic = if is_small(x) {
        polynomial(&COTANGENT, x)
    } else {
        let half = x.sqrt() * convert(0.5);
        let (sine, cosine) = half.sin_cos();
        (T::one() - half * cosine / sine) / x
    };
    quadratic_in_skew(phi, x, convert(0.5), quadratic)
}

/// Returns `I + linear [φ]× + quadratic [φ]×²` with `x = ‖φ‖²`, where `[φ]×² = φ φᵀ - ‖φ‖² I`.
fn quadratic_in_skew<T: RealField + Copy>(phi: &Vector3<T>, x: T, linear: T, quadratic: T) -> Matrix3<T> {
    let scaled = phi * quadratic;
    let turn = phi * linear;
    let diagonal = T::one() - quadratic * x;
    let (xy, xz, yz) = (scaled.x * phi.y, scaled.x * phi.z, scaled.y * phi.z);
    Matrix3::new(
        diagonal + scaled.x * phi.x,
        xy - turn.z,
        xz + turn.y,
        xy + turn.z,
        diagonal + scaled.y * phi.y,
        yz - turn.x,
        xz - turn.y,
        yz + turn.x,
        diagonal + scaled.z * phi.z,
    )
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, UnitVector3};
    use proptest::prelude::*;

    use super::*;

    /// Returns rotation vectors of any direction, with angles from 1e-12 to almost a full rotation.
    fn rotation_vector() -> impl Strategy<Value = Vector3<f64>> {
        let direction = [-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64]
            .prop_filter("direction", |v| v.iter().any(|x| x.abs() > 0.01));
        let angle =
            prop_oneof![0.0..6.0_f64, (-12.0..0.0_f64).prop_map(|power| 10.0_f64.powf(power)), Just(0.0), 0.49..0.51];
        (direction, angle).prop_map(|(direction, angle)| Vector3::from(direction).normalize() * angle)
    }

    /// Returns `Σ M^k/(k + offset)!`: with offset 0 the matrix exponential, with offset 1 and `M = -[φ]×` the right
    /// Jacobian.
    fn matrix_series(matrix: Matrix3<f64>, offset: i32) -> Matrix3<f64> {
        let mut term = Matrix3::identity();
        let mut sum = term;
        for k in 1..60 {
            term = term * matrix / f64::from(k + offset);
            sum += term;
        }
        sum
    }

    proptest! {
        #[test]
        fn exp_is_the_matrix_exponential(phi in rotation_vector()) {
            let rotation = exp(&phi);
            prop_assert!((rotation.norm() - 1.0).abs() < 1e-15);
            let difference = rotation.to_rotation_matrix().into_inner() - matrix_series(skew(&phi), 0);
            prop_assert!(difference.norm() < 2e-13);
        }

        #[test]
        fn log_undoes_exp_to_the_last_digits(phi in rotation_vector()) {
            prop_assume!(phi.norm() < 3.1);
            prop_assert!((log(&exp(&phi)) - phi).norm() <= 1e-14 * phi.norm());
            // The other quaternion of the same rotation.
            let other = UnitQuaternion::new_unchecked(-exp(&phi).into_inner());
            prop_assert!((log(&other) - phi).norm() <= 1e-14 * phi.norm());
        }

        #[test]
        fn right_jacobian_is_its_series(phi in rotation_vector()) {
            prop_assert!((right_jacobian(&phi) - matrix_series(-skew(&phi), 1)).norm() < 2e-13);
        }

        #[test]
        fn right_jacobian_inverse_is_its_inverse(phi in rotation_vector()) {
            let product = right_jacobian(&phi) * right_jacobian_inverse(&phi);
            prop_assert!((product - Matrix3::identity()).norm() < 1e-12);
        }

        #[test]
        fn right_jacobian_moves_the_exponential(phi in rotation_vector(), turn in rotation_vector()) {
            let turn = turn.normalize() * 1e-6;
            prop_assume!(turn.norm() > 0.0);
            let moved = log(&(exp(&phi).inverse() * exp(&(phi + turn))));
            prop_assert!((moved - right_jacobian(&phi) * turn).norm() < 1e-11);
        }

        #[test]
        fn errors_in_single_precision_are_a_few_roundings(phi in rotation_vector()) {
            prop_assume!(phi.norm() < 3.1);
            let single = phi.map(|x| x as f32);
            let phi = single.map(f64::from);
            prop_assert!((log(&exp(&single)).map(f64::from) - phi).norm() <= 1e-6 * phi.norm());
            prop_assert!((right_jacobian(&single).map(f64::from) - right_jacobian(&phi)).norm() < 3e-6);
            prop_assert!((right_jacobian_inverse(&single).map(f64::from) - right_jacobian_inverse(&phi)).norm() < 1e-5);
        }
    }

    #[test]
    fn log_of_half_a_turn_has_length_pi() {
        let axis = UnitVector3::new_normalize(Vector3::new(1.0, -2.0, 0.5));
        let half_turn = UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI);
        assert!((log(&half_turn).norm() - std::f64::consts::PI).abs() < 1e-15);
    }

    #[test]
    fn the_skew_matrix_is_the_cross_product() {
        let (a, b) = (Vector3::new(1.0, 2.0, 3.0), Vector3::new(-4.0, 0.5, 7.0));
        assert_eq!(skew(&a) * b, a.cross(&b));
        assert!((exp(&a).to_rotation_matrix().matrix() - Rotation3::new(a).matrix()).norm() < 1e-14);
    }
}

//! Rotation curves as normalised sums of quaternions: `q(u) = Σ N_i(u) q_i / ‖Σ N_i(u) q_i‖`
//! (Kang and Park, *Cubic spline algorithms for orientation interpolation*, 1999).
//!
//! Control points need not have unit length: their lengths act as weights. Neighbours must lie in the same half of the
//! sphere, because `q` and `-q` are the same rotation but not the same control point: see [`align_signs`].

use nalgebra::{Matrix3, Quaternion, RealField, UnitQuaternion, convert};

use super::rotation::skew;
use super::{Basis, MAX_ORDER, RotationMotion, RotationSample};

/// Flips signs of quaternions so that each has an angle of at most 90° in R⁴ to the previous one. The rotations stay
/// the same.
pub fn align_signs<T: RealField + Copy>(quaternions: &mut [Quaternion<T>]) {
    let Some(first) = quaternions.first() else { return };
    let mut before = *first;
    for quaternion in quaternions {
        if quaternion.dot(&before) < T::zero() {
            *quaternion = -*quaternion;
        }
        before = *quaternion;
    }
}

/// Returns the point at `basis` of the curve with the control points `control` (all of them).
///
/// Returns `None` if there are too few control points, or if their weighted sum vanishes (opposite quaternions cancel)
/// or is not finite.
pub fn evaluate<T: RealField + Copy>(basis: &Basis<T>, control: &[Quaternion<T>]) -> Option<RotationSample<T>> {
    let control = basis.select(control)?;
    let zero = Quaternion::new(T::zero(), T::zero(), T::zero(), T::zero());
    let mut sum = zero;
    let mut derivative = zero;
    let mut magnitude = T::zero();
    for ((point, &value), &slope) in control.iter().zip(&basis.value).zip(&basis.first_derivative) {
        sum += *point * value;
        derivative += *point * slope;
        magnitude += point.norm_squared() * value;
    }
    // The weights sum to 1, so the squared length of the sum is at most `magnitude`. NaN is rejected.
    let norm_squared = sum.norm_squared();
    if !(norm_squared > magnitude * T::default_epsilon() && norm_squared.is_finite()) {
        return None;
    }
    let norm_reciprocal = norm_squared.sqrt().recip();
    let rotation = sum * norm_reciprocal;
    // A change dq of the sum rotates the result by 2 vec(q* dq)/‖sum‖; the real part of q* dq only changes the length.
    // With dq = N_i q_i (0, δ/2) that is N_i/‖sum‖ vec((q* q_i) (0, δ)).
    let inverse = rotation.conjugate() * norm_reciprocal;
    let angular_velocity = (inverse * derivative).imag() * convert::<f64, T>(2.0);
    let mut jacobians = [Matrix3::zeros(); MAX_ORDER];
    for ((jacobian, point), &value) in jacobians.iter_mut().zip(control).zip(&basis.value) {
        let relative = inverse * *point * value;
        *jacobian = skew(&relative.imag()) + Matrix3::from_diagonal_element(relative.w);
    }
    Some(RotationSample { rotation: UnitQuaternion::new_unchecked(rotation), angular_velocity, jacobians })
}

/// Evaluates the curve like [`evaluate`], with the angular acceleration and the Jacobians of angular velocity and
/// angular acceleration.
///
/// With the sum q and n = q·q: ω = 2 vec(q* q')/n and ω' = 2 vec(q* q'')/n − 2 (q·q') ω/n, because q'* q' has no
/// imaginary part.
pub fn motion<T: RealField + Copy>(basis: &Basis<T>, control: &[Quaternion<T>]) -> Option<RotationMotion<T>> {
    let sample = evaluate(basis, control)?;
    let control = basis.select(control)?;
    let zero = Quaternion::new(T::zero(), T::zero(), T::zero(), T::zero());
    let (mut sum, mut first, mut second) = (zero, zero, zero);
    let weights = basis.value.iter().zip(&basis.first_derivative).zip(&basis.second_derivative);
    for (point, ((&value, &slope), &curvature)) in control.iter().zip(weights.clone()) {
        sum += *point * value;
        first += *point * slope;
        second += *point * curvature;
    }
    let two = convert::<f64, T>(2.0);
    let half = convert::<f64, T>(0.5);
    let reciprocal = sum.norm_squared().recip();
    let velocity = sample.angular_velocity;
    // Twice vec(q* q'')/n, and the growth rate of the length of the sum.
    let bend = (sum.conjugate() * second).imag() * (two * reciprocal);
    let growth = sum.dot(&first) * reciprocal;

    let mut velocity_jacobians = [Matrix3::zeros(); MAX_ORDER];
    let mut acceleration_jacobians = [Matrix3::zeros(); MAX_ORDER];
    let jacobians = velocity_jacobians.iter_mut().zip(&mut acceleration_jacobians);
    for (((of_velocity, of_acceleration), point), ((&value, &slope), &curvature)) in jacobians.zip(control).zip(weights)
    {
        // A rotation δ of the control point changes the sum by N_i q_i (0, δ/2). Multiplied from the left by the
        // conjugate of the sum or of one of its derivatives, that is a matrix times δ.
        let turned = |left: &Quaternion<T>| {
            let relative = left.conjugate() * *point * reciprocal;
            (skew(&relative.imag()) + Matrix3::from_diagonal_element(relative.w), relative.imag())
        };
        let (by_sum, along_sum) = turned(&sum);
        let (by_first, along_first) = turned(&first);
        let (by_second, _) = turned(&second);
        *of_velocity = by_sum * slope - by_first * value + velocity * along_sum.transpose() * value;
        let of_bend = by_sum * curvature - by_second * value + bend * along_sum.transpose() * value;
        let of_growth = along_sum * (growth * value - half * slope) - along_first * (half * value);
        *of_acceleration = of_bend - *of_velocity * (two * growth) - velocity * of_growth.transpose() * two;
    }
    Some(RotationMotion {
        sample,
        angular_acceleration: bend - velocity * (two * growth),
        velocity_jacobians,
        acceleration_jacobians,
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use proptest::prelude::*;
    use std::vec::Vec;

    use super::super::Knots;
    use super::super::rotation::exp;
    use super::super::tests::{
        away_from_knots, jacobians_agree, knots_and_parameter, motion_agrees, numeric_angular_velocity, rotation_walk,
    };
    use super::*;

    /// Returns control points of different lengths.
    fn control_points(walk: &[UnitQuaternion<f64>]) -> Vec<Quaternion<f64>> {
        let mut control: Vec<_> =
            walk.iter().enumerate().map(|(i, q)| q.into_inner() * (1.0 + 0.05 * (i % 5) as f64)).collect();
        align_signs(&mut control);
        control
    }

    proptest! {
        #[test]
        fn angular_velocity_agrees_with_differences(
            (knots, degree, u) in knots_and_parameter(),
            walk in rotation_walk(48),
        ) {
            let u = away_from_knots(&knots, u, 2e-5);
            let knots = Knots::new(&knots, degree).unwrap();
            let control = control_points(&walk);
            let at = |u| evaluate(&knots.basis(u).unwrap(), &control).unwrap();
            let numeric = numeric_angular_velocity(|u| at(u).rotation, u);
            prop_assert!((at(u).angular_velocity - numeric).norm() < 1e-4 * (1.0 + numeric.norm()));
            prop_assert!((at(u).rotation.norm() - 1.0).abs() < 1e-14);
        }

        #[test]
        fn jacobians_agree_with_differences(
            (knots, degree, u) in knots_and_parameter(),
            walk in rotation_walk(48),
        ) {
            let basis = Knots::new(&knots, degree).unwrap().basis(u).unwrap();
            let control = control_points(&walk);
            let sample = evaluate(&basis, &control).unwrap();
            let turned = |index: usize, turn: &UnitQuaternion<f64>| {
                let mut control = control.clone();
                if index < basis.order {
                    control[basis.first + index] *= turn.into_inner();
                }
                evaluate(&basis, &control).unwrap().rotation
            };
            prop_assert!(jacobians_agree(&sample.jacobians, turned));
        }

        /// Also for curves whose degree is too low for smooth derivatives: between knots they are smooth.
        #[test]
        fn angular_acceleration_and_its_jacobians_agree_with_differences(
            (knots, degree, u) in knots_and_parameter(),
            walk in rotation_walk(48),
        ) {
            let u = away_from_knots(&knots, u, 2e-5);
            let knots = Knots::new(&knots, degree).unwrap();
            let control = control_points(&walk);
            let basis = knots.basis(u).unwrap();
            let at = |u| motion(&knots.basis(u).unwrap(), &control).unwrap();
            prop_assert_eq!(at(u).sample, evaluate(&basis, &control).unwrap());
            let turned = |index: usize, turn: &UnitQuaternion<f64>| {
                let mut control = control.clone();
                if index < basis.order {
                    control[basis.first + index] *= turn.into_inner();
                }
                motion(&basis, &control).unwrap()
            };
            prop_assert!(motion_agrees(at, u, turned));
        }

        #[test]
        fn aligned_signs_change_no_rotation_and_leave_no_jump(walk in rotation_walk(20), flips in any::<u32>()) {
            let flipped = |i: usize, q: Quaternion<f64>| if flips >> i & 1 == 1 { -q } else { q };
            let mut control: Vec<_> = walk.iter().enumerate().map(|(i, q)| flipped(i, q.into_inner())).collect();
            align_signs(&mut control);
            prop_assert!(control.windows(2).all(|pair| pair[0].dot(&pair[1]) >= 0.0));
            for (quaternion, rotation) in control.iter().zip(&walk) {
                prop_assert!(*quaternion == rotation.into_inner() || *quaternion == -rotation.into_inner());
            }
            prop_assert_eq!(control[0], flipped(0, walk[0].into_inner()));
        }
    }

    #[test]
    fn the_ends_are_the_end_control_points() {
        let knots = [0.0, 0.0, 0.0, 0.0, 0.3, 1.0, 1.0, 1.0, 1.0];
        let knots = Knots::new(&knots, 3).unwrap();
        let turns: [Vector3<f64>; 5] = core::array::from_fn(|i| Vector3::new(0.1, 0.2, -0.3) * i as f64);
        let control = turns.map(|turn| exp(&turn).into_inner() * 3.0);
        let rotation = |u| evaluate(&knots.basis(u).unwrap(), &control).unwrap().rotation;
        assert!(rotation(0.0).angle_to(&exp(&turns[0])) < 1e-14);
        assert!(rotation(1.0).angle_to(&exp(&turns[4])) < 1e-14);
    }

    #[test]
    fn a_vanishing_sum_is_rejected() {
        let knots = [0.0, 0.0, 1.0, 1.0];
        let knots = Knots::new(&knots, 1).unwrap();
        let q = Quaternion::new(0.5, -0.5, 0.5, 0.5);
        assert!(evaluate(&knots.basis(0.5).unwrap(), &[q, -q]).is_none());
        assert!(evaluate(&knots.basis(0.4).unwrap(), &[q, -q]).is_some());
        assert!(evaluate(&knots.basis(0.5).unwrap(), &[q, q * f64::NAN]).is_none());
        assert!(evaluate(&knots.basis(0.5).unwrap(), &[q * 0.0, q * 0.0]).is_none());
        assert!(evaluate(&knots.basis(0.5).unwrap(), &[q]).is_none());
    }
}

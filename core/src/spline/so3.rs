//! Rotation curves on the group SO(3): `R(u) = R_0 Π exp(λ_j(u) d_j)` with the steps
//! `d_j = log(R_{j-1}⁻¹ R_j)` between neighbouring control points and the cumulative basis
//! `λ_j = Σ_{i ≥ j} N_i` (Sommer et al., *Continuous-time estimation of attitude using B-splines on
//! Lie groups*, 2016, and *Efficient derivative computation for cumulative B-splines on Lie groups*,
//! 2020).
//!
//! The sign of a control quaternion has no meaning here. Neighbouring control points must be less
//! than half a turn apart: at half a turn the direction of the step is arbitrary.

use nalgebra::{Matrix3, RealField, UnitQuaternion, Vector3};

use super::rotation::{exp, log, right_jacobian, right_jacobian_inverse};
use super::{Basis, MAX_DEGREE, MAX_ORDER, RotationSample};

/// The step between two neighbouring control points, at one parameter.
#[derive(Clone, Copy)]
struct Step<T: RealField> {
    /// `d_j`.
    vector: Vector3<T>,
    /// `λ_j`.
    weight: T,
    /// `exp(λ_j d_j)`.
    rotation: UnitQuaternion<T>,
}

/// The point at `basis` of the curve with all its control points `control` (unit quaternions);
/// `None` when there are too few of them.
pub fn evaluate<T: RealField + Copy>(basis: &Basis<T>, control: &[UnitQuaternion<T>]) -> Option<RotationSample<T>> {
    let control = basis.select(control)?;
    let (first, others) = control.split_first()?;

    let mut rotation = *first;
    let mut angular_velocity = Vector3::zeros();
    let mut steps =
        [Step { vector: Vector3::zeros(), weight: T::zero(), rotation: UnitQuaternion::identity() }; MAX_DEGREE];
    let mut weight: T = basis.value.iter().fold(T::zero(), |sum, value| sum + *value);
    let mut weight_derivative = T::zero();
    let weights = basis.value.iter().zip(&basis.first_derivative);
    for (((before, after), (&value, &slope)), step) in control.iter().zip(others).zip(weights).zip(&mut steps) {
        weight -= value;
        weight_derivative -= slope;
        let vector = log(&(before.inverse() * after));
        *step = Step { vector, weight, rotation: exp(&(vector * weight)) };
        rotation *= step.rotation;
        angular_velocity = step.rotation.inverse_transform_vector(&angular_velocity) + vector * weight_derivative;
    }

    // Turning d_j by ε turns R by P_j λ_j J_r(λ_j d_j) ε, with P_j the inverse of the product of the
    // later factors. A turn δ of control point j changes d_j by J_r⁻¹(d_j) δ and d_{j+1} by the
    // left Jacobian's inverse, -J_l⁻¹(d_{j+1}) δ.
    let mut jacobians = [Matrix3::zeros(); MAX_ORDER];
    let mut later = Matrix3::identity();
    let mut from_next = Matrix3::zeros();
    let count = others.len();
    for (jacobian, step) in jacobians.iter_mut().skip(1).zip(&steps).take(count).rev() {
        let gain = later * right_jacobian(&(step.vector * step.weight)) * step.weight;
        let inverse = right_jacobian_inverse(&step.vector);
        *jacobian = gain * inverse - from_next;
        from_next = gain * inverse.transpose();
        later *= step.rotation.inverse().to_rotation_matrix().into_inner();
    }
    if let Some(jacobian) = jacobians.first_mut() {
        *jacobian = later - from_next;
    }
    Some(RotationSample { rotation: UnitQuaternion::new_normalize(rotation.into_inner()), angular_velocity, jacobians })
}

#[cfg(test)]
mod tests {
    use nalgebra::Quaternion;
    use proptest::prelude::*;
    use std::vec::Vec;

    use super::super::tests::{
        away_from_knots, greville, jacobians_agree, knots_and_parameter, numeric_angular_velocity, rotation_walk,
    };
    use super::super::{Knots, quaternion};
    use super::*;

    proptest! {
        #[test]
        fn angular_velocity_agrees_with_differences(
            (knots, degree, u) in knots_and_parameter(),
            control in rotation_walk(48),
        ) {
            let u = away_from_knots(&knots, u, 2e-5);
            let knots = Knots::new(&knots, degree).unwrap();
            let at = |u| evaluate(&knots.basis(u).unwrap(), &control).unwrap();
            let numeric = numeric_angular_velocity(|u| at(u).rotation, u);
            prop_assert!((at(u).angular_velocity - numeric).norm() < 1e-4 * (1.0 + numeric.norm()));
            prop_assert!((at(u).rotation.norm() - 1.0).abs() < 1e-15);
        }

        #[test]
        fn jacobians_agree_with_differences(
            (knots, degree, u) in knots_and_parameter(),
            control in rotation_walk(48),
        ) {
            let basis = Knots::new(&knots, degree).unwrap().basis(u).unwrap();
            let sample = evaluate(&basis, &control).unwrap();
            let turned = |index: usize, turn: &UnitQuaternion<f64>| {
                let mut control = control.clone();
                if index < basis.order {
                    control[basis.first + index] *= turn;
                }
                evaluate(&basis, &control).unwrap().rotation
            };
            prop_assert!(jacobians_agree(&sample.jacobians, turned));
        }

        #[test]
        fn turning_all_control_points_from_the_left_turns_the_curve(
            (knots, degree, u) in knots_and_parameter(),
            control in rotation_walk(48),
        ) {
            let basis = Knots::new(&knots, degree).unwrap().basis(u).unwrap();
            let turn = exp(&Vector3::new(0.7, -1.9, 0.4));
            let turned: Vec<_> = control.iter().map(|q| turn * q).collect();
            let (before, after) = (evaluate(&basis, &control).unwrap(), evaluate(&basis, &turned).unwrap());
            prop_assert!(after.rotation.angle_to(&(turn * before.rotation)) < 1e-14);
            prop_assert!((after.angular_velocity - before.angular_velocity).norm() < 1e-12 * (1.0 + before.angular_velocity.norm()));
        }

        /// Control points at the Greville abscissae of a turn at constant rate give exactly this turn
        /// on SO(3); the quaternion curve deviates from it only in the third order of the step angle.
        #[test]
        fn a_constant_rate_is_exact_and_near_the_quaternion_curve((knots, degree, u) in knots_and_parameter()) {
            let rate = Vector3::new(0.03, -0.05, 0.04);
            let control: Vec<_> = greville(&knots, degree).map(|u| exp(&(rate * u))).collect();
            let quaternions: Vec<Quaternion<f64>> = control.iter().map(|q| q.into_inner()).collect();
            let basis = Knots::new(&knots, degree).unwrap().basis(u).unwrap();
            let sample = evaluate(&basis, &control).unwrap();
            prop_assert!(sample.rotation.angle_to(&exp(&(rate * u))) < 1e-14);
            prop_assert!((sample.angular_velocity - rate).norm() < 1e-13);
            let other = quaternion::evaluate(&basis, &quaternions).unwrap();
            prop_assert!(sample.rotation.angle_to(&other.rotation) < 1e-3);
            prop_assert!((sample.angular_velocity - other.angular_velocity).norm() < 5e-3);
        }
    }

    #[test]
    fn signs_of_control_quaternions_do_not_matter() {
        let knots = [0.0, 0.0, 0.0, 0.4, 1.0, 1.0, 1.0];
        let basis = Knots::new(&knots, 2).unwrap().basis(0.3).unwrap();
        let control: [UnitQuaternion<f64>; 4] =
            core::array::from_fn(|i| exp(&(Vector3::new(0.3, 0.1, 0.2) * i as f64)));
        let mut flipped = control;
        flipped[1] = UnitQuaternion::new_unchecked(-control[1].into_inner());
        let (one, other) = (evaluate(&basis, &control).unwrap(), evaluate(&basis, &flipped).unwrap());
        assert!(one.rotation.angle_to(&other.rotation) < 1e-15);
        assert!((one.jacobians[1] - other.jacobians[1]).norm() < 1e-15);
        assert!(evaluate(&basis, &control[..2]).is_none());
    }
}

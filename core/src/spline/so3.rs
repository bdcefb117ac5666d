//! Rotation curves on the group SO(3): `R(u) = R_0 Π exp(λ_j(u) d_j)` with the steps
//! `d_j = log(R_{j-1}⁻¹ R_j)` between neighbouring control points and the cumulative basis
//! `λ_j = Σ_{i ≥ j} N_i` (Sommer et al., *Continuous-time estimation of attitude using B-splines on
//! Lie groups*, 2016, and *Efficient derivative computation for cumulative B-splines on Lie groups*,
//! 2020).
//!
//! The sign of a control quaternion has no meaning here. Neighbouring control points must be less than 180° apart: at
//! 180° the direction of the step is arbitrary.

use nalgebra::{Matrix3, RealField, UnitQuaternion, Vector3};

use super::rotation::{exp, log, right_jacobian, right_jacobian_inverse, skew};
use super::{Basis, MAX_DEGREE, MAX_ORDER, RotationMotion, RotationSample};

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

/// Returns the point at `basis` of the curve with the control points `control` (all of them, unit quaternions); `None`
/// if there are too few.
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

    // A change ε of d_j rotates R by P_j λ_j J_r(λ_j d_j) ε, with P_j the inverse of the product of the later factors.
    // A rotation δ of control point j changes d_j by J_r⁻¹(d_j) δ and d_{j+1} by the left Jacobian's inverse,
    // -J_l⁻¹(d_{j+1}) δ.
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

/// A step with the quantities needed for IMU measurements.
#[derive(Clone, Copy)]
struct MovingStep<T: RealField> {
    step: Step<T>,
    /// `λ_j'`.
    slope: T,
    /// `λ_j''`.
    curvature: T,
    /// Angular velocity of the previous steps, in the frame after this one.
    velocity: Vector3<T>,
    /// Angular acceleration of the previous steps, in the frame after this one.
    acceleration: Vector3<T>,
}

/// Evaluates the curve like [`evaluate`], with the angular acceleration and the Jacobians of angular velocity and
/// angular acceleration.
///
/// With `A_j = exp(λ_j d_j)`, from step to step (Sommer et al. 2020) `ω ← A_jᵀ ω + λ_j' d_j` and `ω' ← A_jᵀ ω' + λ_j'
/// (A_jᵀ ω) × d_j + λ_j'' d_j`.
pub fn motion<T: RealField + Copy>(basis: &Basis<T>, control: &[UnitQuaternion<T>]) -> Option<RotationMotion<T>> {
    let sample = evaluate(basis, control)?;
    let control = basis.select(control)?;
    let (_, others) = control.split_first()?;

    let (mut velocity, mut acceleration) = (Vector3::<T>::zeros(), Vector3::<T>::zeros());
    let at_rest = Step { vector: Vector3::zeros(), weight: T::zero(), rotation: UnitQuaternion::identity() };
    let (zero, still) = (T::zero(), Vector3::zeros());
    let mut steps =
        [MovingStep { step: at_rest, slope: zero, curvature: zero, velocity: still, acceleration: still }; MAX_DEGREE];
    let mut weight: T = basis.value.iter().fold(zero, |sum, value| sum + *value);
    let (mut slope, mut curvature) = (zero, zero);
    let weights = basis.value.iter().zip(&basis.first_derivative).zip(&basis.second_derivative);
    for (((before, after), ((&value, &first), &second)), moving) in
        control.iter().zip(others).zip(weights).zip(&mut steps)
    {
        weight -= value;
        slope -= first;
        curvature -= second;
        let vector = log(&(before.inverse() * after));
        let rotation = exp(&(vector * weight));
        let carried = rotation.inverse_transform_vector(&velocity);
        let carried_acceleration = rotation.inverse_transform_vector(&acceleration);
        let step = Step { vector, weight, rotation };
        *moving = MovingStep { step, slope, curvature, velocity: carried, acceleration: carried_acceleration };
        acceleration = carried_acceleration + carried.cross(&vector) * slope + vector * curvature;
        velocity = carried + vector * slope;
    }

    // A change ε of d_j rotates A_j by λ_j J_r(λ_j d_j) ε. The vectors that A_jᵀ transforms rotate by the same vector
    // in the opposite direction. The later steps turn a change Δω into L Δω; they turn changes Δω and Δω' into a change
    // of ω' by M Δω + L Δω'.
    let mut velocity_jacobians = [Matrix3::zeros(); MAX_ORDER];
    let mut acceleration_jacobians = [Matrix3::zeros(); MAX_ORDER];
    let (mut later, mut mixed) = (Matrix3::<T>::identity(), Matrix3::<T>::zeros());
    let mut velocity_from_next = Matrix3::<T>::zeros();
    let mut acceleration_from_next = Matrix3::<T>::zeros();
    let count = others.len();
    let jacobians = velocity_jacobians.iter_mut().zip(&mut acceleration_jacobians);
    for ((by_velocity, by_acceleration), moving) in jacobians.skip(1).zip(&steps).take(count).rev() {
        let MovingStep { step: Step { vector, weight, rotation }, slope, curvature, velocity, acceleration } = *moving;
        let gain = right_jacobian(&(vector * weight)) * weight;
        let turned = skew(&velocity) * gain;
        let of_velocity = turned + Matrix3::from_diagonal_element(slope);
        let of_acceleration = skew(&acceleration) * gain
            + (skew(&velocity) - skew(&vector) * turned) * slope
            + Matrix3::from_diagonal_element(curvature);
        let gain_of_velocity = later * of_velocity;
        let gain_of_acceleration = later * of_acceleration + mixed * of_velocity;
        let inverse = right_jacobian_inverse(&vector);
        *by_velocity = gain_of_velocity * inverse - velocity_from_next;
        *by_acceleration = gain_of_acceleration * inverse - acceleration_from_next;
        velocity_from_next = gain_of_velocity * inverse.transpose();
        acceleration_from_next = gain_of_acceleration * inverse.transpose();
        let back = rotation.inverse().to_rotation_matrix().into_inner();
        mixed = (mixed - later * skew(&vector) * slope) * back;
        later *= back;
    }
    if let (Some(of_velocity), Some(of_acceleration)) =
        (velocity_jacobians.first_mut(), acceleration_jacobians.first_mut())
    {
        *of_velocity = -velocity_from_next;
        *of_acceleration = -acceleration_from_next;
    }
    Some(RotationMotion { sample, angular_acceleration: acceleration, velocity_jacobians, acceleration_jacobians })
}

#[cfg(test)]
mod tests {
    use nalgebra::Quaternion;
    use proptest::prelude::*;
    use std::vec::Vec;

    use super::super::tests::{
        away_from_knots, greville, jacobians_agree, knots_and_parameter, motion_agrees, numeric_angular_velocity,
        rotation_walk,
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

        /// Also for curves whose degree is too low for smooth derivatives: between knots they are smooth.
        #[test]
        fn angular_acceleration_and_its_jacobians_agree_with_differences(
            (knots, degree, u) in knots_and_parameter(),
            control in rotation_walk(48),
        ) {
            let u = away_from_knots(&knots, u, 2e-5);
            let knots = Knots::new(&knots, degree).unwrap();
            let basis = knots.basis(u).unwrap();
            let at = |u| motion(&knots.basis(u).unwrap(), &control).unwrap();
            prop_assert_eq!(at(u).sample, evaluate(&basis, &control).unwrap());
            let turned = |index: usize, turn: &UnitQuaternion<f64>| {
                let mut control = control.clone();
                if index < basis.order {
                    control[basis.first + index] *= turn;
                }
                motion(&basis, &control).unwrap()
            };
            prop_assert!(motion_agrees(at, u, turned));
        }

        #[test]
        fn rotating_all_control_points_from_the_left_rotates_the_curve(
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

        /// With control points at the Greville abscissae of a rotation at constant rate, the curve on SO(3) is exactly
        /// this rotation; the quaternion curve deviates from it only in the third order of the step angle.
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

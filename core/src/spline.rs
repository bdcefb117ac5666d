//! Clamped B-spline curves on non-uniform knots: basis functions, and curves in space and rotation.
//!
//! A curve of degree `p` with control points `P_0 … P_n` over the knots `u_0 ≤ … ≤ u_{n+p+1}` is
//! `C(u) = Σ N_{i,p}(u) P_i`. In every knot span only `p + 1` basis functions differ from zero, so
//! evaluation has two steps: [`Knots::basis`] finds the span and the basis functions at `u`
//! ([`Basis`]), and the curve modules weigh their control points with it:
//!
//! | module | control points | curve |
//! |---|---|---|
//! | [`vector`] | `Vector3` | the sum above |
//! | [`quaternion`] | `Quaternion` | the sum above, normalised (Kang and Park 1999) |
//! | [`so3`] | `UnitQuaternion` | cumulative product of exponentials (Sommer et al. 2016, 2020) |
//! | [`rotation`] | | exponential, logarithm and their Jacobians, used by the above |
//!
//! One [`Basis`] serves all curves that share a knot vector. Symbols and algorithm numbers are those
//! of Piegl and Tiller, *The NURBS Book*, second edition.
//!
//! Nothing here panics or allocates, whatever the input: a parameter outside the knots is an error,
//! too few control points give `None`.
//!
//! ```
//! use evcal_core::spline::{Knots, vector};
//! use nalgebra::Vector3;
//!
//! let knots = [0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0];
//! let knots = Knots::new(&knots, 2)?;
//! let control: [Vector3<f64>; 4] = core::array::from_fn(|i| Vector3::new(i as f64, 0.0, 1.0));
//! let sample = vector::evaluate(&knots.basis(2.0)?, &control);
//! assert_eq!(sample.map(|sample| sample.value), Some(control[3]));
//! # Ok::<(), evcal_core::spline::SplineError>(())
//! ```

pub mod quaternion;
pub mod rotation;
pub mod so3;
pub mod vector;

use core::fmt;

use nalgebra::{Matrix3, RealField, UnitQuaternion, Vector3};

/// The highest degree of a curve.
pub const MAX_DEGREE: usize = 5;
/// The largest number of control points that act on one point of a curve.
pub const MAX_ORDER: usize = MAX_DEGREE + 1;

/// Reason to reject a knot vector or a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SplineError {
    /// The degree is not in 1..=[`MAX_DEGREE`].
    Degree,
    /// Fewer than `2 (degree + 1)` knots, that is, fewer than `degree + 1` control points.
    TooFewControlPoints,
    /// A knot is smaller than the one before it, or not finite.
    KnotsDecrease,
    /// The first or the last `degree + 1` knots are not equal.
    NotClamped,
    /// An inner knot is repeated more than `degree` times (the curve would jump), or a knot at an end more than
    /// `degree + 1` times.
    KnotMultiplicity,
    /// The parameter lies outside the knots, or is NaN.
    OutOfRange,
}

impl fmt::Display for SplineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Degree => "the degree of a spline must be 1 to 5",
            Self::TooFewControlPoints => "a spline needs at least one control point more than its degree",
            Self::KnotsDecrease => "the knots of a spline must be finite and must not decrease",
            Self::NotClamped => "the first and the last knot of a spline must be repeated once more than its degree",
            Self::KnotMultiplicity => "a knot of a spline is repeated too often",
            Self::OutOfRange => "the parameter lies outside the knots of the spline",
        })
    }
}

impl core::error::Error for SplineError {}

/// A clamped knot vector, checked and borrowed.
///
/// Its first and last knot are repeated `degree + 1` times, so that the curve begins in the first
/// and ends in the last control point. A knot inside may be repeated up to `degree` times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Knots<'a, T> {
    knots: &'a [T],
    degree: usize,
    start: T,
    end: T,
}

impl<'a, T: RealField + Copy> Knots<'a, T> {
    /// Checks `knots` for curves of `degree`.
    ///
    /// # Errors
    /// [`SplineError::Degree`], [`SplineError::TooFewControlPoints`], [`SplineError::KnotsDecrease`],
    /// [`SplineError::NotClamped`] or [`SplineError::KnotMultiplicity`].
    pub fn new(knots: &'a [T], degree: usize) -> Result<Self, SplineError> {
        if degree == 0 || degree > MAX_DEGREE {
            return Err(SplineError::Degree);
        }
        let order = degree + 1;
        let (Some((first, head)), Some((last, tail))) = (knots.split_first(), knots.split_last()) else {
            return Err(SplineError::TooFewControlPoints);
        };
        if knots.len() < 2 * order {
            return Err(SplineError::TooFewControlPoints);
        }
        // Written so that a NaN is rejected.
        let rises = knots.iter().zip(head).all(|(knot, next)| knot <= next);
        if !(rises && first.is_finite() && last.is_finite()) {
            return Err(SplineError::KnotsDecrease);
        }
        if knots.get(degree) != Some(first) || knots.get(knots.len() - order) != Some(last) {
            return Err(SplineError::NotClamped);
        }
        // The ends are excluded because each may be repeated once more.
        if head.iter().zip(tail.iter().skip(order)).any(|(knot, later)| knot == later) {
            return Err(SplineError::KnotMultiplicity);
        }
        Ok(Self { knots, degree, start: *first, end: *last })
    }

    /// Creates the knots without a check, for a vector that [`Knots::new`] has accepted before. Other knots cause wrong
    /// values or errors, but never a panic.
    pub fn assume_valid(knots: &'a [T], degree: usize) -> Self {
        let end = |knot: Option<&T>| knot.copied().unwrap_or_else(T::zero);
        Self { knots, degree: degree.min(MAX_DEGREE), start: end(knots.first()), end: end(knots.last()) }
    }

    /// Returns the degree of the curve, 1 to [`MAX_DEGREE`].
    pub fn degree(&self) -> usize {
        self.degree
    }

    /// Returns the number of control points that belong to these knots.
    pub fn control_point_count(&self) -> usize {
        self.knots.len().saturating_sub(self.degree).saturating_sub(1)
    }

    /// Returns the first parameter of the curve.
    pub fn start(&self) -> T {
        self.start
    }

    /// Returns the last parameter of the curve.
    pub fn end(&self) -> T {
        self.end
    }

    /// Returns the knots.
    pub fn as_slice(&self) -> &'a [T] {
        self.knots
    }

    /// Returns the `k` with `u_k ≤ u < u_{k+1}`, found by bisection (algorithm A2.1). The last span that is not empty
    /// is closed: it includes [`Knots::end`].
    ///
    /// # Errors
    /// [`SplineError::OutOfRange`] if `u` lies outside the knots or is NaN.
    pub fn find_span(&self, u: T) -> Result<usize, SplineError> {
        if !(self.start <= u && u <= self.end) {
            return Err(SplineError::OutOfRange);
        }
        let inside = self.knots.get(self.degree + 1..self.control_point_count()).unwrap_or_default();
        Ok(self.degree + inside.partition_point(|knot| *knot <= u))
    }

    /// Returns the basis functions that differ from zero at `u`, and their first two derivatives with respect to `u`
    /// (the results of algorithms A2.2 and A2.3, in one pass).
    ///
    /// At a knot the derivatives are taken from the right, at [`Knots::end`] from the left.
    ///
    /// # Errors
    /// [`SplineError::OutOfRange`] if `u` lies outside the knots or is NaN.
    pub fn basis(&self, u: T) -> Result<Basis<T>, SplineError> {
        let degree = self.degree;
        let span = self.find_span(u)?;
        let first = span.saturating_sub(degree);
        // u_{k-p+1} … u_k and u_{k+1} … u_{k+p}
        let (Some(lower), Some(upper)) =
            (self.knots.get(first + 1..first + 1 + degree), self.knots.get(span + 1..span + 1 + degree))
        else {
            return Err(SplineError::OutOfRange);
        };

        let mut value = [T::zero(); MAX_ORDER];
        let mut first_derivative = [T::zero(); MAX_ORDER];
        let mut second_derivative = [T::zero(); MAX_ORDER];
        value[0] = T::one();
        let mut factor = T::zero();
        // Raises the degree from j - 1 to j, in place. Both recurrences divide by the same knot
        // difference: (2.5) for the values and (2.7) for the derivatives of either order. The
        // difference covers the span of u, which is not empty, so it is never zero.
        for j in 1..=degree {
            factor += T::one();
            let mut value_carry = T::zero();
            let mut value_quotient_before = T::zero();
            let mut slope_quotient_before = T::zero();
            let mut values = value.iter_mut().zip(first_derivative.iter_mut()).zip(second_derivative.iter_mut());
            let differences = lower.iter().skip(degree - j).zip(upper);
            for ((&lower, &upper), ((value, slope), curvature)) in differences.zip(values.by_ref()) {
                let reciprocal = (upper - lower).recip();
                let value_quotient = *value * reciprocal;
                let slope_quotient = *slope * reciprocal;
                *value = value_carry + (upper - u) * value_quotient;
                *slope = factor * (value_quotient_before - value_quotient);
                *curvature = factor * (slope_quotient_before - slope_quotient);
                value_carry = (u - lower) * value_quotient;
                value_quotient_before = value_quotient;
                slope_quotient_before = slope_quotient;
            }
            if let Some(((value, slope), curvature)) = values.next() {
                *value = value_carry;
                *slope = factor * value_quotient_before;
                *curvature = factor * slope_quotient_before;
            }
        }
        Ok(Basis { first, order: degree + 1, value, first_derivative, second_derivative })
    }
}

/// The basis functions that differ from zero at one parameter.
///
/// Entry `i` of each array belongs to control point `first + i`; entries from `order` on are zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Basis<T> {
    /// Index of the first control point concerned: the knot span minus the degree.
    pub first: usize,
    /// Number of control points concerned: the degree plus one.
    pub order: usize,
    /// `N_i(u)`. They are not negative and sum to 1.
    pub value: [T; MAX_ORDER],
    /// `N_i'(u)`. They sum to 0.
    pub first_derivative: [T; MAX_ORDER],
    /// `N_i''(u)`. They sum to 0.
    pub second_derivative: [T; MAX_ORDER],
}

impl<T> Basis<T> {
    /// Returns the control points concerned, out of all control points of a curve; `None` if `control` is too short.
    pub fn select<'a, P>(&self, control: &'a [P]) -> Option<&'a [P]> {
        control.get(self.first..)?.get(..self.order)
    }
}

/// One point of a rotation curve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotationSample<T: RealField> {
    /// The rotation `R`; for a camera trajectory `R_world_camera`.
    pub rotation: UnitQuaternion<T>,
    /// Angular velocity ω in the body (camera) frame, `R' = R [ω]×`, in radians per unit of `u`.
    pub angular_velocity: Vector3<T>,
    /// Entry `i`: derivative of the body-frame perturbation `w` of the rotation (`R exp(w)`) with respect to the
    /// body-frame perturbation `δ` of control point `Basis::first + i` (`q_i exp(δ)`), both rotation vectors. Entries
    /// from `Basis::order` on are zero.
    pub jacobians: [Matrix3<T>; MAX_ORDER],
}

/// One point of a rotation curve with its angular acceleration, for IMU measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RotationMotion<T: RealField> {
    /// Rotation, angular velocity and the Jacobians of the rotation.
    pub sample: RotationSample<T>,
    /// Derivative of the angular velocity in the body (camera) frame, in radians per squared unit of `u`.
    pub angular_acceleration: Vector3<T>,
    /// Entry `i`: derivative of the angular velocity with respect to the body-frame perturbation `δ` of control point
    /// `Basis::first + i` (`q_i exp(δ)`). Entries from `Basis::order` on are zero.
    pub velocity_jacobians: [Matrix3<T>; MAX_ORDER],
    /// The same for the angular acceleration.
    pub acceleration_jacobians: [Matrix3<T>; MAX_ORDER],
}

#[cfg(test)]
pub(crate) mod tests {
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    /// Returns knot vectors of every degree with up to 8 spans of very different lengths, some of the knots repeated,
    /// and a parameter on them.
    pub(crate) fn knots_and_parameter() -> impl Strategy<Value = (Vec<f64>, usize, f64)> {
        let span = (0.1..1.5_f64, 1..=MAX_DEGREE);
        (1..=MAX_DEGREE, -3.0..3.0_f64, prop::collection::vec(span, 1..8), 0.0..=1.0_f64).prop_map(
            |(degree, start, spans, place)| {
                let mut knots = std::vec![start; degree + 1];
                let mut end = start;
                let count = spans.len();
                for (index, (length, repeats)) in spans.into_iter().enumerate() {
                    end += length;
                    // Mostly simple knots.
                    let repeats =
                        if index + 1 == count { degree + 1 } else { repeats.saturating_sub(3).clamp(1, degree) };
                    knots.extend(std::iter::repeat_n(end, repeats));
                }
                let u = (start + place * (end - start)).min(end);
                (knots, degree, u)
            },
        )
    }

    /// Returns a parameter near `u` whose nearest knot is farther away than `distance`.
    pub(crate) fn away_from_knots(knots: &[f64], u: f64, distance: f64) -> f64 {
        let near = knots.iter().copied().find(|knot| (knot - u).abs() <= distance);
        let end = knots[knots.len() - 1];
        near.map_or(u, |knot| if knot < end { knot + 2.0 * distance } else { knot - 2.0 * distance })
    }

    /// Returns rotations with steps of up to about 1.4 rad between neighbours.
    pub(crate) fn rotation_walk(count: usize) -> impl Strategy<Value = Vec<UnitQuaternion<f64>>> {
        prop::collection::vec([-0.8..0.8_f64, -0.8..0.8_f64, -0.8..0.8_f64], count).prop_map(|turns| {
            let mut rotation = UnitQuaternion::from_euler_angles(1.0, 2.0, 3.0);
            let mut walk = Vec::new();
            for turn in turns {
                rotation *= UnitQuaternion::from_scaled_axis(Vector3::from(turn));
                walk.push(rotation);
            }
            walk
        })
    }

    /// Returns the angular velocity at `u` of a curve of rotations by central differences, in the body frame.
    pub(crate) fn numeric_angular_velocity(curve: impl Fn(f64) -> UnitQuaternion<f64>, u: f64) -> Vector3<f64> {
        numeric_turn(|step| curve(u + step), 1e-5)
    }

    /// Returns the rotation vector per unit of the argument at 0, by central differences, in the body frame.
    fn numeric_turn(rotation: impl Fn(f64) -> UnitQuaternion<f64>, step: f64) -> Vector3<f64> {
        rotation::log(&(rotation(-step).inverse() * rotation(step))) / (2.0 * step)
    }

    /// Checks the Jacobians of a rotation: `turned` returns the rotation after the control point of this index was
    /// rotated on the right.
    pub(crate) fn jacobians_agree(
        jacobians: &[Matrix3<f64>; MAX_ORDER],
        turned: impl Fn(usize, &UnitQuaternion<f64>) -> UnitQuaternion<f64>,
    ) -> bool {
        jacobians.iter().enumerate().all(|(index, jacobian)| {
            (0..3).all(|axis| {
                let turn = |angle: f64| {
                    let mut vector = Vector3::zeros();
                    vector[axis] = angle;
                    turned(index, &rotation::exp(&vector))
                };
                (jacobian.column(axis) - numeric_turn(turn, 1e-6)).norm() < 1e-8
            })
        })
    }

    /// Checks the second derivatives of a rotation near `u`: `at` returns the motion at a parameter, `turned` the
    /// motion at `u` after the control point of this index was rotated on the right.
    pub(crate) fn motion_agrees(
        at: impl Fn(f64) -> RotationMotion<f64>,
        u: f64,
        turned: impl Fn(usize, &UnitQuaternion<f64>) -> RotationMotion<f64>,
    ) -> bool {
        let (here, step) = (at(u), 1e-5);
        let [before, after] = [u - step, u + step].map(|u| at(u).sample.angular_velocity);
        let numeric = (after - before) / (2.0 * step);
        let (velocity, acceleration) = (here.sample.angular_velocity.norm(), here.angular_acceleration.norm());
        let jacobians = here.velocity_jacobians.iter().zip(&here.acceleration_jacobians).enumerate();
        (here.angular_acceleration - numeric).norm() < 1e-3 * (1.0 + numeric.norm())
            && jacobians.into_iter().all(|(index, (of_velocity, of_acceleration))| {
                (0..3).all(|axis| {
                    let step = 1e-6;
                    let [before, after] = [-step, step].map(|angle| {
                        let mut vector = Vector3::zeros();
                        vector[axis] = angle;
                        turned(index, &rotation::exp(&vector))
                    });
                    let agrees = |jacobian: &Matrix3<f64>, change: Vector3<f64>, size: f64| {
                        let numeric = change / (2.0 * step);
                        (jacobian.column(axis) - numeric).norm() < 1e-7 * (1.0 + numeric.norm() + size)
                    };
                    let velocities = after.sample.angular_velocity - before.sample.angular_velocity;
                    let accelerations = after.angular_acceleration - before.angular_acceleration;
                    agrees(of_velocity, velocities, velocity) && agrees(of_acceleration, accelerations, acceleration)
                })
            })
    }

    /// Returns the Greville abscissae: control points there reproduce linear functions of `u`.
    pub(crate) fn greville(knots: &[f64], degree: usize) -> impl Iterator<Item = f64> {
        knots[1..knots.len() - 1].windows(degree).map(move |window| window.iter().sum::<f64>() / degree as f64)
    }

    /// Definition (2.5) of the basis functions: recursive, 0/0 = 0.
    fn definition(knots: &[f64], i: usize, p: usize, u: f64) -> f64 {
        if p == 0 {
            return f64::from(u8::from(knots[i] <= u && u < knots[i + 1]));
        }
        let part = |numerator: f64, denominator: f64, value: f64| {
            if denominator == 0.0 { 0.0 } else { numerator / denominator * value }
        };
        part(u - knots[i], knots[i + p] - knots[i], definition(knots, i, p - 1, u))
            + part(knots[i + p + 1] - u, knots[i + p + 1] - knots[i + 1], definition(knots, i + 1, p - 1, u))
    }

    /// The NURBS Book, examples 2.3 and 2.4.
    const BOOK: [f64; 11] = [0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 5.0, 5.0, 5.0];

    #[test]
    fn nurbs_book_examples_2_3_and_2_4() {
        let knots = Knots::new(&BOOK, 2).unwrap();
        assert_eq!((knots.degree(), knots.control_point_count(), knots.start(), knots.end()), (2, 8, 0.0, 5.0));
        assert_eq!(knots.find_span(2.5), Ok(4));
        let basis = knots.basis(2.5).unwrap();
        assert_eq!((basis.first, basis.order), (2, 3));
        assert_eq!(basis.value, [0.125, 0.75, 0.125, 0.0, 0.0, 0.0]);
        assert_eq!(basis.first_derivative, [-0.5, 0.0, 0.5, 0.0, 0.0, 0.0]);
        assert_eq!(basis.second_derivative, [1.0, -2.0, 1.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn single_precision_gives_the_same_numbers() {
        let knots = BOOK.map(|knot| knot as f32);
        let basis = Knots::new(&knots, 2).unwrap().basis(2.5).unwrap();
        assert_eq!(basis.value, [0.125, 0.75, 0.125, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn spans_are_closed_on_the_left_and_the_last_on_both_sides() {
        let knots = Knots::new(&BOOK, 2).unwrap();
        for (u, span) in [(0.0, 2), (1.0, 3), (3.999, 5), (4.0, 7), (4.999, 7), (5.0, 7)] {
            assert_eq!(knots.find_span(u), Ok(span), "u = {u}");
        }
        for u in [-1e-9, 5.000_001, f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            assert_eq!(knots.find_span(u), Err(SplineError::OutOfRange));
            assert_eq!(knots.basis(u), Err(SplineError::OutOfRange));
        }
    }

    #[test]
    fn bad_knot_vectors_are_rejected_with_their_reason() {
        let cases: [(&[f64], usize, SplineError); 14] = [
            (&[0.0, 1.0], 0, SplineError::Degree),
            (&[0.0; 14], 6, SplineError::Degree),
            (&[], 3, SplineError::TooFewControlPoints),
            (&[0.0, 0.0, 0.0, 1.0, 1.0, 1.0], 3, SplineError::TooFewControlPoints),
            (&[0.0, 0.0, 2.0, 1.0, 3.0, 3.0], 1, SplineError::KnotsDecrease),
            (&[0.0, 0.0, f64::NAN, 1.0, 1.0], 1, SplineError::KnotsDecrease),
            (&[f64::NAN, f64::NAN, f64::NAN, f64::NAN], 1, SplineError::KnotsDecrease),
            (&[0.0, 0.0, f64::INFINITY, f64::INFINITY], 1, SplineError::KnotsDecrease),
            (&[0.0, 0.1, 1.0, 1.0], 1, SplineError::NotClamped),
            (&[0.0, 0.0, 0.9, 1.0], 1, SplineError::NotClamped),
            (&[0.0, 0.0, 0.0, 1.0, 1.0], 1, SplineError::KnotMultiplicity),
            (&[0.0, 0.0, 1.0, 1.0, 1.0], 1, SplineError::KnotMultiplicity),
            (&[0.0, 0.0, 0.5, 0.5, 1.0, 1.0], 1, SplineError::KnotMultiplicity),
            (&[1.0; 8], 3, SplineError::KnotMultiplicity),
        ];
        for (knots, degree, error) in cases {
            assert_eq!(Knots::new(knots, degree).unwrap_err(), error, "{knots:?} of degree {degree}");
        }
        assert!(Knots::new(&[0.0, 0.0, 0.0, 0.5, 0.5, 1.0, 1.0, 1.0], 2).is_ok());
    }

    #[test]
    fn a_curve_begins_in_its_first_and_ends_in_its_last_control_point() {
        for degree in 1..=MAX_DEGREE {
            let mut knots = std::vec![-1.0; degree + 1];
            knots.extend([0.2, 0.3]);
            knots.extend(std::vec![2.0; degree + 1]);
            let knots = Knots::new(&knots, degree).unwrap();
            let start = knots.basis(-1.0).unwrap();
            assert_eq!((start.first, start.value[0]), (0, 1.0));
            let end = knots.basis(2.0).unwrap();
            assert_eq!((end.first + degree + 1, end.value[degree]), (knots.control_point_count(), 1.0));
        }
    }

    proptest! {
        #[test]
        fn values_follow_the_definition((knots, degree, u) in knots_and_parameter()) {
            let basis = Knots::new(&knots, degree).unwrap().basis(u).unwrap();
            prop_assume!(u < knots[knots.len() - 1]);
            for i in 0..knots.len() - degree - 1 {
                let value = i.checked_sub(basis.first).filter(|&i| i < basis.order).map_or(0.0, |i| basis.value[i]);
                prop_assert!((value - definition(&knots, i, degree, u)).abs() < 1e-13);
            }
        }

        #[test]
        fn values_are_a_partition_of_unity((knots, degree, u) in knots_and_parameter()) {
            let basis = Knots::new(&knots, degree).unwrap().basis(u).unwrap();
            prop_assert!(basis.value.iter().all(|&value| (0.0..=1.0).contains(&value)));
            prop_assert!((basis.value.iter().sum::<f64>() - 1.0).abs() < 1e-14);
            let scale = |values: &[f64]| values.iter().fold(1.0, |scale: f64, value| scale.max(value.abs()));
            for values in [basis.first_derivative, basis.second_derivative] {
                prop_assert!(values.iter().sum::<f64>().abs() < 1e-13 * scale(&values));
            }
            for values in [basis.value, basis.first_derivative, basis.second_derivative] {
                prop_assert!(values[basis.order..].iter().all(|&value| value == 0.0));
            }
        }

        #[test]
        fn derivatives_agree_with_differences_of_the_values((knots, degree, u) in knots_and_parameter()) {
            let step = 1e-5;
            let u = away_from_knots(&knots, u, 2.0 * step);
            let knots = Knots::new(&knots, degree).unwrap();
            let [before, here, after] = [u - step, u, u + step].map(|u| knots.basis(u).unwrap());
            for i in 0..MAX_ORDER {
                let first = (after.value[i] - before.value[i]) / (2.0 * step);
                let second = (after.first_derivative[i] - before.first_derivative[i]) / (2.0 * step);
                // Truncation of the central difference: a third or fourth derivative times step²/6.
                prop_assert!((here.first_derivative[i] - first).abs() < 2e-5 * (1.0 + first.abs()));
                prop_assert!((here.second_derivative[i] - second).abs() < 2e-4 * (1.0 + second.abs()));
            }
        }

        #[test]
        fn unchecked_knots_never_panic(
            knots in prop::collection::vec(prop_oneof![any::<f32>(), 0.0..2.0_f32], 0..16),
            degree in prop_oneof![0..8_usize, Just(usize::MAX)],
            u in prop_oneof![any::<f32>(), 0.0..2.0_f32],
        ) {
            let knots = Knots::assume_valid(&knots, degree);
            let inside = knots.start() <= u && u <= knots.end();
            prop_assert!(inside || knots.basis(u) == Err(SplineError::OutOfRange));
        }

        #[test]
        fn checked_knots_need_no_second_check((knots, degree, _) in knots_and_parameter()) {
            prop_assert_eq!(Knots::new(&knots, degree), Ok(Knots::assume_valid(&knots, degree)));
        }

        #[test]
        fn any_numbers_give_a_value_or_an_error(
            knots in prop::collection::vec(prop_oneof![any::<f32>(), Just(0.0), Just(1.0), Just(2.0)], 0..16),
            degree in 0..8_usize,
            u in prop_oneof![any::<f32>(), 0.0..2.0_f32],
        ) {
            let mut knots = knots;
            knots.sort_by(f32::total_cmp);
            if let Ok(knots) = Knots::new(&knots, degree) {
                prop_assert_eq!(knots.basis(u).is_ok(), (knots.start()..=knots.end()).contains(&u));
            }
        }
    }
}

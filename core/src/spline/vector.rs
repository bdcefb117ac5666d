//! B-spline curves in space: `C(u) = Σ N_i(u) P_i` (*The NURBS Book*, algorithms A3.1 and A3.2).

use nalgebra::{RealField, Vector3};

use super::Basis;

/// One point of a curve in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VectorSample<T> {
    /// `C(u)`.
    pub value: Vector3<T>,
    /// `C'(u)`, per unit of `u`.
    pub first_derivative: Vector3<T>,
    /// `C''(u)`, per squared unit of `u`.
    pub second_derivative: Vector3<T>,
}

/// Returns the point at `basis` of the curve with the control points `control` (all of them); `None` if there are too
/// few.
pub fn evaluate<T: RealField + Copy>(basis: &Basis<T>, control: &[Vector3<T>]) -> Option<VectorSample<T>> {
    let control = basis.select(control)?;
    let mut sample = VectorSample {
        value: Vector3::zeros(),
        first_derivative: Vector3::zeros(),
        second_derivative: Vector3::zeros(),
    };
    let weights = basis.value.iter().zip(&basis.first_derivative).zip(&basis.second_derivative);
    for (point, ((value, first_derivative), second_derivative)) in control.iter().zip(weights) {
        sample.value += point * *value;
        sample.first_derivative += point * *first_derivative;
        sample.second_derivative += point * *second_derivative;
    }
    Some(sample)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::Knots;
    use super::super::tests::{away_from_knots, knots_and_parameter};
    use super::*;

    /// De Boor's algorithm, which works on control points and needs no basis functions.
    fn de_boor(knots: &[f64], degree: usize, control: &[Vector3<f64>], u: f64) -> Vector3<f64> {
        let span = (degree..control.len()).rfind(|&k| knots[k] <= u && knots[k] < knots[k + 1]).unwrap();
        let mut points = control[span - degree..=span].to_vec();
        for level in 1..=degree {
            for j in (level..=degree).rev() {
                let (low, high) = (knots[span - degree + j], knots[span + 1 + j - level]);
                let share = (u - low) / (high - low);
                points[j] = points[j - 1] * (1.0 - share) + points[j] * share;
            }
        }
        points[degree]
    }

    fn point() -> impl Strategy<Value = Vector3<f64>> {
        [-1.0..1.0_f64, -1.0..1.0_f64, -1.0..1.0_f64].prop_map(Vector3::from)
    }

    proptest! {
        #[test]
        fn agrees_with_de_boor(
            (knots, degree, u) in knots_and_parameter(),
            points in prop::collection::vec(point(), 48),
        ) {
            let checked = Knots::new(&knots, degree).unwrap();
            let points = &points[..checked.control_point_count()];
            let sample = evaluate(&checked.basis(u).unwrap(), points).unwrap();
            prop_assert!((sample.value - de_boor(&knots, degree, points, u)).norm() < 1e-13);
        }

        #[test]
        fn derivatives_agree_with_central_differences(
            (knots, degree, u) in knots_and_parameter(),
            points in prop::collection::vec(point(), 48),
        ) {
            let step = 1e-5;
            let u = away_from_knots(&knots, u, 2.0 * step);
            let knots = Knots::new(&knots, degree).unwrap();
            let [before, here, after] =
                [u - step, u, u + step].map(|u| evaluate(&knots.basis(u).unwrap(), &points).unwrap());
            let first = (after.value - before.value) / (2.0 * step);
            let second = (after.first_derivative - before.first_derivative) / (2.0 * step);
            prop_assert!((here.first_derivative - first).norm() < 2e-5 * (1.0 + first.norm()));
            prop_assert!((here.second_derivative - second).norm() < 2e-4 * (1.0 + second.norm()));
        }
    }

    #[test]
    fn too_few_control_points_are_rejected() {
        let knots = [0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0];
        let basis = Knots::new(&knots, 2).unwrap().basis(1.5).unwrap();
        assert!(evaluate(&basis, &[Vector3::zeros(); 3]).is_none());
        assert!(evaluate(&basis, &[Vector3::zeros(); 4]).is_some());
    }
}

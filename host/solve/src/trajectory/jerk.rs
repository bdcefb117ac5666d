//! The third derivative of a trajectory (jerk): the change of its acceleration.
//!
//! The derivative of a curve of degree p with control points P is one of degree p − 1 with control points p (Pᵢ₊₁ − Pᵢ) / (uᵢ₊ₚ₊₁
//! − uᵢ₊₁) (*The NURBS Book*, equation 3.4). Applied three times, this yields, for p = 3, the jerk in every knot span. For
//! rotations, the rotation vectors from each control point to the next replace the first differences.

use evcal_core::spline::rotation::{log, right_jacobian_inverse};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::{RotationControl, Trajectory};

/// One control point of the third derivative, with its derivatives by the control points of the trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jerk {
    /// First of the four control points that it depends on.
    pub first: usize,
    /// Time over which it counts (s).
    pub duration: f64,
    /// Middle of the time over which it counts (s).
    pub t: f64,
    /// Jerk of the rotation (rad/s³, camera frame), then of the camera centre (m/s³).
    pub value: [f64; 6],
    /// Derivative of the rotation's jerk by the rotation of each control point (camera frame).
    pub by_rotation: [Matrix3<f64>; 4],
    /// Derivative of the centre's jerk by the centre of each control point, a multiple of unity.
    pub by_translation: [f64; 4],
}

/// Returns the jerks of `trajectory` in order of time; empty if its degree is below 3.
pub fn jerks(trajectory: &Trajectory) -> Vec<Jerk> {
    let degree = trajectory.degree;
    if degree < 3 {
        return Vec::new();
    }
    let turns = turns(&trajectory.rotation);
    let points = trajectory.translation.windows(4).zip(turns.windows(3));
    points
        .enumerate()
        .filter_map(|(first, (points, turns))| {
            let knots = trajectory.knots.get(first..=first + degree + 3)?;
            let factors = third_derivative(knots, degree)?;
            let [before, middle, after] = factors;
            let by_translation = [-before, before - middle, middle - after, after];
            let moving: Vector3<f64> = points.iter().zip(by_translation).map(|(point, weight)| point * weight).sum();
            let turning: Vector3<f64> = turns.iter().zip(factors).map(|(turn, factor)| turn * factor).sum();
            let mut by_rotation = [Matrix3::zeros(); 4];
            for (place, (turn, factor)) in turns.iter().zip(factors).enumerate() {
                by_rotation[place] -= right_jacobian_inverse(&-turn) * factor;
                by_rotation[place + 1] += right_jacobian_inverse(turn) * factor;
            }
            let (start, end) = (*knots.get(3)?, *knots.get(degree + 1)?);
            let value = [turning.x, turning.y, turning.z, moving.x, moving.y, moving.z];
            let duration = (end - start) / (degree - 2) as f64;
            Some(Jerk { first, duration, t: 0.5 * (start + end), value, by_rotation, by_translation })
        })
        .collect()
}

/// Returns the weights of three neighbouring first differences of control points in the third derivative. `knots`
/// begins with the first knot of the first of these control points. `None` if knots coincide.
fn third_derivative(knots: &[f64], degree: usize) -> Option<[f64; 3]> {
    let slope = |first: usize, order: usize| {
        let length = knots.get(first + degree + 1)? - knots.get(first + order)?;
        (length > 0.0).then(|| (degree + 1 - order) as f64 / length)
    };
    let steps = [slope(0, 1)?, slope(1, 1)?, slope(2, 1)?];
    let bends = [slope(0, 2)?, slope(1, 2)?];
    let last = slope(0, 3)?;
    Some([last * bends[0] * steps[0], -last * (bends[0] + bends[1]) * steps[1], last * bends[1] * steps[2]])
}

/// Returns the rotation vectors from each control point to the next (rad, camera frame).
pub fn turns(control: &RotationControl) -> Vec<Vector3<f64>> {
    let turn = |a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>| log(&(a.inverse() * b));
    let of_units = |units: &[UnitQuaternion<f64>]| units.windows(2).map(|pair| turn(&pair[0], &pair[1])).collect();
    match control {
        RotationControl::Quaternion(control) => {
            let units: Vec<_> = control.iter().map(|point| UnitQuaternion::new_normalize(*point)).collect();
            of_units(&units)
        }
        RotationControl::So3(control) => of_units(control),
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::spline::rotation::exp;

    use super::*;

    fn trajectory() -> Trajectory {
        let knots = vec![0.0, 0.0, 0.0, 0.0, 0.1, 0.3, 0.4, 0.4, 0.4, 0.4];
        let control =
            (0..6).map(|index| f64::from(index * index % 5)).map(|s| exp(&Vector3::new(0.1 * s, 0.2, -0.05 * s)));
        Trajectory {
            recording: 0,
            knots,
            degree: 3,
            translation: (0..6)
                .map(|index| Vector3::new(f64::from(index * index % 7), 0.3, f64::from(index)))
                .collect(),
            rotation: RotationControl::So3(control.collect()),
        }
    }

    #[test]
    fn the_jerk_of_the_centre_is_the_third_derivative_of_the_curve() {
        let trajectory = trajectory();
        let step = 0.01;
        for jerk in jerks(&trajectory) {
            let at = |steps: f64| trajectory.sample(jerk.t + steps * step).unwrap().linear_velocity;
            let numeric = (at(1.0) - at(0.0) * 2.0 + at(-1.0)) / (step * step);
            let value = Vector3::new(jerk.value[3], jerk.value[4], jerk.value[5]);
            assert!((value - numeric).norm() < 1e-6 * numeric.norm().max(1.0), "{value} {numeric}");
        }
        assert_eq!(jerks(&trajectory).iter().map(|jerk| jerk.duration).sum::<f64>(), 0.4);
    }

    #[test]
    fn derivatives_of_the_jerk_agree_with_differences() {
        let trajectory = trajectory();
        let found = jerks(&trajectory);
        for parameter in 0..36 {
            let mut delta = vec![0.0; 36];
            let mut at = |step: f64| {
                delta[parameter] = step;
                let mut moved = trajectory.clone();
                moved.update(&delta);
                jerks(&moved)
            };
            let (plus, minus) = (at(1e-6), at(-1e-6));
            let (point, axis) = (parameter / 6, parameter % 6);
            for ((jerk, plus), minus) in found.iter().zip(&plus).zip(&minus) {
                for row in 0..6 {
                    let numeric = (plus.value[row] - minus.value[row]) / 2e-6;
                    let analytic = match point.checked_sub(jerk.first) {
                        Some(place) if place < 4 && axis < 3 && row < 3 => jerk.by_rotation[place][(row, axis)],
                        Some(place) if place < 4 && axis == row => jerk.by_translation[place],
                        _ => 0.0,
                    };
                    assert!((numeric - analytic).abs() < 1e-4 * analytic.abs().max(100.0), "{numeric} {analytic}");
                }
            }
        }
    }
}

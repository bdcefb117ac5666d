//! A prior on the acceleration of a trajectory for times without events: a hand cannot accelerate without bounds.
//!
//! While the board hardly moves, there are hardly any events, and the ends of a segment would diverge. Each three neighbouring
//! control points c therefore have an acceleration (of the centre, and of the rotation as the difference of the rotation vectors
//! between neighbours), at their Greville abscissae g:
//!
//! a = 2 ((c₂ − c₁) / (g₂ − g₁) − (c₁ − c₀) / (g₁ − g₀)) / (g₂ − g₀),
//!
//! and the cost is a² / (2 σ²), with σ far above the uncertainty that events leave.

use super::control_band::Block;
use crate::trajectory::Trajectory;
use crate::trajectory::jerk::turns;
use crate::trajectory::knots::greville;

/// Typical acceleration of the camera (m/s², σ of a weak prior); it matters only at times without events.
const ACCELERATION: f64 = 100.0;
/// The same for the angular acceleration (rad/s²).
const ANGULAR_ACCELERATION: f64 = 300.0;

/// One acceleration in units of its σ, and its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Acceleration {
    /// First of the three control points.
    pub first: usize,
    /// Rotation (camera frame), then translation.
    pub residual: [f64; 6],
    /// Derivative of the rotation's residual by each control point's rotation, a multiple of unity.
    pub rotation: [f64; 3],
    /// Derivative of the translation's residual by each control point's translation, a multiple of unity.
    pub translation: [f64; 3],
}

impl Acceleration {
    /// Adds the acceleration to the normal equations of a segment whose control points act together in groups of `order`:
    /// `blocks` of a control point with itself and those before it, and `gradient`. Returns the added cost.
    pub fn add_to(&self, order: usize, blocks: &mut [Block], gradient: &mut [[f64; 6]]) -> f64 {
        let cost = 0.5 * self.residual.iter().map(|value| value * value).sum::<f64>();
        let weight = |point: usize, axis: usize| if axis < 3 { self.rotation[point] } else { self.translation[point] };
        // The acceleration couples three control points; a spline of degree 1 couples two.
        if order < 3 {
            return cost;
        }
        for row in 0..3 {
            let index = self.first + row;
            let Some(gradient) = gradient.get_mut(index) else { return cost };
            for (axis, (sum, residual)) in gradient.iter_mut().zip(self.residual).enumerate() {
                *sum += weight(row, axis) * residual;
            }
            for column in 0..=row {
                let Some(block) = blocks.get_mut(index * order + row - column) else { return cost };
                for axis in 0..6 {
                    block[(axis, axis)] += weight(row, axis) * weight(column, axis);
                }
            }
        }
        cost
    }
}

/// Returns the accelerations of all control points of `trajectory`.
pub fn accelerations(trajectory: &Trajectory) -> Vec<Acceleration> {
    let abscissae = greville(&trajectory.knots, trajectory.degree);
    let turns = turns(&trajectory.rotation);
    let factors = abscissae.windows(3).map(|three| {
        let half = 0.5 * (three[2] - three[0]);
        [1.0 / ((three[1] - three[0]) * half), 1.0 / ((three[2] - three[1]) * half)]
    });
    factors
        .zip(trajectory.translation.windows(3))
        .zip(turns.windows(2))
        .enumerate()
        .map(|(first, (([before, after], points), turns))| {
            let weights = |sigma: f64| [before / sigma, -(before + after) / sigma, after / sigma];
            let (rotation, translation) = (weights(ANGULAR_ACCELERATION), weights(ACCELERATION));
            let turning = turns[1] * rotation[2] - turns[0] * rotation[0];
            let moving = points[0] * translation[0] + points[1] * translation[1] + points[2] * translation[2];
            let residual = [turning.x, turning.y, turning.z, moving.x, moving.y, moving.z];
            Acceleration { first, residual, rotation, translation }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::trajectory::RotationControl;

    fn trajectory(place: impl Fn(f64) -> f64) -> Trajectory {
        let mut trajectory = Trajectory {
            recording: 0,
            knots: vec![0.0, 0.0, 0.0, 0.0, 0.1, 0.3, 0.4, 0.4, 0.4, 0.4],
            degree: 3,
            translation: Vec::new(),
            rotation: RotationControl::So3(Vec::new()),
        };
        let abscissae = greville(&trajectory.knots, trajectory.degree);
        trajectory.translation = abscissae.iter().map(|&t| Vector3::new(place(t), 0.0, 1.0)).collect();
        let units = abscissae.iter().map(|&t| UnitQuaternion::from_euler_angles(0.0, place(t), 0.0));
        trajectory.rotation = RotationControl::So3(units.collect());
        trajectory
    }

    #[test]
    fn constant_velocity_costs_nothing_and_acceleration_agrees_with_the_curve() {
        for found in accelerations(&trajectory(|t| 0.2 + 3.0 * t)) {
            assert!(found.residual.iter().all(|value| value.abs() < 1e-11), "{:?}", found.residual);
        }
        let found = accelerations(&trajectory(|t| 2.0 * t * t));
        assert_eq!(found.len(), 4);
        for found in found {
            assert!((found.residual[3] - 4.0 / 100.0).abs() < 1e-11, "{:?}", found.residual);
            assert!((found.residual[1] - 4.0 / 300.0).abs() < 1e-11, "{:?}", found.residual);
        }
    }
}

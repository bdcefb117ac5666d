//! Interpolation of the camera's pose.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::error::MotionCaptureError;
use evcal_geometry::numerics::statistics::median;
use evcal_geometry::timed_pose::TimedPose;

/// Longest median time between poses for interpolation (s).
const LONGEST_INTERVAL: f64 = 0.021;
/// Time between poses, in median intervals, from which there is a gap.
const GAP: f64 = 2.5;
/// Number of poses of a cubic.
const NODES: usize = 4;

/// Pose and velocities of the camera at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// `T_world_camera` (m).
    pub pose: Isometry3<f64>,
    /// Velocity of the camera's centre (m/s, axes of the world).
    pub velocity: Vector3<f64>,
    /// Angular velocity (rad/s, axes of the camera).
    pub angular_velocity: Vector3<f64>,
}

/// Poses of a camera, dense enough for cubics between them.
#[derive(Clone, Copy, Debug)]
pub struct Path<'a> {
    poses: &'a [TimedPose],
    /// Longest time between neighbours (s).
    longest: f64,
}

impl<'a> Path<'a> {
    /// Creates the path through `poses`, which are in order of time.
    ///
    /// # Errors
    /// [`MotionCaptureError::Sparse`] if they are too far apart.
    pub fn new(poses: &'a [TimedPose]) -> Result<Self, MotionCaptureError> {
        let mut intervals: Vec<f64> = poses.windows(2).map(|pair| pair[1].t - pair[0].t).collect();
        let interval = median(&mut intervals, f64::total_cmp).unwrap_or(f64::INFINITY);
        if interval > LONGEST_INTERVAL {
            return Err(MotionCaptureError::Sparse { interval });
        }
        Ok(Self { poses, longest: GAP * interval })
    }

    /// Returns the time of the first pose (s).
    pub fn start(&self) -> f64 {
        self.poses.first().map_or(0.0, |first| first.t)
    }

    /// Returns the camera at `t` seconds; `None` outside the poses, in a gap and next to one.
    ///
    /// The position is a cubic through the two poses before and the two after; the rotation is a cubic of rotation vectors
    /// relative to the pose before.
    pub fn at(&self, t: f64) -> Option<Moment> {
        let after = self.poses.partition_point(|pose| pose.t <= t);
        let nodes: &[TimedPose; NODES] = self.poses.get(after.checked_sub(2)?..after + 2)?.try_into().ok()?;
        if nodes.windows(2).any(|pair| pair[1].t - pair[0].t > self.longest) {
            return None;
        }
        let base = nodes[1].pose.rotation;
        let (mut position, mut velocity) = (Vector3::zeros(), Vector3::zeros());
        let (mut turn, mut turning) = (Vector3::zeros(), Vector3::zeros());
        for (node, (weight, slope)) in nodes.iter().zip(weights(&nodes.each_ref().map(|node| node.t), t)) {
            let rotation = (base.inverse() * node.pose.rotation).scaled_axis();
            position += node.pose.translation.vector * weight;
            velocity += node.pose.translation.vector * slope;
            turn += rotation * weight;
            turning += rotation * slope;
        }
        // The right Jacobian of the exponential, to second order.
        let angular_velocity = turning - turn.cross(&turning) * 0.5 + turn.cross(&turn.cross(&turning)) / 6.0;
        let rotation = base * UnitQuaternion::from_scaled_axis(turn);
        Some(Moment { pose: Isometry3::from_parts(Translation3::from(position), rotation), velocity, angular_velocity })
    }
}

/// Returns Lagrange's polynomials on `nodes` at `t`, and their derivatives.
fn weights(nodes: &[f64; NODES], t: f64) -> [(f64, f64); NODES] {
    std::array::from_fn(|index| {
        let others = || nodes.iter().enumerate().filter(move |(other, _)| *other != index).map(|(_, node)| *node);
        let below: f64 = others().map(|node| nodes[index] - node).product();
        let value: f64 = others().map(|node| t - node).product();
        let slope: f64 = (0..NODES)
            .filter(|left_out| *left_out != index)
            .map(|left_out| {
                let rest = nodes.iter().enumerate().filter(|(other, _)| *other != index && *other != left_out);
                rest.map(|(_, node)| t - node).product::<f64>()
            })
            .sum();
        (value / below, slope / below)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(t: f64) -> Isometry3<f64> {
        let turn = Vector3::new(0.4 * (5.0 * t).sin(), 0.3 * (7.0 * t).cos(), 0.5 * (3.0 * t).sin());
        Isometry3::new(Vector3::new(0.1 * (6.0 * t).sin(), 0.05 * (9.0 * t).cos(), -0.6 + 0.02 * t), turn)
    }

    fn poses() -> Vec<TimedPose> {
        (0..400).map(|index| 0.005 * f64::from(index)).map(|t| TimedPose { t, pose: pose(t) }).collect()
    }

    #[test]
    fn poses_and_velocities_agree_with_the_motion() {
        let poses = poses();
        let path = Path::new(&poses).unwrap();
        let step = 1e-5;
        for index in 0..300 {
            let t = 0.01 + 0.006_1 * f64::from(index);
            let (found, wanted) = (path.at(t).unwrap(), pose(t));
            assert!((found.pose.translation.vector - wanted.translation.vector).norm() < 2e-7);
            assert!(found.pose.rotation.angle_to(&wanted.rotation) < 2e-6);
            let (before, after) = (pose(t - step), pose(t + step));
            let velocity = (after.translation.vector - before.translation.vector) / (2.0 * step);
            let turning = (before.rotation.inverse() * after.rotation).scaled_axis() / (2.0 * step);
            assert!((found.velocity - velocity).norm() < 2e-4, "{} {velocity}", found.velocity);
            assert!((found.angular_velocity - turning).norm() < 2e-3, "{} {turning}", found.angular_velocity);
        }
    }

    #[test]
    fn there_is_no_pose_in_gaps_and_outside() {
        let mut poses = poses();
        poses.drain(100..110);
        let path = Path::new(&poses).unwrap();
        assert!(path.at(-0.1).is_none() && path.at(3.0).is_none() && path.at(0.52).is_none());
        assert!(path.at(0.48).is_some() && path.at(0.57).is_some());
        let sparse: Vec<TimedPose> = poses.into_iter().step_by(10).collect();
        assert!(matches!(Path::new(&sparse), Err(MotionCaptureError::Sparse { .. })));
    }
}

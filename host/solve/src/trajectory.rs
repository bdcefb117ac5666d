//! Continuous trajectories of the camera, one spline per segment (section 7 of method.md).
//!
//! A trajectory is a clamped B-spline of degree 1 to 5 on non-uniform knots (seconds) for the pose `T_world_camera`: a curve in
//! space for the camera centre and, on the same knots, a curve of rotations, either normalised quaternion sums or a cumulative
//! curve on SO(3) (paper III-C; [`evcal_core::spline`]). [`knots`] computes the knots from the times of the poses, [`fit`] the
//! control points from the poses. Evaluation never panics: outside its knots a trajectory has no pose.

pub mod alignment;
pub mod first;
pub mod fit;
pub mod jerk;
pub mod knot_grid;
pub mod knots;
pub mod segment;
pub mod settings;

use std::fmt;
use std::str::FromStr;

use evcal_core::spline::rotation::exp;
use evcal_core::spline::{Basis, Knots, RotationSample, SplineError, quaternion, so3, vector};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// Returns the mean distance of the camera from the plane of the board along `trajectories` (m).
pub fn mean_distance(trajectories: &[Trajectory]) -> f64 {
    let points = || trajectories.iter().flat_map(|trajectory| &trajectory.translation);
    points().map(|point| point.z.abs()).sum::<f64>() / points().count().max(1) as f64
}

/// The kind of rotation curve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum RotationSpline {
    /// Normalised sums of quaternions (Kang and Park 1999), the faster one.
    #[default]
    Quaternion,
    /// Cumulative products on SO(3) (Sommer et al. 2016, 2020).
    So3,
}

impl fmt::Display for RotationSpline {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Quaternion => "quaternion",
            Self::So3 => "so3",
        })
    }
}

/// The name of a rotation spline is unknown.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("rotation spline {0:?}: write quaternion or so3")]
pub struct RotationSplineError(String);

impl FromStr for RotationSpline {
    type Err = RotationSplineError;

    fn from_str(text: &str) -> Result<Self, RotationSplineError> {
        match text {
            "quaternion" => Ok(Self::Quaternion),
            "so3" => Ok(Self::So3),
            _ => Err(RotationSplineError(text.to_owned())),
        }
    }
}

/// Reasons why no trajectory could be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    /// Fewer poses than a spline of this degree has control points in a single span.
    #[error("a trajectory of degree {degree} needs at least {} poses, not {found}", degree + 1)]
    TooFewPoses {
        /// Degree of the spline.
        degree: usize,
        /// Number of poses given.
        found: usize,
    },
    /// The number of control points does not suit the degree and the number of poses.
    #[error("{found} control points do not suit a spline of degree {degree} through {poses} poses: {} to {poses} would", degree + 1)]
    ControlPointCount {
        /// Requested number of control points.
        found: usize,
        /// Degree of the spline.
        degree: usize,
        /// Number of poses given.
        poses: usize,
    },
    /// The times of the poses do not increase.
    #[error("pose {index} at {t} s is not later than the one before it")]
    TimesDoNotIncrease {
        /// Index of the pose.
        index: usize,
        /// Its time in seconds.
        t: f64,
    },
    /// A pose lies outside the requested range of the trajectory.
    #[error("pose at {t} s lies outside the trajectory from {start} s to {end} s")]
    PoseOutside {
        /// Time of the pose in seconds.
        t: f64,
        /// Requested start in seconds.
        start: f64,
        /// Requested end in seconds.
        end: f64,
    },
    /// A pose has numbers that are not finite.
    #[error("pose {index} has numbers that are not finite")]
    NotFinite {
        /// Index of the pose.
        index: usize,
    },
    /// The poses do not determine a control point.
    #[error("the poses do not determine control point {control_point} of the trajectory: use fewer control points")]
    Undetermined {
        /// Index of the control point.
        control_point: usize,
    },
    /// The knots are invalid for a spline.
    #[error("{0}")]
    Spline(#[from] SplineError),
}

/// Control points of the rotation.
#[derive(Clone, Debug, PartialEq)]
pub enum RotationControl {
    /// Control points of a quaternion spline, neighbours on the same half of the sphere; their lengths are weights.
    Quaternion(Vec<Quaternion<f64>>),
    /// Control points of an SO(3) spline.
    So3(Vec<UnitQuaternion<f64>>),
}

/// The pose `T_world_camera` over the time of one segment.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    /// Index of the recording that contains the segment.
    pub recording: usize,
    /// Clamped knots in seconds since the start of the recording.
    pub knots: Vec<f64>,
    /// Degree of the spline.
    pub degree: usize,
    /// Control points of the camera centre in world coordinates, metres.
    pub translation: Vec<Vector3<f64>>,
    /// Control points of R_world_camera, as many as of the translation.
    pub rotation: RotationControl,
}

/// A trajectory at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseSample {
    /// The control points concerned and their weights.
    pub basis: Basis<f64>,
    /// R_world_camera, its angular velocity in the camera frame (rad/s) and its Jacobians.
    pub rotation: RotationSample<f64>,
    /// Camera centre in world coordinates, metres.
    pub translation: Vector3<f64>,
    /// Velocity of the camera centre in world coordinates, m/s.
    pub linear_velocity: Vector3<f64>,
}

/// Number of parameters of a control point in [`Trajectory::update`].
pub const CONTROL_POINT_PARAMETERS: usize = 6;

impl Trajectory {
    /// Returns the first time of the trajectory in seconds.
    pub fn start(&self) -> f64 {
        self.curve_knots().start()
    }

    /// Returns the last time of the trajectory in seconds.
    pub fn end(&self) -> f64 {
        self.curve_knots().end()
    }

    /// Returns the number of control points.
    pub fn control_point_count(&self) -> usize {
        self.translation.len()
    }

    /// Returns the first of the control points that act at time `t` in seconds; `None` outside the trajectory.
    pub fn first_point(&self, t: f64) -> Option<usize> {
        self.curve_knots().find_span(t).ok()?.checked_sub(self.degree)
    }

    /// Returns pose, velocities and Jacobians at time `t` in seconds; `None` outside the trajectory, or if quaternions cancel.
    pub fn sample(&self, t: f64) -> Option<PoseSample> {
        let basis = self.curve_knots().basis(t).ok()?;
        let rotation = match &self.rotation {
            RotationControl::Quaternion(control) => quaternion::evaluate(&basis, control),
            RotationControl::So3(control) => so3::evaluate(&basis, control),
        }?;
        let vector = vector::evaluate(&basis, &self.translation)?;
        Some(PoseSample { basis, rotation, translation: vector.value, linear_velocity: vector.first_derivative })
    }

    /// Returns T_world_camera at time `t` in seconds; `None` if [`Trajectory::sample`] returns `None`.
    pub fn pose(&self, t: f64) -> Option<Isometry3<f64>> {
        let sample = self.sample(t)?;
        Some(Isometry3::from_parts(sample.translation.into(), sample.rotation.rotation))
    }

    /// Moves every control point. `delta` has [`CONTROL_POINT_PARAMETERS`] numbers per control point: a rotation vector δ
    /// (radians, camera frame: `q exp(δ)`), then a translation in metres.
    pub fn update(&mut self, delta: &[f64]) {
        let (parts, _) = delta.as_chunks::<CONTROL_POINT_PARAMETERS>();
        debug_assert_eq!(delta.len(), CONTROL_POINT_PARAMETERS * self.control_point_count());
        for (point, part) in self.translation.iter_mut().zip(parts) {
            *point += Vector3::new(part[3], part[4], part[5]);
        }
        let turns = parts.iter().map(|part| exp(&Vector3::new(part[0], part[1], part[2])));
        match &mut self.rotation {
            RotationControl::Quaternion(control) => {
                control.iter_mut().zip(turns).for_each(|(point, turn)| *point *= turn.into_inner());
            }
            RotationControl::So3(control) => {
                control.iter_mut().zip(turns).for_each(|(point, turn)| {
                    *point = UnitQuaternion::new_normalize(point.into_inner() * turn.into_inner());
                });
            }
        }
    }

    fn curve_knots(&self) -> Knots<'_, f64> {
        Knots::assume_valid(&self.knots, self.degree)
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::spline::rotation::log;

    use super::*;

    fn trajectories() -> [Trajectory; 2] {
        let control: Vec<UnitQuaternion<f64>> =
            (0..6).map(|i| exp(&Vector3::new(0.1, 0.2 * f64::from(i), -0.1 * f64::from(i % 3)))).collect();
        let quaternions = control.iter().map(|q| q.into_inner() * 1.1).collect();
        [RotationControl::Quaternion(quaternions), RotationControl::So3(control)].map(|rotation| Trajectory {
            recording: 0,
            knots: vec![1.0, 1.0, 1.0, 1.0, 1.3, 1.5, 2.0, 2.0, 2.0, 2.0],
            degree: 3,
            translation: (0..6).map(|i| Vector3::new(f64::from(i), 0.5, f64::from(i * i))).collect(),
            rotation,
        })
    }

    #[test]
    fn a_trajectory_has_poses_between_its_ends_and_none_outside() {
        for trajectory in trajectories() {
            assert_eq!((trajectory.start(), trajectory.end(), trajectory.control_point_count()), (1.0, 2.0, 6));
            for t in [1.0, 1.3, 1.7, 2.0] {
                assert!(trajectory.pose(t).is_some());
            }
            for t in [0.999, 2.001, f64::NAN, f64::INFINITY] {
                assert!(trajectory.pose(t).is_none());
            }
            let end = trajectory.pose(2.0).unwrap();
            assert!((end.translation.vector - Vector3::new(5.0, 0.5, 25.0)).norm() < 1e-12);
        }
    }

    #[test]
    fn velocities_are_derivatives_of_the_poses() {
        let step = 1e-6;
        for trajectory in trajectories() {
            let [before, after] = [1.4 - step, 1.4 + step].map(|t| trajectory.pose(t).unwrap());
            let sample = trajectory.sample(1.4).unwrap();
            let linear = (after.translation.vector - before.translation.vector) / (2.0 * step);
            let angular = log(&(before.rotation.inverse() * after.rotation)) / (2.0 * step);
            assert!((sample.linear_velocity - linear).norm() < 1e-7);
            assert!((sample.rotation.angular_velocity - angular).norm() < 1e-7);
        }
    }

    #[test]
    fn an_update_moves_the_pose_as_the_jacobians_predict() {
        for trajectory in trajectories() {
            let delta: Vec<f64> = (0..36).map(|i| 1e-5 * f64::from(i * i % 7 - 3)).collect();
            let mut moved = trajectory.clone();
            moved.update(&delta);
            for t in [1.0, 1.2, 1.45, 1.9] {
                let sample = trajectory.sample(t).unwrap();
                let mut turn = Vector3::zeros();
                let mut shift = Vector3::zeros();
                for index in 0..sample.basis.order {
                    let part = &delta[CONTROL_POINT_PARAMETERS * (sample.basis.first + index)..];
                    turn += sample.rotation.jacobians[index] * Vector3::new(part[0], part[1], part[2]);
                    shift += Vector3::new(part[3], part[4], part[5]) * sample.basis.value[index];
                }
                let (before, after) = (trajectory.pose(t).unwrap(), moved.pose(t).unwrap());
                assert!((log(&(before.rotation.inverse() * after.rotation)) - turn).norm() < 1e-9);
                assert!((after.translation.vector - before.translation.vector - shift).norm() < 1e-13);
            }
        }
    }

    #[test]
    fn names_of_rotation_splines_are_read_and_written() {
        for rotation in [RotationSpline::Quaternion, RotationSpline::So3] {
            assert_eq!(rotation.to_string().parse(), Ok(rotation));
            assert_eq!(serde_json::to_string(&rotation).unwrap(), format!("\"{rotation}\""));
        }
        let error = "euler".parse::<RotationSpline>().unwrap_err();
        assert_eq!(error.to_string(), "rotation spline \"euler\": write quaternion or so3");
    }
}

//! The poses of a calibration, each with its uncertainty.

pub mod csv;

use evcal_core::settings;
use evcal_core::settings::above;
use serde::{Deserialize, Serialize};

use evcal_geometry::timed_pose::TimedPose;
use evcal_solve::solve::State;
use evcal_solve::solve::equations::pose_covariance::{PoseCovariance, PoseSigma};
use evcal_solve::solve::left_out::{LeftOut, covers};

settings! {
    /// Selection of the poses that are written.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct PoseSettings {
        /// Poses per second in `trajectory.txt` and `trajectory.csv`.
        pub rate: f64 = 200.0, "Hz", above(0.0).at_most(10_000.0);
    }
}

/// Largest σ of the centre along any axis (m); poses with more are only in `trajectory.csv`.
const LARGEST_POSITION_SIGMA: f64 = 0.005;
/// Largest σ of the rotation about any axis (rad); poses with more are only in `trajectory.csv`.
const LARGEST_ROTATION_SIGMA: f64 = 0.01;
/// Largest ratio of the uncertainty to the usual one in the recording (the median); poses with more are only in `trajectory.csv`.
const LARGEST_WEAKNESS: f64 = 4.0;

/// A pose with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertainPose {
    /// Time in seconds since the start of the recording, and the pose.
    pub pose: TimedPose,
    /// Its standard deviation; `None` if it could not be determined.
    pub sigma: Option<PoseSigma>,
}

impl UncertainPose {
    /// Returns `true` if the pose is determined well enough; `false` if its σ is not known.
    pub fn is_determined(&self) -> bool {
        self.sigma.is_some_and(|sigma| {
            sigma.position.iter().all(|sigma| *sigma <= LARGEST_POSITION_SIGMA)
                && sigma.rotation.iter().all(|sigma| *sigma <= LARGEST_ROTATION_SIGMA)
                && sigma.weakness <= LARGEST_WEAKNESS
        })
    }
}

/// Returns the `poses` that are determined well enough.
pub fn determined(poses: &[UncertainPose]) -> impl Iterator<Item = TimedPose> {
    poses.iter().filter(|pose| pose.is_determined()).map(|pose| pose.pose)
}

/// Samples the poses along the trajectories of `recording` at whole multiples of one over the rate, in order of time, without the
/// excluded intervals.
pub fn sampled_poses(
    state: &State,
    covariance: &PoseCovariance,
    left_out: &[LeftOut],
    recording: usize,
    settings: &PoseSettings,
) -> Vec<UncertainPose> {
    let mut poses = Vec::new();
    for (segment, trajectory) in state.trajectories.iter().enumerate().filter(|(_, one)| one.recording == recording) {
        let first = (trajectory.start() * settings.rate).ceil() as i64;
        let last = (trajectory.end() * settings.rate).floor() as i64;
        poses.extend((first..=last).filter_map(|step| {
            let t = step as f64 / settings.rate;
            if covers(left_out, recording, t) {
                return None;
            }
            let pose = TimedPose { t, pose: trajectory.pose(t)? };
            Some(UncertainPose { pose, sigma: covariance.sigma(segment, trajectory, t) })
        }));
    }
    poses.sort_by(|a, b| a.pose.t.total_cmp(&b.pose.t));
    poses
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;

    use super::*;

    #[test]
    fn a_pose_must_be_determined_in_absolute_terms_and_relative_to_the_others() {
        let of = |position: f64, rotation: f64, weakness: f64| {
            let sigma = PoseSigma { position: [0.0, position, 0.0], rotation: [rotation, 0.0, 0.0], weakness };
            UncertainPose { pose: TimedPose { t: 0.0, pose: Isometry3::identity() }, sigma: Some(sigma) }
        };
        assert!(of(0.004, 0.009, 3.9).is_determined());
        assert!(!of(0.006, 0.0, 1.0).is_determined());
        assert!(!of(0.0, 0.011, 1.0).is_determined());
        assert!(!of(0.001, 0.001, 4.1).is_determined());
        assert!(!UncertainPose { sigma: None, ..of(0.0, 0.0, 1.0) }.is_determined());
    }
}

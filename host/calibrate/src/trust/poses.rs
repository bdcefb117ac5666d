//! The poses of a calibration, each with how sure it is.

pub mod csv;

use evcal_core::settings;
use evcal_core::settings::above;
use serde::{Deserialize, Serialize};

use crate::solve::State;
use crate::solve::left_out::{LeftOut, covers};
use crate::solve::pose_covariance::{PoseCovariance, PoseSigma};
use evcal_geometry::timed_pose::TimedPose;

settings! {
    /// Which poses are written.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct PoseSettings {
        /// Poses a second in `trajectory.txt` and `trajectory.csv`.
        pub rate: f64 = 200.0, "Hz", above(0.0).at_most(10_000.0);
        /// Poses whose centre is known worse than this along any axis are only in `trajectory.csv`.
        pub largest_position_sigma: f64 = 0.005, "m", above(0.0);
        /// The same for the rotation about any axis.
        pub largest_rotation_sigma: f64 = 0.01, "rad", above(0.0);
        /// Poses whose uncertainty is more than this many times the usual one in the recording (the median) are only in
        /// `trajectory.csv`, too.
        pub largest_weakness: f64 = 4.0, "", above(1.0);
    }
}

/// A pose with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UncertainPose {
    /// Time in seconds since the start of the recording, and the pose.
    pub pose: TimedPose,
    /// Its standard deviation; `None` where it could not be told.
    pub sigma: Option<PoseSigma>,
}

impl UncertainPose {
    /// Whether it is sure enough; a pose whose σ is not known is not.
    pub fn is_determined(&self, settings: &PoseSettings) -> bool {
        self.sigma.is_some_and(|sigma| {
            sigma.position.iter().all(|sigma| *sigma <= settings.largest_position_sigma)
                && sigma.rotation.iter().all(|sigma| *sigma <= settings.largest_rotation_sigma)
                && sigma.weakness <= settings.largest_weakness
        })
    }
}

/// Those of `poses` that are sure enough.
pub fn determined<'a>(poses: &'a [UncertainPose], settings: &'a PoseSettings) -> impl Iterator<Item = TimedPose> + 'a {
    poses.iter().filter(|pose| pose.is_determined(settings)).map(|pose| pose.pose)
}

/// The poses along the trajectories of `recording`, at whole multiples of one over the rate, in order of time, but for the
/// stretches that are left out.
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
    fn a_pose_must_be_sure_by_itself_and_among_the_others() {
        let settings = PoseSettings::default();
        let of = |position: f64, rotation: f64, weakness: f64| {
            let sigma = PoseSigma { position: [0.0, position, 0.0], rotation: [rotation, 0.0, 0.0], weakness };
            UncertainPose { pose: TimedPose { t: 0.0, pose: Isometry3::identity() }, sigma: Some(sigma) }
        };
        assert!(of(0.004, 0.009, 3.9).is_determined(&settings));
        assert!(!of(0.006, 0.0, 1.0).is_determined(&settings));
        assert!(!of(0.0, 0.011, 1.0).is_determined(&settings));
        assert!(!of(0.001, 0.001, 4.1).is_determined(&settings));
        assert!(!UncertainPose { sigma: None, ..of(0.0, 0.0, 1.0) }.is_determined(&settings));
    }
}

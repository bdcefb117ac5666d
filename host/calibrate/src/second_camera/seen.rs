//! Motion of a second camera before it is calibrated against the first: its poses, and its rotation rates.

use nalgebra::{Isometry3, Translation3};

use evcal_geometry::board::symmetry::Reflection;
use evcal_geometry::numerics::statistics::median;
use evcal_solve::trajectory::alignment::Rates;
use evcal_solve::trajectory::{PoseSample, Trajectory};

/// Step of the grid on which rotation rates are compared (s).
const STEP: f64 = 0.005;
/// Number of these steps between poses of a trajectory.
const POSE_STEPS: usize = 4;
/// Time at the ends of a trajectory that is excluded (s).
const MARGIN: f64 = 0.03;
/// Longest time between two frames over which the rotation is taken as uniform (s).
const EVENLY: f64 = 0.12;
/// Longest time between two frames of one segment, within which the orientation of the board cannot change (s).
const LONGEST_GAP: f64 = 0.3;

/// A pose of the second camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPose {
    /// Time of the second clock (s).
    pub t: f64,
    /// Index of the segment; the orientation of a symmetric board is the same for all poses of a segment.
    pub segment: usize,
    /// `T_world_camera`.
    pub pose: Isometry3<f64>,
}

/// The motion of the second camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Rotation rates of the camera.
    pub rates: Rates,
    /// Its poses in order of time.
    pub poses: Vec<SeenPose>,
    /// Time between poses (s).
    pub every: f64,
}

impl Seen {
    /// Returns the motion along trajectories.
    pub fn along(trajectories: &[Trajectory]) -> Self {
        let (start, end) = span(trajectories);
        let every = STEP * POSE_STEPS as f64;
        let count = if end > start { ((end - start) / every) as usize + 1 } else { 0 };
        let pose = |index: usize| {
            let t = start + every * index as f64;
            let (segment, sample) = inner_sample(trajectories, t)?;
            Some(SeenPose { t, segment, pose: pose_of(&sample) })
        };
        Self { rates: rates(trajectories), poses: (0..count).filter_map(pose).collect(), every }
    }

    /// Returns the motion from frames: times (s) and poses (`T_world_camera`), in order of time. The rotation between frames is
    /// taken as uniform.
    pub fn in_frames(frames: impl Iterator<Item = (f64, Isometry3<f64>)>) -> Self {
        let mut poses: Vec<SeenPose> = Vec::new();
        for (t, pose) in frames {
            let segment = poses.last().map_or(0, |last| last.segment + usize::from(t - last.t > LONGEST_GAP));
            poses.push(SeenPose { t, segment, pose });
        }
        let pairs = || poses.windows(2).filter_map(|pair| <&[SeenPose; 2]>::try_from(pair).ok());
        let mut gaps: Vec<f64> = pairs().map(|[before, after]| after.t - before.t).collect();
        let every = median(&mut gaps, f64::total_cmp).unwrap_or(0.0);
        let start = poses.first().map_or(0.0, |first| first.t);
        let mut rates = Vec::new();
        for [before, after] in pairs() {
            let gap = after.t - before.t;
            let rate = before.pose.rotation.angle_to(&after.pose.rotation) / gap;
            let until = ((after.t - start) / STEP).ceil() as usize;
            rates.resize(until.max(rates.len()), (gap < EVENLY).then_some(rate));
        }
        Self { rates: Rates { start, step: STEP, values: rates }, poses, every }
    }

    /// Returns the motion that the mirrored image of the same camera shows.
    pub fn seen_in_a_mirror(&self, reflection: &Reflection) -> Self {
        let mirrored = |seen: &SeenPose| SeenPose { pose: reflection.seen_in_a_mirror(&seen.pose), ..*seen };
        Self { poses: self.poses.iter().map(mirrored).collect(), ..self.clone() }
    }
}

/// Returns the index of the first trajectory that contains `t`, and its sample there.
pub fn sample_at(trajectories: &[Trajectory], t: f64) -> Option<(usize, PoseSample)> {
    trajectories.iter().enumerate().find_map(|(index, one)| Some((index, one.sample(t)?)))
}

/// Returns the same as [`sample_at`], but `None` at the ends of trajectories.
pub fn inner_sample(trajectories: &[Trajectory], t: f64) -> Option<(usize, PoseSample)> {
    sample_at(trajectories, t).filter(|(index, _)| {
        trajectories.get(*index).is_some_and(|one| t > one.start() + MARGIN && t < one.end() - MARGIN)
    })
}

/// Returns `T_world_camera`.
pub fn pose_of(sample: &PoseSample) -> Isometry3<f64> {
    Isometry3::from_parts(Translation3::from(sample.translation), sample.rotation.rotation)
}

/// Returns the first and the last time of trajectories (s).
fn span(trajectories: &[Trajectory]) -> (f64, f64) {
    let ends = trajectories.iter().map(|one| (one.start(), one.end()));
    ends.fold((f64::INFINITY, f64::NEG_INFINITY), |span, one| (span.0.min(one.0), span.1.max(one.1)))
}

/// Returns the rotation rates of a camera.
pub fn rates(trajectories: &[Trajectory]) -> Rates {
    let (start, end) = span(trajectories);
    Rates::new(start, end, STEP, |t| Some(inner_sample(trajectories, t)?.1.rotation.angular_velocity.norm()))
}

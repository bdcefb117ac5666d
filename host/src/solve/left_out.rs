//! Stretches of time that are left out of the solve and of the trajectory.

use serde::{Deserialize, Serialize};

use super::observation::EventBin;
use super::{Problem, State};

/// Why a stretch is left out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// No curve explains the events.
    Unexplained,
    /// The camera's readout was saturated: the events are late.
    Saturated,
}

/// A stretch of time that is left out.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Number of the recording.
    pub recording: usize,
    /// Start in seconds since the start of the recording.
    pub start: f64,
    /// End in seconds since the start of the recording.
    pub end: f64,
    /// Why.
    pub reason: Reason,
}

/// Whether time `t` (s) of `recording` lies in one of `stretches`.
pub fn covers(stretches: &[LeftOut], recording: usize, t: f64) -> bool {
    stretches.iter().any(|stretch| stretch.recording == recording && stretch.start <= t && t <= stretch.end)
}

/// Takes the observations in `stretches` out of `problem`.
pub fn leave_out(problem: &mut Problem, state: &State, stretches: &[LeftOut]) {
    for (observations, trajectory) in problem.segments.iter_mut().zip(&state.trajectories) {
        let outside = |t: f64| !covers(stretches, trajectory.recording, t);
        let mut events = Vec::with_capacity(observations.events.len());
        let mut bins = Vec::with_capacity(observations.bins.len());
        for bin in observations.bins.iter().filter(|bin| outside(bin.t)) {
            let first = events.len();
            events.extend_from_slice(observations.events.get(bin.first..bin.end).unwrap_or_default());
            bins.push(EventBin { t: bin.t, first, end: events.len() });
        }
        observations.points.retain(|point| outside(point.t));
        (observations.events, observations.bins) = (events, bins);
    }
}

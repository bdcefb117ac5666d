//! Intervals of time that are excluded from the solve and from the trajectory.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::Problem;
use super::State;

/// Reasons why an interval is excluded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// No curve explains the events.
    Unexplained,
    /// The camera's readout was saturated: the events are late.
    Saturated,
}

/// An excluded interval of time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// Number of the recording.
    pub recording: usize,
    /// Start in seconds since the start of the recording.
    pub start: f64,
    /// End in seconds since the start of the recording.
    pub end: f64,
    /// The reason.
    pub reason: Reason,
}

impl LeftOut {
    /// Returns the length in seconds.
    pub fn seconds(&self) -> f64 {
        self.end - self.start
    }

    /// Returns the length of the common time with `other` in seconds.
    pub fn seconds_within(&self, other: &Self) -> f64 {
        let common = self.end.min(other.end) - self.start.max(other.start);
        if self.recording == other.recording { common.max(0.0) } else { 0.0 }
    }
}

/// Prints start and end to a hundredth of a second.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} to {:.2} s", self.start, self.end)
    }
}

/// Returns `true` if time `t` (s) of `recording` lies in one of `intervals`.
pub fn covers(intervals: &[LeftOut], recording: usize, t: f64) -> bool {
    intervals.iter().any(|interval| interval.recording == recording && interval.start <= t && t <= interval.end)
}

/// Removes the observations in `intervals` from `problem`.
pub fn leave_out(problem: &mut Problem, state: &State, intervals: &[LeftOut]) {
    // Usually there is nothing to do, and there are many events.
    if intervals.is_empty() {
        return;
    }
    for (observations, trajectory) in problem.segments.iter_mut().zip(&state.trajectories) {
        let far = std::mem::take(&mut observations.far);
        *observations = observations.at_times(|t| !covers(intervals, trajectory.recording, t));
        observations.far = far;
    }
}

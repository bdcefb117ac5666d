//! Intervals of time that are excluded from the solve and from the trajectory.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::{Problem, State};

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

/// Prints start and end to a hundredth of a second.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} to {:.2} s", self.start, self.end)
    }
}

/// Returns `true` if time `t` (s) of `recording` lies in one of `stretches`.
pub fn covers(stretches: &[LeftOut], recording: usize, t: f64) -> bool {
    stretches.iter().any(|stretch| stretch.recording == recording && stretch.start <= t && t <= stretch.end)
}

/// Removes the observations in `stretches` from `problem`.
pub fn leave_out(problem: &mut Problem, state: &State, stretches: &[LeftOut]) {
    // Usually there is nothing to do, and there are many events.
    if stretches.is_empty() {
        return;
    }
    for (observations, trajectory) in problem.segments.iter_mut().zip(&state.trajectories) {
        let far = std::mem::take(&mut observations.far);
        *observations = observations.within(|t| !covers(stretches, trajectory.recording, t));
        observations.far = far;
    }
}

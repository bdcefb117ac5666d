//! Stretches of time that are left out of the solve and of the trajectory.

use std::fmt;

use serde::{Deserialize, Serialize};

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

/// When it is, to a hundredth of a second.
impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.2} to {:.2} s", self.start, self.end)
    }
}

/// Whether time `t` (s) of `recording` lies in one of `stretches`.
pub fn covers(stretches: &[LeftOut], recording: usize, t: f64) -> bool {
    stretches.iter().any(|stretch| stretch.recording == recording && stretch.start <= t && t <= stretch.end)
}

/// Takes the observations in `stretches` out of `problem`.
pub fn leave_out(problem: &mut Problem, state: &State, stretches: &[LeftOut]) {
    // Mostly there is nothing to do, and the events are many.
    if stretches.is_empty() {
        return;
    }
    for (observations, trajectory) in problem.segments.iter_mut().zip(&state.trajectories) {
        let far = std::mem::take(&mut observations.far);
        *observations = observations.within(|t| !covers(stretches, trajectory.recording, t));
        observations.far = far;
    }
}

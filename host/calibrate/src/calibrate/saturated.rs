//! Stretches with a saturated readout.

use crate::solve::left_out::LeftOut;
use event_recordings::pass::RecordingReport;

/// They are left out unless they are a larger part of the recordings than this.
const MOST_LEFT_OUT: f64 = 0.5;

/// Stretches with a saturated readout: one of the two is empty.
pub(super) struct Saturated {
    /// Those that the joint solve leaves out.
    pub(super) left_out: Vec<LeftOut>,
    /// Those that stay in it, for they are too large a part of the recordings.
    pub(super) kept: Vec<LeftOut>,
}

impl Saturated {
    pub(super) fn new(stretches: Vec<LeftOut>, recordings: &[RecordingReport]) -> Self {
        let duration = recordings.iter().map(|recording| recording.duration).sum::<f64>();
        let of_saturated: f64 = stretches.iter().map(|stretch| stretch.end - stretch.start).sum();
        if of_saturated <= MOST_LEFT_OUT * duration {
            Self { left_out: stretches, kept: Vec::new() }
        } else {
            Self { left_out: Vec::new(), kept: stretches }
        }
    }
}

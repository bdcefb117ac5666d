//! Intervals with a saturated readout.

use evcal_solve::solve::left_out::LeftOut;
use event_recordings::pass::RecordingReport;

/// Share of the recordings above which they are not excluded.
const MOST_LEFT_OUT: f64 = 0.5;

/// Intervals with a saturated readout: one of the two lists is empty.
pub(super) struct Saturated {
    /// Intervals that the joint solve excludes.
    pub(super) left_out: Vec<LeftOut>,
    /// Intervals that it includes, because they are too large a part of the recordings.
    pub(super) kept: Vec<LeftOut>,
}

impl Saturated {
    pub(super) fn new(intervals: Vec<LeftOut>, recordings: &[RecordingReport]) -> Self {
        let duration = recordings.iter().map(|recording| recording.duration).sum::<f64>();
        let of_saturated: f64 = intervals.iter().map(LeftOut::seconds).sum();
        if of_saturated <= MOST_LEFT_OUT * duration {
            Self { left_out: intervals, kept: Vec::new() }
        } else {
            Self { left_out: Vec::new(), kept: intervals }
        }
    }
}

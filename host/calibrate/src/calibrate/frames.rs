//! Selection of the reference frames for the joint solve, and of those that keep their events.

use super::interval_choice::{ChosenSeconds, IntervalChoice, second_of};
use evcal_detection::circles::compact_frame::CompactFrame;
use evcal_detection::circles::reference_frame::{ReferenceFrame, SeenIn};
use evcal_solve::initial::InitialModel;

/// All reference frames.
pub(super) struct Frames {
    /// Frames in the joint solve, in order of recording.
    pub(super) taken: Vec<ReferenceFrame>,
    /// Frames outside the joint solve.
    pub(super) others: Vec<CompactFrame>,
}

/// Selects the frames of circle inputs, and those of the `windows` in the chosen seconds.
pub(super) fn take_frames(
    windows: Vec<CompactFrame>,
    of_circles: Vec<ReferenceFrame>,
    choice: Option<&IntervalChoice>,
) -> Frames {
    let chosen = choice.map(ChosenSeconds::new);
    let (mut taken, mut others) = (of_circles, Vec::new());
    for mut window in windows {
        if chosen.as_ref().is_none_or(|chosen| chosen.has(window.recording, second_of(window.t()))) {
            taken.push(window.into());
        } else {
            window.seen_in = SeenIn::PassedEvents;
            others.push(window);
        }
    }
    taken.sort_by_key(|frame| frame.recording);
    Frames { taken, others }
}

/// Drops the events of all frames except those with the smallest, the median and the largest error, which the report shows. After
/// the first camera nothing else needs them.
pub(super) fn keep_examples(frames: &mut [ReferenceFrame], initial: &InitialModel) {
    let with_events = |frame: usize| frames.get(frame).is_some_and(ReferenceFrame::is_shown);
    let mut ranked: Vec<(f64, usize)> =
        initial.frames.iter().map(|posed| (posed.rms, posed.frame)).filter(|(_, frame)| with_events(*frame)).collect();
    ranked.sort_by(|a, b| a.0.total_cmp(&b.0));
    let last = ranked.len().saturating_sub(1);
    let shown = [0, last.div_ceil(2), last].map(|place| ranked.get(place).map(|(_, frame)| *frame));
    for (index, frame) in frames.iter_mut().enumerate() {
        if frame.is_shown() && !shown.contains(&Some(index)) {
            frame.seen_in = SeenIn::PassedEvents;
        }
    }
}

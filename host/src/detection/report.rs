//! What became of events, windows and circles.

use std::collections::BTreeMap;

use evcal_core::circle::CircleCounts;
use serde::Serialize;

/// What the detection took in and gave out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct DetectionReport {
    /// Events that came in.
    pub events: u64,
    /// Windows with too few events to be worth a try.
    pub too_few_events: u64,
    /// Windows tried.
    pub windows: u64,
    /// Windows in which the board was found.
    pub found: u64,
    /// Those of them in which only the frames around them told where the board lies.
    pub found_by_neighbours: u64,
    /// Circles found in all windows.
    pub circles: u64,
    /// Pairs of clusters that were refused, by reason.
    pub pairs_refused: BTreeMap<&'static str, u64>,
    /// Windows without a board, by reason.
    pub grids_refused: BTreeMap<&'static str, u64>,
    /// Windows in which something did not fit the detector's capacity.
    pub overflowed: u64,
    /// Circles of the frames found.
    pub board_circles: u64,
}

impl DetectionReport {
    /// Adds the counts of another part.
    pub fn add(&mut self, other: &Self) {
        self.events += other.events;
        self.too_few_events += other.too_few_events;
        self.windows += other.windows;
        self.found += other.found;
        self.found_by_neighbours += other.found_by_neighbours;
        self.circles += other.circles;
        self.overflowed += other.overflowed;
        self.board_circles += other.board_circles;
        for (reason, count) in &other.pairs_refused {
            *self.pairs_refused.entry(reason).or_default() += count;
        }
        for (reason, count) in &other.grids_refused {
            *self.grids_refused.entry(reason).or_default() += count;
        }
    }

    pub(super) fn count_pairs(&mut self, counts: &CircleCounts) {
        self.circles += u64::from(counts.circles);
        for (reason, count) in [
            ("back to back", counts.back_to_back),
            ("radius out of bounds", counts.radius_out_of_bounds),
            ("arc too short", counts.arc_too_short),
            ("radius against distance", counts.radius_against_distance),
            ("centre against midpoint", counts.center_against_midpoint),
            ("fit error", counts.error_too_large),
            ("not mutual", counts.not_mutual),
        ] {
            if count > 0 {
                *self.pairs_refused.entry(reason).or_default() += u64::from(count);
            }
        }
    }
}

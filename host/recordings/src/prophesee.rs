//! Recordings of Prophesee's software: RAW (EVT 2.0, 2.1, 3.0 and 4.0) and DAT.
//!
//! Both begin with lines `% key value`, which end with `% end` or at the first line of another form.

mod dat;
mod header;
mod raw;
mod write;

pub use dat::FORMAT as DAT_FORMAT;
pub use raw::FORMAT as RAW_FORMAT;
pub use write::{EVT4_OUTPUT, OUTPUT as RAW_OUTPUT};

use evcal_core::decode::EvtCounts;

use crate::read_report::ReadReport;

/// Stores the counts of the decoder in `report`.
pub(super) fn store_counts(counts: &EvtCounts, report: &mut ReadReport) {
    report.stream.clock_resets = counts.clock_resets.into();
    let faults = [
        ("events dropped because no valid time preceded them", counts.without_time),
        ("events dropped because no row preceded them", counts.without_row),
        (
            "time words taken as damaged: they jump by more than a second or far back, and the next ones do not confirm it",
            counts.false_leaps,
        ),
        ("jumps in time by more than a second that the next words confirm: data was lost", counts.leaps),
        ("words that the format does not define", counts.unknown),
    ];
    report.stream.faults =
        faults.into_iter().filter(|(_, count)| *count > 0).map(|(what, n)| (what, n.into())).collect();
}

/// Name under which triggers are counted.
pub(super) const TRIGGERS: &str = "triggers";

//! Recordings of Prophesee's software: RAW (EVT 2.0, 2.1 and 3.0) and DAT.
//!
//! Both begin with lines `% key value`, up to `% end` or to the first line that begins otherwise.

mod dat;
mod header;
mod raw;
mod write;

pub use dat::FORMAT as DAT_FORMAT;
pub use raw::FORMAT as RAW_FORMAT;
pub use write::OUTPUT as RAW_OUTPUT;

use evcal_core::decode::EvtCounts;

use crate::read_report::ReadReport;

/// Tells in `report` what the decoder met.
pub(super) fn tell(counts: &EvtCounts, report: &mut ReadReport) {
    report.stream.clock_resets = counts.clock_resets.into();
    let faults = [
        ("events left out for want of a time: none came before, or the last one was damaged", counts.without_time),
        ("events left out for want of a row: none came before", counts.without_row),
        (
            "words of time taken for damaged: they leap by more than a second or far back, and the next ones do not confirm it",
            counts.false_leaps,
        ),
        ("leaps in time by more than a second that the next words confirm: something was lost", counts.leaps),
        ("words that the format does not have", counts.unknown),
    ];
    report.stream.faults =
        faults.into_iter().filter(|(_, count)| *count > 0).map(|(what, n)| (what, n.into())).collect();
}

/// The name under which triggers are counted.
pub(super) const TRIGGERS: &str = "triggers";

//! Recordings of Prophesee's software: RAW (EVT 2.0, 2.1 and 3.0) and DAT.
//!
//! Both begin with lines `% key value`, up to `% end` or to the first line that begins otherwise.

mod dat;
mod header;
mod raw;
mod write;

pub use dat::FORMAT as DAT_FORMAT;
pub use raw::FORMAT as RAW_FORMAT;

use evcal_core::decode::EvtCounts;

use super::ReadReport;

/// Tells in `report` what the decoder met.
pub(super) fn tell(counts: &EvtCounts, report: &mut ReadReport) {
    report.stream.clock_resets = counts.clock_resets.into();
    let faults = [
        ("an event before the first time, or behind a damaged one", counts.without_time),
        ("an event before the first row", counts.without_row),
        ("a time that leaps and is not believed", counts.false_leaps),
        ("words lost for more than a second", counts.leaps),
        ("a word that the format does not have", counts.unknown),
    ];
    report.stream.faults =
        faults.into_iter().filter(|(_, count)| *count > 0).map(|(what, n)| (what, n.into())).collect();
}

/// The name under which triggers are counted.
pub(super) const TRIGGERS: &str = "triggers";

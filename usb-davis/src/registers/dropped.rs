//! The camera's counts of data that it dropped because the host read too slowly.

use super::{Register, RegisterSnapshot, dvs, mux};

/// Both halves of all drop counters.
pub const DROP_COUNTERS: [Register; 6] = [
    mux::EXTERNAL_INPUT_DROPPED,
    mux::EXTERNAL_INPUT_DROPPED.next(),
    mux::DVS_DROPPED,
    mux::DVS_DROPPED.next(),
    dvs::DROPPED,
    dvs::DROPPED.next(),
];

/// Number of items that a camera dropped in a period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Dropped {
    /// Pixel events, before the multiplexer and in it.
    pub events: u64,
    /// Signals at the connectors.
    pub signals: u64,
}

impl Dropped {
    /// Computes the difference from the registers at the beginning and at the end of the period. Unknown counters are
    /// taken as zero, their value when the camera is plugged in.
    pub fn between(beginning: &RegisterSnapshot, end: &RegisterSnapshot) -> Self {
        let count = |counter| {
            let [beginning, end] = [beginning, end].map(|registers| registers.counter(counter).unwrap_or(0));
            end.saturating_sub(beginning)
        };
        Self { events: count(mux::DVS_DROPPED) + count(dvs::DROPPED), signals: count(mux::EXTERNAL_INPUT_DROPPED) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_period_begins_at_the_value_of_the_counters() {
        let beginning = RegisterSnapshot::from_iter([(mux::DVS_DROPPED, 1), (mux::DVS_DROPPED.next(), u32::MAX)]);
        let end = [(mux::DVS_DROPPED, 2), (mux::DVS_DROPPED.next(), 3), (dvs::DROPPED, 0), (dvs::DROPPED.next(), 10)];
        let signals = [(mux::EXTERNAL_INPUT_DROPPED, 0), (mux::EXTERNAL_INPUT_DROPPED.next(), 7)];
        let end = RegisterSnapshot::from_iter(end.into_iter().chain(signals));
        assert_eq!(Dropped::between(&beginning, &end), Dropped { events: 4 + 10, signals: 7 });
        assert_eq!(Dropped::between(&end, &end), Dropped::default());
    }
}

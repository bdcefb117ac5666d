//! Division of events into bins of time.

use evcal_core::event::Event;

/// Divides `events`, which are in the order of time, into bins of `length` microseconds; returns the number and the events of
/// each bin.
pub(super) fn time_bins(mut events: &[Event], length: i64) -> impl Iterator<Item = (i64, &[Event])> {
    std::iter::from_fn(move || {
        let bin = events.first()?.t.div_euclid(length);
        let start = bin.saturating_mul(length);
        let times = start..start.saturating_add(length);
        let count = events.iter().skip(1).take_while(|event| times.contains(&event.t)).count();
        let (inside, later) = events.split_at(1 + count);
        events = later;
        Some((bin, inside))
    })
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    #[test]
    fn every_event_is_in_the_bin_of_its_time() {
        let times = [-1, 0, 5, 9, 10, 10, 29, 30, 12, i64::MAX];
        let events = times.map(|t| Event { t, x: 0, y: 0, polarity: Polarity::On });
        let found: Vec<(i64, usize)> = time_bins(&events, 10).map(|(bin, events)| (bin, events.len())).collect();
        let expected = [(-1, 1), (0, 3), (1, 2), (2, 1), (3, 1), (1, 1), (i64::MAX / 10, 1)];
        assert_eq!(found, expected);
    }
}

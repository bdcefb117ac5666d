//! Whether two recordings hold the same events.

use std::collections::BTreeSet;

use evcal_core::event::{Event, Polarity};

/// One of so many pairs of events is kept.
const KEPT: u64 = 4096;

/// A sample of the pairs of successive events, by their pixels, polarities and the time between: it stays the same when a
/// recording is cut, converted, or set to another clock.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fingerprint {
    last: Option<Event>,
    pairs: BTreeSet<u64>,
}

impl Fingerprint {
    /// Adds `events`, which follow those before.
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            if let Some(last) = self.last.replace(*event) {
                let pair = mixed(place(&last) << 32 | place(event)) ^ mixed(event.t.wrapping_sub(last.t) as u64);
                let pair = mixed(pair);
                if pair.is_multiple_of(KEPT) {
                    self.pairs.insert(pair);
                }
            }
        }
    }

    /// The share of the events that both hold, of those of the smaller one: 0 to 1.
    pub fn shared(&self, other: &Self) -> f64 {
        let fewest = self.pairs.len().min(other.pairs.len()).max(1);
        self.pairs.intersection(&other.pairs).count() as f64 / fewest as f64
    }
}

fn place(event: &Event) -> u64 {
    u64::from(event.x) << 17 | u64::from(event.y) << 1 | u64::from(event.polarity == Polarity::On)
}

/// The finalizer of SplitMix64 (Steele, Lea and Flood 2014): every bit depends on every bit.
fn mixed(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Events whose pixels look random, from number `first` on, a microsecond or two apart.
    fn events(seed: u64, range: std::ops::Range<u64>, clock: i64) -> Vec<Event> {
        range
            .map(|index| {
                let random = mixed(seed << 40 | (index + 1));
                let polarity = if random & 1 == 0 { Polarity::Off } else { Polarity::On };
                let (x, y) = ((random >> 8) % 346, (random >> 32) % 260);
                Event { t: clock + (2 * index + (random >> 60) % 2) as i64, x: x as u16, y: y as u16, polarity }
            })
            .collect()
    }

    fn fingerprint(parts: &[Vec<Event>]) -> Fingerprint {
        let mut fingerprint = Fingerprint::default();
        parts.iter().for_each(|part| fingerprint.push(part));
        fingerprint
    }

    #[test]
    fn the_same_events_are_known_again_whatever_the_clock_and_the_batches() {
        let whole = fingerprint(&[events(1, 0..400_000, 0)]);
        let again = fingerprint(&[events(1, 0..1000, 7_000_000), events(1, 1000..400_000, 7_000_000)]);
        assert_eq!(whole.shared(&again), 1.0);
        // The second half of one, with as much again of something else.
        let half = fingerprint(&[events(1, 200_000..400_000, 0), events(2, 400_000..600_000, 0)]);
        let share = half.shared(&whole);
        assert!((0.35..0.65).contains(&share), "{share}");
    }

    #[test]
    fn other_events_at_the_same_times_are_others() {
        let share = fingerprint(&[events(1, 0..400_000, 0)]).shared(&fingerprint(&[events(3, 0..400_000, 0)]));
        assert_eq!(share, 0.0);
    }
}

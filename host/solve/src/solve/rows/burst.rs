//! The rank of an event in its burst, and the length of the burst.
//!
//! When the edge of a dot crosses a pixel, the pixel fires several events of one polarity, one for each contrast threshold that
//! its log intensity passes. The k-th event of such a burst happens at a definite level of the blurred edge, so its distance from
//! the geometric edge is nearly the same for all pixels, while it differs by up to two pixels between ranks. An event with a
//! known rank is therefore several times as precise.
//!
//! A pixel compares the light with its level at its last event, so the position on the edge at which a burst begins
//! depends on where the previous burst ended. The number of events of the whole burst explains most of this: a burst
//! that begins late on the edge has room for fewer events. The share of short bursts depends on speed, distance and
//! position on the sensor, so that without the lengths the mean of a rank would change with these.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use serde::{Deserialize, Serialize};

use evcal_detection::diagnosis::double_edges::{CLOSE, FirstIntervals, OCTAVES};
use evcal_detection::diagnosis::lost_events::BurstPairs;

/// Largest rank with a class of its own; later events of a burst share it.
pub const MAX_RANK: u8 = 3;

/// Number of ranks with a class of their own.
pub const RANK_COUNT: usize = MAX_RANK as usize + 1;

/// Number of events of a whole burst. In simulated recordings (seeds 5001 to 5003, 5008, 5010), classes by this number gave better
/// results than classes by the length of the previous burst.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BurstLength {
    /// Five or more.
    #[default]
    FiveOrMore,
    /// Four.
    Four,
    /// Three.
    Three,
    /// One or two.
    OneOrTwo,
}

impl BurstLength {
    /// All lengths, in the order of their indices.
    pub const ALL: [Self; 4] = [Self::FiveOrMore, Self::Four, Self::Three, Self::OneOrTwo];

    /// Number of lengths.
    pub const COUNT: usize = Self::ALL.len();

    /// Returns the index in [`BurstLength::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }
}

/// Index of the length of a burst, by its number of events. (A table, because comparisons would cost many mispredicted branches.)
const LENGTH_INDICES: [u8; 256] = {
    let mut indices = [BurstLength::FiveOrMore as u8; 256];
    indices[4] = BurstLength::Four as u8;
    indices[3] = BurstLength::Three as u8;
    [indices[2], indices[1], indices[0]] = [BurstLength::OneOrTwo as u8; 3];
    indices
};

/// Rank of an event in its burst, and the length of the burst.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BurstPosition {
    /// 0 for the first event of a burst, at most [`MAX_RANK`].
    pub rank: u8,
    /// Length of the burst.
    pub length: BurstLength,
}

/// Rank of an event in a burst that may continue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BurstBeginning {
    /// 0 for the first event of a burst, at most [`MAX_RANK`].
    pub rank: u8,
    /// Number of the burst among the bursts of its pixel, modulo 256.
    burst: u8,
}

/// Number of bits that encode a length.
const LENGTH_BITS: u32 = 2;

#[derive(Clone, Copy)]
struct PixelState {
    /// Time of the last event in microseconds; `i64::MIN` before the first.
    last: i64,
    /// Lengths of the 16 previous bursts, the latest in the lowest bits.
    before: u32,
    /// Number of events.
    count: u32,
    /// Polarity index of the last event.
    polarity: u8,
    /// Number of events in the burst so far.
    length: u8,
    /// Number of the burst, modulo 256.
    burst: u8,
    /// `true` if the burst has two events so far, at an interval in [`CLOSE`].
    is_close: bool,
    /// Polarity index and number of events of the burst before.
    previous: [u8; 2],
}

/// Follows the bursts of every pixel of a sensor, and counts its events.
pub struct BurstTracker {
    width: usize,
    pixels: Vec<PixelState>,
    longest_pause: i64,
    repeated: u64,
    intervals: FirstIntervals,
    pairs: BurstPairs,
}

impl BurstTracker {
    /// Creates a tracker for a sensor of this size. A pixel that is silent for longer than `longest_pause` microseconds starts a
    /// new burst.
    pub fn new(sensor: Sensor, longest_pause: i64) -> Self {
        let width = usize::from(sensor.width);
        let state = PixelState {
            last: i64::MIN,
            before: 0,
            count: 0,
            polarity: 0,
            length: 0,
            burst: 0,
            is_close: false,
            previous: [0; 2],
        };
        let pixels = vec![state; width * usize::from(sensor.height)];
        Self {
            width,
            pixels,
            longest_pause,
            repeated: 0,
            intervals: FirstIntervals::default(),
            pairs: BurstPairs::default(),
        }
    }

    /// Returns the index of a pixel; `None` outside the sensor.
    fn pixel(&self, x: u16, y: u16) -> Option<usize> {
        (usize::from(x) < self.width).then_some(usize::from(y) * self.width + usize::from(x))
    }

    /// Counts the next events of each pixel. Call it for a few events before they are pushed one by one: their pixels' states are then
    /// fetched from memory at the same time, not one after the other.
    pub fn count(&mut self, events: &[Event]) {
        for event in events {
            let pixel = self.pixel(event.x, event.y);
            if let Some(state) = pixel.and_then(|pixel| self.pixels.get_mut(pixel)) {
                state.count = state.count.saturating_add(1);
            }
        }
    }

    /// Returns the number of counted events of each pixel, row by row.
    pub fn counts(&self) -> Vec<u32> {
        self.pixels.iter().map(|state| state.count).collect()
    }

    /// Returns the number of events that have the same time and polarity as the previous event of their pixel.
    pub fn repeated(&self) -> u64 {
        self.repeated
    }

    /// Returns the intervals after the first event of each burst.
    pub fn intervals(&self) -> &FirstIntervals {
        &self.intervals
    }

    /// Returns the lengths of successive bursts.
    pub fn pairs(&self) -> &BurstPairs {
        &self.pairs
    }

    /// Takes the next event in time order and returns its rank in its burst; `None` for an event outside the sensor.
    pub fn push(&mut self, event: &Event) -> Option<BurstBeginning> {
        let pixel = self.pixel(event.x, event.y)?;
        let state = self.pixels.get_mut(pixel)?;
        let polarity = event.polarity.index() as u8;
        let is_same = state.polarity == polarity;
        // The pause before the first event is longer than any other.
        let continues = is_same & (event.t.saturating_sub(state.last) <= self.longest_pause);
        self.repeated += u64::from(is_same & (event.t == state.last));
        let was_close = state.is_close;
        state.is_close = false;
        if state.length == 1 || was_close {
            let octave = octave(event.t.saturating_sub(state.last));
            let is_close = octave.is_some_and(|octave| CLOSE.contains(&octave));
            if was_close {
                self.intervals.thirds[usize::from(is_same)] += u64::from(is_close);
            } else if let Some(octave) = octave {
                let of = if is_same { &mut self.intervals.same } else { &mut self.intervals.opposite };
                of[octave.min(OCTAVES - 1)] += 1;
                state.is_close = is_same & is_close;
            }
        }
        let [earlier, length] = state.previous;
        let is_pair = !continues & (length > 0) & (earlier != state.polarity);
        self.pairs.add(state.polarity, length, state.length, u32::from(is_pair));
        state.previous = if continues { state.previous } else { [state.polarity, state.length] };
        let before = state.before << LENGTH_BITS | u32::from(LENGTH_INDICES[usize::from(state.length)]);
        state.before = if continues { state.before } else { before };
        state.burst = state.burst.wrapping_add(u8::from(!continues));
        state.length = if continues { state.length.saturating_add(1) } else { 1 };
        state.polarity = polarity;
        state.last = event.t;
        Some(BurstBeginning { rank: (state.length - 1).min(MAX_RANK), burst: state.burst })
    }

    /// Reads the state of pixel (`x`, `y`), to bring it into the cache. The returned number has no meaning.
    pub fn touch(&self, x: u16, y: u16) -> u8 {
        self.pixel(x, y).and_then(|pixel| self.pixels.get(pixel)).map_or(0, |state| state.length)
    }

    /// Returns rank and burst length of an earlier event of pixel (`x`, `y`). Call it after the burst is over; before,
    /// the length is the number of events so far. A burst with more than 16 later bursts is no longer stored and counts
    /// as long.
    pub fn place(&self, x: u16, y: u16, beginning: BurstBeginning) -> BurstPosition {
        let BurstBeginning { rank, burst } = beginning;
        let state = self.pixel(x, y).and_then(|pixel| self.pixels.get(pixel));
        let length = state.map_or_else(BurstLength::default, |state| {
            let lengths = u64::from(state.before) << LENGTH_BITS | u64::from(LENGTH_INDICES[usize::from(state.length)]);
            let since = LENGTH_BITS * u32::from(state.burst.wrapping_sub(burst));
            let index = lengths.checked_shr(since).unwrap_or(0) & ((1 << LENGTH_BITS) - 1);
            BurstLength::ALL.get(index as usize).copied().unwrap_or_default()
        });
        BurstPosition { rank, length }
    }
}

/// Returns the octave of an interval (µs); `None` if it is zero.
fn octave(interval: i64) -> Option<usize> {
    u64::try_from(interval).ok()?.checked_ilog2().map(|octave| octave as usize)
}

#[cfg(test)]
mod tests {
    use super::BurstLength::{FiveOrMore, Four, OneOrTwo, Three};
    use super::*;
    use evcal_core::event::Polarity::{Off, On};

    #[test]
    fn repeated_events_are_counted() {
        let repeated = |events: &[Event]| {
            let mut tracker = BurstTracker::new(Sensor::new(20, 15), 1000);
            events.iter().for_each(|event| assert!(tracker.push(event).is_some()));
            tracker.repeated()
        };
        let at = |t: i64, x: u16, polarity| Event { t, x, y: 2, polarity };
        // Sorted by time alone, so that the events of one time come as a b a b.
        let twice: Vec<Event> = (0..40).map(|index| at(index / 4, (index % 2) as u16, On)).collect();
        assert_eq!(repeated(&twice), 20);
        // Another time, pixel or polarity is another event.
        assert_eq!(repeated(&[at(0, 1, On), at(0, 2, On), at(0, 1, Off), at(1, 1, Off)]), 0);
    }

    #[test]
    fn a_burst_ends_with_the_polarity_or_a_pause() {
        let mut tracker = BurstTracker::new(Sensor::new(4, 3), 1000);
        let events = [(0, Off), (10, Off), (20, On), (30, On), (40, On), (50, On), (60, On), (2000, On), (2001, Off)];
        let beginnings = events.map(|(t, polarity)| tracker.push(&Event { t, x: 3, y: 2, polarity }).unwrap());
        assert_eq!(beginnings.map(|one| one.rank), [0, 1, 0, 1, 2, 3, 3, 0, 0]);
        let lengths = beginnings.map(|one| tracker.place(3, 2, one).length);
        let [short, long] = [OneOrTwo, FiveOrMore];
        assert_eq!(lengths, [short, short, long, long, long, long, long, short, short]);
        assert_eq!(tracker.push(&Event { t: 3000, x: 4, y: 0, polarity: On }), None);
        assert_eq!(tracker.push(&Event { t: 3000, x: 0, y: 3, polarity: On }), None);
    }

    #[test]
    fn intervals_after_the_first_event_of_a_burst_are_counted() {
        let mut tracker = BurstTracker::new(Sensor::new(4, 3), 100_000);
        // 20 µs, then 100 µs; 1500 µs to the opposite polarity; 10 µs to the opposite one, and no third; 2 s.
        let events = [(0, Off), (20, Off), (120, Off), (300, On), (1800, Off), (1810, On), (2_001_810, On)];
        for (t, polarity) in events {
            tracker.push(&Event { t, x: 1, y: 1, polarity });
        }
        let mut expected = FirstIntervals { thirds: [0, 1], ..FirstIntervals::default() };
        (expected.same[4], expected.same[15]) = (1, 1);
        (expected.opposite[10], expected.opposite[3]) = (1, 1);
        assert_eq!(*tracker.intervals(), expected);
    }

    #[test]
    fn the_length_of_a_burst_is_stored_for_sixteen_more_bursts() {
        let mut tracker = BurstTracker::new(Sensor::new(1, 1), 1000);
        let counts = [2, 3, 1, 4, 300, 3, 1, 1, 4, 2, 2, 3, 4, 5, 6, 1, 4, 3];
        let mut t = 0;
        let firsts: Vec<BurstBeginning> = counts
            .iter()
            .enumerate()
            .map(|(burst, &count)| {
                let polarity = if burst % 2 == 0 { On } else { Off };
                let mut events = (0..count).map(|_| {
                    t += 10;
                    tracker.push(&Event { t, x: 0, y: 0, polarity }).unwrap()
                });
                let first = events.next().unwrap();
                events.for_each(drop);
                first
            })
            .collect();
        let length = |count| match count {
            1 | 2 => OneOrTwo,
            3 => Three,
            4 => Four,
            _ => FiveOrMore,
        };
        for (first, count) in firsts.iter().zip(counts).skip(1) {
            assert_eq!(tracker.place(0, 0, *first), BurstPosition { rank: 0, length: length(count) }, "{count}");
        }
        // The first burst has seventeen after it.
        assert_eq!(tracker.place(0, 0, firsts[0]).length, FiveOrMore);
    }
}

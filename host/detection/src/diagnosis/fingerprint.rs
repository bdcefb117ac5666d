//! Detection of recordings with the same events.

use std::collections::HashMap;

use evcal_core::event::{Event, Polarity};

/// Number of successive events of a run. Shorter runs can be equal by chance: on a small sensor, different recordings of one scene
/// contain the same pairs of neighbours 0 or 1 µs apart. No two real recordings of a blinking board had a run of 4 events in common.
const RUN: usize = 6;
/// Largest number of runs that are kept. Of longer recordings, a sample is kept.
const MOST: usize = 1 << 16;
/// Fewest equal runs that are not a coincidence.
const FEWEST: usize = 4;
/// Odd, so that multiplication by it loses no bit of a sum.
const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;

/// A sample of the runs of successive events, by their pixels, polarities and time differences. It does not change when a
/// recording is cut, converted, or shifted to another clock.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Fingerprint {
    /// Time of the last event in µs.
    last: Option<i64>,
    /// The last events; event number `count` has the index `count` modulo the length.
    run: [u64; RUN],
    count: usize,
    /// Sum over the last events, each times a power of [`FACTOR`].
    sum: u64,
    /// Runs are kept if their hash ends with this number of zero bits: one run in 2^level.
    level: u32,
    /// The runs, with `true` for those that occurred once. A run that a static scene repeats carries no information.
    runs: HashMap<u64, bool>,
}

impl Fingerprint {
    /// Adds `events`, which follow the previous ones.
    pub fn push(&mut self, events: &[Event]) {
        const OLDEST: u64 = FACTOR.wrapping_pow(RUN as u32);
        // Local copies, which the compiler keeps in registers, unlike fields.
        let Self { mut last, mut run, mut count, mut sum, .. } = *self;
        for event in events {
            let since = event.t.wrapping_sub(last.replace(event.t).unwrap_or(event.t)) as u64;
            let this = mixed(place(event) << 30 ^ since);
            let oldest = std::mem::replace(&mut run[count % RUN], this);
            sum = sum.wrapping_mul(FACTOR).wrapping_add(this).wrapping_sub(oldest.wrapping_mul(OLDEST));
            count += 1;
            // The time before the first event is not known.
            if count > RUN {
                self.keep(sum);
            }
        }
        (self.last, self.run, self.count, self.sum) = (last, run, count, sum);
    }

    fn keep(&mut self, run: u64) {
        if !is_kept(run, self.level) {
            return;
        }
        self.runs.entry(run).and_modify(|is_single| *is_single = false).or_insert(true);
        if self.runs.len() > MOST {
            self.level += 1;
            let level = self.level;
            self.runs.retain(|run, _| is_kept(*run, level));
        }
    }

    /// Returns the runs that occurred once and are kept at this level.
    fn singles(&self, level: u32) -> impl Iterator<Item = u64> {
        self.runs.iter().filter(move |(run, is_single)| **is_single && is_kept(**run, level)).map(|(run, _)| *run)
    }

    /// Returns the share of common events, relative to the smaller recording: 0 to 1.
    pub fn shared(&self, other: &Self) -> f64 {
        let level = self.level.max(other.level);
        let fewest = self.singles(level).count().min(other.singles(level).count()).max(1);
        let equal = self.singles(level).filter(|run| other.runs.get(run) == Some(&true)).count();
        if equal < FEWEST { 0.0 } else { equal as f64 / fewest as f64 }
    }
}

fn is_kept(run: u64, level: u32) -> bool {
    run.trailing_zeros() >= level
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

    /// Returns the events of the numbers `range`, 1 to 3 µs apart, whose pixels look random.
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
    fn the_same_events_are_recognised_whatever_the_clock_and_the_batches() {
        let whole = fingerprint(&[events(1, 0..400_000, 0)]);
        let again = fingerprint(&[events(1, 0..1000, 7_000_000), events(1, 1000..400_000, 7_000_000)]);
        assert_eq!(whole.shared(&again), 1.0);
        // The second half of one, with as many other events.
        let half = fingerprint(&[events(1, 200_000..400_000, 0), events(2, 400_000..600_000, 0)]);
        let share = half.shared(&whole);
        assert!((0.35..0.65).contains(&share), "{share}");
    }

    #[test]
    fn different_events_at_the_same_times_are_not_common() {
        let share = fingerprint(&[events(1, 0..400_000, 0)]).shared(&fingerprint(&[events(3, 0..400_000, 0)]));
        assert_eq!(share, 0.0);
    }
    /// In two recordings of a board on a sensor of 128 × 128 pixels, one event in 2 was followed by its neighbour within a
    /// microsecond. They must not be reported as the same.
    #[test]
    fn neighbours_that_follow_each_other_do_not_make_recordings_the_same() {
        let scene = |seed: u64| -> Vec<Event> {
            let pair = |index: u64| {
                let random = mixed(seed << 40 | (index + 1));
                let (x, y) = ((random % 100) as u16, ((random >> 16) % 100) as u16);
                let t = (50 * index + (random >> 40) % 40) as i64;
                let polarity = Polarity::On;
                [Event { t, x, y, polarity }, Event { t: t + (random >> 60) as i64 % 2, x: x + 1, y, polarity }]
            };
            (0..150_000).flat_map(pair).collect()
        };
        let share = fingerprint(&[scene(1)]).shared(&fingerprint(&[scene(2)]));
        assert!(share < 1e-3, "{share}");
    }

    /// A board that blinks, row by row at times of whole milliseconds, with noise in between: everything except the noise
    /// repeats.
    #[test]
    fn events_that_a_static_scene_repeats_do_not_count() {
        let blinks = |seed: u64| -> Vec<Event> {
            let blink = |index: u64| {
                let t = 10_000 * index as i64;
                let polarity = if index.is_multiple_of(2) { Polarity::On } else { Polarity::Off };
                let board = (0..2000_u16).map(move |pixel| Event { t, x: pixel % 50, y: pixel / 50, polarity });
                let noise = (0..20).map(move |number| {
                    let random = mixed(seed << 40 | (20 * index + number + 1));
                    Event { t: t + 1000, x: (random % 128) as u16, y: ((random >> 20) % 128) as u16, polarity }
                });
                board.chain(noise)
            };
            (0..100).flat_map(blink).collect()
        };
        let first = fingerprint(&[blinks(1)]);
        assert_eq!(first.shared(&fingerprint(&[blinks(2)])), 0.0);
        assert_eq!(first.shared(&first), 1.0);
    }

    /// A part of a recording of any length is recognised.
    #[test]
    fn a_part_of_a_long_recording_is_recognised() {
        let (part, whole) = (fingerprint(&[events(1, 500_000..520_000, 9)]), fingerprint(&[events(1, 0..800_000, 0)]));
        assert!(whole.runs.len() <= MOST && whole.level > 0);
        assert!(part.shared(&whole) > 0.9, "{}", part.shared(&whole));
    }
}

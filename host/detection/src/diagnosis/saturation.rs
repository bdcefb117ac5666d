//! Detection of intervals with a saturated readout.
//!
//! A sensor reads its events one after the other. If more events wait than it can read, they leave at the readout's own rate:
//! their number per millisecond is the largest of the recording, and much more constant than the number of random events, whose
//! variance equals their mean. Such events are late by their waiting time.

use evcal_core::event::Event;

use super::time_bins::time_bins;

/// Length of the bins that are compared (µs).
const BIN: i64 = 1000;
/// A bin is near the largest if its number of events is at least this share of the largest.
const NEAR: f64 = 0.9;
/// Fewest successive bins of an interval.
const FEWEST_BINS: usize = 10;
/// A bin is at the top if its number of events is at least this share of the largest.
const TOP: f64 = 0.97;
/// Share of an interval's bins that must be at the top; the rate of an unsaturated readout, which rises and falls, is there for half
/// of the time.
const AT_TOP: f64 = 0.75;
/// Ratio of variance to mean below which the numbers of events per bin vary too little to be random: for random events it is 1.
const STEADY: f64 = 0.3;
/// Lowest rate of a readout (events per bin).
const FEWEST_EVENTS: u32 = 500;
/// Later bins are ignored: 3 h.
const MOST_BINS: usize = 10_800_000;

/// Counts events per bin to detect saturation.
#[derive(Clone, Debug, Default)]
pub struct SaturationDetector {
    counts: Vec<u32>,
}

/// Intervals with a saturated readout.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Saturation {
    /// Events per second of the saturated readout; 0 without an interval.
    pub rate: f64,
    /// Start and end of each in seconds since the start of the recording, in order of time.
    pub intervals: Vec<(f64, f64)>,
}

impl Saturation {
    /// Returns the length of all intervals (s).
    pub fn duration(&self) -> f64 {
        self.intervals.iter().map(|(start, end)| end - start).sum()
    }
}

impl SaturationDetector {
    /// Adds events, with times since the start of the recording (µs).
    pub fn push(&mut self, events: &[Event]) {
        time_bins(events, BIN).for_each(|(bin, events)| self.add_to(bin, events.len()));
    }

    /// Adds an event at `t` since the start of the recording (µs).
    pub fn add(&mut self, t: i64) {
        self.add_to(t.div_euclid(BIN), 1);
    }

    fn add_to(&mut self, bin: i64, events: usize) {
        let bin = usize::try_from(bin).unwrap_or(0);
        if bin >= self.counts.len() && bin < MOST_BINS {
            self.counts.resize(bin + 1, 0);
        }
        if let Some(count) = self.counts.get_mut(bin) {
            *count += events as u32;
        }
    }

    /// Returns the result.
    pub fn finish(&self) -> Saturation {
        let most = self.counts.iter().copied().max().unwrap_or(0);
        let mut found = Saturation::default();
        if most < FEWEST_EVENTS {
            return found;
        }
        let near = |count: u32| f64::from(count) >= NEAR * f64::from(most);
        let (mut start, mut events, mut bins) = (0, 0_u64, 0_usize);
        for run in self.counts.chunk_by(|a, b| near(*a) == near(*b)) {
            let end = start + run.len();
            let is_long = run.first().copied().is_some_and(near) && run.len() >= FEWEST_BINS;
            if is_long && is_flat(run, most) && is_steady(run) {
                let time = |bin: usize| (bin as i64 * BIN) as f64 * 1e-6;
                // Events that still wait at the end arrive in the next bin.
                found.intervals.push((time(start.saturating_sub(1)), time(end + 1)));
                events += run.iter().map(|&count| u64::from(count)).sum::<u64>();
                bins += run.len();
            }
            start = end;
        }
        if bins > 0 {
            found.rate = events as f64 / (bins as f64 * BIN as f64 * 1e-6);
        }
        found
    }
}

/// Returns `true` if most counts are at the top.
fn is_flat(counts: &[u32], most: u32) -> bool {
    let top = counts.iter().filter(|&&count| f64::from(count) >= TOP * f64::from(most)).count();
    top as f64 >= AT_TOP * counts.len() as f64
}

/// Returns `true` if counts vary less than counts of random events.
fn is_steady(counts: &[u32]) -> bool {
    let pairs = counts.iter().zip(counts.iter().skip(1));
    let changes: f64 = pairs.map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum();
    let mean = counts.iter().map(|&count| f64::from(count)).sum::<f64>() / counts.len() as f64;
    // The squared difference of two counts is twice their variance, on average.
    changes / (2.0 * (counts.len() - 1) as f64) < STEADY * mean
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn event(t: f64) -> Event {
        Event { t: t as i64, x: 0, y: 0, polarity: Polarity::On }
    }

    /// Random events at `rate(t)` per microsecond at `t` (µs).
    fn by_chance(duration: f64, rate: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut t = 0.0;
        let mut times = Vec::new();
        while t < duration {
            t -= (1.0 - random.next_u64() as f64 / 2.0_f64.powi(64)).max(1e-12).ln() / rate(t);
            times.push(t);
        }
        times
    }

    fn found(times: &[f64]) -> Saturation {
        let mut detector = SaturationDetector::default();
        let events: Vec<Event> = times.iter().map(|&t| event(t)).collect();
        events.chunks(1000).for_each(|events| detector.push(events));
        detector.finish()
    }

    #[test]
    fn the_interval_of_a_readout_that_is_too_slow_is_found() {
        // Between 100 and 150 ms, twice as many as the readout can send, which is 3 per microsecond.
        let requests = by_chance(300_000.0, |t| if (100_000.0..150_000.0).contains(&t) { 6.0 } else { 1.5 });
        let mut free = 0.0_f64;
        let read: Vec<f64> = requests
            .iter()
            .map(|&t| {
                free = free.max(t) + 1.0 / 3.0;
                free
            })
            .collect();
        let saturation = found(&read);
        assert!((saturation.rate - 3e6).abs() < 1e4, "{saturation:?}");
        let &[(start, end)] = saturation.intervals.as_slice() else { panic!("{saturation:?}") };
        // Half of the surplus is read in the following 100 ms.
        assert!((start - 0.1).abs() < 0.003 && (end - 0.25).abs() < 0.006, "{saturation:?}");
    }

    #[test]
    fn a_rate_that_rises_and_falls_smoothly_is_not_saturation() {
        // Events at exactly the given rate, without randomness: the edges of a moving board.
        let mut times = Vec::new();
        let (mut t, mut whole) = (0.0_f64, 0.0);
        while t < 300_000.0 {
            whole += 2.0 + 1.5 * (t * 5e-5).sin();
            while whole >= 1.0 {
                times.push(t);
                whole -= 1.0;
            }
            t += 1.0;
        }
        assert_eq!(found(&times), Saturation::default());
    }

    #[test]
    fn many_random_events_are_not_saturation() {
        assert_eq!(found(&by_chance(300_000.0, |_| 3.0)), Saturation::default());
        let wave = |t: f64| 2.0 + 1.5 * (t * 2e-5).sin();
        assert_eq!(found(&by_chance(300_000.0, wave)), Saturation::default());
        assert_eq!(found(&[]), Saturation::default());
    }
}

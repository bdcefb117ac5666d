//! Detection of flickering light. Lamps on mains flicker at twice its frequency, and every pixel sees it.
//!
//! While the light grows, edges send more ON events and fewer OFF events, and while it falls the opposite, long before
//! areas without edges send any. So the number of ON events minus the number of OFF events has a line at the lamps'
//! frequency; with strong flicker the number of all events has one too.

use evcal_core::event::{Event, Polarity};
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use super::time_bins::time_bins;

/// Length of a bin in which events are counted (µs).
const BIN: i64 = 1000;
/// Number of bins of an interval whose spectrum is computed: 1 s, so that its lines are 1 Hz apart.
const INTERVAL: usize = 1000;
/// Number of bins over which the flicker of most lamps averages out: 50 ms are five periods of 100 Hz and six of 120 Hz.
const LONG_BIN: usize = 50;
/// The rate of events is constant if the mean over long bins is at least this share of their maximum.
const EVEN: f64 = 0.97;
/// Frequencies of lamps and of mains (Hz).
const LAMPS: [f64; 4] = [100.0, 120.0, 50.0, 60.0];
/// Shortest recording that is checked, in bins.
const SHORTEST: usize = 250;
/// Fewest events of an interval whose spectrum is computed: fewer show no flicker.
const FEWEST_EVENTS: u64 = 100;
/// Neighbouring lines with which a lamp's line is compared (Hz, for a whole interval).
const NEIGHBOURS: std::ops::RangeInclusive<i32> = 3..=15;
/// Smallest ratio of a lamp's line to its neighbours.
const STRONGER: f64 = 8.0;
/// Smallest share by which ON and OFF alternate.
const SMALLEST_SHARE: f64 = 0.05;

/// The light seems to flicker.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flicker {
    /// Frequency in hertz.
    pub frequency: f64,
    /// Amplitude of the flicker in ON minus OFF events, or in the number of all events if it is larger there, as a share of the mean
    /// number of events: 0 to about 1.
    pub share: f64,
    /// `true` if the rate of events is constant, at the limit of the readout. The events are late then, and therefore the
    /// frequency is too low.
    pub fills_readout: bool,
}

/// Counts ON and OFF events in bins of a millisecond.
#[derive(Clone, Debug, Default)]
pub struct RateBins {
    interval: Vec<[i32; 2]>,
    /// Powers of two signals, the sum of both polarities and their difference. For each frequency of [`LAMPS`]: the power of its
    /// line and the mean power of the neighbouring lines, each summed over the intervals.
    powers: [[(f64, f64); LAMPS.len()]; 2],
    /// Number of evaluated bins.
    bins: usize,
    /// Number of events in the evaluated bins.
    events: u64,
    /// Largest number of events in a [`LONG_BIN`] of bins.
    fullest: u64,
    /// The bin that is being filled.
    current: i64,
}

impl RateBins {
    /// Adds the next events; times are relative to the first one (µs).
    pub fn push(&mut self, events: &[Event]) {
        for (bin, events) in time_bins(events, BIN) {
            let on = events.iter().filter(|event| event.polarity == Polarity::On).count();
            let mut counts = [0; 2];
            counts[Polarity::Off.index()] = (events.len() - on) as i32;
            counts[Polarity::On.index()] = on as i32;
            self.add_to(bin, counts);
        }
    }

    /// Adds the next event; `t` is relative to the first one (µs).
    pub fn add(&mut self, t: i64, polarity: Polarity) {
        let mut counts = [0; 2];
        counts[polarity.index()] = 1;
        self.add_to(t.div_euclid(BIN), counts);
    }

    fn add_to(&mut self, bin: i64, counts: [i32; 2]) {
        let index = bin - self.current;
        if index >= INTERVAL as i64 {
            self.close(index < 2 * INTERVAL as i64);
            // Intervals without events are skipped.
            self.current = bin - index % INTERVAL as i64;
        }
        if self.interval.is_empty() {
            self.interval.resize(INTERVAL, [0; 2]);
        }
        let place = usize::try_from(bin - self.current).ok().and_then(|index| self.interval.get_mut(index));
        if let Some(sums) = place {
            sums.iter_mut().zip(counts).for_each(|(sum, count)| *sum += count);
        }
    }

    /// Adds the spectrum of the interval that ended, if it is `whole`.
    fn close(&mut self, whole: bool) {
        if whole {
            self.add_spectrum(INTERVAL);
        }
        self.interval.clear();
    }

    /// Adds the spectrum of the first `length` bins of the interval.
    fn add_spectrum(&mut self, length: usize) {
        let interval = self.interval.get(..length).unwrap_or_default();
        let events: u64 = interval.iter().flatten().map(|count| u64::from(count.unsigned_abs())).sum();
        if events == 0 {
            return;
        }
        self.events += events;
        self.bins += length;
        for bins in interval.chunks_exact(LONG_BIN) {
            self.fullest = self.fullest.max(bins.iter().flatten().map(|count| u64::from(count.unsigned_abs())).sum());
        }
        if events < FEWEST_EVENTS {
            return;
        }
        let between = INTERVAL as f64 / length as f64;
        let signals: [Vec<i32>; 2] = [1, -1].map(|sign| interval.iter().map(|[off, on]| on + sign * off).collect());
        for (signal, powers) in signals.iter().zip(&mut self.powers) {
            for (frequency, (line, neighbours)) in LAMPS.iter().zip(powers) {
                *line += power(signal, *frequency);
                let others = NEIGHBOURS.flat_map(|distance| [-distance, distance]);
                let others = others.map(|distance| power(signal, frequency + between * f64::from(distance)));
                let powers: Vec<f64> = others.collect();
                *neighbours += powers.iter().sum::<f64>() / powers.len().max(1) as f64;
            }
        }
    }

    /// Returns the flicker in the whole intervals, or in the beginning of a recording that has none; `None` without flicker.
    pub fn flicker(&self) -> Option<Flicker> {
        if self.bins > 0 {
            return self.strongest();
        }
        let last = self.interval.iter().rposition(|counts| *counts != [0; 2])?;
        let mut beginning = self.clone();
        beginning.add_spectrum(last);
        if last < SHORTEST { None } else { beginning.strongest() }
    }

    /// Returns `true` if the rate of events was constant: objects that move in front of a camera never cause that, but a readout
    /// at its limit does.
    pub fn is_even(&self) -> bool {
        let mean = self.events as f64 / self.bins.max(1) as f64;
        self.bins > 0 && mean * LONG_BIN as f64 >= EVEN * self.fullest as f64
    }

    fn strongest(&self) -> Option<Flicker> {
        let mean = self.events as f64 / self.bins.max(1) as f64;
        let fills_readout = self.is_even();
        let candidates = self.powers.iter().flat_map(|powers| LAMPS.iter().zip(powers));
        let candidates = candidates.filter_map(|(frequency, (line, neighbours))| {
            // Amplitude of the wave (events per bin), from the power of its line in all intervals.
            let intervals = self.bins.div_ceil(INTERVAL) as f64;
            let amplitude = 2.0 * (line * intervals).sqrt() / self.bins.max(1) as f64;
            let share = amplitude / mean;
            let is_significant = *line > STRONGER * neighbours && share > SMALLEST_SHARE;
            is_significant.then_some(Flicker { frequency: *frequency, share, fills_readout })
        });
        candidates.max_by(|a, b| a.share.total_cmp(&b.share))
    }
}

/// Returns the power of the line of `frequency` (Hz) in counts of a second.
fn power(counts: &[i32], frequency: f64) -> f64 {
    let step = std::f64::consts::TAU * frequency * BIN as f64 * 1e-6;
    let wave_at = |index: usize| {
        let (sine, cosine) = libm::sincos(step * index as f64);
        Complex::new(cosine, sine)
    };
    let turn = wave_at(1);
    let (mut sum, mut wave, mut next) = (Complex::new(0.0, 0.0), turn, 1);
    // Empty bins are skipped: a recording with few events in a long time consists mostly of them.
    for (index, count) in counts.iter().enumerate().filter(|(_, count)| **count != 0) {
        if index != next {
            wave = wave_at(index);
        }
        sum += wave * f64::from(*count);
        (wave, next) = (wave * turn, index + 1);
    }
    sum.norm_sqr()
}

#[cfg(test)]
mod tests {
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// Returns the flicker in events at random times, whose share of ON varies by `share` at `frequency`, at a rate that varies
    /// slowly.
    fn seen(frequency: f64, share: f64, seconds: f64) -> Option<Flicker> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut random = || (rng.next_u64() >> 11) as f64 / (1_u64 << 53) as f64;
        let mut bins = RateBins::default();
        let mut t: f64 = 0.0;
        while t < seconds {
            t += 1e-5 * -random().max(1e-9).ln();
            let slow = 0.6 + 0.4 * (7.0 * t).sin() * (3.1 * t).cos();
            let on = 0.5 + 0.5 * share * (std::f64::consts::TAU * frequency * t).cos();
            if random() < slow {
                bins.add((t * 1e6) as i64, if random() < on { Polarity::On } else { Polarity::Off });
            }
        }
        bins.flicker()
    }

    /// Every interval with an event would otherwise take as long as a full one.
    #[test]
    fn intervals_of_few_events_have_no_spectrum() {
        let mut bins = RateBins::default();
        (0..1000).for_each(|index| bins.add(990_000 * index, Polarity::On));
        assert_eq!(bins.powers, RateBins::default().powers);
        assert!(bins.bins > 0 && bins.flicker().is_none());
    }

    #[test]
    fn lamps_on_mains_are_detected_and_nothing_else() {
        for frequency in [100.0, 120.0, 50.0, 60.0] {
            // Mains frequency is never exact.
            let found = seen(frequency + 0.05, 0.3, 4.0).unwrap();
            assert_eq!(found.frequency, frequency);
            assert!((found.share - 0.3).abs() < 0.05, "{found:?}");
        }
        for frequency in [0.0, 10.0, 83.0, 300.0] {
            assert_eq!(seen(frequency, 0.3, 4.0), None, "{frequency}");
        }
        assert_eq!(seen(100.0, 0.01, 4.0), None);
    }

    #[test]
    fn a_readout_at_its_limit_is_reported() {
        let mut bins = RateBins::default();
        for t in 0..2_100_000 {
            let polarity = if t / 5000 % 2 == 0 { Polarity::On } else { Polarity::Off };
            bins.add(t, polarity);
        }
        let found = bins.flicker().unwrap();
        assert!(found.fills_readout && found.frequency == 100.0, "{found:?}");
        assert!(bins.is_even() && !RateBins::default().is_even());
        assert!(!seen(100.0, 0.5, 3.1).unwrap().fills_readout);
    }

    #[test]
    fn a_short_recording_shows_what_its_length_allows() {
        assert_eq!(seen(100.0, 0.5, 0.2), None);
        let seen = [seen(100.0, 0.5, 0.4), seen(120.0, 0.5, 0.4)].map(|found| found.map(|flicker| flicker.frequency));
        assert_eq!(seen, [Some(100.0), Some(120.0)]);
        assert_eq!(RateBins::default().flicker(), None);
    }

    #[test]
    fn long_times_without_events_are_skipped() {
        let mut bins = RateBins::default();
        for t in [0, 10, 1_000_000_000_000, 1_000_000_000_500, i64::MAX / 2] {
            bins.add(t, Polarity::On);
        }
        assert_eq!(bins.flicker(), None);
    }
}

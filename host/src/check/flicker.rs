//! Does the light flicker? Lamps on mains do, at twice its frequency, and every pixel sees it.

use serde::Serialize;

/// Length of a bin in which events are counted (µs).
const BIN: i64 = 1000;
/// Bins of a stretch, whose spectrum is taken: 1 s, so that its lines are 1 Hz apart.
const STRETCH: usize = 1000;
/// Frequencies of lamps and of mains (Hz).
const LAMPS: [f64; 4] = [100.0, 120.0, 50.0, 60.0];
/// Lines beside a lamp's to compare it with (Hz).
const BESIDE: std::ops::RangeInclusive<i32> = 3..=15;
/// A lamp's line is so many times as strong as those beside it.
const STRONGER: f64 = 8.0;
/// It changes the rate of events by at least this share.
const SMALLEST_SHARE: f64 = 0.05;

/// The light seems to flicker.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Flicker {
    /// Frequency in hertz.
    pub frequency: f64,
    /// By what share of its mean the rate of events swings, 0 to 1 and more.
    pub share: f64,
}

/// Counts events in bins of a millisecond.
#[derive(Clone, Debug, Default)]
pub struct RateBins {
    stretch: Vec<u32>,
    /// For each lamp the sums over stretches of the powers of its line and of those beside it.
    powers: [(f64, f64); LAMPS.len()],
    stretches: u32,
    events: u64,
    /// The bin that is being filled.
    current: i64,
}

impl RateBins {
    /// Takes the next event; `t` counts from the first one (µs).
    pub fn add(&mut self, t: i64) {
        let bin = t.div_euclid(BIN);
        let index = bin - self.current;
        if index >= STRETCH as i64 {
            self.close(index < 2 * STRETCH as i64);
            // Over times without events nothing is to be learned.
            self.current = bin - index % STRETCH as i64;
        }
        if self.stretch.is_empty() {
            self.stretch.resize(STRETCH, 0);
        }
        if let Some(count) = usize::try_from(bin - self.current).ok().and_then(|index| self.stretch.get_mut(index)) {
            *count += 1;
        }
    }

    /// Adds the spectrum of the stretch that ended, if it is `whole`.
    fn close(&mut self, whole: bool) {
        let events: u64 = self.stretch.iter().map(|count| u64::from(*count)).sum();
        if whole && events > 0 {
            self.events += events;
            self.stretches += 1;
            for (frequency, (line, beside)) in LAMPS.iter().zip(&mut self.powers) {
                *line += power(&self.stretch, *frequency);
                let others = BESIDE.flat_map(|distance| [-distance, distance]);
                let (mut sum, mut count) = (0.0, 0.0);
                for distance in others {
                    sum += power(&self.stretch, frequency + f64::from(distance));
                    count += 1.0;
                }
                *beside += sum / count;
            }
        }
        self.stretch.clear();
    }

    /// What the whole stretches show; `None` where no lamp does.
    pub fn flicker(&self) -> Option<Flicker> {
        let mean = self.events as f64 / f64::from(self.stretches.max(1)) / STRETCH as f64;
        let candidates = LAMPS.iter().zip(&self.powers).filter_map(|(frequency, (line, beside))| {
            // The amplitude of a wave whose line has this power.
            let amplitude = 2.0 * (line / f64::from(self.stretches.max(1))).sqrt() / STRETCH as f64;
            let share = amplitude / mean;
            let stands_out = *line > STRONGER * beside && share > SMALLEST_SHARE;
            stands_out.then_some(Flicker { frequency: *frequency, share })
        });
        candidates.max_by(|a, b| a.share.total_cmp(&b.share))
    }
}

/// Power of the line of `frequency` (Hz) in counts of a second.
fn power(counts: &[u32], frequency: f64) -> f64 {
    let step = std::f64::consts::TAU * frequency * BIN as f64 * 1e-6;
    let (mut cosine, mut sine) = (0.0, 0.0);
    for (index, count) in counts.iter().enumerate() {
        let angle = step * index as f64;
        cosine += f64::from(*count) * libm::cos(angle);
        sine += f64::from(*count) * libm::sin(angle);
    }
    cosine * cosine + sine * sine
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;
    use crate::numerics::random::uniform_in;

    /// What events at random times show, at a rate that swings by `share` at `frequency`, and slowly by itself.
    fn seen(frequency: f64, share: f64, seconds: f64) -> Option<Flicker> {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut bins = RateBins::default();
        let mut t: f64 = 0.0;
        while t < seconds {
            t += 1e-5 * -uniform_in(&mut rng, 1e-9, 1.0).ln();
            let slow = 0.6 + 0.4 * (7.0 * t).sin() * (3.1 * t).cos();
            let rate = slow * (1.0 + share * (std::f64::consts::TAU * frequency * t).cos()) / (1.0 + share);
            if uniform_in(&mut rng, 0.0, 1.0) < rate {
                bins.add((t * 1e6) as i64);
            }
        }
        bins.flicker()
    }

    #[test]
    fn lamps_on_mains_are_seen_and_nothing_else() {
        for frequency in [100.0, 120.0, 50.0, 60.0] {
            // Mains is never exact.
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
    fn too_short_a_recording_shows_none() {
        assert_eq!(seen(100.0, 0.5, 0.9), None);
        assert_eq!(RateBins::default().flicker(), None);
    }

    #[test]
    fn long_times_without_events_are_passed_over() {
        let mut bins = RateBins::default();
        for t in [0, 10, 1_000_000_000_000, 1_000_000_000_500, i64::MAX / 2] {
            bins.add(t);
        }
        assert_eq!(bins.flicker(), None);
    }
}

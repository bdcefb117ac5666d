//! Detection of timestamps that are coarser than a camera's.

use std::fmt;
use std::ops::RangeInclusive;

use evcal_core::event::Event;
use serde::Serialize;

/// Fewest events for a decision.
const FEWEST_EVENTS: u64 = 1000;
/// Range of coarse steps between different timestamps (µs). The steps of a DVXplorer, which scans its pixels, are 200 µs and not
/// coarse; steps above the range are pauses.
const COARSE: RangeInclusive<i64> = 240..=50_000;
/// Largest share of shorter steps.
const FEW_SHORT: f64 = 0.01;
/// Mean number of events per timestamp from which steps are due to the clock. With fewer, the events themselves may be that rare.
const TOGETHER: f64 = 10.0;
/// Mean number of events with one timestamp above which times were lost: cameras read a row of at most some thousand pixels at
/// once.
const ALL: f64 = 5000.0;
/// Seconds since 1970, from 2001 to 2096.
const UNIX_SECONDS: RangeInclusive<i64> = 1_000_000_000..=4_000_000_000;

/// Timestamps that are too coarse.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum CoarseTimes {
    /// They have steps.
    Steps {
        /// The mean step in milliseconds.
        step_ms: f64,
        /// Events with the same time, on average.
        events: f64,
    },
    /// Almost all events have the same timestamp.
    Equal,
    /// The same, because seconds since 1970 were stored in 32-bit floating-point numbers, whose steps are 64 or 128 s there.
    UnixSecondsOf32Bits,
}

impl CoarseTimes {
    /// Steps from which times cannot show flicker of 100 Hz, a quarter of its period (ms).
    const HIDES_FLICKER: f64 = 2.5;

    /// Returns `true` if the rate of events varies with the steps of the timestamps, as it does with flicker.
    pub fn looks_like_flicker(&self) -> bool {
        match self {
            Self::Steps { step_ms, .. } => *step_ms >= Self::HIDES_FLICKER,
            Self::Equal | Self::UnixSecondsOf32Bits => true,
        }
    }

    /// Remedy.
    pub const ADVICE: &str = "export times in whole microseconds, or as floating-point numbers of 64 bits";
}

impl fmt::Display for CoarseTimes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Steps { step_ms, events } => {
                write!(f, "times come in steps of {step_ms:.2} ms, with {events:.0} events at each")
            }
            Self::Equal => write!(f, "nearly all events have the same time"),
            Self::UnixSecondsOf32Bits => write!(
                f,
                "nearly all events have the same time: seconds since 1970 do not fit into floating-point numbers of 32 bits"
            ),
        }
    }
}

/// Counts the steps between timestamps.
#[derive(Clone, Debug, Default)]
pub struct TimeSteps {
    latest: Option<i64>,
    events: u64,
    /// Number of different timestamps.
    times: u64,
    /// Number of steps that are not pauses.
    steps: u64,
    /// Number of those steps that are shorter than coarse ones.
    short: u64,
    /// Sum of the steps that are not pauses (µs).
    sum: i64,
}

impl TimeSteps {
    /// Adds the timestamp of the next event (µs).
    pub fn add(&mut self, t: i64) {
        self.events += 1;
        let Some(latest) = self.latest.replace(t) else {
            self.times = 1;
            return;
        };
        let step = t.saturating_sub(latest);
        // Not a branch: a processor would often predict wrongly whether a time repeats.
        let is_step = u64::from(step != 0);
        self.times += is_step;
        if step <= *COARSE.end() {
            self.steps += is_step;
            self.short += is_step & u64::from(step < *COARSE.start());
            self.sum += step;
        }
    }

    /// Adds the timestamps of several events.
    pub fn push(&mut self, events: &[Event]) {
        events.iter().for_each(|event| self.add(event.t));
    }

    /// Returns the problem with the timestamps, if there is any; `first` is the first of them as stored in the file (µs).
    pub fn coarse(&self, first: i64) -> Option<CoarseTimes> {
        if self.events < FEWEST_EVENTS {
            return None;
        }
        let together = self.events as f64 / self.times.max(1) as f64;
        let are_coarse = self.steps > 0 && self.short as f64 <= FEW_SHORT * self.steps as f64;
        if together >= TOGETHER && are_coarse {
            let step_ms = 1e-3 * self.sum as f64 / self.steps as f64;
            return Some(CoarseTimes::Steps { step_ms, events: together });
        }
        // Whole seconds may have been interpreted as microseconds.
        let of_32_bits = |seconds: i64| UNIX_SECONDS.contains(&seconds) && seconds % 64 == 0;
        let are_unix = of_32_bits(first) || (first % 1_000_000 == 0 && of_32_bits(first / 1_000_000));
        match together >= ALL || self.times == 1 {
            true if are_unix => Some(CoarseTimes::UnixSecondsOf32Bits),
            true => Some(CoarseTimes::Equal),
            false => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coarse(times: impl Iterator<Item = i64>) -> Option<CoarseTimes> {
        let mut steps = TimeSteps::default();
        let times: Vec<i64> = times.collect();
        times.iter().for_each(|t| steps.add(*t));
        steps.coarse(times[0])
    }

    /// 0.65 million events per second, in steps of `step` µs.
    fn stepped(step: i64) -> Option<CoarseTimes> {
        coarse((0..1_000_000).map(|index| index * 100 / 65 / step * step))
    }

    #[test]
    fn steps_are_measured_and_fine_timestamps_are_not_reported() {
        for step in [250, 1000, 4000, 10_000] {
            let Some(CoarseTimes::Steps { step_ms, .. }) = stepped(step) else { panic!("{step}") };
            assert!((step_ms - step as f64 * 1e-3).abs() < 1e-6, "{step_ms}");
        }
        assert_eq!(stepped(1), None);
        // With steps of 10 ms, a lamp of 100 Hz was blamed.
        assert!(stepped(10_000).unwrap().looks_like_flicker() && !stepped(1000).unwrap().looks_like_flicker());
        assert_eq!(coarse((0..500_000).map(|index| (index / 165 + index / 400) * 200)), None);
        // A camera that scans its pixels every 200 µs, sometimes without events; few events, and pauses; rows of 1000 pixels that
        // are read every 20 µs.
        assert_eq!(coarse((0..5000).map(|index| index * 2000 + index / 100 * 900_000)), None);
        assert_eq!(coarse((0..500_000).map(|index| index / 1000 * 20)), None);
    }

    /// Equal timestamps must be reported, not a board that is not in view.
    #[test]
    fn equal_times_are_named_with_their_cause() {
        let seconds = |t: f64| f64::from((1.6e9 + t) as f32);
        let unix = |unit: f64| coarse((0..400_000).map(|index| (seconds(f64::from(index) * 2e-6) * unit) as i64));
        assert_eq!(unix(1.0), Some(CoarseTimes::UnixSecondsOf32Bits));
        assert_eq!(unix(1e6), Some(CoarseTimes::UnixSecondsOf32Bits));
        // These times contain a step to the next 32-bit number.
        let long = coarse((0..400_000).map(|index| seconds(f64::from(index) * 1e-3) as i64));
        assert_eq!(long, Some(CoarseTimes::UnixSecondsOf32Bits));
        assert_eq!(coarse((0..2000).map(|_| 7)), Some(CoarseTimes::Equal));
        assert_eq!(coarse((0..200).map(|_| 7)), None);
    }
}

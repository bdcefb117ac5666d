//! Event rates, and the load of the camera relative to its limit.

use std::collections::VecDeque;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

/// Length of the slots that are counted (µs).
const SLOT: i64 = 10_000;
/// Slots over which rates are computed: a second.
const SLOTS: usize = 100;
/// A DAVIS346, and its largest event rate in real recordings (events per second).
const DAVIS346: (Sensor, f64) = (Sensor::new(346, 260), 9e6);

/// Event rates of the last second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    /// Mean rate in events per second.
    pub mean: f64,
    /// Rate in the busiest hundredth of the second, in events per second.
    pub peak: f64,
    /// The peak rate as a fraction of the camera's limit, if the limit is known.
    pub load: Option<f64>,
    /// Fraction of ON events, 0 to 1.
    pub on_share: f64,
}

/// Measures event rates.
#[derive(Clone, Debug)]
pub struct RateMeter {
    limit: Option<f64>,
    /// ON and OFF events of the last slots, the current one last.
    slots: VecDeque<[u64; 2]>,
    current: i64,
}

impl RateMeter {
    /// Creates a meter for this sensor.
    pub fn new(sensor: Sensor) -> Self {
        let limit = (sensor == DAVIS346.0).then_some(DAVIS346.1);
        Self { limit, slots: VecDeque::new(), current: 0 }
    }

    /// Adds the next events, in order of time (µs).
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            let slot = event.t.div_euclid(SLOT);
            let passed = slot.saturating_sub(self.current).clamp(0, SLOTS as i64 + 1);
            self.current = self.current.max(slot);
            for _ in 0..passed {
                self.slots.push_back([0; 2]);
            }
            while self.slots.len() > SLOTS + 1 {
                self.slots.pop_front();
            }
            if self.slots.is_empty() {
                self.slots.push_back([0; 2]);
            }
            if let Some(counts) = self.slots.back_mut() {
                match event.polarity {
                    Polarity::On => counts[0] += 1,
                    Polarity::Off => counts[1] += 1,
                }
            }
        }
    }

    /// Returns the rates of the last second, without the current slot; `None` without events.
    pub fn rates(&self) -> Option<Rates> {
        let whole = self.slots.len().checked_sub(1).filter(|count| *count > 0)?;
        let slots = || self.slots.iter().take(whole);
        let (on, off) = slots().fold((0, 0), |(on, off), slot| (on + slot[0], off + slot[1]));
        let most = slots().map(|slot| slot[0] + slot[1]).max()?;
        let second = |events: u64, slots: usize| events as f64 / (slots as f64 * SLOT as f64 * 1e-6);
        let peak = second(most, 1);
        (on + off > 0).then(|| Rates {
            mean: second(on + off, whole),
            peak,
            load: self.limit.map(|limit| peak / limit),
            on_share: on as f64 / (on + off) as f64,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn events(from: i64, to: i64, step: i64) -> Vec<Event> {
        let event = |t| {
            let polarity = if t % (4 * step) == 0 { Polarity::On } else { Polarity::Off };
            Event { t, x: 0, y: 0, polarity }
        };
        (from..to).step_by(step as usize).map(event).collect()
    }

    #[test]
    fn rates_are_the_mean_and_the_peak_of_the_last_second() {
        let mut meter = RateMeter::new(Sensor::new(346, 260));
        assert_eq!(meter.rates(), None);
        // An event every 10 µs for two seconds, then every µs for 20 ms; the last 10 ms are the current slot.
        meter.push(&events(0, 2_000_000, 10));
        meter.push(&events(2_000_000, 2_020_000, 1));
        let rates = meter.rates().unwrap();
        assert_eq!(rates.peak, 1e6);
        assert!((rates.mean - 109_000.0).abs() < 1.0 && (rates.on_share - 0.25).abs() < 1e-6, "{rates:?}");
        assert!((rates.load.unwrap() - 1.0 / 9.0).abs() < 1e-9);
        // A second later these events no longer count.
        meter.push(&events(4_000_000, 4_100_000, 100));
        assert!((meter.rates().unwrap().peak - 1e4).abs() < 1.0);
        let mut unknown = RateMeter::new(Sensor::new(640, 480));
        unknown.push(&events(0, 100_000, 10));
        assert_eq!(unknown.rates().unwrap().load, None);
    }
}

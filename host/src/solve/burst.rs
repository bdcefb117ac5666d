//! The place of an event in the bursts of its pixel.
//!
//! When the edge of a dot crosses a pixel, the pixel fires several events of one polarity, one for
//! each contrast threshold that its log intensity passes. The k-th event of such a burst happens at
//! a definite level of the blurred edge, so its distance from the geometric edge is nearly the same
//! for all pixels, while it differs by up to two pixels between ranks. Knowing the rank makes an
//! event several times as precise.
//!
//! A pixel compares with its level at its last event. After a burst that ended early, as the thresholds of some
//! pixels and the time for which they are dead after an event make it, this level is another one, and the next burst begins
//! elsewhere on the edge. How often that happens depends on speed and distance, so such bursts are told apart.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

/// Largest rank that is told apart; later events of a burst share it.
pub const MAX_RANK: u8 = 3;

/// Number of ranks told apart.
pub const RANK_COUNT: usize = MAX_RANK as usize + 1;

/// Bursts of fewer events are short.
const SHORT_BURST: u8 = 3;

/// Where an event stands in the bursts of its pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BurstPlace {
    /// 0 for the first event of a burst, at most [`MAX_RANK`].
    pub rank: u8,
    /// Whether the burst before had one or two events only.
    pub after_short: bool,
}

#[derive(Clone, Copy)]
struct PixelState {
    /// Time of the last event in microseconds; `i64::MIN` before the first.
    last: i64,
    /// Polarity index of the last event.
    polarity: u8,
    /// Number of events in the burst so far.
    length: u8,
    /// Whether the burst before was short.
    after_short: bool,
}

/// Follows the bursts of every pixel of a sensor.
pub struct BurstTracker {
    width: usize,
    pixels: Vec<PixelState>,
    longest_pause: i64,
}

impl BurstTracker {
    /// A tracker for a sensor of `sensor` = (width, height) pixels; a pixel that is silent for
    /// longer than `longest_pause` microseconds starts a new burst.
    pub fn new(sensor: Sensor, longest_pause: i64) -> Self {
        let width = usize::from(sensor.width);
        let state = PixelState { last: i64::MIN, polarity: 0, length: 0, after_short: false };
        Self { width, pixels: vec![state; width * usize::from(sensor.height)], longest_pause }
    }

    /// Takes the next event in time order and tells its place. `None` for an event outside the sensor.
    pub fn place(&mut self, event: &Event) -> Option<BurstPlace> {
        if usize::from(event.x) >= self.width {
            return None;
        }
        let state = self.pixels.get_mut(usize::from(event.y) * self.width + usize::from(event.x))?;
        let polarity = event.polarity.index() as u8;
        let continues = state.last != i64::MIN
            && state.polarity == polarity
            && event.t.saturating_sub(state.last) <= self.longest_pause;
        if continues {
            state.length = state.length.saturating_add(1);
        } else {
            // Nothing is known of what came before a pixel's first burst.
            state.after_short = state.length > 0 && state.length < SHORT_BURST;
            state.length = 1;
        }
        state.polarity = polarity;
        state.last = event.t;
        Some(BurstPlace { rank: (state.length - 1).min(MAX_RANK), after_short: state.after_short })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_core::event::Polarity::{Off, On};

    #[test]
    fn a_burst_ends_with_the_polarity_or_a_pause() {
        let mut tracker = BurstTracker::new(Sensor::new(4, 3), 1000);
        let events = [(0, Off), (10, Off), (20, On), (30, On), (40, On), (50, On), (60, On), (2000, On), (2001, Off)];
        let ranks: Vec<u8> = events
            .iter()
            .map(|&(t, polarity)| tracker.place(&Event { t, x: 3, y: 2, polarity }).unwrap().rank)
            .collect();
        assert_eq!(ranks, [0, 1, 0, 1, 2, 3, 3, 0, 0]);
        assert_eq!(tracker.place(&Event { t: 3000, x: 4, y: 0, polarity: On }), None);
        assert_eq!(tracker.place(&Event { t: 3000, x: 0, y: 3, polarity: On }), None);
    }

    #[test]
    fn the_burst_before_is_short_or_not() {
        let mut tracker = BurstTracker::new(Sensor::new(1, 1), 1000);
        let bursts = [(On, 2), (Off, 3), (On, 1), (Off, 4), (On, 300), (Off, 1)];
        let mut t = 0;
        let after_short = bursts.map(|(polarity, length)| {
            let places: Vec<bool> = (0..length)
                .map(|_| {
                    t += 10;
                    tracker.place(&Event { t, x: 0, y: 0, polarity }).unwrap().after_short
                })
                .collect();
            assert!(places.iter().all(|place| *place == places[0]));
            places[0]
        });
        assert_eq!(after_short, [false, true, false, true, false, false]);
    }
}

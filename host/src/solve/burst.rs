//! The rank of an event in its burst.
//!
//! When the edge of a dot crosses a pixel, the pixel fires several events of one polarity, one for
//! each contrast threshold that its log intensity passes. The k-th event of such a burst happens at
//! a definite level of the blurred edge, so its distance from the geometric edge is nearly the same
//! for all pixels, while it differs by up to two pixels between ranks. Knowing the rank makes an
//! event several times as precise.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

/// Largest rank that is told apart; later events of a burst share it.
pub const MAX_RANK: u8 = 3;

/// Number of ranks told apart.
pub const RANK_COUNT: usize = MAX_RANK as usize + 1;

#[derive(Clone, Copy)]
struct PixelState {
    /// Time of the last event in microseconds; `i64::MIN` before the first.
    last: i64,
    /// Polarity index of the last event.
    polarity: u8,
    /// Rank of the last event.
    rank: u8,
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
        let state = PixelState { last: i64::MIN, polarity: 0, rank: 0 };
        Self { width, pixels: vec![state; width * usize::from(sensor.height)], longest_pause }
    }

    /// Takes the next event in time order and tells its rank, 0 for the first of a burst, at most
    /// [`MAX_RANK`]. `None` for an event outside the sensor.
    pub fn rank(&mut self, event: &Event) -> Option<u8> {
        if usize::from(event.x) >= self.width {
            return None;
        }
        let state = self.pixels.get_mut(usize::from(event.y) * self.width + usize::from(event.x))?;
        let polarity = event.polarity.index() as u8;
        let continues = state.last != i64::MIN
            && state.polarity == polarity
            && event.t.saturating_sub(state.last) <= self.longest_pause;
        state.rank = if continues { (state.rank + 1).min(MAX_RANK) } else { 0 };
        state.polarity = polarity;
        state.last = event.t;
        Some(state.rank)
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
        let ranks: Vec<u8> =
            events.iter().map(|&(t, polarity)| tracker.rank(&Event { t, x: 3, y: 2, polarity }).unwrap()).collect();
        assert_eq!(ranks, [0, 1, 0, 1, 2, 3, 3, 0, 0]);
        assert_eq!(tracker.rank(&Event { t: 3000, x: 4, y: 0, polarity: On }), None);
        assert_eq!(tracker.rank(&Event { t: 3000, x: 0, y: 3, polarity: On }), None);
    }
}

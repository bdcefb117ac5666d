//! The bus that reads the events of all pixels one after another.

use evcal_core::event::Event;

use super::sensor::Arbiter;

/// State of the bus between two time slices.
#[derive(Clone, Debug)]
pub struct Bus {
    arbiter: Arbiter,
    free_at: f64,
    row: u16,
}

impl Bus {
    /// Creates an idle bus.
    pub fn new(arbiter: Arbiter) -> Self {
        Self { arbiter, free_at: f64::NEG_INFINITY, row: 0 }
    }

    /// Replaces request times by the times at which the bus reads the events. `events` are in order of request, and
    /// later calls contain later requests, so times never decrease.
    pub fn read(&mut self, events: &mut [Event]) {
        for event in events {
            let switch = if event.y == self.row { 0.0 } else { 1e6 * self.arbiter.row_time };
            let start = self.free_at.max(event.t as f64);
            self.free_at = start + switch + 1e6 * self.arbiter.event_time;
            self.row = event.y;
            event.t = self.free_at as i64;
        }
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    #[test]
    fn a_burst_leaves_at_the_rate_of_the_bus() {
        let arbiter = Arbiter { latency: 0.0, jitter: 0.0, event_time: 1e-6, row_time: 2e-6 };
        let mut events: Vec<Event> =
            (0..12).map(|index| Event { t: 100, x: index % 4, y: index / 4, polarity: Polarity::On }).collect();
        Bus::new(arbiter).read(&mut events);
        let times: Vec<i64> = events.iter().map(|event| event.t - 100).collect();
        assert_eq!(times, [1, 2, 3, 4, 7, 8, 9, 10, 13, 14, 15, 16]);
    }
}

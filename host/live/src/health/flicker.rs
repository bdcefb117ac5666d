//! Flicker of the light.

use evcal_core::event::Event;

use evcal_detection::diagnosis::flicker::{Flicker, RateBins};

/// Length of the periods, each of which is analysed as a whole (µs).
const PERIOD: i64 = 3_000_000;

/// Measures the flicker in the latest complete period of 3 s.
#[derive(Clone, Debug, Default)]
pub struct RecentFlicker {
    bins: RateBins,
    start: i64,
    latest: Option<Option<Flicker>>,
}

impl RecentFlicker {
    /// Adds the next events, in order of time (µs since the first).
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            if event.t - self.start >= PERIOD {
                // The first event after the period closes it.
                self.bins.add(event.t - self.start, event.polarity);
                self.latest = Some(self.bins.flicker());
                (self.bins, self.start) = (RateBins::default(), event.t);
            }
            self.bins.add(event.t - self.start, event.polarity);
        }
    }

    /// Returns the flicker; `None` before the first 3 s are over, `Some(None)` if the light does not flicker.
    pub fn flicker(&self) -> Option<Option<Flicker>> {
        self.latest
    }
}

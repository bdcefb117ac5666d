//! Does the light flicker now?

use evcal_core::event::Event;

use evcal_calibrate::diagnosis::flicker::{Flicker, RateBins};

/// Time that is looked at together (µs).
const PERIOD: i64 = 3_000_000;

/// [`RateBins`] of the last whole 3 s.
#[derive(Clone, Debug, Default)]
pub struct RecentFlicker {
    bins: RateBins,
    start: i64,
    latest: Option<Option<Flicker>>,
}

impl RecentFlicker {
    /// Takes the next events, in order of time (µs since the first).
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            if event.t - self.start >= PERIOD {
                // The event that comes after the last whole second closes it.
                self.bins.add(event.t - self.start, event.polarity);
                self.latest = Some(self.bins.flicker());
                (self.bins, self.start) = (RateBins::default(), event.t);
            }
            self.bins.add(event.t - self.start, event.polarity);
        }
    }

    /// What they showed; the outer `None` before the first 3 s.
    pub fn flicker(&self) -> Option<Option<Flicker>> {
        self.latest
    }
}

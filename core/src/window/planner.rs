//! The window policy over a slice of time-sorted events.

use super::{Outcome, Window, WindowSettings, WindowState};
use crate::event::Event;

/// Yields the windows of `[start, end)` one by one, over a slice of events sorted by time.
///
/// Call [`next`](Self::next), search for the pattern, and pass the outcome to [`report`](Self::report), until `next`
/// returns `None`. Pass the same slice to every call.
///
/// ```
/// use evcal_core::event::Event;
/// use evcal_core::window::{Outcome, WindowPlanner, WindowSettings};
///
/// let events: &[Event] = &[];
/// let mut planner = WindowPlanner::new(WindowSettings::default(), 0, 1_000_000);
/// while let Some(window) = planner.next(events) {
///     let _events = &events[window.first..window.last];
///     planner.report(Outcome::NotFound { unique_pixels: 0 });
/// }
/// ```
#[derive(Clone, Debug)]
pub struct WindowPlanner {
    state: WindowState,
    end_us: i64,
    first: usize,
    last: usize,
    too_few_events: u32,
}

impl WindowPlanner {
    /// Creates a planner of windows within `[start_us, end_us)`.
    pub const fn new(settings: WindowSettings, start_us: i64, end_us: i64) -> Self {
        Self { state: WindowState::new(settings, start_us), end_us, first: 0, last: 0, too_few_events: 0 }
    }

    /// Returns the next window to search, or `None` when the next one would end after the planned time.
    ///
    /// Without a [`report`](Self::report) in between, the same window is returned again.
    pub fn next(&mut self, events: &[Event]) -> Option<Window> {
        loop {
            let (start_us, end_us) = (self.state.start_us(), self.state.end_us());
            if end_us > self.end_us || end_us <= start_us {
                return None;
            }
            self.first = first_not_before(events, self.first, start_us);
            self.last = first_not_before(events, self.last.max(self.first), end_us);
            let count = self.last - self.first;
            if count == 0 {
                // Skip to the next event: no window before it can contain anything.
                self.state.skip_to(events.get(self.last)?.t);
                continue;
            }
            match self.state.outcome_without_trying(count) {
                None => return Some(Window { start_us, end_us, first: self.first, last: self.last }),
                Some(outcome) => {
                    self.too_few_events += 1;
                    self.report(outcome);
                }
            }
        }
    }

    /// Accepts the outcome of the window that [`next`](Self::next) returned last.
    pub fn report(&mut self, outcome: Outcome) {
        self.state.report(outcome);
        // A new start begins with a shorter window, whose end may lie before the last one.
        self.last = self.first;
    }

    /// Returns the state machine of the planner.
    pub const fn state(&self) -> &WindowState {
        &self.state
    }

    /// Returns the number of windows that were not searched because they had fewer events than `fewest_events`.
    pub const fn too_few_events(&self) -> u32 {
        self.too_few_events
    }
}

/// Returns the index of the first event at or after `time_us`, searched from `from` in growing strides.
fn first_not_before(events: &[Event], from: usize, time_us: i64) -> usize {
    let Some(rest) = events.get(from..) else { return events.len() };
    let mut bound = 1;
    while rest.get(bound - 1).is_some_and(|event| event.t < time_us) {
        bound = bound.saturating_mul(2);
    }
    let near = rest.get(..bound.min(rest.len())).unwrap_or(rest);
    from + near.partition_point(|event| event.t < time_us)
}

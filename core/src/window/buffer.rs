//! The window policy for single events, with storage of fixed capacity.

use super::{Outcome, Window, WindowSettings, WindowState};
use crate::event::{Event, Polarity};
use heapless::Deque;

/// Storage for the events of a window, at most `N`, eight bytes each.
///
/// Its initial value is all zeros, so a static of this type takes no flash.
#[derive(Debug)]
pub struct EventStorage<const N: usize> {
    events: Deque<PackedEvent, N>,
}

impl<const N: usize> EventStorage<N> {
    /// Creates empty storage.
    pub const fn new() -> Self {
        Self { events: Deque::new() }
    }
}

impl<const N: usize> Default for EventStorage<N> {
    fn default() -> Self {
        Self::new()
    }
}

/// State of the current window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// The window is still open: push more events.
    Collecting,
    /// The window is complete: search [`WindowBuffer::events`] for the pattern, then pass the outcome to
    /// [`WindowBuffer::report`].
    Complete,
}

/// Counts of events that were dropped or reordered, and of windows that were skipped or ended early.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct BufferCounts {
    /// Events dropped because a complete window had not been reported.
    pub overflow: u32,
    /// Events dropped because they came before the start of the window, in the gap after a success.
    pub before_start: u32,
    /// Events older than the previous event; they get its time.
    pub out_of_order: u32,
    /// Windows that were not searched because they had fewer events than `fewest_events`.
    pub too_few_events: u32,
    /// Windows that ended early because the storage was full.
    pub full: u32,
    /// Events discarded by [`WindowBuffer::restart`].
    pub forgotten: u32,
}

/// Collects the events of the current window.
///
/// If the storage is full, the window ends early: it counts as complete, although it is shorter than the settings
/// require, and its end is the time of the first event that found no room. If the board is not found in it, the next
/// window starts later instead of growing.
///
/// ```
/// use evcal_core::event::{Event, Polarity};
/// use evcal_core::window::{EventStorage, Outcome, Progress, WindowBuffer, WindowSettings};
///
/// let mut storage = EventStorage::<4096>::new();
/// let mut windows = WindowBuffer::new(WindowSettings::default(), 0, &mut storage);
/// for t in (0..10_000).step_by(2) {
///     let mut progress = windows.push(Event { t, x: 1, y: 2, polarity: Polarity::On });
///     while progress == Progress::Complete {
///         let unique_pixels = windows.events().count() as u32;
///         progress = windows.report(Outcome::NotFound { unique_pixels });
///     }
/// }
/// assert_eq!(windows.counts().overflow, 0);
/// ```
#[derive(Debug)]
pub struct WindowBuffer<'a, const N: usize> {
    state: WindowState,
    /// Bounds of the window according to `state`, copied for the check of every event.
    start_us: i64,
    end_us: i64,
    /// Events at or after the start of the window, by time. After a failure some may lie after its end.
    events: &'a mut Deque<PackedEvent, N>,
    /// Number of `events` in the window.
    in_window: usize,
    /// The event that closed the window, if it is not in `events`.
    pending: Option<Event>,
    newest_us: i64,
    counts: BufferCounts,
}

impl<'a, const N: usize> WindowBuffer<'a, N> {
    /// Creates an empty window that starts at `start_us`, and clears `storage`.
    pub fn new(settings: WindowSettings, start_us: i64, storage: &'a mut EventStorage<N>) -> Self {
        storage.events.clear();
        let state = WindowState::new(settings, start_us);
        Self {
            state,
            start_us: state.start_us(),
            end_us: state.end_us(),
            events: &mut storage.events,
            in_window: 0,
            pending: None,
            newest_us: i64::MIN,
            counts: BufferCounts::default(),
        }
    }

    /// Adds the next event.
    ///
    /// While a complete window is not reported, further events are dropped and counted as overflow, so call
    /// [`report`](Self::report) first.
    #[inline]
    pub fn push(&mut self, event: Event) -> Progress {
        if self.pending.is_some() || self.in_window < self.events.len() {
            self.counts.overflow = self.counts.overflow.saturating_add(1);
            return Progress::Complete;
        }
        if event.t < self.newest_us {
            self.counts.out_of_order = self.counts.out_of_order.saturating_add(1);
        } else {
            self.newest_us = event.t;
        }
        let event = Event { t: self.newest_us, ..event };
        if event.t < self.start_us {
            self.counts.before_start = self.counts.before_start.saturating_add(1);
            return Progress::Collecting;
        }
        // Most events end here.
        if event.t < self.end_us && self.events.push_back(PackedEvent::pack(event)).is_ok() {
            self.in_window += 1;
            return Progress::Collecting;
        }
        self.pending = Some(event);
        self.settle()
    }

    /// Accepts the outcome of the complete window, and moves on to the next window.
    ///
    /// The stored events may already complete the next window too.
    pub fn report(&mut self, outcome: Outcome) -> Progress {
        self.move_on(outcome);
        self.settle()
    }

    /// Returns the events of the window, by time.
    pub fn events(&self) -> impl Iterator<Item = Event> + Clone + '_ {
        let start_us = self.start_us;
        let (front, back) = self.events.as_slices();
        front.iter().chain(back).take(self.in_window).map(move |packed| packed.unpack(start_us))
    }

    /// Returns the bounds of the window; the indices count [`events`](Self::events) from 0.
    pub const fn window(&self) -> Window {
        let end_us = match self.left_out() {
            Some(event) => event.t,
            None => self.end_us,
        };
        Window { start_us: self.start_us, end_us, first: 0, last: self.in_window }
    }

    /// Discards the stored events and restarts at `start_us`, if that is later than the start of the window. Call it
    /// when events were lost before they reached the buffer, because a window across the gap would have the wrong
    /// bounds.
    pub fn restart(&mut self, start_us: i64) {
        let forgotten = self.events.len() + usize::from(self.pending.is_some());
        self.counts.forgotten = self.counts.forgotten.saturating_add(forgotten as u32);
        self.events.clear();
        self.pending = None;
        self.in_window = 0;
        self.state.skip_to(start_us);
        self.set_bounds();
    }

    /// Returns the first microsecond of the current window; earlier events are dropped.
    pub const fn start_us(&self) -> i64 {
        self.start_us
    }

    const fn set_bounds(&mut self) {
        (self.start_us, self.end_us) = (self.state.start_us(), self.state.end_us());
    }

    /// Returns the event of the window for which the storage had no room, if there is one.
    const fn left_out(&self) -> Option<Event> {
        match self.pending {
            Some(event) if event.t < self.end_us => Some(event),
            _ => None,
        }
    }

    /// Returns the counts so far.
    pub const fn counts(&self) -> &BufferCounts {
        &self.counts
    }

    /// Finds the next complete window among the stored events, if there is one.
    fn settle(&mut self) -> Progress {
        loop {
            if self.in_window == self.events.len() && !self.place_pending() {
                return Progress::Collecting;
            }
            if self.in_window == 0 {
                // Skip to the next event: no window before it can contain anything.
                let start_us = self.start_us;
                let next = self.events.front().map(|packed| packed.unpack(start_us)).or(self.pending);
                let Some(next) = next else { return Progress::Collecting };
                self.state.skip_to(next.t);
                self.set_bounds();
                self.count_in_window();
                continue;
            }
            match self.state.outcome_without_trying(self.in_window) {
                None => return Progress::Complete,
                Some(outcome) => {
                    self.counts.too_few_events = self.counts.too_few_events.saturating_add(1);
                    self.move_on(outcome);
                }
            }
        }
    }

    /// Puts the pending event into the window or drops it; returns `true` if it lies after the window or the window is
    /// full.
    fn place_pending(&mut self) -> bool {
        let Some(event) = self.pending else { return false };
        if event.t >= self.end_us {
            return true;
        }
        if event.t < self.start_us {
            self.counts.before_start = self.counts.before_start.saturating_add(1);
        } else if self.events.push_back(PackedEvent::pack(event)).is_ok() {
            self.in_window += 1;
        } else if self.in_window > 0 {
            return true;
        } else {
            self.counts.overflow = self.counts.overflow.saturating_add(1);
        }
        self.pending = None;
        false
    }

    fn move_on(&mut self, outcome: Outcome) {
        let old_start_us = self.start_us;
        let full = self.left_out().is_some();
        self.counts.full = self.counts.full.saturating_add(u32::from(full));
        self.state.report(match outcome {
            // A longer window would contain the same events.
            Outcome::NotFound { .. } if full => Outcome::NotFound { unique_pixels: u32::MAX },
            outcome => outcome,
        });
        self.set_bounds();
        let start_us = self.start_us;
        while self.events.front().is_some_and(|packed| packed.unpack(old_start_us).t < start_us) {
            self.events.pop_front();
        }
        self.count_in_window();
    }

    /// Sets `in_window` to the number of stored events before the end of the window.
    fn count_in_window(&mut self) {
        let (start_us, end_us) = (self.start_us, self.end_us);
        let (front, back) = self.events.as_slices();
        let before_end = |packed: &PackedEvent| packed.unpack(start_us).t < end_us;
        self.in_window = front.partition_point(before_end);
        if self.in_window == front.len() {
            self.in_window += back.partition_point(before_end);
        }
    }
}

/// An event in eight bytes: the low 32 bits of its time, and the polarity in the top bit of the row.
#[derive(Clone, Copy, Debug)]
struct PackedEvent {
    t: u32,
    x: u16,
    y_and_polarity: u16,
}

impl PackedEvent {
    /// Rows beyond 32767 are stored as 32767, which no sensor has.
    fn pack(event: Event) -> Self {
        let polarity = (event.polarity.index() as u16) << 15;
        Self { t: event.t as u32, x: event.x, y_and_polarity: event.y.min(0x7fff) | polarity }
    }

    /// Restores the event, given a time at most 2^32 µs before it.
    fn unpack(self, start_us: i64) -> Event {
        let elapsed_us = self.t.wrapping_sub(start_us as u32);
        Event {
            t: start_us.saturating_add(i64::from(elapsed_us)),
            x: self.x,
            y: self.y_and_polarity & 0x7fff,
            polarity: if self.y_and_polarity >> 15 == 0 { Polarity::Off } else { Polarity::On },
        }
    }
}

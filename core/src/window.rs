//! Choice of the time windows to search: the window policy of Huang, Wang, Kneip, IROS 2021, III-A.
//!
//! A window is first `min_interval` steps long. While no pattern is found, it grows by one step, up to `max_interval`
//! steps or until it contains too many events. After a success the next window starts `gap` steps after the end of the
//! last one. After a failure the start advances by half the length of the failed window. Every event is therefore
//! searched from at most two starts, so that a recording without a pattern costs little.
//!
//! The rule is one state machine, [`WindowState`], with two front ends that yield the same windows for the same events:
//!
//! - [`WindowPlanner`] walks over a slice of time-sorted events and yields index ranges (host);
//! - [`WindowBuffer`] takes one event after the other and stores the events of the window in a buffer of fixed capacity
//!   (microcontroller).
//!
//! A window is the half-open interval `[start, end)`. No function here can panic.

mod buffer;
mod planner;

pub use buffer::{BufferCounts, EventStorage, Progress, WindowBuffer};
pub use planner::WindowPlanner;

use crate::settings::{at_least, from_to};

crate::settings! {
    /// Time windows in which the board is searched.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(deny_unknown_fields, default))]
    pub struct WindowSettings {
        /// The step τ in which windows grow.
        pub step: u32 = 500, "µs", from_to(1.0, 1e6);
        /// Length of the first window tried at a start.
        pub min_interval: u16 = 3, "steps", at_least(1.0).up_to("max_interval");
        /// Length of the longest window tried at a start. Raise it for slow motion.
        pub max_interval: u16 = 16, "steps", at_least(1.0);
        /// Time between the end of a window with the board and the next start.
        pub gap: u16 = 10, "steps", at_least(0.0);
        /// A window with events at this many distinct pixels or more does not grow any further.
        pub most_events: u32 = 8000, "events", at_least(1.0);
        /// A window with fewer events grows without being searched.
        #[cfg_attr(feature = "serde", serde(skip))]
        pub fewest_events: u32 = 200, "events", at_least(0.0);
    }
}

/// Result of the search for the pattern in a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The pattern was found and passed its checks.
    Found,
    /// The pattern was not found among this many events at distinct pixels.
    NotFound {
        /// Number of distinct pixels with events in the window.
        unique_pixels: u32,
    },
}

/// A window of time and the events in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// First microsecond of the window.
    pub start_us: i64,
    /// First microsecond after the window.
    pub end_us: i64,
    /// Index of the first event in the window.
    pub first: usize,
    /// Index of the first event after the window.
    pub last: usize,
}

impl Window {
    /// Returns the timestamp of a reference frame made from this window: its centre, in microseconds.
    pub const fn center_us(&self) -> i64 {
        self.start_us.saturating_add(self.end_us.saturating_sub(self.start_us) / 2)
    }

    /// Returns the number of events in the window.
    pub const fn len(&self) -> usize {
        self.last.saturating_sub(self.first)
    }

    /// Returns `true` if the window contains no event.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// The current window and the rule for the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowState {
    settings: WindowSettings,
    start_us: i64,
    length: u16,
}

impl WindowState {
    /// Creates the shortest window at `start_us`.
    pub const fn new(settings: WindowSettings, start_us: i64) -> Self {
        let mut state = Self { settings, start_us, length: 0 };
        state.length = state.shortest();
        state
    }

    /// Returns the first microsecond of the current window.
    pub const fn start_us(&self) -> i64 {
        self.start_us
    }

    /// Returns the first microsecond after the current window.
    pub const fn end_us(&self) -> i64 {
        self.start_us.saturating_add(self.steps_us(self.length as i64))
    }

    /// Returns the length of the current window in steps.
    pub const fn length(&self) -> u16 {
        self.length
    }

    /// Returns the settings in use.
    pub const fn settings(&self) -> &WindowSettings {
        &self.settings
    }

    /// Moves to the next window according to `outcome`.
    pub const fn report(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Found => {
                self.start_us = self.end_us().saturating_add(self.steps_us(self.settings.gap as i64));
                self.length = self.shortest();
            }
            Outcome::NotFound { unique_pixels }
                if unique_pixels < self.settings.most_events && self.length < self.settings.max_interval =>
            {
                self.length += 1;
            }
            Outcome::NotFound { .. } => {
                let advance_us = self.steps_us(self.length as i64) / 2;
                let advance_us = if advance_us < 1 { 1 } else { advance_us };
                self.start_us = self.start_us.saturating_add(advance_us);
                self.length = self.shortest();
            }
        }
    }

    /// Restarts at `time_us` if that is later; used to skip a silence longer than the window.
    pub const fn skip_to(&mut self, time_us: i64) {
        if time_us > self.start_us {
            self.start_us = time_us;
            self.length = self.shortest();
        }
    }

    /// Judges a window by its number of events alone: returns `None` if it should be searched, otherwise the outcome.
    const fn outcome_without_trying(&self, events: usize) -> Option<Outcome> {
        if events < self.settings.fewest_events as usize { Some(Outcome::NotFound { unique_pixels: 0 }) } else { None }
    }

    const fn shortest(&self) -> u16 {
        if self.settings.min_interval < 1 { 1 } else { self.settings.min_interval }
    }

    const fn steps_us(&self, steps: i64) -> i64 {
        let step_us = if self.settings.step < 1 { 1 } else { self.settings.step as i64 };
        steps * step_us
    }
}

#[cfg(test)]
mod tests;

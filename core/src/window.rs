//! Which stretch of time to look at: the window policy of Huang, Wang, Kneip, IROS 2021, III-A.
//!
//! A window starts `minimum` steps long and grows by one step while no pattern is found in it, until
//! it is `maximum` steps long or holds too many events. After a success the next window starts `gap`
//! steps after the end of the last one; after a failure the start moves on by [`Advance`].
//!
//! The rule is one state machine, [`WindowState`], with two front ends that yield the same windows
//! for the same events:
//!
//! - [`WindowPlanner`] walks over a slice of time-sorted events and yields index ranges (host);
//! - [`WindowBuffer`] takes one event after the other and keeps what the window needs in storage of
//!   fixed capacity (microcontroller).
//!
//! A window is the half-open interval `[start, end)`. No function here can panic.

mod buffer;
mod planner;

pub use buffer::{BufferCounts, EventStorage, Progress, WindowBuffer};
pub use planner::WindowPlanner;

/// How far the start of the window moves after a failure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Advance {
    /// By half the length of the window that failed: every event is looked at from at most two
    /// starts, so that a recording without a pattern costs little.
    HalfWindow,
    /// By a number of steps τ (at least one).
    Steps(u16),
}

/// Settings of the window policy. All lengths are in steps of `step_us`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowPolicy {
    /// The step τ in microseconds, at least 1.
    /// Default: 500.
    pub step_us: u32,
    /// Length of the first window tried at a start, in steps (the paper's `min`), at least 1.
    /// Default: 3.
    pub minimum: u16,
    /// Length of the longest window tried at a start, in steps (the paper's `max`).
    /// Default: 16.
    pub maximum: u16,
    /// Steps between the end of a successful window and the next start (the paper's `g`).
    /// Default: 5.
    pub gap: u16,
    /// A window with at least this many events at distinct pixels does not grow any more.
    /// Default: 8000.
    pub event_cap: u32,
    /// A window with fewer events than this cannot hold the pattern: it grows without being tried.
    /// Default: 200.
    pub event_floor: u32,
    /// How far the start moves after a failure.
    /// Default: [`Advance::HalfWindow`].
    pub advance: Advance,
}

impl Default for WindowPolicy {
    fn default() -> Self {
        Self {
            step_us: 500,
            minimum: 3,
            maximum: 16,
            gap: 5,
            event_cap: 8000,
            event_floor: 200,
            advance: Advance::HalfWindow,
        }
    }
}

/// What came of looking for the pattern in a window.
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
    /// Time stamp of a reference frame made of this window: its centre, in microseconds.
    pub const fn center_us(&self) -> i64 {
        self.start_us.saturating_add(self.end_us.saturating_sub(self.start_us) / 2)
    }

    /// Number of events in the window.
    pub const fn len(&self) -> usize {
        self.last.saturating_sub(self.first)
    }

    /// True if the window holds no event.
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// The current window and the rule by which the next one follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WindowState {
    policy: WindowPolicy,
    start_us: i64,
    length: u16,
}

impl WindowState {
    /// The shortest window at `start_us`.
    pub const fn new(policy: WindowPolicy, start_us: i64) -> Self {
        let mut state = Self { policy, start_us, length: 0 };
        state.length = state.shortest();
        state
    }

    /// First microsecond of the current window.
    pub const fn start_us(&self) -> i64 {
        self.start_us
    }

    /// First microsecond after the current window.
    pub const fn end_us(&self) -> i64 {
        self.start_us.saturating_add(self.steps_us(self.length as i64))
    }

    /// Length of the current window in steps.
    pub const fn length(&self) -> u16 {
        self.length
    }

    /// The policy in force.
    pub const fn policy(&self) -> &WindowPolicy {
        &self.policy
    }

    /// Moves to the window that follows this one after `outcome`.
    pub const fn report(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Found => {
                self.start_us = self.end_us().saturating_add(self.steps_us(self.policy.gap as i64));
                self.length = self.shortest();
            }
            Outcome::NotFound { unique_pixels }
                if unique_pixels < self.policy.event_cap && self.length < self.policy.maximum =>
            {
                self.length += 1;
            }
            Outcome::NotFound { .. } => {
                let advance_us = match self.policy.advance {
                    Advance::HalfWindow => self.steps_us(self.length as i64) / 2,
                    Advance::Steps(steps) => self.steps_us(steps as i64),
                };
                let advance_us = if advance_us < 1 { 1 } else { advance_us };
                self.start_us = self.start_us.saturating_add(advance_us);
                self.length = self.shortest();
            }
        }
    }

    /// Starts anew at `time_us`, if that is later: for a silence longer than the window.
    pub const fn skip_to(&mut self, time_us: i64) {
        if time_us > self.start_us {
            self.start_us = time_us;
            self.length = self.shortest();
        }
    }

    /// Judges a window by its number of events alone: `None` if it is worth a try, else the outcome.
    const fn outcome_without_trying(&self, events: usize) -> Option<Outcome> {
        if events < self.policy.event_floor as usize { Some(Outcome::NotFound { unique_pixels: 0 }) } else { None }
    }

    const fn shortest(&self) -> u16 {
        if self.policy.minimum < 1 { 1 } else { self.policy.minimum }
    }

    const fn steps_us(&self, steps: i64) -> i64 {
        let step_us = if self.policy.step_us < 1 { 1 } else { self.policy.step_us as i64 };
        steps * step_us
    }
}

#[cfg(test)]
mod tests;

//! Load shedding: drops events when they arrive faster than they can be processed.
//!
//! The rate limiter is a token bucket (rate in events per second, and a burst size) with hysteresis: once the bucket is
//! empty, all events are shed until it is full again. The admitted events therefore form uninterrupted intervals of at
//! least one burst. A window inside such an interval contains all events of its dots. Keeping every n-th event instead
//! would thin out all windows and leave holes in every dot. Every shed event is counted.
//!
//! The clock is taken from the events, so the result does not depend on when the code runs.

use crate::event::Event;

/// Event rate that can be processed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventBudget {
    /// Sustained event rate that can be processed, in events per second.
    /// Default: 300 000.
    pub events_per_second: u32,
    /// Number of events that may arrive at once: a few windows. Admitted intervals contain at least this many events.
    /// Default: 8000.
    pub burst: u32,
}

impl Default for EventBudget {
    fn default() -> Self {
        Self { events_per_second: 300_000, burst: 8000 }
    }
}

/// Unit of the bucket: a millionth of an event, so that one microsecond adds `events_per_second` units.
const EVENT: u64 = 1_000_000;

/// Admits or sheds events according to an [`EventBudget`].
///
/// ```
/// use evcal_core::budget::{EventBudget, LoadShedder};
/// use evcal_core::event::{Event, Polarity};
///
/// // One event per microsecond, of which a fifth can be processed.
/// let mut shedder = LoadShedder::new(EventBudget { events_per_second: 200_000, burst: 1000 });
/// let events = (0..100_000).map(|t| Event { t, x: 1, y: 2, polarity: Polarity::On });
/// let admitted = events.filter(|event| shedder.admit(event)).count() as u32;
/// assert!((19_000..=21_000).contains(&admitted));
/// assert_eq!(shedder.shed(), 100_000 - admitted);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct LoadShedder {
    events_per_second: u32,
    full: u64,
    level: u64,
    shedding: bool,
    last_us: i64,
    shed: u32,
}

impl LoadShedder {
    /// Creates a shedder with a full bucket.
    pub const fn new(budget: EventBudget) -> Self {
        let full = budget.burst as u64 * EVENT;
        Self {
            events_per_second: budget.events_per_second,
            full,
            level: full,
            shedding: false,
            last_us: i64::MAX,
            shed: 0,
        }
    }

    /// Returns `true` if the next event should be processed, `false` if it is shed. Events must come in order of time;
    /// an event that goes back in time adds nothing to the bucket.
    #[inline]
    pub fn admit(&mut self, event: &Event) -> bool {
        let elapsed_us = u32::try_from(event.t.saturating_sub(self.last_us).max(0)).unwrap_or(u32::MAX);
        self.last_us = event.t;
        let refill = u64::from(elapsed_us) * u64::from(self.events_per_second);
        self.level = self.level.saturating_add(refill).min(self.full);
        self.shedding = if self.shedding { self.level < self.full } else { self.level < EVENT };
        if self.shedding || self.level < EVENT {
            self.shed = self.shed.saturating_add(1);
            return false;
        }
        self.level -= EVENT;
        true
    }

    /// Returns `true` if the last event was shed.
    pub const fn is_shedding(&self) -> bool {
        self.shedding
    }

    /// Returns the number of events shed so far.
    pub const fn shed(&self) -> u32 {
        self.shed
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;
    use crate::event::Polarity;

    fn admitted(budget: EventBudget, times: &[i64]) -> (Vec<bool>, u32) {
        let mut shedder = LoadShedder::new(budget);
        let event = |&t: &i64| Event { t, x: 0, y: 0, polarity: Polarity::On };
        (times.iter().map(event).map(|event| shedder.admit(&event)).collect(), shedder.shed())
    }

    /// Reference implementation: wait for a whole burst, then admit events until less than one event is left.
    fn naive(budget: EventBudget, times: &[i64]) -> Vec<bool> {
        let burst = i128::from(budget.burst);
        let mut interval: Option<(i64, i128)> = times.first().map(|&t| (t, 0));
        let mut waiting_since = (0, 0_i128);
        // Inside an interval the bucket may overflow, so its level is followed event by event.
        let mut level = burst * 1_000_000;
        let mut before = times.first().copied().unwrap_or(0);
        let mut result = Vec::new();
        for &t in times {
            let income = i128::from(t - before) * i128::from(budget.events_per_second);
            before = t;
            if interval.is_none() {
                let (since, left) = waiting_since;
                let saved = left + i128::from(t - since) * i128::from(budget.events_per_second);
                if saved < burst * 1_000_000 {
                    result.push(false);
                    continue;
                }
                (interval, level) = (Some((t, 0)), burst * 1_000_000);
            } else {
                level = (level + income).min(burst * 1_000_000);
            }
            if level < 1_000_000 {
                (interval, waiting_since) = (None, (t, level));
                result.push(false);
            } else {
                level -= 1_000_000;
                result.push(true);
            }
        }
        result
    }

    fn times() -> impl Strategy<Value = Vec<i64>> {
        let step = prop_oneof![8 => 0_i64..5, 1 => 0_i64..1000];
        (any::<u32>(), prop::collection::vec(step, 1..600)).prop_map(|(start, steps)| {
            let mut t = i64::from(start);
            let sum = |step| {
                t += step;
                t
            };
            steps.into_iter().map(sum).collect()
        })
    }

    proptest! {
        #[test]
        fn the_shedder_equals_the_reference_implementation(times in times(), events_per_second in 0_u32..2_000_000, burst in 1_u32..80) {
            let budget = EventBudget { events_per_second, burst };
            let (passed, shed) = admitted(budget, &times);
            prop_assert_eq!(&passed, &naive(budget, &times));
            prop_assert_eq!(shed as usize, passed.iter().filter(|&&passed| !passed).count());
        }

        /// In any time interval, at most the budget of that interval plus one burst is admitted, and at least one burst
        /// is admitted before something is shed.
        #[test]
        fn the_budget_is_kept_and_at_least_one_burst_is_admitted_at_once(times in times(), events_per_second in 0_u32..2_000_000, burst in 1_u32..80) {
            let (passed, _) = admitted(EventBudget { events_per_second, burst }, &times);
            let passed_times: Vec<i64> = times.iter().zip(&passed).filter(|(_, passed)| **passed).map(|(t, _)| *t).collect();
            for (first, start) in passed_times.iter().enumerate() {
                for (count, end) in passed_times[first..].iter().enumerate() {
                    let most = f64::from(burst) + (end - start) as f64 * f64::from(events_per_second) * 1e-6;
                    prop_assert!((count + 1) as f64 <= most + 1e-6);
                }
            }
            let intervals: Vec<&[bool]> = passed.split(|&passed| !passed).collect();
            for interval in &intervals[..intervals.len() - 1] {
                prop_assert!(interval.is_empty() || interval.len() >= burst as usize);
            }
        }
    }

    #[test]
    fn extreme_times_are_handled() {
        let budget = EventBudget { events_per_second: u32::MAX, burst: u32::MAX };
        assert_eq!(admitted(budget, &[i64::MAX, i64::MIN, 0, i64::MAX, -5]).0, [true; 5]);
        assert_eq!(admitted(EventBudget { burst: 0, ..budget }, &[0, 1]).0, [false; 2]);
    }
}

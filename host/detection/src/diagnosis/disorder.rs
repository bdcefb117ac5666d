//! Events that are out of the order of their timestamps.

use std::fmt;

use event_recordings::ReadReport;

/// Share of all events from which they are reported.
const MANY: f64 = 0.05;
/// Backward steps shorter than this (µs) shift no edge by as much as a pixel.
const LONG: i64 = 1000;

/// Events that are earlier than a previous one and came too late to be sorted. A reader gives them the time of the
/// previous one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Disorder {
    /// Their share of all events.
    pub share: f64,
    /// The largest step back (µs).
    pub largest: i64,
}

impl Disorder {
    /// Returns the disorder that a reader reported, if it is large.
    pub fn met(report: &ReadReport) -> Option<Self> {
        let share = report.steps_back as f64 / report.events.max(1) as f64;
        let largest = report.largest_step_back;
        (share > MANY && largest >= LONG).then_some(Self { share, largest })
    }

    /// Remedy.
    pub const ADVICE: &str = "sort the events by time";
}

impl fmt::Display for Disorder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let milliseconds = self.largest as f64 * 1e-3;
        write!(f, "{:.0} % of the events are up to {milliseconds:.0} ms earlier than one before", 100.0 * self.share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_long_backward_steps_are_reported() {
        let met = |steps_back, largest_step_back| {
            Disorder::met(&ReadReport { events: 1000, steps_back, largest_step_back, ..ReadReport::default() })
        };
        let disorder = met(990, 29_980).unwrap();
        assert_eq!(disorder.to_string(), "99 % of the events are up to 30 ms earlier than one before");
        // A camera whose columns come a few microseconds apart, and a few events from another thread.
        assert_eq!((met(500, 20), met(40, 50_000), met(0, 0)), (None, None, None));
        assert_eq!(Disorder::met(&ReadReport::default()), None);
    }
}

//! Streams whose time span differs from the events' time span, for example because a driver stamped them with another clock.

use std::fmt;

use serde::Serialize;

use super::seconds;
use event_recordings::StreamSummary;

/// Fewest elements of a continuous stream, such as frames or IMU samples.
const FEWEST: u64 = 20;
/// Smallest difference of the beginning or the end that is reported (s).
const LEAST: f64 = 0.5;
/// The same difference as a share of the events' span.
const SHARE: f64 = 0.1;

/// A stream whose time span differs from the events' time span.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherSpan {
    /// Name of the stream.
    pub stream: String,
    /// Number of its elements.
    pub elements: u64,
    /// Start in seconds after the first event.
    pub from_s: f64,
    /// End in seconds after the first event.
    pub to_s: f64,
    /// Time from the first to the last event (s).
    pub events_s: f64,
}

impl OtherSpan {
    /// Returns `stream` if it begins or ends at another time than the `events` (µs).
    pub(super) fn new(stream: &StreamSummary, events: (i64, i64)) -> Option<Self> {
        let (first, last) = stream.times_us?;
        let after = |time: i64| seconds(time.saturating_sub(events.0));
        let (from_s, to_s, events_s) = (after(first), after(last), after(events.1));
        let difference = from_s.abs().max((to_s - events_s).abs());
        let is_different = stream.elements >= FEWEST && last > first && difference > LEAST.max(SHARE * events_s);
        is_different.then(|| Self { stream: stream.name.clone(), elements: stream.elements, from_s, to_s, events_s })
    }
}

impl fmt::Display for OtherSpan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { stream, elements, from_s, to_s, events_s } = self;
        let span = to_s - from_s;
        write!(
            f,
            "{stream} is from {from_s:.2} to {to_s:.2} s after the first event, which is {span:.2} s, the events last {events_s:.2} s: "
        )?;
        let rate = span / events_s;
        if (rate - 1.0).abs() < SHARE {
            return f.write_str("its clock has another origin");
        }
        let count = *elements as f64;
        write!(
            f,
            "if both were recorded together, its clock runs {rate:.2} times as fast, and it has {:.1} a second rather than {:.1}",
            count / events_s,
            count / span
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(from: f64, to: f64, elements: u64) -> Option<String> {
        let microseconds = |seconds: f64| (1e6 * seconds) as i64;
        let times_us = Some((microseconds(from), microseconds(to)));
        let stream = StreamSummary { name: "imu".to_owned(), packets: 1, elements, times_us, unread: None };
        OtherSpan::new(&stream, (0, 8_000_000)).map(|other| other.to_string())
    }

    #[test]
    fn a_clock_at_twice_the_rate_is_named_with_the_rate_that_is_right() {
        let text = named(0.0, 16.0, 8000).unwrap();
        assert!(text.contains("2.00 times as fast") && text.contains("1000.0 a second rather than 500.0"), "{text}");
        assert!(named(20.0, 36.0, 8000).unwrap().contains("2.00 times as fast"));
        assert!(named(-3.0, 5.0, 8000).unwrap().ends_with("has another origin"));
        // Frames every 40 ms, and occasional triggers.
        assert_eq!(named(0.04, 7.97, 200), None);
        assert_eq!(named(3.0, 4.0, 5), None);
    }
}

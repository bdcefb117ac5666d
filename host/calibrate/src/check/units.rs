//! Check of the unit of the timestamps.

use std::fmt;
use std::ops::{ControlFlow, Range};

use serde::{Serialize, Serializer};

use event_recordings::pass::read_while;
use event_recordings::{Recording, RecordingOptions, TimeUnit};

/// Usual number of events per second of event cameras in front of something that moves.
const USUAL: Range<f64> = 3e3..3e8;
/// Number of events per second below which hardly anything moves.
const SLOW: f64 = 1e4;
/// Recordings of a board with so little motion are hardly ever longer than this (s).
const LONG: f64 = 300.0;
/// A typical rate within that range.
const MIDDLE: f64 = 1e6;
/// Number of events from which a rate is computed.
const EVENTS: usize = 20_000;

/// A unit with which the rate of events is usual.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherUnit {
    /// The unit; `None` if the format has only one.
    #[serde(serialize_with = "as_words")]
    pub unit: Option<TimeUnit>,
    /// Events per second with the assumed unit.
    pub rate: f64,
    /// Events per second with this unit.
    pub other_rate: Option<f64>,
}

fn as_words<S: Serializer>(unit: &Option<TimeUnit>, serializer: S) -> Result<S::Ok, S::Error> {
    unit.map(|unit| unit.to_string()).serialize(serializer)
}

impl fmt::Display for OtherUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} events per second are unusual for a camera", in_words(self.rate))?;
        if let (Some(unit), Some(rate)) = (self.unit, self.other_rate) {
            write!(f, "; with times in {unit} it would be {}", in_words(rate))?;
        }
        Ok(())
    }
}

fn in_words(rate: f64) -> String {
    match rate {
        rate if rate >= 1e6 => format!("{:.1} million", rate / 1e6),
        rate if rate >= 10.0 => format!("{rate:.0}"),
        rate if rate >= 1e-3 => format!("{rate:.3}"),
        _ => "fewer than 0.001".to_owned(),
    }
}

/// Returns the more likely unit of the timestamps. Returns `None` if events have a usual `rate` (events per second) over the
/// whole recording or at its beginning, or the unit was given.
pub fn unusual_unit(recording: &Recording, rate: f64) -> Option<OtherUnit> {
    recording.options().time_unit.is_none().then(|| unit_for(USUAL, recording, rate))?
}

/// Does the same as [`unusual_unit`], from the beginning of a recording alone.
pub fn unusual_beginning(recording: &Recording) -> Option<OtherUnit> {
    unusual_unit(recording, first_rate(recording)?)
}

/// Does the same as [`unusual_unit`], for a recording in which no board was found: few events over many minutes are reported too, even
/// if the unit was given.
pub fn other_unit(recording: &Recording, rate: f64) -> Option<OtherUnit> {
    let is_slow = rate < SLOW && lasts_longer_than(recording, LONG);
    match is_slow {
        true => unit_for(SLOW..USUAL.end, recording, rate),
        false => unusual_unit(recording, rate),
    }
}

/// Returns the more likely unit if cameras send events at a `usual` rate.
fn unit_for(usual: Range<f64>, recording: &Recording, rate: f64) -> Option<OtherUnit> {
    // Events at a single time do not determine a rate.
    if rate <= 0.0 || !rate.is_finite() {
        return None;
    }
    // With a long time without events the total rate is small in any unit, so the rate at the beginning is used.
    let is_pause = || rate < usual.start && first_rate(recording).is_some_and(|rate| usual.contains(&rate));
    if usual.contains(&rate) || is_pause() {
        return None;
    }
    let rate_in = |unit: TimeUnit| {
        let options = RecordingOptions { time_unit: Some(unit), ..recording.options().clone() };
        first_rate(&Recording::new(recording.path(), options).ok()?)
    };
    // Timestamps with decimals were interpreted as seconds, and are never nanoseconds.
    let has_decimals = first_rate(recording).is_some_and(|rate| rate_in(TimeUnit::Seconds) == Some(rate));
    let units = [TimeUnit::Seconds, TimeUnit::Milliseconds, TimeUnit::Microseconds, TimeUnit::Nanoseconds];
    let units = units.into_iter().filter(|unit| !(has_decimals && *unit == TimeUnit::Nanoseconds));
    let rates = units.filter_map(|unit| Some((unit, rate_in(unit).filter(|rate| usual.contains(rate))?)));
    let from_middle = |rate: f64| (rate / MIDDLE).ln().abs();
    let best = rates.min_by(|a, b| from_middle(a.1).total_cmp(&from_middle(b.1)));
    Some(OtherUnit { unit: best.map(|(unit, _)| unit), rate, other_rate: best.map(|(_, rate)| rate) })
}

/// Returns `true` if there are more than `limit` seconds between the first and the last event.
fn lasts_longer_than(recording: &Recording, limit: f64) -> bool {
    let mut last = 0;
    let pass = read_while(recording, &mut |batch| {
        last = batch.events.last().map_or(last, |event| event.t);
        if last as f64 * 1e-6 > limit { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    pass.is_ok() && last as f64 * 1e-6 > limit
}

/// Returns the number of events per second at the beginning of a recording.
fn first_rate(recording: &Recording) -> Option<f64> {
    let mut reader = recording.open().ok()?;
    let (mut batch, mut first, mut last, mut count) = (Vec::new(), None, 0, 0);
    while count < EVENTS && reader.next_batch(&mut batch).ok()? {
        first = first.or(batch.first().map(|event| event.t));
        batch.truncate(EVENTS - count);
        last = batch.last().map_or(last, |event| event.t);
        count += batch.len();
    }
    let duration = (last - first?) as f64 * 1e-6;
    (duration > 0.0).then(|| count as f64 / duration)
}

#[cfg(test)]
mod tests {
    use evcal_core::event::{Event, Polarity};

    use super::*;

    /// An event every 11 days had a rate of "0.000 events per second".
    #[test]
    fn a_rate_of_next_to_nothing_is_not_zero() {
        let words = [0.0, 1e-6, 0.25, 1e-6 + 20.0, 3.2e8].map(in_words);
        assert_eq!(words, ["fewer than 0.001", "fewer than 0.001", "0.250", "20", "320.0 million"]);
    }

    /// Returns the more likely unit for 30 000 events `step` µs apart, with a pause of `pause` µs before the last
    /// thousand.
    fn suspected_unit(step: i64, pause: i64) -> Option<Option<TimeUnit>> {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        let line = |index: i64| {
            let t = index * step + if index < 29_000 { 0 } else { pause };
            format!("{t},{},{},{}\n", index % 346, index % 260, index % 2)
        };
        std::fs::write(&path, format!("t,x,y,p\n{}", (0..30_000).map(line).collect::<String>())).unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        let duration = (29_999 * step + pause) as f64 * 1e-6;
        other_unit(&recording, 30_000.0 / duration).map(|other| other.unit)
    }

    #[test]
    fn a_pause_does_not_make_the_unit_wrong() {
        assert_eq!(suspected_unit(1, 0), None);
        // A year without events in a recording in µs: the unit is not reported as wrong.
        assert_eq!(suspected_unit(1, 31_557_600_000_000), None);
        // Multiples of 1000 are recognised as nanoseconds at once.
        assert_eq!(suspected_unit(1001, 0), Some(Some(TimeUnit::Nanoseconds)));
    }

    /// A rate of 650 million events per second is reported, although the recording begins slowly.
    #[test]
    fn too_many_events_are_suspected_whatever_the_beginning() {
        let event = |index: i64| {
            let t = if index < 20_000 { index / 10 } else { 2000 + (index - 20_000) / 650 };
            let polarity = if index % 2 == 0 { Polarity::On } else { Polarity::Off };
            Event { t, x: 1, y: 2, polarity }
        };
        let recording =
            Recording::from_events("events", (0..2_000_000).map(event).collect(), RecordingOptions::default());
        assert_eq!(unusual_unit(&recording, 4e8).map(|other| other.unit), Some(None));
    }

    /// Nanoseconds are excluded, although 26 million events per second would be nearer to the typical rate.
    #[test]
    fn timestamps_with_decimals_are_not_nanoseconds() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        let line = |index: i64| format!("{}.25,{},{},{}\n", 38 * index, index % 346, index % 260, index % 2);
        std::fs::write(&path, format!("t,x,y,p\n{}", (0..30_000).map(line).collect::<String>())).unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        let other = other_unit(&recording, 1.0 / 38.0).unwrap();
        assert_eq!(other.unit, Some(TimeUnit::Microseconds));
    }

    /// Nanoseconds that were interpreted as microseconds, from a camera with 5 million events per second.
    #[test]
    fn few_events_for_many_minutes_are_suspected() {
        let events = |count: i64| -> Vec<Event> {
            let on = |index: i64| if index % 2 == 0 { Polarity::On } else { Polarity::Off };
            (0..count).map(|index| Event { t: index * 200, x: 1, y: 2, polarity: on(index) }).collect()
        };
        let of = |count: i64| Recording::from_events("events", events(count), RecordingOptions::default());
        // Recordings of 301 s are suspicious, those of 200 s are not; a recording in memory has no other unit to try.
        assert_eq!(other_unit(&of(1_505_000), 5000.0).map(|other| other.unit), Some(None));
        assert_eq!(other_unit(&of(1_000_000), 5000.0), None);
    }
}

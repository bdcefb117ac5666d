//! Are times in the unit that they were taken for?

use std::fmt;

use serde::{Serialize, Serializer};

use crate::recording::{Recording, RecordingOptions, TimeUnit};

/// Events a second that event cameras send in front of something that moves.
const USUAL: std::ops::Range<f64> = 3e3..3e8;
/// What is in the middle of that.
const MIDDLE: f64 = 1e6;
/// Events from which a rate is taken.
const EVENTS: usize = 20_000;

/// A unit with which the rate of events is a usual one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OtherUnit {
    /// What `--time-unit` takes; `None` where the format leaves no choice.
    #[serde(serialize_with = "as_words")]
    pub unit: Option<TimeUnit>,
    /// Events a second as the times were taken.
    pub rate: f64,
    /// Events a second in this unit.
    pub other_rate: Option<f64>,
}

fn as_words<S: Serializer>(unit: &Option<TimeUnit>, serializer: S) -> Result<S::Ok, S::Error> {
    unit.map(|unit| unit.to_string()).serialize(serializer)
}

impl OtherUnit {
    /// What to do.
    pub fn advice(&self) -> String {
        let unit = match self.unit {
            Some(TimeUnit::Seconds) => "s",
            Some(TimeUnit::Milliseconds) => "ms",
            Some(TimeUnit::Microseconds) => "us",
            Some(TimeUnit::Nanoseconds) => "ns",
            None => return "are the times in the file in the unit of its format?".to_owned(),
        };
        format!("add --time-unit {unit}")
    }
}

impl fmt::Display for OtherUnit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} events a second are hardly what a camera sends", in_words(self.rate))?;
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
        rate => format!("{rate:.3}"),
    }
}

/// What the unit of the times is more likely to be; `None` if events come at a usual `rate` (events a second), or the unit
/// was given.
pub fn other_unit(recording: &Recording, rate: f64) -> Option<OtherUnit> {
    // Of events at one time nothing can be told.
    if rate <= 0.0 || !rate.is_finite() || USUAL.contains(&rate) || recording.options().time_unit.is_some() {
        return None;
    }
    let units = [TimeUnit::Seconds, TimeUnit::Milliseconds, TimeUnit::Microseconds, TimeUnit::Nanoseconds];
    let rates = units.into_iter().filter_map(|unit| {
        let options = RecordingOptions { time_unit: Some(unit), ..recording.options().clone() };
        let rate = first_rate(&Recording::new(recording.path(), options).ok()?)?;
        USUAL.contains(&rate).then_some((unit, rate))
    });
    let from_middle = |rate: f64| (rate / MIDDLE).ln().abs();
    let best = rates.min_by(|a, b| from_middle(a.1).total_cmp(&from_middle(b.1)));
    Some(OtherUnit { unit: best.map(|(unit, _)| unit), rate, other_rate: best.map(|(_, rate)| rate) })
}

/// Events a second at the beginning of a recording.
fn first_rate(recording: &Recording) -> Option<f64> {
    let mut reader = recording.open().ok()?;
    let (mut batch, mut first, mut last, mut count) = (Vec::new(), None, 0, 0);
    while count < EVENTS && reader.next_batch(&mut batch).ok()? {
        first = first.or(batch.first().map(|event| event.t));
        last = batch.last().map_or(last, |event| event.t);
        count += batch.len();
    }
    let duration = (last - first?) as f64 * 1e-6;
    (duration > 0.0).then(|| count as f64 / duration)
}

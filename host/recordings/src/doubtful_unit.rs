//! Choice of the time unit for times that are all multiples of 1000. They are either nanoseconds of a camera that
//! counts microseconds, or microseconds of a camera that counts milliseconds. The event rate decides.

use evcal_core::event::Event;

use crate::options::TimeUnit;
use crate::read_report::ReadReport;
use crate::reader::{Decode, Opened};

/// Highest rate in events per second that a camera can sustain for [`EVENTS`] events.
const MOST_EVENTS_A_SECOND: f64 = 1e8;
/// Number of events from which the rate is computed.
const EVENTS: usize = 1 << 20;

/// Returns the rate in events per second if it is higher than any camera's. `decoder` must be at its beginning.
pub fn impossible_rate(mut decoder: Box<dyn Decode>) -> Option<f64> {
    let (mut batch, mut count) = (Vec::new(), 0);
    let mut span: Option<(i64, i64)> = None;
    let mut more = true;
    while more && count < EVENTS {
        batch.clear();
        // The pass that follows reports any fault of the file.
        more = decoder.decode(&mut batch, &mut ReadReport::default()).unwrap_or(false);
        count += batch.len();
        for Event { t, .. } in &batch {
            let (first, last) = span.unwrap_or((*t, *t));
            span = Some((first.min(*t), last.max(*t)));
        }
    }
    let (first, last) = span?;
    let rate = count as f64 / (last.saturating_sub(first).max(1) as f64 * 1e-6);
    (rate > MOST_EVENTS_A_SECOND).then_some(rate)
}

/// Notes in `opened`, a file that was opened with microseconds, that nanoseconds would have given this impossible `rate`
/// (events per second).
pub fn note_correction(opened: &mut Opened, rate: f64) {
    let (unit, nanoseconds) = (TimeUnit::Microseconds, TimeUnit::Nanoseconds);
    let millions = rate / 1e6;
    opened.information.notes.push(format!(
        "times are taken for {unit}: in {nanoseconds} there would be {millions:.0} million events per second, which is impossible"
    ));
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;

    use crate::{Recording, RecordingOptions};

    /// Returns the last time and the notes of 100,000 events. Groups of `together` events have the same time, a
    /// multiple of `step`.
    fn read(together: i64, step: i64) -> (i64, Vec<String>) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("events.csv");
        let mut text = "t,x,y,p\n".to_owned();
        for index in 0..100_000 {
            // The beginning, from which the unit is guessed, has a low rate.
            let t = if index < 2000 { index / 50 } else { 40 + (index - 2000) / together } * step;
            let _ = writeln!(text, "{t},{},{},{}", index % 346, index % 260, index % 2);
        }
        std::fs::write(&path, text).unwrap();
        let mut reader = Recording::new(&path, RecordingOptions::default()).unwrap().open().unwrap();
        let (mut batch, mut last) = (Vec::new(), 0);
        while reader.next_batch(&mut batch).unwrap() {
            last = batch.last().unwrap().t;
        }
        (last, reader.information().notes.clone())
    }

    /// Whole milliseconds, written as microseconds, of a camera with 0.65 million events per second. Taken for
    /// nanoseconds, the rate would be 650 million.
    #[test]
    fn an_impossible_rate_rejects_the_guess() {
        let (last, notes) = read(650, 1000);
        assert_eq!(last, 190_000);
        assert!(
            notes.iter().any(|note| note.contains("taken for microseconds: in nanoseconds there would be 5")),
            "{notes:?}"
        );
        // Microseconds, written as nanoseconds, of a camera with 7 million events per second.
        let (last, notes) = read(7, 1000);
        assert_eq!(last, 14_039);
        assert!(notes.iter().any(|note| note.contains("taken for nanoseconds")), "{notes:?}");
    }
}

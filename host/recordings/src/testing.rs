//! Helpers for the tests of all formats.

use std::path::Path;

use evcal_core::event::{Event, Polarity};
use tempfile::TempDir;

use super::{Damage, ReadReport, Recording, RecordingInformation, RecordingOptions};

/// Result of a pass through a recording.
pub struct Outcome {
    pub events: Vec<Event>,
    /// `None` if the file could not be opened.
    pub information: Option<RecordingInformation>,
    pub report: ReadReport,
    pub error: Option<String>,
}

/// Reads a file with this content.
pub fn read(content: &[u8]) -> Outcome {
    read_with(content, RecordingOptions::default())
}

/// Creates a folder for thousands of short-lived files, in memory if possible, because removing a file from a disk may
/// take a millisecond.
fn short_lived() -> TempDir {
    tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap()
}

/// Reads a file with this content, including frames and IMU samples.
pub fn read_with(content: &[u8], options: RecordingOptions) -> Outcome {
    let directory = short_lived();
    let path = directory.path().join("recording");
    std::fs::write(&path, content).unwrap();
    read_file(&path, options)
}

/// Reads the file at `path`, including frames and IMU samples.
pub fn read_file(path: &Path, options: RecordingOptions) -> Outcome {
    let mut outcome = Outcome { events: Vec::new(), information: None, report: ReadReport::default(), error: None };
    let opened = Recording::new(path, options).and_then(|recording| Ok((recording.open()?, recording)));
    let (mut reader, recording) = match opened {
        Ok(opened) => opened,
        Err(error) => return Outcome { error: Some(error.to_string()), ..outcome },
    };
    // None of this may panic.
    let _ = (recording.streams(), recording.visit_frames(|_| {}));
    if let Ok(mut extras) = recording.open_extras() {
        while extras.next_until(i64::MAX, &mut Vec::new()).is_some() {}
    }
    let mut batch = Vec::new();
    loop {
        match reader.next_batch(&mut batch) {
            Ok(true) => outcome.events.extend_from_slice(&batch),
            Ok(false) => break,
            Err(error) => {
                outcome.error = Some(error.to_string());
                break;
            }
        }
    }
    outcome.information = Some(reader.information().clone());
    outcome.report = reader.report().clone();
    outcome
}

/// Truncations of a count by 32-bit counters: unsigned, signed, and unsigned with 31 bits.
pub const KEPT: [fn(i64) -> i64; 3] =
    [|count| (count as u32).into(), |count| (count as i32).into(), |count| count & 0x7fff_ffff];

/// Returns events around this time, 150 µs apart; some are up to 3 ms earlier than the events before them.
pub fn events_around(time: i64) -> Vec<Event> {
    let event = |index: i64| Event {
        t: time - 1 + 150 * (index - 500) - if index % 13 == 0 { 3000 } else { 0 },
        x: (index * 7 % 340) as u16 + 2,
        y: (index * 11 % 250) as u16 + 2,
        polarity: if index % 3 == 0 { Polarity::On } else { Polarity::Off },
    };
    (0..1000).map(event).collect()
}

/// Checks that a file with the times of a counter that wraps gives the same events as one with times of 64 bits.
pub fn check_wrap(wrapped: &[u8], whole: &[u8]) {
    let [mut wrapped, whole] = [wrapped, whole].map(read);
    assert_eq!((whole.report.counter_wraps, whole.report.clock_resets, whole.events.len()), (None, 0, 1000));
    assert!(wrapped.report.sorted > 70);
    let wraps = wrapped.report.counter_wraps.take();
    assert!(wraps.is_some_and(|wraps| wraps.count == 1 && wraps.first_event == 502), "{wraps:?}");
    assert_eq!((wrapped.error, wrapped.events, wrapped.report), (None, whole.events, whole.report));
}

/// Checks damaged versions of a file. A file cut at any byte gives the first of its events and reports the loss or the
/// damage. A file with any byte changed causes no panic and gives events in order of time.
pub fn check_damage(content: &[u8]) {
    let whole = read(content);
    assert!(whole.error.is_none() && !whole.events.is_empty(), "{:?}", whole.error);
    for cut in 0..content.len() {
        let part = read(&content[..cut]);
        assert!(whole.events.starts_with(&part.events), "cut at {cut}");
        let is_reported = part.error.is_some() || part.report.truncated.is_some();
        // A cut at the end of a record cannot be detected.
        let few = content.len() - cut;
        assert!(is_reported || part.events.len() < whole.events.len() || few < 64, "cut at {cut}");
        if let Some(truncated) = part.report.truncated {
            assert!(truncated.byte <= cut as u64, "cut at {cut}: {}", truncated.byte);
        }
    }
    let mut changed = content.to_vec();
    for position in 0..changed.len() {
        let change = [0x01, 0x80, 0xff][position % 3];
        changed[position] ^= change;
        for damage in [Damage::Refuse, Damage::Skip] {
            let outcome = read_with(&changed, RecordingOptions { damage, ..RecordingOptions::default() });
            assert!(outcome.events.is_sorted_by_key(|event| event.t), "changed at {position}");
            assert_eq!(outcome.report.events, outcome.events.len() as u64);
        }
        changed[position] ^= change;
    }
}

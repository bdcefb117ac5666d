//! One pass through a recording on a thread of its own, with a report.

use std::ops::ControlFlow;
use std::sync::mpsc::{Receiver, SyncSender, channel, sync_channel};

use evcal_core::event::Event;
use serde::{Deserialize, Serialize};

use crate::date::date;
use crate::error::RecordingError;
use crate::read_report::ReadReport;
use crate::reader::RecordingInformation;
use crate::recording::Recording;

/// Report of reading one recording, as it is stored with a calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingReport {
    /// Events or circles read.
    pub count: u64,
    /// Duration in seconds.
    pub duration: f64,
    /// Model and serial number of the camera, if the recording contains them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_name: Option<String>,
    /// Date of the recording, if it contains one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub began: Option<String>,
    /// Assumptions, corrections and losses, in sentences.
    pub notes: Vec<String>,
}

/// Result of one pass through a recording.
pub struct Pass {
    /// Events passed to the visitor.
    pub count: u64,
    /// Time of the first event in the file (µs).
    pub first: i64,
    /// Time of the last event in the file (µs).
    pub last: i64,
    /// Model and serial number of the camera, if the recording contains them.
    pub camera_name: Option<String>,
    /// Date of the recording, if it contains one.
    pub began: Option<String>,
    /// Assumptions of the reader, in sentences.
    pub assumptions: Vec<String>,
    /// Counts and corrections of the reader.
    pub report: ReadReport,
    /// Error that ended the pass before the end of the recording.
    pub damage: Option<RecordingError>,
}

impl Pass {
    /// Summarises the pass as a report.
    pub fn to_report(&self) -> RecordingReport {
        let mut notes = self.assumptions.clone();
        notes.extend(self.report.warnings());
        if let Some(error) = &self.damage {
            notes.push(format!("read only up to the damage: {error}"));
        }
        RecordingReport {
            count: self.count,
            duration: (self.last - self.first) as f64 * 1e-6,
            camera_name: self.camera_name.clone(),
            began: self.began.clone(),
            notes,
        }
    }
}

/// Number of batches that are read in advance.
const READ_AHEAD: usize = 4;

/// Passes all events of a recording to `visit`, with times relative to the first event. If the recording is damaged,
/// passes the events before the damage. A separate thread reads ahead.
///
/// # Errors
/// [`RecordingError`] if no event can be read.
pub fn read_recording(recording: &Recording, visit: &mut dyn FnMut(&[Event])) -> Result<Pass, RecordingError> {
    read_while(recording, &mut |batch| {
        visit(batch.events);
        ControlFlow::Continue(())
    })
}

/// Consecutive events of a recording.
#[derive(Clone, Copy, Debug)]
pub struct Batch<'a> {
    /// The events, with times relative to the first event of the recording.
    pub events: &'a [Event],
    /// Fraction of the recording read after this batch, 0 to 1; `None` if unknown.
    pub done: Option<f64>,
}

/// Reads like [`read_recording`] until `visit` returns `Break`. The result then covers the events read so far.
///
/// # Errors
/// As for [`read_recording`], and [`RecordingErrorKind::Changed`] if a file changed since the recording was opened.
///
/// [`RecordingErrorKind::Changed`]: crate::RecordingErrorKind::Changed
pub fn read_while(
    recording: &Recording,
    visit: &mut dyn FnMut(Batch) -> ControlFlow<()>,
) -> Result<Pass, RecordingError> {
    std::thread::scope(|scope| {
        let (sender, batches) = sync_channel(READ_AHEAD);
        let (used, buffers) = channel();
        let reader = scope.spawn(move || read_ahead(recording, &sender, &buffers));
        // Dropping the iterator closes the channel, which ends the reader.
        let _ = batches.into_iter().try_for_each(|(events, done)| {
            let flow = visit(Batch { events: &events, done });
            // After its last batch the reader needs no buffer.
            let _ = used.send(events);
            flow
        });
        reader.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

/// Reads a recording and sends its batches; `buffers` returns their memory, to be used again.
fn read_ahead(
    recording: &Recording,
    sender: &SyncSender<(Vec<Event>, Option<f64>)>,
    buffers: &Receiver<Vec<Event>>,
) -> Result<Pass, RecordingError> {
    recording.source_files().check()?;
    let mut reader = recording.open()?;
    let (mut count, mut first, mut last) = (0, None, 0);
    let damage = loop {
        let mut events = buffers.try_recv().unwrap_or_default();
        match reader.next_batch(&mut events) {
            Ok(true) => {}
            Ok(false) => break None,
            // The events before the damage are kept.
            Err(error) if count > 0 && !error.kind.is_repetition() => break Some(error),
            Err(error) => {
                recording.source_files().check()?;
                return Err(error);
            }
        }
        let start = *first.get_or_insert_with(|| events.first().map_or(0, |event| event.t));
        last = events.last().map_or(last, |event| event.t);
        count += events.len() as u64;
        for event in &mut events {
            event.t -= start;
        }
        if sender.send((events, reader.done())).is_err() {
            // The visitor has stopped.
            break None;
        }
    };
    // Damage, too, may be a change of the file.
    recording.source_files().check()?;
    let RecordingInformation { camera_name, began, notes: assumptions, .. } = reader.information().clone();
    let began = began.or_else(|| date(first?));
    let report = reader.report().clone();
    Ok(Pass { count, first: first.unwrap_or(0), last, camera_name, began, assumptions, report, damage })
}

#[cfg(test)]
mod tests {
    use std::fs::File;
    use std::io::Write;
    use std::path::{Path, PathBuf};

    use evcal_core::event::Polarity;
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::encode::OutputFormat;
    use crate::write::EventWriter;
    use crate::{RecordingErrorKind, RecordingOptions};

    fn events() -> Vec<Event> {
        let event = |index: i64| Event {
            t: 1_000_000 + 20 * index,
            x: (index * 7 % 346) as u16,
            y: (index * 11 % 260) as u16,
            polarity: if index % 3 == 0 { Polarity::On } else { Polarity::Off },
        };
        (0..200_000).map(event).collect()
    }

    fn write(path: &Path) -> Recording {
        let output = OutputFormat::from_extension(path).unwrap();
        let mut writer = EventWriter::create(path, output, Sensor::new(346, 260), "").unwrap();
        writer.write(&events()).unwrap();
        writer.finish().unwrap();
        // Longer than the resolution of a file system's clock.
        std::thread::sleep(std::time::Duration::from_millis(30));
        Recording::new(path, RecordingOptions::default()).unwrap()
    }

    fn is_changed(read: Result<Pass, RecordingError>, path: &Path) -> bool {
        read.is_err_and(|error| matches!(error.kind, RecordingErrorKind::Changed) && error.path == path)
    }

    #[test]
    fn a_file_that_changes_while_or_after_it_is_read_is_an_error() {
        let changes: [fn(&Path); 3] = [
            |path| File::options().append(true).open(path).unwrap().write_all(b"1").unwrap(),
            |path| File::options().write(true).open(path).unwrap().set_len(1 << 20).unwrap(),
            |path| {
                let copy = path.with_extension("copy");
                std::fs::copy(path, &copy).unwrap();
                std::fs::rename(copy, path).unwrap();
            },
        ];
        for extension in ["raw", "aedat4", "bag", "h5"] {
            for change in changes {
                let folder = tempfile::tempdir().unwrap();
                let path = folder.path().join("recording").with_extension(extension);
                let recording = write(&path);
                assert_eq!(read_recording(&recording, &mut |_| {}).unwrap().count, 200_000);
                change(&path);
                assert!(is_changed(read_recording(&recording, &mut |_| {}), &path), "{extension}");
                let recording = write(&path);
                let mut is_first = true;
                let read = read_recording(&recording, &mut |_| {
                    if std::mem::take(&mut is_first) {
                        change(&path);
                    }
                });
                assert!(is_changed(read, &path), "{extension}");
                assert!(recording.source_files().checksums().is_err());
            }
        }
    }

    /// The file of a folder changes, not the folder.
    #[test]
    fn all_files_of_a_folder_are_watched() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("part_0.mcap");
        drop(write(&file));
        let metadata = "rosbag2_bagfile_information:\n  relative_file_paths: [part_0.mcap]\n";
        std::fs::write(folder.path().join("metadata.yaml"), metadata).unwrap();
        let recording = Recording::new(folder.path(), RecordingOptions::default()).unwrap();
        let names: Vec<PathBuf> =
            recording.source_files().checksums().unwrap().into_iter().map(|sum| sum.path).collect();
        assert_eq!(names, [folder.path().join("metadata.yaml"), file.clone()]);
        assert!(read_recording(&recording, &mut |_| {}).is_ok());
        File::options().append(true).open(&file).unwrap().write_all(b"1").unwrap();
        assert!(is_changed(read_recording(&recording, &mut |_| {}), &file));
    }
}

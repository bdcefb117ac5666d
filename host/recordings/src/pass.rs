//! One pass through a recording.

use std::ops::ControlFlow;
use std::sync::mpsc::{SyncSender, sync_channel};

use evcal_core::event::Event;
use serde::{Deserialize, Serialize};

use crate::date::date;
use crate::error::RecordingError;
use crate::read_report::ReadReport;
use crate::reader::RecordingInformation;
use crate::recording::Recording;

/// What was read of a recording.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingReport {
    /// Events or circles read.
    pub count: u64,
    /// Duration in seconds.
    pub duration: f64,
    /// Model and serial number of the camera, if the recording tells them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_name: Option<String>,
    /// When it was recorded, if it tells that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub began: Option<String>,
    /// What was assumed, repaired or lost, in sentences.
    pub notes: Vec<String>,
}

/// What one pass through a recording met.
pub struct Pass {
    /// Events handed out.
    pub count: u64,
    /// Time of the first event in the file (µs).
    pub first: i64,
    /// Time of the last event in the file (µs).
    pub last: i64,
    /// Model and serial number of the camera, if the recording tells them.
    pub camera_name: Option<String>,
    /// When it was recorded, if it tells that.
    pub began: Option<String>,
    /// What the reader assumed.
    pub assumptions: Vec<String>,
    /// What the reader met.
    pub report: ReadReport,
    /// What ended the pass before the end of the recording.
    pub damage: Option<RecordingError>,
}

impl Pass {
    /// The pass as a report.
    pub fn to_report(&self) -> RecordingReport {
        let mut notes = self.assumptions.clone();
        notes.extend(self.report.warnings());
        if let Some(error) = &self.damage {
            notes.push(format!("read up to its damage only: {error}"));
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

/// Batches that are read while earlier ones are worked on.
const READ_AHEAD: usize = 4;

/// Hands all events of a recording to `visit`, with times from its first event; of a damaged recording
/// those before the damage. A thread of its own reads ahead.
///
/// # Errors
/// [`RecordingError`] when not one event can be read.
pub fn read_recording(recording: &Recording, visit: &mut dyn FnMut(&[Event])) -> Result<Pass, RecordingError> {
    read_while(recording, &mut |batch| {
        visit(batch.events);
        ControlFlow::Continue(())
    })
}

/// Events that follow each other in a recording.
#[derive(Clone, Copy, Debug)]
pub struct Batch<'a> {
    /// The events, with times from the first one of the recording.
    pub events: &'a [Event],
    /// Which part of the recording was read with them, 0 to 1; `None` where that is not known.
    pub done: Option<f64>,
}

/// As [`read_recording`], until `visit` breaks it off; the pass is then that of what was read.
///
/// # Errors
/// As there.
pub fn read_while(
    recording: &Recording,
    visit: &mut dyn FnMut(Batch) -> ControlFlow<()>,
) -> Result<Pass, RecordingError> {
    std::thread::scope(|scope| {
        let (sender, batches) = sync_channel(READ_AHEAD);
        let reader = scope.spawn(move || read_ahead(recording, &sender));
        // The batches are dropped with the iterator, and the reader notices.
        let _ = batches.into_iter().try_for_each(|(events, done)| visit(Batch { events: &events, done }));
        reader.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

fn read_ahead(recording: &Recording, sender: &SyncSender<(Vec<Event>, Option<f64>)>) -> Result<Pass, RecordingError> {
    let mut reader = recording.open()?;
    let (mut count, mut first, mut last) = (0, None, 0);
    let damage = loop {
        let mut events = Vec::new();
        match reader.next_batch(&mut events) {
            Ok(true) => {}
            Ok(false) => break None,
            // What was read before the damage counts.
            Err(error) if count > 0 => break Some(error),
            Err(error) => return Err(error),
        }
        let start = *first.get_or_insert_with(|| events.first().map_or(0, |event| event.t));
        last = events.last().map_or(last, |event| event.t);
        count += events.len() as u64;
        for event in &mut events {
            event.t -= start;
        }
        if sender.send((events, reader.done())).is_err() {
            // Nobody listens any more.
            break None;
        }
    };
    let RecordingInformation { camera_name, began, notes: assumptions, .. } = reader.information().clone();
    let began = began.or_else(|| date(first?));
    let report = reader.report().clone();
    Ok(Pass { count, first: first.unwrap_or(0), last, camera_name, began, assumptions, report, damage })
}

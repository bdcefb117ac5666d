//! Distinction of files of events from files of circles.

use std::path::{Path, PathBuf};

use evcal_files::remedies;
use event_recordings::{Head, Recording, RecordingError, RecordingOptions};

use super::{stream, track};

/// Content of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// Events, or unknown content.
    Events,
    /// Circles that a detector found: see [`track`](mod@track).
    CircleTrack,
    /// Circles from a microcontroller: see [`stream`](mod@stream).
    CircleStream,
}

impl InputKind {
    /// Determines the kind of the file at `path` from its content.
    ///
    /// # Errors
    /// [`RecordingError`] if it cannot be read.
    pub fn of(path: &Path) -> Result<Self, RecordingError> {
        if path.is_dir() {
            return Ok(Self::Events);
        }
        let head = Head::read(path)?;
        Ok(match head.text() {
            Some(text) if track::is_circle_track(text) => Self::CircleTrack,
            _ if stream::is_circle_stream(&head.bytes) => Self::CircleStream,
            _ => Self::Events,
        })
    }
}

/// Reasons why a file of events cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum EventsError {
    /// It is a circle track or stream.
    #[error("{} contains circles, not events", .0.display())]
    Circles(PathBuf),
    /// It cannot be read as a recording.
    #[error("{0}")]
    Recording(#[from] RecordingError),
}

remedies! { EventsError, say;
    Self::Circles(_) => "{} reads this file; other commands need the recording", say.calibrate?;
    Self::Recording(error) => error.remedy(say);
}

/// Opens the events of the file or folder at `path`.
///
/// # Errors
/// [`EventsError`] if it contains no events or cannot be read.
pub fn open_events(path: &Path, options: RecordingOptions) -> Result<Recording, EventsError> {
    match InputKind::of(path)? {
        InputKind::Events => Ok(Recording::new(path, options)?),
        InputKind::CircleTrack | InputKind::CircleStream => Err(EventsError::Circles(path.to_owned())),
    }
}

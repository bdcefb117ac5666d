//! Writer of recordings with one event stream, and the list of output formats.

use std::fmt;
use std::fs::File;
use std::path::Path;
use std::str::FromStr;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;

pub use super::encode::OutputFormat;
use super::encode::{Description, Encode, WriteError};
use super::extras::OtherStreams;
use crate::formats::FORMATS;
use crate::prophesee;

/// Returns the formats that can be written.
pub fn output_formats() -> impl Iterator<Item = OutputFormat> {
    FORMATS.iter().filter_map(|format| format.output).chain([&prophesee::EVT4_OUTPUT]).copied()
}

impl OutputFormat {
    /// Returns the output format for the extension of `path`, if there is one.
    pub fn from_extension(path: &Path) -> Option<Self> {
        let extension = path.extension()?.to_string_lossy().to_lowercase();
        output_formats().find(|format| format.extensions.contains(&extension.as_str()))
    }
}

/// The text is not the name of an output format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub struct NoOutputFormat;

impl fmt::Display for NoOutputFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |format: OutputFormat| match format.title {
            Some(title) => format!("{} ({title})", format.name),
            None => format.name.to_owned(),
        };
        write!(f, "write {}", listed(output_formats().map(name)))
    }
}

/// Parses the name of a format as on the command line.
impl FromStr for OutputFormat {
    type Err = NoOutputFormat;

    fn from_str(text: &str) -> Result<Self, NoOutputFormat> {
        output_formats().find(|format| format.name == text).ok_or(NoOutputFormat)
    }
}

/// Returns the extensions of all output formats as text for a sentence: ".a, .b or .c".
pub fn output_extensions() -> String {
    listed(output_formats().flat_map(|format| format.extensions).map(|extension| format!(".{extension}")))
}

/// Joins words with commas, and "or" before the last.
fn listed(words: impl Iterator<Item = String>) -> String {
    let words: Vec<String> = words.collect();
    match words.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => String::new(),
    }
}

/// Writer of a recording with one event stream.
pub struct EventWriter(Box<dyn Encode>);

impl EventWriter {
    /// Creates the file at `path` for events of a sensor of `sensor` (width, height) pixels. `camera_name` (model and
    /// serial number) is stored if the format supports it.
    ///
    /// # Errors
    /// When the file cannot be created, or the format does not support this sensor.
    pub fn create(path: &Path, format: OutputFormat, sensor: Sensor, camera_name: &str) -> Result<Self, WriteError> {
        let description = Description { sensor, camera_name, others: OtherStreams::default(), zero: 0 };
        Ok(Self((format.create)(&mut || File::create(path), &description)?))
    }

    /// Writes `events`. Their times must not be earlier than times written before.
    ///
    /// # Errors
    /// When the output cannot be written.
    pub fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        self.0.write(events)
    }

    /// Completes the file. Without this call it is incomplete, as if the program had been killed.
    ///
    /// # Errors
    /// When the output cannot be written.
    pub fn finish(mut self) -> Result<(), WriteError> {
        self.0.finish()
    }
}

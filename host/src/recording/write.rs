//! Writing recordings: AEDAT4, text and EventCalib binary.

use evcal_core::sensor::Sensor;
use std::fs::File;
use std::io::{self, BufWriter};
use std::path::{Path, PathBuf};

use evcal_core::event::Event;
use usb_davis::dump::DumpError;
use usb_davis::protocol::EncodeError;

use super::aedat4::header::Compression;
use super::{aedat4, event_calib, text};

/// Why a recording could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The operating system refused.
    #[error("cannot be written: {0}")]
    Io(#[from] io::Error),
    /// More than a size field can hold.
    #[error("a packet or header is too large for its format")]
    TooLarge,
    /// A DAVIS346 has another sensor.
    #[error("a DAVIS346 has 346x260 pixels; the recording is for a sensor of {}x{}", .0.width, .0.height)]
    Sensor(Sensor),
    /// A camera could not have sent this.
    #[error("cannot be said in the words of a DAVIS346: {0}")]
    Wire(#[from] EncodeError),
    /// A dump refuses it.
    #[error("cannot be written: {0}")]
    Dump(#[from] DumpError),
    /// No format has this file name extension.
    #[error("{}: unknown extension; use .aedat4, .csv, .txt or .bin", .0.display())]
    Extension(PathBuf),
}

/// A format to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputFormat {
    /// AEDAT4 with this compression.
    Aedat4(Compression),
    /// Text with a line of names, `t_us,x,y,p`.
    Text,
    /// EventCalib binary.
    EventCalib,
}

impl OutputFormat {
    /// The format that the extension of `path` stands for: `.aedat4` (Zstandard), `.csv` and `.txt`,
    /// `.bin` (EventCalib).
    pub fn from_extension(path: &Path) -> Result<Self, WriteError> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("aedat4") => Ok(Self::Aedat4(Compression::Zstd)),
            Some("csv" | "txt") => Ok(Self::Text),
            Some("bin") => Ok(Self::EventCalib),
            _ => Err(WriteError::Extension(path.to_owned())),
        }
    }
}

/// Turns events into the bytes of one format.
pub trait Encode {
    /// Writes `events`, which come after those written before.
    fn write(&mut self, events: &[Event]) -> Result<(), WriteError>;
    /// Writes whatever closes the file.
    fn finish(&mut self) -> Result<(), WriteError>;
}

/// Writes a recording of one event stream.
pub struct EventWriter(Box<dyn Encode>);

impl EventWriter {
    /// Creates the file at `path` for events of a sensor of `sensor` (width, height) pixels.
    /// `camera_name` (model and serial number) is kept where the format has a place for it.
    pub fn create(path: &Path, format: OutputFormat, sensor: Sensor, camera_name: &str) -> Result<Self, WriteError> {
        let file = BufWriter::with_capacity(1 << 18, File::create(path)?);
        Ok(Self(match format {
            OutputFormat::Aedat4(compression) => {
                Box::new(aedat4::write::Encoder::new(file, compression, sensor, camera_name)?)
            }
            OutputFormat::Text => Box::new(text::Encoder::new(file, sensor)?),
            OutputFormat::EventCalib => Box::new(event_calib::Encoder(file)),
        }))
    }

    /// Writes `events`, whose times must not be earlier than those written before.
    pub fn write(&mut self, events: &[Event]) -> Result<(), WriteError> {
        self.0.write(events)
    }

    /// Closes the file. Without it the file is as if the program had been killed.
    pub fn finish(mut self) -> Result<(), WriteError> {
        self.0.finish()
    }
}

//! Undistorted events with fractions of pixels.

use evcal_core::sensor::Sensor;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use evcal_core::event::Event;

use evcal_files::{FileError, NewFile};

/// A format that supports events between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SubPixelFormat {
    /// Lines of time (µs), x, y (four decimals), polarity.
    Text,
    /// EventCalib's records, whose coordinates are f64.
    EventCalib,
}

/// The extension belongs to a format that supports only whole pixels.
#[derive(Debug, thiserror::Error)]
#[error("{}: fractions of pixels can be written to .csv, .txt or .bin (EventCalib)", .0.display())]
pub struct NoFractions(PathBuf);

impl SubPixelFormat {
    /// Returns the format of the extension of `path`.
    ///
    /// # Errors
    /// [`NoFractions`] if the format supports only whole pixels.
    pub fn from_extension(path: &Path) -> Result<Self, NoFractions> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("csv" | "txt") => Ok(Self::Text),
            Some("bin") => Ok(Self::EventCalib),
            _ => Err(NoFractions(path.to_owned())),
        }
    }
}

/// Writes events between pixels.
pub struct SubPixelWriter {
    output: NewFile,
    format: SubPixelFormat,
}

impl SubPixelWriter {
    /// Creates the file at `path` for a `sensor`.
    ///
    /// # Errors
    /// [`FileError`] if it cannot be written.
    pub fn create(path: &Path, format: SubPixelFormat, sensor: Sensor) -> Result<Self, FileError> {
        let mut output = NewFile::create(path)?;
        if format == SubPixelFormat::Text {
            writeln!(output, "# undistorted, sensor {} x {}\nt_us,x,y,p", sensor.width, sensor.height)
                .map_err(|error| FileError::new(path, error))?;
        }
        Ok(Self { output, format })
    }

    /// Writes `event` at (x, y).
    ///
    /// # Errors
    /// Errors of the system.
    pub fn write(&mut self, event: &Event, [x, y]: [f64; 2]) -> io::Result<()> {
        let polarity = event.polarity.index();
        match self.format {
            SubPixelFormat::Text => writeln!(self.output, "{},{x:.4},{y:.4},{polarity}", event.t),
            SubPixelFormat::EventCalib => {
                for value in [event.t as f64 / 1e6, x, y] {
                    self.output.write_all(&value.to_le_bytes())?;
                }
                self.output.write_all(&[polarity as u8])
            }
        }
    }

    /// Completes the file under its name.
    ///
    /// # Errors
    /// [`FileError`] if not all of it could be written.
    pub fn finish(self) -> Result<(), FileError> {
        self.output.finish()
    }
}

//! Undistorted events with the fractions of their pixels.

use evcal_core::sensor::Sensor;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use evcal_core::event::Event;

use evcal_files::{FileError, NewFile};

/// A format whose events may lie between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SubPixelFormat {
    /// Lines of time (µs), x, y (four decimals), polarity.
    Text,
    /// EventCalib's records, whose coordinates are f64.
    EventCalib,
}

/// The extension stands for a format that holds whole pixels only.
#[derive(Debug, thiserror::Error)]
#[error("{}: fractions of pixels can be written to .csv, .txt or .bin (EventCalib)", .0.display())]
pub struct NoFractions(PathBuf);

impl SubPixelFormat {
    /// The format that the extension of `path` stands for.
    ///
    /// # Errors
    /// [`NoFractions`].
    pub fn from_extension(path: &Path) -> Result<Self, NoFractions> {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        match extension.as_deref() {
            Some("csv" | "txt") => Ok(Self::Text),
            Some("bin") => Ok(Self::EventCalib),
            _ => Err(NoFractions(path.to_owned())),
        }
    }
}

/// Writes events that lie between pixels.
pub struct SubPixelWriter {
    output: NewFile,
    format: SubPixelFormat,
}

impl SubPixelWriter {
    /// Begins the file at `path` for a `sensor`.
    ///
    /// # Errors
    /// [`FileError`] when nothing can be written there.
    pub fn create(path: &Path, format: SubPixelFormat, sensor: Sensor) -> Result<Self, FileError> {
        let mut output = NewFile::create(path)?;
        if format == SubPixelFormat::Text {
            writeln!(output, "# undistorted, sensor {} x {}\nt_us,x,y,p", sensor.width, sensor.height)
                .map_err(|error| FileError::new(path, error))?;
        }
        Ok(Self { output, format })
    }

    /// Writes `event` as one at (x, y).
    ///
    /// # Errors
    /// What the system says.
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

    /// Gives the file its name.
    ///
    /// # Errors
    /// [`FileError`] when not all of it could be written.
    pub fn finish(self) -> Result<(), FileError> {
        self.output.finish()
    }
}

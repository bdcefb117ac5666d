//! Undistorted events with fractions of pixels.

use evcal_core::sensor::Sensor;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use evcal_core::event::Event;

use evcal_files::{FileError, NewFile};
#[cfg(feature = "hdf5")]
use event_recordings::hdf5::SubPixelEncoder;

/// A format that supports events between pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum SubPixelFormat {
    /// Lines of time (µs), x, y (four decimals), polarity.
    Text,
    /// EventCalib's records, whose coordinates are f64.
    EventCalib,
    /// HDF5 in the layout of DSEC, with x and y as f64.
    #[cfg(feature = "hdf5")]
    Hdf5,
}

#[cfg(feature = "hdf5")]
const EXTENSIONS: &str = ".csv, .txt, .h5, .hdf5 or .bin (EventCalib)";
#[cfg(not(feature = "hdf5"))]
const EXTENSIONS: &str = ".csv, .txt or .bin (EventCalib)";

/// The extension belongs to a format that supports only whole pixels.
#[derive(Debug, thiserror::Error)]
#[error("{}: fractions of pixels can be written to {EXTENSIONS}", .0.display())]
pub struct NoFractions(PathBuf);

impl evcal_files::remedy::Remedy for NoFractions {}

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
            #[cfg(feature = "hdf5")]
            Some("h5" | "hdf5") => Ok(Self::Hdf5),
            _ => Err(NoFractions(path.to_owned())),
        }
    }
}

/// Writes events between pixels.
pub struct SubPixelWriter {
    output: NewFile,
    encoder: Encoder,
}

/// Encoder of events in one of the formats.
enum Encoder {
    Text,
    EventCalib,
    #[cfg(feature = "hdf5")]
    Hdf5(Box<SubPixelEncoder>, PathBuf),
}

impl SubPixelWriter {
    /// Creates the file at `path` for a `sensor`.
    ///
    /// # Errors
    /// [`FileError`] if it cannot be written.
    pub fn create(path: &Path, format: SubPixelFormat, sensor: Sensor) -> Result<Self, FileError> {
        let mut output = NewFile::create(path)?;
        let failed = |error| FileError::new(path, error);
        let encoder = match format {
            SubPixelFormat::Text => {
                writeln!(output, "# undistorted, sensor {} x {}\nt_us,x,y,p", sensor.width, sensor.height)
                    .map_err(failed)?;
                Encoder::Text
            }
            SubPixelFormat::EventCalib => Encoder::EventCalib,
            #[cfg(feature = "hdf5")]
            SubPixelFormat::Hdf5 => {
                let file = output.handle().map_err(failed)?;
                Encoder::Hdf5(SubPixelEncoder::new(file, sensor).map_err(failed)?.into(), path.to_owned())
            }
        };
        Ok(Self { output, encoder })
    }

    /// Writes `event` at (x, y).
    ///
    /// # Errors
    /// Errors of the system.
    pub fn write(&mut self, event: &Event, [x, y]: [f64; 2]) -> io::Result<()> {
        let polarity = event.polarity.index();
        match &mut self.encoder {
            Encoder::Text => writeln!(self.output, "{},{x:.4},{y:.4},{polarity}", event.t),
            Encoder::EventCalib => {
                for value in [event.t as f64 / 1e6, x, y] {
                    self.output.write_all(&value.to_le_bytes())?;
                }
                self.output.write_all(&[polarity as u8])
            }
            #[cfg(feature = "hdf5")]
            Encoder::Hdf5(encoder, _) => encoder.write(event, [x, y]),
        }
    }

    /// Completes the file under its name.
    ///
    /// # Errors
    /// [`FileError`] if not all of it could be written.
    pub fn finish(self) -> Result<(), FileError> {
        #[cfg(feature = "hdf5")]
        if let Encoder::Hdf5(mut encoder, path) = self.encoder {
            encoder.finish().map_err(|error| FileError::new(&path, io::Error::other(error)))?;
        }
        self.output.finish()
    }
}

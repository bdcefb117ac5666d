//! A second camera that takes ordinary frames, with a global or a rolling shutter, as a folder of images in the format
//! of EuRoC data sets.

use std::fs;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;
use serde::{Deserialize, Serialize};

use super::frame::{ExposureModel, FrameSensor, FrameTimes};
use super::row::TICK;
use super::{SLICE_TICKS, Simulation, SimulationError};
use evcal_files::FileError;
use event_recordings::image_file::{ImageFile, Samples};
use event_recordings::image_folder::{HEADER, IMAGES, Stamps, TABLE};

/// Name of the subfolder in the folder of a simulation.
pub const FOLDER: &str = "second";

/// A frame camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FrameCameraSettings {
    /// Size of its sensor.
    pub sensor: Sensor,
    /// Rate, exposure and noise.
    pub exposure: ExposureModel,
    /// Delay of each row's exposure relative to the row above, in microseconds: 0 for a global shutter.
    pub line_delay: f64,
    /// Meaning of a frame's timestamp: start, middle or end of the exposure of its first row.
    pub stamps: Stamps,
}

impl Default for FrameCameraSettings {
    /// 30 frames per second with a global shutter.
    fn default() -> Self {
        let exposure = ExposureModel { interval: 33_333, readout: 0, moments: 4, ..ExposureModel::default() };
        Self { sensor: Sensor::new(640, 512), exposure, line_delay: 0.0, stamps: Stamps::Middle }
    }
}

impl FrameCameraSettings {
    /// Checks all settings; returns an error with the first setting that is out of range.
    pub fn check(&self) -> Result<(), SimulationError> {
        self.exposure.check()?;
        let Sensor { width, height } = self.sensor;
        let smallest = width.min(height);
        let most = f64::from(self.exposure.interval) / f64::from(height.max(1));
        let checks = [
            ("frames.sensor", f64::from(smallest), smallest > 0 && width.max(height) <= 8192, "1 to 8192 pixels"),
            (
                "frames.line_delay",
                self.line_delay,
                self.line_delay.abs() <= most,
                "at most the time between two frames over the number of rows, in us",
            ),
        ];
        match checks.into_iter().find(|(.., right, _)| !right) {
            Some((name, value, _, range)) => Err(SimulationError::Setting { name, value, range }),
            None => Ok(()),
        }
    }

    /// Returns the moment of the exposure that a frame's timestamp refers to (µs).
    fn stamped(&self, times: FrameTimes) -> f64 {
        let (start, end) = (times.exposure_start as f64, times.exposure_end as f64);
        match self.stamps {
            Stamps::Start => start,
            Stamps::Middle => 0.5 * (start + end),
            Stamps::End => end,
        }
    }
}

/// Writes the frames of `simulation` from `begin` (µs) on into the folder at `path`. `own_time` converts a time in µs
/// to a timestamp of the camera's clock in ns. Returns the names of the files in the folder. `progress` is called with
/// the number of finished slices.
pub(super) fn write(
    simulation: &Simulation,
    settings: &FrameCameraSettings,
    begin: i64,
    own_time: &dyn Fn(f64) -> i64,
    path: &Path,
    mut progress: impl FnMut(usize),
) -> Result<Vec<PathBuf>, FileError> {
    let images = path.join(IMAGES);
    fs::create_dir_all(&images).map_err(|error| FileError::new(&images, error))?;
    let Sensor { width, height } = settings.sensor;
    let stage = &simulation.stage;
    let sensor = FrameSensor::new(stage, settings.exposure, simulation.settings.seed);
    let all_rows = settings.line_delay * f64::from(height);
    let slice = SLICE_TICKS as f64 * TICK;
    let (mut table, mut written) = (format!("{HEADER}\n"), Vec::new());
    for number in 0.. {
        let times = FrameTimes::new(&settings.exposure, number);
        let (first, last) = (times.start as f64 + all_rows.min(0.0), times.end as f64 + all_rows.max(0.0));
        if last > 1e6 * simulation.settings.duration {
            break;
        }
        if first < (begin as f64).max(0.0) {
            continue;
        }
        let frame = sensor.expose_rolling(stage, |t| simulation.pose(t), number, settings.line_delay);
        let stamp = own_time(settings.stamped(times));
        let name = format!("{stamp}.png");
        let pixels = frame.pixels.iter().map(|pixel| (pixel >> 2) as u8).collect();
        let size = (u32::from(width), u32::from(height));
        ImageFile { size, channels: 1, samples: Samples::Eight(pixels) }.write_png(&images.join(&name))?;
        table += &format!("{stamp},{name}\n");
        written.push(Path::new(IMAGES).join(name));
        progress((last / slice) as usize);
    }
    evcal_files::write(&path.join(TABLE), table.as_bytes())?;
    written.push(TABLE.into());
    progress(simulation.slice_count());
    Ok(written)
}

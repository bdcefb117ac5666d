//! Undistortion of recordings.

use evcal_core::sensor::Sensor;
use std::fs;
use std::path::{Path, PathBuf};

use evcal_core::camera::Camera;
use evcal_core::event::Event;
use serde::Serialize;

use super::picture::{PictureError, undistort_frame, write_frame};
use super::sub_pixel::{SubPixelFormat, SubPixelWriter};
use super::{PixelMap, TooLarge, check_size};
use evcal_detection::circles::file::{EventsError, open_events};
use evcal_files::FileError;
use evcal_files::folder::NamesFile;
use evcal_files::remedies;
use evcal_geometry::lens::camera_file::{CameraDescription, CameraFile};
use event_recordings::convert::{
    Change, ConversionProgress, ConversionReport, ConvertError, TimeOrigin, convert_changed,
};
use event_recordings::encode::OutputFormat;
use event_recordings::extras::{Extra, Extras};
use event_recordings::{EventReader, Recording, RecordingError, RecordingOptions};

/// File name of the camera of undistorted frames or pictures, in their folder.
pub const FRAMES_CAMERA: &str = "camera.json";
/// Prefix of the names of undistorted frames.
const FRAME: &str = "frame-";

/// The maps between a camera and the one without distortion.
#[derive(Clone, Debug)]
pub struct Maps {
    /// From old to new pixels.
    pub forth: PixelMap,
    /// From new to old pixels.
    pub back: PixelMap,
}

impl Maps {
    /// Creates the maps between the pixels of `camera` on a `sensor` and the pixels of `new` on one of the same size.
    pub fn new(camera: &Camera<f64>, new: &Camera<f64>, sensor: Sensor) -> Self {
        Self { forth: PixelMap::new(camera, new, sensor), back: PixelMap::new(new, camera, sensor) }
    }
}

/// Opens the recording at `path` of a camera with this `sensor`, which is used if the recording does not contain its own.
///
/// # Errors
/// [`EventsError`] if it contains circles or cannot be read.
pub fn open_recording(path: &Path, options: RecordingOptions, sensor: Sensor) -> Result<Recording, EventsError> {
    let known = match options.sensor {
        Some(sensor) => Some(sensor),
        None => open_events(path, options.clone())?.open()?.information().sensor,
    };
    open_events(path, RecordingOptions { sensor: known.or(Some(sensor)), ..options })
}

/// Returns the file name of the camera of an output: `events.csv` has `events.camera.json`.
pub fn undistorted_camera_path(output: &Path) -> PathBuf {
    output.with_extension("camera.json")
}

/// Writes a camera to a file that can be read as a calibration.
///
/// # Errors
/// [`FileError`] if the file cannot be written.
pub fn write_camera(path: &Path, camera: &Camera<f64>, sensor: Sensor) -> Result<(), FileError> {
    let text = camera_text(camera, sensor).map_err(|error| FileError::new(path, error.into()))?;
    evcal_files::write(path, text.as_bytes())
}

/// Returns `true` if the file at `path` already equals the output of [`write_camera`], for example because the
/// recording was undistorted to another format before.
pub fn contains_camera(path: &Path, camera: &Camera<f64>, sensor: Sensor) -> bool {
    match (fs::read(path), camera_text(camera, sensor)) {
        (Ok(there), Ok(text)) => there == text.as_bytes(),
        _ => false,
    }
}

fn camera_text(camera: &Camera<f64>, sensor: Sensor) -> serde_json::Result<String> {
    serde_json::to_string_pretty(&CameraFile { sensor, camera: CameraDescription::new(camera) })
}

/// Report on the undistortion of a recording.
#[derive(Debug, Default, Serialize)]
pub struct UndistortionReport {
    /// Number of events outside the new image, which are dropped.
    pub events_outside: u64,
    /// Report of the conversion.
    #[serde(flatten)]
    pub conversion: ConversionReport,
}

/// Reasons why a recording was not, or not completely, undistorted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum UndistortError {
    /// The recording cannot be read, or the output not be written.
    #[error("{0}")]
    Convert(#[from] ConvertError),
    /// The recording cannot be read.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// A frame cannot be written.
    #[error("{0}")]
    Picture(#[from] PictureError),
    /// It has another sensor.
    #[error("{file} is of a sensor with {found} pixels, the calibration of one with {calibrated}")]
    Sensor {
        /// The recording.
        file: String,
        /// Its sensor.
        found: Sensor,
        /// The sensor of the calibration.
        calibrated: Sensor,
    },
    /// The sensor of the calibration is too large.
    #[error("{0}")]
    TooLarge(#[from] TooLarge),
    /// A file or the folder of the frames cannot be written.
    #[error("{0}")]
    File(#[from] FileError),
}

remedies! { UndistortError, say;
    Self::Convert(error) => error.remedy(say);
    Self::Recording(error) => error.remedy(say);
}

impl NamesFile for UndistortError {
    fn file_mut(&mut self) -> Option<&mut PathBuf> {
        match self {
            Self::File(error) => error.file_mut(),
            Self::Picture(error) => error.file_mut(),
            _ => None,
        }
    }
}

/// Checks that `recording` is of a `calibrated` sensor. To be called before maps of the sensor are made, because they may be
/// large.
///
/// # Errors
/// [`UndistortError`] if the sensor is another one or too large, or the recording cannot be read.
pub fn check_recording(recording: &Recording, calibrated: Sensor) -> Result<(), UndistortError> {
    compare_sensors(recording, &recording.open()?, calibrated)?;
    Ok(check_size(calibrated, 2)?)
}

fn check_sensor(recording: &Recording, reader: &EventReader, maps: &Maps) -> Result<(), UndistortError> {
    compare_sensors(recording, reader, maps.forth.sensor())
}

fn compare_sensors(recording: &Recording, reader: &EventReader, calibrated: Sensor) -> Result<(), UndistortError> {
    match reader.information().sensor {
        Some(found) if found != calibrated => {
            Err(UndistortError::Sensor { file: recording.path().display().to_string(), found, calibrated })
        }
        _ => Ok(()),
    }
}

/// Writes the undistorted `recording` to a file at `path`, which is overwritten: events at their nearest pixels, frames
/// interpolated. `progress` is called with the progress of the conversion.
///
/// # Errors
/// [`UndistortError`] if it cannot begin or the output cannot be written. If the recording is damaged, everything before the
/// damage is written, and the report contains the error.
pub fn undistort_recording(
    recording: &Recording,
    path: &Path,
    target: OutputFormat,
    maps: &Maps,
    progress: impl FnMut(ConversionProgress),
) -> Result<UndistortionReport, UndistortError> {
    check_sensor(recording, &recording.open()?, maps)?;
    let mut events_outside = 0;
    let mut move_events = |events: &mut Vec<Event>| {
        let before = events.len();
        events.retain_mut(|event| {
            let pixel = maps.forth.nearest_pixel(event.x, event.y);
            if let Some([x, y]) = pixel {
                (event.x, event.y) = (x, y);
            }
            pixel.is_some()
        });
        events_outside += (before - events.len()) as u64;
    };
    let mut move_frame = |extra: &mut Extra| {
        if let Extra::Frame(frame) = extra {
            undistort_frame(frame, &maps.back);
        }
    };
    let change = Change { events: &mut move_events, extra: &mut move_frame };
    let conversion = convert_changed(recording, path, target, TimeOrigin::Kept, change, progress)?;
    Ok(UndistortionReport { events_outside, conversion })
}

/// Does the same as [`undistort_recording`], with the fractions of pixels kept and without frames.
///
/// # Errors
/// As for [`undistort_recording`].
pub fn undistort_sub_pixel(
    recording: &Recording,
    path: &Path,
    format: SubPixelFormat,
    maps: &Maps,
    mut progress: impl FnMut(ConversionProgress),
) -> Result<UndistortionReport, UndistortError> {
    let mut reader = recording.open()?;
    check_sensor(recording, &reader, maps)?;
    let failed = |error| FileError::new(path, error);
    let mut writer = SubPixelWriter::create(path, format, maps.forth.sensor())?;
    let mut report = UndistortionReport::default();
    let mut events = Vec::new();
    loop {
        match reader.next_batch(&mut events) {
            Ok(true) => {}
            Ok(false) => break,
            Err(error) => {
                report.conversion.error = Some(error.into());
                break;
            }
        }
        for event in &events {
            match maps.forth.get_on_sensor(event.x, event.y) {
                Some(place) => {
                    writer.write(event, place).map_err(failed)?;
                    report.conversion.events += 1;
                }
                None => report.events_outside += 1,
            }
        }
        progress(ConversionProgress { events: reader.report().events, done: reader.done() });
    }
    writer.finish()?;
    report.conversion.report = reader.report().clone();
    report.conversion.notes = reader.information().notes.clone();
    report.conversion.lost = Extras::default().left_out(reader.report());
    Ok(report)
}

/// Returns `true` if a file of a folder, by its path in it, may be an output of [`undistort_frames`] or the camera of its frames.
pub fn is_frame_file(file: &Path) -> bool {
    let name = file.to_str().unwrap_or_default();
    name == FRAMES_CAMERA || (name.starts_with(FRAME) && name.ends_with(".png"))
}

/// Frames that were written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WrittenFrames {
    /// Their number.
    pub count: u64,
    /// Parts of the recording that could not be read, as sentences.
    pub lost: Vec<String>,
}

/// Writes the undistorted frames of `recording` as `frame-000000-T.png`, with T the middle of the exposure in µs, to `folder`,
/// which is created. Frames before a damaged one are written.
///
/// # Errors
/// [`UndistortError`] if the recording cannot be read or a frame cannot be written.
pub fn undistort_frames(recording: &Recording, folder: &Path, maps: &Maps) -> Result<WrittenFrames, UndistortError> {
    check_sensor(recording, &recording.open()?, maps)?;
    fs::create_dir_all(folder).map_err(|error| FileError::new(folder, error))?;
    let mut extras = recording.open_extras()?;
    let (mut lost, mut count) = (Vec::new(), 0_u64);
    while let Some(extra) = extras.next_until(i64::MAX, &mut lost) {
        let Extra::Frame(mut frame) = extra else { continue };
        undistort_frame(&mut frame, &maps.back);
        let path = folder.join(format!("{FRAME}{count:06}-{}.png", frame.t));
        write_frame(&frame, &path)?;
        count += 1;
    }
    Ok(WrittenFrames { count, lost })
}

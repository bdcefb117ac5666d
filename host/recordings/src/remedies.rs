//! Remedies for recordings that cannot be read.

use std::path::Path;

use evcal_files::remedy::{Remedy, Words};
use usb_davis::capture::CaptureError;

use super::image_folder::{TABLE, is_image};
use super::likely_sensor::add_sensor;
use super::text::LineError;
use crate::error::{RecordingError, RecordingErrorKind, Usable};

impl Remedy for RecordingError {
    fn remedy(&self, say: &Words) -> Option<String> {
        Some(match &self.kind {
            RecordingErrorKind::Missing(_) => remedy_of_missing(&self.path).to_owned(),
            RecordingErrorKind::Directory { .. } if self.path.join("calibration.json").is_file() => {
                format!("give the recording; this folder contains a calibration, for {}", say.of_calibrations?)
            }
            RecordingErrorKind::Directory { recordings } => return one_of(recordings, say),
            RecordingErrorKind::Unsupported(format) => return format.remedy(say),
            RecordingErrorKind::Damaged { usable: Usable::Around, .. } | RecordingErrorKind::DamagedChunk { .. } => {
                format!("skip the damaged parts with {}", say.skip_damaged?)
            }
            RecordingErrorKind::Damaged { usable: Usable::Nothing, .. } => {
                "copy it again; if the program that wrote an HDF5 file was killed, h5clear -s may repair it".to_owned()
            }
            RecordingErrorKind::BagMetadata(_) => "give the .db3 or .mcap file itself".to_owned(),
            RecordingErrorKind::Line { what: LineError::FieldCount { count, columns }, .. } => {
                match *count > columns.as_slice().len() {
                    true => format!(
                        "if numbers have decimal commas, write 0.5 instead of 0,5; otherwise give all columns with {}",
                        say.columns
                    ),
                    false => format!("give the columns of the file with {}, or complete the line", say.columns),
                }
            }
            RecordingErrorKind::Line { what: LineError::Time { .. }, .. } | RecordingErrorKind::EventTime { .. } => {
                format!("give the unit with {}", say.time_unit)
            }
            RecordingErrorKind::NoEffect { option, .. } => format!("leave out {}", option.word(say)?),
            RecordingErrorKind::Filter(_) => {
                "rewrite it with h5repack -f GZIP=4 IN OUT on a computer with that compression filter".to_owned()
            }
            RecordingErrorKind::Sensor { .. } => format!("give the true size with {}", say.sensor),
            RecordingErrorKind::ChipUnknown => add_sensor(None, say),
            RecordingErrorKind::SeveralImageTopics(_) => format!("choose one with {}", say.with_stream?),
            RecordingErrorKind::Layout(error) => return error.remedy(say),
            RecordingErrorKind::Capture(error) => return remedy_of_capture(error, say),
            _ => return None,
        })
    }
}

/// Returns the remedy for an error of `usb-davis`.
pub(crate) fn remedy_of_capture(error: &CaptureError, say: &Words) -> Option<String> {
    match error {
        CaptureError::SeveralDevices(_) | CaptureError::TooManyDevices(_) => {
            Some(format!("choose one with {} BUS.DEVICE", say.device?))
        }
        _ => None,
    }
}

/// Limit of listed file names.
const MOST_NAMED: usize = 3;

/// Returns the remedy for a folder with these files that may be recordings.
fn one_of(recordings: &[String], say: &Words) -> Option<String> {
    let named: Vec<&str> = recordings.iter().take(MOST_NAMED).map(String::as_str).collect();
    let more = if recordings.len() > MOST_NAMED { " …" } else { "" };
    let is_of_images = |name: &String| name == TABLE || is_image(Path::new(name));
    Some(match named.is_empty() {
        false if recordings.iter().all(is_of_images) => {
            format!("to calibrate from images, add {}", say.frames_only?)
        }
        true => "give the recording in it".to_owned(),
        false => format!("give the recording in it ({}{more})", named.join(", ")),
    })
}

/// Returns the remedy for a path that does not exist.
fn remedy_of_missing(path: &Path) -> &'static str {
    let text = path.to_string_lossy();
    if text == "-" {
        "standard input is not supported, because a recording is read more than once: write it to a file first"
    } else if text.contains("://") {
        "addresses are not supported: download the file first"
    } else if text.contains(['*', '?']) {
        "no file matches this pattern: check the folder"
    } else if text.starts_with('~') {
        "~ is not expanded within quotes: write the full path of your home folder"
    } else if text.starts_with("/dev/tty") {
        "write serial:PORT for a detector on a serial port, and check that it is connected"
    } else {
        "check the path; paths with spaces need quotes"
    }
}

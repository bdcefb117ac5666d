//! Remedies for recordings that cannot be read.

use std::path::Path;

use evcal_files::remedies;
use evcal_files::remedy::Words;
use usb_davis::capture::CaptureError;

use super::image_folder::{TABLE, is_image};
use super::likely_sensor::add_sensor;
use super::text::LineError;
use crate::error::{RecordingError, RecordingErrorKind as Kind, Usable};

remedies! { RecordingError, say;
    Self { kind: Kind::Missing(_), path } => Some(of_missing(path).to_owned());
    Self { kind: Kind::Directory { recordings }, path } => of_folder(path, recordings, say);
    Self { kind: Kind::Unsupported(format), .. } => format.remedy(say);
    Self { kind: Kind::Damaged { usable: Usable::Around, .. } | Kind::DamagedChunk { .. }, .. } =>
        "skip the damaged parts with {}", say.skip_damaged?;
    Self { kind: Kind::Damaged { usable: Usable::Nothing, .. }, .. } =>
        "copy it again; if the program that wrote an HDF5 file was killed, h5clear -s may repair it";
    Self { kind: Kind::BagMetadata(_), .. } => "give the .db3 or .mcap file itself";
    Self { kind: Kind::Line { what: LineError::FieldCount { count, columns }, .. }, .. } =>
        Some(match *count > columns.as_slice().len() {
            true => format!(
                "if numbers have decimal commas, write 0.5 instead of 0,5; otherwise give all columns with {}",
                say.columns
            ),
            false => format!("give the columns of the file with {}, or complete the line", say.columns),
        });
    Self { kind: Kind::Line { what: LineError::Time { .. }, .. } | Kind::EventTime { .. }, .. } =>
        "give the unit with {}", say.time_unit;
    Self { kind: Kind::NoEffect { option, .. }, .. } => "leave out {}", option.word(say)?;
    Self { kind: Kind::Filter(_), .. } =>
        "rewrite it with h5repack -f GZIP=4 IN OUT on a computer with that compression filter";
    Self { kind: Kind::Sensor { .. }, .. } => "give the true size with {}", say.sensor;
    Self { kind: Kind::ChipUnknown, .. } => Some(add_sensor(None, say));
    Self { kind: Kind::SeveralImageTopics(_), .. } => "choose one with {}", say.with_stream?;
    Self { kind: Kind::Layout(error), .. } => error.remedy(say);
    Self { kind: Kind::Capture(error), .. } => remedy_of_capture(error, say);
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
fn of_folder(path: &Path, recordings: &[String], say: &Words) -> Option<String> {
    let is_of_images = |name: &String| name == TABLE || is_image(Path::new(name));
    let named = recordings.iter().take(MOST_NAMED).map(String::as_str).collect::<Vec<_>>().join(", ");
    let more = if recordings.len() > MOST_NAMED { " …" } else { "" };
    Some(match recordings {
        _ if path.join("calibration.json").is_file() => {
            format!("give the recording; this folder contains a calibration, for {}", say.of_calibrations?)
        }
        [] => "give the recording in it".to_owned(),
        _ if recordings.iter().all(is_of_images) => format!("to calibrate from images, add {}", say.frames_only?),
        _ => format!("give the recording in it ({named}{more})"),
    })
}

/// Returns the remedy for a path that does not exist.
fn of_missing(path: &Path) -> &'static str {
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

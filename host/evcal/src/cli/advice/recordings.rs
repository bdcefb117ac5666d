//! Advice about recordings, and about files and folders that cannot be written.

use std::error::Error;
use std::path::Path;

use evcal_calibrate::task::error::CalibrateError;
use evcal_core::sensor::Sensor;
use evcal_detection::detection::search::SearchError;
use evcal_files::folder::FolderError;
use evcal_files::output::OutputError;
use event_recordings::convert::ConvertError;
use event_recordings::encode::WriteError;
use event_recordings::given_sensor::{Exchanged, OtherSensor};
use event_recordings::image_folder::{TABLE, is_image};
use event_recordings::text::LineError;
use event_recordings::{FormatOption, LayoutError, RecordingError, RecordingErrorKind, UnsupportedFormat, Usable};
use usb_davis::capture::CaptureError;

/// Returns advice about an error of event-recordings, evcal-files or usb-davis, or about an unknown sensor size.
pub fn advice(error: &(dyn Error + 'static)) -> Option<String> {
    if let Some(RecordingError { path, kind }) = error.downcast_ref() {
        return about_recording(path, kind);
    }
    if let Some(error) = error.downcast_ref() {
        return Some(about_sensor(error));
    }
    if let Some(error) = error.downcast_ref() {
        return about_conversion(error);
    }
    if let Some(SearchError::SensorUnknown { likely, .. }) = error.downcast_ref() {
        return Some(add_sensor(*likely));
    }
    if let Some(CalibrateError::SensorUnknown { likely, .. }) = error.downcast_ref() {
        return Some(add_sensor(*likely));
    }
    if let Some(WriteError::Jump { .. } | WriteError::Pauses { .. }) = error.downcast_ref() {
        let next =
            "if the unit of its timestamps is wrong, give it with --time-unit; otherwise cut the recording there";
        return Some(next.to_owned());
    }
    about_output(error).or_else(|| about_capture(error.downcast_ref()?)).map(str::to_owned)
}

/// Returns the advice to add `--sensor`, with the likely size.
pub fn add_sensor(likely: Option<Sensor>) -> String {
    likely.map_or_else(
        || "add --sensor WIDTHxHEIGHT".to_owned(),
        |sensor| format!("add --sensor {}x{}", sensor.width, sensor.height),
    )
}

fn about_recording(path: &Path, kind: &RecordingErrorKind) -> Option<String> {
    let next = match kind {
        RecordingErrorKind::Missing(_) => advice_on_missing_path(path),
        RecordingErrorKind::Directory { .. } if path.join("calibration.json").is_file() => {
            "give the recording; this folder contains a calibration, for evcal export, evaluate, compare and undistort -c"
        }
        RecordingErrorKind::Directory { recordings } => return Some(one_of(recordings)),
        RecordingErrorKind::Unsupported(format) => about_format(*format)?,
        RecordingErrorKind::Damaged { usable: Usable::Around, .. } | RecordingErrorKind::DamagedChunk { .. } => {
            "skip the damaged parts with --skip-damaged"
        }
        RecordingErrorKind::Damaged { usable: Usable::Nothing, .. } => {
            "copy it again; if the program that wrote an HDF5 file was killed, h5clear -s may repair it"
        }
        RecordingErrorKind::BagMetadata(_) => "give the .db3 or .mcap file itself",
        RecordingErrorKind::Line { what: LineError::FieldCount { count, columns }, .. } => {
            match *count > columns.as_slice().len() {
                true => {
                    "if numbers have decimal commas, write 0.5 instead of 0,5; otherwise give all columns with --columns"
                }
                false => "give the columns of the file with --columns, or complete the line",
            }
        }
        RecordingErrorKind::Line { what: LineError::Time { .. }, .. } | RecordingErrorKind::EventTime { .. } => {
            "give the unit with --time-unit"
        }
        RecordingErrorKind::NoEffect { option, .. } => return Some(format!("leave out {}", name(*option))),
        RecordingErrorKind::Filter(_) => {
            "rewrite it with h5repack -f GZIP=4 IN OUT on a computer with that compression filter"
        }
        RecordingErrorKind::Sensor { .. } => "give the true size with --sensor",
        RecordingErrorKind::ChipUnknown => "add --sensor WIDTHxHEIGHT",
        RecordingErrorKind::SeveralImageTopics(_) => "choose one with --with-stream",
        RecordingErrorKind::Layout(error) => about_layout(error)?,
        RecordingErrorKind::Capture(error) => about_capture(error)?,
        _ => return None,
    };
    Some(next.to_owned())
}

/// Limit of listed file names.
const MOST_NAMED: usize = 3;

fn one_of(recordings: &[String]) -> String {
    let named: Vec<&str> = recordings.iter().take(MOST_NAMED).map(String::as_str).collect();
    let more = if recordings.len() > MOST_NAMED { " …" } else { "" };
    let is_of_images = |name: &String| name == TABLE || is_image(Path::new(name));
    match named.is_empty() {
        false if recordings.iter().all(is_of_images) => "to calibrate from images, add --frames-only".to_owned(),
        true => "give the recording in it".to_owned(),
        false => format!("give the recording in it ({}{more})", named.join(", ")),
    }
}

/// Returns advice about a path that does not exist.
fn advice_on_missing_path(path: &Path) -> &'static str {
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

fn about_format(format: UnsupportedFormat) -> Option<&'static str> {
    Some(match format {
        UnsupportedFormat::Aedat1 => "open it in jAER and save it as AEDAT 2",
        UnsupportedFormat::Aedat3Compressed => "convert it to AEDAT4 with DV",
        UnsupportedFormat::Rosbag1 => "convert it to version 2.0 with rosbag fix",
        UnsupportedFormat::Hdf5 => {
            "build evcal with --features hdf5, or save its arrays t, x, y and p with h5py and numpy.savez"
        }
        UnsupportedFormat::VirtualHdf5 => {
            "one of its datasets is virtual (a view of other arrays): copy the numbers into ordinary datasets with h5py or \
             h5repack -l CONTI IN OUT"
        }
        UnsupportedFormat::Lz4 => "unpack it with unlz4 first",
        UnsupportedFormat::ModifiedPcap => "rewrite it with editcap -F pcap IN OUT",
        UnsupportedFormat::PropheseeEncoding => "convert it with metavision_file_to_csv",
        UnsupportedFormat::EventStreamVersion => "convert it with the program that wrote it",
        UnsupportedFormat::EventStreamKind => {
            "give a file with events of a DVS or an ATIS, not colours or generic data"
        }
        UnsupportedFormat::Gzip => "unpack it with gunzip first",
        UnsupportedFormat::Xz => "unpack it with unxz first",
        UnsupportedFormat::Zstandard => "unpack it with unzstd first",
        UnsupportedFormat::Bzip2 => "unpack it with bunzip2 first",
        UnsupportedFormat::Tar => "unpack it with tar -xf first",
        UnsupportedFormat::SevenZip | UnsupportedFormat::Rar | UnsupportedFormat::Zip => "unpack it first",
        UnsupportedFormat::ZipCompression => "pack it again with numpy.savez_compressed",
        UnsupportedFormat::Spreadsheet => "save its events as CSV",
        UnsupportedFormat::Calibration => {
            "it is for evcal export, evaluate, compare and undistort -c; give the recording here"
        }
        UnsupportedFormat::CalibrationReport => "open it in a browser; give the recording here",
        UnsupportedFormat::Json => "for a calibration use evcal export, evaluate, compare or undistort -c",
        UnsupportedFormat::Yaml => {
            "a camera.yaml is for OpenCV, evcal reads the calibration.json next to it; give the recording here"
        }
        UnsupportedFormat::Pdf => "give the recording, not the printed board",
        UnsupportedFormat::Png => "evcal undistort removes the distortion of pictures",
        UnsupportedFormat::Parquet | UnsupportedFormat::Arrow | UnsupportedFormat::Pickle => {
            "save its columns t, x, y and p with numpy.savez, or as CSV"
        }
        UnsupportedFormat::Matlab => "save it in MATLAB with the option -v7.3, or its events as text",
        UnsupportedFormat::Video => "give the events of the camera, not a video of them",
        UnsupportedFormat::Html => "this is a web page instead of the recording: download the recording again",
        UnsupportedFormat::GitLfsPointer => "the file is only a pointer: run git lfs pull to fetch the recording",
        UnsupportedFormat::Utf16 => "save it as UTF-8, or convert it with iconv -f UTF-16 -t UTF-8",
        UnsupportedFormat::Latin1 => "save it as UTF-8, or convert it with iconv -f LATIN1 -t UTF-8",
        _ => return None,
    })
}

fn name(option: FormatOption) -> &'static str {
    match option {
        FormatOption::Stream => "--stream",
        FormatOption::Columns => "--columns",
        FormatOption::TimeUnit => "--time-unit",
        FormatOption::Device => "--device",
        FormatOption::Growth => "--follow",
    }
}

fn about_layout(error: &LayoutError) -> Option<&'static str> {
    match error {
        LayoutError::Names(_)
        | LayoutError::FirstLine(_)
        | LayoutError::FieldCount(_)
        | LayoutError::Unclear
        | LayoutError::Ambiguous => Some("give its columns with --columns, for example t,x,y,p"),
        LayoutError::Named => Some("leave out --columns"),
        _ => None,
    }
}

fn about_capture(error: &CaptureError) -> Option<&'static str> {
    match error {
        CaptureError::SeveralDevices(_) | CaptureError::TooManyDevices(_) => {
            Some("choose one with --device BUS.DEVICE")
        }
        _ => None,
    }
}

fn about_sensor(error: &OtherSensor) -> String {
    let swapped = |sensor: &Sensor| format!("write --sensor {}x{}", sensor.height, sensor.width);
    let next = match error {
        OtherSensor::TooSmall { own: Some(_), .. } | OtherSensor::TooLarge { .. } => "leave out --sensor",
        OtherSensor::Exchanged { exchanged: Exchanged::RequestedSize, sensor, .. } => return swapped(sensor),
        OtherSensor::Exchanged { exchanged: Exchanged::FileSize, sensor, .. } => {
            return format!("the size in the file has them swapped; {}", swapped(sensor));
        }
        OtherSensor::Exchanged { exchanged: Exchanged::Columns, .. } => {
            "give the order of the columns with --columns, such as t,y,x,p"
        }
        OtherSensor::Exchanged { exchanged: Exchanged::File, .. } => {
            "the program that wrote the file swapped them; write the file again"
        }
        OtherSensor::StatedTooSmall { likely: Some(likely), .. } => {
            return format!("give the true size: --sensor {}x{}", likely.width, likely.height);
        }
        OtherSensor::CountedFromOne { .. } => "subtract 1 from x and y",
        OtherSensor::NoPixels { .. } => "give the columns of x and y with --columns",
        _ => "give the true size with --sensor",
    };
    next.to_owned()
}

fn about_conversion(error: &ConvertError) -> Option<String> {
    match error {
        ConvertError::Extension(_) => Some("or give the format with --to".to_owned()),
        ConvertError::SensorUnknown { likely, .. } => Some(add_sensor(*likely)),
        ConvertError::CopiedTimes(_) => Some("leave out --unix-time".to_owned()),
        _ => None,
    }
}

fn about_output(error: &(dyn Error + 'static)) -> Option<&'static str> {
    match (error.downcast_ref(), error.downcast_ref()) {
        (Some(OutputError::Exists(_)), _) => Some("choose another name, or replace it with --force"),
        (_, Some(FolderError::Exists(_))) => Some("choose another folder, or replace the results with --force"),
        (_, Some(FolderError::Busy(_))) => Some("wait until it ends, or choose another folder with -o"),
        (_, Some(FolderError::Unusable(_) | FolderError::Blocked(_))) => Some("choose another folder with -o"),
        _ => None,
    }
}

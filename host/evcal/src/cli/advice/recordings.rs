//! What to do about recordings, and about files and folders that cannot be written.

use std::error::Error;
use std::path::Path;

use evcal_calibrate::calibrate::error::CalibrateError;
use evcal_calibrate::detection::search::SearchError;
use evcal_core::sensor::Sensor;
use evcal_files::folder::FolderError;
use evcal_files::output::OutputError;
use event_recordings::convert::ConvertError;
use event_recordings::encode::WriteError;
use event_recordings::given_sensor::{Exchanged, OtherSensor};
use event_recordings::text::LineError;
use event_recordings::{FormatOption, LayoutError, RecordingError, RecordingErrorKind, UnsupportedFormat, Usable};
use usb_davis::capture::CaptureError;

/// What to do about `error`, where it is one of event-recordings, evcal-files or usb-davis, or about a sensor that is not known.
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
    if let Some(WriteError::Jump { .. }) = error.downcast_ref() {
        let next = "is the unit of its times another one? name it with --time-unit; if not, cut the recording there";
        return Some(next.to_owned());
    }
    about_output(error).or_else(|| about_capture(error.downcast_ref()?)).map(str::to_owned)
}

/// How the size of a sensor is given, if it is likely this one.
pub fn add_sensor(likely: Option<Sensor>) -> String {
    likely.map_or_else(
        || "add --sensor WIDTHxHEIGHT".to_owned(),
        |sensor| format!("add --sensor {}x{}", sensor.width, sensor.height),
    )
}

fn about_recording(path: &Path, kind: &RecordingErrorKind) -> Option<String> {
    let next = match kind {
        RecordingErrorKind::Missing(_) => where_else(path),
        RecordingErrorKind::Directory { .. } if path.join("calibration.json").is_file() => {
            "name the recording; the folder holds a calibration, which evcal export, evaluate, compare and undistort -c read"
        }
        RecordingErrorKind::Directory { recordings } => return Some(one_of(recordings)),
        RecordingErrorKind::Unsupported(format) => about_format(*format)?,
        RecordingErrorKind::Damaged { usable: Usable::Around, .. } | RecordingErrorKind::DamagedChunk { .. } => {
            "leave out what is damaged with --skip-damaged"
        }
        RecordingErrorKind::Damaged { usable: Usable::Nothing, .. } => {
            "copy it again; where the program that wrote an HDF5 file was ended too early, h5clear -s may mend it"
        }
        RecordingErrorKind::BagMetadata(_) => "name the .db3 or .mcap file itself",
        RecordingErrorKind::Line { what: LineError::FieldCount { count, columns }, .. } => {
            match *count > columns.as_slice().len() {
                true => {
                    "do numbers have a comma in place of the point? write 0.5, not 0,5; or name all columns with --columns"
                }
                false => "name those that there are with --columns, or complete the line",
            }
        }
        RecordingErrorKind::Line { what: LineError::Time { .. }, .. } | RecordingErrorKind::EventTime { .. } => {
            "name the unit with --time-unit"
        }
        RecordingErrorKind::NoEffect { option, .. } => return Some(format!("leave out {}", name(*option))),
        RecordingErrorKind::Filter(_) => {
            "write it anew with h5repack -f GZIP=4 IN OUT, where that compression is installed"
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

/// Names of files that are told at most.
const MOST_NAMED: usize = 3;

fn one_of(recordings: &[String]) -> String {
    let named: Vec<&str> = recordings.iter().take(MOST_NAMED).map(String::as_str).collect();
    let more = if recordings.len() > MOST_NAMED { " …" } else { "" };
    match named.is_empty() {
        true => "name the recording in it".to_owned(),
        false => format!("name the recording in it ({}{more})", named.join(", ")),
    }
}

/// What to do about a path that leads nowhere.
fn where_else(path: &Path) -> &'static str {
    let text = path.to_string_lossy();
    if text == "-" {
        "standard input is not read, for a recording is read more than once: write it to a file first"
    } else if text.contains("://") {
        "an address is no file: download it first"
    } else if text.contains(['*', '?']) {
        "no name is of this form: is it the right folder?"
    } else if text.starts_with('~') {
        "within quotes ~ is a name like others: write the whole path of your home folder"
    } else if text.starts_with("/dev/tty") {
        "a detector on a serial port is named serial:PORT; is it plugged in?"
    } else {
        "is the path right? one with spaces needs quotes"
    }
}

fn about_format(format: UnsupportedFormat) -> Option<&'static str> {
    Some(match format {
        UnsupportedFormat::Aedat1 => "open it in jAER and save it as AEDAT 2",
        UnsupportedFormat::Aedat3Compressed => "convert it to AEDAT4 with DV",
        UnsupportedFormat::Rosbag1 => "bring it to version 2 with rosbag fix",
        UnsupportedFormat::Hdf5 => {
            "build evcal with --features hdf5, or save its arrays t, x, y and p with h5py and numpy.savez"
        }
        UnsupportedFormat::VirtualHdf5 => {
            "an array in it is a view of other arrays (a virtual dataset): copy the numbers into arrays of their own, with h5py or \
             h5repack -l CONTI IN OUT"
        }
        UnsupportedFormat::PropheseeEncoding => "convert it with metavision_file_to_csv",
        UnsupportedFormat::EventStreamVersion => "convert it with the program that wrote it",
        UnsupportedFormat::EventStreamKind => "name the events of a DVS or an ATIS, not colours or generic bytes",
        UnsupportedFormat::Gzip => "unpack it with gunzip first",
        UnsupportedFormat::Xz => "unpack it with unxz first",
        UnsupportedFormat::Zstandard => "unpack it with unzstd first",
        UnsupportedFormat::Bzip2 => "unpack it with bunzip2 first",
        UnsupportedFormat::Tar => "unpack it with tar -xf first",
        UnsupportedFormat::SevenZip | UnsupportedFormat::Rar | UnsupportedFormat::Zip => "unpack it first",
        UnsupportedFormat::ZipCompression => "pack it again with numpy.savez_compressed",
        UnsupportedFormat::Spreadsheet => "save its events as CSV",
        UnsupportedFormat::Calibration => {
            "evcal export, evaluate, compare and undistort -c read it; name the recording here"
        }
        UnsupportedFormat::CalibrationReport => "browsers show it; name the recording here",
        UnsupportedFormat::Json => "a calibration is read by evcal export, evaluate, compare and undistort -c",
        UnsupportedFormat::Yaml => {
            "a camera.yaml is a camera for OpenCV, and calibration.json beside it is read by evcal; name the recording here"
        }
        UnsupportedFormat::Pdf => "name the recording of the board, not the board",
        UnsupportedFormat::Png => "evcal undistort takes pictures, and takes their distortion out",
        UnsupportedFormat::Parquet | UnsupportedFormat::Pickle => {
            "save its columns t, x, y and p with numpy.savez, or as CSV"
        }
        UnsupportedFormat::Matlab => "save it in MATLAB with the option -v7.3, or its events as text",
        UnsupportedFormat::Video => "name the events that the camera recorded, not a video of them",
        UnsupportedFormat::Html => "a web page was saved in place of the recording: download it again",
        UnsupportedFormat::GitLfsPointer => "the recording itself was not fetched: run git lfs pull",
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
    }
}

fn about_layout(error: &LayoutError) -> Option<&'static str> {
    match error {
        LayoutError::Names(_)
        | LayoutError::FirstLine(_)
        | LayoutError::FieldCount(_)
        | LayoutError::Unclear
        | LayoutError::Ambiguous => Some("say what its columns are with --columns, for example t,x,y,p"),
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
    let turned = |sensor: &Sensor| format!("write --sensor {}x{}", sensor.height, sensor.width);
    let next = match error {
        OtherSensor::TooSmall { own: Some(_), .. } | OtherSensor::TooLarge { .. } => "leave out --sensor",
        OtherSensor::Exchanged { exchanged: Exchanged::RequestedSize, sensor, .. } => return turned(sensor),
        OtherSensor::Exchanged { exchanged: Exchanged::FileSize, sensor, .. } => {
            return format!("the file exchanged them in its size; {}", turned(sensor));
        }
        OtherSensor::Exchanged { exchanged: Exchanged::Columns, .. } => {
            "say where x and y are with --columns, such as t,y,x,p"
        }
        OtherSensor::Exchanged { exchanged: Exchanged::File, .. } => {
            "the program that wrote the file exchanged them; write it anew"
        }
        OtherSensor::CountedFromOne { .. } => "subtract 1 from x and y",
        OtherSensor::NoPixels { .. } => "say which columns x and y are with --columns",
        _ => "give the true size with --sensor",
    };
    next.to_owned()
}

fn about_conversion(error: &ConvertError) -> Option<String> {
    match error {
        ConvertError::Extension(_) => Some("or name the format with --to".to_owned()),
        ConvertError::SensorUnknown { likely, .. } => Some(add_sensor(*likely)),
        ConvertError::CopiedTimes(_) => Some("leave out --unix-time".to_owned()),
        _ => None,
    }
}

fn about_output(error: &(dyn Error + 'static)) -> Option<&'static str> {
    match (error.downcast_ref(), error.downcast_ref()) {
        (Some(OutputError::Exists(_)), _) => Some("choose another name, or replace it with --force"),
        (_, Some(FolderError::Exists(_))) => Some("choose another folder, or replace the results with --force"),
        (_, Some(FolderError::Busy(_))) => Some("wait for its end, or choose another folder with -o"),
        (_, Some(FolderError::Unusable(_) | FolderError::Blocked(_))) => Some("choose another folder with -o"),
        _ => None,
    }
}

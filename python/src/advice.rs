//! Advice about errors, in terms of the Python package. The libraries' errors contain only facts, because their advice
//! would depend on the program.

use std::error::Error;
use std::fmt::Display;

use evcal_calibrate::advice::Advice;
use evcal_calibrate::calibrate::repeat::RepeatError;
use evcal_calibrate::inertial::error::InertialError;
use evcal_calibrate::second_camera::error::SecondCameraError;
use evcal_calibrate::task::board_choice::BoardChoiceError;
use evcal_calibrate::task::error::CalibrateError;
use evcal_core::sensor::Sensor;
use evcal_detection::detection::recognition::other_board::OtherReading;
use evcal_detection::detection::recognition::radius::OtherRadius;
use evcal_detection::detection::search::SearchError;
use evcal_detection::detection::{NoPattern, NoPatternCause};
use evcal_files::folder::FolderError;
use evcal_files::output::OutputError;
use event_recordings::convert::ConvertError;
use event_recordings::given_sensor::{Exchanged, OtherSensor};
use event_recordings::text::LineError;
use event_recordings::{FormatOption, LayoutError, RecordingError, RecordingErrorKind, UnsupportedFormat};

/// Returns the advice for `error`, or for the first of its causes for which there is advice.
pub fn advice(error: &(dyn Error + 'static)) -> Option<String> {
    let mut cause = Some(error);
    while let Some(error) = cause {
        if let Some(next) = of_one(error) {
            return Some(next);
        }
        cause = error.source();
    }
    None
}

/// Returns the message of an error with the advice.
fn advised(error: &(impl Error + 'static)) -> String {
    advice(error).map_or_else(|| error.to_string(), |next| format!("{error}; {next}"))
}

fn of_one(error: &(dyn Error + 'static)) -> Option<String> {
    if let Some(RecordingError { kind, .. }) = error.downcast_ref() {
        return about_recording(kind).map(str::to_owned);
    }
    if let Some(error) = error.downcast_ref() {
        return Some(about_sensor(error));
    }
    if let Some(SearchError::SensorUnknown { likely, .. }) = error.downcast_ref() {
        return Some(give_sensor(*likely));
    }
    if let Some(CalibrateError::SensorUnknown { likely, .. }) = error.downcast_ref() {
        return Some(give_sensor(*likely));
    }
    if let Some(FolderError::Exists(_)) = error.downcast_ref() {
        return Some("name another folder, or give force=True".to_owned());
    }
    if let Some(OutputError::Exists(_)) = error.downcast_ref() {
        return Some("choose another name, or give force=True".to_owned());
    }
    if let Some(error) = error.downcast_ref() {
        return about_conversion(error);
    }
    about_calibration(error).or_else(|| about_other_devices(error).map(str::to_owned))
}

fn about_conversion(error: &ConvertError) -> Option<String> {
    match error {
        ConvertError::Extension(_) => Some("or name the format with to=".to_owned()),
        ConvertError::SensorUnknown { likely, .. } => Some(give_sensor(*likely)),
        ConvertError::CopiedTimes(_) => Some("leave out unix_time".to_owned()),
        _ => None,
    }
}

/// Returns the advice for errors about the IMU, other cameras and parts of a recording.
fn about_other_devices(error: &(dyn Error + 'static)) -> Option<&'static str> {
    if let Some(RepeatError::TooFew { .. } | RepeatError::TooShort { .. }) = error.downcast_ref() {
        return Some("the length of the parts is seconds=");
    }
    if let Some(error) = error.downcast_ref() {
        return match error {
            InertialError::NoTrajectory => Some("leave out frames=\"only\""),
            InertialError::NoSamples { .. }
            | InertialError::OneTime { .. }
            | InertialError::Lacks { .. }
            | InertialError::AccelerationUnit { of_file: false, .. }
            | InertialError::AngularUnit { of_file: false, .. } => Some("give a file of samples: imu=\"samples.csv\""),
            _ => None,
        };
    }
    match error.downcast_ref()? {
        SecondCameraError::NoTrajectory => Some("leave out frames=\"only\", and give the recording of events first"),
        SecondCameraError::CirclesOfSecond => Some("give its events with with_="),
        SecondCameraError::SeveralRecordings => Some("give only one recording of the first camera if with_= is given"),
        SecondCameraError::SameRecording { .. } => Some("give the recording of another camera with with_="),
        SecondCameraError::RollingShutter { .. } => Some("give rolling_shutter=True"),
        _ => None,
    }
}

/// Returns the advice for an error of `evcal-calibrate`.
fn about_calibration(error: &(dyn Error + 'static)) -> Option<String> {
    if let Some(error) = error.downcast_ref() {
        return match error {
            CalibrateError::TimeUnit { unit, .. } => {
                unit.unit.map(|unit| format!("give time_unit={:?}", unit.symbol()))
            }
            CalibrateError::LargerBoard(larger) => Some(give_board(larger.board)),
            CalibrateError::NoPictures { .. } => Some("give frames=\"cross-check\"".to_owned()),
            _ => None,
        };
    }
    if let Some(error) = error.downcast_ref::<NoPattern>() {
        return match error.main_cause() {
            NoPatternCause::OtherBoard(OtherReading::Board { board, .. }) => Some(give_board(board)),
            NoPatternCause::OtherBoard(OtherReading::Kind(found)) => {
                Some(format!("for example board={:?}", found.example()))
            }
            NoPatternCause::OnePolarity(_) => Some("name the column of the polarity with columns=".to_owned()),
            _ => None,
        };
    }
    if let Some(OtherRadius { meant, .. }) = error.downcast_ref() {
        return meant.first().map(|(_, board)| give_board(*board));
    }
    match error.downcast_ref()? {
        BoardChoiceError::NoEvents | BoardChoiceError::NotRecognised { .. } => {
            Some("for example board=\"acircles:9x4:55mm:r17.5mm\"".to_owned())
        }
        BoardChoiceError::SizeUnknown { found } => Some(format!("for example board={:?}", found.example())),
        _ => None,
    }
}

fn give_board(board: impl Display) -> String {
    format!("give board=\"{board}\"")
}

/// Returns the advice of a finding in terms of the Python package.
pub fn worded(advice: &Advice) -> String {
    match advice {
        Advice::TakeModel(kind) => format!("calibrate again with model=\"{kind}\""),
        Advice::TakeWholeBoard(board) => format!(
            "calibrate again with board=\"{board}\", which uses more of the recording; the lens is correct within the reported uncertainty"
        ),
        Advice::CountRows => {
            "count them on the board: board= names more than it has, or a part of it was never in view".to_owned()
        }
        Advice::NameSensor(likely) => give_sensor(*likely),
        Advice::NameTimeUnit(Some(unit)) => format!("give time_unit={:?}", unit.symbol()),
        Advice::CountFromZero { sensor, name_sensor: true } => {
            let without = Advice::CountFromZero { sensor: *sensor, name_sensor: false };
            format!("{without}, and {}", give_sensor(Some(*sensor)))
        }
        Advice::ExchangeAxes => "x and y are swapped: correct columns=, or swap the two numbers of sensor=".to_owned(),
        Advice::NameColumns(outside) => {
            format!("{outside}: are the columns in another order? State the order, such as columns=\"x,y,t,p\"")
        }
        Advice::CorrectSensor(outside) => format!("{outside}: give its true size as sensor=(width, height)"),
        Advice::BothPolarities(_) => format!("{advice} with columns="),
        Advice::NameBoard => {
            "no board was recognised: describe it, for example board=\"acircles:9x4:55mm:r17.5mm\" or board=\"checkerboard:6x9:25mm\"".to_owned()
        }
        Advice::Measure(found) => {
            let measure = found.to_measure();
            format!("the board is {found}: {measure}, for example board={:?}", found.example())
        }
        Advice::FindBoard(error) => advised(error),
        Advice::CorrectRadius(error) => advised(error),
        Advice::Calibrate { board, .. } => format!("call calibrate with board=\"{board}\""),
        others => others.to_string(),
    }
}

fn argument(Sensor { width, height }: Sensor) -> String {
    format!("sensor=({width}, {height})")
}

fn give_sensor(likely: Option<Sensor>) -> String {
    format!("give {}", likely.map_or_else(|| "sensor=(width, height)".to_owned(), argument))
}

fn about_recording(kind: &RecordingErrorKind) -> Option<&'static str> {
    Some(match kind {
        RecordingErrorKind::Missing(_) => "is the path right?",
        RecordingErrorKind::Directory { .. } => "name the recording in it",
        RecordingErrorKind::Unsupported(format) => about_format(*format)?,
        RecordingErrorKind::Line { what: LineError::FieldCount { .. }, .. } => {
            "complete the line, or name all columns with columns="
        }
        RecordingErrorKind::Line { what: LineError::Time { .. }, .. } | RecordingErrorKind::EventTime { .. } => {
            "name the unit with time_unit="
        }
        RecordingErrorKind::NoEffect { option: FormatOption::Stream, .. } => "leave out stream",
        RecordingErrorKind::NoEffect { option: FormatOption::Columns, .. } => "leave out columns",
        RecordingErrorKind::NoEffect { option: FormatOption::TimeUnit, .. } => "leave out time_unit",
        RecordingErrorKind::Sensor { .. } | RecordingErrorKind::ChipUnknown => "give sensor=(width, height)",
        RecordingErrorKind::Layout(LayoutError::Named) => "leave out columns",
        RecordingErrorKind::Layout(
            LayoutError::Names(_)
            | LayoutError::FirstLine(_)
            | LayoutError::FieldCount(_)
            | LayoutError::Unclear
            | LayoutError::Ambiguous,
        ) => "name its columns, for example columns=\"t,x,y,p\"",
        _ => return None,
    })
}

fn about_format(format: UnsupportedFormat) -> Option<&'static str> {
    Some(match format {
        UnsupportedFormat::Gzip
        | UnsupportedFormat::Xz
        | UnsupportedFormat::Zstandard
        | UnsupportedFormat::Bzip2
        | UnsupportedFormat::Lz4
        | UnsupportedFormat::Tar
        | UnsupportedFormat::SevenZip
        | UnsupportedFormat::Rar
        | UnsupportedFormat::Zip => "unpack it first",
        UnsupportedFormat::Calibration => "evcal.Camera.load reads it",
        UnsupportedFormat::Parquet
        | UnsupportedFormat::Arrow
        | UnsupportedFormat::Pickle
        | UnsupportedFormat::Spreadsheet
        | UnsupportedFormat::VirtualHdf5 => "load it in Python and give its events as an array",
        UnsupportedFormat::Html => "a web page was saved instead of the recording: download it again",
        UnsupportedFormat::GitLfsPointer => "the recording itself was not fetched: run git lfs pull",
        UnsupportedFormat::Utf16 | UnsupportedFormat::Latin1 => "save it as UTF-8",
        _ => return None,
    })
}

fn about_sensor(error: &OtherSensor) -> String {
    let turned = |sensor: &Sensor| format!("give {}", argument(Sensor::new(sensor.height, sensor.width)));
    let next = match error {
        OtherSensor::TooSmall { own: Some(_), .. } | OtherSensor::TooLarge { .. } => "leave out sensor",
        OtherSensor::Exchanged { exchanged: Exchanged::RequestedSize | Exchanged::FileSize, sensor, .. } => {
            return turned(sensor);
        }
        OtherSensor::Exchanged { .. } => "exchange x and y",
        OtherSensor::CountedFromOne { .. } => "subtract 1 from x and y",
        OtherSensor::NoPixels { .. } => "name the columns of x and y with columns=",
        _ => "give the true size as sensor=(width, height)",
    };
    next.to_owned()
}

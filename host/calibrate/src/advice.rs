//! Advice as data, so that each program can put it into words with its own options.
//!
//! `Display` is a wording that fits every program. A program that has options, or functions with arguments, provides
//! its own [`Wording`].

use std::fmt;
use std::path::PathBuf;

use evcal_core::camera::ModelKind;
use evcal_core::event::Polarity;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::CircleBoard;
use event_recordings::{RecordingOptions, TimeUnit};

use evcal_detection::detection::NoPattern;
use evcal_detection::detection::no_board::only_one_polarity;
use evcal_detection::detection::recognition::radius::OtherRadius;
use evcal_detection::detection::recognition::recognised::Recognised;

/// Function with which a program words advice.
pub type Wording = fn(&Advice) -> String;

/// Returns the wording of this library: the `Display` of [`Advice`].
pub fn plain(advice: &Advice) -> String {
    advice.to_string()
}

/// Advice on a finding, or on a recording.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Advice {
    /// Advice for which no program has an option.
    Plain(String),
    /// Calibrate again with this camera model.
    TakeModel(ModelKind),
    /// Calibrate again with this board, of which the nominal board is a part.
    TakeWholeBoard(CircleBoard),
    /// Count rows and columns of the board.
    CountRows,
    /// Check that the lens is clean and the board is not wavy; bend and print of the board are estimated already,
    /// unless they are fixed.
    CheckLensAndBoard,
    /// Cover more of the lens, or estimate these parameters anyway.
    Free(Vec<&'static str>),
    /// State the size of the sensor, probably this one.
    NameSensor(Option<Sensor>),
    /// State the unit of the timestamps; `None` if the format has only one.
    NameTimeUnit(Option<TimeUnit>),
    /// Count pixels from 0.
    CountFromZero {
        /// The sensor.
        sensor: Sensor,
        /// `true` if its size must be stated, too.
        name_sensor: bool,
    },
    /// Exchange x and y.
    ExchangeAxes,
    /// State the order of the columns, because these events are outside the sensor.
    NameColumns(Outside),
    /// State the true size of the sensor, because these events are outside it.
    CorrectSensor(Outside),
    /// Export events of both polarities, not of this one alone.
    BothPolarities(Polarity),
    /// State the board.
    NameBoard,
    /// Measure the board that was recognised.
    Measure(Recognised),
    /// Find the board: advice for the reason why it was not found.
    FindBoard(NoPattern),
    /// Correct radius or spacing of the board.
    CorrectRadius(OtherRadius),
    /// Calibrate from this recording.
    Calibrate {
        /// The recording.
        recording: PathBuf,
        /// The options with which it is read.
        options: RecordingOptions,
        /// The board in it.
        board: String,
    },
}

/// Events outside the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outside {
    /// All events.
    All,
    /// This number of them.
    Some(u64),
}

impl fmt::Display for Outside {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::All => write!(f, "all events lie outside the sensor"),
            Self::Some(count) => write!(f, "{count} events lie outside the sensor"),
        }
    }
}

impl From<&str> for Advice {
    fn from(words: &str) -> Self {
        Self::Plain(words.to_owned())
    }
}

impl fmt::Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Plain(words) => f.write_str(words),
            Self::TakeModel(kind) => write!(f, "calibrate again with the model {kind}"),
            Self::TakeWholeBoard(board) => write!(
                f,
                "calibrate again with the board {board}, which uses more of the recording; the lens is correct within the reported uncertainty"
            ),
            Self::CountRows => {
                write!(f, "count them on the board: more are stated than it has, or a part of it was never in view")
            }
            Self::CheckLensAndBoard => write!(
                f,
                "is the board wavy, or the lens dirty? A smooth bend and an uneven print are estimated already, unless they are fixed"
            ),
            Self::Free(names) => write!(
                f,
                "bring the board into the corners of the image, or request that {} be estimated anyway",
                names.join(", ")
            ),
            Self::NameSensor(Some(sensor)) => write!(f, "state the size of the sensor, probably {sensor}"),
            Self::NameSensor(None) => write!(f, "state the size of the camera's sensor"),
            Self::NameTimeUnit(Some(unit)) => write!(f, "state that times are in {unit}"),
            Self::NameTimeUnit(None) => write!(f, "are the times in the file in the unit of its format?"),
            Self::CountFromZero { sensor, name_sensor } => {
                let Sensor { width, height } = sensor;
                write!(f, "pixels are counted from 1, up to column {width} and row {height}: subtract 1 from x and y")?;
                if *name_sensor { write!(f, ", and state the size of the sensor, {sensor}") } else { Ok(()) }
            }
            Self::ExchangeAxes => {
                write!(
                    f,
                    "x and y are swapped: correct the order of the columns, or swap width and height of the sensor"
                )
            }
            Self::NameColumns(outside) => {
                write!(f, "{outside}: are the columns in another order? State it, such as x,y,t,p")
            }
            Self::CorrectSensor(outside) => write!(f, "{outside}: state its true size"),
            Self::BothPolarities(only) => f.write_str(&only_one_polarity(*only)),
            Self::NameBoard => write!(f, "no board was recognised: name it"),
            Self::Measure(found) => {
                write!(f, "the board is {found}: {}, for example {}", found.to_measure(), found.example())
            }
            Self::FindBoard(error) => error.fmt(f),
            Self::CorrectRadius(error) => error.fmt(f),
            Self::Calibrate { board, .. } => write!(f, "calibrate from it with the board {board}"),
        }
    }
}

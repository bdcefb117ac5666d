//! Advice as data, which [`Advice::worded`] puts into the words of a program. `Display` uses no option of any program.

use std::fmt;
use std::path::PathBuf;

use evcal_core::camera::ModelKind;
use evcal_core::event::Polarity;
use evcal_core::sensor::Sensor;
use evcal_files::remedy::{Remedy, Words};
use evcal_geometry::board::{CircleBoard, SquareBoard};
use event_recordings::likely_sensor::add_sensor;
use event_recordings::{RecordingOptions, TimeUnit};

use evcal_detection::detection::NoPattern;
use evcal_detection::detection::no_board::only_one_polarity;
use evcal_detection::detection::recognition::radius::OtherRadius;
use evcal_detection::detection::recognition::recognised::Recognised;

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
    /// State this board, which the recording shows.
    StateBoard(SquareBoard),
    /// Count rows and columns of the board.
    CountRows,
    /// Check that the lens is clean and the board is not wavy; bend and print of the board are estimated already,
    /// unless they are fixed.
    CheckLensAndBoard,
    /// Estimate a parameter that was fixed.
    Estimate {
        /// Its name.
        name: &'static str,
        /// The request to fix it, such as `k3=0`.
        fixed: String,
    },
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

impl Advice {
    /// Returns the advice in the words of a program.
    pub fn worded(&self, say: &Words) -> String {
        let Words { board, model, sensor, columns, time_unit, .. } = say;
        match self {
            Self::Plain(words) => words.clone(),
            Self::TakeModel(kind) => format!("calibrate again with {}", model.with(kind)),
            Self::TakeWholeBoard(whole) => format!(
                "calibrate again with {}, which uses more of the recording; the lens is correct within the reported uncertainty",
                board.with(whole)
            ),
            Self::StateBoard(shown) => format!("measure the print, and use {} if it is right", board.with(shown)),
            Self::CountRows => format!(
                "count rows and columns of the board: {board} has more than the board, or a part of the board was never in view"
            ),
            Self::CheckLensAndBoard => {
                let fixed = say.fix.map(|fix| format!(" with {fix}")).unwrap_or_default();
                format!(
                    "check whether the board is wavy or the lens dirty (a smooth bend and an uneven print are estimated, unless fixed{fixed})"
                )
            }
            Self::Estimate { name, fixed } => match say.fix {
                Some(fix) => format!("leave out {}, so that it is estimated", fix.with(fixed)),
                None => format!("let {name} be estimated"),
            },
            Self::Free(names) => {
                let anyway = match say.free {
                    Some(free) => {
                        let options: Vec<String> = names.iter().map(|name| free.with(name)).collect();
                        format!("estimate them anyway with {}", options.join(" "))
                    }
                    None => format!("request that {} be estimated anyway", names.join(", ")),
                };
                format!("bring the board into the corners of the image, or {anyway}")
            }
            Self::NameSensor(Some(likely)) => add_sensor(Some(*likely), say),
            Self::NameSensor(None) => format!("{}, the size of the camera's sensor", add_sensor(None, say)),
            Self::NameTimeUnit(Some(unit)) => format!("add {}", time_unit.with(unit.symbol())),
            Self::NameTimeUnit(None) => "are the times in the file in the unit of its format?".to_owned(),
            Self::CountFromZero { sensor: counted, name_sensor } => {
                let Sensor { width, height } = counted;
                let size = name_sensor.then(|| format!(", and {}", add_sensor(Some(*counted), say)));
                format!(
                    "pixels are counted from 1, up to column {width} and row {height}: subtract 1 from x and y{}",
                    size.unwrap_or_default()
                )
            }
            Self::ExchangeAxes => {
                format!("x and y are swapped: correct {columns}, or swap the two numbers of {sensor}")
            }
            Self::NameColumns(outside) => {
                format!("{outside}: check the order of the columns, and give it with {columns}, such as x,y,t,p")
            }
            Self::CorrectSensor(outside) => format!("{outside}: give the true size of the sensor with {sensor}"),
            Self::BothPolarities(only) => format!("{} with {columns}", only_one_polarity(*only)),
            Self::NameBoard => format!(
                "no board was recognised: describe it with {board}, for example acircles:9x4:55mm:r17.5mm or checkerboard:6x9:25mm"
            ),
            Self::Measure(found) => {
                let example = found.remedy(say).map_or(String::new(), |example| format!(", {example}"));
                format!("the board is {found}: {}{example}", found.to_do())
            }
            Self::FindBoard(error) => error.advised(say),
            Self::CorrectRadius(error) => error.advised(say),
            Self::Calibrate { board: known, .. } => format!("calibrate from it with {}", board.with(known)),
        }
    }
}

impl fmt::Display for Advice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.worded(&Words::LIBRARY))
    }
}

//! Errors of a calibration.

use super::board_choice::LargerBoard;
use crate::advice::Advice;
use crate::check::units::OtherUnit;
use crate::picture_calibration::alignment::Misalignment;
use crate::picture_calibration::calibration::NoPictureCalibration;
use crate::picture_calibration::joint::NoJointPoints;
use evcal_core::sensor::Sensor;
use evcal_detection::detection::exchanged::Exchanged;
use evcal_detection::detection::recognition::radius::OtherRadius;
use evcal_detection::detection::{LARGEST_SENSOR, NoPattern};
use evcal_detection::diagnosis::silent_lines::SilentLines;
use evcal_detection::diagnosis::time_steps::CoarseTimes;
use evcal_files::remedies;
use evcal_solve::initial::InitialError;
use evcal_solve::solve::SolveError;
use evcal_solve::solve::refinement::RefinementError;
use evcal_solve::trajectory::first::FirstTrajectoryError;
use event_recordings::RecordingError;
use event_recordings::given_sensor::OtherSensor;
use event_recordings::images::ImagesError;
use event_recordings::likely_sensor::{add_sensor, likely_words};
use serde::{Serialize, Serializer};

/// Reasons why a calibration failed.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// The caller cancelled it.
    #[error("stopped before the end")]
    Stopped,
    /// There is no input.
    #[error("there is no recording: name at least one")]
    NoInput,
    /// A recording could not be read.
    #[error("{0}")]
    Source(#[from] RecordingError),
    /// The sensor size is not known.
    #[error("{file} does not say how many pixels the sensor has{}", likely_words(*.likely))]
    SensorUnknown {
        /// The file name.
        file: String,
        /// The smallest usual sensor that includes all pixels of the events.
        likely: Option<Sensor>,
    },
    /// The requested sensor differs from the sensor of a recording.
    #[error("{0}")]
    OtherSensor(#[from] OtherSensor),
    /// Event rates suggest that the timestamps have another unit.
    #[error("{file}: no board found, and {unit}")]
    TimeUnit {
        /// The file name.
        file: String,
        /// The more likely unit.
        unit: OtherUnit,
    },
    /// Timestamps are too coarse to find the board.
    #[error("{file}: no board found, and {times}: {}", CoarseTimes::ADVICE)]
    CoarseTimes {
        /// The file name.
        file: String,
        /// Resolution of the timestamps.
        times: CoarseTimes,
    },
    /// No board is found, and a large area of the sensor is silent.
    #[error("{file}: no board found, and {silent}: {}", SilentLines::ADVICE)]
    SilentArea {
        /// The file name.
        file: String,
        /// The area.
        silent: SilentLines,
    },
    /// The circles are not as large as stated.
    #[error("{0}")]
    OtherRadius(#[source] OtherRadius),
    /// ON and OFF are exchanged.
    #[error("{file}: {exchanged}; {}", Exchanged::ADVICE)]
    Exchanged {
        /// The file name.
        file: String,
        /// The evidence.
        exchanged: Exchanged,
    },
    /// In most windows the tags are negatives of the board's tags.
    #[error(
        "{file}: dark and light are exchanged in {inverted} of {windows} windows: ON and OFF are exchanged in the file, or the board is light on dark; {}",
        Exchanged::ADVICE
    )]
    Inverted {
        /// The file name.
        file: String,
        /// Number of windows with negatives of the tags.
        inverted: u64,
        /// Number of windows that were searched.
        windows: u64,
    },
    /// In most windows the tags are mirror images of the board's tags.
    #[error(
        "{file}: the tags are mirrored in {mirrored} of {windows} windows: print the board again, not mirrored, or correct x or y if the file counts it from the other side"
    )]
    Mirrored {
        /// The file name.
        file: String,
        /// Number of windows with mirror images of the tags.
        mirrored: u64,
        /// Number of windows that were searched.
        windows: u64,
    },
    /// The lens or the board cannot have the given values.
    #[error("the values of the fixed parameters are not possible for this lens or board")]
    ImpossibleValues,
    /// No solution exists with the given values of the lens.
    #[error(
        "with these fixed parameters no event is near the board's circles: do the values belong to this lens? Parameters that are not fixed are estimated"
    )]
    FixedFarOff,
    /// The stated board is a part of a larger one.
    #[error("too few views are consistent: is the board described correctly? It looks like {}: {}", .0.found, .0.board)]
    LargerBoard(Box<LargerBoard>),
    /// The sensor is too large.
    #[error("{file} is of a sensor with {} x {} pixels; up to {} x {} are supported", .sensor.width, .sensor.height, LARGEST_SENSOR.width, LARGEST_SENSOR.height)]
    SensorTooLarge {
        /// The file name.
        file: String,
        /// Its size.
        sensor: Sensor,
    },
    /// The recordings are of different sensors.
    #[error("{file} is of a sensor with {} x {} pixels, the recordings before it of one with {} x {}: calibrate one camera at a time", .sensor.width, .sensor.height, .before.width, .before.height)]
    SensorsDiffer {
        /// The file name.
        file: String,
        /// Its sensor.
        sensor: Sensor,
        /// The sensor of the recordings before it.
        before: Sensor,
    },
    /// Two recordings contain the same events.
    #[error("{file} contains the same events as {other}: give each recording once, and none that is part of another")]
    SameEvents {
        /// The file name.
        file: String,
        /// The earlier file with the same events.
        other: String,
    },
    /// There are no events.
    #[error("{file} contains no events")]
    Empty {
        /// The file name.
        file: String,
    },
    /// The board was not found.
    #[error("{0}")]
    NoPattern(#[source] NoPattern),
    /// There is no initial model.
    #[error("{0}")]
    Initial(#[from] InitialError),
    /// There is no start trajectory.
    #[error("{0}")]
    FirstTrajectories(#[from] FirstTrajectoryError),
    /// The joint solve failed.
    #[error("{0}")]
    Solve(#[source] SolveError),
    /// Images could not be read.
    #[error("{0}")]
    Images(#[from] ImagesError),
    /// Events are required, and there are only frames.
    #[error(
        "{file} contains frames, not events: give a recording of events, and calibrate the frames as a second camera"
    )]
    OnlyFrames {
        /// The folder.
        file: String,
    },
    /// There are no pictures.
    #[error(
        "{file} contains no frames{}, but frames were requested: record them too, or do not request them",
        passed_over.iter().map(|passed_over| format!(" of this camera ({passed_over})")).collect::<String>()
    )]
    NoPictures {
        /// The files.
        file: String,
        /// Sentence about a stream of frames that is not read.
        passed_over: Option<String>,
    },
    /// The pictures do not yield a calibration.
    #[error("no calibration from the camera's frames: {0}")]
    Pictures(NoPictureCalibration),
    /// The views of a board that blinks do not yield a calibration.
    #[error("no calibration from a board that blinks: {0}")]
    Views(NoPictureCalibration),
    /// The board blinks, and frames were requested in addition to the events.
    #[error(
        "the board blinks in front of a camera at rest ({views} views show it): frames are solved only together with events of a board that moves"
    )]
    BlinkingWithFrames {
        /// Number of views with the board.
        views: usize,
    },
    /// A parameter of the board is requested, and there are only pictures.
    #[error(
        "print-ratio, bend and radius of the board can only be fixed or estimated with the events of a board that moves"
    )]
    BoardOfPictures,
    /// Pictures and events of the same moment show the board at different positions.
    #[error("frames and events cannot be solved together: {}; {}", .0, .0.advice())]
    PicturesMisaligned(Misalignment),
    /// Pictures and events cannot be solved together.
    #[error("frames and events cannot be solved together: {0}")]
    JointPictures(NoJointPoints),
}

remedies! { CalibrateError, say;
    Self::Source(error) => error.remedy(say);
    Self::OtherSensor(error) => error.remedy(say);
    Self::OtherRadius(error) => error.remedy(say);
    Self::NoPattern(error) => error.remedy(say);
    Self::Initial(error) => error.remedy(say);
    Self::Images(error) => error.remedy(say);
    Self::Views(none) => none.reason.remedy(say);
    Self::SensorUnknown { likely, .. } => Some(add_sensor(*likely, say));
    Self::TimeUnit { unit, .. } => Some(Advice::NameTimeUnit(unit.unit).worded(say));
    Self::LargerBoard(larger) => "use {}", say.board.with(larger.board);
    Self::ImpossibleValues => "change the values of {}", say.fix?;
    Self::FixedFarOff => "leave out {}", say.fix?;
    Self::OnlyFrames { .. } =>
        "add {}, or give a recording of events first and the frames with {}", say.frames_only?, say.with?;
    Self::BlinkingWithFrames { .. } => "leave out {}: evcal then calibrates from the views", say.frames_jointly?;
    Self::BoardOfPictures => "leave out {} and {} of the board", say.fix?, say.free?;
    Self::NoPictures { .. } => "record with {}, or leave out the option that needs frames", say.frames?;
}

impl CalibrateError {
    /// Returns `true` if the recordings could be read and their content explains the failure.
    pub fn is_explained_by_content(&self) -> bool {
        matches!(
            self,
            Self::NoPattern(_)
                | Self::OtherRadius(_)
                | Self::Exchanged { .. }
                | Self::LargerBoard(_)
                | Self::Initial(_)
                | Self::FirstTrajectories(_)
                | Self::Solve(_)
                | Self::Pictures(_)
                | Self::Views(_)
                | Self::BlinkingWithFrames { .. }
                | Self::PicturesMisaligned(_)
                | Self::JointPictures(_)
        )
    }
}

impl From<RefinementError<Self>> for CalibrateError {
    fn from(error: RefinementError<Self>) -> Self {
        match error {
            RefinementError::Read(error) => error,
            RefinementError::Solve(error) => Self::Solve(error),
        }
    }
}

impl Serialize for CalibrateError {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

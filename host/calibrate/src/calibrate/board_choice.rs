//! The board of a calibration: named by the user, or recognised in the recordings.

use super::input::Input;
use crate::detection::layout::{RecognisedLayout, find_layout};
use crate::detection::recognised::{Recognised, find_board};
use crate::detection::search::{SearchError, sensor_of};
use crate::detection::settings::DetectionSettings;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::request::{BoardRequest, CircleSize, PrintSize};
use evcal_geometry::board::{Board, CircleBoard};
use event_recordings::{Recording, RecordingError};

/// Reasons why the board is not known.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BoardChoiceError {
    /// A recording could not be searched.
    #[error("{0}")]
    Search(#[from] SearchError),
    /// There are no events in which a board could be recognised.
    #[error("`auto` requires a recording of events: name the board")]
    NoEvents,
    /// No layout fits.
    #[error(
        "no board recognised in {file}: is all of the board in view at times, flat, in focus and moving? If so, name it"
    )]
    NotRecognised {
        /// The recording that was searched last.
        file: String,
    },
    /// The layout is known, the size is not.
    #[error("the board is {found}, but events do not determine its size: {}", .found.to_measure())]
    SizeUnknown {
        /// The board.
        found: Recognised,
    },
}

/// Returns the board of `request`. If it has to be recognised, the first recording with a recognisable board decides.
///
/// # Errors
/// [`BoardChoiceError`] if no board is recognised, or its size is not given.
pub fn choose_board(
    request: &BoardRequest,
    recordings: &[&Recording],
    settings: &DetectionSettings,
) -> Result<Board, BoardChoiceError> {
    let size = match request {
        BoardRequest::Given(board) => return Ok(*board),
        BoardRequest::Recognise(size) => size,
    };
    let found = recognise_board(recordings, settings)?;
    match (size, found) {
        (PrintSize::Circles(CircleSize { spacing, radius }), Recognised::Circles(layout)) => {
            Ok(CircleBoard { pattern: layout.pattern, spacing: *spacing, radius: *radius }.into())
        }
        (PrintSize::Squares(side), Recognised::Squares(squares)) => {
            Ok(Board::Squares(squares.board.with_length(*side)))
        }
        (PrintSize::Unknown | PrintSize::Circles(_) | PrintSize::Squares(_), found) => {
            Err(BoardChoiceError::SizeUnknown { found })
        }
    }
}

/// Returns the board in the first of the recordings in which one is recognised.
///
/// # Errors
/// [`BoardChoiceError`] if no board is recognised.
pub fn recognise_board(
    recordings: &[&Recording],
    settings: &DetectionSettings,
) -> Result<Recognised, BoardChoiceError> {
    first_found(recordings, |recording, sensor| find_board(recording, sensor, settings))
}

/// Returns the result of `find` for the first of the recordings for which it is not `None`.
fn first_found<T>(
    recordings: &[&Recording],
    find: impl Fn(&Recording, Sensor) -> Result<Option<T>, RecordingError>,
) -> Result<T, BoardChoiceError> {
    let mut error = BoardChoiceError::NoEvents;
    for recording in recordings {
        let sensor = sensor_of(recording)?;
        match find(recording, sensor).map_err(SearchError::from)? {
            Some(found) => return Ok(found),
            None => error = BoardChoiceError::NotRecognised { file: recording.path().display().to_string() },
        }
    }
    Err(error)
}

/// The printed board, if the nominal board is only a part of it. The nominal board then fits several positions on the
/// printed one.
#[derive(Clone, Debug)]
pub struct LargerBoard {
    /// Its layout.
    pub found: RecognisedLayout,
    /// The larger board with the nominal spacing and radius.
    pub board: CircleBoard,
}

/// Returns the board with more circles than `board` that is recognised in `inputs`, if there is one.
pub fn larger_board(inputs: &[Input], board: &CircleBoard, settings: &DetectionSettings) -> Option<LargerBoard> {
    let recordings = inputs.iter().filter_map(|input| match input {
        Input::Events(recording) => Some(recording),
        Input::Images(_) | Input::Circles { .. } => None,
    });
    // If no board is recognised, there is nothing to report.
    let find = |recording: &Recording, sensor: Sensor| find_layout(recording, sensor, settings);
    let found = first_found(&recordings.collect::<Vec<_>>(), find).ok()?;
    let fitting = CircleBoard { pattern: found.pattern, ..*board };
    (found.pattern.circle_count() > board.circle_count()).then_some(LargerBoard { found, board: fitting })
}

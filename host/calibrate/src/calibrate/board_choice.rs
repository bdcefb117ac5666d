//! The board of a calibration: named by the user, or recognised in the recordings.

use super::input::Input;
use crate::detection::layout::{RecognisedLayout, find_layout};
use crate::detection::search::{SearchError, sensor_of};
use crate::detection::settings::DetectionSettings;
use evcal_geometry::board::request::{BoardRequest, CircleSize};
use evcal_geometry::board::{Board, CircleBoard};
use event_recordings::Recording;

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
        "no circle grid recognised in {file}: is all of the board in view at times, flat, in focus and moving? If so, name it"
    )]
    NotRecognised {
        /// The recording that was searched last.
        file: String,
    },
    /// The layout is known, the size is not.
    #[error("the board is {found}, but events do not determine its size: {}", .found.to_measure())]
    SizeUnknown {
        /// The layout.
        found: RecognisedLayout,
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
    let found = recognise_layout(recordings, settings)?;
    match size {
        Some(CircleSize { spacing, radius }) => {
            Ok(CircleBoard { pattern: found.pattern, spacing: *spacing, radius: *radius }.into())
        }
        None => Err(BoardChoiceError::SizeUnknown { found }),
    }
}

/// Returns the layout of the board in the first of the recordings in which one is recognised.
///
/// # Errors
/// [`BoardChoiceError`] if no board is recognised.
pub fn recognise_layout(
    recordings: &[&Recording],
    settings: &DetectionSettings,
) -> Result<RecognisedLayout, BoardChoiceError> {
    let mut error = BoardChoiceError::NoEvents;
    for recording in recordings {
        let sensor = sensor_of(recording)?;
        match find_layout(recording, sensor, settings).map_err(SearchError::from)? {
            Some(found) => return Ok(found),
            None => error = BoardChoiceError::NotRecognised { file: recording.path().display().to_string() },
        }
    }
    Err(error)
}

/// The printed board, if `board` is only a part of it; such a part is found in several positions of the whole.
#[derive(Clone, Debug)]
pub struct LargerBoard {
    /// Its layout.
    pub found: RecognisedLayout,
    /// The larger board with the stated spacing and radius.
    pub board: CircleBoard,
}

/// Returns the board with more circles than `board` that is recognised in `inputs`, if there is one.
pub fn larger_board(inputs: &[Input], board: &CircleBoard, settings: &DetectionSettings) -> Option<LargerBoard> {
    let recordings = inputs.iter().filter_map(|input| match input {
        Input::Events(recording) => Some(recording),
        Input::Images(_) | Input::Circles { .. } => None,
    });
    // If no board is recognised, there is nothing to report.
    let found = recognise_layout(&recordings.collect::<Vec<_>>(), settings).ok()?;
    let fitting = CircleBoard { pattern: found.pattern, ..*board };
    (found.pattern.circle_count() > board.circle_count()).then_some(LargerBoard { found, board: fitting })
}

//! The board of a calibration: named by the user, or recognised in the recordings.

use super::PictureUse;
use super::input::Input;
use crate::advice::Advice;
use crate::quality::verdict::{Cause, Finding, Severity};
use evcal_core::sensor::Sensor;
use evcal_detection::detection::recognition::layout::{RecognisedLayout, find_layout};
use evcal_detection::detection::recognition::other_board::OtherReading;
use evcal_detection::detection::recognition::recognised::{Recognised, find_board};
use evcal_detection::detection::recognition::stated_board::{
    OtherRatio, StatedBoard, compare, compare_frames, squares_instead_of,
};
use evcal_detection::detection::search::{SearchError, sensor_of};
use evcal_detection::detection::settings::DetectionSettings;
use evcal_files::remedies;
use evcal_geometry::board::request::{BoardRequest, CircleSize, PrintSize};
use evcal_geometry::board::squares::{CharucoLayout, TagGrid, TagOrder};
use evcal_geometry::board::{Board, CircleBoard, SquareBoard};
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
    #[error("the board is {found}, but events do not determine its size: {}", .found.to_do())]
    SizeUnknown {
        /// The board.
        found: Recognised,
    },
    /// The board is mirrored.
    #[error("the board is {found}: {}", .found.to_do())]
    Mirrored {
        /// The board.
        found: Recognised,
    },
    /// The stated board is not the one in view.
    #[error("the board is not {stated}: {found}")]
    Other {
        /// The stated board.
        stated: Board,
        /// The board in view.
        found: OtherReading,
    },
    /// The second length of the stated board is wrong.
    #[error("{}", ratio_in_words(.0))]
    WrongRatio(OtherRatio),
}

remedies! { BoardChoiceError, say;
    Self::Search(error) => error.remedy(say);
    Self::Other { found, .. } => found.remedy(say);
    Self::NoEvents => "for example {}", say.board.with("acircles:9x4:55mm:r17.5mm");
    Self::NotRecognised { .. } => "describe the board with {}{}", say.board,
        say.board_help.map_or(", for example checkerboard:6x9:25mm".to_owned(), |help| format!(": {help} lists all kinds"));
    Self::SizeUnknown { found } => found.remedy(say);
    Self::WrongRatio(ratio) => "use {}", say.board.with(ratio.board);
}

/// Describes the measured ratio of the two lengths of a board.
pub fn ratio_in_words(OtherRatio { board, measured, stated }: &OtherRatio) -> String {
    match board {
        SquareBoard::Charuco(board) => format!(
            "the markers measure {:.1} mm if a square measures {:.1} mm ({measured:.3} of it), not {:.1} mm",
            1e3 * measured * board.square,
            1e3 * board.square,
            1e3 * stated * board.square
        ),
        SquareBoard::Tags(grid) => format!(
            "the gap between two tags is about {} of a tag's side, not {stated} (measured: {measured:.2})",
            grid.spacing
        ),
        SquareBoard::Checkerboard(_) => String::new(),
    }
}

/// The board to calibrate with, if it was stated.
#[derive(Clone, Debug, PartialEq)]
pub struct ConfirmedBoard {
    /// The board.
    pub board: Board,
    /// The difference between the stated board and the recording, if there is one.
    pub finding: Option<Finding>,
}

impl From<Board> for ConfirmedBoard {
    fn from(board: Board) -> Self {
        Self { board, finding: None }
    }
}

/// Compares a stated board with some pictures of the first recording that shows it, in its events or else in its frames, or in its
/// frames alone if only `pictures` are calibrated; a board of circles with some windows. If the tags of the stated board are only
/// numbered, rotated or bordered in another way, or frames show its markers in another size, returns the board in view.
///
/// # Errors
/// [`BoardChoiceError`] if the board in view is another one.
pub fn confirm_board(
    board: &Board,
    recordings: &[&Recording],
    pictures: PictureUse,
    settings: &DetectionSettings,
) -> Result<ConfirmedBoard, BoardChoiceError> {
    for recording in recordings {
        // A recording without a known sensor, or one that contains no events, is reported when it is calibrated.
        let sensor = sensor_of(recording).ok();
        let stated = match board {
            Board::Squares(stated) => stated,
            // Of several recordings, some may show nothing.
            Board::Circles(stated) if recordings.len() == 1 => {
                let Some(sensor) = sensor else { continue };
                match squares_instead_of(stated, recording, sensor, settings) {
                    Ok(Some(found)) => return Err(BoardChoiceError::Other { stated: *board, found }),
                    _ => continue,
                }
            }
            Board::Circles(_) => continue,
        };
        let of_events = match pictures {
            PictureUse::Only => None,
            _ => sensor.and_then(|sensor| compare(recording, sensor, stated).ok()),
        };
        let is_clear = of_events.as_ref().is_some_and(|compared| *compared != StatedBoard::Unclear);
        let compared = if is_clear { of_events } else { compare_frames(recording, stated).ok() };
        match compared.unwrap_or(StatedBoard::Unclear) {
            StatedBoard::Kept | StatedBoard::Unclear => {}
            StatedBoard::DoubtfulRatio(ratio) => {
                let finding = Some(finding_on_ratio(&ratio));
                return Ok(ConfirmedBoard { board: *board, finding });
            }
            StatedBoard::WrongRatio(ratio) => return Err(BoardChoiceError::WrongRatio(ratio)),
            StatedBoard::Variant(found) => {
                let differences = differences(&found, stated).join(", ");
                let file = recording.path().display();
                let finding = Some(Finding::new(
                    Cause::BoardNotAsStated,
                    Severity::Note,
                    format!(
                        "{file} shows the board {found}, not {stated}: {differences}; it is calibrated with {found}"
                    ),
                    Advice::StateBoard(found),
                ));
                return Ok(ConfirmedBoard { board: Board::Squares(found), finding });
            }
            StatedBoard::Other(found) => return Err(BoardChoiceError::Other { stated: *board, found }),
        }
    }
    Ok((*board).into())
}

/// Returns the finding on the second length of a board of tags. A wrong size of the markers of a ChArUco board moves none of its
/// corners.
fn finding_on_ratio(ratio: &OtherRatio) -> Finding {
    let severity = match ratio.board {
        SquareBoard::Charuco(_) => Severity::Note,
        _ => Severity::Warning,
    };
    Finding::new(Cause::LengthsDisagree, severity, ratio_in_words(ratio), Advice::StateBoard(ratio.board))
}

/// Describes the numbering, rotation, border and size of the tags of `found` that differ from `stated`.
fn differences(found: &SquareBoard, stated: &SquareBoard) -> Vec<String> {
    match (found, stated) {
        (SquareBoard::Tags(found), SquareBoard::Tags(stated)) => {
            let mut words = Vec::new();
            if found.first_id != stated.first_id {
                words.push(format!("the first tag is {}", found.first_id));
            }
            if found.order != stated.order {
                words.push(match found.order {
                    TagOrder::Upwards => "rows are numbered from the bottom".to_owned(),
                    TagOrder::Downwards => "rows are numbered from the top".to_owned(),
                });
            }
            let turn = |grid: &TagGrid| (grid.turn + if grid.order == TagOrder::Downwards { 2 } else { 0 }) % 4;
            if turn(found) != turn(stated) {
                let quarters = (turn(found) + 4 - turn(stated)) % 4;
                words.push(format!("each tag is rotated by {}°", 90 * u16::from(quarters)));
            }
            if found.border != stated.border {
                let modules = if found.border == 1 { "module" } else { "modules" };
                words.push(format!("the dark border of a tag is {} {modules} wide", found.border));
            }
            words
        }
        (SquareBoard::Charuco(found), SquareBoard::Charuco(stated)) if found.layout == stated.layout => {
            vec![format!("its markers measure {:.1} mm", 1e3 * found.marker)]
        }
        (SquareBoard::Charuco(found), _) => vec![match found.layout {
            CharucoLayout::Current => "the square at its top left is dark".to_owned(),
            CharucoLayout::Legacy => "the square at its top left contains the first marker".to_owned(),
        }],
        _ => Vec::new(),
    }
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
/// [`BoardChoiceError`] if no board is recognised, or if it is mirrored.
pub fn recognise_board(
    recordings: &[&Recording],
    settings: &DetectionSettings,
) -> Result<Recognised, BoardChoiceError> {
    match first_found(recordings, |recording, sensor| find_board(recording, sensor, settings))? {
        found if found.is_mirrored() => Err(BoardChoiceError::Mirrored { found }),
        found => Ok(found),
    }
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

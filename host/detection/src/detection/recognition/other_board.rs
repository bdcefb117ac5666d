//! Comparison with other boards if the stated board was not found.
//!
//! The circles of the first seconds are compared with boards that users confuse with the stated one: rows and columns exchanged,
//! the other layout. One that fits many windows is reported, otherwise any layout that does ([`super::layout`]). A mirrored print
//! is not one of them: its circles have the same positions as those of a correct print, and lead to the same camera.

use std::fmt;

use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;

use super::layout::{FEWEST_CIRCLES, RecognisedLayout, first_circles, recognise};
use super::radius::other_radius;
use super::recognised::{Recognised, find_board, find_squares, in_lengths_of, is_same};
use crate::circles::reference_frame::{ReferenceFrame, UnorderedFrame};
use crate::detection::order_frames;
use crate::detection::settings::DetectionSettings;
use evcal_files::remedies;
use evcal_geometry::board::{Board, CircleBoard, SquareBoard};
use evcal_squares::recognition::RecognisedBoard;
use event_recordings::{Recording, RecordingError};

/// Another board must fit at least this share of the windows that have at least half as many circles as the nominal
/// board.
const FEWEST_FITS: f64 = 0.2;

/// A board that fits better than the stated one.
#[derive(Clone, Debug, PartialEq)]
pub enum OtherReading {
    /// A board of the same kind, with the stated lengths.
    Board {
        /// Number of windows or pictures that it fits.
        fitting: usize,
        /// Number of windows with enough circles, or of pictures.
        windows: usize,
        /// The board.
        board: Board,
    },
    /// A board of another kind, whose lengths are unknown, or a mirrored one.
    Kind(Recognised),
}

impl OtherReading {
    /// Returns the layout of the circles, if the board has circles.
    pub fn pattern(&self) -> Option<Pattern> {
        match self {
            Self::Board { board, .. } => board.circles().map(|board| board.pattern),
            Self::Kind(Recognised::Circles(layout)) => Some(layout.pattern),
            Self::Kind(Recognised::Squares(_)) => None,
        }
    }
}

remedies! { OtherReading, say;
    Self::Board { board, .. } => "use {}", say.board.with(board);
    Self::Kind(found) => found.remedy(say);
}

impl fmt::Display for OtherReading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Board { fitting, windows, board } => {
                write!(f, "{fitting} of {windows} windows fit the board {board} instead")
            }
            Self::Kind(found) => write!(f, "the board is {found}: {}", found.to_do()),
        }
    }
}

/// Returns the board in the first seconds of `recording`, if it is another one than `board`, which was not found there;
/// `None` if none is recognised.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn find_other_board(
    recording: &Recording,
    sensor: Sensor,
    board: &Board,
    settings: &DetectionSettings,
) -> Result<Option<OtherReading>, RecordingError> {
    match board {
        Board::Circles(board) => {
            if let Some(squares) = find_squares(recording, sensor)? {
                return Ok(Some(OtherReading::Kind(Recognised::Squares(squares))));
            }
            let frames = first_circles(recording, sensor, settings, FEWEST_CIRCLES.min(half(board)))?;
            Ok(other_reading(&frames, board, sensor))
        }
        Board::Squares(stated) => Ok(match find_board(recording, sensor, settings)? {
            Some(Recognised::Squares(found)) => other_squares(found, stated),
            Some(circles) => Some(OtherReading::Kind(circles)),
            None => None,
        }),
    }
}

/// Returns the recognised board of squares if it differs from the stated one; `None` if it does not.
pub(in crate::detection) fn other_squares(found: RecognisedBoard, stated: &SquareBoard) -> Option<OtherReading> {
    let other_kind = || Some(OtherReading::Kind(Recognised::Squares(found)));
    if found.is_mirrored {
        return other_kind();
    }
    let Some(board) = in_lengths_of(&found.board, stated) else { return other_kind() };
    let (fitting, windows) = (found.fitting, found.moments);
    (!is_same(&board, stated)).then_some(OtherReading::Board { fitting, windows, board: Board::Squares(board) })
}

/// Returns the board that the circles of all frames fit instead of `board`: one that users confuse with it, or any recognised
/// layout; `None` if no board fits.
pub fn other_reading(all: &[UnorderedFrame], board: &CircleBoard, sensor: Sensor) -> Option<OtherReading> {
    let frames: Vec<UnorderedFrame> = all.iter().filter(|frame| frame.circles.len() >= half(board)).cloned().collect();
    let pattern = board.pattern;
    let exchanged = Pattern { rows: pattern.columns, columns: pattern.rows, ..pattern };
    let layout = match pattern.layout {
        Layout::Asymmetric => Layout::Symmetric,
        Layout::Symmetric => Layout::Asymmetric,
    };
    let readings = [exchanged, Pattern { layout, ..pattern }, Pattern { layout, ..exchanged }].map(|pattern| {
        let (found, _) = order_frames(&frames, &pattern, Some(sensor));
        (found, pattern)
    });
    let (found, pattern) = readings.into_iter().max_by_key(|(found, _)| found.len())?;
    let fitting = found.len();
    if fitting > 0 && fitting as f64 >= FEWEST_FITS * frames.len() as f64 {
        let board = with_likely_lengths(&found, CircleBoard { pattern, ..*board }).into();
        return Some(OtherReading::Board { fitting, windows: frames.len(), board });
    }
    let RecognisedLayout { pattern, fitting, windows, .. } = recognise(all, sensor)?;
    let (found, _) = order_frames(all, &pattern, Some(sensor));
    let board = with_likely_lengths(&found, CircleBoard { pattern, ..*board }).into();
    Some(OtherReading::Board { fitting, windows, board })
}

/// Returns `board`, or the board that is meant if its circles in `frames` have another radius: of the other layout, the spacing is the
/// distance of other circles.
fn with_likely_lengths(frames: &[ReferenceFrame], board: CircleBoard) -> CircleBoard {
    let meant = other_radius(frames, &board).and_then(|other| other.meant.first().map(|(_, board)| *board));
    meant.unwrap_or(board)
}

/// Returns half of a board's circles, rounded up.
fn half(board: &CircleBoard) -> usize {
    board.circle_count().div_ceil(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the board to state, and `true` if all its lengths are known.
    fn other(found: &str, stated: &str) -> Option<(String, bool)> {
        let board = found.parse().unwrap();
        let found = RecognisedBoard::new(board, 9, 10);
        other_squares(found, &stated.parse().unwrap()).map(|other| match other {
            OtherReading::Board { board, .. } => (board.to_string(), true),
            OtherReading::Kind(found) => (found.example(), false),
        })
    }

    #[test]
    fn nominal_lengths_are_used_only_if_they_describe_the_same_squares() {
        assert_eq!(other("checkerboard:6x9:30mm", "checkerboard:9x6:25mm"), None);
        assert_eq!(other("apriltags:3x4:30mm:0.25", "apriltags:3x4:50mm:0.24"), None);
        let known = |board: &str| Some((board.to_owned(), true));
        assert_eq!(other("checkerboard:6x9:30mm", "checkerboard:7x10:25mm"), known("checkerboard:6x9:25mm"));
        assert_eq!(
            other("checkerboard:6x9:30mm", "charuco:7x10:25mm:18mm:DICT_4X4_50"),
            known("checkerboard:6x9:25mm")
        );
        // The stated ratio of both lengths is kept, because the recognised one is only measured.
        assert_eq!(
            other("charuco:5x7:30mm:22.2mm:DICT_5X5_50", "charuco:5x7:40mm:30mm:DICT_4X4_100"),
            known("charuco:5x7:40mm:30mm:DICT_5X5_50")
        );
        // Of dictionaries that contain the same tags, the stated one is kept.
        assert_eq!(
            other("charuco:5x7:30mm:22.2mm:DICT_5X5_50", "charuco:7x5:40mm:30mm:DICT_5X5_100"),
            known("charuco:5x7:40mm:30mm:DICT_5X5_100")
        );
        assert_eq!(other("apriltags:3x4:30mm:0.25", "apriltags:4x3:30mm:0.26"), known("apriltags:3x4:30mm:0.26"));
        // The stated lengths do not determine the lengths of a board of another kind.
        let unknown = |board: &str| Some((board.to_owned(), false));
        let charuco = "charuco:5x7:30mm:22mm:DICT_5X5_50";
        assert_eq!(other(charuco, "aprilgrid:6x6:88mm:0.3"), unknown(charuco));
        assert_eq!(other(charuco, "checkerboard:4x6:25mm"), unknown(charuco));
    }
}

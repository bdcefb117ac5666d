//! Reasons why no board was found in a window or a picture, with remedies.

use std::fmt;

use evcal_core::circle::Extraction;
use evcal_core::event::Polarity;
use serde::{Deserialize, Serialize};

use event_recordings::pictures::NoImage;

use super::exchanged::Exchanged;

/// Reason why no board was found in a window, a picture or a frame of circles. The order of the variants is the order
/// in `calibration.json`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum NoBoard {
    /// OpenCV's grid finder raised an error.
    #[serde(rename = "OpenCV failed")]
    OpencvFailed,
    /// OpenCV's grid finder found no board.
    #[serde(rename = "OpenCV found no grid")]
    OpencvFoundNone,
    /// The edges of a picture's dots are too blurred.
    #[serde(rename = "blurred")]
    Blurred,
    /// The lattice is not near the position to which the board moved.
    #[serde(rename = "board not where it is expected")]
    NotAsExpected,
    /// The corners of squares belong to a larger or smaller checkerboard.
    #[serde(rename = "corners beside the board")]
    OtherCheckerboardSize,
    /// The corners of squares do not form a checkerboard.
    #[serde(rename = "corners form no checkerboard")]
    NoCheckerboard,
    /// No tag of the board was found.
    #[serde(rename = "no tags of the board")]
    NoTags,
    /// The dark border of the tags has another width than stated.
    #[serde(rename = "tags with another border")]
    OtherBorder,
    /// Some tags belong to the board, but their neighbours do not.
    #[serde(rename = "tags of another board")]
    OtherTags,
    /// The board is printed mirrored.
    #[serde(rename = "mirrored print")]
    MirroredPrint,
    /// Dark and light are exchanged.
    #[serde(rename = "dark and light exchanged")]
    Inverted,
    /// There are fewer corners of squares than required.
    #[serde(rename = "too few corners")]
    TooFewCorners,
    /// The lattice continues where the board ends.
    #[serde(rename = "circles beside the board")]
    LargerThanBoard,
    /// The circles do not form a lattice.
    #[serde(rename = "circles form no lattice")]
    NoLattice,
    /// The circles are not at the positions of a smooth lattice.
    #[serde(rename = "circles scatter too much")]
    Scattered,
    /// The dots of the lattice have corners, or holes.
    #[serde(rename = "dots that are not round")]
    NotRound,
    /// The encoding of a picture is not supported.
    #[serde(rename = "in an encoding that is not read")]
    UnreadEncoding,
    /// Columns of a picture were lost in transmission.
    #[serde(rename = "lost columns")]
    LostColumns,
    /// The grid finder failed for a reason without a name here.
    #[serde(rename = "no board")]
    Unknown,
    /// A picture has no dots.
    #[serde(rename = "no dots")]
    NoDots,
    /// A picture is neither greyscale nor colour.
    #[serde(rename = "no grey or colour picture")]
    NotGrey,
    /// There is a lattice, but it is not known which part of the board it is.
    #[serde(rename = "not clear which part of the board", alias = "place on the board not certain")]
    PlaceUncertain,
    /// The rows of a picture were exposed one after the other.
    #[serde(rename = "rolling shutter")]
    RollingShutter,
    /// There are fewer circles than required.
    #[serde(rename = "too few circles")]
    TooFewCircles,
    /// There is a lattice, with too few circles.
    #[serde(rename = "too few circles in the grid of the board")]
    TooFewOfBoard,
    /// The window contains too few events for a search.
    #[serde(rename = "too few events")]
    TooFewEvents,
    /// There are more circles than the grid finder accepts.
    #[serde(rename = "too many circles")]
    TooManyCircles,
}

/// Advice if image or print are mirrored.
pub const MIRRORED_ADVICE: &str =
    "correct x or y if the file counts it from the other side, or print the board again, not mirrored";

impl NoBoard {
    /// Returns the advice if this is the reason in most windows; `max_interval` is the setting of the windows, `extraction` the
    /// way in which circles were searched.
    pub fn remedy(self, max_interval: u16, extraction: Extraction) -> String {
        if let Some(advice) = self.advice_on_print() {
            return advice.to_owned();
        }
        match self {
            Self::TooFewEvents => {
                format!("move faster, or set a larger detection.window.max_interval (now {max_interval})")
            }
            Self::TooFewCircles if extraction == Extraction::Soft => {
                "is the board in view, moving and in focus, and are its dots at least 3 px wide in the image? If so, move faster".to_owned()
            }
            Self::TooFewCircles => {
                "is the board in view, moving and in focus? If so, move faster, or use the soft extraction".to_owned()
            }
            Self::LargerThanBoard | Self::TooFewOfBoard | Self::PlaceUncertain => {
                "is the board described right: rows and columns, acircles or circles? Of rows with 5, 4, 5, 4 circles only 4 each are used: state 4 columns".to_owned()
            }
            Self::TooFewCorners | Self::NoCheckerboard => {
                "is all of the board in view and in focus? Show it for at least a second".to_owned()
            }
            Self::NoTags => "are the family of the tags, their border and their ids stated as printed?".to_owned(),
            _ => "is the board in view and flat, and is it described right?".to_owned(),
        }
    }

    /// Returns the advice if the board in view is not the stated one, whatever light and motion are; `None` for other reasons.
    pub fn advice_on_print(self) -> Option<&'static str> {
        Some(match self {
            Self::OtherCheckerboardSize => {
                "count the inner corners, where four squares meet: one row and one column fewer than squares"
            }
            Self::OtherBorder => "state the border as printed: 1 or 2 modules of the tag",
            Self::OtherTags => {
                "count rows and columns of tags, measure tag and gap, and see whether ids rise from the top or from the bottom"
            }
            Self::MirroredPrint => MIRRORED_ADVICE,
            Self::Inverted => Exchanged::ADVICE,
            Self::NotRound => {
                "they have corners or holes, like tags, keys, nuts or windows: is the board with round dots in view?"
            }
            _ => return None,
        })
    }
}

/// Explains why no circle can be found in events of this polarity alone, with advice.
pub fn only_one_polarity(polarity: Polarity) -> String {
    let only = match polarity {
        Polarity::On => "ON",
        Polarity::Off => "OFF",
    };
    format!(
        "all events are {only}, and a circle is found from ON and OFF events together: export the polarity too, or state which column it is"
    )
}

impl fmt::Display for NoBoard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The same text as in reports.
        self.serialize(f)
    }
}

impl From<NoImage> for NoBoard {
    fn from(reason: NoImage) -> Self {
        match reason {
            NoImage::RollingShutter => Self::RollingShutter,
            NoImage::LostColumns => Self::LostColumns,
            NoImage::NotGrey => Self::NotGrey,
            NoImage::UnreadEncoding => Self::UnreadEncoding,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_are_sorted_by_their_text() {
        use NoBoard::*;
        let all = [
            OpencvFailed,
            OpencvFoundNone,
            Blurred,
            NotAsExpected,
            LargerThanBoard,
            NoLattice,
            Scattered,
            NotRound,
            UnreadEncoding,
            LostColumns,
            Unknown,
            NoDots,
            NotGrey,
            PlaceUncertain,
            RollingShutter,
            TooFewCircles,
            TooFewOfBoard,
            TooFewEvents,
            TooManyCircles,
        ];
        assert!(all.is_sorted() && all.is_sorted_by_key(|reason| reason.to_string()));
    }
}

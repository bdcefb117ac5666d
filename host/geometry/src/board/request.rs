//! The user's request for a board: a full description, or recognition.

use std::fmt;
use std::str::FromStr;

use super::circles::{length, millimetres, radius_of};
use super::{Board, BoardError, BoardProblem, CircleBoardError};

/// A board that is given or to be recognised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardRequest {
    /// The board is fully described.
    Given(Board),
    /// Layout, rows and columns are to be recognised.
    Recognise(PrintSize),
}

/// Size of a board that is to be recognised: events do not determine it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PrintSize {
    /// Unknown: `auto`.
    Unknown,
    /// Size of a board of circles: `auto:55mm:r17.5mm`.
    Circles(CircleSize),
    /// Side in metres of a square of a board of squares, or of a tag of a grid of tags: `auto:25mm`.
    Squares(f64),
}

/// Size of the circles of a board, which events do not determine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleSize {
    /// Lattice spacing in metres, as [`CircleBoard::spacing`](super::CircleBoard::spacing).
    pub spacing: f64,
    /// Radius of a circle in metres.
    pub radius: f64,
}

/// Word that requests recognition of the board.
const AUTO: &str = "auto";

impl FromStr for BoardRequest {
    type Err = BoardError;

    fn from_str(text: &str) -> Result<Self, BoardError> {
        let error = |problem| CircleBoardError { text: text.to_owned(), problem };
        let parts: Vec<&str> = text.split(':').collect();
        match parts.as_slice() {
            [AUTO] => Ok(Self::Recognise(PrintSize::Unknown)),
            [AUTO, side] => {
                let side = length(side).ok_or_else(|| error(BoardProblem::Auto))?;
                Ok(Self::Recognise(PrintSize::Squares(side)))
            }
            [AUTO, spacing, radius] => {
                let size = CircleSize {
                    spacing: length(spacing).ok_or_else(|| error(BoardProblem::Spacing((*spacing).to_owned())))?,
                    radius: radius_of(radius).ok_or_else(|| error(BoardProblem::Radius((*radius).to_owned())))?,
                };
                Ok(Self::Recognise(PrintSize::Circles(size)))
            }
            [AUTO, ..] => Err(error(BoardProblem::Auto).into()),
            _ => Ok(Self::Given(text.parse()?)),
        }
    }
}

impl fmt::Display for BoardRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Given(board) => board.fmt(f),
            Self::Recognise(PrintSize::Unknown) => f.write_str(AUTO),
            Self::Recognise(PrintSize::Squares(side)) => write!(f, "{AUTO}:{}mm", millimetres(*side)),
            Self::Recognise(PrintSize::Circles(CircleSize { spacing, radius })) => {
                write!(f, "{AUTO}:{}mm:r{}mm", millimetres(*spacing), millimetres(*radius))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn board_requests_survive_a_round_trip_and_mistakes_have_a_remedy() {
        let parse = |text: &str| text.parse::<BoardRequest>().unwrap();
        assert_eq!(parse("auto"), BoardRequest::Recognise(PrintSize::Unknown));
        assert_eq!(parse("auto:25mm"), BoardRequest::Recognise(PrintSize::Squares(0.025)));
        for text in ["auto", "auto:25mm", "auto:55mm:r17.5mm", "acircles:9x4:55mm:r17.5mm"] {
            assert_eq!(parse(text).to_string(), text);
        }
        for text in ["auto:55", "auto:9x4:55mm:r17.5mm", "auto:55:r17.5mm", "auto:55mm:17.5mm", "automatic"] {
            let message = text.parse::<BoardRequest>().unwrap_err().to_string();
            assert!(message.contains("; write "), "{message}");
        }
        assert!("auto:55".parse::<BoardRequest>().unwrap_err().to_string().contains("auto:55mm:r17.5mm"));
    }
}

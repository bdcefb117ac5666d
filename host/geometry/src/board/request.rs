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
    /// Layout, rows and columns are to be recognised: `auto` or `auto:55mm:r17.5mm`.
    Recognise(Option<CircleSize>),
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
            [AUTO] => Ok(Self::Recognise(None)),
            [AUTO, spacing, radius] => {
                let size = CircleSize {
                    spacing: length(spacing).ok_or_else(|| error(BoardProblem::Spacing((*spacing).to_owned())))?,
                    radius: radius_of(radius).ok_or_else(|| error(BoardProblem::Radius((*radius).to_owned())))?,
                };
                Ok(Self::Recognise(Some(size)))
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
            Self::Recognise(None) => f.write_str(AUTO),
            Self::Recognise(Some(CircleSize { spacing, radius })) => {
                write!(f, "{AUTO}:{}mm:r{}mm", millimetres(*spacing), millimetres(*radius))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_are_given_or_recognised() {
        let parse = |text: &str| text.parse::<BoardRequest>().unwrap();
        assert_eq!(parse("auto"), BoardRequest::Recognise(None));
        for text in ["auto", "auto:55mm:r17.5mm", "acircles:9x4:55mm:r17.5mm"] {
            assert_eq!(parse(text).to_string(), text);
        }
        for text in ["auto:55mm", "auto:9x4:55mm:r17.5mm", "auto:55:r17.5mm", "auto:55mm:17.5mm", "automatic"] {
            let message = text.parse::<BoardRequest>().unwrap_err().to_string();
            assert!(message.contains("; write "), "{message}");
        }
        assert!("auto:55mm".parse::<BoardRequest>().unwrap_err().to_string().contains("auto:55mm:r17.5mm"));
    }
}

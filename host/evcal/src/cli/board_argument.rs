//! The value of `--board`: a description of the board, or a target file of Kalibr.

use std::path::Path;

use evcal_files::remedies;
use evcal_geometry::board::request::BoardRequest;
use evcal_geometry::board::squares::kalibr::{CircleTarget, Target, TargetFileError, read};
use evcal_geometry::board::{Board, BoardError};

/// Errors in the value of `--board`.
#[derive(Debug, thiserror::Error)]
pub enum BoardArgumentError {
    /// The description is not valid.
    #[error("{0}")]
    Description(#[from] BoardError),
    /// The file is not a target file of Kalibr.
    #[error("{0}")]
    File(#[from] TargetFileError),
    /// The file describes circles without their radius.
    #[error("{file} does not contain the radius of the circles: measure it, and write --board {target}:rRADIUS")]
    RadiusUnknown {
        /// The file.
        file: String,
        /// The circles without their radius.
        target: CircleTarget,
    },
}

remedies! { BoardArgumentError, say;
    Self::Description(error) => error.remedy(say);
}

/// Parses a description of a board, or reads the target file with the name `text`.
///
/// # Errors
/// [`BoardArgumentError`].
pub fn board(text: &str) -> Result<Board, BoardArgumentError> {
    match board_file(text) {
        Some(board) => board,
        None => Ok(text.parse()?),
    }
}

/// Parses a description, the name of a target file or, unlike [`board`], a request to recognise the board.
///
/// # Errors
/// [`BoardArgumentError`].
pub fn board_request(text: &str) -> Result<BoardRequest, BoardArgumentError> {
    match board_file(text) {
        Some(board) => board.map(BoardRequest::Given),
        None => Ok(text.parse()?),
    }
}

/// Reads the board from the target file with the name `text`; `None` if it is not the name of a YAML file.
fn board_file(text: &str) -> Option<Result<Board, BoardArgumentError>> {
    let path = Path::new(text);
    let is_yaml = path
        .extension()
        .is_some_and(|ending| ending.eq_ignore_ascii_case("yaml") || ending.eq_ignore_ascii_case("yml"));
    is_yaml.then(|| match read(path)? {
        Target::Squares(board) => Ok(Board::Squares(board)),
        Target::Circles(target) => Err(BoardArgumentError::RadiusUnknown { file: text.to_owned(), target }),
    })
}

//! The board as the command line takes it: a description, or a target file of Kalibr.

use std::path::Path;

use evcal_geometry::board::request::BoardRequest;
use evcal_geometry::board::squares::kalibr::{CircleTarget, Target, TargetFileError, read};
use evcal_geometry::board::{Board, BoardError};

/// Why `--board` names no board.
#[derive(Debug, thiserror::Error)]
pub enum BoardArgumentError {
    /// It is no description of one.
    #[error("{0}")]
    Description(#[from] BoardError),
    /// The file is no target of Kalibr's.
    #[error("{0}")]
    File(#[from] TargetFileError),
    /// The file has circles without a radius.
    #[error(
        "{file} does not state how large its circles are: write --board {target}:rRADIUS with the radius of a circle, measured"
    )]
    RadiusUnknown {
        /// The file.
        file: String,
        /// What it states.
        target: CircleTarget,
    },
}

/// The board that `text` describes, or that the target file of this name does, with all its sizes.
///
/// # Errors
/// [`BoardArgumentError`].
pub fn board(text: &str) -> Result<Board, BoardArgumentError> {
    match board_file(text) {
        Some(board) => board,
        None => Ok(text.parse()?),
    }
}

/// The same, or that it is to be recognised.
///
/// # Errors
/// [`BoardArgumentError`].
pub fn board_request(text: &str) -> Result<BoardRequest, BoardArgumentError> {
    match board_file(text) {
        Some(board) => board.map(BoardRequest::Given),
        None => Ok(text.parse()?),
    }
}

/// The board in the target file of this name; `None` if it is no name of one.
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

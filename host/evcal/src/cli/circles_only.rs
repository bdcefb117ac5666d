//! The board of a circle stream, which must consist of circles.

use evcal_geometry::board::{Board, CircleBoard};

/// A board of squares was given for a circle stream.
#[derive(Debug, thiserror::Error)]
#[error("{board}: a circle stream contains circles, not squares")]
pub struct CirclesOnly {
    board: Board,
}

impl evcal_files::remedy::Remedy for CirclesOnly {}

/// Returns the circles of `board`.
///
/// # Errors
/// [`CirclesOnly`] if the board consists of squares.
pub fn circles_of(board: &Board) -> Result<&CircleBoard, CirclesOnly> {
    board.circles().ok_or(CirclesOnly { board: *board })
}

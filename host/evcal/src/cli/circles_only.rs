//! Circle streams, in which there are boards of circles alone.

use evcal_geometry::board::{Board, CircleBoard};

/// A board of squares where there are only circles.
#[derive(Debug, thiserror::Error)]
#[error("{board}: a circle stream holds circles, not squares")]
pub struct CirclesOnly {
    board: Board,
}

/// The circles of `board`.
///
/// # Errors
/// [`CirclesOnly`] where it has none.
pub fn circles_of(board: &Board) -> Result<&CircleBoard, CirclesOnly> {
    board.circles().ok_or(CirclesOnly { board: *board })
}

//! Commands that look for boards of circles alone.

use evcal_geometry::board::{Board, CircleBoard};

/// A board of squares where only circles are looked for.
#[derive(Debug, thiserror::Error)]
#[error("{board}: this command looks for boards of circles; evcal calibrate takes all boards")]
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

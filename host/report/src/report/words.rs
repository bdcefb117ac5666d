//! The names of the parts of a board.

use evcal_geometry::board::Board;

/// What the report calls the parts of a board.
#[derive(Clone, Copy, Debug)]
pub struct Words {
    /// A point whose position is detected.
    pub point: &'static str,
    /// Several of them.
    pub points: &'static str,
    /// A dark part, whose edges trigger events.
    pub part: &'static str,
    /// Several of them.
    pub parts: &'static str,
    /// The size of the parts that the calibration can estimate.
    pub size: &'static str,
}

/// Returns the words for the parts of `board`.
pub fn words(board: &Board) -> Words {
    match board {
        Board::Circles(_) => {
            Words { point: "circle", points: "circles", part: "dot", parts: "dots", size: "radius of the dots" }
        }
        Board::Squares(_) => Words {
            point: "corner",
            points: "corners",
            part: "square",
            parts: "squares",
            size: "half the width of the dark squares",
        },
    }
}

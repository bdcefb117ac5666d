//! A point of a board, found in a picture.

/// A point of a board, found in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FoundPoint {
    /// Index on the board.
    pub index: usize,
    /// Position in the picture.
    pub pixel: [f32; 2],
}

//! Square tags of a board.

/// A square tag on a board.
#[derive(Clone, Debug, PartialEq)]
pub struct Tag {
    /// Its number in its family or dictionary.
    pub id: u16,
    /// Its corners on the board in metres: top left, top right, bottom right, bottom left of the tag in the upright
    /// orientation of its family.
    pub corners: [[f64; 2]; 4],
    /// Modules along each side, with the dark border.
    pub side: usize,
    /// `true` for each light module, row by row from the top left.
    pub light: Vec<bool>,
}

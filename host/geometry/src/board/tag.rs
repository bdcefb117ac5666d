//! Square tags of a board.

use nalgebra::Vector2;

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

impl Tag {
    /// Returns its middle on the board in metres.
    pub fn middle(&self) -> Vector2<f64> {
        self.corners.map(Vector2::from).iter().sum::<Vector2<f64>>() / 4.0
    }
}

//! Printing of boards of squares.

use super::{Printable, Shapes};
use crate::board::squares::SquareBoard;
use crate::board::squares::raster::Rectangle;

impl Printable for SquareBoard {
    fn size(&self) -> [f64; 2] {
        let Rectangle { low, high } = self.bounds();
        [high[0] - low[0], high[1] - low[1]].map(|side| side * 1e3)
    }

    fn shapes(&self, corner: [f64; 2]) -> Shapes {
        let Rectangle { low, .. } = self.bounds();
        let place = |[x, y]: [f64; 2]| [corner[0] + (x - low[0]) * 1e3, corner[1] + (y - low[1]) * 1e3];
        let dark = self.raster().dark_rectangles();
        let rectangles = dark.into_iter().map(|dark| Rectangle::between(place(dark.low), place(dark.high)));
        Shapes { dots: Vec::new(), rectangles: rectangles.collect(), corner }
    }

    fn lengths(&self) -> String {
        let millimetres = |metres: f64| (metres * 1e7).round() / 1e4;
        match self {
            Self::Checkerboard(board) => {
                let (rows, columns) = (board.rows, board.columns);
                format!("Squares {} mm wide, {rows} x {columns} inner corners.", millimetres(board.square))
            }
            Self::Tags(grid) => {
                let gap = millimetres(grid.spacing * grid.tag);
                format!("Tags {} mm wide, {gap} mm between them.", millimetres(grid.tag))
            }
            Self::Charuco(board) => {
                let (square, marker) = (millimetres(board.square), millimetres(board.marker));
                format!("Squares {square} mm wide, markers {marker} mm.")
            }
        }
    }

    fn scaled(&self, spacing: f64) -> Option<Self> {
        let mut board = *self;
        match &mut board {
            Self::Checkerboard(board) => board.square = spacing / 1e3,
            Self::Tags(grid) => grid.tag = spacing / 1e3,
            Self::Charuco(board) => {
                // Round down to tenths of a millimetre.
                board.marker = (spacing * (board.marker / board.square) * 10.0).floor() / 1e4;
                board.square = spacing / 1e3;
                if board.marker <= 0.0 {
                    return None;
                }
            }
        }
        Some(board)
    }
}

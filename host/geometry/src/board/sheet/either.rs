//! Printing of boards of either kind.

use super::{Printable, Shapes};
use crate::board::Board;

impl Printable for Board {
    fn size(&self) -> [f64; 2] {
        match self {
            Self::Circles(board) => board.size(),
            Self::Squares(board) => board.size(),
        }
    }

    fn shapes(&self, corner: [f64; 2]) -> Shapes {
        match self {
            Self::Circles(board) => board.shapes(corner),
            Self::Squares(board) => board.shapes(corner),
        }
    }

    fn lengths(&self) -> String {
        match self {
            Self::Circles(board) => board.lengths(),
            Self::Squares(board) => board.lengths(),
        }
    }

    fn scaled(&self, spacing: f64) -> Option<Self> {
        match self {
            Self::Circles(board) => board.scaled(spacing).map(Self::Circles),
            Self::Squares(board) => board.scaled(spacing).map(Self::Squares),
        }
    }
}

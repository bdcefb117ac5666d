//! The printed board: parsing of its description, positions of its points, and the geometry used by the stages of a
//! calibration.

pub mod circles;
pub mod homography;
pub mod request;
pub mod shape;
pub mod sheet;
pub mod squares;
pub mod symmetry;
pub mod tag;

use std::fmt;
use std::str::FromStr;

use evcal_core::pattern::Pattern;
use evcal_files::remedies;
use nalgebra::Vector2;

pub use self::circles::{BOARD_FORM, BoardProblem, CircleBoard, CircleBoardError, any_length, layout_name};
use self::squares::edges::{Edge, SquareEdges};
use self::squares::names_squares;
pub use self::squares::{SquareBoard, SquareBoardError};

/// Reason why the description of a board was rejected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BoardError {
    /// Error in the description of a board of circles.
    #[error("{0}")]
    Circles(#[from] CircleBoardError),
    /// Error in the description of a board of squares.
    #[error("{0}")]
    Squares(#[from] SquareBoardError),
}

remedies! { BoardError, say;
    Self::Circles(error) => error.remedy(say);
}

/// A printed board. World coordinates: x and y on the board, z = 0; a camera in front of it is at z < 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Board {
    /// Circles; the points are their centres.
    Circles(CircleBoard),
    /// Squares; the points are corners.
    Squares(SquareBoard),
}

impl Board {
    /// Returns the number of points.
    pub fn point_count(&self) -> usize {
        match self {
            Self::Circles(board) => board.circle_count(),
            Self::Squares(board) => board.point_count(),
        }
    }

    /// Returns point `index` on the board plane, in metres.
    pub fn point(&self, index: usize) -> Vector2<f64> {
        match self {
            Self::Circles(board) => board.circle_center(index),
            Self::Squares(board) => board.point(index),
        }
    }

    /// Returns the lattice on which the points lie, row by row.
    pub fn lattice(&self) -> Pattern {
        match self {
            Self::Circles(board) => board.pattern,
            Self::Squares(board) => board.lattice(),
        }
    }

    /// Returns the board of circles, if it is one.
    pub fn circles(&self) -> Option<&CircleBoard> {
        match self {
            Self::Circles(board) => Some(board),
            Self::Squares(_) => None,
        }
    }

    /// Returns the radius of the dot at each point, in metres; 0 for corners.
    pub fn dot_radius(&self) -> f64 {
        self.circles().map_or(0.0, |board| board.radius)
    }

    /// Returns the radius of a circle, or half the side of a square or module (m).
    pub fn print_radius(&self) -> f64 {
        match self {
            Self::Circles(board) => board.radius,
            Self::Squares(board) => 0.5 * board.module(),
        }
    }

    /// Returns the distance from one circle to its nearest neighbour, or from one dark square or module to the next
    /// (m).
    pub fn print_period(&self) -> f64 {
        match self {
            Self::Circles(board) => board.neighbour_distance(),
            Self::Squares(board) => 2.0 * board.module(),
        }
    }

    /// Returns the edges of the print as polylines, in metres: rims of circles, borders between dark and light squares.
    pub fn outlines(&self) -> Vec<Vec<Vector2<f64>>> {
        match self {
            Self::Circles(board) => (0..board.circle_count()).map(|index| board.rim(index)).collect(),
            Self::Squares(board) => SquareEdges::new(&board.raster()).edges().iter().map(Edge::pieces).collect(),
        }
    }

    /// Returns the centre of the area that the points cover, in metres.
    pub fn middle(&self) -> Vector2<f64> {
        let count = self.point_count();
        (0..count).map(|index| self.point(index)).sum::<Vector2<f64>>() / count as f64
    }

    /// Returns the lowest and highest coordinates of the points, in metres.
    pub fn extent(&self) -> (Vector2<f64>, Vector2<f64>) {
        let points = (0..self.point_count()).map(|index| self.point(index));
        points.fold((Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY)), |(low, high), point| {
            (low.inf(&point), high.sup(&point))
        })
    }

    /// Returns the longer side of the area that the points cover, in metres.
    pub fn longer_side(&self) -> f64 {
        let (low, high) = self.extent();
        (high - low).max()
    }
}

impl FromStr for Board {
    type Err = BoardError;

    fn from_str(text: &str) -> Result<Self, BoardError> {
        if names_squares(text) { Ok(Self::Squares(text.parse()?)) } else { Ok(Self::Circles(text.parse()?)) }
    }
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Circles(board) => board.fmt(f),
            Self::Squares(board) => board.fmt(f),
        }
    }
}

impl From<CircleBoard> for Board {
    fn from(board: CircleBoard) -> Self {
        Self::Circles(board)
    }
}

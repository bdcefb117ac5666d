//! The points of a board of squares in pictures of one moment.

use evcal_core::pattern::Pattern;
use evcal_geometry::board::SquareBoard;
use evcal_squares::checkerboard::{NoCheckerboard, find_checkerboard};
use evcal_squares::found_point::FoundPoint;
use evcal_squares::picture::Picture;

use super::no_board::NoBoard;

/// Points found, by rising index.
pub type Points = Vec<FoundPoint>;

/// Finds a board.
pub struct SquareFinder {
    board: SquareBoard,
}

impl SquareFinder {
    /// Finds `board`.
    pub fn new(board: &SquareBoard) -> Self {
        Self { board: *board }
    }

    /// The board in that of `pictures` that shows most of it; `near` are its points a moment before.
    ///
    /// # Errors
    /// Why it is in none of them, from the one that came nearest.
    pub fn find(&self, pictures: &[Picture], near: Option<&Points>) -> Result<Points, NoBoard> {
        let pattern = self.board.lattice();
        let expected = near.map(|points| by_index(points, pattern));
        let mut best: Result<Points, NoBoard> = Err(NoBoard::TooFewCorners);
        for picture in pictures {
            let found = self.find_in(picture, expected.as_deref());
            let is_better = match (&best, &found) {
                (Ok(best), Ok(found)) => found.len() > best.len(),
                (Err(_), _) => true,
                (Ok(_), Err(_)) => false,
            };
            if is_better {
                best = found;
            }
            if best.as_ref().is_ok_and(|points| points.len() == pattern.circle_count()) {
                break;
            }
        }
        best
    }

    fn find_in(&self, picture: &Picture, expected: Option<&[Option<[f32; 2]>]>) -> Result<Points, NoBoard> {
        match &self.board {
            SquareBoard::Checkerboard(board) => {
                find_checkerboard(picture, board.rows, board.columns, expected).map_err(NoBoard::from)
            }
            SquareBoard::Tags(_) | SquareBoard::Charuco(_) => Err(NoBoard::NoTags),
        }
    }
}

fn by_index(points: &Points, pattern: Pattern) -> Vec<Option<[f32; 2]>> {
    let mut places = vec![None; pattern.circle_count()];
    for point in points {
        if let Some(place) = places.get_mut(point.index) {
            *place = Some(point.pixel);
        }
    }
    places
}

impl From<NoCheckerboard> for NoBoard {
    fn from(reason: NoCheckerboard) -> Self {
        match reason {
            NoCheckerboard::TooFewSaddles { .. } | NoCheckerboard::TooFewCorners { .. } => Self::TooFewCorners,
            NoCheckerboard::BesideBoard { .. } => Self::CornersBesideBoard,
            NoCheckerboard::PlaceUncertain { .. } => Self::PlaceUncertain,
            NoCheckerboard::NotAsExpected => Self::NotAsExpected,
            _ => Self::NoCheckerboard,
        }
    }
}

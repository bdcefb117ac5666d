//! From circles to the board: the grid finder and room to work in, for windows, pictures and frames of circles.

use evcal_core::grid::{FoundGrid, GridCandidate, GridError, GridOptions, GridWorkspace, find_grid, find_grid_near};
use evcal_core::pattern::Pattern;
use nalgebra::{RealField, Vector2};

use super::no_board::NoBoard;

/// Circles that the grid finder has room for.
const CANDIDATES: usize = 256;

/// A circle that was found to be one of the board's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlacedCircle {
    /// Index on the board.
    pub index: usize,
    /// Index among the candidates.
    pub candidate: usize,
}

/// Finds a board among circles.
pub struct BoardFinder<T> {
    pattern: Pattern,
    workspace: Box<GridWorkspace<T, CANDIDATES>>,
}

impl<T: RealField + Copy> BoardFinder<T> {
    /// Looks for boards of `pattern`.
    // As with the detector, what the workspace is made in must not be part of the frames of rayon's recursion.
    #[inline(never)]
    pub fn new(pattern: Pattern) -> Self {
        Self { pattern, workspace: Box::new(GridWorkspace::new()) }
    }

    /// The circles of the board, by board index.
    ///
    /// # Errors
    /// [`NoBoard`] when there is none for certain.
    pub fn find(
        &mut self,
        candidates: &[GridCandidate<T>],
        options: &GridOptions,
    ) -> Result<Vec<PlacedCircle>, NoBoard> {
        let found = find_grid(candidates, &self.pattern, options, &mut self.workspace)?;
        Ok(placed(&found))
    }

    /// The same near the pixel where each circle of the board is `expected`.
    ///
    /// # Errors
    /// [`NoBoard`] when there is none for certain.
    pub fn find_near(
        &mut self,
        candidates: &[GridCandidate<T>],
        options: &GridOptions,
        expected: &[Option<Vector2<T>>],
    ) -> Result<Vec<PlacedCircle>, NoBoard> {
        let found = find_grid_near(candidates, &self.pattern, options, expected, &mut self.workspace)?;
        Ok(placed(&found))
    }
}

fn placed<T, const N: usize>(found: &FoundGrid<T, N>) -> Vec<PlacedCircle> {
    let circles = found.circles.iter();
    circles.map(|circle| PlacedCircle { index: circle.board.into(), candidate: circle.candidate.into() }).collect()
}

/// The first `circles`, as far as the grid finder has room for them.
pub fn within_capacity<T>(circles: &[T]) -> &[T] {
    circles.get(..CANDIDATES).unwrap_or(circles)
}

impl From<GridError> for NoBoard {
    fn from(error: GridError) -> Self {
        match error {
            GridError::TooManyCandidates { .. } => Self::TooManyCircles,
            GridError::TooFewCandidates { .. } => Self::TooFewCircles,
            GridError::NoLattice => Self::NoLattice,
            GridError::TooFewCircles { .. } => Self::TooFewOfBoard,
            GridError::NotSmooth => Self::Scattered,
            GridError::WrongBoard { .. } => Self::BesideBoard,
            GridError::AmbiguousPlacement { .. } => Self::PlaceUncertain,
            GridError::NotAsExpected => Self::NotAsExpected,
            _ => Self::Unknown,
        }
    }
}

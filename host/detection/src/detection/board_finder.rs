//! The grid finder with its workspace, for windows, pictures and frames of circles.

use evcal_core::grid::{FoundGrid, GridCandidate, GridError, GridOptions, GridWorkspace, find_grid, find_grid_near};
use evcal_core::pattern::Pattern;
use nalgebra::{RealField, Vector2};

use super::no_board::NoBoard;

/// Largest number of circles that the grid finder accepts.
const CANDIDATES: usize = 256;

/// A circle with its index on the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PlacedCircle {
    /// Index on the board.
    pub index: usize,
    /// Index among the candidates.
    pub candidate: usize,
}

/// Searches circles for a board.
pub struct BoardFinder<T> {
    pattern: Pattern,
    workspace: Box<GridWorkspace<T, CANDIDATES>>,
}

impl<T: RealField + Copy> BoardFinder<T> {
    /// Creates a finder of boards of `pattern`.
    // As with the detector, the construction of the workspace must not be part of the frames of rayon's recursion.
    #[inline(never)]
    pub fn new(pattern: Pattern) -> Self {
        Self { pattern, workspace: Box::new(GridWorkspace::new()) }
    }

    /// Returns the circles of the board, by board index.
    ///
    /// # Errors
    /// [`NoBoard`] if there is no certain board.
    pub fn find(
        &mut self,
        candidates: &[GridCandidate<T>],
        options: &GridOptions,
    ) -> Result<Vec<PlacedCircle>, NoBoard> {
        let found = find_grid(candidates, &self.pattern, options, &mut self.workspace)?;
        Ok(placed(&found))
    }

    /// Returns the circles of the board like [`find`](Self::find), at the position nearest to the `expected` pixels of
    /// the board's circles.
    ///
    /// # Errors
    /// [`NoBoard`] if there is no certain board.
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

/// Returns the first `circles`, up to the capacity of the grid finder.
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
            GridError::WrongBoard { .. } => Self::LargerThanBoard,
            GridError::AmbiguousPlacement { .. } => Self::PlaceUncertain,
            GridError::NotAsExpected => Self::NotAsExpected,
            _ => Self::Unknown,
        }
    }
}

//! Finds the ordered board among the circle candidates of one window.
//!
//! [`find_grid`] finds a [`Pattern`] among candidate centres. It needs no camera model because it follows the lattice
//! from neighbour to neighbour. The board may therefore be bent by perspective and lens distortion, false candidates
//! may lie among the dots, and dots may be missing.
//!
//! 1. Seeds: points midway between two pairs of opposite neighbours.
//! 2. Growth from a seed outwards; the position of each site is predicted from its placed neighbours.
//! 3. Settling: a homography behind a lens (of unknown distortion) is fitted to the lattice. Every candidate is
//!    compared with a map fitted without it, and keeps, takes or loses its site.
//! 4. Placement: the shift and rotation that put the lattice onto the board, if it is likelier than any other by
//!    [`GridOptions::minimum_odds`].
//!
//! Guarantees for every returned board:
//! - The map from board to image keeps its sense of rotation (x to the right, y down in both), so the order is never
//!   mirrored. An asymmetric board with an even number of rows differs from its mirror image, so a mirrored picture of
//!   it is rejected. All other boards equal their mirror image: a mirrored picture of such a board is also a valid
//!   picture from another viewpoint, and points alone cannot distinguish the two.
//! - The lattice is square in space for some focal length: sheared orders are rejected.
//! - Any other placement (shifted or rotated) explains far fewer candidates and is unlikely. Complete boards
//!   are therefore certain. A board without its outer circles is rejected if it might be shifted
//!   ([`GridError::AmbiguousPlacement`]). Earlier windows can determine the position of such a board:
//!   [`find_grid_near`].
//! - A board that a rotation by 180° or 90° maps onto itself (all symmetric boards, and asymmetric ones with an even
//!   number of rows) is reported as [`Ordering::Ambiguous`]. The first circle of the returned order lies nearest to the
//!   top left. [`reorder`] returns the other orders.
//! - No candidate has two board indices, and no board index two candidates. If two candidates compete for one circle,
//!   neither is taken. A candidate that lies within the scatter of a missing circle's position is taken for that
//!   circle.
//!
//! Known limitation: a board with one row or column less than the pattern is taken for a partial view of it.
//!
//! No heap, no panics, no randomness: the order of the candidates does not affect the result.

mod evidence;
mod expectation;
mod fit;
mod lattice;
mod placement;
mod points;
mod search;
mod seed;
mod select;
mod settle;
mod warp;

use heapless::Vec;
use nalgebra::{RealField, Vector2};

use crate::pattern::{Layout, Pattern};
use lattice::Lattice;
use points::Points;
use search::Choice;
use settle::Settling;

/// A detected circle that may belong to the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridCandidate<T> {
    /// Centre in pixels.
    pub center: Vector2<T>,
    /// Radius in pixels, 0 if unknown. Known radii of two neighbours must differ by less than a factor of two.
    pub radius: T,
}

/// Criteria for accepting a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridOptions {
    /// Width and height of the image in pixels; the centre of lens distortion is assumed near the middle.
    pub image_size: (f64, f64),
    /// Smallest number of circles of an accepted board.
    pub minimum_circles: usize,
    /// Smallest likelihood ratio of the best placement to any other placement.
    pub minimum_odds: f64,
    /// Largest number of points that continue the lattice outside the board. More points indicate another board.
    pub maximum_outside: usize,
    /// Largest scatter of the circles about a smooth lattice, as a fraction of the distance of neighbours.
    pub maximum_scatter: f64,
    /// `true` if circles are missed independently of each other, as in a picture of a board at rest. Then a whole row
    /// that is missing within the image means that the board ends there. In events it does not, because the detector
    /// misses a whole row if the row moves along itself.
    pub independent_misses: bool,
}

impl GridOptions {
    /// Returns the options for a pattern and an image size (width, height) in pixels: at least 40 % of the circles and
    /// at least 12 (with fewer, random clutter can form a board), odds of 5000.
    pub const fn new(pattern: &Pattern, image_size: (f64, f64)) -> Self {
        let count = pattern.circle_count();
        let part = (count * 2).div_ceil(5);
        let enough = if part < 12 { 12 } else { part };
        let rows = match pattern.layout {
            Layout::Asymmetric => pattern.rows / 2,
            Layout::Symmetric => pattern.rows,
        } as usize;
        let columns = pattern.columns as usize;
        let side = if rows < columns { rows } else { columns };
        Self {
            image_size,
            minimum_circles: if enough < count { enough } else { count },
            minimum_odds: 5000.0,
            maximum_outside: (if side < 2 { 2 } else { side }) - 1,
            maximum_scatter: 0.1,
            independent_misses: false,
        }
    }
}

/// A circle of the board and its candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridCircle {
    /// Index on the board, row by row ([`Pattern::lattice_position`]).
    pub board: u16,
    /// Index in the slice of candidates.
    pub candidate: u16,
}

/// Uniqueness of the order of a found board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ordering {
    /// There is one order.
    Unique,
    /// The board looks the same after a rotation: this many orders are equally valid (2: rotations by 180°; 4: by 90°).
    /// In the returned order the first circle is nearest to the top left of the image.
    Ambiguous(u8),
}

/// A board found among the candidates.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundGrid<T, const N: usize> {
    /// The circles found, by rising board index.
    pub circles: Vec<GridCircle, N>,
    /// Uniqueness of the order.
    pub ordering: Ordering,
    /// Scatter of the circles about a smooth lattice: standard deviation in pixels along one axis.
    pub scatter: T,
}

/// Reason why no board was found, taken from the attempt that got furthest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum GridError {
    /// More candidates than the workspace can store.
    TooManyCandidates {
        /// Number of candidates given.
        count: usize,
        /// Number of candidates that fit.
        capacity: usize,
    },
    /// Fewer usable candidates (finite, no duplicates) than circles needed.
    TooFewCandidates {
        /// Number of usable candidates.
        usable: usize,
        /// Number of circles needed.
        needed: usize,
    },
    /// No part of the candidates looks like a lattice.
    NoLattice,
    /// The largest lattice, or its part on the board, has too few circles.
    TooFewCircles {
        /// Number of circles found.
        found: usize,
        /// Number of circles needed.
        needed: usize,
    },
    /// The circles scatter too much about a smooth lattice.
    NotSmooth,
    /// The lattice continues outside the board: it belongs to another board, or to no board.
    WrongBoard {
        /// Number of lattice points outside the board.
        outside: usize,
    },
    /// Several placements on the board explain (nearly) the same number of circles.
    AmbiguousPlacement {
        /// Circles explained by the best placement.
        best: usize,
        /// Circles explained by the second best placement.
        runner_up: usize,
    },
    /// No placement is near the expected one.
    NotAsExpected,
}

impl GridError {
    /// Returns `true` if a lattice was found and only its position on the board is in question.
    const fn is_of_placement(&self) -> bool {
        matches!(self, Self::WrongBoard { .. } | Self::AmbiguousPlacement { .. } | Self::NotAsExpected)
    }
}

impl core::fmt::Display for GridError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooManyCandidates { count, capacity } => {
                write!(
                    f,
                    "{count} circle candidates exceed the capacity of {capacity}: use stricter limits for circles"
                )
            }
            Self::TooFewCandidates { usable, needed } => {
                write!(f, "{usable} circle candidates found, the board needs {needed}")
            }
            Self::NoLattice => write!(f, "the circle candidates do not form a lattice"),
            Self::TooFewCircles { found, needed } => write!(f, "{found} circles of the board found, {needed} needed"),
            Self::NotSmooth => write!(f, "the circle candidates scatter too much to be a board"),
            Self::WrongBoard { outside } => {
                write!(f, "{outside} circles outside the board: check the size of the board")
            }
            Self::AmbiguousPlacement { best, runner_up } => {
                write!(
                    f,
                    "the position of the board is ambiguous: {best} circles fit the best position, {runner_up} the next"
                )
            }
            Self::NotAsExpected => {
                write!(f, "the circles form a lattice, but not at the expected position of the board")
            }
        }
    }
}

impl core::error::Error for GridError {}

/// Storage of [`find_grid`] for up to `N` candidates.
#[derive(Clone, Debug)]
pub struct GridWorkspace<T, const N: usize> {
    points: Points<T, N>,
    lattice: Lattice<N>,
    settling: Settling<T, N>,
}

impl<T: RealField + Copy, const N: usize> GridWorkspace<T, N> {
    /// Creates an empty workspace.
    pub const fn new() -> Self {
        Self { points: Points::new(), lattice: Lattice::new(), settling: Settling::new() }
    }
}

impl<T: RealField + Copy, const N: usize> Default for GridWorkspace<T, N> {
    fn default() -> Self {
        Self::new()
    }
}

/// Finds the board among the candidates.
///
/// # Errors
/// Returns a [`GridError`] if no board was found. When in doubt, a board is rejected, because a wrong board is worse
/// than none.
pub fn find_grid<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    pattern: &Pattern,
    options: &GridOptions,
    workspace: &mut GridWorkspace<T, N>,
) -> Result<FoundGrid<T, N>, GridError> {
    search::search(candidates, pattern, options, &Choice::MostLikely, workspace)
}

/// Finds the board near its expected position, for example as predicted from earlier windows.
///
/// `expected` contains the expected pixel of each circle of the board, by board index; `None` if it is unknown. The
/// position and orientation of the board on the lattice then do not depend on likelihood: the placement nearest to the
/// expected one is taken if it is nearer than a third of the spacing (root mean square). Boards that are cut by the
/// border of the image, or that a rotation maps onto themselves, therefore keep their order from window to window. The
/// result is [`Ordering::Unique`].
///
/// # Errors
/// [`GridError::NotAsExpected`] if no placement is near, otherwise as [`find_grid`].
pub fn find_grid_near<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    pattern: &Pattern,
    options: &GridOptions,
    expected: &[Option<Vector2<T>>],
    workspace: &mut GridWorkspace<T, N>,
) -> Result<FoundGrid<T, N>, GridError> {
    search::search(candidates, pattern, options, &Choice::Nearest(expected), workspace)
}

/// A candidate on a lattice site.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LatticeSite {
    /// Steps along the first direction of the lattice.
    pub u: i8,
    /// Steps along the second direction. The rotation from the first to the second direction has the same sense as from
    /// x to y.
    pub v: i8,
    /// Index in the slice of candidates.
    pub candidate: u16,
}

/// Finds the largest lattice of at least [`GridOptions::minimum_circles`] candidates. The caller determines the
/// position of the lattice on a board, because it may know more about the candidates than their positions.
///
/// # Errors
/// Returns a [`GridError`] if there is no such lattice.
pub fn find_lattice<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    options: &GridOptions,
    workspace: &mut GridWorkspace<T, N>,
) -> Result<Vec<LatticeSite, N>, GridError> {
    search::search_lattice(candidates, options, workspace)
}

/// Returns the number of rotations that map the board onto itself: 4 for a square symmetric board, 2 for other
/// symmetric boards and for asymmetric ones with an even number of rows, otherwise 1.
pub fn symmetry(pattern: &Pattern) -> usize {
    placement::turns_of(pattern)
}

/// Returns the index of circle `board` after the board was rotated `turn` times by 180° ([`symmetry`] 2) or 90° (4).
/// `None` if there is no such circle.
pub fn reorder(pattern: &Pattern, board: usize, turn: usize) -> Option<usize> {
    let turns = placement::turns_of(pattern);
    let (width, height) = placement::extent_of(pattern);
    if board >= pattern.circle_count() {
        return None;
    }
    let (mut x, mut y) = pattern.lattice_position(board);
    for _ in 0..turn % turns.max(1) {
        (x, y) = if turns == 4 { (width - y, x) } else { (width - x, height - y) };
    }
    pattern.index_at(x, y)
}

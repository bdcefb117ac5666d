//! Circle candidates of one window → the ordered board.
//!
//! [`find_grid`] finds a [`Pattern`] among candidate centres. It needs no camera model: it follows
//! the lattice from neighbour to neighbour, so that perspective and lens distortion may bend the
//! board, candidates that are no circles may lie among the dots, and dots may be missing.
//!
//! 1. Seeds: points midway between two pairs of opposite neighbours.
//! 2. Growth: from a seed outward, each site predicted by its placed neighbours.
//! 3. Settling: a homography behind a lens (of unknown distortion) is fitted to the lattice; every
//!    candidate is judged by the map without it and keeps, takes or loses its site.
//! 4. Placement: the shift and turn that put the lattice onto the board, if it is likelier than any
//!    other by [`GridOptions::minimum_odds`].
//!
//! What holds of every returned board:
//! - The map from board to image keeps its sense of rotation (x to the right, y down in both): no
//!   mirrored order is returned. An asymmetric board with an even number of rows is not its own
//!   mirror image, so a mirrored picture of it is refused. All others are: a mirrored picture of
//!   such a board is a true picture of it from elsewhere, and points alone cannot tell.
//! - The lattice is square in space for some focal length: a sheared order is none.
//! - Any other placement (shifted, turned) explains fewer candidates, by enough to be unlikely. So
//!   complete boards are certain; one whose outer circles are missing is refused as soon as it might
//!   be shifted ([`GridError::AmbiguousPlacement`]). Where such a board lies, the windows before can
//!   tell: [`find_grid_near`].
//! - A board that a half or a quarter turn maps onto itself (all symmetric ones, asymmetric ones
//!   with an even number of rows) is reported as [`Ordering::Ambiguous`]; the order returned is the
//!   one whose first circle lies nearest to the top left. [`reorder`] gives the others.
//! - No candidate has two board indices, no board index two candidates. Where two candidates
//!   compete for one circle, neither is taken. A candidate within the scatter of where a missing
//!   circle would be is taken for it.
//!
//! What cannot be told: a board with one row or column less than the pattern is a partial view of it.
//!
//! No heap, no panics, no randomness: the same candidates in any order give the same circles.

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

/// A detected circle that may be one of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridCandidate<T> {
    /// Centre in pixels.
    pub center: Vector2<T>,
    /// Radius in pixels, 0 when unknown. Where two neighbours' radii are known they must not differ
    /// by a factor of two or more.
    pub radius: T,
}

/// Which boards to accept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridOptions {
    /// Width and height of the image in pixels: lens distortion is centred near its middle.
    pub image_size: (f64, f64),
    /// Fewest circles of a board that is accepted.
    pub minimum_circles: usize,
    /// How many times likelier than any other a placement on the board must be.
    pub minimum_odds: f64,
    /// Most points that continue the lattice beside the board. More mean that it is another board.
    pub maximum_outside: usize,
    /// Largest scatter of the circles about a smooth lattice, in parts of the distance of
    /// neighbours.
    pub maximum_scatter: f64,
}

impl GridOptions {
    /// Options for a pattern and the image's width and height in pixels: at least 40 % of the circles
    /// and no fewer than 12 (below, chance makes boards of clutter), odds of 5000.
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
        }
    }
}

/// One circle of the board and its candidate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GridCircle {
    /// Index on the board, row by row ([`Pattern::lattice_position`]).
    pub board: u16,
    /// Index in the slice of candidates.
    pub candidate: u16,
}

/// Whether the order of a found board is the only one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ordering {
    /// There is one order.
    Unique,
    /// The board looks the same after a turn: this many orders are equally right (2: half turn;
    /// 4: quarter turns). The one returned has its first circle nearest to the top left of the
    /// image.
    Ambiguous(u8),
}

/// A board found among the candidates.
#[derive(Clone, Debug, PartialEq)]
pub struct FoundGrid<T, const N: usize> {
    /// The circles found, by rising board index.
    pub circles: Vec<GridCircle, N>,
    /// Whether other orders are equally right.
    pub ordering: Ordering,
    /// Scatter of the circles about a smooth lattice: a standard deviation in pixels, along one axis.
    pub scatter: T,
}

/// Why no board was found. The reason given is that of the attempt that went furthest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[non_exhaustive]
pub enum GridError {
    /// There are more candidates than the workspace holds.
    TooManyCandidates {
        /// Number of candidates given.
        count: usize,
        /// Number of candidates that fit.
        capacity: usize,
    },
    /// The usable candidates (finite, not twice the same) are fewer than the circles needed.
    TooFewCandidates {
        /// Number of usable candidates.
        usable: usize,
        /// Number of circles needed.
        needed: usize,
    },
    /// Nowhere do the candidates look like a lattice.
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
    /// The lattice goes on beside the board: another board, or not a board.
    WrongBoard {
        /// Number of lattice points beside the board.
        outside: usize,
    },
    /// Several placements on the board explain (nearly) as many circles.
    AmbiguousPlacement {
        /// Circles explained by the best placement.
        best: usize,
        /// Circles explained by the next best.
        runner_up: usize,
    },
    /// No placement is near the expected one.
    NotAsExpected,
}

impl GridError {
    /// Whether there is a lattice, and only its place on the board is in question.
    const fn is_of_placement(&self) -> bool {
        matches!(self, Self::WrongBoard { .. } | Self::AmbiguousPlacement { .. } | Self::NotAsExpected)
    }
}

impl core::fmt::Display for GridError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::TooManyCandidates { count, capacity } => {
                write!(f, "{count} circle candidates, room for {capacity}: narrow the circle tests")
            }
            Self::TooFewCandidates { usable, needed } => {
                write!(f, "{usable} circle candidates, the board needs {needed}")
            }
            Self::NoLattice => write!(f, "the circle candidates form no lattice"),
            Self::TooFewCircles { found, needed } => write!(f, "{found} circles of the board found, {needed} needed"),
            Self::NotSmooth => write!(f, "the circle candidates scatter too much to be a board"),
            Self::WrongBoard { outside } => {
                write!(f, "{outside} circles beside the board: is the size of the board right?")
            }
            Self::AmbiguousPlacement { best, runner_up } => {
                write!(f, "the board could lie in two places: {best} or {runner_up} circles agree")
            }
            Self::NotAsExpected => write!(f, "the circles form a lattice, but not where the board is expected"),
        }
    }
}

impl core::error::Error for GridError {}

/// Storage of [`find_grid`] for up to N candidates.
#[derive(Clone, Debug)]
pub struct GridWorkspace<T, const N: usize> {
    points: Points<T, N>,
    lattice: Lattice<N>,
    settling: Settling<T, N>,
}

impl<T: RealField + Copy, const N: usize> GridWorkspace<T, N> {
    /// An empty workspace.
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
/// [`GridError`] says why there is none. A wrong board is worse than none: when in doubt, it is
/// refused.
pub fn find_grid<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    pattern: &Pattern,
    options: &GridOptions,
    workspace: &mut GridWorkspace<T, N>,
) -> Result<FoundGrid<T, N>, GridError> {
    search::search(candidates, pattern, options, &Choice::MostLikely, workspace)
}

/// Finds the board where it is expected, as by its motion in the windows before.
///
/// `expected` holds the pixel where each circle of the board is expected, by board index; `None`
/// where nothing is known. Where the board lies on the lattice that the candidates form, and which way
/// round, is then no question of likelihood: it is the placement nearest to what is expected, if that is nearer
/// than a third of the spacing (root mean square). So boards that the border of the image cuts, or that a
/// turn maps onto themselves, keep their order from window to window; the result is
/// [`Ordering::Unique`].
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

/// A candidate at its place on a lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LatticeSite {
    /// Steps along the first direction of the lattice.
    pub u: i8,
    /// Steps along the second direction. The turn from the first to it is that from x to y.
    pub v: i8,
    /// Index in the slice of candidates.
    pub candidate: u16,
}

/// Finds the largest lattice of at least [`GridOptions::minimum_circles`] candidates. Its place on a board is left to the caller,
/// who may know more than positions.
///
/// # Errors
/// [`GridError`] says why there is none.
pub fn find_lattice<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    options: &GridOptions,
    workspace: &mut GridWorkspace<T, N>,
) -> Result<Vec<LatticeSite, N>, GridError> {
    search::search_lattice(candidates, options, workspace)
}

/// Number of turns that map the board onto itself: 4 for a square symmetric board, 2 for the other
/// symmetric ones and for asymmetric ones with an even number of rows, else 1.
pub fn symmetry(pattern: &Pattern) -> usize {
    placement::turns_of(pattern)
}

/// The index that circle `board` has after the board was turned `turn` times by a half turn
/// ([`symmetry`] 2) or a quarter turn (4). None if there is no such circle.
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

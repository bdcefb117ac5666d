//! Circle candidates of one window → the ordered board.
//!
//! [`find_grid`] finds a [`Pattern`] among candidate centres. It needs no camera model: it follows
//! the lattice from neighbour to neighbour, so that perspective and lens distortion may bend the
//! board, candidates that are no circles may lie among the dots, and dots may be missing.
//!
//! 1. Seeds: points midway between two pairs of opposite neighbours.
//! 2. Growth: from a seed outward, each site predicted by its placed neighbours.
//! 3. Reconciliation: every site is predicted by a smooth local surface through its neighbours; the
//!    points that fit it within the scatter of the lattice keep or take their place.
//! 4. Placement: the shift and turn of the lattice that puts most points on circles of the board.
//!
//! What holds of every returned board:
//! - The map from board to image keeps its sense of rotation (x to the right, y down in both): no
//!   mirrored order is returned. An asymmetric board with an even number of rows is not its own
//!   mirror image, so a mirrored picture of it is refused. All others are: a mirrored picture of
//!   such a board is a true picture of it from elsewhere, and points alone cannot tell.
//! - Every other placement (shifted, turned) explains at least [`GridOptions::placement_margin`]
//!   fewer points, or one fewer if no candidate is left over. So a board that is cut by the border of the
//!   image such that it might be shifted is refused ([`GridError::AmbiguousPlacement`]).
//! - A board that a half or a quarter turn maps onto itself (all symmetric ones, asymmetric ones
//!   with an even number of rows) is reported as [`Ordering::Ambiguous`]; the order returned is the
//!   one whose first circle lies nearest to the top left. [`reorder`] gives the others.
//! - No candidate has two board indices, no board index two candidates. Where two candidates
//!   compete for one circle, neither is taken.
//!
//! No heap, no panics, no randomness: the same candidates in any order give the same circles.

mod evidence;
mod lattice;
mod placement;
mod points;
mod seed;
mod select;
mod settle;
mod warp;

use heapless::Vec;
use nalgebra::{RealField, Vector2};

use crate::pattern::{Layout, Pattern};
use lattice::Lattice;
use placement::Placement;
use points::Points;
use seed::Kind;
use settle::Settling;
use warp::{LatticeImage, Warp};

/// A detected circle that may be one of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridCandidate<T> {
    /// Centre in pixels.
    pub center: Vector2<T>,
    /// Radius in pixels, 0 when unknown. Where two neighbours' radii are known they must not differ
    /// by a factor of two or more.
    pub radius: T,
}

/// What to do with a board that reaches beyond the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CutBoards {
    /// It is placed only if the circles seen leave no other place.
    Refuse,
    /// It may be placed by what is missing: its absent circles lie beyond the border of the image,
    /// those of other placements would be visible. For boards that are known to be there: a smaller
    /// board at the border of the image looks the same.
    Accept,
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
    /// What to do with a board that reaches beyond the image.
    pub cut_boards: CutBoards,
    /// Most points that continue the lattice beside the board. More mean that it is another board.
    pub maximum_outside: usize,
    /// Largest scatter of the circles about a smooth lattice, in parts of the distance of
    /// neighbours.
    pub maximum_scatter: f64,
}

impl GridOptions {
    /// Options for a pattern: at least 40 % of its circles and no fewer than 12 (below, chance makes
    /// boards of clutter), a margin of 2.
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
            minimum_odds: 400.0,
            cut_boards: CutBoards::Refuse,
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
}

impl GridError {
    /// Whether there is a lattice, and only its place on the board is in question.
    const fn is_of_placement(&self) -> bool {
        matches!(self, Self::WrongBoard { .. } | Self::AmbiguousPlacement { .. })
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

/// Growth accepts a point within this part of the spacing, first strictly, then generously.
const GROWTH_TOLERANCES: [f64; 2] = [0.18, 0.3];
/// A board is good enough to stop the search with if it has this many tenths of its circles.
const ENOUGH_TENTHS: usize = 9;
/// Most lattices that are grown, settled and refused.
const ATTEMPTS: usize = 10;

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
    let points = &mut workspace.points;
    let needed = options.minimum_circles;
    if candidates.len() < needed {
        return Err(GridError::TooFewCandidates { usable: candidates.len(), needed });
    }
    if !points.load(candidates) {
        return Err(GridError::TooManyCandidates { count: candidates.len(), capacity: N });
    }
    if points.len() < needed {
        return Err(GridError::TooFewCandidates { usable: points.len(), needed });
    }
    points.find_neighbours();

    let mut failure = GridError::NoLattice;
    for kind in [Kind::Cross, Kind::Border] {
        match search(pattern, options, workspace, kind) {
            Ok(found) => return Ok(found),
            Err(reason) => failure = failure.max(reason),
        }
        if failure.is_of_placement() {
            break;
        }
    }
    Err(failure)
}

/// Grows a lattice from one seed after the other, until one is a board that is complete enough.
fn search<T: RealField + Copy, const N: usize>(
    pattern: &Pattern,
    options: &GridOptions,
    workspace: &mut GridWorkspace<T, N>,
    kind: Kind,
) -> Result<FoundGrid<T, N>, GridError> {
    let GridWorkspace { points, lattice, settling } = workspace;
    let needed = options.minimum_circles;
    let mut best: Option<FoundGrid<T, N>> = None;
    let mut failure = GridError::NoLattice;
    let mut attempts = 0;
    let mut used = [false; N];
    for seed in &seed::find_seeds(points, kind) {
        if used.get(usize::from(seed.center)).copied().unwrap_or(true) {
            continue;
        }
        seed.plant(lattice);
        for tolerance in GROWTH_TOLERANCES {
            lattice.grow(points, nalgebra::convert(tolerance));
        }
        // Settling adds the sites beyond holes, but they are few.
        if lattice.len() * 2 < needed {
            failure = failure.max(GridError::TooFewCircles { found: lattice.len(), needed });
            continue;
        }
        let grown = lattice.len();
        let settled = settling.settle(lattice, points, options);
        let found = match judge(lattice, points, pattern, options, settled) {
            Ok(found) => found,
            Err(reason) => {
                failure = failure.max(reason);
                attempts += 1;
                if attempts == ATTEMPTS {
                    break;
                }
                // A lattice that lost many of its points while settling is not the last word.
                if reason.is_of_placement() && lattice.len() * 10 >= grown * ENOUGH_TENTHS {
                    mark(&mut used, lattice);
                }
                continue;
            }
        };
        if found.circles.len() * 10 >= pattern.circle_count() * ENOUGH_TENTHS {
            return Ok(found);
        }
        mark(&mut used, lattice);
        if best.as_ref().is_none_or(|best| found.circles.len() > best.circles.len()) {
            best = Some(found);
        }
    }
    best.ok_or(failure)
}

/// Marks the points of a lattice: a seed among them would only grow the same lattice again.
fn mark<const N: usize>(used: &mut [bool; N], lattice: &Lattice<N>) {
    for site in lattice.sites() {
        if let Some(used) = used.get_mut(usize::from(site.point)) {
            *used = true;
        }
    }
}

/// Places a lattice on the board and decides whether to accept it.
fn judge<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    pattern: &Pattern,
    options: &GridOptions,
    settled: Option<(Warp<T>, T)>,
) -> Result<FoundGrid<T, N>, GridError> {
    let needed = options.minimum_circles;
    let too_few = |found| GridError::TooFewCircles { found, needed };
    let (Some((warp, scatter)), true) = (settled, lattice.len() >= needed) else { return Err(too_few(lattice.len())) };
    let Some(image) = LatticeImage::new(&warp) else { return Err(too_few(0)) };
    let placement = evidence::decide(lattice, points, &image, scatter, pattern, options)?;
    let outside = lattice.len().saturating_sub(placement.inside);
    if outside > options.maximum_outside {
        return Err(GridError::WrongBoard { outside });
    }
    let placement = placement::turned_to_top_left(placement, &image, pattern);
    let ordering = match placement::turns_of(pattern) {
        1 => Ordering::Unique,
        turns => Ordering::Ambiguous(turns as u8),
    };
    Ok(FoundGrid { circles: circles(lattice, points, pattern, &placement), ordering, scatter })
}

fn circles<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    pattern: &Pattern,
    placement: &Placement,
) -> Vec<GridCircle, N> {
    let mut circles: Vec<GridCircle, N> = Vec::new();
    for site in lattice.sites() {
        let Some(board) = placement.circle(pattern, site.u, site.v).and_then(|index| u16::try_from(index).ok()) else {
            continue;
        };
        let Some(point) = points.get(site.point) else { continue };
        let mut carried = GridCircle { board, candidate: point.candidate };
        for known in circles.iter_mut() {
            if carried.board < known.board {
                core::mem::swap(&mut carried, known);
            }
        }
        if circles.push(carried).is_err() {
            break;
        }
    }
    circles
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

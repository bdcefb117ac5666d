//! Search for the board: grows lattices from one seed after another until one of them is the board.

use heapless::Vec;
use nalgebra::{RealField, Vector2};

use super::lattice::{Lattice, Site};
use super::placement::{Placement, turned_to_top_left, turns_of};
use super::points::Points;
use super::seed::{Kind, find_seeds};
use super::settle::Settled;
use super::warp::LatticeImage;
use super::{FoundGrid, GridCandidate, GridCircle, GridError, GridOptions, GridWorkspace, LatticeSite, Ordering};
use super::{evidence, expectation};
use crate::pattern::Pattern;

/// Largest distance of a point from its predicted position during growth, as a fraction of the spacing: first strict,
/// then generous.
const GROWTH_TOLERANCES: [f64; 2] = [0.18, 0.3];
/// The search stops at a board with this many tenths of its circles.
const ENOUGH_TENTHS: usize = 9;
/// Largest number of lattices that are grown, settled and rejected.
const ATTEMPTS: usize = 10;

/// Criterion for choosing a placement.
pub(super) enum Choice<'a, T> {
    /// The most likely placement, by explained points and missed circles.
    MostLikely,
    /// The placement nearest to the expected pixels of the board's circles.
    Nearest(&'a [Option<Vector2<T>>]),
}

/// Finds the board among the candidates.
pub(super) fn search<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    pattern: &Pattern,
    options: &GridOptions,
    choice: &Choice<T>,
    workspace: &mut GridWorkspace<T, N>,
) -> Result<FoundGrid<T, N>, GridError> {
    load(candidates, options, &mut workspace.points)?;
    let mut failure = GridError::NoLattice;
    for kind in [Kind::Cross, Kind::Border] {
        match search_from(pattern, options, choice, workspace, kind) {
            Ok(found) => return Ok(found),
            Err(reason) => failure = failure.max(reason),
        }
        if failure.is_of_placement() {
            break;
        }
    }
    Err(failure)
}

fn load<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    options: &GridOptions,
    points: &mut Points<T, N>,
) -> Result<(), GridError> {
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
    Ok(())
}

/// Finds the largest lattice among the candidates.
pub(super) fn search_lattice<T: RealField + Copy, const N: usize>(
    candidates: &[GridCandidate<T>],
    options: &GridOptions,
    workspace: &mut GridWorkspace<T, N>,
) -> Result<Vec<LatticeSite, N>, GridError> {
    let GridWorkspace { points, lattice, settling } = workspace;
    load(candidates, options, points)?;
    let needed = options.minimum_circles;
    let mut best: Vec<LatticeSite, N> = Vec::new();
    let mut used = [false; N];
    for seed in &find_seeds(points, Kind::Cross) {
        if used.get(usize::from(seed.center)).copied().unwrap_or(true) {
            continue;
        }
        seed.plant(lattice);
        for tolerance in GROWTH_TOLERANCES {
            lattice.grow(points, nalgebra::convert(tolerance));
        }
        let settled = lattice.len() * 2 >= needed && settling.settle(lattice, points, options).is_some();
        mark(&mut used, lattice);
        if settled && lattice.len() > best.len() {
            best.clear();
            for &Site { u, v, point } in lattice.sites() {
                let Some(candidate) = points.get(point).map(|point| point.candidate) else { continue };
                // The capacity equals the number of sites.
                let _ = best.push(LatticeSite { u, v, candidate });
            }
        }
    }
    match best.len() {
        0 => Err(GridError::NoLattice),
        found if found < needed => Err(GridError::TooFewCircles { found, needed }),
        _ => Ok(best),
    }
}

/// Grows a lattice from one seed after another, until one is a sufficiently complete board.
fn search_from<T: RealField + Copy, const N: usize>(
    pattern: &Pattern,
    options: &GridOptions,
    choice: &Choice<T>,
    workspace: &mut GridWorkspace<T, N>,
    kind: Kind,
) -> Result<FoundGrid<T, N>, GridError> {
    let GridWorkspace { points, lattice, settling } = workspace;
    let needed = options.minimum_circles;
    let mut best: Option<FoundGrid<T, N>> = None;
    let mut failure = GridError::NoLattice;
    let mut attempts = 0;
    let mut used = [false; N];
    for seed in &find_seeds(points, kind) {
        if used.get(usize::from(seed.center)).copied().unwrap_or(true) {
            continue;
        }
        seed.plant(lattice);
        for tolerance in GROWTH_TOLERANCES {
            lattice.grow(points, nalgebra::convert(tolerance));
        }
        // Settling adds the sites beyond holes, but only a few.
        if lattice.len() * 2 < needed {
            failure = failure.max(GridError::TooFewCircles { found: lattice.len(), needed });
            continue;
        }
        let grown = lattice.len();
        let settled = settling.settle(lattice, points, options);
        let found = match judge(lattice, points, pattern, options, choice, settled) {
            Ok(found) => found,
            Err(reason) => {
                failure = failure.max(reason);
                attempts += 1;
                if attempts == ATTEMPTS {
                    break;
                }
                // If a lattice lost many of its points during settling, its points may start another lattice.
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

/// Marks the points of a lattice as used, because a seed among them would only grow the same lattice again.
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
    choice: &Choice<T>,
    settled: Option<Settled<T>>,
) -> Result<FoundGrid<T, N>, GridError> {
    let needed = options.minimum_circles;
    let too_few = |found| GridError::TooFewCircles { found, needed };
    let enough = settled.filter(|_| lattice.len() >= needed);
    let Some(Settled { warp, scatter }) = enough else { return Err(too_few(lattice.len())) };
    let Some(image) = LatticeImage::new(&warp) else { return Err(too_few(0)) };
    let placement = match choice {
        Choice::MostLikely => evidence::decide(lattice, points, &image, scatter, pattern, options)?,
        Choice::Nearest(expected) => expectation::decide(lattice, points, &image, expected, pattern, options)?,
    };
    let outside = lattice.len().saturating_sub(placement.inside);
    if outside > options.maximum_outside {
        return Err(GridError::WrongBoard { outside });
    }
    let (placement, ordering) = match (choice, turns_of(pattern)) {
        (Choice::Nearest(_), _) | (_, 1) => (placement, Ordering::Unique),
        (Choice::MostLikely, turns) => {
            (turned_to_top_left(placement, &image, pattern), Ordering::Ambiguous(turns as u8))
        }
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
        for known in &mut circles {
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

//! Seeds of lattices: points between two pairs of opposite neighbours.

use heapless::Vec;
use nalgebra::{RealField, Vector2};

use super::lattice::Lattice;
use super::points::{NEIGHBOURS, Points};

/// Number of seeds kept.
pub(super) const SEEDS: usize = 12;

/// Largest difference of opposite steps, relative to the shorter one: perspective compresses the far side.
const OPPOSITE_TOLERANCE: f64 = 0.35;
/// Largest distance of a corner of the cell from its expected position, relative to the shorter step.
const CORNER_TOLERANCE: f64 = 0.35;
/// Smallest sine of the angle between the two steps.
const LEAST_SINE: f64 = 0.15;
/// Upper bound of the ratio of the radii of neighbouring circles of a board (if both are known).
const RADIUS_RATIO: f64 = 2.0;
/// Largest number of pairs of opposite neighbours examined around a point.
const PAIRS: usize = 6;

/// A point with the ends of its two lattice steps.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seed<T> {
    pub center: u16,
    /// Points at (1, 0) and (-1, 0); the second may be missing.
    pub along_u: (u16, u16),
    /// Points at (0, 1) and (0, -1).
    pub along_v: (u16, Option<u16>),
    /// Number of the four diagonal corners with a point.
    corners: u8,
    /// Misfit of neighbours and corners, relative to the step.
    misfit: T,
}

#[derive(Clone, Copy)]
struct Pair<T> {
    ends: (u16, u16),
    step: Vector2<T>,
    misfit: T,
}

impl<T: RealField + Copy> Seed<T> {
    /// Starts a lattice with the seed's points.
    pub fn plant<const N: usize>(&self, lattice: &mut Lattice<N>) {
        lattice.clear();
        lattice.place(0, 0, self.center);
        lattice.place(1, 0, self.along_u.0);
        lattice.place(-1, 0, self.along_u.1);
        lattice.place(0, 1, self.along_v.0);
        if let Some(point) = self.along_v.1 {
            lattice.place(0, -1, point);
        }
    }

    fn is_better_than(&self, other: &Self) -> bool {
        let rank = |seed: &Self| seed.corners + if seed.along_v.1.is_some() { 1 } else { 0 };
        rank(self) > rank(other) || (rank(self) == rank(other) && self.misfit < other.misfit)
    }
}

/// Kind of seed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Points between two pairs of opposite neighbours, inside the board.
    Cross,
    /// Points between one pair of neighbours, at the border of the board; for boards of two rows, or with many missing
    /// circles.
    Border,
}

/// Returns the most lattice-like seeds, best first.
pub(super) fn find_seeds<T: RealField + Copy, const N: usize>(
    points: &Points<T, N>,
    kind: Kind,
) -> Vec<Seed<T>, SEEDS> {
    let mut seeds = Vec::new();
    for center in 0..points.len() as u16 {
        let pairs = opposite_pairs(points, center);
        let seed = match kind {
            Kind::Cross => best_cross(points, center, &pairs),
            Kind::Border => best_border(points, center, &pairs),
        };
        if let Some(seed) = seed {
            insert(&mut seeds, seed);
        }
    }
    seeds
}

/// Returns the first seed of two pairs that form a whole cell. The pairs are sorted by length, so these are the
/// shortest lattice steps.
fn best_cross<T: RealField + Copy, const N: usize>(
    points: &Points<T, N>,
    center: u16,
    pairs: &[Pair<T>],
) -> Option<Seed<T>> {
    let mut best: Option<Seed<T>> = None;
    for (index, second) in pairs.iter().enumerate() {
        for first in pairs.iter().take(index) {
            let Some(seed) = cross(points, center, first, second) else { continue };
            if seed.corners == 4 {
                return Some(seed);
            }
            if best.is_none_or(|best| seed.is_better_than(&best)) {
                best = Some(seed);
            }
        }
    }
    best
}

fn best_border<T: RealField + Copy, const N: usize>(
    points: &Points<T, N>,
    center: u16,
    pairs: &[Pair<T>],
) -> Option<Seed<T>> {
    let mut best: Option<Seed<T>> = None;
    for pair in pairs {
        if let Some(seed) = border(points, center, pair)
            && best.is_none_or(|best| seed.is_better_than(&best))
        {
            best = Some(seed);
        }
    }
    best
}

/// Returns pairs of neighbours on opposite sides of a point, shortest first.
fn opposite_pairs<T: RealField + Copy, const N: usize>(points: &Points<T, N>, center: u16) -> Vec<Pair<T>, PAIRS> {
    let tolerance: T = nalgebra::convert(OPPOSITE_TOLERANCE);
    let half: T = nalgebra::convert(0.5);
    let mut pairs = Vec::new();
    let Some(origin) = points.get(center) else { return pairs };
    let mut seen: Vec<(u16, Vector2<T>), NEIGHBOURS> = Vec::new();
    for (index, point) in points.neighbours(center) {
        if !radii_agree(origin.radius, point.radius) {
            continue;
        }
        let step = point.position - origin.position;
        for &(other, other_step) in &seen {
            let gap = (step + other_step).norm_squared();
            // Neighbours are sorted by distance, so `other_step` is the shorter one.
            let limit = tolerance * tolerance * other_step.norm_squared();
            if gap < limit {
                let pair = Pair {
                    ends: (index, other),
                    step: (step - other_step) * half,
                    misfit: gap / other_step.norm_squared(),
                };
                if pairs.push(pair).is_err() {
                    return pairs;
                }
            }
        }
        if seen.push((index, step)).is_err() {
            return pairs;
        }
    }
    pairs
}

/// Returns a seed from two pairs, if they span a cell and points exist at corners of that cell.
fn cross<T: RealField + Copy, const N: usize>(
    points: &Points<T, N>,
    center: u16,
    first: &Pair<T>,
    second: &Pair<T>,
) -> Option<Seed<T>> {
    let along_v = oriented(first, second)?;
    let origin = points.position(center)?;
    let tolerance = corner_tolerance(first, second);
    let (u_plus, u_minus) = (points.position(first.ends.0)?, points.position(first.ends.1)?);
    let (v_plus, v_minus) = (points.position(along_v.0)?, points.position(along_v.1)?);
    let mut corners = 0;
    let mut misfit = first.misfit + second.misfit;
    for (side, other) in [(u_plus, v_plus), (u_plus, v_minus), (u_minus, v_plus), (u_minus, v_minus)] {
        if let Some(nearest) = points.nearest(&(side + other - origin), tolerance) {
            corners += 1;
            misfit += nearest.distance_squared / (tolerance * tolerance);
        }
    }
    // A point halfway would mean that the cell contains only every other lattice point.
    let half: T = nalgebra::convert(0.5);
    let halfway = [(u_plus + origin) * half, (v_plus + origin) * half, (u_plus + v_plus) * half];
    if halfway.iter().any(|place| points.nearest(place, tolerance * half).is_some()) {
        return None;
    }
    (corners >= 2).then_some(Seed {
        center,
        along_u: first.ends,
        along_v: (along_v.0, Some(along_v.1)),
        corners,
        misfit,
    })
}

/// Returns a seed at the border of the board: one pair, and a third neighbour with at least one corner.
fn border<T: RealField + Copy, const N: usize>(points: &Points<T, N>, center: u16, pair: &Pair<T>) -> Option<Seed<T>> {
    let origin = points.get(center)?;
    let (plus, minus) = (points.position(pair.ends.0)?, points.position(pair.ends.1)?);
    let mut best: Option<Seed<T>> = None;
    for (index, point) in points.neighbours(center) {
        if index == pair.ends.0 || index == pair.ends.1 || !radii_agree(origin.radius, point.radius) {
            continue;
        }
        let third = Pair { ends: (index, index), step: point.position - origin.position, misfit: T::zero() };
        if oriented(pair, &third).is_none() {
            continue;
        }
        let tolerance = corner_tolerance(pair, &third);
        let mut corners = 0;
        let mut misfit = pair.misfit;
        for side in [plus, minus] {
            if let Some(nearest) = points.nearest(&(side + third.step), tolerance) {
                corners += 1;
                misfit += nearest.distance_squared / (tolerance * tolerance);
            }
        }
        if corners == 0 {
            continue;
        }
        let turned = pair.step.perp(&third.step) < T::zero();
        let along_u = if turned { (pair.ends.1, pair.ends.0) } else { pair.ends };
        let seed = Seed { center, along_u, along_v: (index, None), corners, misfit };
        if best.is_none_or(|best| seed.is_better_than(&best)) {
            best = Some(seed);
        }
    }
    best
}

/// Returns the ends of `second`, ordered so that the rotation from `first` to `second` has the same sense as from x to
/// y; `None` if the two are nearly parallel.
fn oriented<T: RealField + Copy>(first: &Pair<T>, second: &Pair<T>) -> Option<(u16, u16)> {
    let least_sine: T = nalgebra::convert(LEAST_SINE);
    let cross = first.step.perp(&second.step);
    if cross * cross < least_sine * least_sine * first.step.norm_squared() * second.step.norm_squared() {
        return None;
    }
    Some(if cross > T::zero() { second.ends } else { (second.ends.1, second.ends.0) })
}

fn corner_tolerance<T: RealField + Copy>(first: &Pair<T>, second: &Pair<T>) -> T {
    let tolerance: T = nalgebra::convert(CORNER_TOLERANCE);
    tolerance * first.step.norm_squared().min(second.step.norm_squared()).sqrt()
}

fn radii_agree<T: RealField + Copy>(a: T, b: T) -> bool {
    let ratio: T = nalgebra::convert(RADIUS_RATIO);
    a == T::zero() || b == T::zero() || (a < b * ratio && b < a * ratio)
}

/// Inserts a seed into the list, sorted from best to worst; the worst is dropped when the list is full.
fn insert<T: RealField + Copy>(seeds: &mut Vec<Seed<T>, SEEDS>, seed: Seed<T>) {
    let mut carried = seed;
    for kept in seeds.iter_mut() {
        if carried.is_better_than(kept) {
            core::mem::swap(&mut carried, kept);
        }
    }
    // If the list is full, the remaining seed is the worst.
    let _ = seeds.push(carried);
}

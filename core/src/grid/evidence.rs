//! Choice of the placement on the board, and its certainty.
//!
//! Two placements of one lattice differ in the points that they explain and in the circles that they miss. If only one
//! placement explains a point, the other must assume that the point is clutter that happens to lie on a lattice site.
//! This is unlikely, the more so the fewer candidates lie off the lattice. A circle missed within the image is a miss
//! of the detector; a circle beyond the border of the image is not. If the border might cut the board, a single point
//! is therefore not decisive.
//!
//! In motion, a placement loses odds for the circles that it misses, but wins none for the circles that a rival misses,
//! because misses are not independent. The detector misses a whole row that moves along itself or lies on the axis of a
//! rotation. If these misses counted against the right placement, the board would be placed one row off. In pictures of
//! a board at rest, misses are independent and count for and against ([`GridOptions::independent_misses`]).

use heapless::Vec;
use nalgebra::RealField;

use super::lattice::Lattice;
use super::placement::{Placement, axes_of, visit};
use super::points::Points;
use super::warp::LatticeImage;
use super::{GridError, GridOptions};
use crate::pattern::Pattern;

/// Largest number of placements compared; if more are (nearly) as good, the placement is ambiguous.
const RIVALS: usize = 32;
/// Placements that explain fewer points than the best by this number or more are ignored.
const CLEAR: usize = 4;
/// Natural logarithm of the likelihood ratio: largest contribution of one explained point.
const MOST_FOR_POINT: f64 = 9.2;
/// A circle nearer to the border of the image than this fraction of the spacing may be invisible.
const BORDER: f64 = 0.5;

/// A circle with a candidate nearer than this fraction of the spacing is not missed.
const NEAR: f64 = 0.3;

/// A placement and the number of circles that it misses within the image.
#[derive(Clone, Copy)]
struct Rival {
    placement: Placement,
    missed: usize,
}

/// Returns the most likely placement, if it is likelier than any other by `options.minimum_odds`.
pub(super) fn decide<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    image: &LatticeImage<T>,
    scatter: T,
    pattern: &Pattern,
    options: &GridOptions,
) -> Result<Placement, GridError> {
    let mut most = 0;
    let axes = axes_of(image, pattern);
    visit(lattice, pattern, &axes, options.minimum_circles, |placement| most = most.max(placement.inside));
    if most == 0 {
        return Err(GridError::TooFewCircles { found: 0, needed: options.minimum_circles });
    }
    let mut rivals: Vec<Rival, RIVALS> = Vec::new();
    let mut overflow = false;
    visit(lattice, pattern, &axes, (most + 1).saturating_sub(CLEAR), |placement| {
        overflow |= rivals.push(Rival { placement, missed: 0 }).is_err();
    });
    if overflow {
        return Err(GridError::AmbiguousPlacement { best: most, runner_up: most });
    }
    if let [only] = rivals.as_slice() {
        return Ok(only.placement);
    }
    let spacing = lattice.spacing(points);
    for rival in &mut rivals {
        rival.missed = missed(lattice, points, image, &rival.placement, spacing, pattern, options);
    }
    let fewest = rivals.iter().filter(|rival| rival.placement.inside == most).map(|rival| rival.missed).min();
    let fewest = fewest.unwrap_or(0);
    let per_point = weight_of_point(lattice, points, most, scatter, spacing);
    // The rate of misses, by the rule of succession.
    let rate: T = nalgebra::convert((fewest + 1) as f64 / (most + fewest + 2) as f64);
    let per_miss = -rate.ln();
    let likelihood = |rival: &Rival| {
        per_point * nalgebra::convert(rival.placement.inside as f64) - per_miss * nalgebra::convert(rival.missed as f64)
    };
    let Some(mut best) = rivals.first().copied() else {
        return Err(GridError::TooFewCircles { found: 0, needed: options.minimum_circles });
    };
    for rival in &rivals {
        if likelihood(rival) > likelihood(&best) {
            best = *rival;
        }
    }
    // Points of the lattice outside the board count against the best placement, but a single one may be clutter.
    let outside = lattice.len().saturating_sub(best.placement.inside);
    let against = if outside > 1 { outside } else { 0 };
    let needed: T = nalgebra::convert::<f64, T>(options.minimum_odds.max(1.0)).ln();
    for rival in rivals.iter().filter(|rival| rival.placement != best.placement) {
        let points = best.placement.inside as f64 - rival.placement.inside as f64 - against as f64;
        let missed_more = best.missed as f64 - rival.missed as f64;
        let missed_more = if options.independent_misses { missed_more } else { missed_more.max(0.0) };
        let against_misses = per_miss * nalgebra::convert(missed_more);
        if per_point * nalgebra::convert(points) - against_misses < needed {
            let (best, runner_up) = (best.placement.inside, rival.placement.inside);
            return Err(GridError::AmbiguousPlacement { best, runner_up });
        }
    }
    Ok(best.placement)
}

/// Returns the number of circles that a placement expects well within the image but that are missing.
fn missed<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    image: &LatticeImage<T>,
    placement: &Placement,
    spacing: T,
    pattern: &Pattern,
    options: &GridOptions,
) -> usize {
    let border = spacing * nalgebra::convert(BORDER);
    let near = spacing * nalgebra::convert(NEAR);
    let (width, height): (T, T) =
        (nalgebra::convert(options.image_size.0 - 1.0), nalgebra::convert(options.image_size.1 - 1.0));
    (0..pattern.circle_count())
        .map(|circle| placement.site(pattern, circle))
        .filter(|&(u, v)| lattice.at(u, v).is_none())
        .filter_map(|(u, v)| image.at(u, v))
        .filter(|place| place.x > border && place.y > border && place.x < width - border && place.y < height - border)
        // A nearby candidate may still be the circle.
        .filter(|place| points.nearest(place, near).is_none())
        .count()
}

/// Returns the weight of a point that only one of two placements explains: minus the logarithm of the probability that
/// clutter would have been taken for a circle at a given site.
fn weight_of_point<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    explained: usize,
    scatter: T,
    spacing: T,
) -> T {
    let most: T = nalgebra::convert(MOST_FOR_POINT);
    let clutter: T = nalgebra::convert(points.len().saturating_sub(explained) as f64);
    // The ratio of the area in which a candidate is accepted at the border of the lattice (four standard deviations,
    // with half the variance added for the map) to the area that contains the clutter.
    let area_of_site = scatter * scatter * nalgebra::convert(1.5 * 16.0 * core::f64::consts::PI);
    let area = spacing * spacing * nalgebra::convert(2.0 * lattice.len() as f64);
    let chance = clutter * area_of_site / area;
    if chance > T::zero() { (-chance.ln()).clamp(T::zero(), most) } else { most }
}

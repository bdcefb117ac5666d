//! Choice of the placement nearest to the expected one.

use nalgebra::{RealField, Vector2};

use super::lattice::Lattice;
use super::placement::{Placement, axes_of, turns_of, visit};
use super::points::Points;
use super::warp::LatticeImage;
use super::{GridError, GridOptions};
use crate::pattern::Pattern;

/// Largest root mean square distance to the expected pixels, as a fraction of the spacing. Any other placement is then
/// at least twice as far away.
const NEAREST: f64 = 1.0 / 3.0;

/// Returns the placement whose circles are nearest to their `expected` pixels (by board index).
pub(super) fn decide<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    image: &LatticeImage<T>,
    expected: &[Option<Vector2<T>>],
    pattern: &Pattern,
    options: &GridOptions,
) -> Result<Placement, GridError> {
    let spacing = lattice.spacing(points);
    let limit = spacing * spacing * nalgebra::convert(NEAREST * NEAREST);
    let mut best: Option<(T, Placement)> = None;
    let axes = axes_of(image, pattern);
    visit(lattice, pattern, &axes, options.minimum_circles, |mut placement| {
        for _ in 0..turns_of(pattern) {
            if let Some(distance) = mean_square(lattice, points, expected, &placement, pattern)
                && distance <= limit
                && best.is_none_or(|(least, _)| distance < least)
            {
                best = Some((distance, placement));
            }
            placement = placement.turned(pattern);
        }
    });
    best.map(|(_, placement)| placement).ok_or(GridError::NotAsExpected)
}

/// Returns the mean squared distance of a placement's points from their expected pixels; `None` if fewer than half of
/// them have one.
fn mean_square<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    expected: &[Option<Vector2<T>>],
    placement: &Placement,
    pattern: &Pattern,
) -> Option<T> {
    let mut sum = T::zero();
    let mut count = 0;
    for site in lattice.sites() {
        let circle = placement.circle(pattern, site.u, site.v);
        let Some(expected) = circle.and_then(|circle| expected.get(circle).copied().flatten()) else { continue };
        sum += (points.position(site.point)? - expected).norm_squared();
        count += 1;
    }
    let mean = sum / nalgebra::convert(f64::from(count.max(1)));
    (count as usize * 2 >= placement.inside && mean.is_finite()).then_some(mean)
}

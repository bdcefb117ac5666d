//! Brings a grown lattice and the points into agreement.
//!
//! A smooth map is fitted to the lattice. Then every point, placed or not, is compared with a map fitted without it.
//! The point is assigned to the nearest site if its distance from that site is small relative to the scatter of the
//! lattice. Wrong points thus lose their site, better points replace them, and points beyond a hole are reached. This
//! is repeated until the lattice no longer changes.

use heapless::Vec;
use nalgebra::{RealField, Vector2};

use super::GridOptions;
use super::fit::{Precision, Step};
use super::lattice::Lattice;
use super::points::Points;
use super::select::{exchange, select};
use super::warp::Warp;

/// Largest number of rounds.
const ROUNDS: usize = 6;
/// Steps of the first fit.
pub(super) const APPROACH: [Step; 9] = [
    Step::Homography,
    Step::Homography,
    Step::Homography,
    Step::Distortion,
    Step::Distortion,
    Step::Distortion,
    Step::All,
    Step::All,
    Step::All,
];
/// Steps of every round; they end when the cost no longer decreases.
pub(super) const FIT: [Step; 4] = [Step::Robust; 4];
/// Largest deviation of a point, in standard deviations.
const DEVIATIONS: f64 = 4.0;
/// Largest distance of a point from its site, as a fraction of the spacing.
const WIDEST: f64 = 0.35;
/// Largest uncertainty of the map (two standard deviations), as a fraction of the spacing.
const LEAST_CERTAIN: f64 = 0.2;
/// Smallest scatter of the points, as a fraction of the spacing, because the map is not exact.
const LEAST_SCATTER: f64 = 0.004;
/// If two points compete for a site, smallest difference of their squared distances, in units of the variance; below it
/// neither is taken.
const CONTEST: f64 = 12.0;

/// A point that fits a site.
#[derive(Clone, Copy, Debug)]
struct Claim<T> {
    u: i8,
    v: i8,
    point: u16,
    /// Squared distance in units of the variance.
    distance: T,
}

/// The map of a settled lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settled<T> {
    pub warp: Warp<T>,
    /// Standard deviation of one point along one axis, pixels.
    pub scatter: T,
}

/// Buffers that [`Settling::settle`] reuses: the claims of points on sites, and squared residuals.
#[derive(Clone, Debug)]
pub(super) struct Settling<T, const N: usize> {
    claims: Vec<Claim<T>, N>,
    squares: Vec<T, N>,
}

impl<T: RealField + Copy, const N: usize> Settling<T, N> {
    pub const fn new() -> Self {
        Self { claims: Vec::new(), squares: Vec::new() }
    }

    /// Fits a map and settles the lattice; returns `None` if no map fits.
    pub fn settle(
        &mut self,
        lattice: &mut Lattice<N>,
        points: &Points<T, N>,
        options: &GridOptions,
    ) -> Option<Settled<T>> {
        let mut warp = Warp::affine(lattice, points, options.image_size)?;
        warp.fit(lattice, points, &APPROACH, &mut self.squares)?;
        let limit = |lattice: &Lattice<N>| lattice.spacing(points) * nalgebra::convert(options.maximum_scatter);
        // Most candidates do not belong to a board; reject them early.
        let median = warp.median_square(lattice, points, &mut self.squares)?;
        if deviation_of(median) > limit(lattice) {
            return None;
        }
        let mut scatter = T::zero();
        for _ in 0..ROUNDS {
            let precision = warp.fit(lattice, points, &FIT, &mut self.squares)?;
            scatter = self.scatter(lattice, points, &warp, &precision)?;
            if scatter > limit(lattice) {
                return None;
            }
            self.collect_claims(lattice, points, &warp, &precision, scatter);
            if !self.redistribute(lattice) {
                break;
            }
            if lattice.len() * 2 < options.minimum_circles {
                return None;
            }
        }
        Some(Settled { warp, scatter })
    }

    /// Returns the standard deviation that follows from the median of the residuals.
    fn scatter(
        &mut self,
        lattice: &Lattice<N>,
        points: &Points<T, N>,
        warp: &Warp<T>,
        precision: &Precision<T>,
    ) -> Option<T> {
        self.squares.clear();
        let mut least = T::zero();
        for site in lattice.sites() {
            let Some(local) = points.position(site.point).and_then(|position| warp.at(&position)) else { continue };
            let deviation = precision.deviation(&local, site.position(), true);
            // The capacity equals the number of sites.
            let _ = self.squares.push(deviation.normalized_squared);
            least = least.max(local.spacing_squared());
        }
        let rank = self.squares.len() / 2;
        let floor = least.sqrt() * nalgebra::convert(LEAST_SCATTER);
        Some(deviation_of(select(&mut self.squares, rank)?).max(floor))
    }

    /// Collects the points that fit a site, best first.
    fn collect_claims(
        &mut self,
        lattice: &Lattice<N>,
        points: &Points<T, N>,
        warp: &Warp<T>,
        precision: &Precision<T>,
        scatter: T,
    ) {
        let deviations: T = nalgebra::convert(DEVIATIONS);
        let widest: T = nalgebra::convert(WIDEST * WIDEST);
        let least_certain: T = nalgebra::convert(LEAST_CERTAIN * LEAST_CERTAIN / 4.0);
        let variance = scatter * scatter;
        self.claims.clear();
        for point in 0..points.len() as u16 {
            let Some(local) = points.position(point).and_then(|position| warp.at(&position)) else { continue };
            let Some((u, v)) = nearest_site(&local.site) else { continue };
            let site = Vector2::new(nalgebra::convert(f64::from(u)), nalgebra::convert(f64::from(v)));
            let spacing_squared = local.spacing_squared();
            if local.residual(site).norm_squared() > widest * spacing_squared {
                continue;
            }
            let member = lattice.at(i32::from(u), i32::from(v)) == Some(point);
            let deviation = precision.deviation(&local, site, member);
            let fits = deviation.normalized_squared <= deviations * deviations * variance
                && deviation.distance_squared <= widest * spacing_squared
                && deviation.variance * variance <= least_certain * spacing_squared;
            if !fits {
                continue;
            }
            let claim = Claim { u, v, point, distance: deviation.normalized_squared / variance };
            if self.claims.push(claim).is_err() {
                return;
            }
            self.sink_last();
        }
    }

    /// Moves the last claim to its position among the sorted claims before it.
    fn sink_last(&mut self) {
        let mut end = self.claims.len();
        while let Some([.., before, last]) = self.claims.get_mut(..end) {
            if before.distance <= last.distance {
                return;
            }
            core::mem::swap(before, last);
            end -= 1;
        }
    }

    /// Rebuilds the lattice from the claims; returns `true` if that changed it.
    fn redistribute(&mut self, lattice: &mut Lattice<N>) -> bool {
        let before = lattice.len();
        let contest: T = nalgebra::convert(CONTEST);
        let mut kept = 0;
        let mut same = 0;
        for index in 0..self.claims.len() {
            let Some(claim) = self.claims.get(index).copied() else { break };
            let rival = self
                .claims
                .iter()
                .enumerate()
                .find(|(other_index, other)| *other_index != index && (other.u, other.v) == (claim.u, claim.v));
            // The first of several claims is the best; it keeps the site if the next is clearly worse.
            let keeps = rival
                .is_none_or(|(other_index, other)| other_index > index && other.distance - claim.distance >= contest);
            if keeps {
                same += usize::from(lattice.at(i32::from(claim.u), i32::from(claim.v)) == Some(claim.point));
                exchange(&mut self.claims, kept, index);
                kept += 1;
            }
        }
        if kept == before && same == before {
            return false;
        }
        lattice.clear();
        for claim in self.claims.iter().take(kept) {
            lattice.place(i32::from(claim.u), i32::from(claim.v), claim.point);
        }
        true
    }
}

/// Returns the standard deviation along one axis that corresponds to a median of squared distances.
fn deviation_of<T: RealField + Copy>(median_square: T) -> T {
    // The squared length of a normal 2-vector has the median 2 ln 2.
    (median_square / nalgebra::convert(2.0 * core::f64::consts::LN_2)).sqrt()
}

fn nearest_site<T: RealField + Copy>(place: &Vector2<T>) -> Option<(i8, i8)> {
    let round = |value: T| -> Option<i8> {
        let value: f64 = nalgebra::try_convert(value.round())?;
        (value.abs() <= 30.0).then_some(value as i8)
    };
    Some((round(place.x)?, round(place.y)?))
}

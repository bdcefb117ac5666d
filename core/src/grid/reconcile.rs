//! Brings a grown lattice and the points into agreement.
//!
//! Every site, placed or next to placed ones, is predicted from its neighbours alone
//! ([`predict`]). The nearest point takes it if it is close enough for the scatter that
//! the lattice itself shows. So wrong points lose their place, better ones replace them, and points
//! beyond a hole are reached.

use heapless::Vec;
use nalgebra::RealField;

use super::lattice::{Lattice, Site};
use super::points::Points;
use super::smooth::predict;

/// Storage of one reconciliation.
#[derive(Clone, Debug)]
pub(super) struct Agreement<T, const N: usize> {
    sites: Vec<Site, N>,
    residuals: Vec<T, N>,
}

/// A point never lies further from its prediction than this part of the spacing.
const WIDEST: f64 = 0.25;
/// Closer than this part of the spacing is always good enough.
const NARROWEST: f64 = 0.015;
/// A second point in the same place must be this much worse, as a difference of squared distances
/// in units of the variance, or neither is taken.
const CONTEST: f64 = 12.0;

impl<T: RealField + Copy, const N: usize> Agreement<T, N> {
    pub const fn new() -> Self {
        Self { sites: Vec::new(), residuals: Vec::new() }
    }

    /// Reconciles a few times with ever narrower bounds. Returns the scatter of one point, as a
    /// standard deviation in pixels along one axis.
    pub fn settle(&mut self, lattice: &mut Lattice<N>, points: &Points<T, N>) -> Option<T> {
        self.pass(lattice, points, None);
        let scatter = self.scatter()?;
        self.pass(lattice, points, Some((scatter, nalgebra::convert(8.0))));
        let scatter = self.scatter()?;
        self.pass(lattice, points, Some((scatter, nalgebra::convert(4.5))));
        self.scatter()
    }

    /// One reconciliation. `bound`: the scatter, and how many times the scatter a point may be off.
    fn pass(&mut self, lattice: &mut Lattice<N>, points: &Points<T, N>, bound: Option<(T, T)>) {
        self.sites.clear();
        self.residuals.clear();
        for site in lattice.sites() {
            self.consider(lattice, points, (i32::from(site.u), i32::from(site.v)), bound);
        }
        let Some((u_min, u_max, v_min, v_max)) = lattice.bounds() else { return };
        for v in v_min - 1..=v_max + 1 {
            for u in u_min - 1..=u_max + 1 {
                if lattice.at(u, v).is_none() {
                    self.consider(lattice, points, (u, v), bound);
                }
            }
        }
        lattice.clear();
        for site in &self.sites {
            lattice.place(i32::from(site.u), i32::from(site.v), site.point);
        }
    }

    fn consider(&mut self, lattice: &Lattice<N>, points: &Points<T, N>, (u, v): (i32, i32), bound: Option<(T, T)>) {
        let Some(prediction) = predict(lattice, points, u, v) else { return };
        if prediction.steps.determinant() <= T::zero() {
            return;
        }
        let spacing = prediction.spacing_squared().sqrt();
        let widening = (T::one() + prediction.variance).sqrt();
        let widest = spacing * nalgebra::convert(WIDEST);
        let limit = bound.map_or(widest, |(scatter, factor)| {
            (scatter * factor * widening).max(spacing * nalgebra::convert(NARROWEST)).min(widest)
        });
        let Some(nearest) = points.nearest(&prediction.position, limit) else { return };
        if let (Some((scatter, _)), Some(second)) = (bound, nearest.second_squared) {
            let contest: T = nalgebra::convert(CONTEST);
            let deviation = scatter * widening;
            if second - nearest.distance_squared < contest * deviation * deviation {
                return;
            }
        }
        let (Ok(u), Ok(v)) = (i8::try_from(u), i8::try_from(v)) else { return };
        let site = Site { u, v, point: nearest.point };
        if self.sites.push(site).is_ok() {
            // Both lists have the same capacity.
            let _ = self.residuals.push(nearest.distance_squared / (widening * widening));
        }
    }

    /// Standard deviation by the median of the residuals.
    fn scatter(&mut self) -> Option<T> {
        let count = self.residuals.len();
        if count == 0 {
            return None;
        }
        let middle = select(&mut self.residuals, count / 2)?;
        // The squared length of a normal 2-vector has the median 2 ln 2.
        let median: T = nalgebra::convert(2.0 * core::f64::consts::LN_2);
        Some((middle / median).sqrt())
    }
}

/// The value that sorting would put at `rank`.
fn select<T: RealField + Copy>(values: &mut [T], rank: usize) -> Option<T> {
    for first in 0..=rank.min(values.len().checked_sub(1)?) {
        let rest = values.get_mut(first..)?;
        let mut least = 0;
        for index in 1..rest.len() {
            if rest.get(index)? < rest.get(least)? {
                least = index;
            }
        }
        let value = *rest.get(least)?;
        *rest.get_mut(least)? = *rest.first()?;
        *rest.first_mut()? = value;
    }
    values.get(rank).copied()
}

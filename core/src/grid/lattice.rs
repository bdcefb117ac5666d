//! Points with integer lattice coordinates, and growth of the lattice from neighbour to neighbour.

use heapless::Vec;
use nalgebra::{Matrix2, RealField, Vector2};

use super::points::{NONE, Points};

/// Lattice coordinates run from -HALF to HALF - 1.
const HALF: i32 = 32;
const SIDE: usize = 2 * HALF as usize;

/// A lattice site with a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Site {
    pub u: i8,
    pub v: i8,
    pub point: u16,
}

impl Site {
    /// Returns the lattice coordinates.
    pub fn position<T: RealField + Copy>(&self) -> Vector2<T> {
        Vector2::new(nalgebra::convert(f64::from(self.u)), nalgebra::convert(f64::from(self.v)))
    }
}

/// Board coordinates (x; y) for each lattice step (u, v).
pub(super) type Axes = [[i32; 2]; 2];

/// An affine map from lattice to image coordinates.
pub(super) struct Affine<T> {
    /// Mean of the lattice coordinates.
    pub mean_site: Vector2<T>,
    /// Mean of the image coordinates.
    pub mean_position: Vector2<T>,
    /// Pixels per lattice step (columns: u, v).
    pub steps: Matrix2<T>,
}

/// Points on lattice sites, one to one.
#[derive(Clone, Debug)]
pub(super) struct Lattice<const N: usize> {
    cells: [[u16; SIDE]; SIDE],
    sites: Vec<Site, N>,
    placed: [bool; N],
}

impl<const N: usize> Lattice<N> {
    pub const fn new() -> Self {
        Self { cells: [[NONE; SIDE]; SIDE], sites: Vec::new(), placed: [false; N] }
    }

    pub fn clear(&mut self) {
        for site in &self.sites {
            if let Some(cell) = cell_mut(&mut self.cells, i32::from(site.u), i32::from(site.v)) {
                *cell = NONE;
            }
        }
        self.sites.clear();
        self.placed = [false; N];
    }

    pub fn sites(&self) -> &[Site] {
        &self.sites
    }

    pub fn len(&self) -> usize {
        self.sites.len()
    }

    /// Returns the point at a site.
    pub fn at(&self, u: i32, v: i32) -> Option<u16> {
        let column = usize::try_from(u + HALF).ok()?;
        let row = usize::try_from(v + HALF).ok()?;
        self.cells.get(row)?.get(column).copied().filter(|&point| point != NONE)
    }

    /// Puts a point on a free site; returns `false` if site or point is taken or the site is out of range.
    pub fn place(&mut self, u: i32, v: i32, point: u16) -> bool {
        let (Ok(site_u), Ok(site_v)) = (i8::try_from(u), i8::try_from(v)) else { return false };
        let Some(placed) = self.placed.get_mut(usize::from(point)) else { return false };
        let Some(cell) = cell_mut(&mut self.cells, u, v) else { return false };
        if *placed || *cell != NONE || self.sites.push(Site { u: site_u, v: site_v, point }).is_err() {
            return false;
        }
        *placed = true;
        *cell = point;
        true
    }

    /// Returns the mean distance of neighbours in pixels, zero without neighbours.
    pub fn spacing<T: RealField + Copy>(&self, points: &Points<T, N>) -> T {
        let mut sum = T::zero();
        let mut count = T::zero();
        for site in &self.sites {
            let (u, v) = (i32::from(site.u), i32::from(site.v));
            for neighbour in [self.at(u + 1, v), self.at(u, v + 1)].into_iter().flatten() {
                if let (Some(a), Some(b)) = (points.position(site.point), points.position(neighbour)) {
                    sum += (a - b).norm();
                    count += T::one();
                }
            }
        }
        if count > T::zero() { sum / count } else { T::zero() }
    }

    /// Returns the affine map from lattice to image coordinates that fits best; `None` if all points are collinear.
    pub fn affine<T: RealField + Copy>(&self, points: &Points<T, N>) -> Option<Affine<T>> {
        let samples =
            || self.sites.iter().filter_map(|site| points.position(site.point).map(|place| (site.position(), place)));
        let count: T = nalgebra::convert(self.sites.len().max(1) as f64);
        let mut mean_site = Vector2::zeros();
        let mut mean_position = Vector2::zeros();
        for (site, position) in samples() {
            mean_site += site / count;
            mean_position += position / count;
        }
        let mut spread = Matrix2::<T>::zeros();
        let mut mixed = Matrix2::<T>::zeros();
        for (site, position) in samples() {
            let site = site - mean_site;
            spread += site * site.transpose();
            mixed += (position - mean_position) * site.transpose();
        }
        Some(Affine { mean_site, mean_position, steps: mixed * spread.try_inverse()? })
    }

    /// Adds points next to the placed ones as long as a point lies within `tolerance` × the local spacing of a position
    /// that its placed neighbours predict.
    pub fn grow<T: RealField + Copy>(&mut self, points: &Points<T, N>, tolerance: T) {
        let mut next = 0;
        while let Some(site) = self.sites.get(next).copied() {
            next += 1;
            for (step_u, step_v) in STEPS {
                let (u, v) = (i32::from(site.u) + step_u, i32::from(site.v) + step_v);
                if self.at(u, v).is_some() {
                    continue;
                }
                let Some(prediction) = self.extrapolate(points, u, v) else { continue };
                let radius = tolerance * prediction.spacing_squared.sqrt();
                if let Some(nearest) = points.nearest(&prediction.position, radius) {
                    self.place(u, v, nearest.point);
                }
            }
        }
    }

    /// Predicts the position of a site from lines and parallelograms of placed neighbours.
    fn extrapolate<T: RealField + Copy>(&self, points: &Points<T, N>, u: i32, v: i32) -> Option<Extrapolation<T>> {
        let at = |u: i32, v: i32| self.at(u, v).and_then(|point| points.position(point));
        let half: T = nalgebra::convert(0.5);
        let mut sum = Vector2::zeros();
        let mut count = T::zero();
        let mut step_squared: Option<T> = None;
        for (du, dv) in STEPS {
            let Some(first) = at(u - du, v - dv) else { continue };
            let second = at(u - 2 * du, v - 2 * dv);
            if let Some(second) = second {
                let mut line = first + first - second;
                if let Some(third) = at(u - 3 * du, v - 3 * dv) {
                    line += (first - second - second + third) * half;
                }
                sum += line;
                count += T::one();
                let square = (first - second).norm_squared();
                step_squared = Some(step_squared.map_or(square, |known| known.min(square)));
            }
            if let Some(opposite) = at(u + du, v + dv) {
                sum += (first + opposite) * half;
                count += T::one();
                let square = (first - opposite).norm_squared() * half * half;
                step_squared = Some(step_squared.map_or(square, |known| known.min(square)));
            }
            for (eu, ev) in [(dv, du), (-dv, -du)] {
                let (Some(side), Some(corner)) = (at(u - eu, v - ev), at(u - du - eu, v - dv - ev)) else { continue };
                sum += first + side - corner;
                count += T::one();
                let square = (side - corner).norm_squared();
                step_squared = Some(step_squared.map_or(square, |known| known.min(square)));
            }
        }
        Some(Extrapolation { position: sum / count, spacing_squared: step_squared? })
    }
}

/// A predicted position.
struct Extrapolation<T> {
    position: Vector2<T>,
    /// Squared distance to the nearest of the neighbours used.
    spacing_squared: T,
}

/// Steps from a site to its neighbours.
const STEPS: [(i32, i32); 4] = [(1, 0), (0, 1), (-1, 0), (0, -1)];

fn cell_mut(cells: &mut [[u16; SIDE]; SIDE], u: i32, v: i32) -> Option<&mut u16> {
    let column = usize::try_from(u + HALF).ok()?;
    let row = usize::try_from(v + HALF).ok()?;
    cells.get_mut(row)?.get_mut(column)
}

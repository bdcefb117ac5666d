//! Fits a [`Warp`] to a lattice, and measures the deviation of single points from it.

use heapless::Vec;
use nalgebra::{Matrix2, RealField, Vector2};

use super::lattice::Lattice;
use super::points::Points;
use super::select::select;
use super::warp::{COUNT, Local, USUAL_DISTORTION, Warp};

/// Prior values of the parameters.
const ASSUMED: [f64; COUNT] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, USUAL_DISTORTION, 0.0, 0.0, 0.0];
/// Standard deviations of the prior; zero means no prior.
const SPREAD: [f64; COUNT] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.4, 0.2, 0.1, 0.1];
/// Scatter of the points in pixels, relative to which the prior is weighted.
const NOMINAL_SCATTER: f64 = 0.5;
/// A point at this multiple of the median distance keeps a quarter of its weight.
const CUT: f64 = 3.0;

/// Index of the first parameter of the lens.
const FIRST_OF_LENS: usize = 8;
/// Factor on the weight of the prior for parameters that are not estimated yet.
const FIRM: f64 = 1e6;
/// Largest number of attempts at a step, with increasing damping.
const ATTEMPTS: usize = 5;

/// A step that leaves more than this fraction of the cost is the last of its kind.
const ENOUGH: f64 = 0.98;

/// Parameters and weights of one step of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// Estimates the homography and keeps the lens at its prior, because the lens would otherwise absorb perspective.
    /// Outliers have full weight.
    Homography,
    /// Estimates the homography and λ₁.
    Distortion,
    /// Estimates all parameters.
    All,
    /// Estimates all parameters, with little weight on outliers.
    Robust,
}

/// The precision of a fitted map, for the deviation of single points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Precision<T> {
    /// Lower triangular factor of the normal matrix.
    factor: [[T; COUNT]; COUNT],
    /// Squared distance at which a point has a quarter of its weight.
    cut_squared: T,
    unit: T,
}

/// Deviation of a point from the map fitted to the other points.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deviation<T> {
    /// Squared distance in pixels.
    pub distance_squared: T,
    /// The squared distance divided by its variance, if points scatter by 1 px along each axis.
    pub normalized_squared: T,
    /// Variance of the map at the point, sum over both axes, if points scatter by 1 px along each axis.
    pub variance: T,
}

impl<T: RealField + Copy> Warp<T> {
    /// Fits the map to a lattice by Levenberg-Marquardt steps from its current parameters. `squares` is scratch space.
    pub fn fit<const N: usize>(
        &mut self,
        lattice: &Lattice<N>,
        points: &Points<T, N>,
        schedule: &[Step],
        squares: &mut Vec<T, N>,
    ) -> Option<Precision<T>> {
        let ten: T = nalgebra::convert(10.0);
        let tiny: T = nalgebra::convert(1e-4);
        let enough: T = nalgebra::convert(ENOUGH);
        let mut damping = T::zero();
        let mut last = None;
        let mut finished = None;
        for &step in schedule {
            if finished == Some(step) {
                continue;
            }
            let cut_squared = match step {
                Step::Homography | Step::Distortion | Step::All => self.unit * self.unit,
                Step::Robust => {
                    let median = self.median_square(lattice, points, squares)?;
                    (median * nalgebra::convert(CUT * CUT)).max(tiny)
                }
            };
            let weights = assumption_weights(step);
            let (system, before) = self.normal_equations(lattice, points, cut_squared, &weights);
            let mut after = before;
            for _ in 0..ATTEMPTS {
                if let Some(factor) = cholesky(&system.normal, damping) {
                    let mut trial = *self;
                    for (parameter, change) in trial.parameters.iter_mut().zip(solve(&factor, system.gradient)) {
                        *parameter -= change;
                    }
                    let cost = trial.cost(lattice, points, cut_squared, &weights);
                    if cost < before {
                        after = cost;
                        *self = trial;
                        damping = if damping < tiny { T::zero() } else { damping / ten };
                        break;
                    }
                }
                damping = (damping * ten).max(tiny * ten);
            }
            last = Some((system, cut_squared));
            if after >= before * enough {
                finished = Some(step);
            }
        }
        let (system, cut_squared) = last?;
        cholesky(&system.normal, T::zero()).map(|factor| Precision { factor, cut_squared, unit: self.unit })
    }

    /// Returns the median of the squared distances of the lattice's points from their sites, in square pixels.
    pub fn median_square<const N: usize>(
        &self,
        lattice: &Lattice<N>,
        points: &Points<T, N>,
        squares: &mut Vec<T, N>,
    ) -> Option<T> {
        squares.clear();
        for (position, site) in members(lattice, points) {
            // The capacity equals the number of sites.
            let _ = squares.push(self.square(&position, site));
        }
        let rank = squares.len() / 2;
        select(squares, rank)
    }

    /// Returns the squared residual of a point, in square pixels; large if the map is not valid there.
    fn square(&self, position: &Vector2<T>, site: Vector2<T>) -> T {
        self.at(position).map_or(self.unit * self.unit, |local| local.residual(site).norm_squared())
    }

    /// Returns the robust cost (Geman-McClure) including the prior.
    fn cost<const N: usize>(
        &self,
        lattice: &Lattice<N>,
        points: &Points<T, N>,
        cut_squared: T,
        weights: &[T; COUNT],
    ) -> T {
        let mut cost = T::zero();
        for (position, site) in members(lattice, points) {
            let square = self.square(&position, site);
            cost += square * cut_squared / (cut_squared + square);
        }
        cost + self.cost_of_assumptions(weights)
    }

    fn cost_of_assumptions(&self, weights: &[T; COUNT]) -> T {
        let mut cost = T::zero();
        for ((&parameter, &weight), assumed) in self.parameters.iter().zip(weights).zip(ASSUMED) {
            let offset = parameter - nalgebra::convert(assumed);
            cost += offset * offset * weight;
        }
        cost
    }

    /// Returns the normal equations of the cost, and the cost.
    fn normal_equations<const N: usize>(
        &self,
        lattice: &Lattice<N>,
        points: &Points<T, N>,
        cut_squared: T,
        weights: &[T; COUNT],
    ) -> (System<T>, T) {
        let mut normal = [[T::zero(); COUNT]; COUNT];
        let mut gradient = [T::zero(); COUNT];
        let mut cost = self.cost_of_assumptions(weights);
        for (position, site) in members(lattice, points) {
            let Some(local) = self.at(&position) else {
                let square = self.unit * self.unit;
                cost += square * cut_squared / (cut_squared + square);
                continue;
            };
            let residual = local.residual(site);
            let square = residual.norm_squared();
            let share = cut_squared / (cut_squared + square);
            cost += square * share;
            let weight = share * share;
            let [by_x, by_y] = local.slopes(self.unit);
            for row in 0..COUNT {
                let (x, y) = (by_x[row] * weight, by_y[row] * weight);
                for column in 0..=row {
                    normal[row][column] += x * by_x[column] + y * by_y[column];
                }
                gradient[row] += x * residual.x + y * residual.y;
            }
        }
        for index in 0..COUNT {
            normal[index][index] += weights[index];
            gradient[index] += (self.parameters[index] - nalgebra::convert(ASSUMED[index])) * weights[index];
        }
        (System { normal, gradient }, cost)
    }
}

/// The normal equations of one Gauss-Newton step.
struct System<T> {
    /// Lower triangle.
    normal: [[T; COUNT]; COUNT],
    gradient: [T; COUNT],
}

/// Returns the weights of the prior.
fn assumption_weights<T: RealField + Copy>(step: Step) -> [T; COUNT] {
    let firm_from = match step {
        Step::Homography => FIRST_OF_LENS,
        Step::Distortion => FIRST_OF_LENS + 1,
        Step::All | Step::Robust => COUNT,
    };
    core::array::from_fn(|index| {
        let spread = SPREAD[index];
        let ratio = if spread > 0.0 { NOMINAL_SCATTER / spread } else { 0.0 };
        let firmness = if index < firm_from { 1.0 } else { FIRM };
        nalgebra::convert(ratio * ratio * firmness)
    })
}

/// Returns the points of a lattice in the image, with their lattice coordinates.
fn members<'a, T: RealField + Copy, const N: usize>(
    lattice: &'a Lattice<N>,
    points: &'a Points<T, N>,
) -> impl Iterator<Item = (Vector2<T>, Vector2<T>)> + 'a {
    lattice.sites().iter().filter_map(|site| points.position(site.point).map(|position| (position, site.position())))
}

impl<T: RealField + Copy> Precision<T> {
    /// Returns the deviation of a point from its site. For a `member` of the fitted lattice, the deviation is relative
    /// to the map fitted without it.
    pub fn deviation(&self, local: &Local<T>, site: Vector2<T>, member: bool) -> Deviation<T> {
        let mut residual = local.residual(site);
        let mut variance = self.variance(local);
        if member {
            let share = self.cut_squared / (self.cut_squared + residual.norm_squared());
            let weight = share * share;
            if let Some(inverse) = (Matrix2::identity() - variance * weight).try_inverse() {
                residual = inverse * residual;
                variance *= inverse;
            }
        }
        let normalized = (Matrix2::identity() + variance).try_inverse().map_or(residual, |inverse| inverse * residual);
        Deviation {
            distance_squared: residual.norm_squared(),
            normalized_squared: residual.dot(&normalized),
            variance: variance.trace(),
        }
    }

    /// Returns the covariance of the map's image of a lattice point.
    fn variance(&self, local: &Local<T>) -> Matrix2<T> {
        let [mut by_x, mut by_y] = local.slopes(self.unit);
        let (mut xx, mut xy, mut yy) = (T::zero(), T::zero(), T::zero());
        for row in 0..COUNT {
            let (mut x, mut y) = (by_x[row], by_y[row]);
            for column in 0..row {
                x -= by_x[column] * self.factor[row][column];
                y -= by_y[column] * self.factor[row][column];
            }
            let inverse = T::one() / self.factor[row][row];
            (x, y) = (x * inverse, y * inverse);
            (by_x[row], by_y[row]) = (x, y);
            xx += x * x;
            xy += x * y;
            yy += y * y;
        }
        Matrix2::new(xx, xy, xy, yy)
    }
}

/// Returns the lower triangular factor of a matrix whose diagonal was increased by `damping` × itself; `None` if it is
/// not clearly positive definite.
fn cholesky<T: RealField + Copy>(matrix: &[[T; COUNT]; COUNT], damping: T) -> Option<[[T; COUNT]; COUNT]> {
    let mut matrix = *matrix;
    let least: T = nalgebra::convert(1e-9);
    for column in 0..COUNT {
        let mut pivot = matrix[column][column] * (T::one() + damping);
        let before = pivot;
        for entry in matrix[column].iter().take(column) {
            pivot -= *entry * *entry;
        }
        if pivot <= before * least || !pivot.is_finite() {
            return None;
        }
        let root = pivot.sqrt();
        let inverse = T::one() / root;
        matrix[column][column] = root;
        for row in column + 1..COUNT {
            let mut value = matrix[row][column];
            for (left, right) in matrix[row].iter().zip(&matrix[column]).take(column) {
                value -= *left * *right;
            }
            matrix[row][column] = value * inverse;
        }
    }
    Some(matrix)
}

/// Solves L Lᵀ x = b.
fn solve<T: RealField + Copy>(factor: &[[T; COUNT]; COUNT], mut right: [T; COUNT]) -> [T; COUNT] {
    for row in 0..COUNT {
        let mut value = right[row];
        for inner in 0..row {
            value -= factor[row][inner] * right[inner];
        }
        right[row] = value / factor[row][row];
    }
    for row in (0..COUNT).rev() {
        let mut value = right[row];
        for inner in row + 1..COUNT {
            value -= factor[inner][row] * right[inner];
        }
        right[row] = value / factor[row][row];
    }
    right
}

#[cfg(test)]
mod tests {
    use super::super::GridCandidate;
    use super::super::settle::{APPROACH, FIT};
    use super::super::warp::LatticeImage;
    use super::*;

    /// Returns the map from (u, v) to pixels of a board seen through a lens of exactly this form.
    fn truth() -> LatticeImage<f64> {
        let parameters = [9.0, 2.0, 0.5, -1.5, 10.0, -0.3, 0.3, -0.2, -0.5, 0.05, 0.02, -0.03];
        let warp = Warp { middle: Vector2::new(172.5, 129.5), unit: 216.0, parameters };
        LatticeImage::new(&warp).unwrap()
    }

    fn lattice_of(sites: impl Iterator<Item = (i32, i32)> + Clone) -> (Points<f64, 64>, Lattice<64>) {
        let image = truth();
        let pixel = |u, v| image.at(u, v).unwrap();
        let candidates: std::vec::Vec<_> =
            sites.clone().map(|(u, v)| GridCandidate { center: pixel(u, v), radius: 0.0 }).collect();
        let mut points = Points::new();
        assert!(points.load(&candidates));
        let mut lattice = Lattice::new();
        for (u, v) in sites {
            let point = points.nearest(&pixel(u, v), 1e-6).unwrap().point;
            assert!(lattice.place(u, v, point));
        }
        (points, lattice)
    }

    #[test]
    fn a_map_of_the_fitted_form_is_recovered() {
        let sites = (-3..=3).flat_map(|v| (-3..=3).map(move |u| (u, v)));
        let (points, lattice) = lattice_of(sites);
        let mut warp = Warp::affine(&lattice, &points, (346.0, 260.0)).unwrap();
        let mut squares = Vec::<f64, 64>::new();
        let schedule = [&APPROACH[..], &FIT].concat();
        let precision = warp.fit(&lattice, &points, &schedule, &mut squares).unwrap();
        for site in lattice.sites() {
            let local = warp.at(&points.position(site.point).unwrap()).unwrap();
            let deviation = precision.deviation(&local, site.position(), true);
            // The prior of the lens adds a small bias.
            assert!(deviation.distance_squared.sqrt() < 0.1, "{site:?}: {deviation:?}");
        }
        assert!(warp.median_square(&lattice, &points, &mut squares).unwrap().sqrt() < 0.02);
    }

    #[test]
    fn lattice_to_image_and_back() {
        let image = truth();
        let parameters = [9.0, 2.0, 0.5, -1.5, 10.0, -0.3, 0.3, -0.2, -0.5, 0.05, 0.02, -0.03];
        let warp = Warp { middle: Vector2::new(172.5, 129.5), unit: 216.0, parameters };
        for v in -4..=4 {
            for u in -4..=4 {
                let site = warp.at(&image.at(u, v).unwrap()).unwrap().site;
                assert!((site - Vector2::new(f64::from(u), f64::from(v))).norm() < 1e-6, "({u}, {v}): {site}");
            }
        }
    }

    #[test]
    fn steps_and_slopes_are_derivatives() {
        let parameters = [9.0, 2.0, 0.5, -1.5, 10.0, -0.3, 0.3, -0.2, -0.5, 0.05, 0.02, -0.03];
        let warp = Warp { middle: Vector2::new(172.5, 129.5), unit: 216.0, parameters };
        let pixel = Vector2::new(250.0, 90.0);
        let local = warp.at(&pixel).unwrap();
        let step = 1e-4;
        for axis in 0..2 {
            let mut moved = pixel;
            moved[axis] += step;
            let change = (warp.at(&moved).unwrap().site - local.site) / step;
            let mut unit = Vector2::zeros();
            unit[axis] = 1.0;
            assert!((local.steps * change - unit).norm() < 1e-4);
        }
        let slopes = local.slopes(warp.unit);
        for (index, (&by_x, &by_y)) in slopes[0].iter().zip(&slopes[1]).enumerate() {
            let mut other = warp;
            other.parameters[index] += 1e-6;
            let change = local.steps * (other.at(&pixel).unwrap().site - local.site) / 1e-6;
            let slope = Vector2::new(by_x, by_y);
            assert!((change - slope).norm() < 1e-3 * (1.0 + slope.norm()), "{index}: {change} and {slope}");
        }
    }
}

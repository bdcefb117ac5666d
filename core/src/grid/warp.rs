//! From image to lattice coordinates: a homography behind a lens.
//!
//! A pixel (x, y), relative to the distortion centre and in units of half the image diagonal,
//! stands for the ray (x, y, 1 + λ₁ s + λ₂ s²), s = x² + y² (the division model of Fitzgibbon, CVPR
//! 2001, with a second term); a homography takes rays to lattice coordinates. Twelve parameters: eight of
//! the homography, λ₁, λ₂ and the centre. Weak assumptions about the last six (moderate slant and
//! distortion, centre near the middle of the image) let few points suffice. The map follows
//! perspective and lenses up to fisheyes closely enough that what does not fit it is no circle of the board.

use heapless::Vec;
use nalgebra::{Matrix2, Matrix3, RealField, Vector2, Vector3};

use super::lattice::Lattice;
use super::placement::Axes;
use super::points::Points;
use super::select::select;

/// Number of parameters: a, b, c, d, e, f, g, h of the homography [a b c; d e f; g h 1], λ₁, λ₂,
/// centre x, y.
const COUNT: usize = 12;

/// What is assumed of λ₁; of all others that they are around zero. From pinhole (0) to fisheye (-0.8).
const ASSUMED: [f64; COUNT] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.35, 0.0, 0.0, 0.0];
/// Standard deviations of what is assumed; zero: nothing is.
const SPREAD: [f64; COUNT] = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.4, 0.2, 0.1, 0.1];
/// Scatter of the points in pixels against which the assumptions are weighed.
const NOMINAL_SCATTER: f64 = 0.5;
/// Points off by this many times the median keep a quarter of their weight.
const CUT: f64 = 3.0;

/// Index of the first parameter of the lens.
const FIRST_OF_LENS: usize = 8;
/// Factor on the weight of what is assumed of parameters that are not to move yet.
const FIRM: f64 = 1e6;
/// Most attempts at a step, with ever more damping.
const ATTEMPTS: usize = 5;

/// A step that leaves more than this part of the cost is the last of its kind.
const ENOUGH: f64 = 0.98;

/// What a step of a fit does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// Moves the homography; the lens stays as assumed, without which the lens would take on what is
    /// perspective. Points far off weigh as much as others.
    Homography,
    /// Moves the homography and λ₁.
    Distortion,
    /// Moves all parameters.
    All,
    /// Moves all parameters, with little weight on points far off.
    Robust,
}

/// A map from the image to the lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Warp<T> {
    /// Middle of the image, pixels.
    middle: Vector2<T>,
    /// Half the image diagonal, pixels.
    unit: T,
    parameters: [T; COUNT],
}

/// The map at one pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Local<T> {
    /// Lattice coordinates.
    pub site: Vector2<T>,
    /// Pixels per lattice step (columns: u, v).
    pub steps: Matrix2<T>,
    /// The ray, divided by the denominator of the homography.
    ray: [T; 3],
    /// How the lattice coordinates depend on the third coordinate of the ray.
    by_depth: Vector2<T>,
    /// Squared distance from the distortion centre.
    squared: T,
}

impl<T: RealField + Copy> Local<T> {
    /// Offset in pixels from where the map puts lattice point `site`.
    pub fn residual(&self, site: Vector2<T>) -> Vector2<T> {
        self.steps * (self.site - site)
    }

    /// Distance to the nearest lattice neighbour in pixels, squared.
    pub fn spacing_squared(&self) -> T {
        let (u, v) = (self.steps.column(0), self.steps.column(1));
        u.norm_squared().min(v.norm_squared()).min((u + v).norm_squared()).min((u - v).norm_squared())
    }

    /// Derivatives of the residual with respect to the parameters: those of x, then those of y.
    fn slopes(&self, unit: T) -> [[T; COUNT]; 2] {
        let [x, y, depth] = self.ray;
        let inward = -(self.steps * self.site);
        let deeper = self.steps * self.by_depth;
        let s = self.squared;
        core::array::from_fn(|axis| {
            let (along_u, along_v) = (self.steps[(axis, 0)], self.steps[(axis, 1)]);
            let (inward, deeper) = (inward[axis], deeper[axis]);
            let by_center = if axis == 0 { (-unit, T::zero()) } else { (T::zero(), -unit) };
            [
                along_u * x,
                along_u * y,
                along_u * depth,
                along_v * x,
                along_v * y,
                along_v * depth,
                inward * x,
                inward * y,
                deeper * s,
                deeper * s * s,
                by_center.0,
                by_center.1,
            ]
        })
    }
}

impl<T: RealField + Copy> Warp<T> {
    /// The affine map that fits a lattice best.
    pub fn affine<const N: usize>(lattice: &Lattice<N>, points: &Points<T, N>, image_size: (f64, f64)) -> Option<Self> {
        let half: T = nalgebra::convert(0.5);
        let size = Vector2::new(nalgebra::convert::<f64, T>(image_size.0), nalgebra::convert(image_size.1));
        let middle = (size - Vector2::repeat(T::one())) * half;
        let unit = size.norm() * half;
        let affine = lattice.affine(points)?;
        let back = affine.steps.try_inverse()?;
        let offset = back * (middle - affine.mean_position) + affine.mean_site;
        let mut parameters = [T::zero(); COUNT];
        parameters[8] = nalgebra::convert(ASSUMED[8]);
        parameters[0] = back[(0, 0)] * unit;
        parameters[1] = back[(0, 1)] * unit;
        parameters[2] = offset.x;
        parameters[3] = back[(1, 0)] * unit;
        parameters[4] = back[(1, 1)] * unit;
        parameters[5] = offset.y;
        Some(Self { middle, unit, parameters })
    }

    /// The map at a pixel; none where it is not one to one and right side up.
    pub fn at(&self, pixel: &Vector2<T>) -> Option<Local<T>> {
        let [a, b, c, d, e, f, g, h, first, second, center_x, center_y] = self.parameters;
        let two: T = nalgebra::convert(2.0);
        let place = (pixel - self.middle) / self.unit - Vector2::new(center_x, center_y);
        let (x, y) = (place.x, place.y);
        let s = place.norm_squared();
        let depth = T::one() + (first + second * s) * s;
        let denominator = g * x + h * y + depth;
        if denominator < nalgebra::convert(1e-3) {
            return None;
        }
        let scale = T::one() / denominator;
        let u = (a * x + b * y + c * depth) * scale;
        let v = (d * x + e * y + f * depth) * scale;
        let by_depth = Vector2::new(c - u, f - v) * scale;
        let depth_slope = (first + second * s * two) * two;
        let by_x = Vector2::new(a - u * g, d - v * g) * scale + by_depth * (depth_slope * x);
        let by_y = Vector2::new(b - u * h, e - v * h) * scale + by_depth * (depth_slope * y);
        let determinant = by_x.perp(&by_y);
        if determinant <= T::zero() {
            return None;
        }
        let factor = self.unit / determinant;
        let steps = Matrix2::new(by_y.y, -by_y.x, -by_x.y, by_x.x) * factor;
        Some(Local {
            site: Vector2::new(u, v),
            steps,
            ray: [x * scale, y * scale, depth * scale],
            by_depth,
            squared: s,
        })
    }
}

/// Focal lengths tried by [`LatticeImage::shear`], in units of half the image diagonal: from a fisheye to a
/// telephoto lens.
const FOCAL_LENGTHS: [f64; 7] = [0.5, 0.75, 1.1, 1.6, 2.4, 3.6, 5.4];

/// The same map the other way: from lattice to image.
#[derive(Clone, Copy, Debug)]
pub(super) struct LatticeImage<T> {
    warp: Warp<T>,
    to_ray: Matrix3<T>,
}

impl<T: RealField + Copy> LatticeImage<T> {
    /// None if the map is degenerate.
    pub fn new(warp: &Warp<T>) -> Option<Self> {
        let [a, b, c, d, e, f, g, h, ..] = warp.parameters;
        let to_ray = Matrix3::new(a, b, c, d, e, f, g, h, T::one()).try_inverse()?;
        Some(Self { warp: *warp, to_ray })
    }

    /// How far the map is from showing a square lattice in a plane if `axes` takes lattice to board
    /// coordinates: the ratio of the board's two scales, at the focal length where it is least.
    /// 1 for the right axes, as the convergence of lines belongs to the slant; at least 2.6, if all
    /// is exact, for others. None if the map is degenerate.
    pub fn shear(&self, axes: &Axes) -> Option<T> {
        let axes = Matrix2::from_fn(|row, column| nalgebra::convert::<f64, T>(f64::from(axes[row][column])));
        let rays = self.to_ray.fixed_columns::<2>(0) * axes.try_inverse()?;
        let across = rays.fixed_rows::<2>(0).into_owned();
        let along = rays.fixed_rows::<1>(2).into_owned();
        let two: T = nalgebra::convert(2.0);
        let mut least: Option<T> = None;
        for focal_length in FOCAL_LENGTHS {
            let squared: T = nalgebra::convert(focal_length * focal_length);
            let metric = across.transpose() * across + along.transpose() * along * squared;
            // For scales s ≥ t: (s² + t²) / (s t) = r + 1/r with r = s/t.
            let half_sum = metric.trace() / metric.determinant().sqrt() / two;
            let ratio = half_sum + (half_sum * half_sum - T::one()).max(T::zero()).sqrt();
            if ratio.is_finite() {
                least = Some(least.map_or(ratio, |known| known.min(ratio)));
            }
        }
        least
    }

    /// The pixel of a lattice site; none if it lies beyond what the lens can show.
    pub fn at(&self, (u, v): (i32, i32)) -> Option<Vector2<T>> {
        let [.., first, second, center_x, center_y] = self.warp.parameters;
        let site = Vector3::new(nalgebra::convert(f64::from(u)), nalgebra::convert(f64::from(v)), T::one());
        let ray = self.to_ray * site;
        if ray.z <= T::zero() {
            return None;
        }
        let direction = ray.xy() / ray.z;
        let s = direction.norm_squared();
        let (two, four): (T, T) = (nalgebra::convert(2.0), nalgebra::convert(4.0));
        // The radius shrinks by the factor k with k = 1 + λ₁ s k² + λ₂ s² k⁴: Newton's method, from
        // the solution for λ₂ = 0.
        let mut k = two / (T::one() + (T::one() - four * first * s).max(T::zero()).sqrt());
        for _ in 0..5 {
            let value = T::one() + (first + second * s * k * k) * s * k * k - k;
            let slope = (first * two + second * s * k * k * four) * s * k - T::one();
            if slope >= T::zero() {
                return None;
            }
            k -= value / slope;
        }
        let place = direction * k + Vector2::new(center_x, center_y);
        let pixel = place * self.warp.unit + self.warp.middle;
        // Where Newton's method went astray, the map back does not agree.
        let back = self.warp.at(&pixel)?.site;
        let tolerance: T = nalgebra::convert(0.1);
        ((back - site.xy()).norm() < tolerance).then_some(pixel)
    }
}

/// The precision of a fitted map, with which single points are judged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Precision<T> {
    /// Lower triangular factor of the normal matrix.
    factor: [[T; COUNT]; COUNT],
    /// Square of the distance at which a point has a quarter of its weight.
    cut_squared: T,
    unit: T,
}

/// A point against the map fitted to the others.
#[derive(Clone, Copy, Debug)]
pub(super) struct Deviation<T> {
    /// Squared distance in pixels.
    pub distance_squared: T,
    /// The same in units of its variance, if points scatter by 1 px along each axis.
    pub normalized_squared: T,
    /// Variance of the map there, both axes together, if points scatter by 1 px along each axis.
    pub variance: T,
}

impl<T: RealField + Copy> Warp<T> {
    /// Fits the map to a lattice by Levenberg-Marquardt steps from where it is. `squares` is scratch.
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

    /// Median of the squared distances of the lattice's points from their places, in pixels.
    pub fn median_square<const N: usize>(
        &self,
        lattice: &Lattice<N>,
        points: &Points<T, N>,
        squares: &mut Vec<T, N>,
    ) -> Option<T> {
        squares.clear();
        for (position, site) in members(lattice, points) {
            // As many as there are sites.
            let _ = squares.push(self.square(&position, site));
        }
        let rank = squares.len() / 2;
        select(squares, rank)
    }

    /// Squared residual of a point, in pixels; large where the map does not hold.
    fn square(&self, position: &Vector2<T>, site: Vector2<T>) -> T {
        self.at(position).map_or(self.unit * self.unit, |local| local.residual(site).norm_squared())
    }

    /// The robust cost (Geman and McClure's) with the assumptions.
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

    /// The normal equations of the cost, and the cost.
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

/// Weights of the assumptions.
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

/// The points of a lattice in the image, with their lattice coordinates.
fn members<'a, T: RealField + Copy, const N: usize>(
    lattice: &'a Lattice<N>,
    points: &'a Points<T, N>,
) -> impl Iterator<Item = (Vector2<T>, Vector2<T>)> + 'a {
    lattice.sites().iter().filter_map(|site| points.position(site.point).map(|position| (position, site.position())))
}

impl<T: RealField + Copy> Precision<T> {
    /// How far a point is off the site that the map has for it. A `member` of the fitted lattice is
    /// judged by the map without it.
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

    /// Covariance of the map's image of a lattice point.
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

/// Lower triangular factor of a matrix with its diagonal raised by `damping` × itself; none if it is
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

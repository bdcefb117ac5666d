//! Corners of tags, and crossings of squares, in a picture made of light, by least squares between the picture's own
//! pixels and the blurred print.
//!
//! The model of a pixel at p is a(p) + b(p) · B + (a₀ + b₀ · B) · q(p) + c · (1 − B²). B is the print around the corners,
//! blurred by a normal distribution and seen through a homography and, if it is known, the lens. The planes a and b and
//! the quadratic form q model uneven light; c models a camera whose response is not linear, and ink that spreads.
//! Homography and blur are estimated together with them, so the corners do not depend on the size of the squares or on
//! the blur. Nothing is taken between pixels, and the picture is not smoothed.
//!
//! A tag yields its four corners and the whole homography. Near a crossing there are only two lines, which determine the
//! position and the directions of the axes; scale and perspective come from the other points.

use evcal_geometry::board::homography::homography;
use evcal_geometry::board::squares::raster::Raster;
use evcal_geometry::board::tag::Tag;
use evcal_geometry::numerics::levenberg_marquardt::{Costed, Schedule, minimise};
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2};

use crate::bearings::{Bearings, Plane};
use crate::blurred_print::{NearLines, Print, Shade, Variance};
use crate::picture::{Picture, PixelResidual};

/// Width of the strip around a tag that is fitted too (px); at most the gap to the next square.
const MARGIN: f64 = 2.5;
/// Width of the print beyond this strip that is known, in modules: blur carries it into the strip.
const BEYOND: f64 = 2.5;
/// The fitted region extends from a crossing over this share of a square, so that its other sides need not be right, but
/// no farther than this (px), because more pixels take more time than they improve the crossing.
const CROSSING_SHARE: f64 = 0.7;
const CROSSING_REACH: f64 = 12.0;
/// Width of the print around a crossing that is known, in squares.
const CROSSING_PRINT: f64 = 1.5;
/// A blur from which a first fit can start: variances xx, xy, yy (px²).
pub const FIRST_BLUR: [f64; 3] = [0.5, 0.0, 0.5];
/// Limits of the standard deviation of the blur (px).
const BLURS: [f64; 2] = [0.15, 8.0];
/// Largest motion of a corner from its start (px).
const FARTHEST: f64 = 1.0;
/// Largest rms of the residuals, as a share of the difference between dark and light.
const MOST_RESIDUAL: f64 = 0.1;
/// Smallest difference between dark and light, as a share of the range of the pixels.
const LEAST_CONTRAST: f64 = 0.25;
const SCHEDULE: Schedule =
    Schedule { first_damping: 1e-4, smallest_damping: 1e-7, largest_damping: 1e2, most_steps: 15, smallest_gain: 1e-5 };

/// Number of parameters of a homography, of the blur, and of the light.
const MAP: usize = 8;
const SHAPE: usize = MAP + 3;
const LIGHT: usize = 10;
const UNKNOWNS: usize = SHAPE + LIGHT;

/// The parts of a board that are fitted.
pub struct PrintFits {
    patches: Vec<Patch>,
}

/// A part of a print in its own unit, with the origin in its middle.
struct Patch {
    /// Its middle on the board (m) and its unit (m).
    middle: Vector2<f64>,
    unit: f64,
    /// The points that it yields.
    points: Vec<Vector2<f64>>,
    print: Print,
    /// The fitted region extends this far from the middle, and farther by `margin` (px) but at most `beyond`.
    extent: f64,
    beyond: f64,
    margin: f64,
    /// 1 for each parameter of the homography that is estimated, 0 for the others.
    free: [f64; MAP],
}

/// A point of the board seen in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SeenPoint {
    /// Its position on the board (m).
    pub board: Vector2<f64>,
    /// Its position in the picture (px).
    pub pixel: Vector2<f64>,
}

/// The points of a patch in a picture.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedPoints {
    /// Their positions (px): the corners of a tag in the order of [`Tag::corners`], or a crossing.
    pub points: Vec<Vector2<f64>>,
    /// Standard deviation of a point along one axis (px), on average, if the residuals of the pixels are independent.
    pub sigma: f64,
    /// Variances of the blur: xx, xy, yy (px²).
    pub blur: [f64; 3],
    /// Standard deviation of the residuals as a share of the difference between dark and light.
    pub residual: f64,
    /// Residuals of the pixels of the fitted region.
    pub of_pixels: Vec<PixelResidual>,
}

/// A pixel of the fitted region.
struct Pixel {
    /// Its number in the picture.
    number: u32,
    /// Position on the plane on which lines are straight, and its derivative by the position in the picture.
    place: Vector2<f64>,
    by_pixel: Matrix2<f64>,
    /// 1 and the position in the picture relative to the middle of the patch, about −1 to 1.
    light: [f64; 3],
    value: f64,
}

/// A pixel on the print.
struct Placed {
    /// Its position.
    place: [f64; 2],
    /// Derivatives of this position by the pixel's, multiplied: x x, x y, y y.
    products: [[f64; 3]; 3],
    shade: Shade,
}

/// The estimate: the map from the plane to the print, the blur's variances (xx, xy, yy in px²), and the light: the
/// coefficients of b, a, q and c.
#[derive(Clone)]
struct Estimate {
    map: Matrix3<f64>,
    blur: Variance,
    light: SVector<f64, LIGHT>,
    equations: Equations,
}

/// Normal equations about an estimate.
#[derive(Clone)]
struct Equations {
    normal: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    right: SVector<f64, UNKNOWNS>,
    /// Sum of squares of the residuals, with the best light.
    cost: f64,
}

impl PrintFits {
    /// Prepares the fits of `tags` on a board with this `raster`.
    pub fn of_tags(tags: &[Tag], raster: &Raster) -> Self {
        Self { patches: tags.iter().map(|tag| Patch::of_tag(tag, raster)).collect() }
    }

    /// Prepares the fits of `crossings` of squares with this `side` on a board with this `raster` (m).
    pub fn of_crossings(crossings: &[Vector2<f64>], side: f64, raster: &Raster) -> Self {
        Self { patches: crossings.iter().map(|crossing| Patch::of_crossing(*crossing, side, raster)).collect() }
    }

    /// Fits tag or crossing `index` where the points in `seen` suggest, with about this `blur`. The picture's first pixel is at
    /// `position` on the sensor whose `lens` is known. `None` if it is not there, or its position is uncertain.
    pub fn fit(
        &self,
        picture: &Picture,
        position: [usize; 2],
        lens: Option<&Bearings>,
        index: usize,
        seen: &[SeenPoint],
        blur: [f64; 3],
    ) -> Option<FittedPoints> {
        self.patches.get(index)?.fit(picture, position, lens, seen, blur)
    }
}

impl Patch {
    fn of_tag(tag: &Tag, raster: &Raster) -> Self {
        let middle = tag.middle();
        let corners = tag.corners.map(Vector2::from);
        let half = (corners[0] - middle).amax();
        let module = 2.0 * half / tag.side as f64;
        // The gap ends at the next line beyond the tag.
        let beyond = |lines: &[f64], axis: usize| {
            let outside = |line: &f64| (line - middle[axis]).abs() - half;
            lines.iter().map(outside).filter(|outside| *outside > 1e-3 * half).fold(f64::INFINITY, f64::min)
        };
        let gap = beyond(raster.x_lines(), 0).min(beyond(raster.y_lines(), 1)).min(2.0 * half);
        let reach = half + gap + BEYOND * module;
        Self {
            middle,
            unit: half,
            points: corners.iter().map(|corner| (corner - middle) / half).collect(),
            print: Print::around(raster, middle, reach, half),
            extent: 1.0,
            beyond: gap / half,
            margin: MARGIN,
            free: [1.0; MAP],
        }
    }

    fn of_crossing(crossing: Vector2<f64>, side: f64, raster: &Raster) -> Self {
        Self {
            middle: crossing,
            unit: side,
            points: vec![Vector2::zeros()],
            print: Print::around(raster, crossing, CROSSING_PRINT * side, side),
            extent: 0.0,
            beyond: CROSSING_SHARE,
            margin: CROSSING_REACH,
            free: [0.0, 1.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0],
        }
    }

    fn fit(
        &self,
        picture: &Picture,
        position: [usize; 2],
        lens: Option<&Bearings>,
        seen: &[SeenPoint],
        blur: [f64; 3],
    ) -> Option<FittedPoints> {
        let nearest = seen.iter().map(|point| (point.board - self.middle).norm()).fold(f64::INFINITY, f64::min);
        let near = || seen.iter().filter(|point| (point.board - self.middle).norm() < nearest + 1e-3 * self.unit);
        let middle = near().map(|point| point.pixel).sum::<Vector2<f64>>() / near().count().max(1) as f64;
        let plane = Plane::new(lens, position, middle)?;
        let places = seen.iter().map(|point| plane.place(point.pixel)).collect::<Option<Vec<_>>>()?;
        let on_print: Vec<Vector2<f64>> = seen.iter().map(|point| (point.board - self.middle) / self.unit).collect();
        let map = homography(&places, &on_print)?;
        let pixels = self.pixels(picture, &plane, middle, &map)?;
        let best = self.best(&pixels, map, blur)?;
        self.fitted(&best, &pixels, &plane, &map)
    }

    /// Returns the pixels of the fitted region.
    fn pixels(&self, picture: &Picture, plane: &Plane, middle: Vector2<f64>, map: &Matrix3<f64>) -> Option<Vec<Pixel>> {
        let to_plane = map.try_inverse()?;
        let distance = |[u, v]: [f64; 2]| Some((seen_at(&to_plane, plane, Vector2::new(u, v))? - middle).norm());
        let [a, b, c, d] = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(distance);
        let distances = [a?, b?, c?, d?];
        let unit = 0.25 * distances.iter().sum::<f64>() * std::f64::consts::FRAC_1_SQRT_2;
        let reach = self.extent + self.beyond.min(self.margin / unit);
        let radius = distances.into_iter().fold(0.0, f64::max) * reach;
        if !radius.is_finite() || radius < 1.0 {
            return None;
        }
        let range = |middle: f64, size: usize| {
            let first = (middle - radius).ceil().max(0.0) as usize;
            first..((middle + radius).floor() + 1.0).clamp(first as f64, size.max(first) as f64) as usize
        };
        let (columns, rows) = (range(middle.x, picture.width()), range(middle.y, picture.height()));
        let mut pixels = Vec::with_capacity(columns.len() * rows.len());
        for y in rows {
            for x in columns.clone() {
                let Some((place, by_pixel)) = plane.place_of_pixel(x, y) else { continue };
                let at = map * place.push(1.0);
                let inside = at.z > 0.0 && at.x.abs() <= reach * at.z && at.y.abs() <= reach * at.z;
                let index = y * picture.width() + x;
                let Some(value) = picture.values().get(index).filter(|_| inside) else { continue };
                let light = [1.0, (x as f64 - middle.x) / radius, (y as f64 - middle.y) / radius];
                pixels.push(Pixel { number: index as u32, place, by_pixel, light, value: f64::from(*value) });
            }
        }
        Some(pixels)
    }

    /// Returns the best estimate from `map` and `blur` on.
    fn best(&self, pixels: &[Pixel], map: Matrix3<f64>, blur: Variance) -> Option<Estimate> {
        let [low, high] = range(pixels);
        let mut light = SVector::zeros();
        (light[0], light[3]) = (0.5 * (high - low), 0.5 * (high + low));
        let mut first = self.estimate(pixels, map, blur, light)?;
        if first.light[0] < 0.0 {
            // Where dark and light squares only alternate, either may be the dark ones.
            first = self.estimate(pixels, map, blur, first.light)?;
        }
        let mut best = Costed { cost: first.equations.cost, estimate: first };
        let steps = minimise(
            &mut best,
            &SCHEDULE,
            |_| (),
            |estimate, (), damping| {
                let step = estimate.equations.solve(damping)?;
                let change = Matrix3::new(step[0], step[1], step[2], step[3], step[4], step[5], step[6], step[7], 0.0);
                let map = estimate.map - change * estimate.map;
                let blur = std::array::from_fn(|part| estimate.blur[part] + step[MAP + part]);
                let light = step.fixed_rows::<LIGHT>(SHAPE).into_owned();
                let estimate = self.estimate(pixels, map / map.norm(), blur, light)?;
                Some(Costed { cost: estimate.equations.cost, estimate })
            },
        );
        (steps < SCHEDULE.most_steps).then_some(best.estimate)
    }

    /// Sets up the equations about an estimate; `None` if it is not possible.
    fn estimate(
        &self,
        pixels: &[Pixel],
        map: Matrix3<f64>,
        blur: Variance,
        light: SVector<f64, LIGHT>,
    ) -> Option<Estimate> {
        let [xx, xy, yy] = blur;
        let (least, most) = (BLURS[0] * BLURS[0], BLURS[1] * BLURS[1]);
        // Both eigenvalues are within the limits.
        let within = xx > least && yy > least && (xx - least) * (yy - least) > xy * xy && xx < most && yy < most;
        // The contrast has one sign everywhere.
        if !within || light[0].abs() <= light[1].abs() + light[2].abs() {
            return None;
        }
        let mut products = Products::default();
        let mut rows = Vec::with_capacity(TOGETHER);
        let mut near = NearLines::default();
        for pixel in pixels {
            let Placed { place: [u, v], products: [pp, pq, qq], shade } = self.placed(pixel, &map, blur, &mut near);
            let Pixel { light: [_, x, y], value, .. } = pixel;
            let b = shade.value;
            let (even, form) = (light[3] + light[0] * b, [x * x, x * y, y * y]);
            let [l0, l1, l2] = form.map(|form| even * form);
            let curved = 1.0 + light[6] * form[0] + light[7] * form[1] + light[8] * form[2];
            let contrast = light[0] * curved + light[1] * x + light[2] * y - 2.0 * light[9] * b;
            let [s, t] = shade.by_place.map(|slope| contrast * slope);
            let bend = -(s * u + t * v);
            let by_blur = |part: usize| {
                let [of_pp, of_pq, of_qq] = shade.by_variance;
                contrast * (of_pp * pp[part] + of_pq * pq[part] + of_qq * qq[part])
            };
            let mut row = [
                // The map changes to (1 − step) · map.
                -s * u,
                -s * v,
                -s,
                -t * u,
                -t * v,
                -t,
                -bend * u,
                -bend * v,
                by_blur(0),
                by_blur(1),
                by_blur(2),
                b,
                b * x,
                b * y,
                1.0,
                *x,
                *y,
                l0,
                l1,
                l2,
                1.0 - b * b,
                *value,
                0.0,
                0.0,
            ];
            for (entry, free) in row.iter_mut().zip(&self.free) {
                *entry *= free;
            }
            rows.push(row);
            if rows.len() == TOGETHER {
                products.add(&rows);
                rows.clear();
            }
        }
        products.add(&rows);
        let (mut normal, right, squares) = products.equations();
        for (index, free) in self.free.iter().enumerate() {
            normal[(index, index)] += 1.0 - free;
        }
        let lights = normal.fixed_view::<LIGHT, LIGHT>(SHAPE, SHAPE).into_owned();
        let best = lights.cholesky()?.solve(&right.fixed_rows::<LIGHT>(SHAPE).into_owned());
        let cost = squares - best.dot(&right.fixed_rows::<LIGHT>(SHAPE));
        let equations = Equations { normal, right, cost: cost.max(0.0) };
        cost.is_finite().then_some(Estimate { map, blur, light: best, equations })
    }

    /// Returns where `map` has the pixel on the print, and the shade of the blurred print there.
    fn placed(&self, pixel: &Pixel, map: &Matrix3<f64>, blur: Variance, near: &mut NearLines) -> Placed {
        let by_pixel = &pixel.by_pixel;
        let at = map * pixel.place.push(1.0);
        let inverse = 1.0 / at.z;
        let (u, v) = (at.x * inverse, at.y * inverse);
        let slope = |row: usize, value: f64| {
            let (a, b) = (map[(row, 0)] - value * map[(2, 0)], map[(row, 1)] - value * map[(2, 1)]);
            [
                (a * by_pixel[(0, 0)] + b * by_pixel[(1, 0)]) * inverse,
                (a * by_pixel[(0, 1)] + b * by_pixel[(1, 1)]) * inverse,
            ]
        };
        let (p, q) = (slope(0, u), slope(1, v));
        let product = |a: [f64; 2], b: [f64; 2]| [a[0] * b[0], a[0] * b[1] + a[1] * b[0], a[1] * b[1]];
        let products = [product(p, p), product(p, q), product(q, q)];
        let across = products.map(|of| blur[0] * of[0] + blur[1] * of[1] + blur[2] * of[2]);
        Placed { place: [u, v], products, shade: self.print.shade([u, v], across, near) }
    }

    /// Returns the residuals of the pixels.
    fn residuals(&self, best: &Estimate, pixels: &[Pixel]) -> Vec<PixelResidual> {
        let light = &best.light;
        let mut near = NearLines::default();
        let residual = |pixel: &Pixel| {
            let b = self.placed(pixel, &best.map, best.blur, &mut near).shade.value;
            let [_, x, y] = pixel.light;
            let form = light[6] * x * x + light[7] * x * y + light[8] * y * y;
            let even = light[3] + light[0] * b;
            let slopes = (light[1] * b + light[4]) * x + (light[2] * b + light[5]) * y;
            let value = even * (1.0 + form) + slopes + light[9] * (1.0 - b * b);
            PixelResidual { pixel: pixel.number, value: value as f32, error: (pixel.value - value) as f32 }
        };
        pixels.iter().map(residual).collect()
    }

    /// Returns the points, unless they are uncertain or far from where the map `start` has them.
    fn fitted(&self, best: &Estimate, pixels: &[Pixel], plane: &Plane, start: &Matrix3<f64>) -> Option<FittedPoints> {
        let (inverse, start) = (best.map.try_inverse()?, start.try_inverse()?);
        let freedom = pixels.len().checked_sub(UNKNOWNS).filter(|freedom| *freedom > 0)?;
        let variance = best.equations.cost / freedom as f64;
        let covariance = best.equations.covariance(&self.free)? * variance;
        let mut points = Vec::with_capacity(self.points.len());
        let mut squares = 0.0;
        for at in &self.points {
            let seen = |at: Vector2<f64>| seen_at(&inverse, plane, at);
            let pixel = seen(*at)?;
            let moved = (pixel - seen_at(&start, plane, *at)?).norm();
            if moved.is_nan() || moved > FARTHEST {
                return None;
            }
            points.push(pixel);
            // Derivative of the point in the picture by its place on the print, and of that place by the parameters.
            let step = 1e-4;
            let by_place = Matrix2::from_columns(&[
                (seen(at + Vector2::new(step, 0.0))? - pixel) / step,
                (seen(at + Vector2::new(0.0, step))? - pixel) / step,
            ]);
            let (u, v) = (at.x, at.y);
            let [first, second] =
                [[u, v, 1.0, 0.0, 0.0, 0.0, -u * u, -u * v], [0.0, 0.0, 0.0, u, v, 1.0, -u * v, -v * v]];
            let by_map: SMatrix<f64, 2, MAP> = by_place * SMatrix::from_rows(&[first.into(), second.into()]);
            squares += (by_map * covariance * by_map.transpose()).trace() / 2.0;
        }
        let contrast = 2.0 * best.light[0].abs();
        let residual = variance.sqrt() / contrast;
        let sigma = (squares / self.points.len() as f64).sqrt();
        let of_pixels = self.residuals(best, pixels);
        let fitted = FittedPoints { points, sigma, blur: best.blur, residual, of_pixels };
        let [low, high] = range(pixels);
        let is_visible = contrast >= LEAST_CONTRAST * (high - low);
        (is_visible && fitted.sigma.is_finite() && (0.0..=MOST_RESIDUAL).contains(&residual)).then_some(fitted)
    }
}

/// Returns the position in the picture of a point of the print, with the map from the print to the plane.
fn seen_at(to_plane: &Matrix3<f64>, plane: &Plane, at: Vector2<f64>) -> Option<Vector2<f64>> {
    let place = to_plane * at.push(1.0);
    plane.pixel(place.xy() / place.z)
}

/// Returns the smallest and the largest value.
fn range(pixels: &[Pixel]) -> [f64; 2] {
    let values = || pixels.iter().map(|pixel| pixel.value);
    [values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max)]
}

/// Number of sums that the processor adds at a time, and of pixels that are added one after another.
const LANES: usize = 8;
const TOGETHER: usize = 32;
/// A pixel's derivatives by all unknowns, its value, and zeros.
type Row = [f64; (UNKNOWNS + 1).next_multiple_of(LANES)];

/// Sums of the products of the derivatives and the value over all pixels: for each its products with those up to it.
#[derive(Default)]
struct Products([Row; UNKNOWNS + 1]);

impl Products {
    fn add(&mut self, rows: &[Row]) {
        add_products(&mut self.0, rows);
    }

    /// Returns the normal matrix, its right-hand side, and the sum of the squares of the values.
    fn equations(&self) -> (SMatrix<f64, UNKNOWNS, UNKNOWNS>, SVector<f64, UNKNOWNS>, f64) {
        let product = |a: usize, b: usize| self.0[a.max(b)][a.min(b)];
        let right = SVector::from_fn(|row, _| product(row, UNKNOWNS));
        (SMatrix::from_fn(product), right, product(UNKNOWNS, UNKNOWNS))
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn add_products(sums: &mut [Row; UNKNOWNS + 1], rows: &[Row]) {
    for (index, sums) in sums.iter_mut().enumerate() {
        for block in 0..index / LANES + 1 {
            let range = block * LANES..(block + 1) * LANES;
            let (Some(sums), rows) = (sums.get_mut(range.clone()), rows.iter()) else { continue };
            let mut total = [0.0; LANES];
            for row in rows {
                let (factor, others) = (row[index], &row[range.clone()]);
                for (sum, other) in total.iter_mut().zip(others) {
                    *sum += factor * other;
                }
            }
            for (sum, total) in sums.iter_mut().zip(total) {
                *sum += total;
            }
        }
    }
}

impl Equations {
    /// Returns the step of map and blur, and the light after it.
    fn solve(&self, damping: f64) -> Option<SVector<f64, UNKNOWNS>> {
        let mut damped = self.normal;
        for index in 0..SHAPE {
            damped[(index, index)] *= 1.0 + damping;
        }
        Some(damped.cholesky()?.solve(&self.right))
    }

    /// Returns the covariance of the map, of which only some parameters are `free`, for residuals of variance 1.
    fn covariance(&self, free: &[f64; MAP]) -> Option<SMatrix<f64, MAP, MAP>> {
        let free = SMatrix::<f64, MAP, MAP>::from_diagonal(&(*free).into());
        Some(free * self.normal.cholesky()?.inverse().fixed_view::<MAP, MAP>(0, 0) * free)
    }
}

#[cfg(test)]
mod tests;

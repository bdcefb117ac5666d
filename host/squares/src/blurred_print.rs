//! The shade of a blurred print at a point, with derivatives.
//!
//! The print consists of dark and light rectangles between straight lines. It is blurred by a normal distribution whose
//! axes may have any direction and lengths. At a crossing of two lines the exact shade is a normal distribution of two
//! variables; here it is expanded in the correlation ρ of both axes (Mehler 1866), up to the second order.

use std::sync::LazyLock;

use evcal_geometry::board::squares::raster::Raster;
use nalgebra::Vector2;

/// Distance in standard deviations beyond which a line has no effect (1.3e-5 of the contrast).
const REACH: f64 = 4.2;
/// Steps per standard deviation in the table of the normal distribution.
const STEPS: f64 = 64.0;

/// Normal distribution function and density at the steps of the table.
static NORMAL: LazyLock<Vec<[f64; 2]>> = LazyLock::new(|| {
    let count = (2.0 * REACH * STEPS).ceil() as usize + 2;
    (0..count).map(|step| exact(step as f64 / STEPS - REACH)).collect()
});

fn exact(z: f64) -> [f64; 2] {
    let share = 0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2);
    let density = libm::exp(-0.5 * z * z) / std::f64::consts::TAU.sqrt();
    [share, density]
}

/// A line near a point: the share of the light from beyond it, the density of the normal distribution there, and the
/// distance of the point from it in standard deviations.
#[derive(Clone, Copy)]
struct Near {
    share: f64,
    density: f64,
    z: f64,
}

impl Near {
    /// `z` is within [`REACH`].
    fn new(table: &[[f64; 2]], z: f64) -> Self {
        let place = (z + REACH) * STEPS;
        let step = place as usize;
        let (Some(&[low, slope]), Some(&[high, next])) = (table.get(step), table.get(step + 1)) else {
            let [share, density] = exact(z);
            return Self { share, density, z };
        };
        // Hermite's cubic of the distribution function, whose slopes are the densities; and its derivative.
        let t = place - step as f64;
        let (rise, slope, next) = (high - low, slope / STEPS, next / STEPS);
        let (b, c) = (3.0 * rise - 2.0 * slope - next, slope + next - 2.0 * rise);
        let share = low + t * (slope + t * (b + t * c));
        let density = (slope + t * (2.0 * b + 3.0 * t * c)) * STEPS;
        Self { share, density, z }
    }
}

/// Lines near a point along both axes. It is reused, because it is needed for every pixel.
#[derive(Default)]
pub(crate) struct NearLines {
    along: [Vec<Near>; 2],
}

/// Variances and covariance of the blur along the axes of the print: xx, xy, yy.
pub(crate) type Variance = [f64; 3];

/// A shade, dark (−1) to light (1), and its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shade {
    pub value: f64,
    pub by_place: [f64; 2],
    pub by_variance: Variance,
}

/// A part of a print.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Print {
    /// Lines x = constant and y = constant, increasing.
    lines: [Vec<f64>; 2],
    /// Shade of each cell between lines, row by row; the outermost cells extend to infinity.
    shades: Vec<f64>,
}

impl Print {
    /// Returns the part of a board within `reach` of `middle` along both axes, with `middle` as the origin and `unit` as
    /// the unit of length; all in metres on the board.
    pub(crate) fn around(raster: &Raster, middle: Vector2<f64>, reach: f64, unit: f64) -> Self {
        let end = |sign: f64| [middle.x + sign * reach, middle.y + sign * reach];
        Self::new(raster, end(-1.0), end(1.0), middle.into(), unit)
    }

    /// Returns the part of a board between `low` and `high`, with `middle` as the origin and `unit` as the unit of
    /// length; all in metres on the board.
    fn new(raster: &Raster, low: [f64; 2], high: [f64; 2], middle: [f64; 2], unit: f64) -> Self {
        let inside = |lines: &[f64], axis: usize| -> Vec<f64> {
            lines.iter().copied().filter(|line| (low[axis]..=high[axis]).contains(line)).collect()
        };
        let lines = [inside(raster.x_lines(), 0), inside(raster.y_lines(), 1)];
        // A point in each cell.
        let points = |axis: usize| {
            let ends = [&[low[axis]][..], &lines[axis], &[high[axis]]].concat();
            ends.windows(2).map(|ends| 0.5 * (ends[0] + ends[1])).collect::<Vec<f64>>()
        };
        let (columns, rows) = (points(0), points(1));
        let shade = |x: f64, y: f64| if raster.is_dark_at([x, y]) { -1.0 } else { 1.0 };
        let shades = rows.iter().flat_map(|y| columns.iter().map(move |x| shade(*x, *y))).collect();
        let scaled =
            |axis: usize| -> Vec<f64> { lines[axis].iter().map(|line| (line - middle[axis]) / unit).collect() };
        Self { lines: [scaled(0), scaled(1)], shades }
    }

    fn cell(&self, column: usize, row: usize) -> f64 {
        self.shades.get(row * (self.lines[0].len() + 1) + column).copied().unwrap_or(1.0)
    }

    /// Returns the shade at `place`. Its derivatives are exactly zero if no edge is near.
    pub(crate) fn shade(&self, place: [f64; 2], variance: Variance, near: &mut NearLines) -> Shade {
        let table = &*NORMAL;
        let [sx, sy] = [variance[0], variance[2]].map(f64::sqrt);
        let mut first = [0; 2];
        for (axis, sigma) in [sx, sy].into_iter().enumerate() {
            let lines = &self.lines[axis];
            let found = &mut near.along[axis];
            found.clear();
            let reach = REACH * sigma;
            first[axis] = lines.iter().take_while(|line| **line < place[axis] - reach).count();
            let inverse = 1.0 / sigma;
            let within = lines.iter().skip(first[axis]).take_while(|line| **line <= place[axis] + reach);
            found.extend(within.map(|line| Near::new(table, (place[axis] - line) * inverse)));
        }
        let [left, top] = first;
        let mut value = self.cell(left, top);
        let [columns, rows] = &near.along;
        // The derivatives by both z, the sums of z times the densities, and the sum for the correlation.
        let (mut by_x, mut by_y, mut by_xx, mut by_yy) = (0.0, 0.0, 0.0, 0.0);
        let (mut mixed, mut mixed_x, mut mixed_y) = (0.0, 0.0, 0.0);
        let (mut mixed_xx, mut mixed_xy, mut mixed_yy) = (0.0, 0.0, 0.0);
        for (index, row) in rows.iter().enumerate() {
            let step = self.cell(left, top + index + 1) - self.cell(left, top + index);
            value += step * row.share;
            by_y += step * row.density;
            by_yy += step * row.density * row.z;
        }
        for (number, column) in columns.iter().enumerate() {
            let (before, after) = (left + number, left + number + 1);
            let mut above = self.cell(after, top) - self.cell(before, top);
            let mut step = above;
            for (index, row) in rows.iter().enumerate() {
                let below = self.cell(after, top + index + 1) - self.cell(before, top + index + 1);
                let corner = below - above;
                above = below;
                if corner != 0.0 {
                    step += corner * row.share;
                    let across = corner * column.share * row.density;
                    by_y += across;
                    by_yy += across * row.z;
                    let both = corner * column.density * row.density;
                    mixed += both;
                    mixed_x += both * column.z;
                    mixed_y += both * row.z;
                    mixed_xx += both * (column.z * column.z - 1.0);
                    mixed_xy += both * column.z * row.z;
                    mixed_yy += both * (row.z * row.z - 1.0);
                }
            }
            value += step * column.share;
            by_x += step * column.density;
            by_xx += step * column.density * column.z;
        }
        let scale = 1.0 / (sx * sy);
        let rho = variance[1] * scale;
        value += rho * mixed + 0.5 * rho * rho * mixed_xy;
        // Derivatives by x and y; those of the term with ρ² are neglected. Blurring is diffusion: the derivative by
        // the variance is half the second derivative by the place, and that by the covariance the mixed derivative.
        let by_place = [(by_x - rho * mixed_x) / sx, (by_y - rho * mixed_y) / sy];
        let by_variance = [
            0.5 * (rho * mixed_xx - by_xx) / (sx * sx),
            (mixed + rho * mixed_xy) * scale,
            0.5 * (rho * mixed_yy - by_yy) / (sy * sy),
        ];
        Shade { value, by_place, by_variance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_geometry::board::squares::raster::Rectangle;

    fn print() -> Print {
        let dark = [([0.0, 0.0], [1.0, 1.0]), ([1.0, 1.0], [2.5, 2.0]), ([-1.0, 1.5], [0.0, 2.5])];
        let raster = Raster::of_dark(&dark.map(|(low, high)| Rectangle { low, high }));
        Print::new(&raster, [-2.0; 2], [4.0; 2], [0.5, 0.0], 0.5)
    }

    /// The print in its own units.
    fn dark(x: f64, y: f64) -> bool {
        let (x, y) = (0.5 * x + 0.5, 0.5 * y);
        let within = |low: [f64; 2], high: [f64; 2]| x > low[0] && x < high[0] && y > low[1] && y < high[1];
        within([0.0, 0.0], [1.0, 1.0]) || within([1.0, 1.0], [2.5, 2.0]) || within([-1.0, 1.5], [0.0, 2.5])
    }

    fn shade(place: [f64; 2], variance: Variance) -> Shade {
        print().shade(place, variance, &mut NearLines::default())
    }

    #[test]
    fn the_shade_is_the_mean_of_the_print_over_the_blur() {
        let variance: Variance = [0.3, 0.06, 0.2];
        // A square root of the covariance.
        let (a, b) = (variance[0].sqrt(), variance[1] / variance[0].sqrt());
        let c = (variance[2] - b * b).sqrt();
        for place in [[1.0, 2.0], [0.8, 1.5], [-0.9, 3.1], [3.9, 2.2], [0.0, 0.9]] {
            let (mut sum, mut weights) = (0.0, 0.0);
            for (i, j) in (-120..120).flat_map(|i| (-120..120).map(move |j| (i, j))) {
                let (p, q) = ((f64::from(i) + 0.5) / 24.0, (f64::from(j) + 0.5) / 24.0);
                let weight = libm::exp(-0.5 * (p * p + q * q));
                let shade = if dark(place[0] + a * p, place[1] + b * p + c * q) { -1.0 } else { 1.0 };
                sum += weight * shade;
                weights += weight;
            }
            let found = shade(place, variance).value;
            assert!((found - sum / weights).abs() < 0.01, "{place:?}: {found} {}", sum / weights);
        }
    }

    #[test]
    fn derivatives_agree_with_differences() {
        for (variance, tolerance) in [([0.3, 0.0, 0.2], 1e-6), ([0.3, 0.05, 0.2], 0.02)] {
            for place in [[1.0, 2.0], [0.8, 1.5], [-0.9, 3.1], [3.9, 2.2]] {
                let exact = shade(place, variance);
                let step = 1e-5;
                for axis in 0..2 {
                    let at = |by: f64| {
                        let mut place = place;
                        place[axis] += by;
                        shade(place, variance).value
                    };
                    let numeric = (at(step) - at(-step)) / (2.0 * step);
                    assert!((numeric - exact.by_place[axis]).abs() < tolerance, "{place:?} {axis}");
                }
                for part in 0..3 {
                    let at = |by: f64| {
                        let mut variance = variance;
                        variance[part] += by;
                        shade(place, variance).value
                    };
                    let numeric = (at(step) - at(-step)) / (2.0 * step);
                    assert!((numeric - exact.by_variance[part]).abs() < tolerance, "{place:?} variance {part}");
                }
            }
        }
    }

    #[test]
    fn far_from_edges_the_derivatives_are_zero() {
        assert_eq!(
            shade([0.0, 1.0], [0.01, 0.0, 0.01]),
            Shade { value: -1.0, by_place: [0.0; 2], by_variance: [0.0; 3] }
        );
        assert_eq!(shade([-20.0, 1.0], [0.01, 0.0, 0.01]).value, 1.0);
    }
}

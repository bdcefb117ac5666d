//! Position of a tag with a known pattern, by least squares between the picture and the pattern.
//!
//! All edges of the tag are used, inner ones as well, so that a hardly visible side (in a picture made of events, a
//! side parallel to the motion) does not spoil two corners. The method is by Lucas and Kanade (1981), with gain and
//! offset, for a homography. The slopes are taken from the picture, so an edge that is not visible there has no weight.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::picture::Picture;
use crate::quads::Quad;

/// Width in pixels of the box filter that models all blur: of the camera, of a pixel, of the smoothing.
const BLUR: f64 = 3.2;
/// Upper limit of the same width in modules.
const MOST_BLUR: f64 = 1.4;
/// Positions of samples around each border between modules, as a fraction of the box's width.
const SAMPLES: [f64; 3] = [-0.3, 0.0, 0.3];
/// If a module has fewer pixels than this, there are two samples per module, and one more beyond each side of the tag.
const SMALL_MODULE: f64 = 3.2;
/// Largest number of steps, and the step in pixels below which the position has converged.
const STEPS: usize = 12;
const REACHED: f64 = 0.01;
/// After a step shorter than this, in pixels, the next steps use the same normal equations. The position at which the steps end does not
/// depend on them.
const SETTLED: f64 = 0.1;
/// Largest motion of a corner, in pixels and in modules.
const FARTHEST: f64 = 1.5;
const FARTHEST_IN_MODULES: f64 = 0.5;

/// Number of parameters of a homography, and number of all unknowns: these, gain and offset.
const MAP: usize = 8;
const UNKNOWNS: usize = MAP + 2;
/// The same number, rounded up to whole vectors of a processor.
const LANES: usize = 12;
/// Relative increase of the diagonal of the normal equations, for parameters that the pattern hardly determines.
const DAMPING: f64 = 1e-3;

/// The map from the unit square to a quadrilateral whose corners belong to (0, 0), (1, 0), (1, 1), (0, 1) (Heckbert 1989).
pub(crate) struct SquareMap {
    x: [f64; 3],
    y: [f64; 3],
    z: [f64; 2],
}

impl SquareMap {
    pub(crate) fn new(quad: &[[f64; 2]; 4]) -> Self {
        let [[x0, y0], [x1, y1], [x2, y2], [x3, y3]] = *quad;
        let (dx1, dx2, sx) = (x1 - x2, x3 - x2, x0 - x1 + x2 - x3);
        let (dy1, dy2, sy) = (y1 - y2, y3 - y2, y0 - y1 + y2 - y3);
        let determinant = dx1 * dy2 - dx2 * dy1;
        let g = (sx * dy2 - dx2 * sy) / determinant;
        let h = (dx1 * sy - sx * dy1) / determinant;
        Self { x: [x1 - x0 + g * x1, x3 - x0 + h * x3, x0], y: [y1 - y0 + g * y1, y3 - y0 + h * y3, y0], z: [g, h] }
    }

    fn matrix(&self) -> Matrix3<f64> {
        let (x, y, [g, h]) = (self.x, self.y, self.z);
        Matrix3::new(x[0], x[1], x[2], y[0], y[1], y[2], g, h, 1.0)
    }

    pub(crate) fn at(&self, u: f64, v: f64) -> [f64; 2] {
        let z = self.z[0] * u + self.z[1] * v + 1.0;
        [&self.x, &self.y].map(|row| (row[0] * u + row[1] * v + row[2]) / z)
    }
}

/// A pattern of `side` × `side` modules, light (1) and dark (−1), on a light board.
pub(crate) struct Pattern<'a> {
    pub side: usize,
    pub light: &'a [bool],
}

impl Pattern<'_> {
    /// Returns the positions of the samples in modules, the same along both sides, for modules of this size in pixels.
    fn positions(&self, module: f64) -> Vec<f64> {
        if module < SMALL_MODULE {
            return (0..2 * self.side + 2).map(|index| 0.5 * index as f64 - 0.25).collect();
        }
        (0..=self.side).flat_map(|border| SAMPLES.map(|part| border as f64 + part * BLUR / module)).collect()
    }

    /// Returns the pattern blurred by `blur` modules, at each pair of positions.
    fn samples(&self, positions: &[f64], blur: f64) -> Vec<Sample> {
        let side = self.side as isize;
        let light = |row: isize, column: isize| {
            let inside = (0..side).contains(&row) && (0..side).contains(&column);
            let light = !inside || self.light.get((row * side + column) as usize).copied().unwrap_or(true);
            if light { 1.0 } else { -1.0 }
        };
        let at_border = |position: f64| position.min(self.side as f64 - position) < 0.5 * blur;
        // The modules that a box around each position covers, with their fractions.
        let covered = |position: &f64| -> Vec<(isize, f64)> {
            let (low, high) = (position - 0.5 * blur, position + 0.5 * blur);
            let part = |module: isize| (high.min(module as f64 + 1.0) - low.max(module as f64)).max(0.0) / blur;
            (low.floor() as isize..=high.floor() as isize).map(|module| (module, part(module))).collect()
        };
        let covered: Vec<_> = positions.iter().map(covered).collect();
        let mut samples = Vec::with_capacity(positions.len().pow(2));
        for (v, rows) in positions.iter().zip(&covered) {
            // The modules blurred along the columns, from the one before the first to the one after the last.
            let of_column = |column: isize| rows.iter().map(|&(row, high)| high * light(row, column)).sum::<f64>();
            let blurred: Vec<f64> = (-2..=side + 1).map(of_column).collect();
            for (u, columns) in positions.iter().zip(&covered) {
                // The brightness beyond a corner depends on the board.
                if at_border(*u) && at_border(*v) {
                    continue;
                }
                let of_module =
                    |&(column, wide): &(isize, f64)| wide * blurred.get((column + 2) as usize).copied().unwrap_or(1.0);
                samples.push(Sample { place: Vector2::new(*u, *v), brightness: columns.iter().map(of_module).sum() });
            }
        }
        samples
    }
}

/// The brightness of the blurred pattern at a position, in modules from the top left.
struct Sample {
    place: Vector2<f64>,
    brightness: f64,
}

/// A smoothed picture with its slopes.
pub(crate) struct Slopes {
    width: usize,
    height: usize,
    /// Value, slope along x, slope along y, and zero: four values are added at once.
    pixels: Vec<[f32; 4]>,
}

impl Slopes {
    pub(crate) fn new(smooth: &Picture) -> Self {
        let (width, height) = (smooth.width(), smooth.height());
        let values = smooth.values();
        let pixel = |index: usize| {
            let (x, y) = (index % width, index / width);
            let slope = |before: usize, after: usize| 0.5 * (values[after] - values[before]);
            let along_x = slope(y * width + x.saturating_sub(1), y * width + (x + 1).min(width - 1));
            let along_y = slope(y.saturating_sub(1) * width + x, (y + 1).min(height - 1) * width + x);
            [values[index], along_x, along_y, 0.0]
        };
        Self { width, height, pixels: (0..values.len()).map(pixel).collect() }
    }

    /// Returns value and slopes at a position between pixels.
    fn at(&self, place: Vector2<f64>) -> [f32; 4] {
        // A NaN becomes 0.
        let x = (place.x as f32).max(0.0).min((self.width - 1) as f32);
        let y = (place.y as f32).max(0.0).min((self.height - 1) as f32);
        let (column, row) = (x as usize, y as usize);
        let (a, b) = (x - column as f32, y - row as f32);
        let (next, below) = ((column + 1).min(self.width - 1), (row + 1).min(self.height - 1));
        let pixel =
            |row: usize, column: usize, weight: f32| self.pixels[row * self.width + column].map(|value| weight * value);
        let four = [
            pixel(row, column, (1.0 - a) * (1.0 - b)),
            pixel(row, next, a * (1.0 - b)),
            pixel(below, column, (1.0 - a) * b),
            pixel(below, next, a * b),
        ];
        std::array::from_fn(|index| four[0][index] + four[1][index] + four[2][index] + four[3][index])
    }
}

/// Returns the corners of the tag near `start`; `None` if the pattern is not there.
pub(crate) fn align(slopes: &Slopes, pattern: &Pattern, start: &Quad) -> Option<Quad> {
    let start = start.map(|corner| corner.map(f64::from));
    let module = mean_side(&start) / pattern.side as f64;
    let mut samples = pattern.samples(&pattern.positions(module), (BLUR / module).min(MOST_BLUR));
    // Positions are relative to the middle of the tag, in halves of its side.
    for sample in &mut samples {
        sample.place = sample.place / (0.5 * pattern.side as f64) - Vector2::new(1.0, 1.0);
    }
    let mut map = SquareMap::new(&start).matrix() * Matrix3::new(0.5, 0.0, 0.5, 0.0, 0.5, 0.5, 0.0, 0.0, 1.0);
    let begin = corners(&map);
    let mut last = begin;
    let mut factor = None;
    let mut moved = f64::INFINITY;
    for _ in 0..STEPS {
        let is_exact = moved > SETTLED;
        let mut products = [[0.0_f32; LANES]; UNKNOWNS];
        let mut right = SVector::<f64, UNKNOWNS>::zeros();
        for Sample { place, brightness } in &samples {
            let image = map * place.push(1.0);
            let pixel = image.xy() / image.z;
            let [value, along_x, along_y, _] = slopes.at(pixel).map(f64::from);
            // The slopes along the sides of the tag.
            let slope = |column: usize| {
                let moved = map.fixed_view::<2, 1>(0, column) - pixel * map[(2, column)];
                (along_x * moved[0] + along_y * moved[1]) / image.z
            };
            let (s, t, u, v) = (slope(0), slope(1), place.x, place.y);
            let bend = s * u + t * v;
            let line = SVector::from([s, s * u, s * v, t, t * u, t * v, bend * u, bend * v, -brightness, -1.0]);
            right.axpy(-value, &line, 1.0);
            if is_exact {
                add_products(&mut products, &line);
            }
        }
        if is_exact {
            let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::from_fn(|row, column| products[row][column].into());
            for unknown in 0..MAP {
                normal[(unknown, unknown)] *= 1.0 + DAMPING;
            }
            factor = Some(normal.cholesky()?);
        }
        let step = factor.as_ref()?.solve(&right);
        // A negative gain means that dark and light are exchanged.
        if step[MAP].is_nan() || step[MAP] <= 0.0 {
            return None;
        }
        map *= Matrix3::new(1.0 + step[1], step[2], step[0], step[4], 1.0 + step[5], step[3], -step[6], -step[7], 1.0);
        let now = corners(&map);
        let far = farthest(&begin, &now);
        if far.is_nan() || far > FARTHEST + FARTHEST_IN_MODULES * module {
            return None;
        }
        moved = farthest(&last, &now);
        if moved < REACHED {
            break;
        }
        last = now;
    }
    Some(corners(&map).map(|corner| [corner.x as f32, corner.y as f32]))
}

/// Adds the products of all pairs of values of a line.
fn add_products(products: &mut [[f32; LANES]; UNKNOWNS], line: &SVector<f64, UNKNOWNS>) {
    let line: [f32; LANES] = std::array::from_fn(|index| line.get(index).map_or(0.0, |value| *value as f32));
    for (sums, value) in products.iter_mut().zip(line) {
        for (sum, other) in sums.iter_mut().zip(line) {
            *sum += value * other;
        }
    }
}

/// Returns the images of the corners of a tag, whose sides extend from −1 to 1.
fn corners(map: &Matrix3<f64>) -> [Vector2<f64>; 4] {
    [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|[u, v]| {
        let image = map * Vector3::new(u, v, 1.0);
        image.xy() / image.z
    })
}

/// Returns the largest distance between corresponding corners.
fn farthest(from: &[Vector2<f64>; 4], to: &[Vector2<f64>; 4]) -> f64 {
    from.iter().zip(to).map(|(from, to)| (from - to).norm()).fold(0.0, f64::max)
}

fn mean_side(quad: &[[f64; 2]; 4]) -> f64 {
    let side = |index: usize| {
        let (a, b) = (quad[index], quad[(index + 1) % 4]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    [0, 1, 2, 3].map(side).iter().sum::<f64>() / 4.0
}

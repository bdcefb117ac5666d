//! The position of a tag whose pattern is known: least squares between the picture and the pattern.
//!
//! All edges of the tag count, its inner ones as well, so that a side that is hardly visible (because it is parallel to the motion,
//! in a picture made of events) does not spoil two corners.

use nalgebra::{SMatrix, SVector};

use crate::picture::Picture;
use crate::quads::Quad;

/// Smoothing before, standard deviation in pixels.
const SMOOTHING: f32 = 0.7;
/// Width in pixels of the box that stands for all blur: of the camera, of a pixel, of the smoothing.
const BLUR: f64 = 3.2;
/// The same width in modules is at most this.
const MOST_BLUR: f64 = 1.4;
/// Samples are this part of the box's width before, on and after each border between modules.
const SAMPLES: [f64; 3] = [-0.3, 0.0, 0.3];
/// With modules smaller than this many pixels there are two samples per module, which reach half a module beyond the tag.
const SMALL_MODULE: f64 = 3.2;
/// Most steps, and the step in pixels below which the position is reached.
const STEPS: usize = 12;
const REACHED: f64 = 0.01;
/// A corner may move by this many pixels, and this many modules, at most.
const FARTHEST: f64 = 1.5;
const FARTHEST_IN_MODULES: f64 = 0.5;

/// Four corners, gain, offset.
const UNKNOWNS: usize = 10;

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

    pub(crate) fn at(&self, u: f64, v: f64) -> [f64; 2] {
        let z = self.z[0] * u + self.z[1] * v + 1.0;
        [&self.x, &self.y].map(|row| (row[0] * u + row[1] * v + row[2]) / z)
    }
}

/// A picture with its slopes.
pub(crate) struct Slopes {
    pub smooth: Picture,
    along_x: Picture,
    along_y: Picture,
}

impl Slopes {
    pub(crate) fn new(picture: &Picture) -> Option<Self> {
        let smooth = picture.blurred(SMOOTHING);
        let (width, height) = (smooth.width(), smooth.height());
        let values = smooth.values();
        let slope = |before: usize, after: usize| 0.5 * (values[after] - values[before]);
        let (mut along_x, mut along_y) = (Vec::with_capacity(values.len()), Vec::with_capacity(values.len()));
        for y in 0..height {
            let (row, above, below) = (y * width, y.saturating_sub(1) * width, (y + 1).min(height - 1) * width);
            for x in 0..width {
                along_x.push(slope(row + x.saturating_sub(1), row + (x + 1).min(width - 1)));
                along_y.push(slope(above + x, below + x));
            }
        }
        let picture = |values| Picture::new(width, height, values);
        let (along_x, along_y) = (picture(along_x)?, picture(along_y)?);
        Some(Self { smooth, along_x, along_y })
    }
}

/// A pattern of `side` × `side` modules, light (1) and dark (−1), on a light board.
pub(crate) struct Pattern<'a> {
    pub side: usize,
    pub light: &'a [bool],
}

impl Pattern<'_> {
    /// The positions of the samples in modules, the same along both sides, for modules of this size in pixels.
    fn positions(&self, module: f64) -> Vec<f64> {
        if module < SMALL_MODULE {
            return (0..2 * self.side + 2).map(|index| 0.5 * index as f64 - 0.25).collect();
        }
        (0..=self.side).flat_map(|border| SAMPLES.map(|part| border as f64 + part * BLUR / module)).collect()
    }

    /// The brightness of a pattern blurred by this many modules, at each pair of positions, row by row.
    fn brightness(&self, positions: &[f64], blur: f64) -> Vec<f64> {
        let side = self.side as isize;
        // The modules that a box around each sample covers, with their parts.
        let parts: Vec<Vec<(isize, f64)>> = positions
            .iter()
            .map(|position| {
                let (low, high) = (position - 0.5 * blur, position + 0.5 * blur);
                let part = |module: isize| {
                    let covered = high.min(module as f64 + 1.0) - low.max(module as f64);
                    (module, covered.max(0.0) / blur)
                };
                (low.floor() as isize..=high.floor() as isize).map(part).collect()
            })
            .collect();
        let light = |row: isize, column: isize| {
            let inside = (0..side).contains(&row) && (0..side).contains(&column);
            let light = !inside || self.light.get((row * side + column) as usize).copied().unwrap_or(true);
            if light { 1.0 } else { -1.0 }
        };
        let mut brightness = Vec::with_capacity(positions.len().pow(2));
        for rows in &parts {
            for columns in &parts {
                let sum = rows.iter().map(|&(row, high)| {
                    columns.iter().map(|&(column, wide)| high * wide * light(row, column)).sum::<f64>()
                });
                brightness.push(sum.sum());
            }
        }
        brightness
    }
}

/// The corners of the tag near `start`; `None` if the pattern is not there.
pub(crate) fn align(slopes: &Slopes, pattern: &Pattern, start: &Quad) -> Option<Quad> {
    const STEP: f64 = 0.05;
    let start = start.map(|corner| corner.map(f64::from));
    let mut quad = start;
    let module = mean_side(&quad) / pattern.side as f64;
    let positions = pattern.positions(module);
    let blur = (BLUR / module).min(MOST_BLUR);
    let brightness = pattern.brightness(&positions, blur);
    let unit = |position: f64| position / pattern.side as f64;
    let at_border = |position: f64| position.min(pattern.side as f64 - position) < 0.5 * blur;
    for _ in 0..STEPS {
        let map = SquareMap::new(&quad);
        let moved: [SquareMap; 8] = std::array::from_fn(|unknown| {
            let mut moved = quad;
            moved[unknown / 2][unknown % 2] += STEP;
            SquareMap::new(&moved)
        });
        let mut normal = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut right = SVector::<f64, UNKNOWNS>::zeros();
        // The gain of the step before is unknown in the first one: edges are then compared in direction only.
        for (row, &v) in positions.iter().enumerate() {
            for (column, &u) in positions.iter().enumerate() {
                // What is beyond a corner depends on the board.
                if at_border(u) && at_border(v) {
                    continue;
                }
                let (u, v) = (unit(u), unit(v));
                let [x, y] = map.at(u, v);
                let (px, py) = (x as f32, y as f32);
                let value = f64::from(slopes.smooth.bilinear(px, py));
                let slope = [&slopes.along_x, &slopes.along_y].map(|slope| f64::from(slope.bilinear(px, py)));
                let mut line = SVector::<f64, UNKNOWNS>::zeros();
                for (unknown, moved) in moved.iter().enumerate() {
                    let [to_x, to_y] = moved.at(u, v);
                    line[unknown] = (slope[0] * (to_x - x) + slope[1] * (to_y - y)) / STEP;
                }
                line[8] = -brightness[row * positions.len() + column];
                line[9] = -1.0;
                normal.ger(1.0, &line, &line, 1.0);
                right.axpy(-value, &line, 1.0);
            }
        }
        for unknown in 0..8 {
            normal[(unknown, unknown)] *= 1.0 + 1e-3;
        }
        let solution = normal.cholesky()?.solve(&right);
        // A negative gain is a tag in negative.
        if !solution.iter().all(|value| value.is_finite()) || solution[8] <= 0.0 {
            return None;
        }
        let mut largest = 0.0_f64;
        for unknown in 0..8 {
            let step = solution[unknown].clamp(-1.0, 1.0);
            quad[unknown / 2][unknown % 2] += step;
            largest = largest.max(step.abs());
        }
        let moved = quad.iter().flatten().zip(start.iter().flatten()).map(|(to, from)| (to - from).abs());
        if moved.fold(0.0, f64::max) > FARTHEST + FARTHEST_IN_MODULES * module {
            return None;
        }
        if largest < REACHED {
            break;
        }
    }
    Some(quad.map(|corner| corner.map(|place| place as f32)))
}

fn mean_side(quad: &[[f64; 2]; 4]) -> f64 {
    let side = |index: usize| {
        let (a, b) = (quad[index], quad[(index + 1) % 4]);
        (a[0] - b[0]).hypot(a[1] - b[1])
    };
    [0, 1, 2, 3].map(side).iter().sum::<f64>() / 4.0
}

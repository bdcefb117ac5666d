//! Systematic residuals over the sensor.
//!
//! The sensor, without its outermost pixels, is divided into cells of one size. (A narrower row of cells would count as much as the
//! others, and the outermost pixels are often odd: one of their neighbours is missing.) The residual of an event measures a displacement only across its edge: r = n · d + m, with
//! the edge's unit normal n, the displacement d of the image in the cell, and the outward shift m of the events all around the
//! dots. Both are estimated in each cell by weighted least squares. d is the error of a lens model that cannot follow the lens;
//! in the mean of r it would cancel over edges of all directions. m is the error that the event biases leave.
//!
//! Events of one crossing of an edge have errors in common. The standard errors are therefore computed for sums over blocks of
//! time (the sandwich estimator with clusters; Liang and Zeger, Biometrika 1986).

pub mod histogram;

use evcal_core::sensor::Sensor;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use evcal_geometry::numerics::huber::huber;
use evcal_solve::solve::observation_range::{EventResidual, PointResidual, point_residuals};
use evcal_solve::solve::rows::event_bias::{CLASS_COUNT, SPEED_RANGE_COUNT};
use evcal_solve::solve::{Problem, State};

/// Number of columns of cells; the number of rows follows, so that the cells are nearly square.
const COLUMNS: usize = 16;
/// Number of pixels along each border of the sensor that belong to no cell.
const BORDER: u16 = 1;
/// Time within which events may have errors in common (s): standard errors are computed for sums over such blocks.
const BLOCK: f64 = 0.05;
/// Fewest blocks with observations in a cell from which a displacement is estimated.
const FEWEST_BLOCKS: usize = 12;
/// Systematic displacements above which other lens models are tried: size without the part that noise explains (px,
/// rms), and ratio to the size that noise causes. The ratio was 0.98 to 1.21 for right models in 70 simulated
/// recordings, and 1.38 to 1.48 for `radtan4` on lenses of `radtan8` (seeds 11 to 14).
const SUSPICIOUS: [f64; 2] = [0.002, 1.2];
/// Displacements above which the calibration is doubtful although no other model is better: size without the part that
/// noise explains (px, rms), and ratio to the size that noise causes.
const CONDEMNING: [f64; 2] = [0.008, 1.5];

/// Left and upper side of the first cell (px).
const FIRST: f64 = BORDER as f64 - 0.5;

/// One scalar residual: r = row · (d, m).
#[derive(Clone, Copy, Debug, PartialEq)]
struct Observation {
    t: f64,
    pixel: [f64; 2],
    /// Normal of the edge, and 1 if m is estimated.
    row: Vector3<f64>,
    residual: f64,
    /// Inverse variance, reduced for outliers.
    weight: f64,
}

/// The residuals over the sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualMap {
    /// Columns of cells.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// Width and height of a cell (px).
    pub cell: [f64; 2],
    /// The cells, row by row.
    pub cells: Vec<CellResiduals>,
    /// Summary of all cells.
    pub pattern: ResidualPattern,
}

impl ResidualMap {
    /// Returns left, top, right and bottom of each cell in pixels.
    pub fn places(&self) -> impl Iterator<Item = [f64; 4]> {
        (0..self.rows * self.columns).map(|index| {
            let [width, height] = self.cell;
            let left = (index % self.columns) as f64 * width + FIRST;
            let top = (index / self.columns) as f64 * height + FIRST;
            [left, top, left + width, top + height]
        })
    }
}

/// The residuals in one cell of the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellResiduals {
    /// Number of residuals.
    pub count: usize,
    /// Number of blocks of time with residuals.
    pub blocks: usize,
    /// Root mean square of the residuals (px).
    pub rms: f64,
    /// Systematic displacement, if there are enough observations.
    pub displacement: Option<Displacement>,
}

/// Systematic part of the residuals of a cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Displacement {
    /// Observed minus modelled position of the image in the cell (px).
    pub shift: Vector2<f64>,
    /// Covariance of `shift` (px²).
    pub covariance: Matrix2<f64>,
    /// Mean distance by which events lie further out of the dots than their classes predict (px), with its standard error; `None`
    /// for circle centres.
    pub outward: Option<(f64, f64)>,
}

/// Summary of a residual map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResidualPattern {
    /// Cells with a displacement.
    pub cells: usize,
    /// Root mean square displacement over the pixels of the cells, with the part that noise explains subtracted (px).
    pub shift: f64,
    /// Root mean square displacement in units of its standard error: 1 if it is noise alone.
    pub shift_ratio: f64,
    /// Root mean square outward shift, with the part that noise explains subtracted (px).
    pub outward: f64,
    /// Root mean square outward shift in units of its standard error.
    pub outward_ratio: f64,
}

impl ResidualPattern {
    /// Returns `true` if the displacements are large enough that other models should be tried.
    pub fn is_suspicious(&self) -> bool {
        self.is_beyond(SUSPICIOUS)
    }

    /// Returns `true` if the displacements make the calibration doubtful although no other model is better.
    pub(super) fn is_condemning(&self) -> bool {
        self.is_beyond(CONDEMNING)
    }

    fn is_beyond(&self, [shift, ratio]: [f64; 2]) -> bool {
        self.shift > shift && self.shift_ratio > ratio
    }
}

/// Computes the residual map of `problem` at `state`; `events` are the residuals of all its events.
pub fn residual_map(problem: &Problem, state: &State, events: &[EventResidual]) -> ResidualMap {
    if events.is_empty() {
        let points = point_residuals(problem, state);
        let observations = || points.iter().flat_map(|point| of_point(problem, point));
        return map_of(problem.sensor, observations);
    }
    let observations = || events.iter().filter_map(|event| of_event(problem, state, event));
    map_of(problem.sensor, observations)
}

fn of_event(problem: &Problem, state: &State, event: &EventResidual) -> Option<Observation> {
    let class = usize::from(event.class).min(CLASS_COUNT - 1);
    let sigma = state.bias.get(class)?.sigma[usize::from(event.speed_range).min(SPEED_RANGE_COUNT - 1)];
    let residual = f64::from(event.residual);
    let (_, root_weight) = huber(residual / sigma, problem.huber);
    let [x, y] = event.normal.map(f64::from);
    Some(Observation {
        t: event.t,
        pixel: event.pixel.map(f64::from),
        row: Vector3::new(x, y, 1.0),
        residual,
        weight: (root_weight / sigma).powi(2),
    })
}

fn of_point(problem: &Problem, point: &PointResidual) -> [Observation; 2] {
    let (_, root_weight) = huber(point.residual.norm() / problem.point_sigma, problem.huber);
    let weight = (root_weight / problem.point_sigma).powi(2);
    let (t, pixel) = (point.t, point.pixel.into());
    [(Vector3::x(), point.residual.x), (Vector3::y(), point.residual.y)].map(|(row, residual)| Observation {
        t,
        pixel,
        row,
        residual,
        weight,
    })
}

/// Sums of one cell.
#[derive(Clone, Copy, Debug, Default)]
struct CellSums {
    count: usize,
    square: f64,
    normal: Matrix3<f64>,
    right: Vector3<f64>,
    estimate: Option<(Matrix3<f64>, Vector3<f64>)>,
    block: Option<i64>,
    blocks: usize,
    /// Score of the current block.
    score: Vector3<f64>,
    /// Sum of the outer products of the scores of the blocks before.
    scatter: Matrix3<f64>,
}

impl CellSums {
    fn end_block(&mut self) {
        if self.block.take().is_some() {
            self.blocks += 1;
            self.scatter += self.score * self.score.transpose();
            self.score = Vector3::zeros();
        }
    }

    fn residuals(&self) -> CellResiduals {
        let rms = if self.count > 0 { (self.square / self.count as f64).sqrt() } else { 0.0 };
        CellResiduals { count: self.count, blocks: self.blocks, rms, displacement: self.displacement() }
    }

    fn displacement(&self) -> Option<Displacement> {
        let (inverse, estimate) = self.estimate?;
        if self.blocks < FEWEST_BLOCKS {
            return None;
        }
        let blocks = self.blocks as f64;
        let covariance = inverse * self.scatter * inverse * (blocks / (blocks - 1.0));
        let outward = (self.normal[(2, 2)] > 0.0).then(|| (estimate.z, covariance[(2, 2)].sqrt()));
        let covariance = covariance.fixed_view::<2, 2>(0, 0).into_owned();
        Some(Displacement { shift: estimate.xy(), covariance, outward })
    }
}

/// Inverts the normal matrix of a cell; `None` if the edges have too few directions to determine a displacement.
fn inverse(normal: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    /// Smallest share of the information that the weakest direction may have.
    const WEAKEST: f64 = 0.02;
    let mut normal = *normal;
    if normal[(2, 2)] <= 0.0 {
        // Circle centres do not determine m.
        normal[(2, 2)] = 0.5 * normal.trace();
    }
    let inverse = normal.try_inverse()?;
    let shift = inverse.fixed_view::<2, 2>(0, 0).into_owned();
    let information = shift.try_inverse()?.symmetric_eigenvalues();
    (information.min() >= WEAKEST * information.max()).then_some(inverse)
}

/// Division of a sensor into [`COLUMNS`] × `rows` cells.
struct Cells {
    rows: usize,
    /// Width and height of a cell (px).
    cell: [f64; 2],
}

impl Cells {
    fn of(sensor: Sensor) -> Self {
        let inner = |pixels: u16| f64::from(pixels.saturating_sub(2 * BORDER).max(1));
        let (inner_width, inner_height) = (inner(sensor.width), inner(sensor.height));
        let width = inner_width / COLUMNS as f64;
        let rows = (inner_height / width).round().max(1.0);
        Self { rows: rows as usize, cell: [width, inner_height / rows] }
    }
}

/// Builds the map from the observations that every call of `observations` returns in order of time.
fn map_of<O: Iterator<Item = Observation>>(sensor: Sensor, observations: impl Fn() -> O) -> ResidualMap {
    let Cells { rows, cell } = Cells::of(sensor);
    let index_of = |pixel: [f64; 2]| {
        let [x, y] = pixel.map(|coordinate| coordinate - FIRST);
        let (column, row) = ((x / cell[0]).floor(), (y / cell[1]).floor());
        let is_inside = column >= 0.0 && row >= 0.0 && column < COLUMNS as f64 && row < rows as f64;
        is_inside.then_some(row as usize * COLUMNS + column as usize)
    };
    let mut sums = vec![CellSums::default(); COLUMNS * rows];
    for observation in observations() {
        let Some(sums) = index_of(observation.pixel).and_then(|index| sums.get_mut(index)) else { continue };
        let weighted = observation.row * observation.weight;
        sums.count += 1;
        sums.square += observation.residual * observation.residual;
        sums.normal += weighted * observation.row.transpose();
        sums.right += weighted * observation.residual;
    }
    for sums in &mut sums {
        sums.estimate = inverse(&sums.normal).map(|inverse| (inverse, inverse * sums.right));
    }
    for observation in observations() {
        let Some(sums) = index_of(observation.pixel).and_then(|index| sums.get_mut(index)) else { continue };
        let Some((_, estimate)) = sums.estimate else { continue };
        let block = (observation.t / BLOCK).floor() as i64;
        if sums.block != Some(block) {
            sums.end_block();
            sums.block = Some(block);
        }
        let left = observation.residual - observation.row.dot(&estimate);
        sums.score += observation.row * (observation.weight * left);
    }
    sums.iter_mut().for_each(CellSums::end_block);
    let cells: Vec<CellResiduals> = sums.iter().map(|sums| sums.residuals()).collect();
    let mut pixels = vec![0_usize; cells.len()];
    for (y, x) in (0..sensor.height).flat_map(|y| (0..sensor.width).map(move |x| (y, x))) {
        if let Some(count) = index_of([x, y].map(f64::from)).and_then(|index| pixels.get_mut(index)) {
            *count += 1;
        }
    }
    let pattern = pattern(cells.iter().zip(pixels));
    ResidualMap { columns: COLUMNS, rows, cell, cells, pattern }
}

/// Summarises cells, each with its number of pixels. A cell counts as much as it has pixels.
fn pattern<'a>(cells: impl Iterator<Item = (&'a CellResiduals, usize)>) -> ResidualPattern {
    let mut shift = MeanSquare::default();
    let mut outward = MeanSquare::default();
    for (cell, pixels) in cells {
        let Some(displacement) = cell.displacement else { continue };
        let Some(information) = displacement.covariance.try_inverse() else { continue };
        let Displacement { shift: d, covariance, .. } = displacement;
        // Hotelling's T² of n blocks in p dimensions has the mean p (n − 1) / (n − p − 2).
        let blocks = cell.blocks as f64;
        let share = |dimensions: f64| (blocks - dimensions - 2.0) / (dimensions * (blocks - 1.0));
        shift.add(pixels, d.norm_squared() - covariance.trace(), d.dot(&(information * d)) * share(2.0));
        if let Some((mean, sigma)) = displacement.outward
            && sigma > 0.0
        {
            outward.add(pixels, mean * mean - sigma * sigma, (mean / sigma).powi(2) * share(1.0));
        }
    }
    let ((shift_pixels, shift_ratio), (outward_pixels, outward_ratio)) = (shift.roots(), outward.roots());
    ResidualPattern { cells: shift.count, shift: shift_pixels, shift_ratio, outward: outward_pixels, outward_ratio }
}

/// Mean squares of a quantity over the pixels of cells: beyond noise, and in units of its standard error.
#[derive(Default)]
struct MeanSquare {
    count: usize,
    pixels: f64,
    beyond_noise: f64,
    ratio: f64,
}

impl MeanSquare {
    fn add(&mut self, pixels: usize, beyond_noise: f64, ratio: f64) {
        let pixels = pixels as f64;
        self.count += 1;
        self.pixels += pixels;
        self.beyond_noise += pixels * beyond_noise;
        self.ratio += pixels * ratio;
    }

    fn roots(&self) -> (f64, f64) {
        let pixels = self.pixels.max(1.0);
        ((self.beyond_noise.max(0.0) / pixels).sqrt(), (self.ratio / pixels).sqrt())
    }
}

#[cfg(test)]
mod tests;

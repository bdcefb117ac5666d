//! Coverage of a calibration: positions of the observations on the sensor, and the poses of the board.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use serde::{Deserialize, Serialize};

use evcal_geometry::board::Board;
use evcal_geometry::numerics::statistics::quantile;
use evcal_solve::solve::{Problem, State};

/// Columns and rows of the cells of the sensor.
pub const CELLS: (usize, usize) = (12, 9);

/// Interval between the evaluated poses (s).
const INTERVAL: f64 = 0.02;

/// Share of the mean number of observations per cell from which a cell counts as covered.
const COVERED_SHARE: f64 = 0.03;

/// Distribution of a quantity over all poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// 5th percentile.
    pub low: f64,
    /// Median.
    pub median: f64,
    /// 95th percentile.
    pub high: f64,
}

impl Spread {
    fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let at = |share| quantile(&values, share).unwrap_or(0.0);
        Self { low: at(0.05), median: at(0.5), high: at(0.95) }
    }
}

/// Coverage of the sensor, and distribution of the poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Coverage {
    /// Columns of cells of the sensor.
    pub columns: usize,
    /// Rows of cells.
    pub rows: usize,
    /// Observations in each cell, row by row.
    pub counts: Vec<usize>,
    /// Share of the cells that are covered ([`Coverage::is_covered`]).
    pub covered: f64,
    /// Distance of the camera from the middle of the board in metres.
    pub distance: Spread,
    /// Angle between the line of sight and the board's normal in degrees.
    pub tilt: Spread,
    /// Larger side of the area that the board's circles cover in the image, divided by the shorter side of the sensor.
    pub fill: Spread,
    /// Length of all trajectory segments together in seconds; `None` for views of a camera at rest.
    pub duration: Option<f64>,
}

impl Coverage {
    /// Returns `true` if cell `index` has enough observations to count as covered.
    pub fn is_covered(&self, index: usize) -> bool {
        let total: usize = self.counts.iter().sum();
        let count = self.counts.get(index).copied().unwrap_or(0);
        count > 0 && count as f64 >= COVERED_SHARE * total as f64 / self.counts.len() as f64
    }

    /// Returns `true` if the calibration has observations around `pixel` of a sensor of this size.
    pub fn has_observations_near(&self, pixel: [f64; 2], sensor: Sensor) -> bool {
        self.is_covered(cell(pixel, sensor))
    }
}

/// Returns the index of the cell of `pixel`.
fn cell([x, y]: [f64; 2], Sensor { width, height }: Sensor) -> usize {
    let place = |position: f64, size: u16, count: usize| {
        (((position + 0.5) / f64::from(size) * count as f64).max(0.0) as usize).min(count - 1)
    };
    place(y, height, CELLS.1) * CELLS.0 + place(x, width, CELLS.0)
}

/// Computes the coverage of the observations of `problem` at its solution `state`; `board` is the board they show.
pub fn coverage(problem: &Problem, state: &State, board: &Board) -> Coverage {
    let events = problem.segments.iter().flat_map(|segment| &segment.events);
    let points = problem.segments.iter().flat_map(|segment| &segment.points);
    let pixels = events
        .map(|event| [f64::from(event.x), f64::from(event.y)])
        .chain(points.map(|point| [point.pixel.x, point.pixel.y]));
    let poses = state.trajectories.iter().flat_map(|trajectory| {
        let steps = ((trajectory.end() - trajectory.start()) / INTERVAL) as usize;
        let times = (0..=steps).map(|step| trajectory.start() + step as f64 * INTERVAL);
        times.filter_map(|t| trajectory.pose(t))
    });
    let duration: f64 = state.trajectories.iter().map(|trajectory| trajectory.end() - trajectory.start()).sum();
    coverage_of(&state.camera, problem.sensor, board, pixels, poses, Some(duration))
}

/// Computes the coverage of observations of `board` at these `pixels`, made from these `poses` (`T_world_camera`) in
/// `duration` seconds.
pub fn coverage_of(
    camera: &Camera<f64>,
    sensor: Sensor,
    board: &Board,
    pixels: impl Iterator<Item = [f64; 2]>,
    poses: impl Iterator<Item = Isometry3<f64>>,
    duration: Option<f64>,
) -> Coverage {
    let mut counts = vec![0; CELLS.0 * CELLS.1];
    for pixel in pixels {
        if let Some(count) = counts.get_mut(cell(pixel, sensor)) {
            *count += 1;
        }
    }

    let circles: Vec<_> = (0..board.point_count()).map(|index| board.point(index).push(0.0)).collect();
    let middle = circles.iter().sum::<nalgebra::Vector3<f64>>() / circles.len().max(1) as f64;
    let (mut distances, mut tilts, mut fills) = (Vec::new(), Vec::new(), Vec::new());
    for pose in poses {
        let from_board = pose.translation.vector - middle;
        distances.push(from_board.norm());
        let cosine = from_board.z.abs() / from_board.norm().max(f64::MIN_POSITIVE);
        tilts.push(libm::acos(cosine.min(1.0)).to_degrees());
        let projected = circles
            .iter()
            .filter_map(|circle| camera.project(&pose.inverse_transform_vector(&(circle - pose.translation.vector))));
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for pixel in projected {
            for axis in 0..2 {
                low[axis] = low[axis].min(pixel[axis]);
                high[axis] = high[axis].max(pixel[axis]);
            }
        }
        let side = (high[0] - low[0]).max(high[1] - low[1]);
        if side.is_finite() {
            fills.push(side / f64::from(sensor.width.min(sensor.height)));
        }
    }
    let mut coverage = Coverage {
        columns: CELLS.0,
        rows: CELLS.1,
        counts,
        covered: 0.0,
        distance: Spread::of(distances),
        tilt: Spread::of(tilts),
        fill: Spread::of(fills),
        duration,
    };
    let covered = (0..coverage.counts.len()).filter(|&index| coverage.is_covered(index)).count();
    coverage.covered = covered as f64 / coverage.counts.len() as f64;
    coverage
}

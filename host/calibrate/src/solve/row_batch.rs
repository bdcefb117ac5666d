//! The rows of a batch of events, from their edges.

use evcal_core::camera::MAX_COEFFICIENTS;
use multiversion::multiversion;

use super::BOARD_PARAMETERS;
use super::bearing_table::Cell;
use super::edge_batch::{Edges, GROUP, LANES, Lane, SingleLane};
use super::event_row::{ROW, ROW_BIASES, ROW_BOARD, ROW_COEFFICIENTS, ROW_INTRINSICS, ROW_RESIDUAL};
use super::row_products::{Row, STEP};
use crate::solve::event_bias::bias::{Bias, Biases};
use crate::solve::event_bias::{ClassBias, expected_distance};
use evcal_geometry::numerics::huber::huber;

/// Numbers of a row that are computed for all events at once: all but the coefficients of the camera model.
const PARTS: usize = 6 + 1 + 4 + BOARD_PARAMETERS + Bias::COUNT;
/// Where the biases begin among them.
const BIAS_PARTS: usize = PARTS - Bias::COUNT;

/// Where each of them stands in the row.
const PLACES: [usize; PARTS] = {
    let mut places = [0; PARTS];
    let mut part = 0;
    while part < PARTS {
        places[part] = match part {
            0..6 => part,
            6 => ROW_RESIDUAL,
            7..11 => ROW_INTRINSICS + part - 7,
            11..BIAS_PARTS => ROW_BOARD + part - 11,
            _ => ROW_BIASES + part - BIAS_PARTS,
        };
        part += 1;
    }
    places
};

/// Room for the rows of a batch.
pub struct RowBatch {
    classes: [u8; LANES],
    expected: Expected,
    weighed: Weighed,
    /// Rows of one class, at most, in each step.
    steps: [[Row; STEP]; LANES],
    step_classes: [u8; LANES],
    step: usize,
    /// Rows in the last step.
    filled: usize,
}

/// What is known of the classes of the events.
struct Expected {
    biases: [Lane; Bias::COUNT],
    sigma: Lane,
}

/// What comes of it. Apart from what goes in, so that the compiler sees that they do not overlap.
struct Weighed {
    costs: Lane,
    residuals: Lane,
    parts: [SingleLane; PARTS],
    /// Derivative of the weighed residual by the pixel of a fixed bearing.
    by_pixel: [SingleLane; 2],
    beside_cell: [SingleLane; 2],
}

impl Default for RowBatch {
    fn default() -> Self {
        Self {
            classes: [0; LANES],
            expected: Expected { biases: [[0.0; LANES]; Bias::COUNT], sigma: [1.0; LANES] },
            weighed: Weighed {
                costs: [0.0; LANES],
                residuals: [0.0; LANES],
                parts: [[0.0; LANES]; PARTS],
                by_pixel: [[0.0; LANES]; 2],
                beside_cell: [[0.0; LANES]; 2],
            },
            steps: [[[0.0; ROW]; STEP]; LANES],
            step_classes: [0; LANES],
            step: 0,
            filled: 0,
        }
    }
}

impl RowBatch {
    /// Sets the class of the event in a lane and its spread (px).
    pub fn set_class(&mut self, lane: usize, bias: &ClassBias, sigma: f64) {
        for (lanes, value) in self.expected.biases.iter_mut().zip(bias.biases.as_array()) {
            lanes[lane] = *value;
        }
        self.expected.sigma[lane] = sigma;
    }

    /// Weighs the first `count` lanes of `edges`. `mean_scale` is the unit of the residual where that is not the pixel.
    pub fn weigh(&mut self, edges: &Edges, huber: f64, mean_scale: Option<f64>, count: usize) {
        (self.step, self.filled) = (0, 0);
        weigh(&self.expected, edges, huber, mean_scale, count.next_multiple_of(GROUP), &mut self.weighed);
    }

    /// Adds the rows of the events that have a cell; the `classes` are those of all events. How many there are and the sum of
    /// their costs.
    pub fn collect(&mut self, cells: &[Option<&Cell>], classes: impl Iterator<Item = u8>) -> (usize, f64) {
        for (own, class) in self.classes.iter_mut().zip(classes) {
            *own = class;
        }
        collect(self, cells)
    }

    #[inline(always)]
    fn add(&mut self, lane: usize, cell: &Cell) {
        let class = self.classes[lane];
        if self.filled > 0 && (self.filled == STEP || self.step_classes[self.step] != class) {
            (self.step, self.filled) = (self.step + 1, 0);
        }
        let Some(step) = self.steps.get_mut(self.step) else { return };
        if self.filled == 0 {
            *step = [[0.0; ROW]; STEP];
            self.step_classes[self.step] = class;
        }
        let row = &mut step[self.filled];
        self.filled += 1;
        for (lanes, place) in self.weighed.parts.iter().zip(PLACES) {
            row[place] = lanes[lane];
        }
        let lane_of = |lanes: &[SingleLane; 2]| [lanes[0][lane], lanes[1][lane]];
        let coefficients = cell.by_coefficients(lane_of(&self.weighed.beside_cell), lane_of(&self.weighed.by_pixel));
        row[ROW_COEFFICIENTS..ROW_COEFFICIENTS + MAX_COEFFICIENTS].copy_from_slice(&coefficients);
    }

    /// Distance of the event in a lane from where its class is expected (px).
    pub fn residual(&self, lane: usize) -> f64 {
        self.weighed.residuals[lane]
    }

    /// The rows that were added in steps of one class each, with empty ones among them, and the class of each step.
    pub fn steps(&self) -> (&[[Row; STEP]], &[u8]) {
        let count = self.step + usize::from(self.filled > 0);
        (&self.steps[..count], &self.step_classes[..count])
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn collect(batch: &mut RowBatch, cells: &[Option<&Cell>]) -> (usize, f64) {
    let (mut count, mut cost) = (0, 0.0);
    for (lane, cell) in cells.iter().take(LANES).enumerate() {
        if let Some(cell) = cell {
            batch.add(lane, cell);
            count += 1;
            cost += batch.weighed.costs[lane];
        }
    }
    (count, cost)
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn weigh(expected: &Expected, edges: &Edges, bound: f64, mean_scale: Option<f64>, count: usize, weighed: &mut Weighed) {
    for lane in 0..count.min(LANES) {
        let passage = edges.passage(lane);
        let biases = Biases::from_array(std::array::from_fn(|bias| expected.biases[bias][lane]));
        let residual = edges.pixels[lane] - expected_distance(&biases, &passage);
        let inverse_sigma = 1.0 / expected.sigma[lane];
        let (cost, root_weight) = huber(residual * inverse_sigma, bound);
        let weight = root_weight * inverse_sigma;
        let factor = weight / mean_scale.unwrap_or(edges.scale[lane]);
        weighed.costs[lane] = cost;
        weighed.residuals[lane] = residual;
        for axis in 0..3 {
            weighed.parts[axis][lane] = (edges.by_rotation[axis][lane] * factor) as f32;
            weighed.parts[3 + axis][lane] = (edges.by_translation[axis][lane] * factor) as f32;
            weighed.parts[11 + axis][lane] = (edges.by_shape[axis][lane] * factor) as f32;
        }
        weighed.parts[11 + BOARD_PARAMETERS - 1][lane] = -factor as f32;
        weighed.parts[6][lane] = (residual * weight) as f32;
        for axis in 0..2 {
            let by_pixel = -edges.by_pixel[axis][lane] * factor;
            weighed.parts[7 + axis][lane] = (by_pixel * edges.by_focal_length[axis][lane]) as f32;
            weighed.parts[9 + axis][lane] = by_pixel as f32;
            weighed.by_pixel[axis][lane] = by_pixel as f32;
            weighed.beside_cell[axis][lane] = edges.beside_cell[axis][lane] as f32;
        }
        let derivatives = passage.derivatives();
        for (lanes, derivative) in weighed.parts[BIAS_PARTS..].iter_mut().zip(derivatives.as_array()) {
            lanes[lane] = (-derivative * weight) as f32;
        }
    }
}

//! The rows of a batch of events, from their edges.

use evcal_core::camera::MAX_COEFFICIENTS;
use multiversion::multiversion;

use super::bearing_table::CoefficientPlace;
use super::edge_batch::{Edges, GROUP, LANES, Lane, SingleLane};
use super::event_row::{ROW, ROW_BIASES, ROW_BOARD, ROW_COEFFICIENTS, ROW_INTRINSICS, ROW_RESIDUAL};
use super::loss::Loss;
use super::row_products::{Row, single};
use crate::solve::BOARD_PARAMETERS;
use crate::solve::rows::event_bias::bias::{Bias, Biases};
use crate::solve::rows::event_bias::{ClassBias, expected_distance};
use evcal_geometry::numerics::huber::huber;

/// Number of the values of a row that are computed for all events at once: all but the coefficients of the camera
/// model.
const PARTS: usize = 6 + 1 + 4 + BOARD_PARAMETERS + Bias::COUNT;
/// Index of the first bias among them.
const BIAS_PARTS: usize = PARTS - Bias::COUNT;

/// Index of each of them in the row.
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

/// Buffers for the rows of a batch.
pub struct RowBatch {
    classes: [u8; LANES],
    expected: Expected,
    weighed: Weighed,
    rows: [Row; LANES],
    row_classes: [u8; LANES],
    /// Number of filled rows.
    filled: usize,
}

/// Biases and spreads of the classes of the events.
struct Expected {
    biases: [Lane; Bias::COUNT],
    sigma: Lane,
}

/// Output, separate from the input, so that the compiler sees that they do not overlap.
struct Weighed {
    costs: Lane,
    weights: Lane,
    residuals: Lane,
    /// Numbers that are exact in single precision.
    parts: [Lane; PARTS],
    /// Derivative of the weighted residual by the pixel of a fixed bearing.
    by_pixel: [SingleLane; 2],
    offset_from_cell: [SingleLane; 2],
}

impl Default for RowBatch {
    fn default() -> Self {
        Self {
            classes: [0; LANES],
            expected: Expected { biases: [[0.0; LANES]; Bias::COUNT], sigma: [1.0; LANES] },
            weighed: Weighed {
                costs: [0.0; LANES],
                weights: [0.0; LANES],
                residuals: [0.0; LANES],
                parts: [[0.0; LANES]; PARTS],
                by_pixel: [[0.0; LANES]; 2],
                offset_from_cell: [[0.0; LANES]; 2],
            },
            rows: [[0.0; ROW]; LANES],
            row_classes: [0; LANES],
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

    /// Weights the first `count` lanes of `edges`. `mean_scale` is the unit of the residual if it is not the pixel.
    pub fn weigh(&mut self, edges: &Edges, huber: f64, mean_scale: Option<f64>, count: usize) {
        self.filled = 0;
        weigh(&self.expected, edges, huber, mean_scale, count.next_multiple_of(GROUP), &mut self.weighed);
    }

    /// Adds the rows of the events that have a cell; `classes` are the classes of all events. Returns the loss of these events.
    pub fn collect(&mut self, cells: &[Option<CoefficientPlace>], classes: impl Iterator<Item = u8>) -> Loss {
        for (own, class) in self.classes.iter_mut().zip(classes) {
            *own = class;
        }
        collect(self, cells)
    }

    #[inline(always)]
    fn add(&mut self, lane: usize, cell: &CoefficientPlace) {
        let Some(row) = self.rows.get_mut(self.filled) else { return };
        self.row_classes[self.filled] = self.classes[lane];
        self.filled += 1;
        for (lanes, place) in self.weighed.parts.iter().zip(PLACES) {
            row[place] = lanes[lane];
        }
        let lane_of = |lanes: &[SingleLane; 2]| [lanes[0][lane], lanes[1][lane]];
        let coefficients =
            cell.by_coefficients(lane_of(&self.weighed.offset_from_cell), lane_of(&self.weighed.by_pixel));
        let of_coefficients = &mut row[ROW_COEFFICIENTS..ROW_COEFFICIENTS + MAX_COEFFICIENTS];
        of_coefficients.iter_mut().zip(coefficients).for_each(|(to, value)| *to = f64::from(value));
    }

    /// Returns the distance of the event in a lane from the expected distance of its class (px).
    pub fn residual(&self, lane: usize) -> f64 {
        self.weighed.residuals[lane]
    }

    /// Returns the added rows and their classes.
    pub fn rows(&self) -> (&[Row], &[u8]) {
        (&self.rows[..self.filled], &self.row_classes[..self.filled])
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn collect(batch: &mut RowBatch, cells: &[Option<CoefficientPlace>]) -> Loss {
    let mut loss = Loss::default();
    for (lane, cell) in cells.iter().take(LANES).enumerate() {
        if let Some(cell) = cell {
            batch.add(lane, cell);
            loss.add_observation(batch.weighed.costs[lane], batch.weighed.weights[lane]);
        }
    }
    loss
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
        weighed.weights[lane] = root_weight * root_weight;
        weighed.residuals[lane] = residual;
        for axis in 0..3 {
            weighed.parts[axis][lane] = single(edges.by_rotation[axis][lane] * factor);
            weighed.parts[3 + axis][lane] = single(edges.by_translation[axis][lane] * factor);
            weighed.parts[11 + axis][lane] = single(edges.by_shape[axis][lane] * factor);
        }
        weighed.parts[11 + BOARD_PARAMETERS - 1][lane] = single(-factor);
        weighed.parts[6][lane] = single(residual * weight);
        for axis in 0..2 {
            let by_pixel = -edges.by_pixel[axis][lane] * factor;
            weighed.parts[7 + axis][lane] = single(by_pixel * edges.by_focal_length[axis][lane]);
            weighed.parts[9 + axis][lane] = single(by_pixel);
            weighed.by_pixel[axis][lane] = by_pixel as f32;
            weighed.offset_from_cell[axis][lane] = edges.offset_from_cell[axis][lane] as f32;
        }
        let derivatives = passage.derivatives();
        for (lanes, derivative) in weighed.parts[BIAS_PARTS..].iter_mut().zip(derivatives.as_array()) {
            lanes[lane] = single(-derivative * weight);
        }
    }
}

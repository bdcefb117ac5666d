//! Two statistics of the distances of the observations from their predicted positions.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::Problem;
use super::State;
use super::observation_range::{EventResidual, point_residuals};
use evcal_geometry::numerics::statistics::median;

/// Statistics of the distances of observations from their predicted positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ResidualStatistics {
    /// Number of residuals.
    pub count: usize,
    /// Root mean square (px).
    pub rms: f64,
    /// Median of the absolute value (px).
    pub median: f64,
}

/// The kind of distance that residuals measure. Figures of different kinds cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Measured {
    /// Events, from the edge of their circle.
    #[serde(rename = "event edge distance")]
    EventEdges,
    /// Centres of circles, from their projection.
    #[serde(rename = "circle centre distance")]
    CircleCentres,
    /// Corners of squares, from their projection.
    #[serde(rename = "corner distance")]
    Corners,
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The same text as in files.
        self.serialize(f)
    }
}

/// Computes statistics of all residuals of `problem` at `state`; `events` are the residuals of its events.
pub fn residual_statistics(problem: &Problem, state: &State, events: &[EventResidual]) -> ResidualStatistics {
    let mut sizes: Vec<f32> = events.iter().map(|event| event.residual.abs()).collect();
    sizes.extend(point_residuals(problem, state).iter().map(|point| point.residual.norm() as f32));
    let count = sizes.len();
    if count == 0 {
        return ResidualStatistics::default();
    }
    let square: f64 = sizes.iter().map(|&size| f64::from(size) * f64::from(size)).sum();
    let middle = median(&mut sizes, f32::total_cmp).unwrap_or(0.0);
    ResidualStatistics { count, rms: (square / count as f64).sqrt(), median: f64::from(middle) }
}

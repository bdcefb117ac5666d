//! How far the observations are from where a state puts them, in two figures.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::stretch::{EventResidual, point_residuals};
use super::{Problem, State};
use evcal_geometry::numerics::statistics::median;

/// How far events are from where the model puts them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ResidualStatistics {
    /// Number of residuals.
    pub count: usize,
    /// Root mean square (px).
    pub rms: f64,
    /// Median of the absolute value (px).
    pub median: f64,
}

/// What residuals are distances of: kinds whose figures cannot be compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Measured {
    /// Events, from the edge of their circle.
    #[serde(rename = "event edge distance")]
    EventEdges,
    /// Centres of circles, from where the result puts them.
    #[serde(rename = "circle centre distance")]
    CircleCentres,
    /// Corners of squares, from where the result puts them.
    #[serde(rename = "corner distance")]
    Corners,
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // As it is written to files.
        self.serialize(f)
    }
}

/// Statistics of all residuals of `problem` at `state`; `events` are those of its events.
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

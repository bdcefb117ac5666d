//! The result of a calibration, as it is written to `calibration.json`.

use serde::Serialize;

use crate::camera_file::{CameraDescription, SensorSize};
use crate::event_bias::{CLASS_COUNT, ClassBias};
use crate::burst::RANK_COUNT;
use crate::report::StageReports;

/// Everything that a calibration found out. Field order is the order in the file.
#[derive(Clone, Debug, Serialize)]
pub struct Calibration {
    /// Always `evcal-calibration`.
    pub format: &'static str,
    /// Version of this layout.
    pub version: u32,
    /// Version of the program.
    pub program: &'static str,
    /// Where pixel (0, 0) is.
    pub pixel_convention: &'static str,
    /// Size of the sensor.
    pub sensor: SensorSize,
    /// The lens.
    pub camera: CameraDescription,
    /// Standard deviation of each lens parameter if residuals were independent: a lower bound.
    pub sigma: CameraDescription,
    /// The lens before the joint solve.
    pub initial_camera: CameraDescription,
    /// The board, as on the command line.
    pub board: String,
    /// Event classes and their biases; empty when the input is circle centres.
    pub event_classes: Vec<EventClass>,
    /// How far the observations are from where the result puts them.
    pub residuals: Residuals,
    /// Trajectory segments.
    pub segments: Vec<SegmentSummary>,
    /// What every stage took in and gave out.
    pub stages: StageReports,
}

/// One event class: polarity and rank in the burst.
#[derive(Clone, Debug, Serialize)]
pub struct EventClass {
    /// `off` or `on`.
    pub polarity: &'static str,
    /// Rank in the burst, 0 for the first event; the last rank stands for all later ones.
    pub rank: usize,
    /// Offset from the geometric edge in pixels (positive outside the dot), latency in seconds
    /// relative to the first OFF event, spread in pixels.
    #[serde(flatten)]
    pub bias: ClassBias,
}

impl EventClass {
    /// All classes with their biases.
    pub fn all(bias: &[ClassBias; CLASS_COUNT]) -> Vec<Self> {
        bias.iter()
            .enumerate()
            .map(|(class, bias)| Self {
                polarity: if class < RANK_COUNT { "off" } else { "on" },
                rank: class % RANK_COUNT,
                bias: *bias,
            })
            .collect()
    }
}

/// Residuals of the observations that the final solve used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Residuals {
    /// `event edge distance` or `circle centre distance`: two figures that cannot be compared.
    pub measure: &'static str,
    /// Number of observations.
    pub count: usize,
    /// Root mean square in pixels.
    pub rms: f64,
    /// Median of the absolute value in pixels.
    pub median: f64,
}

/// One trajectory segment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SegmentSummary {
    /// Recording it belongs to.
    pub recording: usize,
    /// Start in seconds since the recording's first event.
    pub start: f64,
    /// End.
    pub end: f64,
    /// Number of control points.
    pub control_points: usize,
    /// Number of observations.
    pub observations: usize,
}

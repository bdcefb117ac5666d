//! The result of a calibration, as it is written to `calibration.json`.

use serde::Serialize;

use crate::burst::RANK_COUNT;
use crate::calibrate::{Calibrated, StageReports};
use crate::camera_file::{CameraDescription, Parameters, SensorSize};
use crate::event_bias::{CLASS_COUNT, ClassBias};

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

impl Calibration {
    /// The result of `calibrated`, seen on `board`.
    pub fn new(calibrated: &Calibrated, board: &crate::board::Board) -> Self {
        let state = &calibrated.refined.state;
        let camera = &state.camera;
        let names = camera.kind().parameter_names();
        let last = calibrated.refined.rounds.last();
        let sigma = Parameters::new(names.iter().enumerate().map(|(index, name)| {
            let value = last.and_then(|round| round.solve.sigma.get(index)).copied().unwrap_or(0.0);
            (*name, value)
        }));
        let from_events = calibrated.refined.segments.iter().any(|segment| !segment.events.is_empty());
        let statistics = calibrated.refined.residuals;
        let segments = state.trajectories.iter().zip(&calibrated.refined.segments);
        Self {
            format: "evcal-calibration",
            version: 1,
            program: env!("CARGO_PKG_VERSION"),
            pixel_convention: "pixel (0, 0) is the centre of the top-left pixel (OpenCV, ROS)",
            sensor: SensorSize { width: calibrated.sensor.0, height: calibrated.sensor.1 },
            camera: CameraDescription::new(camera),
            sigma: CameraDescription { model: camera.kind().name().to_owned(), parameters: sigma },
            initial_camera: CameraDescription::new(&calibrated.initial.camera),
            board: board.to_string(),
            event_classes: if from_events { EventClass::all(&state.bias) } else { Vec::new() },
            residuals: Residuals {
                measure: if from_events { "event edge distance" } else { "circle centre distance" },
                count: statistics.count,
                rms: statistics.rms,
                median: statistics.median,
            },
            segments: segments
                .map(|(trajectory, observations)| SegmentSummary {
                    recording: trajectory.recording,
                    start: trajectory.start(),
                    end: trajectory.end(),
                    control_points: trajectory.control_point_count(),
                    observations: observations.events.len() + observations.points.len(),
                })
                .collect(),
            stages: calibrated.reports.clone(),
        }
    }
}

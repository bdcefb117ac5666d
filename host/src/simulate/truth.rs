//! What is known of a simulated recording, beside its events and its trajectory.

use evcal_core::camera::Camera;
use serde::{Deserialize, Serialize};

use super::{EventCounts, Simulation, SimulationSettings};

/// The camera of a simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrueCamera {
    /// Name of the camera model.
    pub model: String,
    /// Columns of the sensor.
    pub width: u16,
    /// Rows of the sensor.
    pub height: u16,
    /// Names of the parameters, in the model's order.
    pub parameter_names: Vec<String>,
    /// Their values.
    pub parameters: Vec<f64>,
}

/// Everything that makes a simulated recording, and what came out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// The lens and the size of the sensor.
    pub camera: TrueCamera,
    /// The board, as on the command line.
    pub board: String,
    /// Scene, pixels, motion, seed and duration.
    pub settings: SimulationSettings,
    /// Mean image speed of the board's points in view while the camera moves, in pixels per second.
    pub mean_speed: f64,
    /// Number of events, OFF and ON.
    pub events: [u64; 2],
}

impl TrueCamera {
    /// The lens `camera` before a `width` × `height` sensor.
    pub fn new(camera: &Camera<f64>, width: u16, height: u16) -> Self {
        let kind = camera.kind();
        Self {
            model: kind.name().to_owned(),
            width,
            height,
            parameter_names: kind.parameter_names().iter().map(|&name| name.to_owned()).collect(),
            parameters: camera.parameters().to_vec(),
        }
    }
}

impl Truth {
    /// The truth of `simulation` through the lens `camera`, which gave these `counts`.
    pub fn new(camera: &Camera<f64>, simulation: &Simulation, counts: EventCounts) -> Self {
        let settings = simulation.settings().clone();
        let board = simulation.scene().board();
        let rays = simulation.rays();
        Self {
            camera: TrueCamera::new(camera, rays.width(), rays.height()),
            board: board.to_string(),
            mean_speed: simulation.motion().mean_speed(board, rays, settings.duration),
            events: [counts.off, counts.on],
            settings,
        }
    }
}

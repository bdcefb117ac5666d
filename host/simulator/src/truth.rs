//! Ground truth of a simulated recording, except its events and its trajectory.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use serde::{Deserialize, Serialize};

use super::davis::DavisDescription;
use super::motion_capture::MotionCaptureDescription;
use super::second_camera::SecondCameraDescription;
use super::{EventCounts, Simulation, SimulationSettings};
use evcal_geometry::lens::camera_file::CameraDescription;

/// All parameters of a simulated recording and its event counts. In JSON it is also a camera file (see
/// [`evcal_geometry::lens::camera_file`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Truth {
    /// Size of the sensor.
    pub sensor: Sensor,
    /// The lens.
    pub camera: CameraDescription,
    /// Description of the board, as on the command line.
    pub board: String,
    /// Scene, pixels, motion, seed and duration.
    pub settings: SimulationSettings,
    /// Mean image speed of the board's points in view while the camera moves, in pixels per second.
    pub mean_speed: f64,
    /// Number of OFF events.
    pub off_events: u64,
    /// Number of ON events.
    pub on_events: u64,
    /// Frames and IMU samples, if enabled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub davis: Option<DavisDescription>,
    /// Motion capture, if enabled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub motion_capture: Option<MotionCaptureDescription>,
    /// A second camera, if enabled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub second_camera: Option<SecondCameraDescription>,
}

impl Truth {
    /// Creates the ground truth of `simulation` through the lens `camera`, which produced these `counts` of events and
    /// no other streams.
    pub fn new(camera: &Camera<f64>, simulation: &Simulation, counts: EventCounts) -> Self {
        let settings = simulation.settings().clone();
        let board = simulation.scene().nominal_board();
        let rays = simulation.rays();
        Self {
            sensor: rays.sensor(),
            camera: CameraDescription::new(camera),
            board: board.to_string(),
            mean_speed: simulation.motion().mean_speed(board, rays, settings.duration),
            off_events: counts.off,
            on_events: counts.on,
            settings,
            davis: None,
            motion_capture: None,
            second_camera: None,
        }
    }
}

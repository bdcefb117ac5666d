//! Motion capture of the simulated camera: a marker body on the camera, in a room with its own frame and clock.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::{Simulation, SimulationError};
use evcal_geometry::numerics::random::{normal, uniform};
use evcal_geometry::timed_pose::TimedPose;

/// Stream of random numbers for noise and dropouts.
const CAPTURE_STREAM: u64 = u64::MAX - 5;
/// Typical length of a dropout (s).
const DROPOUT: f64 = 0.1;

/// Settings of a capture system and of the marker body.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MotionCaptureSettings {
    /// Poses per second.
    pub rate: f64,
    /// σ of a position along each axis in metres.
    pub position_noise: f64,
    /// σ of a rotation about each axis in degrees.
    pub rotation_noise: f64,
    /// Fraction of the poses that are missing, in dropouts of about 0.1 s.
    pub dropouts: f64,
    /// Position of the marker body in the camera's frame, in metres: the translation of `T_camera_body`.
    pub body_position: [f64; 3],
    /// Rotation of the marker body, as a rotation vector in degrees: the rotation of `T_camera_body`.
    pub body_rotation: [f64; 3],
    /// Position of the board in the capture's frame, in metres: the translation of `T_mocap_world`.
    pub world_position: [f64; 3],
    /// Rotation of the board, as a rotation vector in degrees: the rotation of `T_mocap_world`.
    pub world_rotation: [f64; 3],
    /// t_mocap − t_events at the start of the recording, in seconds.
    pub clock_offset: f64,
    /// Amount by which the capture's clock is faster, in parts per million.
    pub clock_drift: f64,
}

impl Default for MotionCaptureSettings {
    /// A system of infrared cameras with a marker body a few centimetres above the camera.
    fn default() -> Self {
        Self {
            rate: 120.0,
            position_noise: 3e-4,
            rotation_noise: 0.2,
            dropouts: 0.02,
            body_position: [0.015, -0.06, -0.03],
            body_rotation: [70.0, 20.0, -110.0],
            world_position: [1.4, 0.9, -2.2],
            world_rotation: [85.0, 10.0, 30.0],
            clock_offset: 12.345_67,
            clock_drift: 20.0,
        }
    }
}

fn pose(position: [f64; 3], rotation: [f64; 3]) -> Isometry3<f64> {
    let rotation = UnitQuaternion::new(Vector3::from(rotation).map(f64::to_radians));
    Isometry3::from_parts(Translation3::from(Vector3::from(position)), rotation)
}

impl MotionCaptureSettings {
    /// Checks all settings; returns an error with the first setting that is out of range.
    pub fn check(&self) -> Result<(), SimulationError> {
        let numbers = [self.body_position, self.body_rotation, self.world_position, self.world_rotation].concat();
        let checks = [
            ("motion_capture.rate", self.rate, (1.0..=2000.0).contains(&self.rate), "1 to 2000 Hz"),
            (
                "motion_capture.position_noise",
                self.position_noise,
                (0.0..1.0).contains(&self.position_noise),
                "0 to 1 m",
            ),
            (
                "motion_capture.rotation_noise",
                self.rotation_noise,
                (0.0..90.0).contains(&self.rotation_noise),
                "0 to 90 degrees",
            ),
            ("motion_capture.dropouts", self.dropouts, (0.0..0.9).contains(&self.dropouts), "at least 0 and below 0.9"),
            ("motion_capture.clock_offset", self.clock_offset, self.clock_offset.is_finite(), "a number"),
            ("motion_capture.clock_drift", self.clock_drift, self.clock_drift.abs() <= 1e4, "-10000 to 10000 ppm"),
        ];
        if let Some((name, value, _, range)) = checks.into_iter().find(|(.., right, _)| !right) {
            return Err(SimulationError::Setting { name, value, range });
        }
        match numbers.into_iter().find(|value| !value.is_finite()) {
            Some(value) => Err(SimulationError::Setting { name: "motion_capture", value, range: "numbers" }),
            None => Ok(()),
        }
    }

    /// Returns `T_camera_body`.
    pub fn camera_body(&self) -> Isometry3<f64> {
        pose(self.body_position, self.body_rotation)
    }

    /// Returns `T_mocap_world`.
    pub fn mocap_world(&self) -> Isometry3<f64> {
        pose(self.world_position, self.world_rotation)
    }

    /// Returns the poses `T_mocap_body` that the system measures in `simulation`, on its own clock.
    pub fn capture(&self, simulation: &Simulation) -> Vec<TimedPose> {
        let settings = simulation.settings();
        let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
        random.set_stream(CAPTURE_STREAM);
        let count = (settings.duration * self.rate).floor() as usize;
        let mut poses = Vec::with_capacity(count);
        let mut lost = 0_usize;
        for index in 0..=count {
            let t = index as f64 / self.rate;
            let mut vector = |size: f64| Vector3::from_fn(|_, _| size * normal(&mut random));
            let (shift, turn) = (vector(self.position_noise), vector(self.rotation_noise.to_radians()));
            if lost == 0 && uniform(&mut random) < self.dropouts / (DROPOUT * self.rate * (1.0 - self.dropouts)) {
                lost = (2.0 * DROPOUT * self.rate * uniform(&mut random)).ceil() as usize;
            }
            if lost > 0 {
                lost -= 1;
                continue;
            }
            let body = self.mocap_world() * simulation.pose(t) * self.camera_body();
            let position = Translation3::from(body.translation.vector + shift);
            let pose = Isometry3::from_parts(position, body.rotation * UnitQuaternion::new(turn));
            poses.push(TimedPose { t: self.clock_offset + t * (1.0 + 1e-6 * self.clock_drift), pose });
        }
        poses
    }
}

/// Description of a capture in `truth.json`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionCaptureDescription {
    /// The settings.
    pub settings: MotionCaptureSettings,
    /// `T_camera_body`, row by row.
    #[serde(rename = "T_camera_body")]
    pub camera_body: [[f64; 4]; 4],
    /// `T_mocap_world`, row by row.
    #[serde(rename = "T_mocap_world")]
    pub mocap_world: [[f64; 4]; 4],
}

impl MotionCaptureDescription {
    /// Describes a capture with these settings.
    pub fn new(settings: MotionCaptureSettings) -> Self {
        let rows = |pose: Isometry3<f64>| pose.to_homogeneous().transpose().into();
        Self { settings, camera_body: rows(settings.camera_body()), mocap_world: rows(settings.mocap_world()) }
    }
}

//! All settings of a simulated recording except the lens and the board.

use serde::{Deserialize, Serialize};

use super::light::Lamp;
use super::motion::MotionSettings;
use super::scene::SceneSettings;
use super::sensor::{Arbiter, SensorModel};

/// Settings of a simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SimulationSettings {
    /// Length of the recording in seconds, rounded to 50 µs.
    pub duration: f64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Radiances and size of the sheet.
    pub scene: SceneSettings,
    /// Pixels.
    pub sensor: SensorModel,
    /// Motion of the camera.
    pub motion: MotionSettings,
}

/// Reason why a simulation cannot be set up.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimulationError {
    /// The lens sees nothing along the middle row or column.
    #[error("the camera model has no bearing for most of the sensor: check its parameters and the sensor size")]
    NoFieldOfView,
    /// The lens of the second camera is invalid.
    #[error("second_camera.camera is not a valid lens: take it from a truth.json or calibration.json")]
    SecondLens,
    /// A shape of dots was set for a board of squares.
    #[error("simulation setting scene.dots is {0}; a board of squares has no dots")]
    NoDots(&'static str),
    /// A setting is outside its range.
    #[error("simulation setting {name} is {value}; it must be {range}")]
    Setting {
        /// Path of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Allowed range.
        range: &'static str,
    },
}

impl evcal_files::remedy::Remedy for SimulationError {}

impl SimulationSettings {
    /// Checks all settings; returns an error with the first setting that is out of range.
    pub fn check(&self) -> Result<(), SimulationError> {
        let Self { duration, scene, sensor, motion, .. } = self;
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let share = |value: f64| (0.0..1.0).contains(&value);
        let [farthest, nearest] = motion.fill;
        let [slowest, fastest] = sensor.hot_rate;
        let photoreceptor = sensor.photoreceptor.map_or((1.0, 1.0), |low_pass| (low_pass.bandwidth, low_pass.offset));
        let arbiter = sensor.arbiter.unwrap_or(Arbiter { latency: 0.0, jitter: 0.0, event_time: 0.0, row_time: 0.0 });
        let lamp = scene.lamp.unwrap_or(Lamp { frequency: 1.0, depth: 0.0 });
        let scan = sensor.scan.unwrap_or(1e-6);
        const POSITIVE: &str = "above 0";
        const NOT_NEGATIVE: &str = "0 or above";
        const SHARE: &str = "at least 0 and below 1";
        let checks = [
            ("duration", *duration, *duration > 0.0 && *duration <= 1e5, "above 0 and at most 100000 s"),
            ("scene.white", scene.white, positive(scene.white), POSITIVE),
            ("scene.black", scene.black, positive(scene.black), POSITIVE),
            ("scene.background", scene.background, positive(scene.background), POSITIVE),
            ("scene.margin", scene.margin, not_negative(scene.margin), NOT_NEGATIVE),
            ("scene.lamp.frequency", lamp.frequency, (0.1..=1000.0).contains(&lamp.frequency), "from 0.1 to 1000 Hz"),
            ("scene.lamp.depth", lamp.depth, share(lamp.depth), SHARE),
            (
                "sensor.point_spread",
                sensor.point_spread,
                positive(sensor.point_spread) && sensor.point_spread <= 10.0,
                "above 0 and at most 10 px",
            ),
            ("sensor.threshold_on", sensor.threshold_on, sensor.threshold_on >= 0.05, "0.05 or above"),
            ("sensor.threshold_off", sensor.threshold_off, sensor.threshold_off >= 0.05, "0.05 or above"),
            (
                "sensor.threshold_mismatch",
                sensor.threshold_mismatch,
                not_negative(sensor.threshold_mismatch),
                NOT_NEGATIVE,
            ),
            ("sensor.threshold_jitter", sensor.threshold_jitter, not_negative(sensor.threshold_jitter), NOT_NEGATIVE),
            ("sensor.photoreceptor.bandwidth", photoreceptor.0, positive(photoreceptor.0), POSITIVE),
            ("sensor.photoreceptor.offset", photoreceptor.1, not_negative(photoreceptor.1), NOT_NEGATIVE),
            ("sensor.refractory", sensor.refractory, not_negative(sensor.refractory), NOT_NEGATIVE),
            ("sensor.dark", sensor.dark, not_negative(sensor.dark), NOT_NEGATIVE),
            ("sensor.vignette", sensor.vignette, share(sensor.vignette), SHARE),
            ("sensor.leak_rate", sensor.leak_rate, not_negative(sensor.leak_rate), NOT_NEGATIVE),
            ("sensor.noise_rate", sensor.noise_rate, (0.0..=1e4).contains(&sensor.noise_rate), "from 0 to 10000 Hz"),
            ("sensor.noise_spread", sensor.noise_spread, (0.0..=1.0).contains(&sensor.noise_spread), "from 0 to 1"),
            (
                "sensor.hot_rate",
                slowest,
                (0.0..=1e4).contains(&slowest) && slowest <= fastest,
                "from 0 to the upper rate",
            ),
            ("sensor.hot_rate", fastest, (0.0..=1e4).contains(&fastest), "from the lower rate to 10000 Hz"),
            ("sensor.arbiter.latency", arbiter.latency, not_negative(arbiter.latency), NOT_NEGATIVE),
            ("sensor.arbiter.jitter", arbiter.jitter, not_negative(arbiter.jitter), NOT_NEGATIVE),
            ("sensor.arbiter.event_time", arbiter.event_time, not_negative(arbiter.event_time), NOT_NEGATIVE),
            ("sensor.arbiter.row_time", arbiter.row_time, not_negative(arbiter.row_time), NOT_NEGATIVE),
            ("sensor.scan", scan, (1e-6..=0.01).contains(&scan), "from 1 to 10000 us"),
            ("motion.mean_speed", motion.mean_speed, positive(motion.mean_speed), POSITIVE),
            (
                "motion.speed_variation",
                motion.speed_variation,
                (0.0..=0.9).contains(&motion.speed_variation),
                "from 0 to 0.9",
            ),
            ("motion.fill", farthest, farthest > 0.01 && farthest <= nearest, "above 0.01 and at most the nearest"),
            ("motion.fill", nearest, nearest <= 1.2, "at most 1.2"),
            ("motion.distance_scale", motion.distance_scale, positive(motion.distance_scale), POSITIVE),
            ("motion.tilt", motion.tilt, (0.0..80.0).contains(&motion.tilt), "at least 0 and below 80 degrees"),
            ("motion.roll", motion.roll, not_negative(motion.roll), NOT_NEGATIVE),
            ("motion.roll_offset", motion.roll_offset, motion.roll_offset.is_finite(), "a number"),
            ("motion.overshoot", motion.overshoot, (-1.0..=1.0).contains(&motion.overshoot), "from -1 to 1"),
            ("motion.aim", motion.aim[0], motion.aim[0].abs() <= 1.0, "from -1 to 1"),
            ("motion.aim", motion.aim[1], motion.aim[1].abs() <= 1.0, "from -1 to 1"),
            ("motion.reach", motion.reach, (0.0..=1.0).contains(&motion.reach), "from 0 to 1"),
            ("motion.tremor", motion.tremor, (0.0..=5.0).contains(&motion.tremor), "from 0 to 5 degrees"),
        ];
        for (name, value, right, range) in checks {
            if !right {
                return Err(SimulationError::Setting { name, value, range });
            }
        }
        for (name, spans) in [("motion.pauses", &motion.pauses), ("motion.absences", &motion.absences)] {
            if let Some(span) =
                spans.iter().find(|span| !(span.start.is_finite() && span.end.is_finite() && span.start <= span.end))
            {
                return Err(SimulationError::Setting {
                    name,
                    value: span.end,
                    range: "a start and an end not before it",
                });
            }
        }
        Ok(())
    }
}

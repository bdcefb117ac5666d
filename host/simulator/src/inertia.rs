//! The IMU of a DAVIS: readings of gyroscope and accelerometer during the motion.
//!
//! The IMU is at the camera's projection centre, its axes are the camera's (x right, y down, z along the line of
//! sight), and the board hangs upright: gravity points along the world's y. At rest with the image upright it reads −1
//! g on y, as a real one does. Noise and bias are those of an MPU-9250 on real cameras. With a [`mount`](super::mount)
//! it is offset from the camera and has filters, scale errors and misalignment as well.

use nalgebra::{Isometry3, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use usb_davis::protocol::{ImuModel, ImuSample, ImuScale};

use super::SimulationError;
use super::inertial_truth::InertialTruth;
use super::mount::{Mount, MountSettings, MountTruth};
use evcal_geometry::numerics::random::normal;

/// Stream of random numbers for biases and noise.
const INERTIA_STREAM: u64 = u64::MAX - 3;

/// Settings of the IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InertialSettings {
    /// Time between samples in whole milliseconds, 1 to 256.
    pub interval: u16,
    /// 0 to 3: ±2, ±4, ±8, ±16 g.
    pub accelerometer_scale: u8,
    /// 0 to 3: ±250, ±500, ±1000, ±2000 °/s.
    pub gyroscope_scale: u8,
    /// Standard deviation of an accelerometer sample in g.
    pub accelerometer_noise: f64,
    /// Standard deviation of a gyroscope sample in °/s.
    pub gyroscope_noise: f64,
    /// Standard deviation in g of the distribution from which each axis' constant error is drawn.
    pub accelerometer_bias: f64,
    /// Standard deviation in °/s of the distribution from which each axis' constant error is drawn.
    pub gyroscope_bias: f64,
    /// Temperature of the chip in °C.
    pub temperature: f64,
    /// Additional properties of a real IMU; without them, a perfect IMU is at the camera.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<MountSettings>,
}

impl Default for InertialSettings {
    fn default() -> Self {
        Self {
            interval: 1,
            accelerometer_scale: 1,
            gyroscope_scale: 1,
            accelerometer_noise: 0.002,
            gyroscope_noise: 0.06,
            accelerometer_bias: 0.02,
            gyroscope_bias: 1.0,
            temperature: 29.0,
            mount: None,
        }
    }
}

impl InertialSettings {
    /// Returns an IMU without noise and bias.
    pub fn ideal() -> Self {
        Self {
            accelerometer_noise: 0.0,
            gyroscope_noise: 0.0,
            accelerometer_bias: 0.0,
            gyroscope_bias: 0.0,
            ..Self::default()
        }
    }

    /// Returns the IMU of a DAVIS346: offset from the camera, with filters, scale errors and misalignment.
    pub fn davis346() -> Self {
        // The mount adds the noise.
        Self {
            accelerometer_noise: 0.0,
            gyroscope_noise: 0.0,
            mount: Some(MountSettings::default()),
            ..Self::default()
        }
    }

    /// Checks all settings; returns an error with the first setting that is out of range.
    pub fn check(&self) -> Result<(), SimulationError> {
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        const NOT_NEGATIVE: &str = "0 or above";
        const SCALE: &str = "0 to 3";
        let checks = [
            ("imu.interval", f64::from(self.interval), (1..=256).contains(&self.interval), "1 to 256 ms"),
            ("imu.accelerometer_scale", f64::from(self.accelerometer_scale), self.accelerometer_scale < 4, SCALE),
            ("imu.gyroscope_scale", f64::from(self.gyroscope_scale), self.gyroscope_scale < 4, SCALE),
            ("imu.accelerometer_noise", self.accelerometer_noise, not_negative(self.accelerometer_noise), NOT_NEGATIVE),
            ("imu.gyroscope_noise", self.gyroscope_noise, not_negative(self.gyroscope_noise), NOT_NEGATIVE),
            ("imu.accelerometer_bias", self.accelerometer_bias, not_negative(self.accelerometer_bias), NOT_NEGATIVE),
            ("imu.gyroscope_bias", self.gyroscope_bias, not_negative(self.gyroscope_bias), NOT_NEGATIVE),
            ("imu.temperature", self.temperature, (-40.0..=85.0).contains(&self.temperature), "-40 to 85 degrees"),
        ];
        match checks.into_iter().find(|(.., right, _)| !right) {
            Some((name, value, _, range)) => Err(SimulationError::Setting { name, value, range }),
            None => self.mount.map_or(Ok(()), |mount| mount.check()),
        }
    }
}

/// Constant errors of an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InertialBias {
    /// Bias of the accelerometer, in g.
    pub acceleration: [f64; 3],
    /// Bias of the gyroscope, in °/s.
    pub angular_velocity: [f64; 3],
    /// The other errors of a real IMU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mount: Option<MountTruth>,
}

/// An IMU with its biases.
#[derive(Clone, Debug)]
pub struct InertialUnit {
    settings: InertialSettings,
    bias: InertialBias,
    mount: Option<Mount>,
    rng: ChaCha8Rng,
}

impl InertialUnit {
    /// Creates an IMU with biases and noise from `seed`.
    pub fn new(settings: InertialSettings, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(INERTIA_STREAM);
        let mount = settings.mount.map(|mount| Mount::new(mount, seed));
        let bias = InertialBias {
            acceleration: [0; 3].map(|_| settings.accelerometer_bias * normal(&mut rng)),
            angular_velocity: [0; 3].map(|_| settings.gyroscope_bias * normal(&mut rng)),
            mount: mount.as_ref().map(Mount::truth),
        };
        Self { settings, bias, mount, rng }
    }

    /// Returns the constant errors.
    pub fn bias(&self) -> InertialBias {
        self.bias
    }

    /// Returns the ideal readings at `time` µs along `pose` (`T_world_camera` at a time in seconds), and the actual
    /// readings; `None` if the sample is lost. Times must increase.
    pub fn sample(&mut self, pose: impl Fn(f64) -> Isometry3<f64>, time: u64) -> Option<(InertialTruth, ImuSample)> {
        let Some(mount) = &mut self.mount else {
            let ideal_reading = InertialTruth::new(pose, time);
            return Some((ideal_reading, self.read(&ideal_reading)));
        };
        let ideal_reading = mount.ideal_reading(&pose, time);
        let [acceleration, angular_velocity] = mount.output(&pose, time)?;
        Some((ideal_reading, self.read(&InertialTruth { time, acceleration, angular_velocity })))
    }

    /// Returns the actual readings for the ideal readings `truth`. Each call adds new noise.
    pub fn read(&mut self, truth: &InertialTruth) -> ImuSample {
        let Self { settings, bias, rng, .. } = self;
        let scale = ImuScale { accelerometer: settings.accelerometer_scale, gyroscope: settings.gyroscope_scale };
        let accelerometer_step = f64::from(2u16 << scale.accelerometer.min(3)) / 32768.0;
        let gyroscope_step = f64::from(250u16 << scale.gyroscope.min(3)) / 32768.0;
        let mut axes = |truth: &Vector3<f64>, bias: &[f64; 3], noise: f64, step: f64| {
            let mut raw = [0; 3];
            for (raw, (truth, bias)) in raw.iter_mut().zip(truth.iter().zip(bias)) {
                *raw = quantise((truth + bias + noise * normal(rng)) / step);
            }
            raw
        };
        let acceleration =
            axes(&truth.acceleration, &bias.acceleration, settings.accelerometer_noise, accelerometer_step);
        let angular_velocity =
            axes(&truth.angular_velocity, &bias.angular_velocity, settings.gyroscope_noise, gyroscope_step);
        ImuSample {
            time: truth.time,
            acceleration: Some(acceleration),
            angular_velocity: Some(angular_velocity),
            // Formula of the data sheet: 333.87 steps per degree, zero at 21 °C.
            temperature: Some(quantise((settings.temperature - 21.0) * 333.87)),
            scale,
            model: ImuModel::Mpu9250,
        }
    }
}

/// Returns the nearest 16-bit number; readings beyond the range are clamped.
fn quantise(value: f64) -> i16 {
    libm::round(value).clamp(f64::from(i16::MIN), f64::from(i16::MAX)) as i16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::{Motion, MotionSettings};
    use crate::rays::Rays;
    use crate::tests::{board, radtan};
    use evcal_core::sensor::Sensor;
    use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
    use nalgebra::UnitQuaternion;

    #[test]
    fn at_rest_the_imu_measures_one_g_upwards() {
        for angle in [0.0, 90.0f64] {
            let turn = UnitQuaternion::from_euler_angles(0.0, 0.0, angle.to_radians());
            let truth = InertialTruth::new(|_| Isometry3::from_parts(Vector3::new(0.1, 0.2, -0.7).into(), turn), 1000);
            let (sine, cosine) = angle.to_radians().sin_cos();
            assert!((truth.acceleration - Vector3::new(-sine, -cosine, 0.0)).norm() < 1e-6, "{truth:?}");
            assert!(truth.angular_velocity.norm() < 1e-9);
        }
    }

    /// Integrating the ideal readings reproduces the trajectory.
    #[test]
    fn readings_integrate_to_the_motion() {
        let motion =
            Motion::new(&MotionSettings::fast(), &board(), &Rays::new(&radtan(), Sensor::new(346, 260)), 2.0, 5)
                .unwrap();
        let pose = |t: f64| motion.pose(t);
        let start = pose(0.1);
        let mut rotation = start.rotation;
        let mut position = start.translation.vector;
        let mut velocity = (pose(0.1 + 1e-5).translation.vector - pose(0.1 - 1e-5).translation.vector) / 2e-5;
        let step = 1e-3;
        for index in 0..500u64 {
            // Readings in the middle of each millisecond.
            let truth = InertialTruth::new(pose, 100_500 + 1000 * index);
            let half = UnitQuaternion::new(truth.angular_velocity.map(f64::to_radians) * (0.5 * step));
            rotation *= half;
            let gravity = Vector3::new(0.0, STANDARD_GRAVITY, 0.0);
            let acceleration = rotation * (truth.acceleration * STANDARD_GRAVITY) + gravity;
            rotation *= half;
            position += velocity * step + acceleration * (0.5 * step * step);
            velocity += acceleration * step;
        }
        let end = pose(0.6);
        let travelled = (end.translation.vector - start.translation.vector).norm();
        assert!(travelled > 0.05, "{travelled}");
        assert!(rotation.angle_to(&end.rotation) < 2e-5, "{}", rotation.angle_to(&end.rotation));
        assert!((position - end.translation.vector).norm() < 1e-4, "{}", (position - end.translation.vector).norm());
    }

    #[test]
    fn readings_are_truth_bias_and_noise_in_the_sensors_steps() {
        let truth = InertialTruth {
            time: 7000,
            acceleration: Vector3::new(0.5, -1.0, 9.0),
            angular_velocity: Vector3::new(100.0, -30.0, 0.0),
        };
        let sample = InertialUnit::new(InertialSettings::ideal(), 1).read(&truth);
        // 8192 steps per g, 65.536 per °/s; readings beyond ±4 g are clamped.
        assert_eq!(sample.acceleration, Some([4096, -8192, 32767]));
        assert_eq!(sample.angular_velocity, Some([6554, -1966, 0]));
        assert!((sample.temperature_celsius().unwrap() - 29.0).abs() < 0.01);

        let mut unit = InertialUnit::new(InertialSettings::default(), 1);
        let bias = unit.bias();
        let readings: Vec<f64> =
            (0..4000).map(|_| f64::from(unit.read(&truth).angular_velocity_degrees().unwrap()[0])).collect();
        let mean = readings.iter().sum::<f64>() / 4000.0;
        let deviation = (readings.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / 3999.0).sqrt();
        assert!((mean - 100.0 - bias.angular_velocity[0]).abs() < 0.005, "{mean}");
        assert!((deviation - 0.06).abs() < 0.003, "{deviation}");
    }
}

//! Properties of a real IMU compared with a perfect one: position, rotation, filters, scale errors, misalignment,
//! noise, random walks and lost samples.
//!
//! The axes of the IMU are the axes of the accelerometer, as in Kalibr's model with scale and misalignment. From the
//! specific force f and the angular velocity ω, the accelerometer reads M_a f + b_a and the gyroscope M_g C ω + b_g,
//! with lower triangular matrices M and a rotation C from the IMU's axes to the gyroscope's. Both readings, and their
//! noise, pass a low-pass filter with two equal poles.

use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::SimulationError;
use super::inertial_truth::InertialTruth;
use evcal_geometry::numerics::random::{normal, uniform, uniform_in};

/// Stream of random numbers for scale errors, misalignments, noise and losses.
const MOUNT_STREAM: u64 = u64::MAX - 4;
/// Time step of the filters, in microseconds.
const STEP: u64 = 250;

/// Settings of a real IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MountSettings {
    /// Position in the camera's frame, in metres.
    pub position: [f64; 3],
    /// Rotation, as a rotation vector in degrees: R_imu_camera is its exponential.
    pub rotation: [f64; 3],
    /// Largest deviation of the entries of M from the unit matrix.
    pub scale_error: f64,
    /// Largest rotation of the gyroscope's axes relative to the accelerometer's, about each axis, in degrees.
    pub gyroscope_turn: f64,
    /// Delay of the accelerometer's filter, in seconds.
    pub accelerometer_delay: f64,
    /// Delay of the gyroscope's filter, in seconds.
    pub gyroscope_delay: f64,
    /// White noise of the accelerometer before its filter, in g/√Hz: standard deviation of a sample divided by the
    /// square root of the sampling rate.
    pub accelerometer_noise_density: f64,
    /// White noise of the gyroscope before its filter, in °/s/√Hz.
    pub gyroscope_noise_density: f64,
    /// Random walk of the accelerometer's bias, in g/√s.
    pub accelerometer_walk: f64,
    /// Random walk of the gyroscope's bias, in °/s/√s.
    pub gyroscope_walk: f64,
    /// Fraction of the samples that are lost.
    pub lost: f64,
}

impl Default for MountSettings {
    /// Returns the IMU of a DAVIS346, an MPU-9250 with its usual filters.
    fn default() -> Self {
        Self {
            position: [0.003, -0.002, -0.020],
            rotation: [0.9, -0.8, 0.9],
            scale_error: 0.02,
            gyroscope_turn: 0.5,
            accelerometer_delay: 1.9e-3,
            gyroscope_delay: 2.9e-3,
            accelerometer_noise_density: 300e-6,
            gyroscope_noise_density: 0.01,
            accelerometer_walk: 2e-5,
            gyroscope_walk: 2e-4,
            lost: 0.0,
        }
    }
}

impl MountSettings {
    /// Checks all settings; returns an error with the first setting that is out of range.
    pub fn check(&self) -> Result<(), SimulationError> {
        let finite = |values: [f64; 3]| if values.iter().all(|value| value.is_finite()) { 0.0 } else { f64::NAN };
        const NOT_NEGATIVE: &str = "0 or above";
        let within = |value: f64, end: f64| (0.0..=end).contains(&value);
        let checks = [
            ("imu.mount.position", finite(self.position), f64::INFINITY, "finite"),
            ("imu.mount.rotation", finite(self.rotation), f64::INFINITY, "finite"),
            ("imu.mount.scale_error", self.scale_error, 0.2, "0 to 0.2"),
            ("imu.mount.gyroscope_turn", self.gyroscope_turn, 10.0, "0 to 10 degrees"),
            ("imu.mount.accelerometer_delay", self.accelerometer_delay, 0.1, "0 to 0.1 s"),
            ("imu.mount.gyroscope_delay", self.gyroscope_delay, 0.1, "0 to 0.1 s"),
            ("imu.mount.accelerometer_noise_density", self.accelerometer_noise_density, f64::MAX, NOT_NEGATIVE),
            ("imu.mount.gyroscope_noise_density", self.gyroscope_noise_density, f64::MAX, NOT_NEGATIVE),
            ("imu.mount.accelerometer_walk", self.accelerometer_walk, f64::MAX, NOT_NEGATIVE),
            ("imu.mount.gyroscope_walk", self.gyroscope_walk, f64::MAX, NOT_NEGATIVE),
            ("imu.mount.lost", self.lost, 1.0, "0 to 1"),
        ];
        match checks.into_iter().find(|&(_, value, end, _)| !within(value, end)) {
            Some((name, value, _, range)) => Err(SimulationError::Setting { name, value, range }),
            None => Ok(()),
        }
    }

    /// Returns the pose of the camera in the frame of the IMU, T_imu_camera.
    pub fn imu_from_camera(&self) -> Isometry3<f64> {
        let rotation = UnitQuaternion::new(Vector3::from(self.rotation).map(f64::to_radians));
        Isometry3::from_parts(Translation3::from(-(rotation * Vector3::from(self.position))), rotation)
    }
}

/// Random properties of a real IMU, as in `truth.json`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MountTruth {
    /// T_imu_camera, row by row.
    pub imu_from_camera: [[f64; 4]; 4],
    /// M_a, row by row.
    pub accelerometer_matrix: [[f64; 3]; 3],
    /// M_g, row by row.
    pub gyroscope_matrix: [[f64; 3]; 3],
    /// C, row by row.
    pub gyroscope_from_imu: [[f64; 3]; 3],
}

/// A low-pass filter with two equal poles.
#[derive(Clone, Copy, Debug)]
struct LowPass {
    /// Fraction of the old state that remains after a step.
    kept: f64,
    state: Option<[Vector3<f64>; 2]>,
}

impl LowPass {
    fn new(delay: f64) -> Self {
        let kept = if delay > 0.0 { libm::exp(-(STEP as f64) * 1e-6 / (0.5 * delay)) } else { 0.0 };
        Self { kept, state: None }
    }

    /// Filters the next input. `input` is the mean over the step that ends now, by the trapezium rule. With this mean
    /// the filter has the delay of its two poles, without an additional half step.
    fn push(&mut self, input: Vector3<f64>) -> Vector3<f64> {
        let [first, second] = self.state.unwrap_or([input; 2]);
        let next_first = input + (first - input) * self.kept;
        let middle = (first + next_first) * 0.5;
        let next_second = if self.kept > 0.0 { middle + (second - middle) * self.kept } else { next_first };
        self.state = Some([next_first, next_second]);
        next_second
    }
}

/// State of a real IMU.
#[derive(Clone, Debug)]
pub struct Mount {
    settings: MountSettings,
    truth: MountTruth,
    accelerometer: Matrix3<f64>,
    gyroscope: Matrix3<f64>,
    filters: [LowPass; 2],
    walks: [Vector3<f64>; 2],
    time: u64,
    before: Option<[Vector3<f64>; 2]>,
    rng: ChaCha8Rng,
}

impl Mount {
    /// Creates an IMU with errors from `seed`.
    pub fn new(settings: MountSettings, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(MOUNT_STREAM);
        let mut triangle = || {
            let error = settings.scale_error;
            let drawn = Matrix3::from_fn(|_, _| uniform_in(&mut rng, -error, error));
            Matrix3::identity() + drawn.lower_triangle()
        };
        let (accelerometer, of_gyroscope) = (triangle(), triangle());
        let end = settings.gyroscope_turn.to_radians();
        let turn = Vector3::from_fn(|_, _| uniform_in(&mut rng, -end, end));
        let turn = UnitQuaternion::new(turn).to_rotation_matrix().into_inner();
        let rows = |matrix: &Matrix3<f64>| matrix.transpose().into();
        let truth = MountTruth {
            imu_from_camera: settings.imu_from_camera().to_homogeneous().transpose().into(),
            accelerometer_matrix: rows(&accelerometer),
            gyroscope_matrix: rows(&of_gyroscope),
            gyroscope_from_imu: rows(&turn),
        };
        let filters = [settings.accelerometer_delay, settings.gyroscope_delay].map(LowPass::new);
        Self {
            settings,
            truth,
            accelerometer,
            gyroscope: of_gyroscope * turn,
            filters,
            walks: [Vector3::zeros(); 2],
            time: 0,
            before: None,
            rng,
        }
    }

    /// Returns the random properties.
    pub fn truth(&self) -> MountTruth {
        self.truth
    }

    /// Returns the ideal readings of a perfect IMU at the same position at `time` µs; `pose` is T_world_camera at a
    /// time in seconds.
    pub fn ideal_reading(&self, pose: impl Fn(f64) -> Isometry3<f64>, time: u64) -> InertialTruth {
        let camera_from_imu = self.settings.imu_from_camera().inverse();
        InertialTruth::new(|t| pose(t) * camera_from_imu, time)
    }

    /// Returns acceleration (g) and angular velocity (°/s) at `time` µs without the constant bias; `None` if the sample
    /// is lost. Times must increase.
    pub fn output(&mut self, pose: impl Fn(f64) -> Isometry3<f64>, time: u64) -> Option<[Vector3<f64>; 2]> {
        let mut output = [Vector3::zeros(); 2];
        while self.time < time {
            self.time += STEP.min(time - self.time);
            output = self.step(&pose);
        }
        (uniform(&mut self.rng) >= self.settings.lost).then_some(output)
    }

    fn step(&mut self, pose: &impl Fn(f64) -> Isometry3<f64>) -> [Vector3<f64>; 2] {
        let ideal_reading = self.ideal_reading(pose, self.time);
        let length = STEP as f64 * 1e-6;
        let settings = &self.settings;
        let noises = [settings.accelerometer_noise_density, settings.gyroscope_noise_density];
        let walks = [settings.accelerometer_walk, settings.gyroscope_walk];
        let now = [self.accelerometer * ideal_reading.acceleration, self.gyroscope * ideal_reading.angular_velocity];
        let before = self.before.replace(now).unwrap_or(now);
        std::array::from_fn(|sensor| {
            let mut noise = |size: f64| Vector3::from_fn(|_, _| size * normal(&mut self.rng));
            self.walks[sensor] += noise(walks[sensor] * length.sqrt());
            // A filter receives the mean over the step; without a filter, the reading is the current value.
            let smooth =
                if self.filters[sensor].kept > 0.0 { (before[sensor] + now[sensor]) * 0.5 } else { now[sensor] };
            let input = smooth + noise(noises[sensor] / length.sqrt());
            self.filters[sensor].push(input + self.walks[sensor])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn turning(t: f64) -> Isometry3<f64> {
        let turn = Vector3::new(0.3 * (3.0 * t).sin(), 0.4 * (4.0 * t).sin(), 0.2 * t * t);
        Isometry3::new(Vector3::new(0.1 * (2.0 * t).sin(), 0.05, -0.6), turn)
    }

    fn quiet() -> MountSettings {
        MountSettings {
            scale_error: 0.0,
            gyroscope_turn: 0.0,
            accelerometer_noise_density: 0.0,
            gyroscope_noise_density: 0.0,
            accelerometer_walk: 0.0,
            gyroscope_walk: 0.0,
            ..MountSettings::default()
        }
    }

    /// f = R_ic (f_camera + (ω' × r + ω × (ω × r)) / g), with the derivative of ω by differences.
    #[test]
    fn the_imu_measures_the_acceleration_at_its_own_position() {
        let settings = quiet();
        let mount = Mount::new(settings, 1);
        let time = 700_000;
        let camera = |time| InertialTruth::new(turning, time);
        let ideal_reading = mount.ideal_reading(turning, time);
        let turn = settings.imu_from_camera().rotation;
        let radians = |time| camera(time).angular_velocity.map(f64::to_radians);
        let (before, w, after) = (radians(time - 1000), radians(time), radians(time + 1000));
        let r = Vector3::from(settings.position);
        let lever = ((after - before) / 2e-3).cross(&r) + w.cross(&w.cross(&r));
        let expected = turn * (camera(time).acceleration + lever / evcal_geometry::numerics::gravity::STANDARD_GRAVITY);
        assert!((ideal_reading.acceleration - expected).norm() < 1e-5, "{} {expected}", ideal_reading.acceleration);
        assert!((ideal_reading.angular_velocity - turn * camera(time).angular_velocity).norm() < 1e-6);
        assert!(lever.norm() > 0.05);
    }

    #[test]
    fn filters_have_the_specified_delay() {
        let mut mount = Mount::new(quiet(), 1);
        for time in (1000..1_500_000).step_by(1000) {
            let [_, turning_rate] = mount.output(turning, time).unwrap();
            if time > 100_000 {
                let late = mount.ideal_reading(turning, time - 2900).angular_velocity;
                let wrong = mount.ideal_reading(turning, time - 2400).angular_velocity;
                let distance = (turning_rate - late).norm();
                assert!(distance < 0.02, "{time}: {turning_rate} {late}");
                assert!(distance < 0.1 * (turning_rate - wrong).norm() + 5e-3);
            }
        }
    }

    /// White noise has the specified density: over 50 ms, long compared with the filters, the mean has the variance
    /// density² / T.
    #[test]
    fn noise_has_the_specified_density() {
        let settings = MountSettings { accelerometer_noise_density: 0.001, gyroscope_noise_density: 0.01, ..quiet() };
        let still = |_| Isometry3::identity();
        let mut mount = Mount::new(settings, 7);
        let truth = mount.ideal_reading(still, 0);
        let mut sums = [0.0; 2];
        let blocks = 600;
        for block in 0..blocks {
            let mut means = [Vector3::<f64>::zeros(); 2];
            for sample in 1..=50 {
                let [a, w] = mount.output(still, 50_000 * block + 1000 * sample).unwrap();
                means[0] += (a - truth.acceleration) / 50.0;
                means[1] += (w - truth.angular_velocity) / 50.0;
            }
            sums.iter_mut().zip(means).for_each(|(sum, mean)| *sum += mean.norm_squared());
        }
        for (sum, density) in sums.into_iter().zip([0.001, 0.01]) {
            let found = (sum / (3.0 * blocks as f64) * 0.05).sqrt();
            assert!((found / density - 1.0).abs() < 0.06, "{found} for {density}");
        }
    }

    #[test]
    fn the_specified_share_of_samples_is_lost() {
        let mut mount = Mount::new(MountSettings { lost: 0.05, ..quiet() }, 3);
        let lost = (1..=2000).filter(|index| mount.output(turning, 1000 * index).is_none()).count();
        assert!((60..140).contains(&lost), "{lost}");
    }
}

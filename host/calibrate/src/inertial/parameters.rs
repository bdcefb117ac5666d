//! The parameters of an IMU, and the model of its readings.
//!
//! With the pose T_world_camera = (R, p), its rates ω, ω' in the camera frame, the position r of the IMU in the camera frame and
//! gravity g in the world, the specific force at the IMU, in its own axes, is
//!
//! f = R_imu_camera [Rᵀ (s p'' − g) + ω' × r + ω × (ω × r)].
//!
//! Its accelerometer reads M_a f + b_a, its gyroscope M_g C R_imu_camera ω + b_g, each at the time t − d of the trajectory for a
//! sample with timestamp t. M are lower triangular, and C rotates the IMU's axes, which are the accelerometer's, to the
//! gyroscope's: the model that Kalibr calls `scale-misalignment`. s is the true divided by the stated spacing of the board.
//!
//! Each sensor has a low-pass filter. In addition to the delay, it lowers amplitudes by c (2π f)² to first order, which adds c
//! times the second derivative to the signal. For example, a gyroscope may lose 0.5 % at a tremor of 8 Hz. If this were
//! ignored, the trajectory would rotate too little and translate instead, which at the board's distance makes the lever
//! arm millimetres too long.

use evcal_core::spline::rotation::exp;
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

/// Number of parameters.
pub const COUNT: usize = 35;
/// First of the three parameters of R_imu_camera, perturbed on the right, about the axes of the camera (rad).
pub const ROTATION: usize = 0;
/// First of the three components of r (m).
pub const POSITION: usize = 3;
/// Delay of the gyroscope (s).
pub const GYROSCOPE_DELAY: usize = 6;
/// Delay of the accelerometer (s).
pub const ACCELEROMETER_DELAY: usize = 7;
/// First of the three components of b_g (rad/s).
pub const GYROSCOPE_BIAS: usize = 8;
/// First of the three components of b_a (m/s²).
pub const ACCELEROMETER_BIAS: usize = 11;
/// First of the two angles of gravity's direction (rad).
pub const GRAVITY: usize = 14;
/// First of the six entries of M_a.
pub const ACCELEROMETER_MATRIX: usize = 16;
/// First of the six entries of M_g.
pub const GYROSCOPE_MATRIX: usize = 22;
/// First of the three parameters of C, perturbed on the right (rad).
pub const GYROSCOPE_TURN: usize = 28;
/// s.
pub const BOARD_SCALE: usize = 31;
/// Drift of the IMU's clock (s/s).
pub const CLOCK_DRIFT: usize = 32;

/// c of the gyroscope (s²).
pub const GYROSCOPE_FILTER: usize = 33;
/// c of the accelerometer (s²).
pub const ACCELEROMETER_FILTER: usize = 34;

/// Rows and columns of a lower triangular matrix, in the order of its parameters.
pub const TRIANGLE: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

/// The parameters of an IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct InertialParameters {
    /// R_imu_camera.
    pub rotation: UnitQuaternion<f64>,
    /// Position of the IMU in the camera frame (m).
    pub position: Vector3<f64>,
    /// Time by which the gyroscope's timestamps are later than the events of the same moment (s).
    pub gyroscope_delay: f64,
    /// The same for the accelerometer.
    pub accelerometer_delay: f64,
    /// b_g (rad/s).
    pub gyroscope_bias: Vector3<f64>,
    /// b_a (m/s²).
    pub accelerometer_bias: Vector3<f64>,
    /// Gravity in the world (m/s²), pointing down.
    pub gravity: Vector3<f64>,
    /// M_a.
    pub accelerometer_matrix: Matrix3<f64>,
    /// M_g.
    pub gyroscope_matrix: Matrix3<f64>,
    /// C.
    pub gyroscope_from_imu: UnitQuaternion<f64>,
    /// s.
    pub board_scale: f64,
    /// Seconds that the IMU's clock gains on the events' clock per second.
    pub clock_drift: f64,
    /// c of the gyroscope's filter (s²).
    pub gyroscope_filter: f64,
    /// c of the accelerometer's filter (s²).
    pub accelerometer_filter: f64,
    /// Time of the trajectory at which the delays apply (s).
    pub middle: f64,
}

impl InertialParameters {
    /// Returns an IMU at the camera with its axes and without errors, with gravity `gravity` (m/s²); delays apply at `middle`
    /// (s).
    pub fn perfect(gravity: Vector3<f64>, middle: f64) -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            position: Vector3::zeros(),
            gyroscope_delay: 0.0,
            accelerometer_delay: 0.0,
            gyroscope_bias: Vector3::zeros(),
            accelerometer_bias: Vector3::zeros(),
            gravity,
            accelerometer_matrix: Matrix3::identity(),
            gyroscope_matrix: Matrix3::identity(),
            gyroscope_from_imu: UnitQuaternion::identity(),
            board_scale: 1.0,
            clock_drift: 0.0,
            gyroscope_filter: 0.0,
            accelerometer_filter: 0.0,
            middle,
        }
    }

    /// Returns T_imu_camera: from camera coordinates to the IMU's.
    pub fn imu_from_camera(&self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(-(self.rotation * self.position)), self.rotation)
    }

    /// Returns two directions perpendicular to gravity, each times its magnitude.
    pub fn gravity_directions(&self) -> [Vector3<f64>; 2] {
        let size = self.gravity.norm();
        let down = self.gravity / size;
        let aside = if down.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
        let first = down.cross(&aside).normalize();
        [first * size, down.cross(&first) * size]
    }

    /// Returns the parameters after a step, in their order; rotations are perturbed on the right.
    pub fn moved(&self, step: &[f64]) -> Self {
        let at = |index: usize| step.get(index).copied().unwrap_or(0.0);
        let three = |first: usize| Vector3::new(at(first), at(first + 1), at(first + 2));
        let triangle = |matrix: &Matrix3<f64>, first: usize| {
            let mut moved = *matrix;
            TRIANGLE.iter().enumerate().for_each(|(index, place)| moved[*place] += at(first + index));
            moved
        };
        let [first, second] = self.gravity_directions();
        let gravity = self.gravity + first * at(GRAVITY) + second * at(GRAVITY + 1);
        Self {
            rotation: UnitQuaternion::new_normalize((self.rotation * exp(&three(ROTATION))).into_inner()),
            position: self.position + three(POSITION),
            gyroscope_delay: self.gyroscope_delay + at(GYROSCOPE_DELAY),
            accelerometer_delay: self.accelerometer_delay + at(ACCELEROMETER_DELAY),
            gyroscope_bias: self.gyroscope_bias + three(GYROSCOPE_BIAS),
            accelerometer_bias: self.accelerometer_bias + three(ACCELEROMETER_BIAS),
            gravity: gravity * (self.gravity.norm() / gravity.norm()),
            accelerometer_matrix: triangle(&self.accelerometer_matrix, ACCELEROMETER_MATRIX),
            gyroscope_matrix: triangle(&self.gyroscope_matrix, GYROSCOPE_MATRIX),
            gyroscope_from_imu: self.gyroscope_from_imu * exp(&three(GYROSCOPE_TURN)),
            board_scale: self.board_scale + at(BOARD_SCALE),
            clock_drift: self.clock_drift + at(CLOCK_DRIFT),
            gyroscope_filter: self.gyroscope_filter + at(GYROSCOPE_FILTER),
            accelerometer_filter: self.accelerometer_filter + at(ACCELEROMETER_FILTER),
            middle: self.middle,
        }
    }

    /// Returns the trajectory time of a gyroscope sample with timestamp `t`.
    pub fn gyroscope_time(&self, t: f64) -> f64 {
        t - self.gyroscope_delay - self.clock_drift * (t - self.middle)
    }

    /// Returns the trajectory time of an accelerometer sample with timestamp `t`.
    pub fn accelerometer_time(&self, t: f64) -> f64 {
        t - self.accelerometer_delay - self.clock_drift * (t - self.middle)
    }
}

//! What is calibrated of an inertial unit, and what it should read.
//!
//! With the pose T_world_camera = (R, p), its rates ω, ω' in the camera frame, the place r of the unit in the camera frame and
//! gravity g in the world, the unit feels, in its own axes,
//!
//! f = R_imu_camera [Rᵀ (s p'' − g) + ω' × r + ω × (ω × r)],
//!
//! its accelerometer reads M_a f + b_a, its gyroscope M_g C R_imu_camera ω + b_g, each at the time t − d of the trajectory for a
//! sample stamped t. M are lower triangular, C turns the unit's axes, which are the accelerometer's, to the gyroscope's: the
//! model that Kalibr calls `scale-misalignment`. s is the true over the stated spacing of the board.
//!
//! Each sensor has a low-pass filter. Beside the delay it lowers amplitudes by c (2π f)² to first order, which adds c times the
//! second derivative to what is felt. A gyroscope that reads 0.5 % too little of a tremor at 8 Hz would otherwise have the
//! trajectory turn too little and move instead, and at the board's distance that is a lever arm millimetres too long.

use evcal_core::spline::rotation::exp;
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

/// Number of parameters.
pub const COUNT: usize = 35;
/// First of the three of R_imu_camera, turned on the right, about the axes of the camera (rad).
pub const ROTATION: usize = 0;
/// First of the three of r (m).
pub const POSITION: usize = 3;
/// Delay of the gyroscope (s).
pub const GYROSCOPE_DELAY: usize = 6;
/// Delay of the accelerometer (s).
pub const ACCELEROMETER_DELAY: usize = 7;
/// First of the three of b_g (rad/s).
pub const GYROSCOPE_BIAS: usize = 8;
/// First of the three of b_a (m/s²).
pub const ACCELEROMETER_BIAS: usize = 11;
/// First of the two angles of gravity's direction (rad).
pub const GRAVITY: usize = 14;
/// First of the six entries of M_a.
pub const ACCELEROMETER_MATRIX: usize = 16;
/// First of the six entries of M_g.
pub const GYROSCOPE_MATRIX: usize = 22;
/// First of the three of C, turned on the right (rad).
pub const GYROSCOPE_TURN: usize = 28;
/// s.
pub const BOARD_SCALE: usize = 31;
/// Drift of the unit's clock (s/s).
pub const CLOCK_DRIFT: usize = 32;

/// c of the gyroscope (s²).
pub const GYROSCOPE_FILTER: usize = 33;
/// c of the accelerometer (s²).
pub const ACCELEROMETER_FILTER: usize = 34;

/// Rows and columns of a lower triangle, in the order of its parameters.
pub const TRIANGLE: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

/// What is calibrated of an inertial unit.
#[derive(Clone, Debug, PartialEq)]
pub struct InertialParameters {
    /// R_imu_camera.
    pub rotation: UnitQuaternion<f64>,
    /// Where the unit is in the camera frame (m).
    pub position: Vector3<f64>,
    /// How much later the gyroscope's stamps are than the events of the same moment (s).
    pub gyroscope_delay: f64,
    /// The same for the accelerometer.
    pub accelerometer_delay: f64,
    /// b_g (rad/s).
    pub gyroscope_bias: Vector3<f64>,
    /// b_a (m/s²).
    pub accelerometer_bias: Vector3<f64>,
    /// Gravity in the world (m/s²): it points down.
    pub gravity: Vector3<f64>,
    /// M_a.
    pub accelerometer_matrix: Matrix3<f64>,
    /// M_g.
    pub gyroscope_matrix: Matrix3<f64>,
    /// C.
    pub gyroscope_from_imu: UnitQuaternion<f64>,
    /// s.
    pub board_scale: f64,
    /// Seconds that the unit's clock gains on that of the events in a second.
    pub clock_drift: f64,
    /// c of the gyroscope's filter (s²).
    pub gyroscope_filter: f64,
    /// c of the accelerometer's filter (s²).
    pub accelerometer_filter: f64,
    /// Time of the trajectory at which the delays are stated (s).
    pub middle: f64,
}

impl InertialParameters {
    /// A unit at the camera that has its axes and no errors, where gravity is `gravity` (m/s²); delays are stated at `middle` (s).
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

    /// T_imu_camera: from camera coordinates to the unit's.
    pub fn imu_from_camera(&self) -> Isometry3<f64> {
        Isometry3::from_parts(Translation3::from(-(self.rotation * self.position)), self.rotation)
    }

    /// Two directions across gravity, each times its size.
    pub fn gravity_directions(&self) -> [Vector3<f64>; 2] {
        let size = self.gravity.norm();
        let down = self.gravity / size;
        let aside = if down.x.abs() < 0.8 { Vector3::x() } else { Vector3::y() };
        let first = down.cross(&aside).normalize();
        [first * size, down.cross(&first) * size]
    }

    /// Moved by a step in the order of the parameters; rotations are turned on the right.
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

    /// Time of the trajectory at which a sample stamped `t` of the gyroscope was true.
    pub fn gyroscope_time(&self, t: f64) -> f64 {
        t - self.gyroscope_delay - self.clock_drift * (t - self.middle)
    }

    /// The same for the accelerometer.
    pub fn accelerometer_time(&self, t: f64) -> f64 {
        t - self.accelerometer_delay - self.clock_drift * (t - self.middle)
    }
}

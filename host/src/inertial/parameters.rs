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

use evcal_core::spline::rotation::{exp, skew};
use evcal_core::spline::{Basis, Knots};
use evcal_core::spline::{MAX_ORDER, RotationMotion, quaternion, vector};
use nalgebra::{Isometry3, Matrix3, Translation3, UnitQuaternion, Vector3};

use crate::trajectory::{RotationControl, Trajectory};

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
/// Half the time over which rates and readings are differentiated (s): far below the distance of knots.
const STEP: f64 = 3e-4;

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

/// The trajectory at one time, as an inertial unit feels it.
pub struct Motion {
    /// Control points and weights.
    pub basis: Basis<f64>,
    /// Rotation, its rates and their Jacobians.
    pub rotation: RotationMotion<f64>,
    /// p'' (m/s²) in the world.
    pub acceleration: Vector3<f64>,
}

impl Motion {
    /// At time `t`; `None` outside the trajectory or where its rotations are no sum of quaternions.
    pub fn new(trajectory: &Trajectory, t: f64) -> Option<Self> {
        let basis = Knots::assume_valid(&trajectory.knots, trajectory.degree).basis(t).ok()?;
        let RotationControl::Quaternion(control) = &trajectory.rotation else { return None };
        let rotation = quaternion::motion(&basis, control)?;
        let acceleration = vector::evaluate(&basis, &trajectory.translation)?.second_derivative;
        Some(Self { basis, rotation, acceleration })
    }

    /// Angular velocity in the camera frame (rad/s).
    pub fn angular_velocity(&self) -> Vector3<f64> {
        self.rotation.sample.angular_velocity
    }

    /// What an accelerometer with the axes of the camera feels at the place of the unit.
    pub fn felt(&self, parameters: &InertialParameters) -> Vector3<f64> {
        let (w, r) = (self.angular_velocity(), parameters.position);
        let free = self.acceleration * parameters.board_scale - parameters.gravity;
        self.rotation.sample.rotation.inverse_transform_vector(&free)
            + self.rotation.angular_acceleration.cross(&r)
            + w.cross(&w.cross(&r))
    }
}

/// A predicted reading of one sensor with its derivatives.
pub struct Prediction {
    /// The reading.
    pub value: Vector3<f64>,
    /// By the parameters.
    pub by_parameters: [Vector3<f64>; COUNT],
    /// First control point.
    pub first: usize,
    /// By the rotation of each control point.
    pub by_rotation: [Matrix3<f64>; MAX_ORDER],
    /// By the place of each control point.
    pub by_translation: [Matrix3<f64>; MAX_ORDER],
}

impl Prediction {
    fn new(value: Vector3<f64>, first: usize) -> Self {
        Self {
            value,
            by_parameters: [Vector3::zeros(); COUNT],
            first,
            by_rotation: [Matrix3::zeros(); MAX_ORDER],
            by_translation: [Matrix3::zeros(); MAX_ORDER],
        }
    }

    fn set(&mut self, first: usize, columns: &Matrix3<f64>) {
        for axis in 0..3 {
            self.by_parameters[first + axis] = columns.column(axis).into();
        }
    }

    fn set_triangle(&mut self, first: usize, input: &Vector3<f64>) {
        for (index, (row, column)) in TRIANGLE.into_iter().enumerate() {
            self.by_parameters[first + index][row] = input[column];
        }
    }
}

/// A vector in camera axes with its derivatives by what is felt there, so that the filters can add multiples of it.
struct Felt {
    value: Vector3<f64>,
    by_position: Matrix3<f64>,
    by_gravity: [Vector3<f64>; 2],
    by_scale: Vector3<f64>,
    by_rotation: [Matrix3<f64>; MAX_ORDER],
    by_translation: [Matrix3<f64>; MAX_ORDER],
}

impl Felt {
    fn angular_velocity(motion: &Motion) -> Self {
        Self { by_rotation: motion.rotation.velocity_jacobians, ..Self::of(motion.angular_velocity()) }
    }

    fn angular_acceleration(motion: &Motion) -> Self {
        let RotationMotion { angular_acceleration, acceleration_jacobians, .. } = motion.rotation;
        Self { by_rotation: acceleration_jacobians, ..Self::of(angular_acceleration) }
    }

    fn force(motion: &Motion, parameters: &InertialParameters) -> Self {
        let to_camera = motion.rotation.sample.rotation.inverse().to_rotation_matrix().into_inner();
        let (w, r) = (motion.angular_velocity(), parameters.position);
        let free = to_camera * (motion.acceleration * parameters.board_scale - parameters.gravity);
        let turning = skew(&w);
        let (by_turn, by_acceleration) = (skew(&free), -skew(&r));
        let by_velocity = Matrix3::from_diagonal_element(w.dot(&r)) + w * r.transpose() - r * w.transpose() * 2.0;
        let by_place = to_camera * parameters.board_scale;
        let RotationMotion { sample, velocity_jacobians, acceleration_jacobians, .. } = &motion.rotation;
        Self {
            by_position: skew(&motion.rotation.angular_acceleration) + turning * turning,
            by_gravity: parameters.gravity_directions().map(|direction| -(to_camera * direction)),
            by_scale: to_camera * motion.acceleration,
            by_rotation: std::array::from_fn(|index| {
                by_turn * sample.jacobians[index]
                    + by_acceleration * acceleration_jacobians[index]
                    + by_velocity * velocity_jacobians[index]
            }),
            by_translation: std::array::from_fn(|index| by_place * motion.basis.second_derivative[index]),
            ..Self::of(motion.felt(parameters))
        }
    }

    fn of(value: Vector3<f64>) -> Self {
        Self {
            value,
            by_position: Matrix3::zeros(),
            by_gravity: [Vector3::zeros(); 2],
            by_scale: Vector3::zeros(),
            by_rotation: [Matrix3::zeros(); MAX_ORDER],
            by_translation: [Matrix3::zeros(); MAX_ORDER],
        }
    }

    fn add(&mut self, other: &Self, weight: f64) {
        self.value += other.value * weight;
        self.by_position += other.by_position * weight;
        self.by_scale += other.by_scale * weight;
        let sums = self.by_gravity.iter_mut().zip(&other.by_gravity);
        sums.for_each(|(sum, part)| *sum += part * weight);
        let sums = self.by_rotation.iter_mut().chain(&mut self.by_translation);
        sums.zip(other.by_rotation.iter().chain(&other.by_translation)).for_each(|(sum, part)| *sum += part * weight);
    }
}

/// The motion at the time nearest to `t` that has the span of `t` for [`STEP`] to both sides, then before and after it: all
/// three with the same control points.
fn around(trajectory: &Trajectory, t: f64) -> Option<[Motion; 3]> {
    let knots = Knots::assume_valid(&trajectory.knots, trajectory.degree);
    let span = knots.find_span(t).ok()?;
    let (start, end) = (*trajectory.knots.get(span)?, *trajectory.knots.get(span + 1)?);
    // Rounding must not carry it over the knot.
    let reach = STEP * 1.001;
    let middle = t.max(start + reach).min(end - reach);
    Some([
        Motion::new(trajectory, middle)?,
        Motion::new(trajectory, middle - STEP)?,
        Motion::new(trajectory, middle + STEP)?,
    ])
}

/// What the gyroscope should read (rad/s) in a sample stamped `t`; `None` outside the trajectory.
pub fn gyroscope(trajectory: &Trajectory, parameters: &InertialParameters, t: f64) -> Option<Prediction> {
    let time = parameters.gyroscope_time(t);
    let motion = Motion::new(trajectory, time)?;
    let [middle, before, after] = around(trajectory, time)?.map(|motion| Felt::angular_acceleration(&motion));
    let bend = (after.value - before.value) / (2.0 * STEP);
    let third = (after.value - middle.value * 2.0 + before.value) / (STEP * STEP);
    let mut felt = Felt::angular_velocity(&motion);
    let weight = parameters.gyroscope_filter / (2.0 * STEP);
    felt.add(&after, weight);
    felt.add(&before, -weight);

    let turn = parameters.rotation.to_rotation_matrix().into_inner();
    let to_gyroscope = parameters.gyroscope_from_imu.to_rotation_matrix().into_inner();
    let in_imu = turn * felt.value;
    let in_gyroscope = to_gyroscope * in_imu;
    let outer = parameters.gyroscope_matrix * to_gyroscope;
    let all = outer * turn;
    let mut prediction =
        Prediction::new(parameters.gyroscope_matrix * in_gyroscope + parameters.gyroscope_bias, motion.basis.first);
    prediction.set(ROTATION, &(-all * skew(&felt.value)));
    let by_time = -(all * (motion.rotation.angular_acceleration + third * parameters.gyroscope_filter));
    prediction.by_parameters[GYROSCOPE_DELAY] = by_time;
    prediction.by_parameters[CLOCK_DRIFT] = by_time * (t - parameters.middle);
    prediction.by_parameters[GYROSCOPE_FILTER] = all * bend;
    prediction.set(GYROSCOPE_BIAS, &Matrix3::identity());
    prediction.set_triangle(GYROSCOPE_MATRIX, &in_gyroscope);
    prediction.set(GYROSCOPE_TURN, &(-outer * skew(&in_imu)));
    prediction.by_rotation = felt.by_rotation.map(|jacobian| all * jacobian);
    Some(prediction)
}

/// What the accelerometer should read (m/s²) in a sample stamped `t`; `None` outside the trajectory.
pub fn accelerometer(trajectory: &Trajectory, parameters: &InertialParameters, t: f64) -> Option<Prediction> {
    let time = parameters.accelerometer_time(t);
    let motion = Motion::new(trajectory, time)?;
    let [middle, before, after] = around(trajectory, time)?.map(|motion| Felt::force(&motion, parameters));
    let rate = (after.value - before.value) / (2.0 * STEP);
    let bend = (after.value - middle.value * 2.0 + before.value) / (STEP * STEP);
    let mut felt = Felt::force(&motion, parameters);
    let weight = parameters.accelerometer_filter / (STEP * STEP);
    felt.add(&after, weight);
    felt.add(&middle, -2.0 * weight);
    felt.add(&before, weight);

    let turn = parameters.rotation.to_rotation_matrix().into_inner();
    let in_imu = turn * felt.value;
    let all = parameters.accelerometer_matrix * turn;
    let mut prediction =
        Prediction::new(parameters.accelerometer_matrix * in_imu + parameters.accelerometer_bias, motion.basis.first);
    prediction.set(ROTATION, &(-all * skew(&felt.value)));
    prediction.set(POSITION, &(all * felt.by_position));
    let by_time = -(all * rate);
    prediction.by_parameters[ACCELEROMETER_DELAY] = by_time;
    prediction.by_parameters[CLOCK_DRIFT] = by_time * (t - parameters.middle);
    prediction.by_parameters[ACCELEROMETER_FILTER] = all * bend;
    prediction.set(ACCELEROMETER_BIAS, &Matrix3::identity());
    for (index, by_direction) in felt.by_gravity.iter().enumerate() {
        prediction.by_parameters[GRAVITY + index] = all * by_direction;
    }
    prediction.set_triangle(ACCELEROMETER_MATRIX, &in_imu);
    prediction.by_parameters[BOARD_SCALE] = all * felt.by_scale;
    prediction.by_rotation = felt.by_rotation.map(|jacobian| all * jacobian);
    prediction.by_translation = felt.by_translation.map(|jacobian| all * jacobian);
    Some(prediction)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trajectory::CONTROL_POINT_PARAMETERS;

    fn trajectory() -> Trajectory {
        let count = 12;
        let turn = |i: usize| {
            let x = i as f64;
            exp(&Vector3::new(0.3 * (0.9 * x).sin(), 0.2 * (0.7 * x).cos(), 0.1 * x))
        };
        let mut knots = vec![0.0; 6];
        knots.extend((1..count - 5).map(|i| 0.022 * i as f64));
        knots.extend([0.022 * (count - 5) as f64; 6]);
        Trajectory {
            recording: 0,
            knots,
            degree: 5,
            translation: (0..count)
                .map(|i| Vector3::new((i as f64).sin(), (2.0 * i as f64).cos(), 0.3) * 0.01)
                .collect(),
            rotation: RotationControl::Quaternion((0..count).map(|i| turn(i).into_inner()).collect()),
        }
    }

    fn parameters() -> InertialParameters {
        InertialParameters {
            rotation: exp(&Vector3::new(0.3, -1.2, 0.4)),
            position: Vector3::new(0.03, -0.02, -0.05),
            gyroscope_delay: 0.003,
            accelerometer_delay: 0.002,
            gyroscope_bias: Vector3::new(0.1, 0.02, -0.03),
            accelerometer_bias: Vector3::new(0.2, -0.1, 0.3),
            gravity: Vector3::new(1.0, 9.0, -2.0),
            accelerometer_matrix: Matrix3::new(1.01, 0.0, 0.0, 0.02, 0.98, 0.0, -0.01, 0.005, 1.02),
            gyroscope_matrix: Matrix3::new(0.99, 0.0, 0.0, 0.01, 1.03, 0.0, 0.02, -0.015, 1.0),
            gyroscope_from_imu: exp(&Vector3::new(0.01, 0.02, -0.03)),
            board_scale: 1.02,
            clock_drift: 1e-4,
            gyroscope_filter: 2e-6,
            accelerometer_filter: 1e-6,
            middle: 0.05,
        }
    }

    type Sensor = fn(&Trajectory, &InertialParameters, f64) -> Option<Prediction>;

    #[test]
    fn derivatives_by_parameters_agree_with_differences() {
        let trajectory = trajectory();
        let step = 1e-6;
        for sensor in [gyroscope as Sensor, accelerometer] {
            for index in 0..COUNT {
                let mut parameters = parameters();
                if [ACCELEROMETER_DELAY, CLOCK_DRIFT].contains(&index) {
                    // How the filter's own part changes with time is left out.
                    parameters.accelerometer_filter = 0.0;
                }
                let at = |size: f64| {
                    let mut delta = [0.0; COUNT];
                    delta[index] = size;
                    sensor(&trajectory, &parameters.moved(&delta), 0.094).unwrap().value
                };
                let here = sensor(&trajectory, &parameters, 0.094).unwrap().by_parameters[index];
                let numeric = (at(step) - at(-step)) / (2.0 * step);
                assert!((numeric - here).norm() < 1e-3 * (1.0 + numeric.norm()), "{index}: {numeric} {here}");
            }
        }
    }

    #[test]
    fn derivatives_by_control_points_agree_with_differences() {
        let (trajectory, parameters) = (trajectory(), parameters());
        for sensor in [gyroscope as Sensor, accelerometer] {
            let here = sensor(&trajectory, &parameters, 0.09).unwrap();
            for place in 0..MAX_ORDER {
                for axis in 0..CONTROL_POINT_PARAMETERS {
                    let at = |size: f64| {
                        let mut delta = vec![0.0; CONTROL_POINT_PARAMETERS * trajectory.control_point_count()];
                        delta[CONTROL_POINT_PARAMETERS * (here.first + place) + axis] = size;
                        let mut moved = trajectory.clone();
                        moved.update(&delta);
                        sensor(&moved, &parameters, 0.09).unwrap().value
                    };
                    let numeric = (at(1e-7) - at(-1e-7)) / 2e-7;
                    let expected: Vector3<f64> = if axis < 3 {
                        here.by_rotation[place].column(axis).into()
                    } else {
                        here.by_translation[place].column(axis - 3).into()
                    };
                    assert!((numeric - expected).norm() < 1e-4 * (1.0 + numeric.norm()), "{place} {axis}");
                }
            }
        }
    }
}

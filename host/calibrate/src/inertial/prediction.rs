//! Predicted readings of an IMU along a trajectory, with their derivatives.

use evcal_core::spline::rotation::skew;
use evcal_core::spline::{Basis, Knots};
use evcal_core::spline::{MAX_ORDER, RotationMotion, quaternion, vector};
use nalgebra::{Matrix3, Vector3};

use super::parameters::{
    ACCELEROMETER_BIAS, ACCELEROMETER_DELAY, ACCELEROMETER_FILTER, ACCELEROMETER_MATRIX, BOARD_SCALE, CLOCK_DRIFT,
    COUNT, GRAVITY, GYROSCOPE_BIAS, GYROSCOPE_DELAY, GYROSCOPE_FILTER, GYROSCOPE_MATRIX, GYROSCOPE_TURN,
    InertialParameters, POSITION, ROTATION, TRIANGLE,
};
use evcal_solve::trajectory::{RotationControl, Trajectory};

/// Half the time over which rates and readings are differentiated (s): far below the knot spacing.
const STEP: f64 = 3e-4;

/// Motion of the trajectory at one time, from which IMU readings follow.
pub struct Motion {
    /// Control points and weights.
    pub basis: Basis<f64>,
    /// Rotation, its rates and their Jacobians.
    pub rotation: RotationMotion<f64>,
    /// p'' (m/s²) in the world.
    pub acceleration: Vector3<f64>,
}

impl Motion {
    /// Returns the motion at time `t`; `None` outside the trajectory or if its rotations are not sums of quaternions.
    pub fn new(trajectory: &Trajectory, t: f64) -> Option<Self> {
        let basis = Knots::assume_valid(&trajectory.knots, trajectory.degree).basis(t).ok()?;
        let RotationControl::Quaternion(control) = &trajectory.rotation else { return None };
        let rotation = quaternion::motion(&basis, control)?;
        let acceleration = vector::evaluate(&basis, &trajectory.translation)?.second_derivative;
        Some(Self { basis, rotation, acceleration })
    }

    /// Returns the angular velocity in the camera frame (rad/s).
    pub fn angular_velocity(&self) -> Vector3<f64> {
        self.rotation.sample.angular_velocity
    }

    /// Returns the specific force at the position of the IMU, in the axes of the camera.
    pub fn specific_force(&self, parameters: &InertialParameters) -> Vector3<f64> {
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
    /// Derivatives by the parameters.
    pub by_parameters: [Vector3<f64>; COUNT],
    /// First control point.
    pub first: usize,
    /// Derivatives by the rotation of each control point.
    pub by_rotation: [Matrix3<f64>; MAX_ORDER],
    /// Derivatives by the position of each control point.
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

/// A vector in camera axes with its derivatives by the motion, so that the filters can add multiples of it.
struct SensedVector {
    value: Vector3<f64>,
    by_position: Matrix3<f64>,
    by_gravity: [Vector3<f64>; 2],
    by_scale: Vector3<f64>,
    by_rotation: [Matrix3<f64>; MAX_ORDER],
    by_translation: [Matrix3<f64>; MAX_ORDER],
}

impl SensedVector {
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
            ..Self::of(motion.specific_force(parameters))
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

/// Returns the motion at the time nearest to `t` that is at least [`STEP`] from both ends of its knot span, then before and after
/// it: all three with the same control points.
fn around(trajectory: &Trajectory, t: f64) -> Option<[Motion; 3]> {
    let knots = Knots::assume_valid(&trajectory.knots, trajectory.degree);
    let span = knots.find_span(t).ok()?;
    let (start, end) = (*trajectory.knots.get(span)?, *trajectory.knots.get(span + 1)?);
    // Rounding must not move it across the knot.
    let reach = STEP * 1.001;
    let middle = t.max(start + reach).min(end - reach);
    Some([
        Motion::new(trajectory, middle)?,
        Motion::new(trajectory, middle - STEP)?,
        Motion::new(trajectory, middle + STEP)?,
    ])
}

/// Predicts the gyroscope's reading (rad/s) in a sample with timestamp `t`; `None` outside the trajectory.
pub fn gyroscope(trajectory: &Trajectory, parameters: &InertialParameters, t: f64) -> Option<Prediction> {
    let time = parameters.gyroscope_time(t);
    let motion = Motion::new(trajectory, time)?;
    let [middle, before, after] = around(trajectory, time)?.map(|motion| SensedVector::angular_acceleration(&motion));
    let bend = (after.value - before.value) / (2.0 * STEP);
    let third = (after.value - middle.value * 2.0 + before.value) / (STEP * STEP);
    let mut sensed = SensedVector::angular_velocity(&motion);
    let weight = parameters.gyroscope_filter / (2.0 * STEP);
    sensed.add(&after, weight);
    sensed.add(&before, -weight);

    let turn = parameters.rotation.to_rotation_matrix().into_inner();
    let to_gyroscope = parameters.gyroscope_from_imu.to_rotation_matrix().into_inner();
    let in_imu = turn * sensed.value;
    let in_gyroscope = to_gyroscope * in_imu;
    let outer = parameters.gyroscope_matrix * to_gyroscope;
    let all = outer * turn;
    let mut prediction =
        Prediction::new(parameters.gyroscope_matrix * in_gyroscope + parameters.gyroscope_bias, motion.basis.first);
    prediction.set(ROTATION, &(-all * skew(&sensed.value)));
    let by_time = -(all * (motion.rotation.angular_acceleration + third * parameters.gyroscope_filter));
    prediction.by_parameters[GYROSCOPE_DELAY] = by_time;
    prediction.by_parameters[CLOCK_DRIFT] = by_time * (t - parameters.middle);
    prediction.by_parameters[GYROSCOPE_FILTER] = all * bend;
    prediction.set(GYROSCOPE_BIAS, &Matrix3::identity());
    prediction.set_triangle(GYROSCOPE_MATRIX, &in_gyroscope);
    prediction.set(GYROSCOPE_TURN, &(-outer * skew(&in_imu)));
    prediction.by_rotation = sensed.by_rotation.map(|jacobian| all * jacobian);
    Some(prediction)
}

/// Predicts the accelerometer's reading (m/s²) in a sample with timestamp `t`; `None` outside the trajectory.
pub fn accelerometer(trajectory: &Trajectory, parameters: &InertialParameters, t: f64) -> Option<Prediction> {
    let time = parameters.accelerometer_time(t);
    let motion = Motion::new(trajectory, time)?;
    let [middle, before, after] = around(trajectory, time)?.map(|motion| SensedVector::force(&motion, parameters));
    let rate = (after.value - before.value) / (2.0 * STEP);
    let bend = (after.value - middle.value * 2.0 + before.value) / (STEP * STEP);
    let mut sensed = SensedVector::force(&motion, parameters);
    let weight = parameters.accelerometer_filter / (STEP * STEP);
    sensed.add(&after, weight);
    sensed.add(&middle, -2.0 * weight);
    sensed.add(&before, weight);

    let turn = parameters.rotation.to_rotation_matrix().into_inner();
    let in_imu = turn * sensed.value;
    let all = parameters.accelerometer_matrix * turn;
    let mut prediction =
        Prediction::new(parameters.accelerometer_matrix * in_imu + parameters.accelerometer_bias, motion.basis.first);
    prediction.set(ROTATION, &(-all * skew(&sensed.value)));
    prediction.set(POSITION, &(all * sensed.by_position));
    let by_time = -(all * rate);
    prediction.by_parameters[ACCELEROMETER_DELAY] = by_time;
    prediction.by_parameters[CLOCK_DRIFT] = by_time * (t - parameters.middle);
    prediction.by_parameters[ACCELEROMETER_FILTER] = all * bend;
    prediction.set(ACCELEROMETER_BIAS, &Matrix3::identity());
    for (index, by_direction) in sensed.by_gravity.iter().enumerate() {
        prediction.by_parameters[GRAVITY + index] = all * by_direction;
    }
    prediction.set_triangle(ACCELEROMETER_MATRIX, &in_imu);
    prediction.by_parameters[BOARD_SCALE] = all * sensed.by_scale;
    prediction.by_rotation = sensed.by_rotation.map(|jacobian| all * jacobian);
    prediction.by_translation = sensed.by_translation.map(|jacobian| all * jacobian);
    Some(prediction)
}

#[cfg(test)]
mod tests;

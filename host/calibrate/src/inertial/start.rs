//! Start of the IMU calibration: delay, rotation, lever arm and gravity, each with a test of its validity.
//!
//! 1. **Delay**: the rotation rates of camera and IMU, ‖ω − mean‖, are the same whatever their axes. Their normalised correlation
//!    over all shifts has peaks, at one of which the directions of ω agree, too.
//! 2. **Rotation**: the one that maps ω of the camera to ω of the IMU (Wahba's problem), and the best mirrored one: if the latter
//!    fits better, the axes are left-handed.
//! 3. **Lever arm, gravity, accelerometer bias**: linear least squares; gravity must have its known magnitude. If the opposite of
//!    each acceleration fits better, the image is mirrored: for the rotation rates, this is another rotation of the IMU.

use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::error::{IN_ANOTHER, IN_DEGREES, IN_RADIANS, InertialError};
use super::parameters::InertialParameters;
use super::prediction::Motion;
use super::sample::Sample;
use evcal_geometry::numerics::statistics::median;
use evcal_solve::trajectory::Trajectory;
use evcal_solve::trajectory::alignment::{
    AlignmentError, ComparedTurns, LEAST_RATE, Offset, Overlap, Series, Turns, check_axes, offset,
};

/// Step of the grid on which rates are compared (s).
const STEP: f64 = 5e-3;
/// Readings further apart than this, or than three intervals, leave a gap (s).
const LONGEST_GAP: f64 = 0.04;
/// Smallest overlap: as a share of the shorter stream, and in seconds.
const OVERLAP: Overlap = Overlap { share: 0.4, seconds: 1.0 };
/// Share of the angular velocity that varies, below which it counts as constant.
const EVENLY: f64 = 0.5;
/// Ratio of the second to the first singular value below which the camera rotated about one axis only.
const ONE_AXIS: f64 = 0.01;
/// Largest relative error of gravity's magnitude.
const GRAVITY_ERROR: f64 = 0.07;
/// Share of gravity below which it was removed from the accelerations, rather than measured wrongly.
const GRAVITY_LEFT: f64 = 0.2;
/// Share of the residual below which opposite accelerations fit clearly better.
const CLEARLY: f64 = 0.5;

/// Result of the start.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// The parameters.
    pub parameters: InertialParameters,
    /// Largest correlation of the rotation rates.
    pub correlation: f64,
}

/// Computes a start from the trajectories of one recording, whose rotations are sums of quaternions, and its samples;
/// `gravity` is the magnitude of gravity in m/s².
///
/// # Errors
/// [`InertialError`] names the quantity that was not found, and the reason.
pub fn start(trajectories: &[&Trajectory], samples: &[Sample], gravity: f64) -> Result<Start, InertialError> {
    let turning = camera_turns(trajectories);
    let whole = turning.rates().root_mean_square();
    let camera = without_mean(turning);
    let unit = without_mean(unit_values(samples, |sample| sample.angular_velocity));
    let rate = camera.rates().root_mean_square();
    if rate < LEAST_RATE && rate < EVENLY * whole {
        return Err(AlignmentError::EvenRotation { rate: whole.to_degrees() }.into());
    }
    camera.rates().check()?;
    let turns = camera.known().map(|rate| rate * rate.transpose()).sum::<Matrix3<f64>>();
    check_axes(&turns, ONE_AXIS)?;
    let Offset { seconds: delay, correlation } = offset(&camera, &unit, OVERLAP)?;
    let rotation = rotation(&camera, &unit, delay)?;
    let parameters = lever_arm(trajectories, samples, delay, rotation, gravity)?;
    Ok(Start { parameters, correlation })
}

fn without_mean(mut turns: Turns) -> Turns {
    let count = turns.known().count().max(1) as f64;
    let mean = turns.known().sum::<Vector3<f64>>() / count;
    turns.values.iter_mut().flatten().for_each(|value| *value -= mean);
    turns
}

fn camera_turns(trajectories: &[&Trajectory]) -> Turns {
    let start = trajectories.iter().map(|one| one.start()).fold(f64::INFINITY, f64::min);
    let end = trajectories.iter().map(|one| one.end()).fold(f64::NEG_INFINITY, f64::max);
    Series::new(start, end, STEP, |t| {
        // The ends of a trajectory are uncertain.
        let inside = |one: &&&Trajectory| t > one.start() + 0.03 && t < one.end() - 0.03;
        let trajectory = trajectories.iter().find(inside)?;
        Some(Motion::new(trajectory, t)?.angular_velocity())
    })
}

/// Returns means of the readings within half a step, or interpolates between the neighbours of an empty half step.
fn unit_values(samples: &[Sample], value: impl Fn(&Sample) -> Vector3<f64>) -> Series<Vector3<f64>> {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
        return Series { start: 0.0, step: STEP, values: Vec::new() };
    };
    let interval = (last.t - first.t) / samples.len() as f64;
    let longest = LONGEST_GAP.max(3.0 * interval);
    Series::new(first.t, last.t, STEP, |t| {
        let from = samples.partition_point(|sample| sample.t < t - 0.5 * STEP);
        let to = samples.partition_point(|sample| sample.t < t + 0.5 * STEP);
        let near = samples.get(from..to).unwrap_or_default();
        if !near.is_empty() {
            return Some(near.iter().map(&value).sum::<Vector3<f64>>() / near.len() as f64);
        }
        let (before, after) = (samples.get(from.checked_sub(1)?)?, samples.get(from)?);
        let share = (t - before.t) / (after.t - before.t);
        (after.t - before.t < longest).then(|| value(before).lerp(&value(after), share))
    })
}

/// Computes R_imu_camera.
fn rotation(camera: &Turns, unit: &Turns, delay: f64) -> Result<UnitQuaternion<f64>, InertialError> {
    let turns = ComparedTurns::new(camera, unit, delay);
    let factor = (turns.of_second / turns.of_first).sqrt();
    let (degrees, radians) = (180.0 / std::f64::consts::PI, std::f64::consts::PI / 180.0);
    for (wrong, unit) in [(degrees, IN_DEGREES), (radians, IN_RADIANS)] {
        if (0.7..1.4).contains(&(factor / wrong)) {
            return Err(InertialError::AngularUnit { factor, unit, of_file: true });
        }
    }
    if !(0.7..1.4).contains(&factor) {
        return Err(InertialError::AngularUnit { factor, unit: IN_ANOTHER, of_file: true });
    }
    check_axes(&turns.products, ONE_AXIS)?;
    let best = turns.rotation().ok_or(InertialError::Singular)?;
    // Residuals of the best rotation and the best mirrored one.
    let scale = turns.of_second / factor;
    let (proper, mirrored) = (scale - best.explained, scale - best.explained_mirrored);
    if mirrored < 0.3 * proper {
        return Err(InertialError::LeftHanded);
    }
    Ok(best.rotation)
}

/// Unknowns of the linear step: gravity, lever arm, bias in camera axes.
const UNKNOWNS: usize = 9;

fn lever_arm(
    trajectories: &[&Trajectory],
    samples: &[Sample],
    delay: f64,
    rotation: UnitQuaternion<f64>,
    gravity: f64,
) -> Result<InertialParameters, InertialError> {
    let unit = unit_values(samples, |sample| sample.acceleration);
    let (mut rows, mut squares) = (Vec::new(), 0.0);
    for (index, reading) in unit.values.iter().enumerate().step_by(2) {
        let t = unit.start + STEP * index as f64 - delay;
        let inside = |one: &&&Trajectory| t > one.start() + 0.1 && t < one.end() - 0.1;
        let motion = trajectories.iter().find(inside).and_then(|one| Motion::new(one, t));
        let (Some(reading), Some(motion)) = (reading, motion) else { continue };
        squares += motion.acceleration.norm_squared();
        rows.push(row(&motion, rotation.inverse_transform_vector(reading)));
    }
    let (solution, residual) = robust_solution(&rows, 1.0)?;
    if robust_solution(&rows, -1.0)?.1 < CLEARLY * residual {
        return Err(InertialError::OppositeAccelerations);
    }
    let down: Vector3<f64> = solution.fixed_rows::<3>(0).into_owned();
    let size = down.norm();
    let reading = size / gravity;
    if reading < GRAVITY_LEFT {
        return Err(InertialError::GravityRemoved { reading });
    }
    // NaN does not agree with the stated value either.
    let has_expected_size = (reading - 1.0).abs() <= GRAVITY_ERROR;
    if !has_expected_size {
        let motion = (squares / rows.len().max(1) as f64).sqrt();
        return Err(InertialError::GravitySize { size, stated: gravity, motion });
    }
    let middle = 0.5 * (samples.first().map_or(0.0, |one| one.t) + samples.last().map_or(0.0, |one| one.t));
    Ok(InertialParameters {
        rotation,
        position: solution.fixed_rows::<3>(3).into_owned(),
        gyroscope_delay: delay,
        accelerometer_delay: delay,
        accelerometer_bias: rotation * solution.fixed_rows::<3>(6).into_owned(),
        ..InertialParameters::perfect(down * (gravity / size), middle)
    })
}

/// Derivatives of a reading in camera axes by the unknowns, the reading, and the acceleration of the camera in its axes.
type Row = (SMatrix<f64, 3, UNKNOWNS>, Vector3<f64>, Vector3<f64>);

/// Returns the solution if `sign` times the accelerations were measured, and its median residual (m/s²). Where the trajectory is
/// uncertain, so is its acceleration: those rows are dropped.
fn robust_solution(rows: &[Row], sign: f64) -> Result<(SVector<f64, UNKNOWNS>, f64), InertialError> {
    let rest = |(_, reading, acceleration): &Row| reading - acceleration * sign;
    let mut solution = SVector::<f64, UNKNOWNS>::zeros();
    let mut middle = f64::INFINITY;
    for _ in 0..4 {
        let mut matrix = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut right = SVector::<f64, UNKNOWNS>::zeros();
        // A prior of 1 m/s² for the bias and 1 m for the lever arm, at 1 m/s² of noise.
        (3..UNKNOWNS).for_each(|index| matrix[(index, index)] += 1.0);
        let bound = 2.5 * middle;
        for row in rows.iter().filter(|row| (rest(row) - row.0 * solution).norm() <= bound) {
            matrix += row.0.tr_mul(&row.0);
            right += row.0.tr_mul(&rest(row));
        }
        solution = matrix.cholesky().ok_or(InertialError::Singular)?.solve(&right);
        let mut sizes: Vec<f64> = rows.iter().map(|row| (rest(row) - row.0 * solution).norm()).collect();
        middle = median(&mut sizes, f64::total_cmp).unwrap_or(f64::INFINITY);
    }
    Ok((solution, middle))
}

/// Returns the row of a reading in camera axes.
fn row(motion: &Motion, reading: Vector3<f64>) -> Row {
    let to_camera = motion.rotation.sample.rotation.inverse().to_rotation_matrix().into_inner();
    let turning = motion.angular_velocity().cross_matrix();
    let mut by = SMatrix::<f64, 3, UNKNOWNS>::zeros();
    by.fixed_view_mut::<3, 3>(0, 0).copy_from(&-to_camera);
    by.fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(motion.rotation.angular_acceleration.cross_matrix() + turning * turning));
    by.fixed_view_mut::<3, 3>(0, 6).copy_from(&Matrix3::identity());
    (by, reading, to_camera * motion.acceleration)
}

#[cfg(test)]
mod tests;

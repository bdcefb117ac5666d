//! A start that cannot fail silently: delay, rotation, lever arm and gravity, each with a test that it was found.
//!
//! 1. **Delay**: how fast camera and unit turn, ‖ω − mean‖, is the same whatever their axes. Its normalised correlation over all
//!    shifts must have one clear peak.
//! 2. **Rotation**: the one that carries ω of the camera to that of the unit (Wahba's problem), and beside it the best mirrored
//!    one: where that is better, the axes are left-handed.
//! 3. **Lever arm, gravity, accelerometer bias**: linear least squares; gravity must come out in its size.

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::error::InertialError;
use super::parameters::InertialParameters;
use super::prediction::Motion;
use super::sample::Sample;
use crate::trajectory::Trajectory;
use evcal_geometry::numerics::lag::{NoLag, Rules, lag};

/// Step of the grid on which rates are compared (s).
const STEP: f64 = 5e-3;
/// Readings further apart than this, or than three intervals, leave a gap (s).
const LONGEST_GAP: f64 = 0.04;
/// Smallest correlation that is believed.
const CORRELATION: f64 = 0.9;
/// Share of the best peak that another one must stay below.
const SECOND_PEAK: f64 = 0.9;
/// Nearest another peak may be (s).
const PEAK_DISTANCE: f64 = 0.4;
/// Smallest overlap, as a share of the shorter stream.
const OVERLAP: f64 = 0.4;
/// Root mean square of the angular velocity below which the camera hardly turned (rad/s).
const LEAST_RATE: f64 = 0.08;
/// Share of the angular velocity that changes, below which it is the same all the time.
const EVENLY: f64 = 0.5;
/// Second singular value over the first below which the camera turned about one axis.
const ONE_AXIS: f64 = 0.01;
/// How far the size of gravity may be from what it is, as a share.
const GRAVITY_ERROR: f64 = 0.07;
/// Share of gravity below which it was taken off the accelerations, rather than measured wrongly.
const GRAVITY_LEFT: f64 = 0.2;

/// A vector at even times, where it is known.
struct Grid {
    start: f64,
    values: Vec<Option<Vector3<f64>>>,
}

impl Grid {
    fn known(&self) -> impl Iterator<Item = Vector3<f64>> + '_ {
        self.values.iter().flatten().copied()
    }

    fn without_mean(mut self) -> Self {
        let count = self.known().count().max(1) as f64;
        let mean = self.known().sum::<Vector3<f64>>() / count;
        self.values.iter_mut().flatten().for_each(|value| *value -= mean);
        self
    }
}

/// What the start found.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// The parameters.
    pub parameters: InertialParameters,
    /// Largest correlation of the turns.
    pub correlation: f64,
}

/// Finds a start from the trajectories of one recording, whose rotations are sums of quaternions, and its samples; `gravity` is
/// its size in m/s².
///
/// # Errors
/// [`InertialError`] says what was not found, and why.
pub fn start(trajectories: &[&Trajectory], samples: &[Sample], gravity: f64) -> Result<Start, InertialError> {
    let turning = camera_rates(trajectories);
    let whole = root_mean_square(&turning);
    let camera = turning.without_mean();
    let unit = unit_values(samples, |sample| sample.angular_velocity).without_mean();
    let rate = root_mean_square(&camera);
    if rate < LEAST_RATE && rate < EVENLY * whole {
        return Err(InertialError::EvenRotation { rate: whole.to_degrees() });
    }
    if rate < LEAST_RATE {
        return Err(InertialError::LittleRotation { rate: rate.to_degrees() });
    }
    let turns = camera.known().map(|rate| rate * rate.transpose()).sum::<Matrix3<f64>>();
    if let Some(axis) = only_axis(&turns) {
        return Err(InertialError::OneAxis { axis });
    }
    let (delay, correlation) = delay(&camera, &unit)?;
    let rotation = rotation(&camera, &unit, delay)?;
    let parameters = lever_arm(trajectories, samples, (delay, rotation), gravity)?;
    Ok(Start { parameters, correlation })
}

fn root_mean_square(grid: &Grid) -> f64 {
    let count = grid.known().count().max(1) as f64;
    (grid.known().map(|rate| rate.norm_squared()).sum::<f64>() / count).sqrt()
}

fn camera_rates(trajectories: &[&Trajectory]) -> Grid {
    let start = trajectories.iter().map(|one| one.start()).fold(f64::INFINITY, f64::min);
    let end = trajectories.iter().map(|one| one.end()).fold(f64::NEG_INFINITY, f64::max);
    let count = ((end - start) / STEP).max(0.0) as usize + 1;
    let at = |index: usize| {
        let t = start + STEP * index as f64;
        // The ends of a trajectory are uncertain.
        let inside = |one: &&&Trajectory| t > one.start() + 0.03 && t < one.end() - 0.03;
        let trajectory = trajectories.iter().find(inside)?;
        Some(Motion::new(trajectory, t)?.angular_velocity())
    };
    Grid { start, values: (0..count).map(at).collect() }
}

/// Means of the readings within half a step, or between the neighbours where there are none.
fn unit_values(samples: &[Sample], value: impl Fn(&Sample) -> Vector3<f64>) -> Grid {
    let (Some(first), Some(last)) = (samples.first(), samples.last()) else {
        return Grid { start: 0.0, values: Vec::new() };
    };
    let count = ((last.t - first.t) / STEP).clamp(0.0, 1e8) as usize + 1;
    let interval = (last.t - first.t) / samples.len() as f64;
    let longest = LONGEST_GAP.max(3.0 * interval);
    let at = |index: usize| {
        let t = first.t + STEP * index as f64;
        let from = samples.partition_point(|sample| sample.t < t - 0.5 * STEP);
        let to = samples.partition_point(|sample| sample.t < t + 0.5 * STEP);
        let near = samples.get(from..to).unwrap_or_default();
        if !near.is_empty() {
            return Some(near.iter().map(&value).sum::<Vector3<f64>>() / near.len() as f64);
        }
        let (before, after) = (samples.get(from.checked_sub(1)?)?, samples.get(from)?);
        let share = (t - before.t) / (after.t - before.t);
        (after.t - before.t < longest).then(|| value(before).lerp(&value(after), share))
    };
    Grid { start: first.t, values: (0..count).map(at).collect() }
}

/// How much later the unit's stamps are than the events', and the correlation there.
fn delay(camera: &Grid, unit: &Grid) -> Result<(f64, f64), InertialError> {
    let sizes = |grid: &Grid| -> Vec<Option<f64>> { grid.values.iter().map(|value| value.map(|w| w.norm())).collect() };
    let (of_camera, of_unit) = (sizes(camera), sizes(unit));
    let known = |sizes: &[Option<f64>]| sizes.iter().flatten().count() as f64;
    let rules = Rules {
        fewest_pairs: (OVERLAP * known(&of_camera).min(known(&of_unit))).max(1.0 / STEP),
        correlation: CORRELATION,
        second_peak: SECOND_PEAK,
        peak_distance: (PEAK_DISTANCE / STEP) as usize,
    };
    let delay_of = |steps: f64| unit.start - camera.start + steps * STEP;
    match lag(&of_camera, &of_unit, &rules) {
        Ok(found) => Ok((delay_of(found.steps), found.correlation)),
        Err(NoLag::Steady { mean }) => Err(InertialError::EvenRotation { rate: mean.to_degrees() }),
        Err(NoLag::Unlike { correlation }) => Err(InertialError::OtherMotion { correlation }),
        Err(NoLag::Ambiguous { first, second }) => {
            Err(InertialError::Ambiguous { first: delay_of(first), second: delay_of(second) })
        }
    }
}

/// The axis of the camera about which it turned if there was no other; `turns` is the sum of the products of angular velocities with
/// those of the camera.
fn only_axis(turns: &Matrix3<f64>) -> Option<&'static str> {
    let svd = turns.svd(false, true);
    let axis = svd.v_t?.row(0).transpose().iamax();
    let sizes = svd.singular_values;
    let axis = ["x axis (to the right)", "y axis (downwards)", "z axis (the line of sight)"][axis];
    (sizes[1] < ONE_AXIS * sizes[0]).then_some(axis)
}

/// R_imu_camera.
fn rotation(camera: &Grid, unit: &Grid, delay: f64) -> Result<UnitQuaternion<f64>, InertialError> {
    let mut product = Matrix3::zeros();
    let (mut of_camera, mut of_unit) = (0.0, 0.0);
    for (index, w) in camera.values.iter().enumerate() {
        let place = (camera.start + STEP * index as f64 + delay - unit.start) / STEP;
        let below = place.floor().max(0.0) as usize;
        let pair = (unit.values.get(below), unit.values.get(below + 1));
        if let (Some(w), (Some(Some(before)), Some(Some(after)))) = (w, pair) {
            let read = before.lerp(after, place - below as f64);
            product += read * w.transpose();
            of_camera += w.norm_squared();
            of_unit += read.norm_squared();
        }
    }
    let svd = product.svd(true, true);
    let (Some(left), Some(right)) = (svd.u, svd.v_t) else { return Err(InertialError::Singular) };
    let sizes = svd.singular_values;
    let factor = (of_unit / of_camera).sqrt();
    let (degrees, radians) = (180.0 / std::f64::consts::PI, std::f64::consts::PI / 180.0);
    for (wrong, unit) in [(degrees, "°/s, and were read as rad/s"), (radians, "rad/s, and were read as °/s")] {
        if (0.7..1.4).contains(&(factor / wrong)) {
            return Err(InertialError::AngularUnit { factor, unit });
        }
    }
    if !(0.7..1.4).contains(&factor) {
        return Err(InertialError::AngularUnit { factor, unit: "another unit than stated" });
    }
    if let Some(axis) = only_axis(&product) {
        return Err(InertialError::OneAxis { axis });
    }
    let determinant = (left * right).determinant().signum();
    // Residuals of the best rotation and of the best mirrored one differ by the smallest singular value.
    let scale = of_unit / factor;
    let proper = scale - (sizes[0] + sizes[1] + determinant * sizes[2]);
    let mirrored = scale - (sizes[0] + sizes[1] - determinant * sizes[2]);
    if determinant < 0.0 && mirrored < 0.3 * proper {
        return Err(InertialError::LeftHanded);
    }
    let matrix = left * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, determinant)) * right;
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)))
}

/// Unknowns of the linear step: gravity, lever arm, bias in camera axes.
const UNKNOWNS: usize = 9;

fn lever_arm(
    trajectories: &[&Trajectory],
    samples: &[Sample],
    (delay, rotation): (f64, UnitQuaternion<f64>),
    gravity: f64,
) -> Result<InertialParameters, InertialError> {
    let unit = unit_values(samples, |sample| sample.acceleration);
    let mut rows = Vec::new();
    for (index, reading) in unit.values.iter().enumerate().step_by(2) {
        let t = unit.start + STEP * index as f64 - delay;
        let inside = |one: &&&Trajectory| t > one.start() + 0.1 && t < one.end() - 0.1;
        let motion = trajectories.iter().find(inside).and_then(|one| Motion::new(one, t));
        let (Some(reading), Some(motion)) = (reading, motion) else { continue };
        rows.push(row(&motion, rotation.inverse_transform_vector(reading)));
    }
    // Where the trajectory is uncertain its acceleration is: those rows fall away.
    let mut solution = SVector::<f64, UNKNOWNS>::zeros();
    let mut bound = f64::INFINITY;
    for _ in 0..4 {
        let mut matrix = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
        let mut right = SVector::<f64, UNKNOWNS>::zeros();
        // A bias of 1 m/s² and a lever arm of 1 m are the most, at 1 m/s² of noise.
        (3..UNKNOWNS).for_each(|index| matrix[(index, index)] += 1.0);
        let mut sizes = Vec::with_capacity(rows.len());
        for (by, value) in &rows {
            let residual = (value - by * solution).norm();
            sizes.push(residual);
            if residual <= bound {
                matrix += by.tr_mul(by);
                right += by.tr_mul(value);
            }
        }
        solution = matrix.cholesky().ok_or(InertialError::Singular)?.solve(&right);
        let mut sizes: Vec<f64> = rows.iter().map(|(by, value)| (value - by * solution).norm()).collect();
        bound = 2.5 * evcal_geometry::numerics::statistics::median(&mut sizes, f64::total_cmp).unwrap_or(f64::INFINITY);
    }
    let down: Vector3<f64> = solution.fixed_rows::<3>(0).into_owned();
    let size = down.norm();
    let reading = size / gravity;
    if reading < GRAVITY_LEFT {
        return Err(InertialError::GravityRemoved { reading });
    }
    // What is no number is not as stated either.
    let is_as_stated = (reading - 1.0).abs() <= GRAVITY_ERROR;
    if !is_as_stated {
        return Err(InertialError::GravitySize { size, stated: gravity });
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

/// Derivatives of a reading in camera axes by the unknowns, and the reading less what they do not change.
fn row(motion: &Motion, reading: Vector3<f64>) -> (SMatrix<f64, 3, UNKNOWNS>, Vector3<f64>) {
    let to_camera = motion.rotation.sample.rotation.inverse().to_rotation_matrix().into_inner();
    let turning = motion.angular_velocity().cross_matrix();
    let mut by = SMatrix::<f64, 3, UNKNOWNS>::zeros();
    by.fixed_view_mut::<3, 3>(0, 0).copy_from(&-to_camera);
    by.fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(motion.rotation.angular_acceleration.cross_matrix() + turning * turning));
    by.fixed_view_mut::<3, 3>(0, 6).copy_from(&Matrix3::identity());
    (by, reading - to_camera * motion.acceleration)
}

#[cfg(test)]
mod tests;

//! Maximum likelihood of marker body, board and clock.

use nalgebra::{Isometry3, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion};

use super::error::MotionCaptureError;
use super::path::{Moment, Path};
use evcal_geometry::numerics::huber::huber;
use evcal_geometry::numerics::levenberg_marquardt::{Costed, Schedule, minimise};
use evcal_geometry::numerics::statistics::{SIGMA_BY_MEDIAN, median};
use evcal_geometry::timed_pose::TimedPose;

/// Index of the first parameter of `T_camera_body`: rotation (right of the pose, rad), then translation (m).
pub const CAMERA_BODY: usize = 0;
/// Index of the first parameter of `T_mocap_world`, in the same order.
pub const MOCAP_WORLD: usize = 6;
/// Index of the offset of the clocks (s).
pub const OFFSET: usize = 12;
/// Index of the relative drift of the capture's clock.
pub const DRIFT: usize = 13;
/// Index of the ratio of lengths in the capture to those on the board.
pub const SCALE: usize = 14;
/// Number of parameters.
pub const COUNT: usize = 15;

/// Seconds of common poses from which the drift of the clocks is estimated.
pub const LONG_ENOUGH_FOR_DRIFT: f64 = 20.0;
/// Prior σ of the relative rate of the clocks.
const DRIFT_SIGMA: f64 = 2e-4;
/// σ of a fixed parameter.
const FIXED: f64 = 1e-9;
/// Residual from which a pose counts linearly, in σ of one axis.
const HUBER: f64 = 4.0;
/// Number of rounds of spread and solve.
const ROUNDS: usize = 4;
/// Number of rows of a pose: position, rotation.
const ROWS: usize = 6;
/// Smallest spread: position (m) and rotation (rad).
const SMALLEST: Spread = Spread { position: 1e-7, rotation: 1e-7 };

const SCHEDULE: Schedule = Schedule {
    first_damping: 1e-6,
    smallest_damping: 1e-9,
    largest_damping: 1e6,
    most_steps: 30,
    smallest_gain: 1e-10,
};

pub(super) type Row = SMatrix<f64, ROWS, COUNT>;
pub(super) type Normal = SMatrix<f64, COUNT, COUNT>;
pub(super) type Gradient = SVector<f64, COUNT>;

/// Relation of camera and capture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandEye {
    /// `T_camera_body`.
    pub camera_body: Isometry3<f64>,
    /// `T_mocap_world`.
    pub mocap_world: Isometry3<f64>,
    /// t_mocap = t_events + offset + drift (t_mocap − middle).
    pub offset: f64,
    /// Relative rate by which the capture's clock is faster.
    pub drift: f64,
    /// Ratio of lengths in the capture to those on the board.
    pub scale: f64,
    /// Time of the capture at which the offset applies (s).
    pub middle: f64,
}

impl HandEye {
    /// Returns the time of the events at the capture's `t`.
    pub fn event_time(&self, t: f64) -> f64 {
        t - self.offset - self.drift * (t - self.middle)
    }

    /// Returns the poses of the capture at whose time the camera's pose is known, with that pose.
    pub fn matched<'a>(
        &'a self,
        path: &'a Path,
        capture: &'a [TimedPose],
    ) -> impl Iterator<Item = (&'a TimedPose, Moment)> + 'a {
        capture.iter().filter_map(|body| Some((body, path.at(self.event_time(body.t))?)))
    }

    /// Returns the error of a captured pose in position (m, frame of the capture) and rotation (rad, axes of the body), and the
    /// derivatives of both.
    pub(super) fn row(&self, body: &TimedPose, moment: &Moment) -> (SVector<f64, ROWS>, Row) {
        let Self { camera_body, mocap_world, scale, .. } = self;
        let Moment { pose: camera, velocity, angular_velocity } = moment;
        let on_board = camera.translation.vector * *scale + camera.rotation * camera_body.translation.vector;
        let position =
            body.pose.translation.vector - mocap_world.transform_vector(&on_board) - mocap_world.translation.vector;
        let world_body = camera.rotation * camera_body.rotation;
        let rotation = ((mocap_world.rotation * world_body).inverse() * body.pose.rotation).scaled_axis();
        let matrix = |rotation: UnitQuaternion<f64>| rotation.to_rotation_matrix().into_inner();
        let room = matrix(mocap_world.rotation);
        let mut by = Row::zeros();
        by.fixed_view_mut::<3, 3>(0, CAMERA_BODY + 3).copy_from(&-(room * matrix(camera.rotation)));
        by.fixed_view_mut::<3, 3>(0, MOCAP_WORLD).copy_from(&(room * on_board.cross_matrix()));
        by.fixed_view_mut::<3, 3>(0, MOCAP_WORLD + 3).copy_from(&-Matrix3::identity());
        let speed = velocity * *scale + camera.rotation * angular_velocity.cross(&camera_body.translation.vector);
        let later = body.t - self.middle;
        let turning = camera_body.rotation.inverse_transform_vector(angular_velocity);
        for (column, factor) in [(OFFSET, 1.0), (DRIFT, later)] {
            by.fixed_view_mut::<3, 1>(0, column).copy_from(&(room * speed * factor));
            by.fixed_view_mut::<3, 1>(3, column).copy_from(&(turning * factor));
        }
        by.fixed_view_mut::<3, 1>(0, SCALE).copy_from(&-(room * camera.translation.vector));
        by.fixed_view_mut::<3, 3>(3, CAMERA_BODY).copy_from(&-Matrix3::identity());
        by.fixed_view_mut::<3, 3>(3, MOCAP_WORLD).copy_from(&-matrix(world_body.inverse()));
        (SVector::from_fn(|row, _| if row < 3 { position[row] } else { rotation[row - 3] }), by)
    }

    /// Returns the derivatives of the error of [`HandEye::row`] by the camera's pose: its translation (m, axes of the world), its
    /// rotation (rad, about the axes of the camera).
    pub(super) fn by_camera_pose(&self, moment: &Moment) -> SMatrix<f64, ROWS, 6> {
        let matrix = |rotation: UnitQuaternion<f64>| rotation.to_rotation_matrix().into_inner();
        let room = matrix(self.mocap_world.rotation);
        let mut by = SMatrix::<f64, ROWS, 6>::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).copy_from(&(-room * self.scale));
        let body = self.camera_body.translation.vector.cross_matrix();
        by.fixed_view_mut::<3, 3>(0, 3).copy_from(&(room * matrix(moment.pose.rotation) * body));
        by.fixed_view_mut::<3, 3>(3, 3).copy_from(&-matrix(self.camera_body.rotation.inverse()));
        by
    }

    fn moved(&self, step: &Gradient) -> Self {
        let moved = |pose: &Isometry3<f64>, first: usize| {
            let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(first).into_owned());
            let shift = step.fixed_rows::<3>(first + 3).into_owned();
            Isometry3::from_parts(Translation3::from(pose.translation.vector + shift), pose.rotation * turn)
        };
        Self {
            camera_body: moved(&self.camera_body, CAMERA_BODY),
            mocap_world: moved(&self.mocap_world, MOCAP_WORLD),
            offset: self.offset + step[OFFSET],
            drift: self.drift + step[DRIFT],
            scale: self.scale + step[SCALE],
            middle: self.middle,
        }
    }
}

/// Scatter of the trajectories relative to each other, per axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Position (m).
    pub position: f64,
    /// Rotation (rad).
    pub rotation: f64,
}

impl Spread {
    /// Returns loss and weight of an error in position and in rotation.
    fn losses(&self, error: &SVector<f64, ROWS>) -> [(f64, f64); 2] {
        [(0, self.position), (3, self.rotation)].map(|(first, sigma)| {
            let (cost, root_weight) = huber(error.fixed_rows::<3>(first).norm() / sigma, HUBER);
            (cost, (root_weight / sigma).powi(2))
        })
    }

    /// Returns the weight of an error in position and in rotation.
    pub(super) fn weights(&self, error: &SVector<f64, ROWS>) -> [f64; 2] {
        self.losses(error).map(|(_, weight)| weight)
    }
}

/// Priors of drift and scale: σ of each about 0 and 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Priors {
    drift: f64,
    scale: f64,
}

impl Priors {
    pub(super) fn add(&self, at: &HandEye, normal: &mut Normal, gradient: &mut Gradient) -> f64 {
        let mut cost = 0.0;
        for (index, distance, sigma) in [(DRIFT, at.drift, self.drift), (SCALE, at.scale - 1.0, self.scale)] {
            let weight = 1.0 / (sigma * sigma);
            normal[(index, index)] += weight;
            gradient[index] += weight * distance;
            cost += 0.5 * weight * distance * distance;
        }
        cost
    }
}

/// A solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fitted {
    /// Estimated parameters.
    pub hand_eye: HandEye,
    /// Scatter about the solution.
    pub spread: Spread,
    /// Number of poses.
    pub used: usize,
    /// Priors of drift and scale.
    pub priors: Priors,
}

/// Normal equations of poses.
#[derive(Clone, Copy, Debug)]
pub(super) struct Equations {
    pub normal: Normal,
    pub gradient: Gradient,
    pub cost: f64,
}

impl Equations {
    pub(super) fn none() -> Self {
        Self { normal: Normal::zeros(), gradient: Gradient::zeros(), cost: 0.0 }
    }

    /// Adds one pose; position and rotation have separate losses.
    pub(super) fn add(&mut self, error: &SVector<f64, ROWS>, by: &Row, spread: &Spread) {
        for (first, (cost, weight)) in [0, 3].into_iter().zip(spread.losses(error)) {
            let (error, by) = (error.fixed_rows::<3>(first), by.fixed_rows::<3>(first));
            self.normal += by.tr_mul(&by) * weight;
            self.gradient += by.tr_mul(&error) * weight;
            self.cost += cost;
        }
    }
}

/// Fits everything except the scale to the poses of the capture whose time on the clock of the events is `wanted`, starting at
/// `start`.
///
/// # Errors
/// [`MotionCaptureError::Singular`] if they do not determine it.
pub fn fit(
    path: &Path,
    capture: &[TimedPose],
    start: HandEye,
    drifts: bool,
    wanted: impl Fn(f64) -> bool,
) -> Result<Fitted, MotionCaptureError> {
    let priors = Priors { drift: if drifts { DRIFT_SIGMA } else { FIXED }, scale: FIXED };
    let (count, sum) =
        start.matched(path, capture).fold((0.0, 0.0), |(count, sum), (body, _)| (count + 1.0, sum + body.t));
    // The uncertainty of the offset is smallest, and independent of drift, in the middle.
    let middle = sum / f64::max(count, 1.0);
    solve(path, capture, HandEye { middle, ..start }, priors, wanted)
}

/// Fits the scale too, starting at `all`.
///
/// # Errors
/// [`MotionCaptureError::Singular`] if the poses do not determine it.
pub fn with_scale(
    path: &Path,
    capture: &[TimedPose],
    all: &Fitted,
    drifts: bool,
) -> Result<Fitted, MotionCaptureError> {
    let priors = Priors { drift: if drifts { DRIFT_SIGMA } else { FIXED }, scale: 1.0 };
    solve(path, capture, all.hand_eye, priors, |_| true)
}

fn solve(
    path: &Path,
    capture: &[TimedPose],
    start: HandEye,
    priors: Priors,
    wanted: impl Fn(f64) -> bool,
) -> Result<Fitted, MotionCaptureError> {
    let rows = |at: &HandEye| -> Vec<(SVector<f64, ROWS>, Row)> {
        let matched = at.matched(path, capture).filter(|(body, _)| wanted(at.event_time(body.t)));
        matched.map(|(body, moment)| at.row(body, &moment)).collect()
    };
    let mut hand_eye = start;
    let mut spread = spread(&rows(&hand_eye)).ok_or(MotionCaptureError::Singular)?;
    for _ in 0..ROUNDS {
        let linearise = |at: &HandEye| {
            let mut equations = Equations::none();
            rows(at).iter().for_each(|(error, by)| equations.add(error, by, &spread));
            equations.cost += priors.add(at, &mut equations.normal, &mut equations.gradient);
            equations
        };
        let mut best = Costed { estimate: hand_eye, cost: linearise(&hand_eye).cost };
        minimise(&mut best, &SCHEDULE, linearise, |at, equations, damping| {
            let mut normal = equations.normal;
            (0..COUNT).for_each(|index| normal[(index, index)] *= 1.0 + damping);
            let estimate = at.moved(&-normal.cholesky()?.solve(&equations.gradient));
            Some(Costed { estimate, cost: linearise(&estimate).cost })
        });
        hand_eye = best.estimate;
        spread = self::spread(&rows(&hand_eye)).ok_or(MotionCaptureError::Singular)?;
    }
    Ok(Fitted { hand_eye, spread, used: rows(&hand_eye).len(), priors })
}

/// Computes the spread from the median size of the components.
fn spread(rows: &[(SVector<f64, ROWS>, Row)]) -> Option<Spread> {
    let of = |first: usize| {
        let mut sizes: Vec<f64> =
            rows.iter().flat_map(|(error, _)| (first..first + 3).map(|row| error[row].abs())).collect();
        median(&mut sizes, f64::total_cmp).map(|middle| SIGMA_BY_MEDIAN * middle)
    };
    let (position, rotation) = (of(0)?, of(3)?);
    Some(Spread { position: position.max(SMALLEST.position), rotation: rotation.max(SMALLEST.rotation) })
}

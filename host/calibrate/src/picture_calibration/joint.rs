//! The joint solve of pictures and events: the centres of dots are assigned to the trajectories of the events.
//!
//! A centre belongs to the middle of its exposure. The trajectory is on the clock of the events, which are late by the latency of
//! the pixels, so a constant offset between both is estimated first, with its standard deviation: e = π(T(t + τ)) − m, ∂e/∂τ =
//! the dot's velocity.

use nalgebra::{Isometry3, Translation3, Vector2};
use serde::{Deserialize, Serialize};

use super::calibration::{HUBER, PictureCalibration};
use super::circle_image::{center_bias, circle_image_center};
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_detection::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use evcal_geometry::board::Board;
use evcal_geometry::board::shape::{CircleArea, Surface};
use evcal_geometry::numerics::huber::huber_weight;
use evcal_geometry::numerics::statistics::{SIGMA_BY_MEDIAN, median};
use evcal_solve::solve::State;
use evcal_solve::trajectory::Trajectory;

/// Statistics of the pictures in a joint solve.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointReport {
    /// Number of pictures with the board at times with a trajectory.
    pub frames: usize,
    /// Number of centres of dots that became observations.
    pub dots: usize,
    /// Number of dots that were not at the position that the trajectory predicts.
    pub dots_elsewhere: usize,
    /// Time to add to a picture's time to get the time of the events of the same moment (s).
    pub time_offset: f64,
    /// Its standard deviation (s).
    pub time_offset_sigma: f64,
    /// Spread of a centre about the events' trajectory along one axis (px).
    pub spread: f64,
    /// The spread that determines the weight of a centre in the solve (px).
    pub sigma: f64,
}

/// Observations for the joint solve.
pub struct JointPoints {
    /// Centres for each trajectory, in order of time.
    pub points: Vec<Vec<PointObservation>>,
    /// Statistics of the pictures.
    pub report: JointReport,
}

/// Reasons why pictures and events cannot be solved together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoJointPoints {
    /// No picture is within the time of a trajectory.
    #[error("no frame with the board was taken during a trajectory from events")]
    NoCommonTime,
    /// The clocks are too far apart.
    #[error(
        "the clocks of frames and events are too far apart, or their offset is not determined because the board hardly moved in the frames"
    )]
    OffsetUnknown,
}

/// Step in seconds over which a dot's velocity is taken.
const VELOCITY_STEP: f64 = 1e-4;
/// Number of rounds of the time offset.
const ROUNDS: usize = 8;
/// Ratio of a step to its standard deviation below which the offset has converged.
const CONVERGED: f64 = 0.01;
/// Largest offset between pictures and events (s).
const LARGEST_OFFSET: f64 = 0.02;
/// Largest standard deviation of the offset, as a share of the largest offset.
const OFFSET_KNOWN: f64 = 0.1;
/// Share of the distance of neighbouring dots within which a dot agrees with the trajectory.
const NEAR: f64 = 0.25;

/// The weight of a centre is computed from a spread of at least this share of the measured spread.
const SMALLEST_SHARE: f64 = 0.2;

/// One dot on a trajectory.
struct Tied<'a> {
    trajectory: usize,
    frame: usize,
    t: f64,
    circle: usize,
    measured: &'a ObservedCircle,
    residual: Vector2<f64>,
    velocity: Vector2<f64>,
}

/// Assigns the dots of `calibration`'s pictures to the trajectories of `state`.
///
/// The solve treats events as independent, although they are not: their information about the camera is `event_inflation` times
/// smaller than the solve assumes. So that events do not outweigh pictures, a centre's weight is raised by the same factor,
/// divided by the factor by which the pictures' own information is overstated.
///
/// # Errors
/// [`NoJointPoints`] if they cannot be solved together.
pub fn joint_points(
    calibration: &PictureCalibration,
    state: &State,
    event_inflation: f64,
    board: &Board,
) -> Result<JointPoints, NoJointPoints> {
    let used: Vec<&ReferenceFrame> =
        calibration.posed.iter().filter_map(|posed| calibration.frames.get(posed.frame)).collect();
    let mut offset = 0.0;
    let mut sigma = f64::INFINITY;
    for _ in 0..ROUNDS {
        let (tied, _) = tie(&used, state, board, offset);
        let bound = HUBER * spread(&tied).ok_or(NoJointPoints::NoCommonTime)?;
        let (mut information, mut gradients) = (0.0, vec![0.0; used.len()]);
        for dot in &tied {
            let weight = huber_weight(dot.residual.norm_squared(), bound);
            information += weight * dot.velocity.norm_squared();
            if let Some(gradient) = gradients.get_mut(dot.frame) {
                *gradient += weight * dot.velocity.dot(&dot.residual);
            }
        }
        let step = -gradients.iter().sum::<f64>() / information;
        // The dots of a picture have common errors, different pictures do not.
        sigma = gradients.iter().map(|gradient| gradient * gradient).sum::<f64>().sqrt() / information;
        if !step.is_finite() {
            return Err(NoJointPoints::OffsetUnknown);
        }
        offset += step;
        if step.abs() < CONVERGED * sigma {
            break;
        }
    }
    if offset.abs() > LARGEST_OFFSET || sigma > OFFSET_KNOWN * LARGEST_OFFSET {
        return Err(NoJointPoints::OffsetUnknown);
    }
    let (tied, elsewhere) = tie(&used, state, board, offset);
    let spread = spread(&tied).ok_or(NoJointPoints::NoCommonTime)?.max(calibration.spread);
    let mut points: Vec<Vec<PointObservation>> = vec![Vec::new(); state.trajectories.len()];
    let mut frames: Vec<usize> = Vec::new();
    let mut dots = 0;
    for dot in &tied {
        let (Some(trajectory), Some(points)) = (state.trajectories.get(dot.trajectory), points.get_mut(dot.trajectory))
        else {
            continue;
        };
        let bias = pose_at(trajectory, dot.t).and_then(|pose| {
            let pose = onto_board(&pose, state, board, dot.circle);
            center_bias(&state.camera, &pose, board.point(dot.circle), dot_radius(board, state))
        });
        let Some(bias) = bias else { continue };
        points.push(PointObservation { t: dot.t, pixel: dot.measured.center - bias, circle: dot.circle });
        dots += 1;
        frames.push(dot.frame);
    }
    for points in &mut points {
        points.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.circle.cmp(&b.circle)));
    }
    frames.dedup();
    let report = JointReport {
        frames: frames.len(),
        dots,
        dots_elsewhere: elsewhere,
        time_offset: offset,
        time_offset_sigma: sigma,
        spread,
        sigma: spread * (calibration.inflation.max(1.0) / event_inflation.max(1.0)).sqrt().clamp(SMALLEST_SHARE, 1.0),
    };
    Ok(JointPoints { points, report })
}

/// Returns `T_camera_world` at time `t`.
fn pose_at(trajectory: &Trajectory, t: f64) -> Option<Isometry3<f64>> {
    trajectory.pose(t).map(|pose| pose.inverse())
}

/// Returns the radius of the dots at the points of the board (m): zero at corners.
fn dot_radius(board: &Board, state: &State) -> f64 {
    board.circles().map_or(0.0, |_| state.board.radius)
}

/// Returns the distance to the next point of the board from `measured` in the picture, with points at the `expected` positions
/// (px).
fn neighbour_distance(measured: &ObservedCircle, expected: &[Option<Vector2<f64>>], board: &Board) -> f64 {
    match (measured.radius, board.circles()) {
        (Some(radius), Some(circles)) => radius * circles.neighbour_distance() / circles.radius,
        _ => {
            let place = expected.get(measured.index).copied().flatten();
            let others = expected.iter().enumerate().filter(|(index, _)| *index != measured.index);
            let distance = |(_, other): (usize, &Option<Vector2<f64>>)| Some((place? - (*other)?).norm());
            others.filter_map(distance).fold(f64::INFINITY, f64::min)
        }
    }
}

/// Moves `pose` (`T_camera_world`) so that a circle of the flat board appears at the position of the circle on the board of
/// `state`.
fn onto_board(pose: &Isometry3<f64>, state: &State, board: &Board, circle: usize) -> Isometry3<f64> {
    if state.board.is_flat() {
        return *pose;
    }
    let center = board.point(circle);
    let [x, y, z] = Surface::new(&CircleArea::new(board), &state.board).place(center.into());
    pose * Translation3::new(x - center.x, y - center.y, z)
}

/// Returns the dots that are at the position that a trajectory predicts, and the number of the others.
fn tie<'a>(frames: &[&'a ReferenceFrame], state: &State, board: &Board, offset: f64) -> (Vec<Tied<'a>>, usize) {
    let mut tied = Vec::new();
    let mut elsewhere = 0;
    for (number, frame) in frames.iter().enumerate() {
        let t = frame.t() + offset;
        let on_trajectory = |trajectory: &Trajectory| {
            trajectory.recording == frame.recording
                && t - VELOCITY_STEP >= trajectory.start()
                && t + VELOCITY_STEP <= trajectory.end()
        };
        let Some(index) = state.trajectories.iter().position(on_trajectory) else { continue };
        let Some(trajectory) = state.trajectories.get(index) else { continue };
        let poses = [t, t - VELOCITY_STEP, t + VELOCITY_STEP].map(|t| pose_at(trajectory, t));
        let [Some(now), Some(before), Some(after)] = poses else { continue };
        let image = |pose: &Isometry3<f64>, circle: usize| {
            let pose = onto_board(pose, state, board, circle);
            circle_image_center(&state.camera, &pose, board.point(circle), dot_radius(board, state))
        };
        let expected: Vec<Option<Vector2<f64>>> = (0..board.point_count()).map(|circle| image(&now, circle)).collect();
        for measured in &frame.circles {
            let distance = |place: &Vector2<f64>| (place - measured.center).norm();
            let nearest = expected
                .iter()
                .enumerate()
                .filter_map(|(circle, place)| Some((circle, place.as_ref()?)))
                .min_by(|a, b| distance(a.1).total_cmp(&distance(b.1)));
            let near = NEAR * neighbour_distance(measured, &expected, board);
            let Some((circle, place)) = nearest.filter(|(_, place)| distance(place) <= near) else {
                elsewhere += 1;
                continue;
            };
            let (Some(before), Some(after)) = (image(&before, circle), image(&after, circle)) else { continue };
            tied.push(Tied {
                trajectory: index,
                frame: number,
                t,
                circle,
                measured,
                residual: place - measured.center,
                velocity: (after - before) / (2.0 * VELOCITY_STEP),
            });
        }
    }
    (tied, elsewhere)
}

/// Returns a robust standard deviation along one axis of the residuals; `None` without any.
fn spread(tied: &[Tied<'_>]) -> Option<f64> {
    let mut sizes: Vec<f64> = tied.iter().flat_map(|dot| [dot.residual.x.abs(), dot.residual.y.abs()]).collect();
    median(&mut sizes, f64::total_cmp).map(|median| SIGMA_BY_MEDIAN * median)
}

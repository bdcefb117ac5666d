//! Calibration of a second camera on the mount of the first, which sees the same board at the same time: relative pose and clock.
//!
//! Both cameras are calibrated separately first, each with its own trajectory. Their trajectories determine the offset of the
//! clocks, the orientation of the board for each camera, and a first transform ([`start`]). Then the events of the second camera
//! become rows on the trajectories of the first, and both cameras, their event biases and the mount ([`mount`]) are estimated
//! from all events at once ([`joint`]). [`findings()`] checks the result.

pub mod calibration;
mod carried;
pub mod error;
pub mod estimate;
pub mod findings;
pub mod frames;
pub mod joint;
pub mod mount;
mod rows;
pub mod seen;
pub mod start;

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;

use self::calibration::SecondCalibration;
use self::error::SecondCameraError;
use self::estimate::Estimate;
use self::findings::findings;
use self::joint::{Joint, Lenses, Solved, own_rms, share_of_lenses, solve};
use self::mount::{Mount, ROTATION, TRANSLATION};
use self::seen::{Seen, sample_at};
use self::start::{FEWEST_SECONDS, Start};
use crate::quality::uncertainty::Uncertainty;
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_geometry::board::symmetry::{Symmetries, Symmetry};
use evcal_solve::solve::fixed_intrinsics::{self, FixedIntrinsics};
use evcal_solve::solve::left_out::covers;
use evcal_solve::solve::observation::{EventBin, EventObservation, SegmentObservations};
use evcal_solve::solve::refinement::Refined;
use evcal_solve::solve::{BOARD_PARAMETERS, FreeParameters, Problem, State};
use evcal_solve::trajectory::mean_distance;

/// Largest σ of the rotation (rad) with which a mount counts as determined.
const LEAST_KNOWN_ROTATION: f64 = 0.35;

/// A camera that was calibrated separately, from one recording.
#[derive(Clone, Copy)]
pub struct SeparateCalibration<'a> {
    /// Camera, trajectories and events.
    pub refined: &'a Refined,
    /// Uncertainty of its intrinsics.
    pub uncertainty: &'a Uncertainty,
}

/// Calibrates the `second` camera against the `first`, with a board of these `symmetries`.
/// Intrinsics are estimated too, unless `lenses` contains them.
///
/// # Errors
/// [`SecondCameraError`] names the problem with the recordings or the motion, and the remedy.
pub fn calibrate_second(
    first: SeparateCalibration,
    second: SeparateCalibration,
    symmetries: &Symmetries,
    lenses: Lenses,
) -> Result<SecondCalibration, SecondCameraError> {
    let trajectories = &first.refined.state.trajectories;
    let start = start::start(trajectories, &Seen::along(&second.refined.state.trajectories), symmetries, start::LOOSE)?;
    let segments = seen_by_both(first.refined, &second.refined.problem.segments, &start, &symmetries.rotations);
    let count = |segments: &[SegmentObservations]| segments.iter().map(|one| one.events.len()).sum::<usize>();
    let left_out = 1.0 - count(&segments) as f64 / count(&second.refined.problem.segments).max(1) as f64;
    let joint = Joint {
        first: with_board_fixed(&first.refined.problem, first.refined.problem.segments.clone()),
        second: with_board_fixed(&second.refined.problem, segments),
    };
    let estimate = Estimate {
        first: first.refined.state.clone(),
        second: State { board: first.refined.state.board, trajectories: Vec::new(), ..second.refined.state.clone() },
        mount: start.mount,
    };
    let solved = solve_with_fixed_lenses(joint, estimate, lenses)?;
    let known = Known {
        correlation: Some(start.correlation),
        seconds: start.seconds,
        left_out,
        own_rms: Some(own_rms(&second.refined.problem, &second.refined.state)?),
        time_scatter: start.time_scatter,
        sensors: [first, second].map(|camera| camera.refined.problem.sensor),
        lenses,
    };
    let sigma = [first, second].map(|camera| camera.uncertainty.sigma());
    let before = [(&first.refined.state.camera, sigma[0].as_slice()), (&second.refined.state.camera, &sigma[1])];
    determined(finish(solved, &known, before))
}

/// Pictures of the first camera itself, with a lens that was calibrated separately.
#[derive(Clone, Copy)]
pub struct Pictures<'a> {
    /// The lens.
    pub camera: Camera<f64>,
    /// Standard deviation of each of its parameters.
    pub sigma: &'a [f64],
    /// Centres of dots for each trajectory of the first camera, on its clock.
    pub points: &'a [Vec<PointObservation>],
    /// Spread of a centre along one axis (px).
    pub point_sigma: f64,
}

/// Calibrates `pictures` against the events of the same sensor, as if they were pictures of a second camera: the relative pose
/// should be the identity. The intrinsics of the events are estimated too, unless they are fixed (`fixed`).
///
/// # Errors
/// [`SecondCameraError`] names the problem with the recording or the motion, and the remedy.
pub fn calibrate_pictures_against(
    first: SeparateCalibration,
    pictures: Pictures,
    fixed: Option<&FixedIntrinsics>,
) -> Result<SecondCalibration, SecondCameraError> {
    let of = |points: &Vec<PointObservation>| SegmentObservations { points: points.clone(), ..Default::default() };
    let seen: Vec<f64> = pictures.points.iter().flatten().map(|point| point.t).collect();
    let (Some(begin), Some(end)) = (seen.first(), seen.last()) else {
        return Err(SecondCameraError::TooShort { seconds: 0.0, needed: FEWEST_SECONDS });
    };
    let (middle, seconds) = (0.5 * (begin + end), end - begin);
    if seconds < FEWEST_SECONDS {
        return Err(SecondCameraError::TooShort { seconds, needed: FEWEST_SECONDS });
    }
    let points = pictures.points.iter().map(of).collect();
    let second = problem_of_points(&first.refined.problem, points, pictures.sigma, pictures.point_sigma);
    let joint =
        Joint { first: with_board_fixed(&first.refined.problem, first.refined.problem.segments.clone()), second };
    let state = &first.refined.state;
    let estimate = Estimate {
        first: state.clone(),
        second: State { camera: pictures.camera, trajectories: Vec::new(), ..state.clone() },
        mount: Mount { second_first: Isometry3::identity(), offset: 0.0, rate: 0.0, middle, line_delay: None },
    };
    let lenses = [fixed, None];
    let mut solved = solve_with_fixed_lenses(joint, estimate, lenses)?;
    add_scale_error(&mut solved, &first);
    let sensor = first.refined.problem.sensor;
    let known = Known {
        correlation: None,
        seconds,
        left_out: 0.0,
        own_rms: None,
        time_scatter: None,
        sensors: [sensor; 2],
        lenses,
    };
    let before = (state.camera, pictures.camera);
    let sigma = first.uncertainty.sigma();
    determined(finish(solved, &known, [(&before.0, &sigma), (&before.1, pictures.sigma)]))
}

/// Adds an error to `solved` that blocks of time do not show: the error of the focal length of the `first` camera's events, which
/// pictures do not share.
fn add_scale_error(solved: &mut Solved, first: &SeparateCalibration) {
    let place = TRANSLATION + 2;
    let distance = mean_distance(&first.refined.state.trajectories);
    solved.covariance[(place, place)] += (first.uncertainty.systematic_scale * distance).powi(2);
}

/// Returns the problem of centres of dots with this spread (px), through a lens whose parameters have these `sigma`; parameters
/// without σ are fixed. Board and settings come from `first`.
fn problem_of_points(first: &Problem, points: Vec<SegmentObservations>, sigma: &[f64], point_sigma: f64) -> Problem {
    let mut problem = with_board_fixed(first, points);
    problem.point_sigma = point_sigma;
    problem.free.biases = Default::default();
    problem.free.intrinsics = std::array::from_fn(|index| sigma.get(index) > Some(&0.0));
    problem
}

/// Facts about two cameras, apart from their solve.
struct Known<'a> {
    correlation: Option<f64>,
    seconds: f64,
    left_out: f64,
    own_rms: Option<f64>,
    time_scatter: Option<f64>,
    sensors: [Sensor; 2],
    lenses: Lenses<'a>,
}

/// Solves with `lenses` fixed; the covariance includes the effect of their uncertainty.
fn solve_with_fixed_lenses(joint: Joint, estimate: Estimate, lenses: Lenses) -> Result<Solved, SecondCameraError> {
    let (joint, estimate) = with_fixed_lenses(joint, estimate, lenses);
    let mut solved = solve(&joint, estimate)?;
    if let Some(share) = share_of_lenses(&joint, &solved.estimate, lenses)? {
        solved.covariance += share;
    }
    Ok(solved)
}

/// Returns the input with `lenses` fixed.
fn with_fixed_lenses(mut joint: Joint, mut estimate: Estimate, lenses: Lenses) -> (Joint, Estimate) {
    let [first, second] = lenses;
    if let Some(lens) = first {
        joint.first = fixed_intrinsics::with_fixed(&joint.first);
        estimate.first.camera = lens.camera;
    }
    if let Some(lens) = second {
        joint.second = fixed_intrinsics::with_fixed(&joint.second);
        estimate.second.camera = lens.camera;
    }
    (joint, estimate)
}

/// Builds the result. `before` are the separately calibrated cameras, each with the σ of its parameters.
fn finish(solved: Solved, known: &Known, before: [(&Camera<f64>, &[f64]); 2]) -> SecondCalibration {
    let Solved { estimate, covariance, inflation, used, misfit, rms, .. } = solved;
    let cameras = [estimate.first.camera, estimate.second.camera];
    let moved = [0, 1].map(|index| {
        let (before, sigma) = (before[index].0, &with_other(&before, index));
        let solved = || FixedIntrinsics { camera: cameras[index], covariance: None }.distance(before, sigma);
        known.lenses[index].map_or_else(solved, |lens| lens.distance(before, sigma))
    });
    let mut calibration = SecondCalibration {
        mount: estimate.mount,
        covariance,
        inflation,
        correlation: known.correlation,
        seconds: known.seconds,
        used,
        left_out: known.left_out,
        looseness: known.own_rms.map(|own| rms / own),
        time_scatter: known.time_scatter,
        misfit,
        sensors: known.sensors,
        cameras,
        cameras_moved: moved,
        fixed: known.lenses.map(|lens| lens.is_some()),
        rolling_shutter: false,
        findings: Vec::new(),
    };
    calibration.findings = findings(&calibration);
    calibration
}

/// Number of parameters in pixels, with which every lens model begins: focal lengths and principal point.
const IN_PIXELS: usize = 4;

/// Returns σ of the parameters of one of two cameras. It contains the errors of the other one's, because both see the board along one
/// trajectory: errors of one lens bend the trajectory, and the solve of both adapts the other lens to it.
fn with_other(before: &[(&Camera<f64>, &[f64]); 2], index: usize) -> Vec<f64> {
    let ((camera, sigma), other) = (before[index], before[1 - index]);
    let focal = |camera: &Camera<f64>| camera.parameters().first().copied().unwrap_or(1.0);
    let scale = focal(camera) / focal(other.0);
    let shared = if camera.kind() == other.0.kind() { sigma.len() } else { IN_PIXELS };
    let mut sigma = sigma.to_vec();
    let free = sigma.iter_mut().zip(other.1).take(shared).enumerate().filter(|(_, (sigma, _))| **sigma > 0.0);
    free.for_each(|(index, (sigma, of_other))| {
        *sigma = sigma.hypot(of_other * if index < IN_PIXELS { scale } else { 1.0 });
    });
    sigma
}

/// Returns `calibration` if its rotation is determined. With a larger σ the equations are no longer linear, and all results are
/// invalid.
fn determined(calibration: SecondCalibration) -> Result<SecondCalibration, SecondCameraError> {
    let is_known = |axis: usize| calibration.sigma(ROTATION + axis) < LEAST_KNOWN_ROTATION;
    if (0..3).all(is_known) { Ok(calibration) } else { Err(SecondCameraError::Singular) }
}

/// Returns the problem with these observations, and the board fixed.
fn with_board_fixed(problem: &Problem, segments: Vec<SegmentObservations>) -> Problem {
    let free = FreeParameters { board: [false; BOARD_PARAMETERS], ..problem.free };
    Problem { free, ..problem.with_segments(segments) }
}

/// Returns the second camera's observations at times when the first has a trajectory, with the first camera's numbers of the
/// circles.
fn seen_by_both(
    first: &Refined,
    second: &[SegmentObservations],
    start: &Start,
    symmetries: &[Symmetry],
) -> Vec<SegmentObservations> {
    let edges: Vec<Vec<u16>> = symmetries.iter().map(|turn| first.problem.edges.turned(turn)).collect();
    let turn = |t: f64, segment: usize| {
        let time = start.mount.first_time(t);
        let (of_first, _) = sample_at(&first.state.trajectories, time)?;
        if covers(&first.left_out, 0, time) {
            return None;
        }
        let turn = *start.turns.get(&(of_first, segment))?;
        Some((symmetries.get(turn)?, edges.get(turn)?))
    };
    let of_segment = |(segment, observations): (usize, &SegmentObservations)| {
        let mut seen = SegmentObservations::default();
        for bin in &observations.bins {
            let Some((_, edges)) = turn(bin.t, segment) else { continue };
            let begin = seen.events.len();
            for event in observations.events.get(bin.first..bin.end).unwrap_or_default() {
                let Some(&edge) = edges.get(usize::from(event.edge)) else { continue };
                seen.events.push(EventObservation { edge, ..*event });
            }
            seen.bins.push(EventBin { t: bin.t, first: begin, end: seen.events.len() });
        }
        for point in &observations.points {
            let circle = turn(point.t, segment).and_then(|(turn, _)| turn.points.get(point.circle));
            seen.points.extend(circle.map(|&circle| PointObservation { circle: circle.into(), ..*point }));
        }
        seen
    };
    second.iter().enumerate().map(of_segment).collect()
}

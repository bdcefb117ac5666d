//! Comparison of two halves of the observations, calibrated separately.
//!
//! Time is cut into slices; the even ones form one half, the odd ones the other. Each half is solved on its own, starting at the
//! common result: two cameras from data without a common event. They should differ by no more than the reported uncertainty of
//! both, and each should explain the other half's events about as well as the other half's own camera does (with the trajectory
//! estimated in both cases).
//!
//! The common result is so near the result of each half that one Newton step leads there, and everything else follows from the
//! equations at the common result: the events are not processed again.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::quality::uncertainty::parts::CovarianceParts;
use crate::quality::uncertainty::projection::projection_uncertainty;
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_geometry::lens::projection_difference::{ProjectionDifference, projection_difference};
use evcal_solve::solve::equations::border::Columns;
use evcal_solve::solve::equations::normal::Equations;
use evcal_solve::solve::equations::stiffness::Stiffness;
use evcal_solve::solve::equations::system::TrajectoryPriors;
use evcal_solve::solve::half::{Half, SolvedHalf};
use evcal_solve::solve::lens_step::{observed_pixels, stepped};
use evcal_solve::solve::levenberg::intrinsics_of;
use evcal_solve::solve::observation::SegmentObservations;
use evcal_solve::solve::observation_range::{EventResidual, ObservationRange, point_residuals};
use evcal_solve::solve::{GLOBAL_COUNT, Problem, State};

/// Length of a slice of time (s); even slices form one half, odd ones the other.
const SLICE: f64 = 0.5;
/// Recordings with fewer slices are not divided.
const FEWEST_SLICES: f64 = 4.0;

/// Residuals of events for a camera that was not calibrated from them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOutResidual {
    /// Number of observations of both halves together.
    pub count: usize,
    /// Root mean square residual with the camera of the other half (px).
    pub rms: f64,
    /// Root mean square residual with the half's own camera (px).
    pub own_rms: f64,
}

/// Two calibrations, each from one half of the observations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplitHalf {
    /// The two cameras.
    pub cameras: [CameraDescription; 2],
    /// Projection of the second camera minus the projection of the first.
    pub difference: ProjectionDifference,
    /// The root mean square difference that their reported uncertainties predict (px).
    pub expected_rms: f64,
    /// 95 % bound of the difference if the reported uncertainties are right (px).
    pub bound: f64,
    /// Residuals of each half with the camera of the other.
    pub held_out: HeldOutResidual,
}

impl SplitHalf {
    /// Returns `true` if the halves differ by no more than the bound.
    pub fn consistent(&self) -> bool {
        self.difference.rms <= self.bound
    }
}

/// Returns the number of the slice that contains time `t` (s).
fn slice(t: f64) -> i64 {
    (t / SLICE).floor() as i64
}

/// Returns segment and slice of an interval.
fn slice_of(range: &ObservationRange, segments: &[SegmentObservations]) -> (usize, i64) {
    (range.segment, slice(range.start(segments)))
}

/// Cuts `ranges` into groups of at least `size`, without cutting a slice.
pub fn groups<'a>(
    ranges: &'a [ObservationRange],
    segments: &[SegmentObservations],
    size: usize,
) -> Vec<&'a [ObservationRange]> {
    let mut groups = Vec::new();
    let mut rest = ranges;
    let mut count = 0;
    for of_slice in ranges.chunk_by(|a, b| slice_of(a, segments) == slice_of(b, segments)) {
        count += of_slice.len();
        if count >= size {
            let (group, later) = rest.split_at(count);
            groups.push(group);
            (rest, count) = (later, 0);
        }
    }
    if !rest.is_empty() {
        groups.push(rest);
    }
    groups
}

/// The equations of both halves.
pub struct Halves<'a> {
    priors: Vec<TrajectoryPriors<'a>>,
    halves: [Half; 2],
    is_determined: bool,
}

impl<'a> Halves<'a> {
    /// Creates empty halves of `problem`, whose solution is `state`, from equations with these `columns`; `None` if the recording is too short.
    pub fn new(problem: &'a Problem, state: &State, columns: &Columns) -> Option<Self> {
        const NOT_STIFF: &Stiffness = &Stiffness::new();
        let total: f64 = state.trajectories.iter().map(|trajectory| trajectory.end() - trajectory.start()).sum();
        let priors = state.trajectories.iter().enumerate().map(|(segment, trajectory)| {
            TrajectoryPriors::new(trajectory, problem.stiffness.get(segment).unwrap_or(NOT_STIFF))
        });
        let free = problem.free.mask();
        (total >= SLICE * FEWEST_SLICES).then(|| Self {
            priors: priors.collect(),
            halves: [(); 2].map(|()| Half::new(columns, &free)),
            is_determined: true,
        })
    }

    /// Adds a group of [`groups`].
    pub fn add(&mut self, equations: &[Equations]) {
        let slice = |piece: &Equations| (piece.segment, slice(piece.t));
        for of_slice in equations.chunk_by(|a, b| slice(a) == slice(b)) {
            let Some((segment, number)) = of_slice.first().map(slice) else { continue };
            let Some(priors) = self.priors.get(segment) else { continue };
            let [even, odd] = &mut self.halves;
            let half = if number & 1 == 0 { even } else { odd };
            self.is_determined &= half.add_slice(of_slice, priors).is_some();
        }
    }

    /// Solves both halves; `None` if the observations of one do not determine it.
    pub fn solved(&self) -> Option<SolvedHalves> {
        let [first, second] = &self.halves;
        let solved = |half: &Half| Some((half.solved()?, half.loss.cost));
        self.is_determined.then_some(SolvedHalves([solved(first)?, solved(second)?]))
    }
}

/// The solutions of both halves, each with the cost of its observations at the common result.
pub struct SolvedHalves([(SolvedHalf, f64); 2]);

/// Compares the `halves` of `problem`. `state` is the solution of the whole problem, `events` are the residuals of the events at
/// this solution, and `parts` are the parts of its covariance. Returns `None` if the halves cannot be compared.
pub fn split_half(
    problem: &Problem,
    state: &State,
    halves: &SolvedHalves,
    events: &[EventResidual],
    parts: &CovarianceParts,
) -> Option<SplitHalf> {
    let free = problem.free.mask();
    let observed = observed_pixels(&problem.segments, problem.sensor);
    let camera = |(half, _): &(SolvedHalf, f64)| stepped(&state.camera, &half.globals, &observed);
    let formal = |(half, _): &(SolvedHalf, f64)| intrinsics_of(&half.formal, &free, state.camera.parameters().len());
    let [first, second] = &halves.0;
    let cameras = [camera(first)?, camera(second)?];
    let formal = [formal(first), formal(second)];
    // Errors common to both halves cancel.
    let scattered = &parts.noise + &parts.between_parts;
    let covariance = scale_by_scatter(&(&formal[0] + &formal[1]), &parts.noise, &scattered, &free)?;
    let difference = projection_difference(&cameras[0], &cameras[1], problem.sensor).ok()?;
    let expected = projection_uncertainty(&state.camera, &covariance, problem.sensor).ok()?;

    let distance = DVector::from_fn(formal[0].nrows(), |row, _| first.0.globals[row] - second.0.globals[row]);
    let mut held_out = HeldOutResidual { count: 0, rms: 0.0, own_rms: 0.0 };
    for (((half, cost), formal), squares) in halves.0.iter().zip(&formal).zip(squares(problem, state, events)) {
        // The cost is half the sum of the squared residuals, each over its own variance.
        let share = |decrease: f64| squares.sum * (1.0 - decrease / cost.max(f64::MIN_POSITIVE));
        held_out.count += squares.count;
        held_out.own_rms += share(half.decrease);
        held_out.rms += share(half.decrease - 0.5 * squared_mahalanobis_distance(formal, &distance, &free)?);
    }
    let mean = |sum: f64| (sum.max(0.0) / held_out.count.max(1) as f64).sqrt();
    let held_out = HeldOutResidual { rms: mean(held_out.rms), own_rms: mean(held_out.own_rms), ..held_out };
    Some(SplitHalf {
        cameras: cameras.map(|camera| CameraDescription::new(&camera)),
        difference,
        expected_rms: expected.rms,
        bound: expected.rms_95,
        held_out,
    })
}

/// Returns the squared `distance` of the intrinsics in units of their `covariance`; parameters that are not `free` do not count.
fn squared_mahalanobis_distance(
    covariance: &DMatrix<f64>,
    distance: &DVector<f64>,
    free: &[bool; GLOBAL_COUNT],
) -> Option<f64> {
    let places: Vec<usize> = (0..distance.len()).filter(|&index| free[index]).collect();
    let distance = distance.select_rows(&places);
    let factor = covariance.select_rows(&places).select_columns(&places).cholesky()?;
    Some(factor.solve(&distance).dot(&distance))
}

/// Number and sum of the squared residuals of a half (px²).
#[derive(Clone, Copy, Default)]
struct Squares {
    count: usize,
    sum: f64,
}

/// Returns the squared residuals of the even slices, then of the odd ones.
fn squares(problem: &Problem, state: &State, events: &[EventResidual]) -> [Squares; 2] {
    let mut halves = [Squares::default(); 2];
    let [even, odd] = &mut halves;
    let mut add = |t: f64, square: f64| {
        let half = if slice(t) & 1 == 0 { &mut *even } else { &mut *odd };
        half.count += 1;
        half.sum += square;
    };
    events.iter().for_each(|event| add(event.t, f64::from(event.residual).powi(2)));
    point_residuals(problem, state).iter().for_each(|point| add(point.t, point.residual.norm_squared()));
    halves
}

/// Scales `formal` by the ratio of `scattered` to `noise`, as matrices: if `formal` is k times `noise`, the result is k times
/// `scattered`. All are covariances of the intrinsics, with zeros for parameters that are not `free`. Returns `None` if one of
/// them is not positive definite.
fn scale_by_scatter(
    formal: &DMatrix<f64>,
    noise: &DMatrix<f64>,
    scattered: &DMatrix<f64>,
    free: &[bool; GLOBAL_COUNT],
) -> Option<DMatrix<f64>> {
    let count = noise.nrows();
    let places: Vec<usize> = (0..count).filter(|&index| free[index]).collect();
    let of_free = |matrix: &DMatrix<f64>| matrix.select_rows(&places).select_columns(&places);
    let root = |matrix: &DMatrix<f64>| Some(of_free(matrix).cholesky()?.unpack());
    let (formal, noise) = (root(formal)?, root(noise)?);
    let half = noise.solve_lower_triangular(&of_free(scattered))?;
    let shape = noise.solve_lower_triangular(&half.transpose())?;
    Some(intrinsics_of(&(&formal * shape * formal.transpose()), free, count))
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_solve::solve::observation::EventBin;

    #[test]
    fn no_slice_is_in_two_groups() {
        let bins = (0..100).map(|index| EventBin { t: 0.05 + 0.1 * f64::from(index), first: 0, end: 0 }).collect();
        let segments = [SegmentObservations { bins, ..SegmentObservations::default() }];
        let range = |first: usize| ObservationRange { segment: 0, bins: first..first + 2, points: 0..0 };
        let ranges: Vec<ObservationRange> = (0..100).step_by(2).map(range).collect();
        let groups = groups(&ranges, &segments, 4);
        assert_eq!(groups.concat(), ranges);
        assert!(groups.iter().rev().skip(1).all(|group| (4..8).contains(&group.len())), "{groups:?}");
        for pair in groups.windows(2) {
            let [before, after] = [pair[0].last().unwrap(), &pair[1][0]].map(|one| slice_of(one, &segments));
            assert!(before < after, "{before:?} {after:?}");
        }
    }

    #[test]
    fn the_scatter_of_halves_has_the_shape_of_the_whole_covariance() {
        let noise = DMatrix::from_row_slice(3, 3, &[2.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.5, 0.0, 1.0]);
        let scattered = DMatrix::from_row_slice(3, 3, &[9.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 3.0]);
        let mut free = [false; GLOBAL_COUNT];
        (free[0], free[2]) = (true, true);
        // Each half alone has twice the variance, and the difference of two has twice that.
        let four = scale_by_scatter(&(&noise * 4.0), &noise, &scattered, &free).unwrap();
        assert!((four - &scattered * 4.0).norm() < 1e-12);
        let formal = DMatrix::from_row_slice(3, 3, &[7.0, 0.0, 2.0, 0.0, 0.0, 0.0, 2.0, 0.0, 5.0]);
        // If the scatter has the shape of the noise, the covariance is only enlarged.
        let enlarged = scale_by_scatter(&formal, &noise, &(&noise * 2.5), &free).unwrap();
        assert!((enlarged - &formal * 2.5).norm() < 1e-12);
        let scatter = scale_by_scatter(&formal, &noise, &scattered, &free).unwrap();
        assert!((&scatter - scatter.transpose()).norm() < 1e-12 && scatter[(0, 0)] > formal[(0, 0)]);
        assert_eq!(scatter[(1, 1)], 0.0);
        let fixed = DMatrix::zeros(3, 3);
        assert_eq!(scale_by_scatter(&fixed, &fixed, &fixed, &[false; GLOBAL_COUNT]), Some(fixed));
    }
}

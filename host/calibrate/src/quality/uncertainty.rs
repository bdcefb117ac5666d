//! Uncertainty of the intrinsics.
//!
//! The inverse of the normal equations would be their covariance if all events were independent. They are not: events
//! of one passage of an edge share the errors of the pixel, the spline and the bias terms, so that the formal σ is
//! several times too small. The factor is estimated from the recording itself. The observations are cut into blocks of
//! time, each so long that its errors hardly reach into the next. The scatter of the estimate when each block in turn
//! is left out (the jackknife, to first order, with the trajectories adapting) yields another covariance. The necessary
//! length is not known, so several lengths are tried. The length with the largest scatter determines the size of the
//! covariance, and the mean over all lengths determines its shape. That shape is noisy, because there are only a few to
//! some tens of blocks. The formal covariance is not noisy, but contains no correlated errors. The shape of the
//! reported covariance is therefore a mean of both, with weights of 75 % (scatter) and 25 % (formal). Its size relative
//! to the formal covariance is one number, [`Uncertainty::inflation`].
//!
//! Drifts over the whole recording (focus, temperature, the board's position) show only between long parts, up to its halves.
//! There are few of these, so their scatter is partly chance: it is reduced by one standard deviation before it counts.
//!
//! Scatter cannot show an error that is common to all parts of a recording; simulated recordings with known ground truth do. The
//! error that the event biases leave, some thousandths of a pixel, grows with the shift that their latencies cause. It biases the
//! camera along poorly determined directions, in proportion to how poorly determined they are (`MODEL_ERROR`; poses and board
//! follow), and it biases the focal lengths even if the views determine them well (`LATENCY_SCALE`).

pub mod blocks;
pub mod parts;
pub mod projection;

use nalgebra::{DMatrix, DVector};

use crate::quality::board_evidence::{BoardEvidence, RADIUS, after, with_board};
use crate::quality::drift::{Drift, Interval, drift};
use crate::quality::split_half::{Halves, SolvedHalves, groups};
use blocks::{Scatter, StepWithout, limited_step, scatter, sum_by_block};
use evcal_solve::solve::equations::border::Columns;
use evcal_solve::solve::equations::pose_covariance::PoseCovariance;
use evcal_solve::solve::equations::system::{Contribution, PackedContribution};
use evcal_solve::solve::levenberg::{assemble, intrinsics_of, linearised};
use evcal_solve::solve::observation_range::{RANGES_TOGETHER, observation_ranges};
use evcal_solve::solve::rows::bearing_table::BearingTable;
use evcal_solve::solve::rows::board_edge::BoardEdges;
use evcal_solve::solve::rows::event_bias::CLASS_COUNT;
use evcal_solve::solve::rows::event_bias::bias::{Bias, Biases};
use evcal_solve::solve::{BOARD_INDEX, BOARD_PARAMETERS, GLOBAL_COUNT, Problem, SolveError, State, bias_index};
use parts::CovarianceParts;
use projection::{NoView, ProjectionUncertainty, projection_uncertainty};

/// Length of the blocks of time from whose scatter the correlation of events is estimated (s). Blocks of half, twice and four
/// times this length are used too, and the largest value counts.
pub const BLOCK: f64 = 0.25;
/// Smallest number of blocks; shorter recordings get shorter blocks.
const FEWEST_BLOCKS: f64 = 4.0;
/// Lower limit of the σ of the focal lengths, as a share of them: one error common to both.
const SYSTEMATIC_SCALE: f64 = 5e-5;
/// The same for boards of squares. With the limit for dots, 70 of 75 recordings of two simulators
/// were within their 95 % bound, with this one 74 (four kinds of boards, three lenses, slow and fast motion, two lights).
const SYSTEMATIC_SCALE_OF_SQUARES: f64 = 1e-4;
/// Lower limit of the σ of the focal lengths, as a share of them, if the latencies displace the events by half the
/// sensor's diagonal (root mean square). The limit is proportional to the displacement. Chosen on 70 simulated
/// recordings (seeds 9101 to 9196), like [`MODEL_ERROR`] and [`POSE_MODEL_ERROR`].
const LATENCY_SCALE: f64 = 0.108;
/// Error of the projection from imperfections of the event model (σ, rms over the sensor), as a share of the displacement of the
/// events by their latencies (root mean square), for each unit of leverage. Leverage is the variance of the projection from a single
/// event, divided by the variance of that event. More events do not make this error smaller. Without it, focal lengths of boards
/// that are seen head-on were up to 4 σ off (seeds 1401 to 1412).
const MODEL_ERROR: f64 = 1.3e-5;
/// Error of a pose from imperfections of the event model, as a share of the usual σ of a pose. For a pose that is w times less
/// certain, it is w² times as large.
pub const POSE_MODEL_ERROR: f64 = 0.2;
/// Smallest error of the circles' radius that is common to all events, if the radius is estimated (px, σ). With 0.05 px, dots of
/// 17.025 mm were not distinguished from 17.5 mm (seeds 501 to 503).
const SYSTEMATIC_RADIUS: f64 = 0.03;

/// Uncertainty of the intrinsics of a calibration.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// Covariance of the intrinsics, in the order of the camera model's parameters; rows and columns of fixed parameters are
    /// zero.
    pub covariance: DMatrix<f64>,
    /// Part of it that is common to all parts of the recording, so that their scatter does not show it; zero if it is not known.
    pub systematic: DMatrix<f64>,
    /// Smallest error of the focal lengths that is common to all events, as a share of them (σ).
    pub systematic_scale: f64,
    /// Variance of the estimate divided by its variance if all observations were independent, at least 1.
    pub inflation: f64,
    /// Number of observations.
    pub observations: usize,
    /// Number of blocks of time from which the inflation was estimated.
    pub blocks: usize,
}

/// Uncertainty of a joint solve.
pub struct SolveUncertainty {
    /// Uncertainty of the intrinsics.
    pub intrinsics: Uncertainty,
    /// Causes of that uncertainty.
    pub parts: CovarianceParts,
    /// Standard deviation of each estimated parameter of the board; zero for fixed ones.
    pub board_sigma: [f64; BOARD_PARAMETERS],
    /// Evidence about the board with all its parameters estimated; `None` if the observations do not determine them.
    pub board: Option<BoardEvidence>,
    /// Standard deviation of each bias of each event class; zero for fixed ones.
    pub bias_sigma: BiasSigma,
    /// Covariance of the poses.
    pub poses: PoseCovariance,
    /// Covariance of all estimated global parameters, if observations were independent.
    pub formal: DMatrix<f64>,
    /// Both halves of the observations, solved separately; `None` if there are too few.
    pub halves: Option<SolvedHalves>,
    /// A change of the lens or the board within the recordings; `None` if there is none.
    pub drift: Option<Drift>,
}

/// A standard deviation for each bias of each event class.
pub type BiasSigma = [Biases<f64>; CLASS_COUNT];

impl Uncertainty {
    /// Returns the standard deviation of each intrinsic parameter, in the order of the camera model.
    pub fn sigma(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }

    /// Returns the correlation of the intrinsics: 1 on the diagonal; zero off the diagonal for fixed parameters.
    pub fn correlation(&self) -> DMatrix<f64> {
        let sigma = self.sigma();
        DMatrix::from_fn(sigma.len(), sigma.len(), |row, column| {
            let scale = sigma[row] * sigma[column];
            if row == column {
                1.0
            } else if scale > 0.0 {
                self.covariance[(row, column)] / scale
            } else {
                0.0
            }
        })
    }

    /// Returns the number of independent observations that would determine the camera as well.
    pub fn effective_observations(&self) -> f64 {
        self.observations as f64 / self.inflation
    }
}

/// Lengths of blocks, as multiples of [`BLOCK`].
const BLOCK_LENGTHS: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
/// The longest of them.
const LAST_LENGTH: usize = BLOCK_LENGTHS.len() - 1;

/// Share of the reported covariance whose shape follows the scatter of blocks; the rest has the shape of the formal one.
const SCATTER_PART: f64 = 0.75;

/// Lengths of the parts of the recordings that are compared to detect drifts, as shares of the whole.
const LONG_PARTS: [f64; 3] = [0.125, 0.25, 0.5];

/// Returns the inflation from few blocks, reduced by one standard deviation of its estimate: the scatter of the blocks
/// in each of `directions` is χ² distributed.
fn lower_end(scatter: &Scatter, directions: usize) -> f64 {
    let freedom = (scatter.blocks.max(2) - 1) * directions.max(1);
    scatter.inflation / (1.0 + (2.0 / freedom as f64).sqrt())
}

/// Combines the formal covariance and the `scatters` of blocks to the reported covariance. Returns it with its inflation and the
/// number of blocks from which the inflation was estimated.
fn combined(formal: &DMatrix<f64>, scatters: impl Iterator<Item = Scatter>) -> (DMatrix<f64>, f64, usize) {
    let (mut shape, mut lengths) = (DMatrix::zeros(formal.nrows(), formal.ncols()), 0.0);
    let (mut inflation, mut blocks) = (1.0, 0);
    for scatter in scatters {
        shape += scatter.covariance / scatter.inflation;
        lengths += 1.0;
        if scatter.inflation > inflation {
            (inflation, blocks) = (scatter.inflation, scatter.blocks);
        }
    }
    let shape =
        if blocks > 0 { shape * (SCATTER_PART / lengths) + formal * (1.0 - SCATTER_PART) } else { formal.clone() };
    (shape * inflation, inflation, blocks)
}

/// Computes the uncertainty of `state`, the solution of `problem`.
///
/// # Errors
/// [`SolveError::Singular`] if the observations do not determine the estimated parameters.
pub fn uncertainty(problem: &Problem, state: &State) -> Result<SolveUncertainty, SolveError> {
    let ranges = observation_ranges(&problem.segments);
    let free = problem.free.mask();
    // The solve does not evaluate the equations after its last step, so this is done here. The equations before that
    // step cannot be used: if coefficients are strongly correlated, the step rotates the poorly determined direction,
    // and along it the contributions of the blocks would appear far too large.
    let columns = Columns::new(&with_board(problem).mask());
    let system = assemble(problem, state, &ranges, &columns)?;
    let observations = system.loss.count;
    // The derivative of an event's distance by the offset of its class is 1, by the latency the edge's speed.
    let latency_shift = latency_shift(state.bias.iter().enumerate().map(|(class, bias)| {
        let sums = [Bias::Offset, Bias::Latency].map(|bias| system.information_of(bias_index(class, bias)));
        (bias.biases[Bias::Latency], sums)
    }));
    // Long trajectories have large systems. Each form of the system replaces the one before, so that only one is in
    // memory.
    let reduced = system.into_reduced()?;
    let places = columns.among(&free);
    let formal = reduced.covariance(&places)?;
    let formal_with_board = reduced.whole_covariance().ok();
    let step_with_board = reduced.global_step().ok().map(|step| columns.globals(&step));
    let follows = reduced.into_follows();
    let bearings = BearingTable::new(&state.camera, problem.sensor);
    let mut contributions_with_board = Vec::with_capacity(ranges.len());
    let mut curvatures = Vec::with_capacity(ranges.len());
    let mut halves = Halves::new(problem, state, &columns);
    for group in groups(&ranges, &problem.segments, RANGES_TOGETHER) {
        let equations = linearised(problem, state, &bearings, group, &columns)?;
        contributions_with_board.extend(follows.contributions(&equations));
        curvatures.extend(equations.iter().map(|one| one.loss.curvature()));
        if let Some(halves) = &mut halves {
            halves.add(&equations);
        }
    }
    let halves = halves.and_then(|halves| halves.solved());
    let times: Vec<(usize, f64)> = ranges.iter().map(|range| (range.segment, range.start(&problem.segments))).collect();
    let total: f64 = state.trajectories.iter().map(|trajectory| trajectory.end() - trajectory.start()).sum();
    let time = Time { starts: &times, total };
    let of_free = |one: Contribution| one.of(&places);
    let (reported, inflation, blocks) =
        reported_covariance(&formal, &contributions_with_board, &of_free, time, first_count(&free), limited_step);
    let board = formal_with_board
        .zip(step_with_board)
        .map(|(formal, step)| board_evidence(problem, state, &formal, &step, &contributions_with_board, time));
    let recording = |segment: usize| state.trajectories.get(segment).map_or(0, |trajectory| trajectory.recording);
    let interval = |(&(segment, start), &curvature)| Interval { recording: recording(segment), start, curvature };
    let intervals: Vec<Interval> = times.iter().zip(&curvatures).map(interval).collect();
    let drift =
        drift(&state.camera, problem.sensor, &with_board(problem).mask(), &intervals, &contributions_with_board);
    drop(contributions_with_board);

    let count = state.camera.parameters().len();
    // Errors common to all parts of the recording, as a share of the formal covariance and as an error of the focal lengths.
    let noise = intrinsics_of(&formal, &free, count);
    let (common, systematic_scale) = if problem.segments.iter().all(|segment| segment.events.is_empty()) {
        (0.0, 0.0)
    } else {
        let common = common_share(problem, state, &noise, observations, MODEL_ERROR * latency_shift);
        let half_diagonal = 0.5 * f64::from(problem.sensor.width).hypot(f64::from(problem.sensor.height));
        let smallest = match problem.edges {
            BoardEdges::Rims(_) => SYSTEMATIC_SCALE,
            BoardEdges::Lines(_) => SYSTEMATIC_SCALE_OF_SQUARES,
        };
        (common, smallest.max(LATENCY_SCALE * latency_shift / half_diagonal.max(1.0)))
    };
    let focal_lengths = std::array::from_fn(|axis| if free[axis] { state.camera.parameters()[axis] } else { 0.0 });
    let of_model = &noise * common;
    let scale = scale_error(&of_model, focal_lengths, systematic_scale);
    let reported_intrinsics = intrinsics_of(&reported, &free, count);
    let parts = CovarianceParts {
        between_parts: &reported_intrinsics - &noise,
        noise,
        focal_lengths: &scale * scale.transpose(),
        event_model: of_model,
    };
    let systematic = &parts.event_model + &parts.focal_lengths;
    let covariance = reported_intrinsics + &systematic;

    // The poses follow the camera, so its errors move them too.
    let scale = DVector::from_fn(places.len(), |row, _| scale.get(places[row]).copied().unwrap_or(0.0));
    let of_globals = &formal * (1.0 + common / inflation) + &scale * scale.transpose() / inflation;
    let controls = follows.control_covariances(&places, &of_globals).ok_or(SolveError::Singular)?;
    drop(follows);
    let poses = PoseCovariance::new(controls, inflation, &state.trajectories, POSE_MODEL_ERROR);

    let mut variances = [0.0; GLOBAL_COUNT];
    let places = (0..GLOBAL_COUNT).filter(|&global| free[global]);
    for (global, variance) in places.zip(formal.diagonal().iter()) {
        variances[global] = (inflation + common) * variance.max(0.0);
    }
    let bias_sigma = std::array::from_fn(|class| Biases::from_fn(|bias| variances[bias_index(class, bias)].sqrt()));
    let first_of_board = free.iter().take(BOARD_INDEX).filter(|&&free| free).count();
    let mut board_sigma = [0.0; BOARD_PARAMETERS];
    let free_of_board = board_sigma.iter_mut().zip(problem.free.board).filter(|(_, free)| *free);
    for (place, (sigma, _)) in (first_of_board..).zip(free_of_board) {
        *sigma = (reported[(place, place)] + common * formal[(place, place)]).max(0.0).sqrt();
    }
    if problem.free.board[RADIUS] {
        board_sigma[RADIUS] = libm::hypot(board_sigma[RADIUS], SYSTEMATIC_RADIUS * problem.mean_scale);
    }
    let intrinsics = Uncertainty { covariance, systematic, systematic_scale, inflation, observations, blocks };
    Ok(SolveUncertainty { intrinsics, parts, board_sigma, board, bias_sigma, poses, formal, halves, drift })
}

/// Times of the observations.
#[derive(Clone, Copy, Debug)]
pub struct Time<'a> {
    /// Start of each interval of them: segment, and seconds.
    pub starts: &'a [(usize, f64)],
    /// Total length of all trajectories (s).
    pub total: f64,
}

/// Returns the number of `free` parameters that are intrinsics or the board's, which come first.
fn first_count(free: &[bool; GLOBAL_COUNT]) -> usize {
    free.iter().take(BOARD_INDEX + BOARD_PARAMETERS).filter(|&&free| free).count()
}

/// Computes the reported covariance of the `first` parameters, its inflation, and the number of blocks behind it. `part` extracts
/// what is needed of a block's contribution, `formal` is the inverse of the whole information, `contributions` come from intervals of
/// observations, and `step_without` is the step when a block is left out.
pub fn reported_covariance(
    formal: &DMatrix<f64>,
    contributions: &[PackedContribution],
    part: &dyn Fn(Contribution) -> Contribution,
    time: Time,
    first: usize,
    step_without: StepWithout,
) -> (DMatrix<f64>, f64, usize) {
    let longest = time.total / FEWEST_BLOCKS;
    let formal_first = formal.view((0, 0), (first, first)).into_owned();
    let lengths = BLOCK_LENGTHS.map(|factor| (factor * BLOCK).min(longest));
    let of_length = |length: f64| {
        // The blocks are summed one at a time, because all sums together would be as large as the contributions.
        scatter(formal, sum_by_block(time.starts, contributions, length).map(part), first, step_without)
    };
    let (reported, inflation, blocks) = combined(&formal_first, lengths.into_iter().filter_map(of_length));
    let long = LONG_PARTS.map(|share| share * time.total).into_iter().filter(|&length| length > lengths[LAST_LENGTH]);
    let drift = long.filter_map(of_length).map(|scatter| lower_end(&scatter, first)).fold(inflation, f64::max);
    (reported * (drift / inflation), drift, blocks)
}

/// Computes the evidence about the board from the `formal` covariance and the step of all parameters, both with the
/// parameters of the board estimated too.
fn board_evidence(
    problem: &Problem,
    state: &State,
    formal: &DMatrix<f64>,
    step: &[f64],
    contributions: &[PackedContribution],
    time: Time,
) -> BoardEvidence {
    let parameters = with_board(problem);
    let free = parameters.mask();
    let there = |one: Contribution| after(step, one, &free);
    let first = first_count(&free);
    let (reported, ..) = reported_covariance(formal, contributions, &there, time, first, limited_step);
    let board = parameters.board.iter().filter(|&&free| free).count();
    let variances: Vec<f64> = reported.diagonal().iter().skip(first - board).copied().collect();
    let radius_error = SYSTEMATIC_RADIUS * problem.mean_scale;
    BoardEvidence::new(state, step, parameters.board, variances.into_iter(), radius_error)
}

/// Returns the errors of the event model as a share of the `formal` covariance of the intrinsics; `model_error` is the error of
/// the projection per unit of leverage (px rms, σ).
fn common_share(problem: &Problem, state: &State, formal: &DMatrix<f64>, observations: usize, model_error: f64) -> f64 {
    match projection_uncertainty(&state.camera, formal, problem.sensor) {
        // A projection error of `model_error` times the leverage N rms² / s².
        Ok(ProjectionUncertainty { rms, .. }) => {
            (model_error * observations as f64 * rms / spread_squared(problem, state)).powi(2)
        }
        Err(NoView) => 1.0,
    }
}

/// Returns the displacement that the latencies of event classes cause (px, root mean square over all events). Each class has its
/// latency (s), the sum of the weights of its events, and the sum of their weights times the squared speeds of the edges
/// (px²/s²). The common latency, the mean weighted with these squares, causes no displacement, because it is a shift of the
/// clock.
fn latency_shift(classes: impl Iterator<Item = (f64, [f64; 2])>) -> f64 {
    let (mut weights, mut speeds, mut latencies, mut squares) = (0.0, 0.0, 0.0, 0.0);
    for (latency, [weight, speed]) in classes {
        weights += weight;
        speeds += speed;
        latencies += speed * latency;
        squares += speed * latency * latency;
    }
    if weights > 0.0 && speeds > 0.0 {
        ((squares - latencies * latencies / speeds).max(0.0) / weights).sqrt()
    } else {
        0.0
    }
}

/// Returns the squared spread with which the events of `problem` are weighted (px²), the harmonic mean over all of them.
fn spread_squared(problem: &Problem, state: &State) -> f64 {
    let (mut weights, mut count) = (0.0, 0_usize);
    for event in problem.segments.iter().flat_map(|segment| &segment.events) {
        let sigma =
            state.bias.get(usize::from(event.class)).and_then(|bias| bias.sigma.get(usize::from(event.speed_range)));
        if let Some(sigma) = sigma.filter(|&&sigma| sigma > 0.0) {
            weights += 1.0 / (sigma * sigma);
            count += 1;
        }
    }
    if weights > 0.0 { count as f64 / weights } else { 1.0 }
}

/// Returns the common error of both `focal_lengths`, the first intrinsics, which is to be added to `covariance` so that their σ
/// are at least this `share` of them.
fn scale_error(covariance: &DMatrix<f64>, focal_lengths: [f64; 2], share: f64) -> DVector<f64> {
    let lacking = |axis: usize| {
        let focal_length = focal_lengths[axis];
        if focal_length > 0.0 { share * share - covariance[(axis, axis)] / (focal_length * focal_length) } else { 0.0 }
    };
    let share = lacking(0).max(lacking(1)).max(0.0).sqrt();
    let mut common = DVector::zeros(covariance.nrows());
    common.iter_mut().zip(focal_lengths).for_each(|(entry, focal_length)| *entry = share * focal_length);
    common
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_common_error_moves_both_focal_lengths_together() {
        let before = DMatrix::from_diagonal(&DVector::from_column_slice(&[0.0225, 0.04, 0.01, 0.01]));
        let with_scale_error = |covariance: DMatrix<f64>, share: f64| {
            let error = scale_error(&covariance, [300.0, 400.0], share);
            covariance + &error * error.transpose()
        };
        let after = with_scale_error(before.clone(), 1e-3);
        // Of 0.3 px and 0.4 px, 0.15 px and 0.2 px are included already.
        assert!((after[(0, 0)] - 0.09).abs() < 1e-12 && (after[(1, 1)] - 0.16).abs() < 1e-12, "{after}");
        assert_eq!(with_scale_error(after.clone(), 9e-4), after);
        let difference = after - before;
        // The uncertainty of their ratio is unchanged.
        let ratio = DVector::from_column_slice(&[1.0 / 300.0, -1.0 / 400.0, 0.0, 0.0]);
        assert!((&difference * &ratio).norm() < 1e-12, "{difference}");
        assert_eq!(difference.view((2, 2), (2, 2)).norm(), 0.0);
    }

    #[test]
    fn only_differences_between_latencies_displace_events() {
        // As many events of either class, on edges of 500 px/s.
        let sums = [2.0, 2.0 * 250_000.0];
        let shift = |latencies: [f64; 2]| latency_shift(latencies.map(|latency| (latency, sums)).into_iter());
        // Half a millisecond from the mean of both.
        assert!((shift([0.0, 1e-3]) - 0.25).abs() < 1e-12);
        assert!((shift([7e-3, 8e-3]) - 0.25).abs() < 1e-9);
        assert!(shift([3e-3, 3e-3]) < 1e-6);
        // Without motion, latencies have no effect.
        assert_eq!(latency_shift([(0.0, [2.0, 0.0]), (1e-3, [2.0, 0.0])].into_iter()), 0.0);
    }

    #[test]
    fn the_largest_scatter_determines_the_size_and_all_of_them_the_shape() {
        let formal = DMatrix::from_diagonal_element(2, 2, 1.0);
        let of = |x: f64, y: f64, blocks: usize| Scatter {
            covariance: DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&[x, y])),
            inflation: 0.5 * (x + y),
            blocks,
        };
        let (reported, inflation, blocks) = combined(&formal, [of(1.0, 3.0, 9), of(6.0, 2.0, 5)].into_iter());
        assert_eq!((inflation, blocks), (4.0, 5));
        // The mean shape is (0.5 + 1.5, 1.5 + 0.5) / 2: even, as the formal one.
        assert!((&reported - DMatrix::from_diagonal_element(2, 2, 4.0)).norm() < 1e-12, "{reported}");
        let (reported, ..) = combined(&formal, std::iter::once(of(6.0, 2.0, 5)));
        assert!((reported[(0, 0)] - 4.0 * (0.75 * 1.5 + 0.25)).abs() < 1e-12, "{reported}");
    }

    #[test]
    fn the_scatter_of_few_blocks_is_reduced_to_its_lower_end() {
        let of = |blocks: usize| Scatter { covariance: DMatrix::zeros(0, 0), inflation: 6.0, blocks };
        assert!((lower_end(&of(3), 1) - 3.0).abs() < 1e-12);
        assert!(lower_end(&of(2), 9) < lower_end(&of(8), 9) && lower_end(&of(8), 9) < 6.0);
    }

    #[test]
    fn without_scatter_the_formal_covariance_is_reported() {
        let formal = DMatrix::from_diagonal_element(3, 3, 0.2);
        assert_eq!(combined(&formal, std::iter::empty()), (formal.clone(), 1.0, 0));
    }
}

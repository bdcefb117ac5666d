//! How sure the intrinsics are.
//!
//! The inverse of the normal equations would be their covariance if every event were a measurement of its
//! own. It is not: events of one passage of an edge share what the pixel, the spline and the bias terms get
//! wrong, so that the formal σ is several times too small. How much too small, the recording itself tells:
//! the observations are cut into blocks of time, each long enough that its errors hardly reach into the
//! next, and the estimate's scatter when one block after the other is left out (the jackknife, to first
//! order, with the trajectories giving way) gives another covariance. How long is long enough is not known,
//! so several lengths are tried: the one with the largest scatter gives the size of the covariance, the mean
//! of all its shape. From a few to some tens of blocks that shape is noisy; the formal one is not, but it knows
//! nothing of what correlates errors. What is stated is three parts of the former and one of the latter, blown up to the
//! same size by one number, [`Uncertainty::inflation`].
//!
//! What drifts over the whole recording (focus, temperature, the board's place) shows only between long parts, up to its
//! halves. There are few of them, so that their scatter is chance to a good part: they count by the lower end of what
//! it may be, one standard deviation below.
//!
//! No scatter shows an error that every part of a recording has. Simulated recordings with known truth do. What the biases of
//! the events do not follow, some thousandths of a pixel, is the larger the more their latencies move them. It moves the camera in the
//! directions that the views hardly determine, the further the less they do (`MODEL_ERROR`; the poses and the board
//! go with it), and the focal lengths, even if the views determine them well (`LATENCY_SCALE`).

pub mod blocks;
pub mod parts;
pub mod projection;

use nalgebra::{DMatrix, DVector};

use crate::solve::bearing_table::BearingTable;
use crate::solve::event_bias::CLASS_COUNT;
use crate::solve::event_bias::bias::{Bias, Biases};
use crate::solve::levenberg::{intrinsics_of, linearised};
use crate::solve::pose_covariance::PoseCovariance;
use crate::solve::stretch::{STRETCHES_TOGETHER, stretches};
use crate::solve::system::{Contribution, PackedContribution, System};
use crate::solve::{BOARD_INDEX, BOARD_PARAMETERS, GLOBAL_COUNT, Problem, SolveError, State, bias_index};
use crate::trust::board_evidence::{BoardEvidence, RADIUS, after, with_board};
use crate::trust::split_half::{Halves, SolvedHalves, groups};
use blocks::{Scatter, scatter, sum_by_block};
use parts::CovarianceParts;
use projection::{NoView, ProjectionUncertainty, projection_uncertainty};

/// Length of the blocks of time whose scatter tells how far events are correlated (s); blocks of half, twice and four times this
/// length are looked at too, and the largest figure counts.
pub const BLOCK: f64 = 0.25;
/// Shorter recordings get shorter blocks, so that there are this many.
const FEWEST_BLOCKS: f64 = 4.0;
/// Lower limit of the σ of the focal lengths, as a share of them: one error common to both.
const SYSTEMATIC_SCALE: f64 = 5e-5;
/// The same limit if the latencies displace the events by half the sensor's diagonal (root mean square); for smaller displacements
/// it is smaller in proportion.
const LATENCY_SCALE: f64 = 0.108;
/// Error of the projection from imperfections of the event model (σ, rms over the sensor), as a share of the displacement of the
/// events by their latencies (root mean square), for each unit of leverage. Leverage is the variance of the projection from a single
/// event, divided by the variance of that event. More events do not make this error smaller.
const MODEL_ERROR: f64 = 1.3e-5;
/// Error of a pose from imperfections of the event model, as a share of the usual σ of a pose. For a pose that is w times less
/// certain, it is w² times as large.
pub const POSE_MODEL_ERROR: f64 = 0.2;
/// The least error of the circles' radius that all events have in common, where it is estimated (px, σ).
const SYSTEMATIC_RADIUS: f64 = 0.03;

/// How sure the intrinsics of a calibration are.
#[derive(Clone, Debug, PartialEq)]
pub struct Uncertainty {
    /// Covariance of the intrinsics, in the order of the camera model's parameters; rows and columns of
    /// parameters that are held are zero.
    pub covariance: DMatrix<f64>,
    /// What of it all parts of the recording have in common, so that their scatter does not tell it; zero where nothing is known of it.
    pub systematic: DMatrix<f64>,
    /// The least error of the focal lengths that all events have in common, as a share of them (σ).
    pub systematic_scale: f64,
    /// Variance of the estimate over what it would be if all observations were independent, at least 1.
    pub inflation: f64,
    /// Number of observations.
    pub observations: usize,
    /// Number of blocks of time that the inflation was found with.
    pub blocks: usize,
}

/// How sure a joint solve is.
pub struct SolveUncertainty {
    /// That of the intrinsics.
    pub intrinsics: Uncertainty,
    /// Where it comes from.
    pub parts: CovarianceParts,
    /// Standard deviation of each parameter of the board that was estimated; zero where it is held.
    pub board_sigma: [f64; BOARD_PARAMETERS],
    /// What the observations say of the board with all its parameters free; `None` where they cannot tell.
    pub board: Option<BoardEvidence>,
    /// Standard deviation of each bias of each event class; zero where it is held.
    pub bias_sigma: BiasSigma,
    /// How sure each pose is.
    pub poses: PoseCovariance,
    /// Covariance of all global parameters that are free, if observations were independent.
    pub formal: DMatrix<f64>,
    /// Both halves of the observations, solved apart; `None` where they are too few.
    pub halves: Option<SolvedHalves>,
}

/// A standard deviation for each bias of each event class.
pub type BiasSigma = [Biases<f64>; CLASS_COUNT];

impl Uncertainty {
    /// Standard deviation of each intrinsic parameter, in the order of the camera model.
    pub fn sigma(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect()
    }

    /// Correlation of the intrinsics, 1 on the diagonal; zero beside it where a parameter is held.
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

    /// Independent observations that would determine the camera as well.
    pub fn effective_observations(&self) -> f64 {
        self.observations as f64 / self.inflation
    }
}

/// Lengths of blocks that are looked at, as multiples of the one in the settings.
const BLOCK_LENGTHS: [f64; 4] = [0.5, 1.0, 2.0, 4.0];
/// The longest of them.
const LAST_LENGTH: usize = BLOCK_LENGTHS.len() - 1;

/// Part of the stated covariance whose shape is that of the scatter of blocks; the rest has that of the formal one.
const SCATTER_PART: f64 = 0.75;

/// Long parts of the recordings that are looked at for drifts, as shares of all.
const LONG_PARTS: [f64; 3] = [0.125, 0.25, 0.5];

/// The lower end of what the inflation may be that was found from few blocks: their scatter in each of `directions` is χ²
/// distributed.
fn lower_end(scatter: &Scatter, directions: usize) -> f64 {
    let freedom = (scatter.blocks.max(2) - 1) * directions.max(1);
    scatter.inflation / (1.0 + (2.0 / freedom as f64).sqrt())
}

/// The covariance that is stated, its inflation, and the number of blocks that the inflation was found with, from the formal
/// one and from the `scatters` of blocks.
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

/// The uncertainty of `state`, which solves `problem`; `system` is the one there, or one small step before.
///
/// # Errors
/// [`SolveError::Singular`] when the observations do not determine the free parameters.
pub fn uncertainty(problem: &Problem, state: &State, system: System) -> Result<SolveUncertainty, SolveError> {
    let stretches = stretches(&problem.segments);
    let free = problem.free.mask();
    let singular = |_| SolveError::Singular;
    let observations = system.loss.count;
    // The derivative of an event's place by the offset of its class is 1, that by the latency the edge's speed.
    let latency_shift = latency_shift(state.bias.iter().enumerate().map(|(class, bias)| {
        let sums = [Bias::Offset, Bias::Latency].map(|bias| system.information_of(bias_index(class, bias)));
        (bias.biases[Bias::Latency], sums)
    }));
    // Long trajectories have large systems: there is one of a kind at a time.
    let reduced = system.into_reduced(0.0, &with_board(problem).mask()).map_err(singular)?;
    let places = reduced.places(&free);
    let formal = reduced.covariance(&places).map_err(singular)?;
    let all_places = reduced.places(&with_board(problem).mask());
    let formal_with_board = reduced.covariance(&all_places).ok();
    let step_with_board = reduced.global_step().ok();
    let follows = reduced.into_follows();
    let bearings = BearingTable::new(&state.camera, problem.sensor);
    let mut contributions_with_board = Vec::with_capacity(stretches.len());
    let mut halves = Halves::new(problem, state);
    for group in groups(&stretches, &problem.segments, STRETCHES_TOGETHER) {
        let equations = linearised(problem, state, &bearings, group);
        contributions_with_board.extend(follows.contributions(&equations));
        if let Some(halves) = &mut halves {
            halves.add(&equations);
        }
    }
    let halves = halves.and_then(|halves| halves.solved());
    let times: Vec<(usize, f64)> =
        stretches.iter().map(|stretch| (stretch.segment, stretch.start(&problem.segments))).collect();
    let total: f64 = state.trajectories.iter().map(|trajectory| trajectory.end() - trajectory.start()).sum();
    let time = Time { starts: &times, total };
    let of_free = |one: Contribution| one.of(&places);
    let (stated, inflation, blocks) = stated(&formal, &contributions_with_board, &of_free, time, first_count(&free));
    let board = formal_with_board
        .zip(step_with_board)
        .map(|(formal, step)| board_evidence(problem, state, &formal, &step, &contributions_with_board, time));
    drop(contributions_with_board);

    let count = state.camera.parameters().len();
    // What all parts of the recording have in common, as a share of the formal covariance and as an error of the focal lengths.
    let noise = intrinsics_of(&formal, &free, count);
    let (common, systematic_scale) = if problem.segments.iter().all(|segment| segment.events.is_empty()) {
        (0.0, 0.0)
    } else {
        let common = common_share(problem, state, &noise, observations, MODEL_ERROR * latency_shift);
        let half_diagonal = 0.5 * f64::from(problem.sensor.width).hypot(f64::from(problem.sensor.height));
        (common, SYSTEMATIC_SCALE.max(LATENCY_SCALE * latency_shift / half_diagonal.max(1.0)))
    };
    let focal_lengths = std::array::from_fn(|axis| if free[axis] { state.camera.parameters()[axis] } else { 0.0 });
    let of_model = &noise * common;
    let scale = scale_error(&of_model, focal_lengths, systematic_scale);
    let stated_intrinsics = intrinsics_of(&stated, &free, count);
    let parts = CovarianceParts {
        between_parts: &stated_intrinsics - &noise,
        noise,
        focal_lengths: &scale * scale.transpose(),
        event_model: of_model,
    };
    let systematic = &parts.event_model + &parts.focal_lengths;
    let covariance = stated_intrinsics + &systematic;

    // The poses follow the camera: what moves it moves them.
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
        *sigma = (stated[(place, place)] + common * formal[(place, place)]).max(0.0).sqrt();
    }
    if problem.free.board[RADIUS] {
        board_sigma[RADIUS] = libm::hypot(board_sigma[RADIUS], SYSTEMATIC_RADIUS * problem.mean_scale);
    }
    let intrinsics = Uncertainty { covariance, systematic, systematic_scale, inflation, observations, blocks };
    Ok(SolveUncertainty { intrinsics, parts, board_sigma, board, bias_sigma, poses, formal, halves })
}

/// When observations were made.
#[derive(Clone, Copy, Debug)]
pub struct Time<'a> {
    /// Where stretches of them begin: segment, and seconds.
    pub starts: &'a [(usize, f64)],
    /// How long all trajectories are (s).
    pub total: f64,
}

/// How many of the parameters that are `free` are intrinsics or the board's, which come first.
fn first_count(free: &[bool; GLOBAL_COUNT]) -> usize {
    free.iter().take(BOARD_INDEX + BOARD_PARAMETERS).filter(|&&free| free).count()
}

/// The stated covariance of the `first` parameters from what `part` makes of what each block of time says, its inflation, and the
/// number of blocks behind it; `formal` is the inverse of the whole information, `contributions` what stretches of observations say.
pub fn stated(
    formal: &DMatrix<f64>,
    contributions: &[PackedContribution],
    part: &dyn Fn(Contribution) -> Contribution,
    time: Time,
    first: usize,
) -> (DMatrix<f64>, f64, usize) {
    let longest = time.total / FEWEST_BLOCKS;
    let formal_first = formal.view((0, 0), (first, first)).into_owned();
    let lengths = BLOCK_LENGTHS.map(|factor| (factor * BLOCK).min(longest));
    let of_length = |length: f64| {
        // One at a time: all of them would be as large as the contributions.
        scatter(formal, sum_by_block(time.starts, contributions, length).map(part), first)
    };
    let (stated, inflation, blocks) = combined(&formal_first, lengths.into_iter().filter_map(of_length));
    let long = LONG_PARTS.map(|share| share * time.total).into_iter().filter(|&length| length > lengths[LAST_LENGTH]);
    let drift = long.filter_map(of_length).map(|scatter| lower_end(&scatter, first)).fold(inflation, f64::max);
    (stated * (drift / inflation), drift, blocks)
}

/// What the observations say of the board, with the `formal` covariance and the step of all parameters when it may change too.
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
    let (stated, ..) = self::stated(formal, contributions, &there, time, first);
    let board = parameters.board.iter().filter(|&&free| free).count();
    let variances: Vec<f64> = stated.diagonal().iter().skip(first - board).copied().collect();
    let radius_error = SYSTEMATIC_RADIUS * problem.mean_scale;
    BoardEvidence::new(state, step, parameters.board, variances.into_iter(), radius_error)
}

/// What the model of events gets wrong, as a share of the `formal` covariance of the intrinsics; `model_error` is what it moves the
/// projection for each unit of leverage (px rms, σ).
fn common_share(problem: &Problem, state: &State, formal: &DMatrix<f64>, observations: usize, model_error: f64) -> f64 {
    match projection_uncertainty(&state.camera, formal, problem.sensor) {
        // A projection error of `model_error` times the leverage N rms² / s².
        Ok(ProjectionUncertainty { rms, .. }) => {
            (model_error * observations as f64 * rms / spread_squared(problem, state)).powi(2)
        }
        Err(NoView) => 1.0,
    }
}

/// How far the latencies of event classes move events apart (px, root mean square over all events), from each class's latency (s) and the
/// sums over its events of their weights, and of their weights times the squares of the edges' speeds (px²/s²). The latency that all have in
/// common, in the mean over these squares, moves none: it is a shift of the clock.
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

/// The square of the spread that weighs the events of `problem` (px²), the harmonic mean over all of them.
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

/// The common error of both `focal_lengths`, the first intrinsics, that keeps their σ from being below this `share` of them; it is to be
/// added to `covariance`.
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
        // Of 0.3 px and 0.4 px, 0.15 px and 0.2 px are stated already.
        assert!((after[(0, 0)] - 0.09).abs() < 1e-12 && (after[(1, 1)] - 0.16).abs() < 1e-12, "{after}");
        assert_eq!(with_scale_error(after.clone(), 9e-4), after);
        let difference = after - before;
        // Their ratio is as well known as before.
        let ratio = DVector::from_column_slice(&[1.0 / 300.0, -1.0 / 400.0, 0.0, 0.0]);
        assert!((&difference * &ratio).norm() < 1e-12, "{difference}");
        assert_eq!(difference.view((2, 2), (2, 2)).norm(), 0.0);
    }

    #[test]
    fn only_differences_between_latencies_move_events_apart() {
        // As many events of either class, on edges of 500 px/s.
        let sums = [2.0, 2.0 * 250_000.0];
        let shift = |latencies: [f64; 2]| latency_shift(latencies.map(|latency| (latency, sums)).into_iter());
        // Half a millisecond away from the middle of both.
        assert!((shift([0.0, 1e-3]) - 0.25).abs() < 1e-12);
        assert!((shift([7e-3, 8e-3]) - 0.25).abs() < 1e-9);
        assert!(shift([3e-3, 3e-3]) < 1e-6);
        // Where nothing moves, no latency shows.
        assert_eq!(latency_shift([(0.0, [2.0, 0.0]), (1e-3, [2.0, 0.0])].into_iter()), 0.0);
    }

    #[test]
    fn the_largest_scatter_tells_the_size_and_all_of_them_the_shape() {
        let formal = DMatrix::from_diagonal_element(2, 2, 1.0);
        let of = |x: f64, y: f64, blocks: usize| Scatter {
            covariance: DMatrix::from_diagonal(&nalgebra::DVector::from_column_slice(&[x, y])),
            inflation: 0.5 * (x + y),
            blocks,
        };
        let (stated, inflation, blocks) = combined(&formal, [of(1.0, 3.0, 9), of(6.0, 2.0, 5)].into_iter());
        assert_eq!((inflation, blocks), (4.0, 5));
        // The mean shape is (0.5 + 1.5, 1.5 + 0.5) / 2: even, as the formal one.
        assert!((&stated - DMatrix::from_diagonal_element(2, 2, 4.0)).norm() < 1e-12, "{stated}");
        let (stated, ..) = combined(&formal, std::iter::once(of(6.0, 2.0, 5)));
        assert!((stated[(0, 0)] - 4.0 * (0.75 * 1.5 + 0.25)).abs() < 1e-12, "{stated}");
    }

    #[test]
    fn few_blocks_count_by_the_lower_end_of_what_they_say() {
        let of = |blocks: usize| Scatter { covariance: DMatrix::zeros(0, 0), inflation: 6.0, blocks };
        assert!((lower_end(&of(3), 1) - 3.0).abs() < 1e-12);
        assert!(lower_end(&of(2), 9) < lower_end(&of(8), 9) && lower_end(&of(8), 9) < 6.0);
    }

    #[test]
    fn without_scatter_the_formal_covariance_is_stated() {
        let formal = DMatrix::from_diagonal_element(3, 3, 0.2);
        assert_eq!(combined(&formal, std::iter::empty()), (formal.clone(), 1.0, 0));
    }
}

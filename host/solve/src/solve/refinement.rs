//! Rounds of association and solve: each round associates the events again with the better model, until the camera settles
//! (section 11 of method.md).

use std::ops::ControlFlow;

use evcal_core::camera::refit::difference;
use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use evcal_core::settings;
use evcal_core::settings::at_least;
use serde::{Deserialize, Serialize};

use crate::solve::association::{AssociationContext, AssociationReport, AssociationSettings, Associator, Observed};
use crate::solve::event_sample::RankedEvent;
use crate::solve::knot_choice::{KnotReport, choose_knots};
use crate::solve::left_out::{LeftOut, leave_out};
use crate::solve::levenberg::{OF_CAMERA, Schedule, Solved, solve_with_progress};
use crate::solve::observation::SegmentObservations;
use crate::solve::observation_range::{EventResidual, residuals_and_scale, residuals_at};
use crate::solve::residual_statistics::{ResidualStatistics, residual_statistics};
use crate::solve::rows::bearing_table::BearingTable;
use crate::solve::rows::board_edge::BoardEdges;
use crate::solve::rows::event_bias::bias::{Bias, Biases};
use crate::solve::rows::event_bias::first_events::{common_delay, shift_clock};
use crate::solve::rows::event_bias::robust::{ClassResidual, class_spreads, common_spread, shift_offsets};
use crate::solve::rows::event_bias::{CLASS_COUNT, CLASSES_OF_LENGTH, EventBias, is_own_bias, is_shared_bias, unknown};
use crate::solve::unexplained::unexplained;
use crate::solve::{
    BOARD_PARAMETERS, FreeParameters, HUBER, ITERATIONS, Problem, ResidualMeasure, SolveError, SolveReport,
    SolveSettings, State,
};
use crate::trajectory::knot_grid::KnotSettings;
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_geometry::board::Board;
use evcal_geometry::board::shape::CircleArea;

settings! {
    /// The rounds of association and solve, and the biases of events that are fitted.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct RefinementSettings {
        /// Longest time with the board in the joint solve. From a longer recording, the seconds with the most information about
        /// the camera are taken, spread over the whole recording; along the others the trajectory is solved afterwards, with the
        /// camera fixed at the result.
        pub most_seconds: f64 = 45.0, "s", at_least(1.0);
        /// Fit an offset from the geometric edge for each event class, and its change with the edge's curvature.
        pub offsets: bool = true;
        /// Fit a latency for each event class, and its change with speed, position, size and acceleration of the edge.
        pub latencies: bool = true;
    }
}

/// Largest number of rounds.
const ROUNDS: usize = 6;

/// When a round changes the projection by less than this (px, rms over the sensor), the next round is the last. The value is above
/// the noise of the earlier rounds, which have few events.
const SETTLED: f64 = 0.2;

/// Largest number of events in the rounds before the last.
const EARLY_EVENTS: usize = 250_000;

/// The knots of the last round are chosen from every second event. With every fourth event, trajectories would be smoother, and their
/// error in 20 s of fast motion 4 % larger.
const KNOTS: usize = 2;

/// In the last round, a solve with every n-th event precedes the solve with all events, because it leads most of the way to the
/// solution at a fraction of the cost. This is n.
const COARSE: usize = 4;

/// If another solve with more events follows, a solve ends at a step that is predicted to lower the cost by less than this share.
const OF_EARLY: Schedule = Schedule { trusted: 1e-3, ..OF_CAMERA };

/// Assumed spread of the events until it is known (px).
pub const FIRST_SIGMA: f64 = 0.5;

/// Fewest events for a class to have biases of its own.
const FEWEST_OF_CLASS: usize = 500;

/// Spread of the points that hold a trajectory in the first round (px). Its knots are dense and its stiffness is not known yet, so
/// where few edges cross the motion, events alone would let it slide along them, to edges of other squares.
const ANCHOR_SIGMA: f64 = 1.0;

/// Smallest spread of circle centres (px) in the joint solve; without it, circles without noise would have an infinite weight.
pub const SMALLEST_POINT_SIGMA: f64 = 0.02;

/// Statistics of one round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RoundReport {
    /// Association of this round.
    pub association: AssociationReport,
    /// Knots of this round; `None` in the first one, whose knots are even.
    pub knots: Option<KnotReport>,
    /// Solve of this round.
    pub solve: SolveReport,
    /// Root mean square change of the projection over the sensor (px) by this round; `None` if the cameras before and after the
    /// round have no common pixel to compare.
    pub change: Option<f64>,
}

/// Passes an even sample of the events of one recording to a visitor, in batches in time order. The arguments are the index of the
/// recording and the share of its events in the sample (0 to 1). Times count from the start of the recording.
pub type ReadRecording<'a, E> = dyn Fn(usize, f64, &mut dyn FnMut(&[RankedEvent])) -> Result<(), E> + Sync + 'a;

/// The events of all recordings.
pub struct EventInput<'a, E> {
    /// Number of events in each recording.
    pub counts: &'a [u64],
    /// Reads a recording.
    pub read: &'a ReadRecording<'a, E>,
}

/// Input of the refinement.
pub struct RefinementInput<'a, E> {
    /// The board.
    pub board: &'a Board,
    /// Sensor size (width, height) in pixels.
    pub sensor: Sensor,
    /// The events; `None` if the input consists of circle centres alone.
    pub events: Option<EventInput<'a, E>>,
    /// Circle centres of each trajectory, if the input contains circle tracks.
    pub points: Vec<Vec<PointObservation>>,
    /// Spread of a circle centre (px).
    pub point_sigma: f64,
    /// Points of the reference frames of each trajectory, which hold it in the first round.
    pub anchors: &'a [Vec<PointObservation>],
    /// Intervals that are already excluded when the refinement starts.
    pub left_out: &'a [LeftOut],
    /// Flags of the estimated parameters of the board; the others keep their start values.
    pub free_board: [bool; BOARD_PARAMETERS],
    /// Flags of the intrinsics that keep their start values.
    pub fixed: [bool; MAX_PARAMETERS],
}

/// All settings of association and joint solve (sections 8 to 11 of method.md).
#[derive(Clone, Copy)]
pub struct StageSettings<'a> {
    /// Rounds.
    pub refinement: &'a RefinementSettings,
    /// Knots.
    pub knots: &'a KnotSettings,
    /// Association.
    pub association: &'a AssociationSettings,
    /// Solve.
    pub solve: &'a SolveSettings,
}

/// Result of the refinement.
pub struct Refined {
    /// The final estimate.
    pub state: State,
    /// The problem of the last round with its observations.
    pub problem: Problem,
    /// Robust residual statistics of the last round.
    pub residuals: ResidualStatistics,
    /// Residuals of the events at the final estimate; cleared after the examination.
    pub events: Vec<EventResidual>,
    /// Excluded intervals: from the input, and intervals that no curve explains.
    pub left_out: Vec<LeftOut>,
    /// One report per round.
    pub rounds: Vec<RoundReport>,
}

impl Refined {
    /// Returns the estimate alone, so that another solve can start there without the memory of these observations.
    pub fn into_state(self) -> State {
        self.state
    }
}

/// Reasons why the refinement failed.
#[derive(Debug, thiserror::Error)]
pub enum RefinementError<E> {
    /// A recording could not be read again.
    #[error("{0}")]
    Read(#[source] E),
    /// The joint solve failed.
    #[error("{0}")]
    Solve(#[from] SolveError),
}

/// Progress of a round, 0 to 1, when its events are associated, when its solve begins, when the solve with few events
/// is done, and when its solve is done.
const ASSOCIATED: f64 = 0.3;
const READY: f64 = 0.35;
const COARSELY_SOLVED: f64 = 0.75;
const SOLVED: f64 = 0.95;

/// Alternates association and solve, starting at `state`. `progress` receives the number of the round, from 0 on, and
/// its progress, 0 to 1; if it returns an error, the refinement ends as soon as possible.
///
/// # Errors
/// [`RefinementError::Read`] if a recording cannot be read, or with the error of `progress`; [`RefinementError::Solve`] if the
/// observations do not determine the camera.
pub fn refine<E: Send>(
    input: &RefinementInput<E>,
    mut state: State,
    settings: StageSettings,
    mut progress: impl FnMut(usize, f64) -> Result<(), E>,
) -> Result<Refined, RefinementError<E>> {
    let mut rounds: Vec<RoundReport> = Vec::new();
    let mut kept_share = 1.0;
    state.bias = unknown(FIRST_SIGMA);
    // Circle centres are not associated again, so without events one round is enough.
    let total = if input.events.is_some() { ROUNDS } else { 1 };
    let count = input.events.as_ref().map_or(1, |events| events.counts.iter().sum::<u64>().max(1)) as f64;
    // Circle centres fix the clock of the trajectory. With events alone, a delay common to all classes equals a shift of the clock.
    let has_points = input.points.iter().any(|points| !points.is_empty());
    let mut last_early = false;
    loop {
        let round = rounds.len();
        let mut on_progress = |done| progress(round, done);
        on_progress(0.0).map_err(RefinementError::Read)?;
        let first = rounds.is_empty();
        // The last round uses all events that the settings allow. Earlier rounds only have to come near the solution, so they use
        // fewer.
        let final_round = last_early || rounds.len() + 1 == total;
        let wanted = if final_round { settings.association.most_events } else { EARLY_EVENTS };
        let share = (wanted as f64 / (count * kept_share)).min(1.0);
        let bearings = BearingTable::new(&state.camera, input.sensor);
        // An error of the callback is ignored here; the call after the association returns it.
        let mut associating = |done| _ = on_progress(ASSOCIATED * done);
        let Associated { segments, report: association, mut residuals, mut mean_scale } =
            associate_all(input, &state, &bearings, settings, !first, share, &mut associating)?;
        on_progress(ASSOCIATED).map_err(RefinementError::Read)?;
        kept_share = (association.kept as f64 / (association.events.max(1) as f64 * share)).clamp(1e-3, 1.0);
        let mut problem = problem(input, settings, segments, &state);
        if first && !has_points {
            hold(&mut problem, input.anchors);
        }
        if !input.left_out.is_empty() || problem.residual == ResidualMeasure::Plane {
            leave_out(&mut problem, &state, input.left_out);
            let (events, scale) = residuals_and_scale(&problem, &state, &bearings);
            (residuals, mean_scale) = (events.iter().map(EventResidual::of_class).collect(), scale);
        }
        problem.mean_scale = mean_scale.unwrap_or(problem.mean_scale);
        let counts = class_counts(&problem);
        state.bias = updated_bias(&state, residuals, settings);
        problem.free = free_parameters(&state.camera, &counts, settings);
        if !has_points {
            problem.free.biases[latency_reference(&counts)][Bias::Latency] = false;
        }
        let biases = &mut problem.free.biases;
        match problem.edges {
            // Rims have all directions, so a bend common to all classes cannot be distinguished from a change of the
            // trajectory. Therefore class 0 has no bend.
            BoardEdges::Rims(_) => biases[0][Bias::Bend] = false,
            BoardEdges::Lines(_) => biases.iter_mut().for_each(|biases| biases[Bias::Memory] = false),
        }
        problem.free.board = input.free_board;
        let intrinsics = problem.free.intrinsics.iter_mut().zip(input.fixed);
        intrinsics.for_each(|(free, fixed)| *free &= !fixed);
        let is_large = final_round && counts.iter().sum::<usize>() > EARLY_EVENTS;
        let mut knots = None;
        if !first {
            let fewer = is_large.then(|| problem.every(KNOTS));
            let choice = choose_knots(fewer.as_ref().unwrap_or(&problem), &state, settings.knots)?;
            (state.trajectories, problem.stiffness) = (choice.trajectories, choice.stiffness);
            knots = Some(choice.report);
        }
        let before = state.camera;
        on_progress(READY).map_err(RefinementError::Read)?;
        let mut schedule = if final_round { OF_CAMERA } else { OF_EARLY };
        let mut ready = READY;
        if is_large {
            let coarse = problem.every(COARSE);
            let solving = &mut |done| flow(on_progress(READY + (COARSELY_SOLVED - READY) * done));
            let Solved { estimate, damping, .. } = solve_with_progress(&coarse, state, OF_EARLY, solving)?;
            (state, ready, schedule.first) = (estimate, COARSELY_SOLVED, damping);
        }
        let solving = &mut |done| flow(on_progress(ready + (SOLVED - ready) * done));
        let Solved { estimate: solved, report: solve_report, .. } =
            solve_with_progress(&problem, state, schedule, solving)?;
        on_progress(SOLVED).map_err(RefinementError::Read)?;
        state = solved;
        let moved = difference(&before, &state.camera, input.sensor);
        let change = (moved.compared > 0).then_some(moved.root_mean_square);
        rounds.push(RoundReport { association, knots, solve: solve_report, change });
        if final_round {
            let mut events = residuals_at(&problem, &state);
            let (unexplained, mut residuals) = rayon::join(
                || unexplained(&problem, &state, &events),
                || residual_statistics(&problem, &state, &events),
            );
            let delay = (!has_points && knows_latencies(settings)).then(|| common_delay(&state.bias, &events));
            if !unexplained.is_empty() {
                drop(events);
                leave_out(&mut problem, &state, &unexplained);
                let solving = &mut |done| flow(on_progress(SOLVED + (1.0 - SOLVED) * done));
                state = solve_with_progress(&problem, state, schedule, solving)?.estimate;
                on_progress(1.0).map_err(RefinementError::Read)?;
                events = residuals_at(&problem, &state);
                residuals = residual_statistics(&problem, &state, &events);
            }
            if let Some(delay) = delay {
                shift_clock(&mut state.bias, &mut state.trajectories, delay);
            }
            let left_out = input.left_out.iter().chain(&unexplained).copied().collect();
            return Ok(Refined { state, problem, residuals, events, left_out, rounds });
        }
        last_early = change.is_some_and(|change| change < SETTLED);
    }
}

/// Converts the answer of the progress callback: an error ends the solve.
fn flow<E>(answer: Result<(), E>) -> ControlFlow<()> {
    if answer.is_ok() { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
}

/// The events of all recordings as observations.
pub(super) struct Associated {
    /// The observations of each trajectory.
    pub(super) segments: Vec<SegmentObservations>,
    /// Counts of kept and dropped events.
    pub(super) report: AssociationReport,
    /// The residuals of the events.
    pub(super) residuals: Vec<ClassResidual>,
    /// The mean of the metres on the board per pixel across the edge; `None` without events.
    pub(super) mean_scale: Option<f64>,
}

/// Associates a `share` of 0 to 1 of the events of each recording. `on_progress` gets the share that was processed, 0 to 1.
pub(super) fn associate_all<E: Send>(
    input: &RefinementInput<E>,
    state: &State,
    bearings: &BearingTable,
    settings: StageSettings,
    sigma_known: bool,
    share: f64,
    on_progress: &mut dyn FnMut(f64),
) -> Result<Associated, RefinementError<E>> {
    let mut segments = vec![SegmentObservations::default(); state.trajectories.len()];
    let mut report = AssociationReport::default();
    let (mut residuals, mut scale_sum) = (Vec::new(), 0.0);
    let (mut seen, total) = (0, input.events.as_ref().map_or(0, |events| events.counts.iter().sum::<u64>()));
    for (recording, &count, events) in input
        .events
        .iter()
        .flat_map(|events| events.counts.iter().enumerate().map(move |(one, count)| (one, count, events)))
    {
        let context =
            AssociationContext { state, bearings, board: input.board, sigma_known, settings: settings.association };
        let mut associator = Associator::new(context, recording);
        let take = &mut |batch: &[RankedEvent]| {
            associator.push(batch);
            seen += batch.len();
            on_progress((seen as f64 / (total as f64 * share)).min(1.0));
        };
        (events.read)(recording, share, take).map_err(RefinementError::Read)?;
        let Observed { segments: found, residuals: of_events, scales, report: part } = associator.finish();
        residuals.extend(of_events);
        scale_sum += scales;
        report.add(&AssociationReport { events: count, thinned: count.saturating_sub(part.events), ..part });
        for (index, observations) in found {
            if let Some(segment) = segments.get_mut(index) {
                *segment = observations;
            }
        }
    }
    for (segment, points) in segments.iter_mut().zip(&input.points) {
        segment.points.clone_from(points);
    }
    let mean_scale = (!residuals.is_empty()).then(|| scale_sum / residuals.len() as f64);
    Ok(Associated { segments, report, residuals, mean_scale })
}

pub(super) fn problem<E>(
    input: &RefinementInput<E>,
    settings: StageSettings,
    segments: Vec<SegmentObservations>,
    state: &State,
) -> Problem {
    Problem {
        sensor: input.sensor,
        points: (0..input.board.point_count()).map(|index| input.board.point(index).into()).collect(),
        edges: BoardEdges::of_board(input.board),
        area: CircleArea::new(input.board),
        mean_scale: 1.0,
        point_sigma: input.point_sigma,
        associated_latencies: state.bias.map(|bias| bias.biases[Bias::Latency]),
        segments,
        stiffness: Vec::new(),
        free: FreeParameters {
            intrinsics: [false; MAX_PARAMETERS],
            board: [false; BOARD_PARAMETERS],
            biases: [Biases::default(); CLASS_COUNT],
        },
        residual: settings.solve.residual,
        huber: HUBER,
        iterations: ITERATIONS,
    }
}

/// Adds the points that hold the trajectories in the first round.
pub(super) fn hold(problem: &mut Problem, anchors: &[Vec<PointObservation>]) {
    problem.point_sigma = ANCHOR_SIGMA;
    for (segment, points) in problem.segments.iter_mut().zip(anchors) {
        segment.points.clone_from(points);
    }
}

/// Returns the biases with the spread of each class, and the start value of its offset, from the residuals at `state`.
fn updated_bias(state: &State, mut residuals: Vec<ClassResidual>, settings: StageSettings) -> EventBias {
    let mut bias = state.bias;
    // The paper's residual has no offsets.
    if settings.refinement.offsets && settings.solve.residual == ResidualMeasure::Pixel {
        shift_offsets(&mut bias, &mut residuals);
        class_spreads(&mut bias, &residuals);
    } else {
        common_spread(&mut bias, &residuals);
    }
    bias
}

/// Returns the number of events of each class.
fn class_counts(problem: &Problem) -> [usize; CLASS_COUNT] {
    let mut counts = [0; CLASS_COUNT];
    for event in problem.segments.iter().flat_map(|segment| &segment.events) {
        if let Some(count) = counts.get_mut(usize::from(event.class)) {
            *count += 1;
        }
    }
    counts
}

/// Returns `true` if latencies are estimated: the setting is on, and the residual is not the paper's, which has no biases.
fn knows_latencies(settings: StageSettings) -> bool {
    settings.refinement.latencies && settings.solve.residual == ResidualMeasure::Pixel
}

/// Returns the class whose latency is fixed during a solve without circle centres, because a delay common to all classes equals a
/// shift of the clock. It is the largest class of first OFF events, which determines the time best. After the last round,
/// [`shift_clock`] moves the zero to the mean of all first OFF events.
fn latency_reference(counts: &[usize; CLASS_COUNT]) -> usize {
    let first_off = (0..CLASS_COUNT).step_by(CLASSES_OF_LENGTH);
    first_off.rev().max_by_key(|&class| counts[class]).unwrap_or(0)
}

/// Returns the parameters that are estimated, given the number of events of each class.
fn free_parameters(camera: &Camera<f64>, counts: &[usize; CLASS_COUNT], settings: StageSettings) -> FreeParameters {
    let biases = match settings.solve.residual {
        ResidualMeasure::Pixel => free_biases(counts, settings.refinement),
        ResidualMeasure::Plane => Default::default(),
    };
    let intrinsics = std::array::from_fn(|index| index < camera.parameters().len());
    FreeParameters { intrinsics, board: [false; BOARD_PARAMETERS], biases }
}

/// Returns the biases that are estimated, given the number of events of each class: classes with hardly any events keep theirs.
fn free_biases(counts: &[usize; CLASS_COUNT], settings: &RefinementSettings) -> [Biases<bool>; CLASS_COUNT] {
    // Sums over the classes that share biases.
    let mut together = [0; CLASSES_OF_LENGTH];
    for (class, count) in counts.iter().enumerate() {
        together[class % CLASSES_OF_LENGTH] += count;
    }
    std::array::from_fn(|class| {
        let wanted = |bias: Bias| if bias.needs_motion() { settings.latencies } else { settings.offsets };
        Biases::from_fn(|bias| {
            let count = if is_shared_bias(bias) { together[class % CLASSES_OF_LENGTH] } else { counts[class] };
            count >= FEWEST_OF_CLASS && wanted(bias) && is_own_bias(class, bias)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn biases_shared_by_all_lengths_belong_to_long_bursts() {
        let settings = RefinementSettings::default();
        let [long, three] = [0, 2 * CLASSES_OF_LENGTH];
        let mut counts = [FEWEST_OF_CLASS; CLASS_COUNT];
        counts[three] += 1;
        assert_eq!(latency_reference(&counts), three);
        counts[three + 1] += 2;
        assert_eq!(latency_reference(&counts), three, "the second OFF event is not a first one");
        counts[..three].fill(0);
        let free = free_biases(&counts, &settings);
        assert!(free[three][Bias::Latency] && free[three][Bias::Offset]);
        assert!(free[long][Bias::Curvature] && !free[long][Bias::Offset] && !free[long][Bias::Latency]);
        assert!(free[long + 1][Bias::Bend] && free[long][Bias::Bend]);

        let none = free_biases(&[0; CLASS_COUNT], &settings);
        assert_eq!(none, [Biases::default(); CLASS_COUNT]);
    }
}

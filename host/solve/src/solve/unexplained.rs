//! Intervals of a trajectory that the events contradict.
//!
//! If no curve follows the motion, the events scatter more about the curve than at other times, or most events near the board are
//! too far from any edge to be associated. Both are checked in short cells of time.

use rayon::prelude::*;

use super::Problem;
use super::State;
use super::left_out::{LeftOut, Reason};
use super::observation::SegmentObservations;
use super::observation_range::EventResidual;
use crate::trajectory::Trajectory;
use evcal_geometry::numerics::statistics::median;

/// Length of the cells of time (s).
const CELL: f64 = 0.01;
/// Largest median residual in a cell, in units of the median that the class's spread predicts.
const SPREAD: f64 = 1.7;
/// Ratio of events too far from every edge to events near an edge above which a cell is unexplained, if they are also unusually
/// many.
const FAR_RATIO: f64 = 1.0;
/// Cells with fewer events are not checked by their spread.
const FEWEST: usize = 30;
/// Fewest neighbouring cells: one cell alone may be chance, or the first moment of a recording.
const FEWEST_CELLS: usize = 2;
/// Median size of a standard normal deviate.
const NORMAL_MEDIAN: f64 = 0.6745;
/// A cell has unusually many events far from every edge if it has more than this multiple of their median.
const UNUSUAL: f64 = 4.0;

/// Finds the unexplained intervals of the trajectories of `state`, in order of segment and time; `residuals` belong to its
/// events.
pub fn unexplained(problem: &Problem, state: &State, residuals: &[EventResidual]) -> Vec<LeftOut> {
    let segments = problem.segments.par_iter().zip(&state.trajectories).enumerate();
    let of_segments: Vec<Vec<LeftOut>> = segments
        .map(|(segment, (observations, trajectory))| {
            let place = |segment: usize| residuals.partition_point(|event| (event.segment as usize) < segment);
            let residuals = residuals.get(place(segment)..place(segment + 1)).unwrap_or_default();
            unexplained_cells(state, trajectory, observations, residuals)
        })
        .collect();
    let mut found: Vec<(LeftOut, usize)> = Vec::new();
    for range in of_segments.into_iter().flatten() {
        let adjoins = |last: &LeftOut| last.recording == range.recording && last.end >= range.start;
        match found.last_mut().filter(|(last, _)| adjoins(last)) {
            Some((last, cells)) => {
                last.end = range.end;
                *cells += 1;
            }
            None => found.push((range, 1)),
        }
    }
    found.into_iter().filter(|(_, cells)| *cells >= FEWEST_CELLS).map(|(range, _)| range).collect()
}

/// Finds the unexplained cells of one segment, each with its neighbours.
fn unexplained_cells(
    state: &State,
    trajectory: &Trajectory,
    observations: &SegmentObservations,
    residuals: &[EventResidual],
) -> Vec<LeftOut> {
    let cells = ((trajectory.end() - trajectory.start()) / CELL).ceil().max(0.0) as usize;
    let cell_of = |t: f64| ((t - trajectory.start()) / CELL).max(0.0) as usize;
    let mut sizes: Vec<Vec<f32>> = vec![Vec::new(); cells];
    for event in residuals {
        let sigma =
            state.bias.get(usize::from(event.class)).and_then(|bias| bias.sigma.get(usize::from(event.speed_range)));
        if let (Some(cell), Some(sigma)) = (sizes.get_mut(cell_of(event.t)), sigma) {
            cell.push(event.residual.abs() / *sigma as f32);
        }
    }
    let far = far_counts(observations, cells, cell_of);
    let mut counts: Vec<f64> = far.iter().map(|&count| f64::from(count)).collect();
    let usual = median(&mut counts, f64::total_cmp).unwrap_or(0.0);
    let mut found = Vec::new();
    for (cell, (sizes, far)) in sizes.iter_mut().zip(&far).enumerate() {
        let (near, far) = (sizes.len(), f64::from(*far));
        let is_scattered = near >= FEWEST
            && median(sizes, f32::total_cmp).is_some_and(|middle| f64::from(middle) > SPREAD * NORMAL_MEDIAN);
        let is_far_from_edges = far >= FEWEST as f64 && far > FAR_RATIO * near as f64 && far > UNUSUAL * usual;
        if !is_scattered && !is_far_from_edges {
            continue;
        }
        // One more cell on both sides, because a curve that misses in one cell is also wrong in the next.
        let start = trajectory.start() + CELL * (cell as f64 - 1.0);
        found.push(LeftOut {
            recording: trajectory.recording,
            start: start.max(trajectory.start()),
            end: (start + 3.0 * CELL).min(trajectory.end()),
            reason: Reason::Unexplained,
        });
    }
    found
}

fn far_counts(observations: &SegmentObservations, cells: usize, cell_of: impl Fn(f64) -> usize) -> Vec<u32> {
    let mut counts = vec![0; cells];
    for &t in &observations.far {
        if let Some(count) = counts.get_mut(cell_of(f64::from(t))) {
            *count += 1;
        }
    }
    counts
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
    use evcal_core::sensor::Sensor;
    use nalgebra::{UnitQuaternion, Vector3};

    use super::*;
    use crate::solve::left_out::{covers, leave_out};
    use crate::solve::observation::EventBin;
    use crate::solve::rows::board_edge::BoardEdges;
    use crate::solve::rows::event_bias::bias::Biases;
    use crate::solve::rows::event_bias::{CLASS_COUNT, unknown};
    use crate::solve::{BOARD_PARAMETERS, FreeParameters, HUBER, ITERATIONS, ResidualMeasure};
    use crate::trajectory::{RotationControl, Trajectory};
    use evcal_geometry::board::shape::{BoardShape, CircleArea};

    fn problem(bins: usize) -> (Problem, State) {
        let trajectory = Trajectory {
            recording: 0,
            knots: vec![0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0],
            degree: 3,
            translation: vec![Vector3::zeros(); 4],
            rotation: RotationControl::So3(vec![UnitQuaternion::identity(); 4]),
        };
        let camera =
            Camera::from_parameters(ModelKind::Radtan4, &[330.0, 330.0, 173.0, 130.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let of_bins = (0..bins).map(|bin| EventBin { t: (bin as f64 + 0.5) / bins as f64, first: 0, end: 0 });
        let problem = Problem {
            sensor: Sensor::new(346, 260),
            points: Vec::new(),
            edges: BoardEdges::Rims(Vec::new()),
            area: CircleArea { middle: [0.1; 2], half: [0.1; 2] },
            mean_scale: 1.0,
            point_sigma: 1.0,
            associated_latencies: [0.0; CLASS_COUNT],
            segments: vec![SegmentObservations { bins: of_bins.collect(), ..SegmentObservations::default() }],
            stiffness: Vec::new(),
            free: FreeParameters {
                intrinsics: [false; MAX_PARAMETERS],
                board: [false; BOARD_PARAMETERS],
                biases: [Biases::default(); CLASS_COUNT],
            },
            residual: ResidualMeasure::Pixel,
            huber: HUBER,
            iterations: ITERATIONS,
        };
        let board = BoardShape { print_ratio: 1.0, bend: [0.0; 2], radius: 0.01 };
        (problem, State { camera, board, bias: unknown(0.2), trajectories: vec![trajectory] })
    }

    /// A hundred residuals in each cell of 10 ms, evenly between 0 and a size that depends on the time.
    fn spread(largest: impl Fn(f64) -> f32) -> Vec<EventResidual> {
        (0..10_000)
            .map(|index| {
                let t = (f64::from(index) + 0.5) / 10_000.0;
                let residual = largest(t) * (index % 100) as f32 / 100.0;
                EventResidual { t, residual, ..EventResidual::default() }
            })
            .collect()
    }

    #[test]
    fn an_interval_with_large_residuals_is_found_and_excluded() {
        let (mut problem, state) = problem(100);
        let is_scattered = |t: f64| (0.4..0.5).contains(&t);
        let found = unexplained(&problem, &state, &spread(|t| if is_scattered(t) { 0.6 } else { 0.3 }));
        assert_eq!(found.len(), 1, "{found:?}");
        assert!((found[0].start - 0.39).abs() < 1e-9 && (found[0].end - 0.51).abs() < 1e-9, "{found:?}");
        leave_out(&mut problem, &state, &found);
        assert_eq!(problem.segments[0].bins.len(), 88);
        assert!(unexplained(&problem, &state, &spread(|_| 0.3)).is_empty());
    }

    #[test]
    fn an_interval_whose_events_are_far_from_every_edge_is_found() {
        let (mut problem, state) = problem(100);
        problem.segments[0].far = (0..2000).map(|index| 0.7 + 0.05 * index as f32 / 2000.0).collect();
        let found = unexplained(&problem, &state, &spread(|_| 0.3));
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(covers(&found, 0, 0.72) && !covers(&found, 0, 0.6) && !covers(&found, 1, 0.72));
    }
}

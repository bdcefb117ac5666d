//! Linearisation of the observations in an interval of one segment.

use std::ops::Range;

use nalgebra::Vector2;
use rayon::prelude::*;

use super::Problem;
use super::SolveError;
use super::State;
use super::observation::{EventObservation, SegmentObservations};
use crate::solve::equations::band::Band;
use crate::solve::equations::border::Columns;
use crate::solve::equations::normal::Equations;
use crate::solve::equations::pose_products::PoseProducts;
use crate::solve::rows::bearing_table::BearingTable;
use crate::solve::rows::edge_batch::{BatchEvent, EdgeBatch, LANES};
use crate::solve::rows::event_bias::bias::Bias;
use crate::solve::rows::event_bias::robust::ClassResidual;
use crate::solve::rows::event_bias::{CLASS_COUNT, SPEED_RANGE_COUNT};
use crate::solve::rows::event_row::ROW_RESIDUAL;
use crate::solve::rows::loss::Loss;
use crate::solve::rows::point_row::point_rows;
use crate::solve::rows::pose_bin::PoseBin;
use crate::solve::rows::row_batch::RowBatch;
use crate::solve::rows::row_products::{RowProducts, single};
use evcal_detection::circles::reference_frame::PointObservation;
use evcal_geometry::numerics::huber::huber;

/// Consecutive bins (and circle centres) of one segment, few enough to be a unit of work.
#[derive(Clone, Debug, PartialEq)]
pub struct ObservationRange {
    /// Index of the segment.
    pub segment: usize,
    /// Indices in [`SegmentObservations::bins`].
    pub bins: Range<usize>,
    /// Indices in [`SegmentObservations::points`].
    pub points: Range<usize>,
}

impl ObservationRange {
    /// Returns the time of the first observation in seconds; 0 without any.
    pub fn start(&self, segments: &[SegmentObservations]) -> f64 {
        let observations = segments.get(self.segment);
        let bin = observations.and_then(|segment| segment.bins.get(self.bins.clone())?.first());
        let point = observations.and_then(|segment| segment.points.get(self.points.clone())?.first());
        bin.map(|bin| bin.t).or(point.map(|point| point.t)).unwrap_or(0.0)
    }
}

/// Numbers of bins and of points in an interval: enough that merging costs little, few enough to share among threads.
const RANGE_BINS: usize = 128;
const RANGE_POINTS: usize = 512;
/// Number of intervals whose results are in memory at one time.
pub const RANGES_TOGETHER: usize = 64;
/// The same for residuals, which need more memory: an interval has tens of thousands of them.
const RESIDUALS_TOGETHER: usize = 16;

/// Cuts all segments into intervals.
pub fn observation_ranges(segments: &[SegmentObservations]) -> Vec<ObservationRange> {
    let mut ranges = Vec::new();
    for (segment, observations) in segments.iter().enumerate() {
        for first in (0..observations.bins.len()).step_by(RANGE_BINS) {
            let bins = first..(first + RANGE_BINS).min(observations.bins.len());
            ranges.push(ObservationRange { segment, bins, points: 0..0 });
        }
        for first in (0..observations.points.len()).step_by(RANGE_POINTS) {
            let points = first..(first + RANGE_POINTS).min(observations.points.len());
            ranges.push(ObservationRange { segment, bins: 0..0, points });
        }
    }
    ranges
}

/// Computes the normal equations of `range` at `state`.
///
/// # Errors
/// [`SolveError::OutOfBand`] if the state has no trajectory for these observations.
pub fn linearise(
    problem: &Problem,
    state: &State,
    bearings: &BearingTable,
    range: &ObservationRange,
    columns: &Columns,
) -> Result<Equations, SolveError> {
    let observations = problem.segments.get(range.segment).ok_or(SolveError::OutOfBand)?;
    let trajectory = state.trajectories.get(range.segment).ok_or(SolveError::OutOfBand)?;
    let bins = observations.bins.get(range.bins.clone()).unwrap_or_default();
    let points = observations.points.get(range.points.clone()).unwrap_or_default();
    let times = bins.iter().map(|bin| bin.t).chain(points.iter().map(|point| point.t));
    let order = trajectory.degree + 1;
    // Observations need not be in order of time.
    let first_points = times.filter_map(|t| trajectory.first_point(t));
    let span = first_points.fold(None, |span: Option<(usize, usize)>, first| {
        let (least, most) = span.unwrap_or((first, first));
        Some((least.min(first), most.max(first)))
    });
    let (first, count) = span.map_or((0, 0), |(least, most)| (least, most + order - least));
    let band = Band::new(first, count, order, columns.width());
    let mut equations = Equations::new(range.segment, range.start(&problem.segments), columns.range(), band);
    let mut sums = BinSums::default();
    let mut products = PoseProducts::new(columns.width());
    let mut expand = |pose: &PoseBin, sums: &mut RowProducts| {
        if sums.is_touched {
            products.take(sums, columns);
            equations.band.add(pose, &products)?;
            sums.clear_pose();
        }
        Ok(())
    };
    for bin in bins {
        let Some(pose) = PoseBin::new(trajectory, bin.t) else { continue };
        let events = observations.events.get(bin.first..bin.end).unwrap_or_default();
        sums.add_events(problem, state, bearings, &pose, events);
        expand(&pose, &mut sums.products)?;
    }
    for point in points {
        let Some(pose) = PoseBin::new(trajectory, point.t) else { continue };
        sums.add_point(problem, state, &pose, point);
        expand(&pose, &mut sums.products)?;
    }
    equations.add_globals(&sums.products, columns);
    equations.loss = sums.loss;
    Ok(equations)
}

/// Products of the rows of observations that share a pose, and of all rows of an interval.
#[derive(Default)]
pub struct BinSums<'a> {
    /// The products.
    pub products: RowProducts,
    /// Loss of all observations.
    pub loss: Loss,
    batch: EdgeBatch<'a>,
    rows: RowBatch,
}

impl<'a> BinSums<'a> {
    /// Adds the events of a bin with this `pose`.
    #[inline(always)]
    pub fn add_events(
        &mut self,
        problem: &Problem,
        state: &State,
        bearings: &'a BearingTable,
        pose: &PoseBin,
        events: &[EventObservation],
    ) {
        for part in events.chunks(LANES) {
            find_edges(problem, state, bearings, pose, part, &mut self.batch);
            for (lane, event) in part.iter().enumerate() {
                let bias = &state.bias[class_of(event)];
                let range = usize::from(event.speed_range).min(SPEED_RANGE_COUNT - 1);
                self.rows.set_class(lane, bias, bias.sigma[range]);
            }
            self.rows.weigh(self.batch.edges(), problem.huber, problem.residual_scale(), part.len());
            let classes = part.iter().map(|event| class_of(event) as u8);
            self.loss.add(&self.rows.collect(self.batch.cells(), classes));
            let (rows, classes) = self.rows.rows();
            self.products.add(rows, classes);
        }
    }

    /// Adds a circle centre that was seen from this `pose`, if the model can project it.
    pub fn add_point(&mut self, problem: &Problem, state: &State, pose: &PoseBin, point: &PointObservation) {
        let inverse_sigma = 1.0 / problem.point_sigma;
        let Some(&center) = problem.points.get(point.circle) else { return };
        let rows = point_rows(&state.camera, &problem.area, &state.board, pose, center, point.pixel);
        let Some(rows) = rows else { return };
        let error = rows[0][ROW_RESIDUAL].hypot(rows[1][ROW_RESIDUAL]) * inverse_sigma;
        let (cost, root_weight) = huber(error, problem.huber);
        let weighed = rows.map(|row| row.map(|value| single(value * root_weight * inverse_sigma)));
        self.loss.add_observation(cost, root_weight * root_weight);
        self.products.add_without_biases(&weighed);
    }
}

#[inline(always)]
fn class_of(event: &EventObservation) -> usize {
    usize::from(event.class).min(CLASS_COUNT - 1)
}

/// Finds the edges of at most [`LANES`] events of one bin.
#[inline(always)]
fn find_edges<'a>(
    problem: &Problem,
    state: &State,
    bearings: &'a BearingTable,
    pose: &PoseBin,
    events: &[EventObservation],
    batch: &mut EdgeBatch<'a>,
) {
    let batched = events.iter().map(|event| {
        let class = class_of(event);
        let later = problem.associated_latencies[class] - state.bias[class].biases[Bias::Latency];
        let pixel = [f64::from(event.x), f64::from(event.y)];
        BatchEvent { pixel, dt: f64::from(event.dt) + later, edge: event.edge }
    });
    batch.find(problem, &state.board, bearings, pose, batched);
}

/// The residual of one event.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EventResidual {
    /// Time since the start of its recording, minus the latency of its class (s).
    pub t: f64,
    /// Index of the segment.
    pub segment: u32,
    /// Column and row.
    pub pixel: [u16; 2],
    /// Unit vector across the edge in the image, towards its light side.
    pub normal: [f32; 2],
    /// Event class.
    pub class: u8,
    /// Range of the edge's normal speed.
    pub speed_range: u8,
    /// The edge's normal speed (px/s), positive if the pixel leaves the dot.
    pub normal_speed: f32,
    /// Distance from the edge (px), positive outside the dot.
    pub distance: f32,
    /// Distance from the position that the model predicts for the event (px).
    pub residual: f32,
}

impl EventResidual {
    /// Returns the part that concerns the event's class.
    pub fn of_class(&self) -> ClassResidual {
        ClassResidual { class: self.class, speed_range: self.speed_range, residual: self.residual }
    }
}

/// Returns the residuals of all events, in their order.
pub fn residuals_at(problem: &Problem, state: &State) -> Vec<EventResidual> {
    residuals_and_scale(problem, state, &BearingTable::new(&state.camera, problem.sensor)).0
}

/// Returns the residuals of all events, in their order, and the mean of the metres on the board per pixel across the edge (`None`
/// without events); `bearings` belong to the state's camera.
pub fn residuals_and_scale(
    problem: &Problem,
    state: &State,
    bearings: &BearingTable,
) -> (Vec<EventResidual>, Option<f64>) {
    let of_range = |range: &ObservationRange| {
        let mut found = Vec::new();
        let (Some(observations), Some(trajectory)) =
            (problem.segments.get(range.segment), state.trajectories.get(range.segment))
        else {
            return found;
        };
        let mut batch = EdgeBatch::default();
        for bin in observations.bins.get(range.bins.clone()).unwrap_or_default() {
            let Some(pose) = PoseBin::new(trajectory, bin.t) else { continue };
            for part in observations.events.get(bin.first..bin.end).unwrap_or_default().chunks(LANES) {
                find_edges(problem, state, bearings, &pose, part, &mut batch);
                let edges = batch.edges();
                let in_view = part.iter().zip(batch.cells()).enumerate().filter(|(_, (_, cell))| cell.is_some());
                for (lane, (event, _)) in in_view {
                    let scale = edges.scale[lane];
                    let bias = &state.bias[class_of(event)];
                    let passage = edges.passage(lane);
                    let residual = EventResidual {
                        t: bin.t + f64::from(event.dt),
                        segment: range.segment as u32,
                        pixel: [event.x, event.y],
                        normal: [0, 1].map(|axis| (edges.by_pixel[axis][lane] / scale) as f32),
                        class: event.class,
                        speed_range: event.speed_range,
                        normal_speed: passage.normal_speed as f32,
                        distance: edges.pixels[lane] as f32,
                        residual: (edges.pixels[lane] - bias.distance(&passage)) as f32,
                    };
                    found.push((residual, scale as f32));
                }
            }
        }
        found
    };
    let mut found = Vec::with_capacity(problem.segments.iter().map(|segment| segment.events.len()).sum());
    let mut scales = 0.0;
    // A few intervals at a time, so that the residuals are not in memory twice.
    for group in observation_ranges(&problem.segments).chunks(RESIDUALS_TOGETHER) {
        for (residual, scale) in group.par_iter().map(of_range).collect::<Vec<_>>().into_iter().flatten() {
            scales += f64::from(scale);
            found.push(residual);
        }
    }
    let count = found.len();
    (found, (count > 0).then(|| scales / count as f64))
}

/// The residual of one circle centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointResidual {
    /// Time since the start of its recording (s).
    pub t: f64,
    /// Observed position of the centre (px).
    pub pixel: Vector2<f64>,
    /// Observed minus projected position (px).
    pub residual: Vector2<f64>,
}

/// Returns the residuals of all circle centres, segment by segment in order of time.
pub fn point_residuals(problem: &Problem, state: &State) -> Vec<PointResidual> {
    let segments = problem.segments.iter().zip(&state.trajectories);
    let residual = |trajectory, point: &PointObservation| {
        let pose = PoseBin::new(trajectory, point.t)?;
        let &center = problem.points.get(point.circle)?;
        let rows = point_rows(&state.camera, &problem.area, &state.board, &pose, center, point.pixel)?;
        let residual = -Vector2::new(rows[0][ROW_RESIDUAL], rows[1][ROW_RESIDUAL]);
        Some(PointResidual { t: point.t, pixel: point.pixel, residual })
    };
    segments
        .flat_map(|(observations, trajectory)| {
            observations.points.iter().filter_map(move |point| residual(trajectory, point))
        })
        .collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use evcal_core::camera::{Camera, MAX_PARAMETERS, ModelKind};
    use evcal_core::sensor::Sensor;
    use nalgebra::{Isometry3, Rotation3, Translation3, UnitQuaternion, Vector3};

    use super::*;
    use crate::solve::levenberg::{linearised, moved};
    use crate::solve::observation::EventBin;
    use crate::solve::rows::board_edge::BoardEdges;
    use crate::solve::rows::event_bias::bias::Biases;
    use crate::solve::rows::event_bias::unknown;
    use crate::solve::{
        BOARD_INDEX, BOARD_PARAMETERS, FreeParameters, GLOBAL_COUNT, ITERATIONS, ResidualMeasure, bias_index,
    };
    use crate::trajectory::fit::{TrajectoryShape, fit};
    use crate::trajectory::{RotationSpline, Trajectory};
    use evcal_geometry::board::shape::{BoardShape, CircleArea, Surface};
    use evcal_geometry::timed_pose::TimedPose;

    const CENTERS: [[f64; 2]; 2] = [[0.11, 0.165], [0.165, 0.11]];
    const RADIUS: f64 = 0.0175;
    const AREA: CircleArea = CircleArea { middle: [0.19, 0.22], half: [0.19, 0.22] };
    const SHAPE: BoardShape = BoardShape { print_ratio: 1.01, bend: [0.004, -0.002], radius: RADIUS };
    const BINS: usize = 9;

    fn trajectory() -> Trajectory {
        let pose = |t: f64| {
            let turn = Rotation3::from_euler_angles(0.25 + 0.7 * t, -0.3 - t, 0.8 + 2.0 * t);
            let camera = Vector3::new(0.2 + 0.3 * t, 0.4 - 0.2 * t, -0.7 + 0.4 * t);
            Isometry3::from_parts(Translation3::from(camera), UnitQuaternion::from_rotation_matrix(&turn))
        };
        let times = (0..=40).map(|index| 0.0025 * f64::from(index));
        let poses: Vec<TimedPose> = times.map(|t| TimedPose { t, pose: pose(t) }).collect();
        let shape = TrajectoryShape { degree: 3, rotation: RotationSpline::Quaternion, knot_spacing: 0.0175 };
        fit(0, &poses, 0.0, 0.1, &shape).unwrap()
    }

    /// Events of three classes near the rims of two dots.
    fn observations(camera: &Camera<f64>, trajectory: &Trajectory) -> SegmentObservations {
        let mut observations = SegmentObservations::default();
        for bin in 0..BINS {
            let t = 0.01 * (bin as f64 + 1.0);
            let pose = trajectory.pose(t).unwrap();
            let first = observations.events.len();
            for event in 0..75 {
                let (circle, angle) = (event % 2, 0.35 * event as f64 + bin as f64);
                let [x, y] = CENTERS[circle];
                let rim = [x + RADIUS * angle.cos(), y + RADIUS * angle.sin()];
                let rim = Vector3::from(Surface::new(&AREA, &SHAPE).place(rim));
                let pixel = camera.project(&pose.inverse_transform_point(&rim.into()).coords).unwrap();
                observations.events.push(EventObservation {
                    dt: 1e-6 * event as f32,
                    x: pixel.x.round() as u16,
                    y: pixel.y.round() as u16,
                    edge: circle as u16,
                    class: [0, 2, 5][event / 25],
                    speed_range: 1,
                });
            }
            observations.bins.push(EventBin { t, first, end: observations.events.len() });
        }
        observations
    }

    fn cost_and_gradient(problem: &Problem, state: &State) -> (f64, Equations) {
        let bearings = BearingTable::new(&state.camera, problem.sensor);
        let columns = Columns::new(&[true; GLOBAL_COUNT]);
        let ranges = observation_ranges(&problem.segments);
        let mut equations = linearised(problem, state, &bearings, &ranges, &columns).unwrap();
        assert_eq!(equations.len(), 1);
        let equations = equations.remove(0);
        assert_eq!(equations.loss.count, problem.segments[0].events.len());
        (equations.loss.cost, equations)
    }

    /// Events of a known camera, and the matching state; the cost is a parabola.
    pub(crate) fn example() -> (Problem, State) {
        let parameters = [331.0, 332.0, 176.0, 134.0, -0.35, 0.15, -4e-4, 5e-4, -0.03];
        let camera = Camera::from_parameters(ModelKind::Radtan, &parameters).unwrap();
        let trajectory = trajectory();
        let problem = Problem {
            sensor: Sensor::new(346, 260),
            points: CENTERS.to_vec(),
            edges: BoardEdges::Rims(CENTERS.to_vec()),
            area: AREA,
            mean_scale: 1.0,
            point_sigma: 1.0,
            associated_latencies: [0.0; CLASS_COUNT],
            segments: vec![observations(&camera, &trajectory)],
            stiffness: Vec::new(),
            free: FreeParameters {
                intrinsics: [true; MAX_PARAMETERS],
                board: [true; BOARD_PARAMETERS],
                biases: [Biases::default(); CLASS_COUNT],
            },
            residual: ResidualMeasure::Pixel,
            huber: 1e6,
            iterations: ITERATIONS,
        };
        let mut bias = unknown(0.3);
        bias.iter_mut().for_each(|class| class.biases[Bias::Offset] = -0.3);
        (problem, State { camera, board: SHAPE, bias, trajectories: vec![trajectory] })
    }

    /// The gradient equals the slope of the cost by each global parameter and each control point.
    #[test]
    fn the_gradient_is_the_slope_of_the_cost() {
        let (problem, state) = example();
        let control_points = state.trajectories[0].control_point_count();
        let (_, equations) = cost_and_gradient(&problem, &state);
        let slope = |globals: &[f64], points: &[f64]| {
            let cost = |sign: f64| {
                let scaled = |values: &[f64]| values.iter().map(|value| sign * value).collect::<Vec<_>>();
                let state = moved(&state, &[scaled(points)], &scaled(globals), &[]).unwrap();
                cost_and_gradient(&problem, &state).0
            };
            0.5 * (cost(1.0) - cost(-1.0))
        };
        // Deviation of the cost from a parabola: second order in the distance from the edge.
        let assert_close = |found: f64, wanted: f64, scale: f64, what: &str| {
            assert!((found - wanted).abs() < 0.02 * (wanted.abs() + scale), "{what}: {found} against {wanted}");
        };
        let step = |index: usize, size: f64, count: usize| {
            let mut step = vec![0.0; count];
            step[index] = size;
            step
        };
        let still = vec![0.0; 6 * control_points];
        let globals = [(0, 0.01), (2, 0.01), (4, 1e-4), (8, 1e-3)]
            .into_iter()
            .chain([(BOARD_INDEX, 1e-5), (BOARD_INDEX + 1, 1e-5), (BOARD_INDEX + 2, 1e-5), (BOARD_INDEX + 3, 1e-6)])
            .chain([0, 2, 5].map(|class| (bias_index(class, Bias::Offset), 1e-3)))
            .chain([(bias_index(2, Bias::Latency), 1e-6), (bias_index(5, Bias::Curvature), 1e-3)]);
        for (global, size) in globals {
            let numeric = slope(&step(global, size, GLOBAL_COUNT), &still) / size;
            assert_close(equations.corner.gradient[global], numeric, 0.05 / size, &format!("global {global}"));
        }
        for number in 0..6 * control_points {
            let size = 1e-5;
            let numeric = slope(&[0.0; GLOBAL_COUNT], &step(number, size, 6 * control_points)) / size;
            let found = equations.band.gradient[number / 6][number % 6];
            assert_close(found, numeric, 0.05 / size, &format!("control point {number}"));
        }
    }
}

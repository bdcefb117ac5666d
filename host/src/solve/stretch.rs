//! Linearisation of the observations in a stretch of one segment.

use std::ops::Range;

use nalgebra::Vector2;
use rayon::prelude::*;

use super::bearing_table::BearingTable;
use super::edge_batch::{BatchEvent, EdgeBatch, LANES};
use super::event_row::{ROW, ROW_RESIDUAL};
use super::normal::StretchEquations;
use super::observation::{EventObservation, SegmentObservations};
use super::point_row::point_rows;
use super::pose_bin::PoseBin;
use super::row_batch::RowBatch;
use super::row_products::{RowProducts, STEP};
use super::{Problem, State};
use crate::circles::reference_frame::PointObservation;
use crate::numerics::huber::huber;
use crate::solve::event_bias::bias::Bias;
use crate::solve::event_bias::{CLASS_COUNT, SPEED_RANGE_COUNT};

/// A run of bins (and of circle centres) of one segment, small enough to be a unit of work.
#[derive(Clone, Debug, PartialEq)]
pub struct Stretch {
    /// Index of the segment.
    pub segment: usize,
    /// Bins in [`SegmentObservations::bins`].
    pub bins: Range<usize>,
    /// Centres in [`SegmentObservations::points`].
    pub points: Range<usize>,
}

impl Stretch {
    /// Time of the first observation in seconds, 0 without any.
    pub fn start(&self, segments: &[SegmentObservations]) -> f64 {
        let observations = segments.get(self.segment);
        let bin = observations.and_then(|segment| segment.bins.get(self.bins.clone())?.first());
        let point = observations.and_then(|segment| segment.points.get(self.points.clone())?.first());
        bin.map(|bin| bin.t).or(point.map(|point| point.t)).unwrap_or(0.0)
    }
}

/// Bins in a stretch: long enough that merging costs little, short enough to share among threads.
const STRETCH_BINS: usize = 128;
const STRETCH_POINTS: usize = 512;

/// Cuts all segments into stretches.
pub fn stretches(segments: &[SegmentObservations]) -> Vec<Stretch> {
    let mut stretches = Vec::new();
    for (segment, observations) in segments.iter().enumerate() {
        for first in (0..observations.bins.len()).step_by(STRETCH_BINS) {
            let bins = first..(first + STRETCH_BINS).min(observations.bins.len());
            stretches.push(Stretch { segment, bins, points: 0..0 });
        }
        for first in (0..observations.points.len()).step_by(STRETCH_POINTS) {
            let points = first..(first + STRETCH_POINTS).min(observations.points.len());
            stretches.push(Stretch { segment, bins: 0..0, points });
        }
    }
    stretches
}

/// Normal equations of `stretch` at `state`.
pub fn linearise(problem: &Problem, state: &State, bearings: &BearingTable, stretch: &Stretch) -> StretchEquations {
    let (Some(observations), Some(trajectory)) =
        (problem.segments.get(stretch.segment), state.trajectories.get(stretch.segment))
    else {
        return StretchEquations::new(0, 0, 1);
    };
    let bins = observations.bins.get(stretch.bins.clone()).unwrap_or_default();
    let points = observations.points.get(stretch.points.clone()).unwrap_or_default();
    let times = || bins.iter().map(|bin| bin.t).chain(points.iter().map(|point| point.t));
    let first_pose = times().find_map(|t| PoseBin::new(trajectory, t));
    let last_pose = times().rev().find_map(|t| PoseBin::new(trajectory, t));
    let (Some(first_pose), Some(last_pose)) = (first_pose, last_pose) else {
        return StretchEquations::new(0, 0, trajectory.degree + 1);
    };
    let count = last_pose.first + last_pose.order - first_pose.first;
    let mut equations = StretchEquations::new(first_pose.first, count, first_pose.order);
    let mut products = RowProducts::default();
    let mut batch = EdgeBatch::default();
    let mut rows = RowBatch::default();

    for bin in bins {
        let Some(pose) = PoseBin::new(trajectory, bin.t) else { continue };
        let events = observations.events.get(bin.first..bin.end).unwrap_or_default();
        for part in events.chunks(LANES) {
            find_edges(problem, state, bearings, (&pose, part), &mut batch);
            for (lane, event) in part.iter().enumerate() {
                let bias = &state.bias[class_of(event)];
                rows.set_class(lane, bias, bias.sigma[usize::from(event.speed_range).min(SPEED_RANGE_COUNT - 1)]);
            }
            rows.weigh(batch.edges(), problem.settings.huber, problem.residual_scale(), part.len());
            let (count, cost) = rows.collect(batch.cells(), part.iter().map(|event| class_of(event) as u8));
            equations.count += count;
            equations.cost += cost;
            let (steps, classes) = rows.steps();
            products.add(steps, classes);
        }
        equations.add_bin(&pose, &mut products);
    }

    let inverse_sigma = 1.0 / problem.point_sigma;
    for point in points {
        let Some(pose) = PoseBin::new(trajectory, point.t) else { continue };
        let Some(&center) = problem.circle_centers.get(point.circle) else { continue };
        let Some(rows) = point_rows(&state.camera, &pose, Vector2::from(center), point.pixel) else { continue };
        let error = rows[0][ROW_RESIDUAL].hypot(rows[1][ROW_RESIDUAL]) * inverse_sigma;
        let (cost, root_weight) = huber(error, problem.settings.huber);
        equations.cost += cost;
        equations.count += 1;
        let mut weighed = [[0.0; ROW]; STEP];
        for (to, value) in weighed.iter_mut().flatten().zip(rows.iter().flatten()) {
            *to = (value * root_weight * inverse_sigma) as f32;
        }
        products.add_without_biases(&weighed);
        equations.add_bin(&pose, &mut products);
    }
    equations.add_globals(&products);
    equations
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
    (pose, events): (&PoseBin, &[EventObservation]),
    batch: &mut EdgeBatch<'a>,
) {
    let batched = events.iter().map(|event| {
        let class = class_of(event);
        let later = problem.associated_latencies[class] - state.bias[class].biases[Bias::Latency];
        let pixel = [f64::from(event.x), f64::from(event.y)];
        BatchEvent { pixel, dt: f64::from(event.dt) + later, circle: event.circle }
    });
    batch.find(problem, bearings, pose, batched);
}

/// The residual of one event.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EventResidual {
    /// Index of the segment.
    pub segment: usize,
    /// Time since the start of its recording, less the latency of its class (s).
    pub t: f64,
    /// Column and row.
    pub pixel: [u16; 2],
    /// Unit vector across the edge in the image, out of the circle.
    pub normal: [f32; 2],
    /// Event class.
    pub class: u8,
    /// Range of the edge's normal speed.
    pub speed_range: u8,
    /// Distance from where the model puts the event (px).
    pub residual: f32,
    /// Metres on the board for each pixel across the edge.
    pub scale: f32,
}

/// The residuals of all events, in their order, without a table of bearings that is there already.
pub fn residuals_at(problem: &Problem, state: &State) -> Vec<EventResidual> {
    residuals(problem, state, &BearingTable::new(&state.camera, problem.sensor))
}

/// The residuals of all events, in their order; `bearings` are those of the state's camera.
pub fn residuals(problem: &Problem, state: &State, bearings: &BearingTable) -> Vec<EventResidual> {
    let of_stretch = |stretch: &Stretch| {
        let mut found = Vec::new();
        let (Some(observations), Some(trajectory)) =
            (problem.segments.get(stretch.segment), state.trajectories.get(stretch.segment))
        else {
            return found;
        };
        let mut batch = EdgeBatch::default();
        for bin in observations.bins.get(stretch.bins.clone()).unwrap_or_default() {
            let Some(pose) = PoseBin::new(trajectory, bin.t) else { continue };
            for part in observations.events.get(bin.first..bin.end).unwrap_or_default().chunks(LANES) {
                find_edges(problem, state, bearings, (&pose, part), &mut batch);
                let edges = batch.edges();
                let in_view = part.iter().zip(batch.cells()).enumerate().filter(|(_, (_, cell))| cell.is_some());
                for (lane, (event, _)) in in_view {
                    let scale = edges.scale[lane];
                    let bias = &state.bias[class_of(event)];
                    found.push(EventResidual {
                        segment: stretch.segment,
                        t: bin.t + f64::from(event.dt),
                        pixel: [event.x, event.y],
                        normal: [0, 1].map(|axis| (edges.by_pixel[axis][lane] / scale) as f32),
                        class: event.class,
                        speed_range: event.speed_range,
                        residual: (edges.pixels[lane] - bias.distance(&edges.passage(lane))) as f32,
                        scale: scale as f32,
                    });
                }
            }
        }
        found
    };
    stretches(&problem.segments).par_iter().map(of_stretch).collect::<Vec<_>>().concat()
}

/// The residual of one circle centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointResidual {
    /// Time since the start of its recording (s).
    pub t: f64,
    /// Where the centre was seen (px).
    pub pixel: Vector2<f64>,
    /// How far from its projection it was seen (px).
    pub residual: Vector2<f64>,
}

/// The residuals of all circle centres, segment by segment in order of time.
pub fn point_residuals(problem: &Problem, state: &State) -> Vec<PointResidual> {
    let segments = problem.segments.iter().zip(&state.trajectories);
    let residual = |trajectory, point: &PointObservation| {
        let pose = PoseBin::new(trajectory, point.t)?;
        let &center = problem.circle_centers.get(point.circle)?;
        let rows = point_rows(&state.camera, &pose, Vector2::from(center), point.pixel)?;
        let residual = -Vector2::new(rows[0][ROW_RESIDUAL], rows[1][ROW_RESIDUAL]);
        Some(PointResidual { t: point.t, pixel: point.pixel, residual })
    };
    segments
        .flat_map(|(observations, trajectory)| {
            observations.points.iter().filter_map(move |point| residual(trajectory, point))
        })
        .collect()
}

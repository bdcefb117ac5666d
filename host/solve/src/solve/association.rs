//! Assignment of events to the edges of the board (section 8 of method.md).
//!
//! Every event inside a trajectory segment is projected onto the board plane with the pose at its own time, which takes the
//! motion into account. There the nearest circle is found by rounding to the grid. An event is kept if it is near that circle's
//! edge, if the edge really moves across the pixel (if it only moves along its own direction, the distance carries no information),
//! and if its polarity is the one that the motion predicts.

use evcal_core::event::Polarity;
use evcal_core::settings;
use evcal_core::settings::{above, at_least};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::solve::State;
use crate::solve::event_sample::RankedEvent;
use crate::solve::observation::{EventBin, EventObservation, SegmentObservations};
use crate::solve::rows::bearing_table::BearingTable;
use crate::solve::rows::board_edge::{BoardEdges, NearestEdge};
use crate::solve::rows::board_ray::{BoardRay, is_in_front};
use crate::solve::rows::board_surface::{BoardGround, BoardSurface};
use crate::solve::rows::edge_batch::{BatchEvent, EdgeBatch, LANES, Scene};
use crate::solve::rows::event_bias::bias::Bias;
use crate::solve::rows::event_bias::robust::ClassResidual;
use crate::solve::rows::event_bias::{EventKind, speed_range};
use crate::solve::rows::pose_bin::PoseBin;
use crate::trajectory::Trajectory;
use evcal_geometry::board::Board;
use evcal_geometry::board::squares::edges::Side;

settings! {
    /// The assignment of events to circles (section 8 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct AssociationSettings {
        /// Largest distance from the expected distance of the event's class, in units of the class's spread; at most 2.5 px.
        pub band: f64 = 3.0, "σ", above(0.0);
        /// Largest number of events in one solve; more are thinned evenly.
        pub most_events: usize = 1_000_000, "events", at_least(1.0);
    }
}

/// Largest distance from the edge in the first round, while the spread of the events is not known (px).
const FIRST_BAND: f64 = 3.0;
/// Largest distance from the expected distance of the event's class, whatever the spread (px).
const WIDEST_BAND: f64 = 2.5;
/// Largest distance of an event from a line, as a share of the width of the narrower of the two strips along it. The next line with
/// events of the same polarity is at least two such strips away.
const REACH: f64 = 0.75;
/// Smallest distance from a point where lines cross or end (px).
const CLEARANCE: f64 = 1.5;
/// Slowest normal speed of an edge (px/s).
const SLOWEST_EDGE: f64 = 30.0;
/// Smallest share of the motion that is across the edge; below it the edge mostly moves along its own direction.
const TANGENT: f64 = 0.65;
/// The same for straight edges; between both limits one event in [`OBLIQUE_STEP`] counts. If a board moves along its squares, only the
/// edges in the direction of the motion determine its position across the motion: without them, trajectories were up to 10 px off. With all
/// their events, simulated focal lengths were up to 0.05 % too long.
const LINE_TANGENT: f64 = 0.1;
const OBLIQUE_STEP: u64 = 8;
/// Length of a time bin whose events share their basis weights (s).
pub const BIN: f64 = 0.5e-3;

/// Counts of the events: the kept ones, and the dropped ones by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AssociationReport {
    /// Number of input events.
    pub events: u64,
    /// Events left out by thinning.
    pub thinned: u64,
    /// Events outside every segment.
    pub outside_segments: u64,
    /// Events whose ray does not meet a circle of the board.
    pub off_board: u64,
    /// Events too far from the edge of their circle.
    pub far_from_edge: u64,
    /// Events on an edge that is too slow or mostly moves along its own direction.
    pub edge_slides: u64,
    /// Events whose polarity contradicts the motion.
    pub wrong_polarity: u64,
    /// Events kept.
    pub kept: u64,
}

impl AssociationReport {
    /// Adds the counts of another part.
    pub fn add(&mut self, other: &Self) {
        self.events += other.events;
        self.thinned += other.thinned;
        self.outside_segments += other.outside_segments;
        self.off_board += other.off_board;
        self.far_from_edge += other.far_from_edge;
        self.edge_slides += other.edge_slides;
        self.wrong_polarity += other.wrong_polarity;
        self.kept += other.kept;
    }
}

/// Input of the association: the current estimate and the board.
pub struct AssociationContext<'a> {
    /// Current estimate.
    pub state: &'a State,
    /// Bearings of the current camera.
    pub bearings: &'a BearingTable,
    /// The board.
    pub board: &'a Board,
    /// `true` if σ of the classes is known, so that [`AssociationSettings::band`] applies.
    pub sigma_known: bool,
    /// Thresholds.
    pub settings: &'a AssociationSettings,
}

/// Associates the events of one recording, batch by batch in time order.
pub struct Associator<'a> {
    context: AssociationContext<'a>,
    /// Index of the segment and its trajectory, in order of time.
    segments: Vec<(usize, &'a Trajectory)>,
    nearest: NearestEdge,
    edges: BoardEdges,
    ground: BoardGround,
    found: Vec<Vec<Found>>,
    /// Times of events that are too far from every edge, by segment.
    far: Vec<Vec<f32>>,
    report: AssociationReport,
}

/// An event with the edge that it belongs to.
#[derive(Clone, Copy)]
struct Found {
    /// Index of its time bin.
    bin: u32,
    observation: EventObservation,
    /// Distance from the expected distance of its class (px).
    residual: f32,
    /// Metres on the board per pixel across the edge.
    scale: f32,
}

/// An event and the edge nearest to it.
struct Near<'e> {
    event: &'e RankedEvent,
    class: usize,
    /// Time after the centre of the bin, minus the latency of the class (s).
    dt: f64,
    /// Index of the edge in the board's list of edges.
    edge: u16,
}

/// A time bin.
struct Moment<'b> {
    segment: usize,
    /// Index of the bin in the segment.
    bin: u32,
    /// Centre of the bin (s).
    t: f64,
    pose: &'b PoseBin,
}

/// The observations of all segments of a recording.
pub struct Observed {
    /// Index of each segment, and its observations.
    pub segments: Vec<(usize, SegmentObservations)>,
    /// The residuals of all events, segment by segment in the order of the observations.
    pub residuals: Vec<ClassResidual>,
    /// Sum over the events of the metres on the board per pixel across the edge.
    pub scales: f64,
    /// Counts of kept and dropped events.
    pub report: AssociationReport,
}

/// Result for the events that one thread processed.
#[derive(Default)]
struct Part {
    /// Index of the segment, and the event.
    found: Vec<(usize, Found)>,
    /// Segment and time (s) of events on the board that are far from every edge.
    far: Vec<(usize, f32)>,
    report: AssociationReport,
}

/// Number of events that one thread processes at once.
const CHUNK: usize = 4096;

impl<'a> Associator<'a> {
    /// Creates an associator for recording number `recording`.
    pub fn new(context: AssociationContext<'a>, recording: usize) -> Self {
        let state = context.state;
        let mut segments: Vec<(usize, &Trajectory)> =
            state.trajectories.iter().enumerate().filter(|(_, t)| t.recording == recording).collect();
        segments.sort_by(|a, b| a.1.start().total_cmp(&b.1.start()));
        let board = context.board;
        Self {
            found: vec![Vec::new(); segments.len()],
            far: vec![Vec::new(); segments.len()],
            nearest: NearestEdge::of_board(board),
            edges: BoardEdges::of_board(board),
            ground: BoardGround::of_board(board, &state.board),
            report: AssociationReport::default(),
            segments,
            context,
        }
    }

    /// Adds the next events of the recording; their times are microseconds since its start.
    pub fn push(&mut self, events: &[RankedEvent]) {
        let (Some(first), Some(last)) = (events.first(), events.last()) else { return };
        let latencies = self.context.state.bias.iter().map(|bias| bias.biases[Bias::Latency]);
        let margin = latencies.fold(0.0, |most: f64, latency| most.max(latency.abs())) + 1e-4;
        let span = (first.t as f64 * 1e-6 - margin, last.t as f64 * 1e-6 + margin);
        let bins: Vec<SegmentBins> =
            self.segments.iter().map(|(_, trajectory)| SegmentBins::new(trajectory, span)).collect();
        let parts: Vec<Part> = events
            .par_chunks(CHUNK)
            .map(|events| match &self.ground {
                BoardGround::Flat(surface) => self.associate(surface, events, &bins),
                BoardGround::Shaped(surface) => self.associate(surface, events, &bins),
            })
            .collect();
        for Part { found, far, report } in parts {
            self.report.add(&report);
            for (segment, time) in far {
                if let Some(list) = self.far.get_mut(segment) {
                    list.push(time);
                }
            }
            for (segment, found) in found {
                if let Some(list) = self.found.get_mut(segment) {
                    list.push(found);
                }
            }
        }
    }

    /// Associates some events, grouped by time bin.
    fn associate<S: BoardSurface>(&self, surface: &S, events: &[RankedEvent], bins: &[SegmentBins]) -> Part {
        let mut part =
            Part { report: AssociationReport { events: events.len() as u64, ..Default::default() }, ..Part::default() };
        let mut placed: Vec<(usize, u32, &RankedEvent)> = Vec::with_capacity(events.len());
        for event in events {
            let time = self.time(event);
            match bins.iter().enumerate().find_map(|(segment, bins)| Some((segment, bins.bin_at(time)?))) {
                Some((segment, bin)) => placed.push((segment, bin, event)),
                None => part.report.outside_segments += 1,
            }
        }
        placed.sort_by_key(|&(segment, bin, _)| (segment, bin));
        let (mut batch, mut near) = (EdgeBatch::default(), Vec::new());
        for run in placed.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let Some(&(segment, bin, _)) = run.first() else { continue };
            let Some(of_segment) = bins.get(segment) else { continue };
            let Some(pose) = of_segment.pose(bin) else { continue };
            let moment = Moment { segment, bin, t: of_segment.center(bin), pose };
            near.clear();
            near.extend(run.iter().filter_map(|(_, _, event)| self.near(surface, &moment, event)));
            part.report.off_board += (run.len() - near.len()) as u64;
            for near in near.chunks(LANES) {
                self.judge(near, &moment, &mut batch, &mut part);
            }
        }
        part
    }

    /// Returns the time of an event minus the latency of its class (s).
    fn time(&self, event: &RankedEvent) -> f64 {
        let latency = self.context.state.bias.get(class_of(event)).map_or(0.0, |bias| bias.biases[Bias::Latency]);
        event.t as f64 * 1e-6 - latency
    }

    /// Finds the edge nearest to the event on the board; `None` if the event is off the board or outside the image.
    fn near<'e, S: BoardSurface>(&self, surface: &S, moment: &Moment, event: &'e RankedEvent) -> Option<Near<'e>> {
        let dt = self.time(event) - moment.t;
        let place = self.context.bearings.place(f64::from(event.x), f64::from(event.y))?;
        let (bearing, by_pixel) = place.bearing();
        let ray = BoardRay::new(surface, moment.pose, dt, &bearing);
        if !is_in_front(ray.depth()) {
            return None;
        }
        let edge = match &self.nearest {
            NearestEdge::Rims(board) => board.nearest_circle(ray.point())?,
            NearestEdge::Lines(places) => {
                // A pixel that moves to the light becomes brighter.
                let brightens = event.polarity == Polarity::On;
                let velocity = ray.velocity(moment.pose);
                let light = velocity.map(|v| if (v > 0.0) == brightens { Side::High } else { Side::Low });
                let clearance = CLEARANCE * ray.widest_pixel(&by_pixel);
                // If the pixel also slides along the line, it was nearer to the end while the line passed it.
                let speed = velocity[0].hypot(velocity[1]);
                let ends = velocity.map(|v| clearance * speed / v.abs());
                places.nearest(ray.point().into(), light, clearance, ends)?
            }
        };
        Some(Near { event, class: class_of(event), dt, edge: u16::try_from(edge).ok()? })
    }

    /// Checks at most [`LANES`] events of one bin, and adds those that belong to their nearest edge to `part`.
    fn judge<'b>(&'b self, near: &[Near], moment: &Moment, batch: &mut EdgeBatch<'b>, part: &mut Part) {
        let &Moment { segment, bin, t, pose } = moment;
        let state = self.context.state;
        let scene = Scene { edges: &self.edges, ground: &self.ground, radius: state.board.radius, mean_scale: None };
        let batched = near.iter().map(|&Near { event, dt, edge, .. }| {
            let pixel = [f64::from(event.x), f64::from(event.y)];
            BatchEvent { pixel, dt, edge }
        });
        batch.find_in::<false>(&scene, self.context.bearings, pose, batched);
        let edges = batch.edges();
        for (lane, (&Near { event, class, dt, edge }, cell)) in near.iter().zip(batch.cells()).enumerate() {
            let (Some(bias), Some(_)) = (state.bias.get(class), cell) else {
                part.report.off_board += 1;
                continue;
            };
            let (passage, scale) = (edges.passage(lane), edges.scale[lane]);
            let speed_range = speed_range(passage.normal_speed);
            let residual = edges.pixels[lane] - bias.distance(&passage);
            let distance = residual.abs();
            if distance.is_nan() || distance >= self.band(bias.sigma[speed_range]).min(self.reach(edge, scale)) {
                part.report.far_from_edge += 1;
                part.far.push((segment, (t + dt) as f32));
                continue;
            }
            let normal_speed = passage.normal_speed;
            let sliding = edges.sliding[lane] / scale;
            let speed = (normal_speed * normal_speed + sliding * sliding).sqrt();
            let share = normal_speed.abs() / speed;
            if normal_speed.abs() < SLOWEST_EDGE || !self.counts(event, share) {
                part.report.edge_slides += 1;
                continue;
            }
            let predicted = if normal_speed > 0.0 { Polarity::On } else { Polarity::Off };
            if predicted != event.polarity {
                part.report.wrong_polarity += 1;
                continue;
            }
            part.report.kept += 1;
            let (class, speed_range) = (class as u8, speed_range as u8);
            let observation = EventObservation { dt: dt as f32, x: event.x, y: event.y, edge, class, speed_range };
            part.found.push((segment, Found { bin, observation, residual: residual as f32, scale: scale as f32 }));
        }
    }

    /// Returns the largest accepted distance (px) from the expected distance, for an event class with this spread.
    fn band(&self, sigma: f64) -> f64 {
        if self.context.sigma_known { (self.context.settings.band * sigma).min(WIDEST_BAND) } else { FIRST_BAND }
    }

    /// Returns `true` if an event counts although only `share` of the motion is across its edge.
    fn counts(&self, event: &RankedEvent, share: f64) -> bool {
        let is_oblique_line = || {
            let number = event.t as u64 ^ u64::from(event.x) ^ (u64::from(event.y) << 1);
            matches!(self.edges, BoardEdges::Lines(_)) && share >= LINE_TANGENT && number.is_multiple_of(OBLIQUE_STEP)
        };
        share >= TANGENT || is_oblique_line()
    }

    /// Returns the largest accepted distance (px) of an event from an edge of the board.
    fn reach(&self, edge: u16, scale: f64) -> f64 {
        match &self.nearest {
            NearestEdge::Rims(_) => f64::INFINITY,
            NearestEdge::Lines(lines) => {
                lines.edges().get(usize::from(edge)).map_or(0.0, |line| REACH * line.width() / scale)
            }
        }
    }

    /// Ends the recording and returns its observations.
    pub fn finish(self) -> Observed {
        let segments: Vec<(usize, SegmentObservations, Vec<ClassResidual>, f64)> = self
            .found
            .into_par_iter()
            .zip(self.far)
            .zip(self.segments.par_iter())
            .map(|((mut found, far), (segment, trajectory))| {
                found.sort_by_key(|found| (found.bin, found.observation.class));
                let events = Vec::with_capacity(found.len());
                let mut observations = SegmentObservations { events, far, ..SegmentObservations::default() };
                for group in found.chunk_by(|a, b| a.bin == b.bin) {
                    let Some(bin) = group.first().map(|found| found.bin) else { continue };
                    let first = observations.events.len();
                    observations.events.extend(group.iter().map(|found| found.observation));
                    let t = bin_center(trajectory.start(), bin);
                    observations.bins.push(EventBin { t, first, end: observations.events.len() });
                }
                let residuals = found.iter().map(|found| ClassResidual {
                    class: found.observation.class,
                    speed_range: found.observation.speed_range,
                    residual: found.residual,
                });
                let scales = found.iter().map(|found| f64::from(found.scale)).sum();
                (*segment, observations, residuals.collect(), scales)
            })
            .collect();
        let mut observed = Observed { segments: Vec::new(), residuals: Vec::new(), scales: 0.0, report: self.report };
        for (segment, observations, residuals, scales) in segments {
            observed.segments.push((segment, observations));
            observed.residuals.extend(residuals);
            observed.scales += scales;
        }
        observed
    }
}

fn class_of(event: &RankedEvent) -> usize {
    EventKind { polarity: event.polarity, place: event.place }.class()
}

fn bin_center(start: f64, bin: u32) -> f64 {
    start + (f64::from(bin) + 0.5) * BIN
}

/// Poses of the bins of one segment that a batch of events touches.
struct SegmentBins {
    start: f64,
    end: f64,
    first: u32,
    poses: Vec<Option<PoseBin>>,
}

impl SegmentBins {
    fn new(trajectory: &Trajectory, span: (f64, f64)) -> Self {
        let (start, end) = (trajectory.start(), trajectory.end());
        let mut bins = Self { start, end, first: 0, poses: Vec::new() };
        if span.1 < start || span.0 > end {
            return bins;
        }
        bins.first = bins.bin((span.0 - BIN).max(start));
        let last = bins.bin((span.1 + BIN).min(end));
        bins.poses = (bins.first..=last).map(|bin| PoseBin::new(trajectory, bins.center(bin))).collect();
        bins
    }

    fn bin(&self, time: f64) -> u32 {
        ((time - self.start) / BIN).max(0.0) as u32
    }

    fn center(&self, bin: u32) -> f64 {
        bin_center(self.start, bin)
    }

    /// Returns the bin of a time in the segment; `None` if it has no pose.
    fn bin_at(&self, time: f64) -> Option<u32> {
        if self.poses.is_empty() || time < self.start || time > self.end {
            return None;
        }
        let bin = self.bin(time);
        self.pose(bin).map(|_| bin)
    }

    fn pose(&self, bin: u32) -> Option<&PoseBin> {
        self.poses.get(bin.checked_sub(self.first)? as usize)?.as_ref()
    }
}

//! Section 8 of method.md: which event belongs to which circle.
//!
//! Every event inside a trajectory segment is carried to the board plane through the pose at its
//! own time (so motion is taken into account), where the nearest circle is a matter of rounding.
//! An event is kept when it is near that circle's edge, the edge really moves across the pixel (not
//! along itself, where the distance says nothing), and the polarity is the one that the motion
//! predicts.

use evcal_core::event::Polarity;
use evcal_core::settings;
use evcal_core::settings::{above, at_least};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::solve::State;
use crate::solve::bearing_table::BearingTable;
use crate::solve::board_edge::{BoardEdge, Line, NearestEdge, Rim};
use crate::solve::board_ray::{BoardRay, is_in_front};
use crate::solve::board_surface::{BoardGround, BoardSurface};
use crate::solve::event_bias::bias::Bias;
use crate::solve::event_bias::{EventKind, speed_range};
use crate::solve::event_row::{EventEdge, EventRay};
use crate::solve::event_sample::RankedEvent;
use crate::solve::observation::{EventBin, EventObservation, SegmentObservations};
use crate::solve::pose_bin::PoseBin;
use crate::trajectory::Trajectory;
use evcal_geometry::board::Board;

settings! {
    /// Which event belongs to which circle (section 8 of method.md).
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct AssociationSettings {
        /// Largest distance from where the event's class is expected, in units of the class's spread; at most 2.5 px.
        pub band: f64 = 3.0, "σ", above(0.0);
        /// Most events in one solve; more are thinned evenly.
        pub most_events: usize = 1_000_000, "events", at_least(1.0);
    }
}

/// Largest distance from the edge in the first round, while the spread of the events is not known (px).
const FIRST_BAND: f64 = 3.0;
/// Largest distance from where the event's class is expected, whatever the spread (px).
const WIDEST_BAND: f64 = 2.5;
/// Smallest distance from where lines cross or end (px).
const CLEARANCE: f64 = 1.5;
/// Slowest normal speed of an edge (px/s).
const SLOWEST_EDGE: f64 = 30.0;
/// Smallest share of the motion that is across the edge; below it the edge slides along itself.
const TANGENT: f64 = 0.65;
/// Length of a time bin whose events share their basis weights (s).
pub const BIN: f64 = 0.5e-3;

/// What became of the events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AssociationReport {
    /// Events that came in.
    pub events: u64,
    /// Events left out by thinning.
    pub thinned: u64,
    /// Events outside every segment.
    pub outside_segments: u64,
    /// Events whose ray meets no circle of the board.
    pub off_board: u64,
    /// Events too far from the edge of their circle.
    pub far_from_edge: u64,
    /// Events on an edge that is too slow or slides along itself.
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

/// What the association looks at: the current estimate and the board.
pub struct AssociationContext<'a> {
    /// Current estimate.
    pub state: &'a State,
    /// Bearings of the current camera.
    pub bearings: &'a BearingTable,
    /// The board.
    pub board: &'a Board,
    /// Whether σ of the classes is known, so that [`AssociationSettings::band`] applies.
    pub sigma_known: bool,
    /// Thresholds.
    pub settings: &'a AssociationSettings,
}

/// Associates the events of one recording, batch by batch in time order.
pub struct Associator<'a> {
    context: AssociationContext<'a>,
    /// Index of the segment and its trajectory, in order of time.
    segments: Vec<(usize, &'a Trajectory)>,
    edges: NearestEdge,
    ground: BoardGround,
    found: Vec<Vec<(u32, EventObservation)>>,
    /// Times of events that are too far from an edge, by segment.
    far: Vec<Vec<f32>>,
    report: AssociationReport,
}

/// An associated event with the index of its segment and of its time bin.
type Associated = (usize, u32, EventObservation);

/// An edge that an event saw.
struct SeenEdge {
    /// Which one of the board's.
    index: u16,
    /// How it passed.
    edge: EventEdge,
    /// How far from it the event may be (px).
    reach: f64,
}

/// What came of the events that one thread worked on.
#[derive(Default)]
struct Part {
    found: Vec<Associated>,
    /// Segment and time (s) of events on the board that are far from every edge.
    far: Vec<(usize, f32)>,
    report: AssociationReport,
}

/// Events for which one thread works in a go.
const CHUNK: usize = 4096;

impl<'a> Associator<'a> {
    /// An associator for recording number `recording`.
    pub fn new(context: AssociationContext<'a>, recording: usize) -> Self {
        let state = context.state;
        let mut segments: Vec<(usize, &Trajectory)> =
            state.trajectories.iter().enumerate().filter(|(_, t)| t.recording == recording).collect();
        segments.sort_by(|a, b| a.1.start().total_cmp(&b.1.start()));
        let board = context.board;
        Self {
            found: vec![Vec::new(); segments.len()],
            far: vec![Vec::new(); segments.len()],
            edges: NearestEdge::of_board(board),
            ground: BoardGround::of_board(board, &state.board),
            report: AssociationReport::default(),
            segments,
            context,
        }
    }

    /// Takes the next events of the recording; their times count from its start in microseconds.
    pub fn push(&mut self, events: &[RankedEvent]) {
        let (Some(first), Some(last)) = (events.first(), events.last()) else { return };
        let latencies = self.context.state.bias.iter().map(|bias| bias.biases[Bias::Latency]);
        let margin = latencies.fold(0.0, |most: f64, latency| most.max(latency.abs())) + 1e-4;
        let span = (first.t as f64 * 1e-6 - margin, last.t as f64 * 1e-6 + margin);
        let bins: Vec<SegmentBins> =
            self.segments.iter().map(|(_, trajectory)| SegmentBins::new(trajectory, span)).collect();
        let parts: Vec<Part> = events
            .par_chunks(CHUNK)
            .map(|events| {
                let mut part = Part::default();
                for event in events {
                    part.report.events += 1;
                    let observation = match &self.ground {
                        BoardGround::Flat(surface) => self.associate(surface, event, &bins, &mut part),
                        BoardGround::Shaped(surface) => self.associate(surface, event, &bins, &mut part),
                    };
                    if let Some(observation) = observation {
                        part.report.kept += 1;
                        part.found.push(observation);
                    }
                }
                part
            })
            .collect();
        for Part { found, far, report } in parts {
            self.report.add(&report);
            for (segment, time) in far {
                if let Some(list) = self.far.get_mut(segment) {
                    list.push(time);
                }
            }
            for (segment, bin, observation) in found {
                if let Some(list) = self.found.get_mut(segment) {
                    list.push((bin, observation));
                }
            }
        }
    }

    fn associate<S: BoardSurface>(
        &self,
        surface: &S,
        event: &RankedEvent,
        bins: &[SegmentBins],
        part: &mut Part,
    ) -> Option<Associated> {
        let settings = self.context.settings;
        let class = EventKind { polarity: event.polarity, place: event.place }.class();
        let bias = self.context.state.bias.get(class)?;
        let time = event.t as f64 * 1e-6 - bias.biases[Bias::Latency];
        let Some((segment, bin, pose)) =
            bins.iter().enumerate().find_map(|(index, bins)| bins.pose(time).map(|(bin, pose)| (index, bin, pose)))
        else {
            part.report.outside_segments += 1;
            return None;
        };
        let trajectory_bin = bins.get(segment)?;
        let dt = time - trajectory_bin.center(bin);
        let pixel = [f64::from(event.x), f64::from(event.y)];
        let ray = self.context.bearings.place(pixel[0], pixel[1]).map(|place| {
            let (bearing, by_pixel) = place.bearing();
            (BoardRay::new(surface, pose, dt, &bearing), by_pixel)
        });
        let seen = ray.filter(|(ray, _)| is_in_front(ray.depth()));
        let seen = seen.map(|(ray, by_pixel)| EventRay { pixel, dt, ray, by_pixel });
        let Some(SeenEdge { index, edge, reach }) = seen.and_then(|seen| self.edge_of(pose, &seen)) else {
            part.report.off_board += 1;
            return None;
        };
        let speed_range = speed_range(edge.passage.normal_speed);
        let band = if self.context.sigma_known {
            (settings.band * bias.sigma[speed_range]).min(WIDEST_BAND)
        } else {
            FIRST_BAND
        };
        let band = band.min(reach);
        let distance = edge.from_expected(bias).abs();
        if distance.is_nan() || distance >= band {
            part.report.far_from_edge += 1;
            part.far.push((segment, time as f32));
            return None;
        }
        let normal_speed = edge.passage.normal_speed;
        let sliding = edge.distance.sliding / edge.distance.scale;
        let speed = (normal_speed * normal_speed + sliding * sliding).sqrt();
        if normal_speed.abs() < SLOWEST_EDGE || normal_speed.abs() < TANGENT * speed {
            part.report.edge_slides += 1;
            return None;
        }
        let predicted = if normal_speed > 0.0 { Polarity::On } else { Polarity::Off };
        if predicted != event.polarity {
            part.report.wrong_polarity += 1;
            return None;
        }
        let observation = EventObservation {
            dt: dt as f32,
            x: event.x,
            y: event.y,
            edge: index,
            class: class as u8,
            speed_range: speed_range as u8,
        };
        Some((segment, bin, observation))
    }

    /// The edge that an event saw.
    fn edge_of<S: BoardSurface>(&self, pose: &PoseBin, event: &EventRay<S>) -> Option<SeenEdge> {
        let radius = self.context.state.board.radius;
        match &self.edges {
            NearestEdge::Rims(board) => {
                let circle = board.nearest_circle(event.ray.point())?;
                let rim = Rim { center: board.circle_center(circle).into(), radius };
                self.seen_edge(pose, event, circle, rim)
            }
            NearestEdge::Lines { places, lines } => {
                let clearance = CLEARANCE * event.ray.widest_pixel(&event.by_pixel);
                let line = places.nearest(event.ray.point().into(), clearance)?;
                self.seen_edge(pose, event, line, Line { radius, ..*lines.get(line)? })
            }
        }
    }

    fn seen_edge<S: BoardSurface>(
        &self,
        pose: &PoseBin,
        event: &EventRay<S>,
        index: usize,
        edge: impl BoardEdge,
    ) -> Option<SeenEdge> {
        let seen = EventEdge::of_event(self.context.bearings, pose, event, edge)?;
        Some(SeenEdge { index: u16::try_from(index).ok()?, reach: edge.reach(seen.distance.scale), edge: seen })
    }

    /// The observations by index of the segment, and the report.
    pub fn finish(self) -> (Vec<(usize, SegmentObservations)>, AssociationReport) {
        let observations = self
            .found
            .into_par_iter()
            .zip(self.far)
            .zip(self.segments.par_iter())
            .map(|((mut found, far), (segment, trajectory))| {
                found.sort_by_key(|(bin, observation)| (*bin, observation.class));
                let events = Vec::with_capacity(found.len());
                let mut observations = SegmentObservations { events, far, ..SegmentObservations::default() };
                for group in found.chunk_by(|a, b| a.0 == b.0) {
                    let Some(&(bin, _)) = group.first() else { continue };
                    let first = observations.events.len();
                    observations.events.extend(group.iter().map(|(_, observation)| *observation));
                    let t = bin_center(trajectory.start(), bin);
                    observations.bins.push(EventBin { t, first, end: observations.events.len() });
                }
                (*segment, observations)
            })
            .collect();
        (observations, self.report)
    }
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

    fn pose(&self, time: f64) -> Option<(u32, &PoseBin)> {
        if self.poses.is_empty() || time < self.start || time > self.end {
            return None;
        }
        let bin = self.bin(time);
        let pose = self.poses.get(bin.checked_sub(self.first)? as usize)?.as_ref()?;
        Some((bin, pose))
    }
}

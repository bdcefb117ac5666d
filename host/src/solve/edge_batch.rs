//! The edges of many events of one time bin at once.
//!
//! The same formulas as for one event ([`EventEdge`]), in steps that alternate between looking up
//! bearings, event by event, and arithmetic on all of them, which the compiler vectorises.

use multiversion::multiversion;

use super::bearing_table::{BearingTable, Place};
use super::board_ray::{BoardRay, EdgeDistance, is_in_front};
use super::event_row::{EventEdge, step_to_edge};
use super::pose_bin::PoseBin;
use super::{Problem, ResidualMeasure};

/// Most events in a batch.
pub const LANES: usize = 64;

type Lane = [f64; LANES];

/// An event as the batch takes it.
#[derive(Clone, Copy, Debug)]
pub struct BatchEvent {
    /// Column and row in pixels.
    pub pixel: (u16, u16),
    /// Seconds after the centre of the bin.
    pub dt: f64,
    /// Index of the circle on the board.
    pub circle: u16,
}

/// Room for a batch.
pub struct EdgeBatch<'a> {
    rays: Rays,
    edges: Edges,
    places: [Option<Place<'a>>; LANES],
}

/// What goes into a pass of arithmetic.
struct Rays {
    dt: Lane,
    center: [Lane; 2],
    bearing: [Lane; 3],
    by_pixel: [[Lane; 3]; 2],
}

/// What comes out of it. Apart from what goes in, so that the compiler sees that they do not overlap.
struct Edges {
    depth: Lane,
    step: [Lane; 2],
    metres: Lane,
    scale: Lane,
    gradient: [Lane; 2],
    by_translation: [Lane; 3],
    by_rotation: [Lane; 3],
    sliding: Lane,
}

impl Edges {
    #[inline(always)]
    fn distance(&self, lane: usize) -> EdgeDistance {
        EdgeDistance {
            metres: self.metres[lane],
            scale: self.scale[lane],
            by_pixel: [self.gradient[0][lane], self.gradient[1][lane]],
            by_translation: std::array::from_fn(|axis| self.by_translation[axis][lane]),
            by_rotation: std::array::from_fn(|axis| self.by_rotation[axis][lane]),
            sliding: self.sliding[lane],
        }
    }
}

impl Default for EdgeBatch<'_> {
    fn default() -> Self {
        let lane = [0.0; LANES];
        Self {
            rays: Rays { dt: lane, center: [lane; 2], bearing: [lane; 3], by_pixel: [[lane; 3]; 2] },
            edges: Edges {
                depth: lane,
                step: [lane; 2],
                metres: lane,
                scale: lane,
                gradient: [lane; 2],
                by_translation: [lane; 3],
                by_rotation: [lane; 3],
                sliding: lane,
            },
            places: [None; LANES],
        }
    }
}

impl<'a> EdgeBatch<'a> {
    /// Visits the edge of each of the first [`LANES`] of `events`, in their order; events whose edge is
    /// not in view are left out. The visitor is told the event's index.
    #[inline(always)]
    pub fn visit(
        &mut self,
        problem: &Problem,
        bearings: &'a BearingTable,
        pose: &PoseBin,
        events: impl ExactSizeIterator<Item = BatchEvent> + Clone,
        mut visit: impl FnMut(usize, &EventEdge<'a>),
    ) {
        let count = events.len().min(LANES);
        for (lane, event) in events.clone().take(LANES).enumerate() {
            let center = problem.circle_centers.get(usize::from(event.circle));
            let place = bearings.place(f64::from(event.pixel.0), f64::from(event.pixel.1));
            self.rays.dt[lane] = event.dt;
            self.take(lane, center.and(place));
            let center = center.copied().unwrap_or_default();
            self.rays.center[0][lane] = center[0];
            self.rays.center[1][lane] = center[1];
        }
        meet(&self.rays, pose, problem.radius, count, &mut self.edges);
        // The second pass overwrites the step.
        let step = self.edges.step;
        if problem.settings.residual == ResidualMeasure::Pixel {
            for (lane, event) in events.take(LANES).enumerate() {
                let (x, y) = (f64::from(event.pixel.0), f64::from(event.pixel.1));
                let met = self.places[lane].is_some() && is_in_front(self.edges.depth[lane]);
                let place = bearings.place(x - step[0][lane], y - step[1][lane]);
                self.take(lane, place.filter(|_| met));
            }
            meet(&self.rays, pose, problem.radius, count, &mut self.edges);
        }
        for lane in 0..count {
            let Some(place) = self.places[lane].filter(|_| is_in_front(self.edges.depth[lane])) else { continue };
            let step = [step[0][lane], step[1][lane]];
            let residual = problem.settings.residual;
            let at_edge = self.edges.distance(lane);
            let edge = EventEdge::new(pose, at_edge, place, step, problem.radius, residual, problem.mean_scale);
            if edge.pixels.is_finite() {
                visit(lane, &edge);
            }
        }
    }

    #[inline(always)]
    fn take(&mut self, lane: usize, place: Option<Place<'a>>) {
        self.places[lane] = place;
        let Some(place) = place else { return };
        let (bearing, by_pixel) = place.bearing();
        let store = |lanes: &mut [Lane; 3], values: [f64; 3]| {
            lanes.iter_mut().zip(values).for_each(|(to, value)| to[lane] = value);
        };
        store(&mut self.rays.bearing, bearing);
        self.rays.by_pixel.iter_mut().zip(by_pixel).for_each(|(lanes, values)| store(lanes, values));
    }
}

/// Board distance of the first `count` lanes, and the step to the edge.
#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn meet(rays: &Rays, pose: &PoseBin, radius: f64, count: usize, edges: &mut Edges) {
    for lane in 0..count.min(LANES) {
        let bearing = [rays.bearing[0][lane], rays.bearing[1][lane], rays.bearing[2][lane]];
        let column = |pixel: usize| {
            [rays.by_pixel[pixel][0][lane], rays.by_pixel[pixel][1][lane], rays.by_pixel[pixel][2][lane]]
        };
        let by_pixel = [column(0), column(1)];
        let center = [rays.center[0][lane], rays.center[1][lane]];
        let ray = BoardRay::new(pose, rays.dt[lane], &bearing);
        let distance = ray.edge_distance(pose, &by_pixel, center, radius);
        let step = step_to_edge(&distance);
        edges.depth[lane] = ray.depth();
        edges.metres[lane] = distance.metres;
        edges.scale[lane] = distance.scale;
        edges.sliding[lane] = distance.sliding;
        let store = |lanes: &mut [Lane], values: &[f64]| {
            lanes.iter_mut().zip(values).for_each(|(to, value)| to[lane] = *value);
        };
        store(&mut edges.gradient, &distance.by_pixel);
        store(&mut edges.step, &step);
        store(&mut edges.by_translation, &distance.by_translation);
        store(&mut edges.by_rotation, &distance.by_rotation);
    }
}

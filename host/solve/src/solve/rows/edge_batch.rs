//! The edges of many events of one time bin at once.
//!
//! Uses the same formulas as for one event ([`super::event_row`]), in loops over all events of the batch, which the compiler
//! vectorises. The table entry of each event's position is read once: the edge is so near that the same slopes determine the
//! bearing there.

use multiversion::multiversion;

use super::bearing_table::{BearingSlopes, BearingTable, CoefficientPlace, ImagePlane, Spot};
use super::board_edge::{BoardEdge, BoardEdges, Line, Rim};
use super::board_ray::{BoardRay, is_in_front};
use super::board_surface::{BoardGround, BoardSurface};
use super::event_row::step_to_edge;
use super::pose_bin::PoseBin;
use crate::solve::BOARD_PARAMETERS;
use crate::solve::Problem;
use crate::solve::rows::event_bias::EdgePassage;
use evcal_geometry::board::shape::BoardShape;

/// Largest number of events in a batch: with all intermediate values they fit into the first-level cache.
pub const LANES: usize = 32;
/// Lanes are processed in groups of this size, so that vectors are full.
pub const GROUP: usize = 8;

/// One number per event.
pub type Lane = [f64; LANES];
/// The same in single precision.
pub type SingleLane = [f32; LANES];

/// Input of the batch for one event.
#[derive(Clone, Copy, Debug)]
pub struct BatchEvent {
    /// Column and row in pixels.
    pub pixel: [f64; 2],
    /// Seconds after the centre of the bin.
    pub dt: f64,
    /// Index of the edge in the board's list of edges.
    pub edge: u16,
}

/// The board as the batch needs it.
#[derive(Clone, Copy)]
pub struct Scene<'a> {
    /// The edges of the board.
    pub edges: &'a BoardEdges,
    /// The surface of the board.
    pub ground: &'a BoardGround,
    /// [`BoardShape::radius`] of the board.
    pub radius: f64,
    /// Metres on the board per unit of the residual, if residuals are measured on the board.
    pub mean_scale: Option<f64>,
}

/// Buffers of a batch.
pub struct EdgeBatch<'a> {
    events: [BatchEvent; LANES],
    spots: [Option<Spot>; LANES],
    rays: Rays,
    to_edge: StepsToEdge,
    edges: Edges,
    cells: [Option<CoefficientPlace<'a>>; LANES],
    count: usize,
}

/// Table values of each event.
struct Rays {
    dt: Lane,
    pixel: [Lane; 2],
    /// For a rim its centre; for a line its normal, offset and width.
    edge: [Lane; 4],
    bearing: [Lane; 3],
    /// Offset from the centre of the cell of the bearing table (px).
    offset_from_cell: [Lane; 2],
    by_pixel: [[SingleLane; 3]; 2],
    by_pixel_twice: [[SingleLane; 3]; 3],
}

/// Steps from the events to their edges.
struct StepsToEdge {
    depth: Lane,
    pixels: [Lane; 2],
}

/// The edges of the events of a batch; see [`super::event_row`].
pub struct Edges {
    depth: Lane,
    /// Signed distance in pixels, positive on the light side.
    pub pixels: Lane,
    /// Metres on the board per pixel across the edge.
    pub scale: Lane,
    /// Derivative of the distance on the board by pixel x and y (metres per pixel).
    pub by_pixel: [Lane; 2],
    /// Derivative of that distance by the camera centre in the world frame.
    pub by_translation: [Lane; 3],
    /// Derivative of that distance by a rotation perturbation in the camera frame (metres per radian).
    pub by_rotation: [Lane; 3],
    /// Derivative of that distance by print ratio and bends of the board.
    pub by_shape: [Lane; BOARD_PARAMETERS - 1],
    /// Offset of the edge from the centre of the cell, in pixels.
    pub offset_from_cell: [Lane; 2],
    /// Derivative of the pixel by fx and fy.
    pub by_focal_length: [Lane; 2],
    normal_speed: Lane,
    narrowness: Lane,
    corner_share: Lane,
    acceleration: Lane,
    /// Speed at which the pixel's ray slides along the edge (m/s).
    pub sliding: Lane,
}

const NOTHING: Lane = [0.0; LANES];
const NOTHING_SINGLE: SingleLane = [0.0; LANES];

impl Edges {
    const EMPTY: Self = Self {
        depth: NOTHING,
        pixels: NOTHING,
        scale: NOTHING,
        by_pixel: [NOTHING; 2],
        by_translation: [NOTHING; 3],
        by_rotation: [NOTHING; 3],
        by_shape: [NOTHING; BOARD_PARAMETERS - 1],
        offset_from_cell: [NOTHING; 2],
        by_focal_length: [NOTHING; 2],
        normal_speed: NOTHING,
        narrowness: NOTHING,
        corner_share: NOTHING,
        acceleration: NOTHING,
        sliding: NOTHING,
    };

    /// Returns the motion of the edge of an event as it passes the event's pixel.
    #[inline(always)]
    pub fn passage(&self, lane: usize) -> EdgePassage {
        EdgePassage {
            normal_speed: self.normal_speed[lane],
            narrowness: self.narrowness[lane],
            corner_share: self.corner_share[lane],
            acceleration: self.acceleration[lane],
        }
    }
}

impl Rays {
    const EMPTY: Self = Self {
        dt: NOTHING,
        pixel: [NOTHING; 2],
        edge: [NOTHING; 4],
        bearing: [NOTHING; 3],
        offset_from_cell: [NOTHING; 2],
        by_pixel: [[NOTHING_SINGLE; 3]; 2],
        by_pixel_twice: [[NOTHING_SINGLE; 3]; 3],
    };

    /// Returns the ray of an event's pixel shifted by `offset` pixels, and the derivative of its bearing by pixel x and y.
    #[inline(always)]
    fn ray<S: BoardSurface>(
        &self,
        surface: &S,
        pose: &PoseBin,
        lane: usize,
        offset: [f64; 2],
    ) -> (BoardRay<S>, [[f64; 3]; 2]) {
        let vector = |lanes: &[SingleLane; 3]| [lanes[0][lane], lanes[1][lane], lanes[2][lane]];
        let [x, y] = &self.by_pixel;
        let [xx, xy, yy] = &self.by_pixel_twice;
        let slopes =
            BearingSlopes { by_pixel: [vector(x), vector(y)], by_pixel_twice: [vector(xx), vector(xy), vector(yy)] };
        let from_center = [0, 1].map(|axis| self.offset_from_cell[axis][lane] + offset[axis]);
        let bearing = [self.bearing[0][lane], self.bearing[1][lane], self.bearing[2][lane]];
        let (bearing, by_pixel) = slopes.bearing(bearing, from_center);
        (BoardRay::new(surface, pose, self.dt[lane], &bearing), by_pixel)
    }
}

impl Default for EdgeBatch<'_> {
    fn default() -> Self {
        Self {
            events: [BatchEvent { pixel: [0.0; 2], dt: 0.0, edge: 0 }; LANES],
            spots: [None; LANES],
            rays: Rays::EMPTY,
            to_edge: StepsToEdge { depth: NOTHING, pixels: [NOTHING; 2] },
            edges: Edges::EMPTY,
            cells: [None; LANES],
            count: 0,
        }
    }
}

impl<'a> EdgeBatch<'a> {
    /// Finds the edges of the first [`LANES`] of `events` on a board of this `shape`.
    #[inline(always)]
    pub fn find(
        &mut self,
        problem: &Problem,
        shape: &BoardShape,
        bearings: &'a BearingTable,
        pose: &PoseBin,
        events: impl Iterator<Item = BatchEvent>,
    ) {
        let ground = &BoardGround::of_problem(problem, shape);
        let scene = Scene { edges: &problem.edges, ground, radius: shape.radius, mean_scale: problem.residual_scale() };
        self.find_in::<true>(&scene, bearings, pose, events);
    }

    /// Finds the edges as [`EdgeBatch::find`] does, in a `scene`. Derivatives by the coefficients of the camera model
    /// are fetched only with `COEFFICIENTS`.
    #[inline(always)]
    pub fn find_in<const COEFFICIENTS: bool>(
        &mut self,
        scene: &Scene,
        bearings: &'a BearingTable,
        pose: &PoseBin,
        events: impl Iterator<Item = BatchEvent>,
    ) {
        self.count = 0;
        let mut touched = 0.0;
        for (lane, event) in events.take(LANES).enumerate() {
            self.events[lane] = event;
            let spot = bearings.spot(event.pixel[0], event.pixel[1]);
            self.spots[lane] = spot;
            // The table is read in random order. This loop is so short that many reads are in flight at once; the next loop would
            // wait for each.
            touched += spot.map_or(0.0, |spot| bearings.touch(spot));
            if COEFFICIENTS {
                touched += spot.map_or(0.0, |spot| bearings.touch_coefficients(spot));
            }
            self.count = lane + 1;
        }
        std::hint::black_box(touched);
        for lane in 0..self.count {
            self.take(lane, scene, bearings);
        }
        match scene.ground {
            BoardGround::Flat(surface) => self.find_on(surface, scene, bearings.plane(), pose),
            BoardGround::Shaped(surface) => self.find_on(surface, scene, bearings.plane(), pose),
        }
        for (lane, cell) in self.cells.iter_mut().take(self.count).enumerate() {
            let is_in_view = is_in_front(self.to_edge.depth[lane])
                && is_in_front(self.edges.depth[lane])
                && self.edges.pixels[lane].is_finite();
            *cell = cell.filter(|_| is_in_view);
        }
    }

    #[inline(always)]
    fn find_on<S: BoardSurface>(&mut self, surface: &S, scene: &Scene, plane: &ImagePlane, pose: &PoseBin) {
        match scene.edges {
            BoardEdges::Rims(_) => self.find_edges::<S, Rim>(surface, scene, plane, pose),
            BoardEdges::Lines(_) => self.find_edges::<S, Line>(surface, scene, plane, pose),
        }
    }

    #[inline(always)]
    fn find_edges<S: BoardSurface, E: LaneEdge>(
        &mut self,
        surface: &S,
        scene: &Scene,
        plane: &ImagePlane,
        pose: &PoseBin,
    ) {
        let lanes = self.count.next_multiple_of(GROUP);
        let &Scene { radius, mean_scale, .. } = scene;
        match mean_scale {
            None => steps_to_edge::<S, E>(&self.rays, surface, pose, radius, lanes, &mut self.to_edge),
            Some(_) => self.to_edge = StepsToEdge { depth: [1.0; LANES], pixels: [NOTHING; 2] },
        }
        let view = EdgeView { pose, radius, plane, mean_scale };
        edges::<S, E>(&self.rays, surface, view, &self.to_edge, lanes, &mut self.edges);
    }

    /// Returns the edges of the last call of `find`.
    pub fn edges(&self) -> &Edges {
        &self.edges
    }

    /// Returns the cell of the bearing table for each event; `None` if its edge is not in view.
    pub fn cells(&self) -> &[Option<CoefficientPlace<'a>>] {
        self.cells.get(..self.count).unwrap_or_default()
    }

    #[inline(always)]
    fn take(&mut self, lane: usize, scene: &Scene, bearings: &'a BearingTable) {
        let rays = &mut self.rays;
        let event = &self.events[lane];
        let place = self.spots[lane].and_then(|spot| {
            Some((bearings.place_at(spot, event.pixel[0], event.pixel[1])?, bearings.coefficients(spot)?))
        });
        let edge = match scene.edges {
            BoardEdges::Rims(centers) => centers.get(usize::from(event.edge)).map(|&[x, y]| [x, y, 0.0, 0.0]),
            BoardEdges::Lines(lines) => lines.get(usize::from(event.edge)).map(Line::numbers),
        };
        self.cells[lane] = None;
        let (Some((place, coefficients)), Some(edge)) = (place, edge) else { return };
        self.cells[lane] = Some(coefficients);
        rays.dt[lane] = event.dt;
        let put = |lanes: &mut [Lane; 2], values: &[f64; 2]| {
            lanes.iter_mut().zip(values).for_each(|(lanes, value)| lanes[lane] = *value);
        };
        put(&mut rays.pixel, &event.pixel);
        rays.edge.iter_mut().zip(edge).for_each(|(lanes, value)| lanes[lane] = value);
        put(&mut rays.offset_from_cell, &place.offset);
        for (lanes, value) in rays.bearing.iter_mut().zip(place.center) {
            lanes[lane] = *value;
        }
        let BearingSlopes { by_pixel, by_pixel_twice } = place.slopes;
        let slopes = by_pixel.as_flattened().iter().chain(by_pixel_twice.as_flattened());
        let lanes = rays.by_pixel.as_flattened_mut().iter_mut().chain(rays.by_pixel_twice.as_flattened_mut());
        lanes.zip(slopes).for_each(|(lanes, slope)| lanes[lane] = *slope);
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn steps_to_edge<S: BoardSurface, E: LaneEdge>(
    rays: &Rays,
    surface: &S,
    pose: &PoseBin,
    radius: f64,
    lanes: usize,
    found: &mut StepsToEdge,
) {
    for lane in 0..lanes.min(LANES) {
        let (ray, by_pixel) = rays.ray(surface, pose, lane, [0.0; 2]);
        let [x, y] = step_to_edge(&ray.edge_distance(pose, &by_pixel, E::of_lane(&rays.edge, lane, radius)));
        found.depth[lane] = ray.depth();
        found.pixels[0][lane] = x;
        found.pixels[1][lane] = y;
    }
}

/// An edge whose numbers are stored in lanes.
trait LaneEdge: BoardEdge {
    /// Returns the edge of a lane on a board with this [`BoardShape::radius`].
    fn of_lane(lanes: &[Lane; 4], lane: usize, radius: f64) -> Self;
}

impl LaneEdge for Rim {
    #[inline(always)]
    fn of_lane(lanes: &[Lane; 4], lane: usize, radius: f64) -> Self {
        Self { center: [lanes[0][lane], lanes[1][lane]], radius }
    }
}

impl LaneEdge for Line {
    #[inline(always)]
    fn of_lane(lanes: &[Lane; 4], lane: usize, radius: f64) -> Self {
        let normal = [lanes[0][lane], lanes[1][lane]];
        Self { normal, offset: lanes[2][lane], dark_width: lanes[3][lane], radius }
    }
}

impl Line {
    /// Returns normal, offset and width.
    fn numbers(&self) -> [f64; 4] {
        [self.normal[0], self.normal[1], self.offset, self.dark_width]
    }
}

/// An edge as seen from one pose.
#[derive(Clone, Copy)]
struct EdgeView<'a> {
    pose: &'a PoseBin,
    radius: f64,
    plane: &'a ImagePlane,
    /// Metres on the board per unit of the residual, if it is the same for all events.
    mean_scale: Option<f64>,
}

#[multiversion(targets("x86_64+avx512f+avx512vl", "x86_64+avx2", "x86_64+avx"))]
fn edges<S: BoardSurface, E: LaneEdge>(
    rays: &Rays,
    surface: &S,
    view: EdgeView,
    to_edge: &StepsToEdge,
    lanes: usize,
    found: &mut Edges,
) {
    let EdgeView { pose, radius, plane, mean_scale } = view;
    for lane in 0..lanes.min(LANES) {
        let step = [to_edge.pixels[0][lane], to_edge.pixels[1][lane]];
        let (ray, by_pixel) = rays.ray(surface, pose, lane, [-step[0], -step[1]]);
        let edge = E::of_lane(&rays.edge, lane, radius);
        let distance = ray.edge_distance(pose, &by_pixel, edge);
        let at = [rays.pixel[0][lane] - step[0], rays.pixel[1][lane] - step[1]];
        let passage = EdgePassage::new(pose, &distance, plane.corner_share(at), edge);
        let by_focal_length = plane.by_focal_length(at);
        let by_shape = ray.by_shape(&distance);
        found.depth[lane] = ray.depth();
        found.pixels[lane] = distance.beyond(step) / mean_scale.unwrap_or(distance.scale);
        found.scale[lane] = distance.scale;
        for axis in 0..2 {
            found.by_pixel[axis][lane] = distance.by_pixel[axis];
            found.offset_from_cell[axis][lane] = rays.offset_from_cell[axis][lane] - step[axis];
            found.by_focal_length[axis][lane] = by_focal_length[axis];
        }
        for (axis, by_shape) in by_shape.into_iter().enumerate() {
            found.by_translation[axis][lane] = distance.by_translation[axis];
            found.by_rotation[axis][lane] = distance.by_rotation[axis];
            found.by_shape[axis][lane] = by_shape;
        }
        found.normal_speed[lane] = passage.normal_speed;
        found.narrowness[lane] = passage.narrowness;
        found.corner_share[lane] = passage.corner_share;
        found.acceleration[lane] = passage.acceleration;
        found.sliding[lane] = distance.sliding;
    }
}

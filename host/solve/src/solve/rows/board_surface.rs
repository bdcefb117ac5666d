//! The surface of the board that rays meet: a plane, or the shape that the solve estimated.
//!
//! The plane has its own type, separate from a [`Surface`] that happens to be flat, because nearly all boards are flat and the
//! joint solve spends most of its time here.

use crate::solve::BOARD_PARAMETERS;
use crate::solve::Problem;
use evcal_geometry::board::Board;
use evcal_geometry::board::shape::{BoardShape, CircleArea, Surface};

/// A surface with a print on it. Points are positions on the print, in metres.
pub trait BoardSurface: Copy + Send + Sync {
    /// Slope of the surface at a point.
    type Slope: Copy;

    /// Intersects the ray from `camera` along `direction` with the surface.
    fn meet(&self, camera: &[f64; 3], direction: &[f64; 3]) -> (RayMeeting, Self::Slope);

    /// Returns the component of `vector` along (−slope, 1), which is normal to the surface.
    fn across(slope: Self::Slope, vector: &[f64; 3]) -> f64;

    /// Returns the derivative by the camera centre of a function of the print. `gradient` is its derivative by the
    /// point, and `along` its change along the ray per metre across the surface.
    fn by_camera(slope: Self::Slope, gradient: [f64; 2], along: f64) -> [f64; 3];

    /// Converts a derivative by a position on the print to one by a point on the board, and a velocity on the board to one on the
    /// print.
    fn scaled(&self, vector: [f64; 2]) -> [f64; 2];

    /// Returns the derivatives by print ratio and bends of the distance from an edge, at `point` of the print. `normal`
    /// is the gradient of the distance on the print, `by_height` its derivative by the height of the camera.
    fn by_shape(&self, point: [f64; 2], normal: [f64; 2], by_height: f64) -> [f64; BOARD_PARAMETERS - 1];
}

/// Intersection of a ray with a board.
#[derive(Clone, Copy, Debug)]
pub struct RayMeeting {
    /// Length along the ray's direction.
    pub depth: f64,
    /// One over the component of the direction normal to the surface.
    pub inverse: f64,
    /// Position on the print.
    pub point: [f64; 2],
}

/// A flat board with the nominal scale.
#[derive(Clone, Copy, Debug)]
pub struct FlatBoard {
    area: CircleArea,
}

/// A board whose shape differs from the nominal one.
#[derive(Clone, Copy, Debug)]
pub struct ShapedBoard {
    area: CircleArea,
    surface: Surface,
    print_ratio: f64,
}

/// Either of the two surfaces.
#[derive(Clone, Copy, Debug)]
pub enum BoardGround {
    /// Flat, with the nominal scale.
    Flat(FlatBoard),
    /// Bent, or with another ratio of the scales.
    Shaped(ShapedBoard),
}

impl BoardGround {
    /// Returns the surface of a board with circles in `area` and of this `shape`.
    pub fn new(area: &CircleArea, shape: &BoardShape) -> Self {
        let area = *area;
        if shape.is_flat() {
            return Self::Flat(FlatBoard { area });
        }
        Self::Shaped(ShapedBoard { area, surface: Surface::new(&area, shape), print_ratio: shape.print_ratio })
    }

    /// Returns the surface of a `problem`'s board.
    pub fn of_problem(problem: &Problem, shape: &BoardShape) -> Self {
        Self::new(&problem.area, shape)
    }

    /// Returns the surface of `board` with this `shape`.
    pub fn of_board(board: &Board, shape: &BoardShape) -> Self {
        Self::new(&CircleArea::new(board), shape)
    }
}

/// Returns the derivatives by print ratio and bends at `place` relative to the middle of the board, on a print with ratio
/// `print_ratio`; `rise` is the derivative of the surface's height by the bends.
#[inline(always)]
fn by_shape(place: [f64; 2], print_ratio: f64, rise: [f64; 2], normal: [f64; 2], by_height: f64) -> [f64; 3] {
    let by_ratio = (normal[1] * place[1] - normal[0] * place[0]) * (0.5 / print_ratio);
    [by_ratio, -by_height * rise[0], -by_height * rise[1]]
}

impl BoardSurface for FlatBoard {
    type Slope = ();

    #[inline(always)]
    fn meet(&self, camera: &[f64; 3], direction: &[f64; 3]) -> (RayMeeting, ()) {
        let inverse = 1.0 / direction[2];
        let depth = -camera[2] * inverse;
        let point = [camera[0] + depth * direction[0], camera[1] + depth * direction[1]];
        (RayMeeting { depth, inverse, point }, ())
    }

    #[inline(always)]
    fn across((): (), vector: &[f64; 3]) -> f64 {
        vector[2]
    }

    #[inline(always)]
    fn by_camera((): (), gradient: [f64; 2], along: f64) -> [f64; 3] {
        [gradient[0], gradient[1], -along]
    }

    #[inline(always)]
    fn scaled(&self, vector: [f64; 2]) -> [f64; 2] {
        vector
    }

    #[inline(always)]
    fn by_shape(&self, point: [f64; 2], normal: [f64; 2], by_height: f64) -> [f64; 3] {
        let place = [point[0] - self.area.middle[0], point[1] - self.area.middle[1]];
        by_shape(place, 1.0, self.area.rise(point), normal, by_height)
    }
}

impl BoardSurface for ShapedBoard {
    type Slope = [f64; 2];

    #[inline(always)]
    fn meet(&self, camera: &[f64; 3], direction: &[f64; 3]) -> (RayMeeting, [f64; 2]) {
        let met = self.surface.meet(camera, direction);
        let point = self.surface.to_print(met.point);
        (RayMeeting { depth: met.depth, inverse: met.inverse, point }, met.slope)
    }

    #[inline(always)]
    fn across(slope: [f64; 2], vector: &[f64; 3]) -> f64 {
        vector[2] - slope[0] * vector[0] - slope[1] * vector[1]
    }

    #[inline(always)]
    fn by_camera(slope: [f64; 2], gradient: [f64; 2], along: f64) -> [f64; 3] {
        [gradient[0] + along * slope[0], gradient[1] + along * slope[1], -along]
    }

    #[inline(always)]
    fn scaled(&self, vector: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.surface.per_scale();
        [vector[0] * x, vector[1] * y]
    }

    #[inline(always)]
    fn by_shape(&self, point: [f64; 2], normal: [f64; 2], by_height: f64) -> [f64; 3] {
        let middle = self.area.middle;
        let place = [point[0] - middle[0], point[1] - middle[1]];
        let [x, y] = self.surface.per_scale();
        let on_board = [middle[0] + place[0] / x, middle[1] + place[1] / y];
        by_shape(place, self.print_ratio, self.area.rise(on_board), normal, by_height)
    }
}

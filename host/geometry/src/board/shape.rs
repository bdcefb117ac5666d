//! Deviations of a printed board from its description: scale of the print, bending, radius of the circles or width of
//! dark squares.
//!
//! The print is a plane with coordinates (u, v), on which circles are round and lie on the nominal lattice. On the
//! board it is stretched about the middle of its circles by √q along x and 1/√q along y, with the print ratio q, and
//! lies on
//!
//! z = k_x (1 − x̄²) + k_y (1 − ȳ²),
//!
//! where x̄ and ȳ range from −1 to 1 over the area of the circle centres (as in mrcal). A camera in front of the board
//! is at z < 0, so a board with positive k is concave as seen from the camera: its edges are nearer than its middle.
//! The bent surface is longer than the print, by about 2k²/(3a) over half the width a: 0.05 mm for k = 4 mm and a = 0.2
//! m. This difference is neglected.

use serde::{Deserialize, Serialize};

use super::Board;

/// Number of parameters of a shape: print ratio, bend along x, bend along y, radius.
pub const PARAMETERS: usize = 4;

/// Deviations from the description of a board.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardShape {
    /// Scale of the print along x divided by the scale along y; their geometric mean is 1.
    pub print_ratio: f64,
    /// Distance by which the middle is farther from a camera in front than the edges, along x and along y, in metres.
    pub bend: [f64; 2],
    /// Radius of the circles in metres; for a board of squares, half the width of a dark square or module.
    pub radius: f64,
}

impl BoardShape {
    /// Returns the nominal shape of a board.
    pub fn nominal(board: &Board) -> Self {
        Self { print_ratio: 1.0, bend: [0.0; 2], radius: board.print_radius() }
    }

    /// Returns print ratio, bend along x, bend along y, radius.
    pub fn parameters(&self) -> [f64; PARAMETERS] {
        [self.print_ratio, self.bend[0], self.bend[1], self.radius]
    }

    /// Creates the shape with these parameters.
    pub fn from_parameters([print_ratio, bend_x, bend_y, radius]: [f64; PARAMETERS]) -> Self {
        Self { print_ratio, bend: [bend_x, bend_y], radius }
    }

    /// Returns `true` if the print is true to scale and flat.
    pub fn is_flat(&self) -> bool {
        self.print_ratio == 1.0 && self.bend == [0.0; 2]
    }

    /// Returns `true` if all factors and lengths are plausible for `board`.
    pub fn is_possible(&self, board: &Board) -> bool {
        let side = board.longer_side();
        (0.5..2.0).contains(&self.print_ratio)
            && self.bend.iter().all(|bend| bend.abs() < 0.5 * side)
            && self.radius > 0.0
            && 2.0 * self.radius < board.print_period()
    }
}

/// The area that the centres of a board's circles cover.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleArea {
    /// Its middle, in metres.
    pub middle: [f64; 2],
    /// Half its width and height, in metres.
    pub half: [f64; 2],
}

impl CircleArea {
    /// Returns the area of `board`.
    pub fn new(board: &Board) -> Self {
        let (low, high) = board.extent();
        Self { middle: (0.5 * (low + high)).into(), half: (0.5 * (high - low)).into() }
    }

    /// Returns 1 − x̄² and 1 − ȳ² at `point` (metres on the board): the height of the surface there per metre of bend.
    #[inline(always)]
    pub fn rise(&self, point: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let place = (point[axis] - self.middle[axis]) / self.half[axis];
            1.0 - place * place
        })
    }
}

/// The surface of a print of some shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    middle: [f64; 2],
    /// Metres on the board per metre of the print, along x and y, and the reciprocals.
    scale: [f64; 2],
    per_scale: [f64; 2],
    /// Height of the middle in metres.
    height: f64,
    /// Bend divided by the square of half the side, per metre.
    curvature: [f64; 2],
}

/// Intersection of a ray with a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meeting {
    /// Length along the ray, in units of its direction's length (metres). NaN if there is no intersection.
    pub depth: f64,
    /// Reciprocal of the component of the direction along (−slope, 1).
    pub inverse: f64,
    /// The point without its height, in metres.
    pub point: [f64; 2],
    /// Slope of the surface there along x and y.
    pub slope: [f64; 2],
}

impl Surface {
    /// Creates the surface of a board with circles in `area` and of this `shape`.
    pub fn new(area: &CircleArea, shape: &BoardShape) -> Self {
        let root = shape.print_ratio.sqrt();
        Self {
            middle: area.middle,
            scale: [root, 1.0 / root],
            per_scale: [1.0 / root, root],
            height: shape.bend[0] + shape.bend[1],
            curvature: std::array::from_fn(|axis| shape.bend[axis] / (area.half[axis] * area.half[axis])),
        }
    }

    /// Returns the intersection of the surface with the ray from `camera` along `direction`.
    ///
    /// It is the root of a t² + b t + c = 0 that stays finite for a plane, t = −2c / (b ± √(b² − 4ac)). The square root
    /// with its sign is also the component of the direction along (−slope, 1).
    #[inline(always)]
    pub fn meet(&self, camera: &[f64; 3], direction: &[f64; 3]) -> Meeting {
        let [x, y] = [camera[0] - self.middle[0], camera[1] - self.middle[1]];
        let [curved_x, curved_y] = self.curvature;
        let a = curved_x * direction[0] * direction[0] + curved_y * direction[1] * direction[1];
        let b = direction[2] + 2.0 * (curved_x * x * direction[0] + curved_y * y * direction[1]);
        let c = camera[2] - self.height + curved_x * x * x + curved_y * y * y;
        let root = (b * b - 4.0 * a * c).sqrt().copysign(b);
        let depth = -2.0 * c / (b + root);
        let point = [camera[0] + depth * direction[0], camera[1] + depth * direction[1]];
        let slope = [-2.0 * curved_x * (point[0] - self.middle[0]), -2.0 * curved_y * (point[1] - self.middle[1])];
        Meeting { depth, inverse: 1.0 / root, point, slope }
    }

    /// Returns metres of the print per metre on the board, along x and y.
    #[inline(always)]
    pub fn per_scale(&self) -> [f64; 2] {
        self.per_scale
    }

    /// Converts a `point` on the board to its position on the print.
    #[inline(always)]
    pub fn to_print(&self, point: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|axis| (point[axis] - self.middle[axis]) * self.per_scale[axis] + self.middle[axis])
    }

    /// Returns the position in space of a `place` on the print.
    pub fn place(&self, place: [f64; 2]) -> [f64; 3] {
        let offset: [f64; 2] = std::array::from_fn(|axis| (place[axis] - self.middle[axis]) * self.scale[axis]);
        let fall = self.curvature[0] * offset[0] * offset[0] + self.curvature[1] * offset[1] * offset[1];
        [offset[0] + self.middle[0], offset[1] + self.middle[1], self.height - fall]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board() -> Board {
        "acircles:9x4:55mm:r17.5mm".parse().unwrap()
    }

    #[test]
    fn the_middle_of_a_bent_board_is_behind_its_edges_by_the_bend() {
        let (board, bend) = (board(), [0.003, -0.001]);
        let area = CircleArea::new(&board);
        let surface = Surface::new(&area, &BoardShape { bend, ..BoardShape::nominal(&board) });
        let height =
            |x: f64, y: f64| surface.place([area.middle[0] + x * area.half[0], area.middle[1] + y * area.half[1]])[2];
        assert!((height(0.0, 0.0) - height(1.0, 0.0) - bend[0]).abs() < 1e-12);
        assert!((height(0.0, 0.0) - height(0.0, -1.0) - bend[1]).abs() < 1e-12);
        assert!(height(1.0, 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_ray_to_a_point_of_the_surface_meets_it_there() {
        let board = board();
        let area = CircleArea::new(&board);
        let shape = BoardShape { print_ratio: 1.01, bend: [0.004, -0.02], ..BoardShape::nominal(&board) };
        let surface = Surface::new(&area, &shape);
        for index in 0..200 {
            let place = [0.003 * f64::from(index % 17) - 0.01, 0.031 * f64::from(index / 17) - 0.02];
            let point = surface.place(place);
            let camera = [0.4 - 0.004 * f64::from(index), 0.1, -0.7];
            let direction: [f64; 3] = std::array::from_fn(|axis| point[axis] - camera[axis]);
            let met = surface.meet(&camera, &direction);
            assert!((met.depth - 1.0).abs() < 1e-12, "{met:?}");
            let found = surface.to_print(met.point);
            assert!((found[0] - place[0]).abs() < 1e-12 && (found[1] - place[1]).abs() < 1e-12);
            let step = 1e-6;
            for axis in 0..2 {
                let mut moved = met.point;
                moved[axis] += step;
                let rise = surface.place(surface.to_print(moved))[2] - point[2];
                assert!((rise / step - met.slope[axis]).abs() < 1e-5, "{axis} {rise}");
            }
            let along = direction[2] - met.slope[0] * direction[0] - met.slope[1] * direction[1];
            assert!((met.inverse * along - 1.0).abs() < 1e-9);
        }
    }
}

//! The edges of a print: the rims of circles, and the straight lines between dark and light squares.
//!
//! An event occurs when an edge passes its pixel. The solve needs four properties of an edge: the signed distance of a point on the
//! print from it (positive on the light side), the gradient of this distance, the curvature of the edge, and the width of the dark print
//! at it.

use evcal_geometry::board::squares::edges::{Axis, Edge, Side, SquareEdges};
use evcal_geometry::board::symmetry::Symmetry;
use evcal_geometry::board::{Board, CircleBoard};
use nalgebra::{Vector2, Vector3};

/// An edge of the print.
pub trait BoardEdge: Copy + Send + Sync {
    /// Returns the distance of a `point` on the print (metres).
    fn distance(&self, point: [f64; 2]) -> PrintDistance;

    /// Returns the inverse of the size of the dark print at the edge (1/px), the radius of a dot or the width of a dark strip; a pixel
    /// is `scale` metres.
    fn narrowness(&self, scale: f64) -> f64;

    /// Returns the second derivative by time of the distance in pixels, at a pixel that slides along the edge with `sliding` m/s (px/s²).
    fn acceleration(&self, sliding: f64, scale: f64) -> f64;
}

/// Distance of a point on the print from an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrintDistance {
    /// Distance in metres, positive on the light side.
    pub metres: f64,
    /// Direction on the print in which the distance increases.
    pub normal: [f64; 2],
}

/// The rim of a dark circle.
#[derive(Clone, Copy, Debug)]
pub struct Rim {
    /// Centre in metres.
    pub center: [f64; 2],
    /// Radius in metres.
    pub radius: f64,
}

impl BoardEdge for Rim {
    #[inline(always)]
    fn distance(&self, point: [f64; 2]) -> PrintDistance {
        let (x, y) = (point[0] - self.center[0], point[1] - self.center[1]);
        let distance = (x * x + y * y).sqrt();
        let inverse = 1.0 / distance;
        PrintDistance { metres: distance - self.radius, normal: [x * inverse, y * inverse] }
    }

    #[inline(always)]
    fn narrowness(&self, scale: f64) -> f64 {
        scale / self.radius
    }

    #[inline(always)]
    fn acceleration(&self, sliding: f64, scale: f64) -> f64 {
        sliding * sliding / (self.radius * scale)
    }
}

/// A straight edge between dark and light, along x or y.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Direction on the print from the dark side to the light one.
    pub normal: [f64; 2],
    /// Position of the edge along `normal`, minus half the nominal width of a dark square (m). With [`Line::radius`] added, it is the
    /// position of the printed edge.
    pub offset: f64,
    /// Width of the dark strip at the edge (m).
    pub dark_width: f64,
    /// Half the width of a dark square: [`BoardShape::radius`](evcal_geometry::board::shape::BoardShape::radius) (m).
    pub radius: f64,
}

impl BoardEdge for Line {
    #[inline(always)]
    fn distance(&self, point: [f64; 2]) -> PrintDistance {
        let along = self.normal[0] * point[0] + self.normal[1] * point[1];
        PrintDistance { metres: along - self.offset - self.radius, normal: self.normal }
    }

    #[inline(always)]
    fn narrowness(&self, scale: f64) -> f64 {
        scale / self.dark_width
    }

    #[inline(always)]
    fn acceleration(&self, _sliding: f64, _scale: f64) -> f64 {
        0.0
    }
}

/// All edges of a board; events refer to them by index.
#[derive(Clone, Debug)]
pub enum BoardEdges {
    /// Rims of circles, with their centres in metres; their radius is in the shape of the board.
    Rims(Vec<[f64; 2]>),
    /// Lines.
    Lines(Vec<Line>),
}

impl BoardEdges {
    /// Returns the edges of `board`.
    pub fn of_board(board: &Board) -> Self {
        match board {
            Board::Circles(circles) => {
                Self::Rims((0..circles.circle_count()).map(|index| circles.circle_center(index).into()).collect())
            }
            Board::Squares(squares) => Self::Lines(lines(&SquareEdges::new(&squares.raster()), board.print_radius())),
        }
    }

    /// Returns, for each edge, the index of the edge onto which a rotation of the board onto itself maps it. Pieces of one line are
    /// equivalent here.
    pub fn turned(&self, turn: &Symmetry) -> Vec<u16> {
        match self {
            Self::Rims(_) => turn.points.clone(),
            Self::Lines(lines) => {
                let place = |line: &Line| {
                    let normal = (turn.pose.rotation * Vector3::new(line.normal[0], line.normal[1], 0.0)).xy();
                    let offset = line.offset + normal.dot(&turn.pose.translation.vector.xy());
                    let distance = |other: &Line| {
                        let turned = (Vector2::from(other.normal) - normal).norm() * line.dark_width;
                        turned.max((other.offset - offset).abs()).max((other.dark_width - line.dark_width).abs())
                    };
                    let nearest = lines.iter().map(distance).enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
                    nearest.map_or(0, |(index, _)| index as u16)
                };
                lines.iter().map(place).collect()
            }
        }
    }
}

/// Search for the edge that an event belongs to.
#[derive(Clone, Debug)]
pub enum NearestEdge {
    /// Among the rims of circles.
    Rims(CircleBoard),
    /// Among lines at these positions on the print.
    Lines(SquareEdges),
}

impl NearestEdge {
    /// Returns the search among the edges of `board`.
    pub fn of_board(board: &Board) -> Self {
        match board {
            Board::Circles(circles) => Self::Rims(*circles),
            Board::Squares(squares) => Self::Lines(SquareEdges::new(&squares.raster())),
        }
    }
}

/// Returns the lines at `places`; half the nominal width of a dark square is `radius` (m).
fn lines(places: &SquareEdges, radius: f64) -> Vec<Line> {
    let line = |edge: &Edge| {
        let light = match edge.dark {
            Side::Low => 1.0,
            Side::High => -1.0,
        };
        let normal = match edge.across {
            Axis::X => [light, 0.0],
            Axis::Y => [0.0, light],
        };
        Line { normal, offset: light * edge.position - radius, dark_width: edge.dark_width, radius }
    };
    places.edges().iter().map(line).collect()
}

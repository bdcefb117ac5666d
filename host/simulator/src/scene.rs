//! The light that a pixel receives from the board: exact rendering without a pixel grid.
//!
//! The scene is a white sheet with black circles or squares on a grey background. All edges lie in the plane z = 0, so
//! a pixel's radiance is a sum of edge profiles of the sheet and the print, each blurred by the point-spread function,
//! a Gaussian of `point_spread` pixels.
//!
//! Accuracy: the ray through the pixel centre meets the board exactly, for any lens. The distance to a circle's rim or
//! a square's edge follows perspective and lens to second order in the distance, and the blur of a curved rim is exact
//! to second order in blur / radius. Edges of squares are straight and meet at the angle given by the pixel's linear
//! map. For the sheet's edge only that map is used, and its corners are right-angled in the image. A test compares
//! every kind of view with a numeric integral of the point-spread function over the true scene. This accuracy is
//! needed: to determine a focal length to 0.01 %, rims must be correct to 0.002 px.
//!
//! Disturbances ([`super::effects`]) need less accuracy, because nothing is measured from them: a hand, glare, a
//! texture behind the board, and dots of other shapes, whose edges are blurred like straight ones.

mod squares;

use evcal_core::pattern::Layout;
use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

use self::squares::{Footprint, Squares};
use super::dots::Dots;
use super::edge_profile::EdgeProfile;
use super::light::{Glare, Lamp};
use super::rays::Ray;
use super::surroundings::{Hand, Texture};
use super::view::{Gaze, View};
use evcal_geometry::board::shape::{BoardShape, CircleArea, Surface};
use evcal_geometry::board::{Board, CircleBoard, SquareBoard};

/// Radiance of the parts of the scene, and the size of the sheet. White is 1 by convention.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SceneSettings {
    /// Radiance of the sheet.
    pub white: f64,
    /// Radiance of a circle or dark square.
    pub black: f64,
    /// Radiance outside the sheet.
    pub background: f64,
    /// Distance from the outermost circle centres to the sheet's edge, in lattice spacings; for boards of squares from
    /// the outermost squares, in sides of a square or gaps between tags.
    pub margin: f64,
    /// Shape of the dots; boards of squares have none.
    #[serde(default, skip_serializing_if = "Dots::are_circles")]
    pub dots: Dots,
    /// The shape of the printed board, if it differs from the nominal shape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub printed: Option<BoardShape>,
    /// A flickering lamp.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lamp: Option<Lamp>,
    /// A textured room instead of the uniform background.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub texture: Option<Texture>,
    /// A hand over the board.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hand: Option<Hand>,
    /// The reflection of a lamp.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub glare: Option<Glare>,
}

impl Default for SceneSettings {
    fn default() -> Self {
        Self {
            white: 1.0,
            black: 0.08,
            background: 0.35,
            margin: 1.3,
            dots: Dots::Circles,
            printed: None,
            lamp: None,
            texture: None,
            hand: None,
            glare: None,
        }
    }
}

/// A sample of the scene at one pixel and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Radiance, blurred by the point-spread function.
    pub radiance: f64,
    /// Signed distance to the nearest edge in pixels, positive on the inner side; for the edge of a square, positive on
    /// both sides. Far from every edge it is a lower bound of the distance, from the pixel's linear map.
    pub edge: f64,
}

/// The board, prepared for rendering.
#[derive(Clone, Debug)]
pub struct Scene {
    nominal: Board,
    print: Print,
    surface: Option<Surface>,
    settings: SceneSettings,
    lower: Vector2<f64>,
    upper: Vector2<f64>,
    point_spread: f64,
    profile: EdgeProfile,
    per_point_spread: f64,
    middle: Vector2<f64>,
    half_height: f64,
}

/// The printed pattern.
#[derive(Clone, Debug)]
enum Print {
    Circles(Circles),
    Squares(Squares),
}

/// A board of circles.
#[derive(Clone, Debug)]
struct Circles {
    /// The nominal board with its circles as large as printed.
    board: CircleBoard,
    per_spacing: f64,
    per_radius: f64,
    free_distance: f64,
}

impl Circles {
    fn new(nominal: &CircleBoard, radius: f64, dots: Dots) -> Self {
        let board = CircleBoard { radius, ..*nominal };
        // Shapes that are not round extend further than the radius.
        let extent = if dots.are_circles() { board.radius } else { board.radius * std::f64::consts::SQRT_2 };
        Self {
            board,
            per_spacing: 1.0 / board.spacing,
            per_radius: 1.0 / board.radius,
            free_distance: 0.5 * board.neighbour_distance() - extent,
        }
    }

    /// Returns the centre of the circle nearest to `point`, if there is one within about a spacing.
    #[inline]
    fn nearest_center(&self, point: &Vector2<f64>) -> Option<Vector2<f64>> {
        let place = point * self.per_spacing;
        let (x, y) = match self.board.pattern.layout {
            Layout::Symmetric => (nearest(place.x), nearest(place.y)),
            Layout::Asymmetric => {
                let diagonal = nearest(0.5 * (place.x + place.y));
                let antidiagonal = nearest(0.5 * (place.x - place.y));
                (diagonal + antidiagonal, diagonal - antidiagonal)
            }
        };
        self.board.pattern.index_at(x, y)?;
        Some(Vector2::new(f64::from(x), f64::from(y)) * self.board.spacing)
    }
}

/// A white sheet and its print.
struct Sheet {
    print: Print,
    /// Lowest and highest coordinates of the sheet in metres.
    lower: Vector2<f64>,
    upper: Vector2<f64>,
    middle: Vector2<f64>,
    /// Half the shorter side of the print, in metres.
    half_height: f64,
}

impl Sheet {
    fn of_circles(nominal: &CircleBoard, radius: f64, settings: &SceneSettings) -> Self {
        let circles = Circles::new(nominal, radius, settings.dots);
        let board = &circles.board;
        let centers = (0..board.circle_count()).map(|index| board.circle_center(index));
        let corner = centers.fold(Vector2::zeros(), |corner: Vector2<f64>, center| corner.sup(&center));
        let margin = Vector2::repeat((settings.margin * board.spacing).max(board.radius));
        Self {
            middle: 0.5 * corner,
            half_height: 0.5 * corner.min() + board.radius,
            lower: -margin,
            upper: corner + margin,
            print: Print::Circles(circles),
        }
    }

    fn of_squares(nominal: &SquareBoard, half_module: f64, settings: &SceneSettings) -> Self {
        let bounds = nominal.bounds();
        let (low, high) = (Vector2::from(bounds.low), Vector2::from(bounds.high));
        let unit = match nominal {
            SquareBoard::Checkerboard(board) => board.square,
            SquareBoard::Tags(grid) => grid.spacing * grid.tag,
            SquareBoard::Charuco(board) => board.square,
        };
        let further = half_module - 0.5 * nominal.module();
        let margin = Vector2::repeat((settings.margin * unit).max(further));
        Self {
            middle: 0.5 * (low + high),
            half_height: 0.5 * (high - low).min(),
            lower: low - margin,
            upper: high + margin,
            print: Print::Squares(Squares::new(&nominal.raster().widened(further))),
        }
    }
}

impl Scene {
    /// Creates the scene of `board` seen through a point-spread function of `point_spread` pixels (standard deviation).
    pub fn new(nominal: Board, settings: SceneSettings, point_spread: f64) -> Self {
        let printed = settings.printed.unwrap_or(BoardShape::nominal(&nominal));
        let surface = (!printed.is_flat()).then(|| Surface::new(&CircleArea::new(&nominal), &printed));
        let Sheet { print, lower, upper, middle, half_height } = match &nominal {
            Board::Circles(board) => Sheet::of_circles(board, printed.radius, &settings),
            Board::Squares(board) => Sheet::of_squares(board, printed.radius, &settings),
        };
        Self {
            middle,
            half_height,
            nominal,
            print,
            surface,
            settings,
            lower,
            upper,
            point_spread,
            profile: EdgeProfile::new(),
            per_point_spread: 1.0 / point_spread,
        }
    }

    /// Returns the nominal board.
    pub fn nominal_board(&self) -> &Board {
        &self.nominal
    }

    /// Returns `true` if the nearest edge to a pixel remains the nearest while it is visible, so that its distance
    /// determines its speed.
    pub fn has_lone_edges(&self) -> bool {
        matches!(self.print, Print::Circles(_))
    }

    /// Returns the intersection of a ray with the board.
    #[inline(always)]
    fn gaze(&self, view: &View, ray: &Ray) -> Option<Gaze> {
        match &self.surface {
            None => view.gaze(ray),
            Some(surface) => view.gaze_at(ray, surface),
        }
    }

    /// Returns the radiances and the size of the sheet.
    pub fn settings(&self) -> &SceneSettings {
        &self.settings
    }

    /// Returns the distance from an edge, in pixels, beyond which the edge does not change the radiance.
    pub fn reach(&self) -> f64 {
        EdgeProfile::REACH * self.point_spread + 1e-3
    }

    /// Returns the light of the lamps at time `t` (µs), 1 on average.
    #[inline]
    pub fn light(&self, t: f64) -> f64 {
        self.settings.lamp.map_or(1.0, |lamp| lamp.light(t))
    }

    /// Returns the image speed between two views of objects that move on their own, in pixels per second, for a pixel
    /// of about `turn` radians.
    pub fn own_speed(&self, from: &View, to: &View, turn: f64) -> f64 {
        let hand = self.settings.hand.map_or(0.0, |hand| {
            let nearest = from.position.z.abs().min(to.position.z.abs()).max(1e-3);
            hand.top_speed(self.half_height) / (nearest * turn)
        });
        let room = self.settings.texture.map_or(0.0, |texture| {
            let turned = (from.rotation.transpose() * to.rotation).trace();
            let angle = libm::acos((0.5 * (turned - 1.0)).clamp(-1.0, 1.0));
            (texture.drift + angle / (to.time - from.time).max(1e-9)) / turn
        });
        hand + room
    }

    /// Renders the light that a pixel sees from `view`.
    #[inline]
    pub fn sample(&self, view: &View, ray: &Ray) -> Sample {
        let SceneSettings { texture, hand, glare, .. } = self.settings;
        let background = match texture {
            Some(texture) => texture.radiance(&(view.rotation * ray.bearing), view.time),
            None => self.settings.background,
        };
        let mut sample = self.print(view, ray, background);
        if texture.is_some() && sample.edge < -self.reach() {
            // There is always a patch of the room nearby.
            sample.edge = -self.reach() - CLOSE;
        }
        if hand.is_none() && glare.is_none() {
            return sample;
        }
        let Some(gaze) = self.gaze(view, ray) else { return sample };
        if let Some(glare) = glare {
            self.add_glare(&glare, view, &gaze, &mut sample);
        }
        if let Some(hand) = hand {
            self.cover(&hand, view, ray, &gaze, &mut sample);
        }
        sample
    }

    fn add_glare(&self, glare: &Glare, view: &View, gaze: &Gaze, sample: &mut Sample) {
        if self.sheet_depth(&gaze.point) <= 0.0 {
            return;
        }
        let added = glare.radiance(&view.position, &self.middle, &gaze.point);
        if added > 0.0 {
            sample.radiance += added;
            // The spot has no edge, but must be sampled often enough.
            let nearer = sample.edge.abs().min(self.reach() + CLOSE);
            sample.edge = nearer.copysign(sample.edge);
        }
    }

    fn cover(&self, hand: &Hand, view: &View, ray: &Ray, gaze: &Gaze, sample: &mut Sample) {
        let (depth, away) = hand.depth(&gaze.point, &self.middle, self.half_height, view.time);
        let mut edge = depth / gaze.metres_per_pixel(ray);
        if edge.abs() < self.reach() {
            edge = depth / view.jacobian(ray, gaze).tr_mul(&away).norm();
        }
        let share = self.blurred(edge);
        sample.radiance += share * (hand.radiance - sample.radiance);
        if edge.abs() < sample.edge.abs() || edge > self.reach() {
            sample.edge = edge;
        }
    }

    /// Renders the board in front of the `background`. A pixel that does not see the board plane sees the background.
    #[inline]
    fn print(&self, view: &View, ray: &Ray, background: f64) -> Sample {
        let SceneSettings { white, black, .. } = self.settings;
        let Some(gaze) = self.gaze(view, ray) else {
            return Sample { radiance: background, edge: f64::NEG_INFINITY };
        };
        let metres_per_pixel = gaze.metres_per_pixel(ray);
        let reach = self.reach() * metres_per_pixel;
        let sheet = self.sheet_depth(&gaze.point);
        if sheet < -reach {
            return Sample { radiance: background, edge: sheet / metres_per_pixel };
        }
        let circles = match &self.print {
            Print::Squares(squares) => return self.squares(squares, view, ray, &gaze, background),
            Print::Circles(circles) if !self.settings.dots.are_circles() => {
                return self.shape(circles, view, ray, &gaze, background);
            }
            Print::Circles(circles) => circles,
        };
        let nearest = circles.nearest_center(&gaze.point).map(|center| gaze.point - center);
        let circle = nearest.map_or(-circles.free_distance, |offset| circles.board.radius - offset.norm());
        if sheet > reach && circle.abs() > reach {
            let radiance = if circle > 0.0 { black } else { white };
            return Sample { radiance, edge: sheet.min(circle.abs()) / metres_per_pixel };
        }
        let jacobian = view.jacobian(ray, &gaze);
        let (white_share, sheet_edge) =
            if sheet > reach { (1.0, sheet / metres_per_pixel) } else { self.sheet(&gaze.point, &jacobian) };
        let (black_share, circle_edge) = match nearest {
            Some(offset) if circle > -reach => {
                self.circle(circles, view, ray, &(gaze.point - offset), &offset, &jacobian)
            }
            _ => (0.0, circle / metres_per_pixel),
        };
        Sample {
            radiance: background + (white - background) * white_share - (white - black) * black_share,
            edge: if circle_edge.abs() < sheet_edge.abs() { circle_edge } else { sheet_edge },
        }
    }

    /// Renders the board with dots that are not circles, on or near the sheet.
    fn shape(&self, circles: &Circles, view: &View, ray: &Ray, gaze: &Gaze, background: f64) -> Sample {
        let SceneSettings { white, black, dots, .. } = self.settings;
        let jacobian = view.jacobian(ray, gaze);
        let (white_share, sheet_edge) = self.sheet(&gaze.point, &jacobian);
        let metres_per_pixel = gaze.metres_per_pixel(ray);
        let (black_share, edge) = match circles.nearest_center(&gaze.point) {
            Some(center) => {
                let (depth, normal) = dots.depth(&(gaze.point - center), circles.board.radius);
                let bound = depth / metres_per_pixel;
                let edge = if bound.abs() < self.reach() { depth / jacobian.tr_mul(&normal).norm() } else { bound };
                (self.blurred(edge), edge)
            }
            None => (0.0, -circles.free_distance.max(0.0) / metres_per_pixel),
        };
        Sample {
            radiance: background + (white - background) * white_share - (white - black) * black_share,
            edge: if edge.abs() < sheet_edge.abs() { edge } else { sheet_edge },
        }
    }

    /// Renders a board of squares, on or near the sheet.
    fn squares(&self, squares: &Squares, view: &View, ray: &Ray, gaze: &Gaze, background: f64) -> Sample {
        let SceneSettings { white, black, .. } = self.settings;
        let metres_per_pixel = gaze.metres_per_pixel(ray);
        let reach = self.reach() * metres_per_pixel;
        let sheet = self.sheet_depth(&gaze.point);
        let (dark, sides) = squares.clearance(gaze.point.into());
        let free = sides[0].min(sides[1]);
        if sheet > reach && free > reach {
            let radiance = if dark > 0.0 { black } else { white };
            return Sample { radiance, edge: sheet.min(free) / metres_per_pixel };
        }
        let jacobian = view.jacobian(ray, gaze);
        let (white_share, sheet_edge) =
            if sheet > reach { (1.0, sheet / metres_per_pixel) } else { self.sheet(&gaze.point, &jacobian) };
        let gradients = [0, 1].map(|axis| jacobian.row(axis).transpose());
        let slope = gradients.map(|gradient| gradient.norm());
        let edge = (sides[0] / slope[0]).min(sides[1] / slope[1]);
        let black_share = if edge > self.reach() {
            dark
        } else {
            let bend = std::array::from_fn(|axis| {
                let shifted = ray.shifted(&(gradients[axis] / slope[axis]));
                let ahead = self.gaze(view, &shifted).map(|shifted| shifted.point[axis] - gaze.point[axis]);
                ahead.map_or(0.0, |ahead| 2.0 * (ahead - slope[axis]))
            });
            let footprint = Footprint {
                point: gaze.point.into(),
                slope,
                bend,
                correlation: gradients[0].dot(&gradients[1]) / (slope[0] * slope[1]),
                point_spread: self.point_spread,
            };
            squares.dark_share(&footprint, &self.profile)
        };
        Sample {
            radiance: background + (white - background) * white_share - (white - black) * black_share,
            edge: if edge < sheet_edge.abs() { edge } else { sheet_edge },
        }
    }

    /// Returns the distance of `point` from the sheet's edge in metres, positive on the sheet; outside it a lower
    /// bound.
    #[inline]
    fn sheet_depth(&self, point: &Vector2<f64>) -> f64 {
        let low = point - self.lower;
        let high = self.upper - point;
        low.x.min(high.x).min(low.y.min(high.y))
    }

    /// Returns the fraction of the pixel that the sheet covers, and the signed distance to its edge in pixels.
    #[inline]
    fn sheet(&self, point: &Vector2<f64>, jacobian: &Matrix2<f64>) -> (f64, f64) {
        let scale_x = 1.0 / jacobian.row(0).norm();
        let scale_y = 1.0 / jacobian.row(1).norm();
        let sides = [
            (point.x - self.lower.x) * scale_x,
            (self.upper.x - point.x) * scale_x,
            (point.y - self.lower.y) * scale_y,
            (self.upper.y - point.y) * scale_y,
        ];
        let edge = sides.iter().copied().fold(f64::INFINITY, f64::min);
        (sides.iter().map(|&side| self.blurred(side)).product(), edge)
    }

    /// Returns the fraction of the pixel that the circle at `center` covers, and the signed distance to its rim in
    /// pixels. `offset` is the pixel's point relative to the centre.
    #[inline]
    fn circle(
        &self,
        circles: &Circles,
        view: &View,
        ray: &Ray,
        center: &Vector2<f64>,
        offset: &Vector2<f64>,
        jacobian: &Matrix2<f64>,
    ) -> (f64, f64) {
        let (radius, distance) = (circles.board.radius, offset.norm());
        if distance < 1e-9 * radius {
            return (1.0, radius / jacobian.norm());
        }
        // Newton's step to the rim in the pixel's linear map, then the tangent of the rim at that point.
        let gradient = jacobian.tr_mul(offset) / distance;
        let step = gradient * ((radius - distance) / gradient.norm_squared());
        let at_rim = ray.shifted(&step);
        let Some(gaze) = self.gaze(view, &at_rim) else {
            return (self.blurred((radius - distance) / gradient.norm()), (radius - distance) / gradient.norm());
        };
        let offset = gaze.point - center;
        let distance = offset.norm();
        let jacobian = view.jacobian(&at_rim, &gaze);
        let gradient = jacobian.tr_mul(&offset) / distance;
        let per_slope = 1.0 / gradient.norm();
        let edge = (gradient.dot(&step) + radius - distance) * per_slope;
        // A Gaussian that extends along the rim sees the rim's curvature: E[Φ((d − κ t²/2) / σ)] to second order in κ
        // σ, with the tangential offset t and the curvature κ of the rim in the image.
        let stretch = jacobian.determinant() * per_slope * self.point_spread;
        let bend = stretch * stretch * per_slope * circles.per_radius * self.per_point_spread;
        let standard = edge * self.per_point_spread;
        (self.profile.share(standard * (1.0 - 0.25 * bend * bend) - 0.5 * bend), edge)
    }

    #[inline]
    fn blurred(&self, edge: f64) -> f64 {
        self.profile.share(edge * self.per_point_spread)
    }
}

/// If light changes without an edge, an edge is assumed this many pixels beyond the reach.
const CLOSE: f64 = 1.0;

/// Returns the integer nearest to `value`, without the function call that rounding needs on older processors.
#[inline]
fn nearest(value: f64) -> i32 {
    const OFFSET: i32 = 1 << 20;
    (value + (f64::from(OFFSET) + 0.5)) as i32 - OFFSET
}

#[cfg(test)]
mod tests;

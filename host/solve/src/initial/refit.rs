//! Search for one circle in the events around its projection.
//!
//! The projected rim is an ellipse. The distances of nearby events along its normal are measured, and a shift and a change of
//! radius are fitted to them robustly. So a tilted circle needs no circle fit, and the result is the image of the circle's
//! centre, not the centre of the ellipse.

use evcal_core::sensor::Sensor;
use std::f64::consts::TAU;

use evcal_core::camera::Camera;
use evcal_core::event::Polarity;
use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, Vector2, Vector3};

use super::settings::CrossValidationSettings;
use evcal_detection::circles::event_pixel::EventPixel;
use evcal_geometry::board::CircleBoard;

/// Number of points of a projected rim.
const RIM_POINTS: usize = 24;

/// Number of rounds of reweighting.
const ROUNDS: usize = 6;

/// Weight of the prior that centre and radius are as projected, in events: arcs that are too short to determine them do not move.
const PULL: f64 = 0.1;

/// Distance from a projected rim within which events belong to it, for a circle at rest (px).
const RIM_BAND: f64 = 3.0;

/// Largest extension of the band by motion within the window (px).
const MAX_MOTION_BAND: f64 = 4.0;

/// Number of event pixels near a rim for which memory is allocated at once.
const USUAL_EVENTS: usize = 256;

/// Fewest event pixels of each polarity.
const MIN_EVENTS: usize = 5;

/// Distance from which an event counts linearly instead of squared (px).
const HUBER: f64 = 0.7;

/// Largest mean distance of the events from the refitted rim, for a circle at rest (px).
const MAX_FIT_ERROR: f64 = 1.3;

/// Largest standard deviation of the refitted centre in its worst direction (px).
const MAX_CENTER_DEVIATION: f64 = 0.5;

/// A projected circle: `rim(θ) = middle + axes · (cos θ, sin θ)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProjectedCircle {
    /// Image of the circle's centre.
    pub center: Vector2<f64>,
    /// Centre of the ellipse, which is not the image of the centre.
    pub middle: Vector2<f64>,
    /// Columns: two conjugate half axes of the ellipse.
    pub axes: Matrix2<f64>,
    /// Smallest and largest coordinates of the rim.
    pub bounds: [Vector2<f64>; 2],
}

impl ProjectedCircle {
    /// Projects a circle of the board; `None` if a part of it is outside the camera's domain.
    pub fn new(
        camera: &Camera<f64>,
        pose: &Isometry3<f64>,
        center: Vector2<f64>,
        radius: f64,
    ) -> Option<ProjectedCircle> {
        let project = |point: Vector2<f64>| camera.project(&(pose * Point3::new(point.x, point.y, 0.0)).coords);
        let mut rim = [Vector2::zeros(); RIM_POINTS];
        let mut axes = Matrix2::zeros();
        for (index, slot) in rim.iter_mut().enumerate() {
            let angle = TAU * index as f64 / RIM_POINTS as f64;
            let direction = Vector2::new(angle.cos(), angle.sin());
            *slot = project(center + direction * radius)?;
            axes += *slot * direction.transpose() * (2.0 / RIM_POINTS as f64);
        }
        let bounds = rim.iter().fold([rim[0]; 2], |[low, high], point| [low.inf(point), high.sup(point)]);
        // Equal steps on the board are not equal steps on the ellipse, so its middle is the centre of area of the rim, not the
        // mean of its points.
        let origin = rim[0];
        let mut area = 0.0;
        let mut moment = Vector2::zeros();
        for (a, b) in rim.iter().zip(rim.iter().skip(1).chain(rim.iter().take(1))) {
            let (a, b) = (a - origin, b - origin);
            let cross = a.perp(&b);
            area += cross / 2.0;
            moment += (a + b) * (cross / 6.0);
        }
        let middle = origin + moment / area;
        let projected = Self { center: project(center)?, middle, axes, bounds };
        (middle.iter().all(|value| value.is_finite()) && axes.determinant() != 0.0).then_some(projected)
    }

    /// Returns the radius in pixels of the circle with the area of the ellipse.
    pub fn radius(&self) -> f64 {
        self.axes.determinant().abs().sqrt()
    }

    /// Returns half of the ellipse's smaller diameter in pixels.
    fn smaller_radius(&self) -> f64 {
        self.axes.singular_values().min()
    }

    fn inside(&self, sensor: Sensor) -> bool {
        let [low, high] = self.bounds;
        let right = f64::from(sensor.width) - 1.0;
        let bottom = f64::from(sensor.height) - 1.0;
        low.x >= 0.0 && low.y >= 0.0 && high.x <= right && high.y <= bottom
    }
}

/// The pixels of a frame, row by row.
pub struct PixelRows {
    pixels: Vec<EventPixel>,
    row_starts: Vec<usize>,
}

impl PixelRows {
    /// Sorts the pixels of a frame by row.
    pub fn new(pixels: &[EventPixel]) -> Self {
        let mut pixels = pixels.to_vec();
        pixels.sort_unstable_by_key(|pixel| (pixel.y(), pixel.x(), pixel.polarity().index()));
        let rows = pixels.last().map_or(0, |pixel| usize::from(pixel.y()) + 1);
        let row_starts = (0..=rows).map(|row| pixels.partition_point(|pixel| usize::from(pixel.y()) < row)).collect();
        Self { pixels, row_starts }
    }

    /// Returns the pixels in the rectangle from `low` to `high`.
    fn in_rectangle(
        &self,
        low: Vector2<f64>,
        high: Vector2<f64>,
    ) -> impl Iterator<Item = (Vector2<f64>, Polarity)> + '_ {
        // Casts saturate: positions left of or above the sensor become row 0.
        let first = low.y.ceil() as usize;
        let rows = (high.y.floor() as usize + 1).saturating_sub(first);
        let starts = self.row_starts.iter().skip(first);
        starts.zip(self.row_starts.iter().skip(first + 1)).take(rows).flat_map(move |(&start, &end)| {
            let row = self.pixels.get(start..end).unwrap_or_default();
            let skip = row.partition_point(|pixel| f64::from(pixel.x()) < low.x);
            row.iter()
                .skip(skip)
                .take_while(move |pixel| f64::from(pixel.x()) <= high.x)
                .map(|pixel| (Vector2::new(f64::from(pixel.x()), f64::from(pixel.y())), pixel.polarity()))
        })
    }
}

/// Reasons why a circle was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rejection {
    /// A part of its rim is outside the sensor or the camera's domain.
    OutsideSensor,
    /// Too few events of one polarity near its rim.
    TooFewEvents,
    /// The events are not at the predicted position, or do not form the rim of a moving dot.
    Disagrees,
}

/// A circle that was found in the events.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefitCircle {
    /// Image of the circle's centre.
    pub center: Vector2<f64>,
    /// Mean radius in pixels.
    pub radius: f64,
}

/// Data of one frame.
pub struct Frame<'a> {
    /// The camera.
    pub camera: &'a Camera<f64>,
    /// `T_camera_world` at the time of the frame.
    pub pose: Isometry3<f64>,
    /// Poses `T_camera_world` shortly before and after, and the fraction of the time between them that the window of this frame
    /// spans; `None` without a neighbour.
    pub motion: Option<(Isometry3<f64>, Isometry3<f64>, f64)>,
    /// Width and height in pixels.
    pub sensor: Sensor,
    /// The events.
    pub pixels: &'a PixelRows,
}

/// Searches for circle `index` of the board in a frame's events.
pub fn refit_circle(
    frame: &Frame<'_>,
    board: &CircleBoard,
    index: usize,
    settings: &CrossValidationSettings,
) -> Result<RefitCircle, Rejection> {
    let object = board.circle_center(index);
    let circle = ProjectedCircle::new(frame.camera, &frame.pose, object, board.radius)
        .filter(|circle| circle.inside(frame.sensor))
        .ok_or(Rejection::OutsideSensor)?;
    let motion = frame.motion.and_then(|(before, after, part)| {
        let project =
            |pose: Isometry3<f64>| frame.camera.project(&(pose * Point3::new(object.x, object.y, 0.0)).coords);
        Some((project(after)? - project(before)?) * part)
    });
    // Within the window the rim moves by half the motion to either side.
    let half_motion = motion.map_or(0.0, |motion| (motion.norm() / 2.0).min(MAX_MOTION_BAND));
    let gap = (board.neighbour_distance() / board.radius - 2.0) * circle.smaller_radius();
    let band = (RIM_BAND + half_motion).min(0.45 * gap).min(0.8 * circle.smaller_radius());
    let inverse = circle.axes.try_inverse().ok_or(Rejection::OutsideSensor)?;
    let [low, high] = circle.bounds;
    let reach = Vector2::new(band, band);
    // Distance from the rim along its outward normal, and that normal.
    let mut events: Vec<(f64, Vector2<f64>, Polarity)> = Vec::with_capacity(USUAL_EVENTS);
    for (pixel, polarity) in frame.pixels.in_rectangle(low - reach, high + reach) {
        let unit = inverse * (pixel - circle.middle);
        let gradient = inverse.transpose() * unit;
        let slope = gradient.norm();
        // The distance to first order: the deviation of |u| from 1, divided by the length of the gradient of |u|.
        let distance = (unit.norm() - 1.0) * unit.norm() / slope;
        if distance.abs() <= band {
            events.push((distance, gradient / slope, polarity));
        }
    }
    let count = |polarity| events.iter().filter(|event| event.2 == polarity).count();
    if count(Polarity::On) < MIN_EVENTS || count(Polarity::Off) < MIN_EVENTS {
        return Err(Rejection::TooFewEvents);
    }
    // A moving dot has ON events on one side and OFF events on the other.
    let side = |polarity| -> Vector2<f64> { events.iter().filter(|e| e.2 == polarity).map(|e| e.1).sum() };
    if side(Polarity::On).dot(&side(Polarity::Off)) >= 0.0 {
        return Err(Rejection::Disagrees);
    }
    let huber = HUBER + half_motion / 2.0;
    let mut solution = Vector3::zeros();
    let mut normal = Matrix3::identity();
    let mut fit_error = 0.0;
    for _ in 0..ROUNDS {
        normal = Matrix3::identity() * PULL;
        let mut right = Vector3::zeros();
        fit_error = 0.0;
        for (distance, outward, _) in &events {
            let row = outward.push(1.0);
            let error = (distance - row.dot(&solution)).abs();
            // 1 up to `huber`, without a branch that the processor would often predict wrongly.
            let weight = huber / error.max(huber);
            normal += row * row.transpose() * weight;
            right += row * (distance * weight);
            fit_error += error;
        }
        fit_error /= events.len() as f64;
        solution = normal.cholesky().ok_or(Rejection::Disagrees)?.solve(&right);
    }
    let shift = solution.xy();
    let deviation = normal
        .try_inverse()
        .map(|covariance| covariance.fixed_view::<2, 2>(0, 0).symmetric_eigenvalues().max().sqrt() * fit_error);
    let agrees = shift.norm() <= settings.max_center_shift
        && solution.z.abs() <= settings.max_radius_change
        && fit_error <= MAX_FIT_ERROR + half_motion / 2.0
        && deviation.is_some_and(|deviation| deviation <= MAX_CENTER_DEVIATION);
    if agrees {
        Ok(RefitCircle { center: circle.center + shift, radius: circle.radius() + solution.z })
    } else {
        Err(Rejection::Disagrees)
    }
}

//! Why nothing is found: what stands between the events of a moment and the board.

use std::fmt;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

use crate::health::noise::NoiseMeter;
use evcal_calibrate::circles::reference_frame::UnorderedFrame;
use evcal_calibrate::detection::other_board::{OtherReading, other_reading};
use evcal_calibrate::detection::settings::DetectionSettings;
use evcal_calibrate::detection::{CircleWindow, DetectionReport, DetectionStage, NoCircle};
use evcal_geometry::board::{Board, CircleBoard};
use evcal_geometry::numerics::statistics::median;

/// A board that was not seen for so long is explained (s), and again after the same time.
const PATIENCE: f64 = 1.0;
/// Length of the moment that is looked at (s), and most events of it.
const MOMENT: f64 = 0.3;
const MOST_EVENTS: usize = 1_000_000;
/// Fewer events a second are none.
const FEWEST_EVENTS: f64 = 1000.0;
/// Windows with fewer circles hold none.
const FEWEST_CIRCLES: usize = 4;
/// Fewest windows that count.
const FEWEST_WINDOWS: usize = 3;
/// More than this share of the events of a scene at rest are noise.
const MOSTLY: f64 = 0.5;
/// Circles with a smaller radius are far away (px); where dots are still smaller, the edges of two make one about as large.
const FAR: f64 = 5.0;
/// So many pairs of clusters for each circle are refused for the size that they would have: a tenth is usual.
const MANY_REFUSED: f64 = 1.0 / 3.0;
/// Circles whose middles are nearer to the edge of the sensor, in radii, stand at it.
const AT_EDGE: f64 = 3.0;

/// What stands between the events and the board.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Obstacle {
    /// There are hardly any events.
    NoEvents,
    /// Most of them are noise.
    TooSlow,
    /// Nothing looks like a circle.
    NoCircles,
    /// Nothing looks like the board of squares.
    NoSquares,
    /// Circles are too small.
    TooFar,
    /// There are circles up to the edge of the sensor, fewer than make a board.
    CutOff,
    /// They are those of another board.
    OtherBoard(OtherReading),
    /// There are circles, but they are not the board's.
    NoBoard,
}

impl fmt::Display for Obstacle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoEvents => f.write_str("hardly any events: is the lens cap off, and is there light?"),
            Self::TooSlow => f.write_str("hardly anything moves: is the board in view? Move it faster"),
            Self::NoCircles => f.write_str("no circles: is the board in view, in focus and lit?"),
            Self::NoSquares => f.write_str("no squares of the board: is all of it in view, in focus and lit?"),
            Self::TooFar => f.write_str("the circles are too small: bring the board closer"),
            Self::CutOff => f.write_str("only a part of the board is in view: move it to the middle"),
            Self::OtherBoard(other) => write!(f, "{other}"),
            Self::NoBoard => f.write_str("circles, but not those of the board: is it flat, and is it described right?"),
        }
    }
}

/// What was seen instead of the board.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// What stands between.
    pub obstacle: Obstacle,
    /// Circles without a place on the board: centre and radius (px), of the window with the most.
    pub circles: Vec<(Vector2<f64>, f64)>,
}

/// Why `board` is not found in `events`, which are in order of time (µs) and of one short moment.
pub fn explain(events: &[Event], board: &Board, sensor: Sensor, settings: &DetectionSettings) -> Explanation {
    let duration = events.first().zip(events.last()).map_or(0.0, |(first, last)| (last.t - first.t) as f64 * 1e-6);
    if (events.len() as f64) < FEWEST_EVENTS * duration.max(MOMENT) {
        return Explanation { obstacle: Obstacle::NoEvents, circles: Vec::new() };
    }
    let Board::Circles(board) = board else {
        let is_slow = share_at_rest(events, duration, sensor) > MOSTLY;
        let obstacle = if is_slow { Obstacle::TooSlow } else { Obstacle::NoSquares };
        return Explanation { obstacle, circles: Vec::new() };
    };
    let look = |fewest: usize| {
        let mut stage = DetectionStage::for_circles(settings, sensor, fewest);
        stage.push(events);
        stage.into_circles()
    };
    let (whole, report) = look(board.circle_count().div_ceil(2));
    if whole.len() >= FEWEST_WINDOWS {
        return Explanation { obstacle: of_whole(&whole, &report, board, sensor), circles: fullest(whole) };
    }
    let (parts, report) = look(FEWEST_CIRCLES);
    let obstacle = match parts.len() >= FEWEST_WINDOWS {
        true => of_parts(&parts, &report, sensor),
        false if share_at_rest(events, duration, sensor) > MOSTLY => Obstacle::TooSlow,
        false if are_small(&parts, &report) => Obstacle::TooFar,
        false => Obstacle::NoCircles,
    };
    Explanation { obstacle, circles: fullest(parts) }
}

/// What windows with as many circles as half a board are.
fn of_whole(windows: &[CircleWindow], report: &DetectionReport, board: &CircleBoard, sensor: Sensor) -> Obstacle {
    let frames: Vec<UnorderedFrame> = windows.iter().map(CircleWindow::to_frame).collect();
    match other_reading(&frames, board, sensor) {
        Some(other) if other.board.pattern != board.pattern => Obstacle::OtherBoard(other),
        _ if are_small(windows, report) => Obstacle::TooFar,
        _ => Obstacle::NoBoard,
    }
}

/// What windows with fewer circles are.
fn of_parts(windows: &[CircleWindow], report: &DetectionReport, sensor: Sensor) -> Obstacle {
    let at_edge = windows.iter().filter(|window| stands_at_edge(window, sensor)).count();
    match at_edge * 2 > windows.len() {
        _ if are_small(windows, report) => Obstacle::TooFar,
        true => Obstacle::CutOff,
        false => Obstacle::NoBoard,
    }
}

/// Circles of the window with the most.
fn fullest(windows: Vec<CircleWindow>) -> Vec<(Vector2<f64>, f64)> {
    let fullest = windows.into_iter().max_by_key(|window| window.circles.len());
    fullest.map_or_else(Vec::new, |window| window.circles)
}

/// Whether circles are small, or many more would be but for their size.
fn are_small(windows: &[CircleWindow], report: &DetectionReport) -> bool {
    let mut radii: Vec<f64> = windows.iter().flat_map(|window| &window.circles).map(|(_, radius)| *radius).collect();
    let refused = report.pairs_refused.get(&NoCircle::RadiusOutOfBounds).copied().unwrap_or(0);
    median(&mut radii, f64::total_cmp).is_some_and(|radius| radius < FAR)
        || refused as f64 > MANY_REFUSED * report.circles as f64
}

/// Share of the events that would come if nothing moved.
fn share_at_rest(events: &[Event], duration: f64, sensor: Sensor) -> f64 {
    let mut meter = NoiseMeter::new(sensor);
    meter.push(events);
    let pixels = f64::from(sensor.width) * f64::from(sensor.height);
    meter.rate_so_far().map_or(0.0, |rate| rate * pixels * duration / events.len() as f64)
}

fn stands_at_edge(window: &CircleWindow, sensor: Sensor) -> bool {
    let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
    window.circles.iter().any(|(center, radius)| {
        let room = center.x.min(center.y).min(width - 1.0 - center.x).min(height - 1.0 - center.y);
        room < AT_EDGE * radius
    })
}

/// Explains a board that is not found, now and then.
#[derive(Clone, Debug, Default)]
pub struct Explainer {
    moment: Vec<Event>,
    /// The board was seen, or its absence explained, at this time (s).
    settled: f64,
    explanation: Option<Explanation>,
}

impl Explainer {
    /// Takes the next events.
    pub fn push(&mut self, events: &[Event], board: &Board, sensor: Sensor, settings: &DetectionSettings) {
        let Some(now) = events.last().map(|event| event.t as f64 * 1e-6) else { return };
        if now - self.settled < PATIENCE {
            return;
        }
        self.moment.extend_from_slice(events);
        let start = self.moment.first().map_or(now, |event| event.t as f64 * 1e-6);
        if now - start >= MOMENT || self.moment.len() > MOST_EVENTS {
            self.explanation = Some(explain(&self.moment, board, sensor, settings));
            self.moment.clear();
            self.settled = now;
        }
    }

    /// The board was seen at this time (s).
    pub fn found(&mut self, t: f64) {
        self.moment.clear();
        self.explanation = None;
        self.settled = self.settled.max(t);
    }

    /// Not one event came for a while.
    pub fn silence(&mut self) {
        self.moment.clear();
        self.explanation = Some(Explanation { obstacle: Obstacle::NoEvents, circles: Vec::new() });
    }

    /// Why nothing is found, as of the last look.
    pub fn explanation(&self) -> Option<&Explanation> {
        self.explanation.as_ref()
    }
}

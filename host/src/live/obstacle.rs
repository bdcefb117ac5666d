//! Why nothing is found: what stands between the events of a moment and the board.

use std::fmt;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

use crate::board::Board;
use crate::circles::reference_frame::UnorderedFrame;
use crate::detection::other_board::{OtherReading, other_reading};
use crate::detection::settings::DetectionSettings;
use crate::detection::{CircleWindow, DetectionReport, DetectionStage, NoCircle};

/// A board that was not seen for so long is explained (s), and again after the same time.
const PATIENCE: f64 = 1.0;
/// Length of the moment that is looked at (s), and most events of it.
const MOMENT: f64 = 0.3;
const MOST_EVENTS: usize = 1_000_000;
/// Fewer events a second are none.
const FEWEST_EVENTS: f64 = 1000.0;
/// Windows that hold so few circles hold none.
const FEWEST_CIRCLES: usize = 4;
/// Fewest windows to take for another board.
const FEWEST_WINDOWS: usize = 3;
/// Circles with a smaller radius are far away (px).
const FAR: f64 = 3.0;
/// Circles whose middles are nearer to the edge of the sensor, in radii, stand at it.
const AT_EDGE: f64 = 3.0;

/// What stands between the events and the board.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Obstacle {
    /// There are hardly any events.
    NoEvents,
    /// There are too few for the time that a window may take.
    TooSlow,
    /// Nothing looks like a circle.
    NoCircles,
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
            Self::TooSlow => f.write_str("too few events: move the board faster"),
            Self::NoCircles => f.write_str("no circles: is the board in view, in focus and lit?"),
            Self::TooFar => f.write_str("the circles are too small: bring the board closer"),
            Self::CutOff => f.write_str("only a part of the board is in view: move it to the middle"),
            Self::OtherBoard(other) => write!(f, "{other}"),
            Self::NoBoard => f.write_str("circles, but not those of the board: is it flat, and is --board right?"),
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
    let mut stage = DetectionStage::for_circles(settings, sensor, 1);
    stage.push(events);
    let (windows, report) = stage.into_circles();
    let obstacle = obstacle(&windows, &report, board, sensor);
    let fullest = windows.into_iter().max_by_key(|window| window.circles.len());
    Explanation { obstacle, circles: fullest.map_or_else(Vec::new, |window| window.circles) }
}

/// What these windows, all with circles, lack of the board.
fn obstacle(windows: &[CircleWindow], report: &DetectionReport, board: &Board, sensor: Sensor) -> Obstacle {
    let many: Vec<&CircleWindow> = windows.iter().filter(|window| window.circles.len() >= FEWEST_CIRCLES).collect();
    let too_small = report.pairs_refused.get(&NoCircle::RadiusOutOfBounds).copied().unwrap_or(0);
    let mut radii: Vec<f64> = windows.iter().flat_map(|window| &window.circles).map(|(_, radius)| *radius).collect();
    let radius = crate::numerics::statistics::median(&mut radii, f64::total_cmp);
    if many.len() as u64 * 2 <= report.windows {
        return match radius {
            _ if report.too_few_events > report.windows => Obstacle::TooSlow,
            _ if too_small > report.circles => Obstacle::TooFar,
            Some(radius) if radius < FAR => Obstacle::TooFar,
            _ => Obstacle::NoCircles,
        };
    }
    let half = board.circle_count().div_ceil(2);
    let whole: Vec<UnorderedFrame> =
        many.iter().filter(|window| window.circles.len() >= half).map(|window| window.to_frame()).collect();
    if whole.len() >= FEWEST_WINDOWS
        && let Some(other) = other_reading(&whole, board, sensor)
    {
        return Obstacle::OtherBoard(other);
    }
    let at_edge = many.iter().filter(|window| stands_at_edge(window, sensor)).count();
    match radius {
        _ if at_edge * 2 > many.len() && whole.len() * 2 <= many.len() => Obstacle::CutOff,
        Some(radius) if radius < FAR => Obstacle::TooFar,
        _ => Obstacle::NoBoard,
    }
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

    /// Why nothing is found, as of the last look.
    pub fn explanation(&self) -> Option<&Explanation> {
        self.explanation.as_ref()
    }
}

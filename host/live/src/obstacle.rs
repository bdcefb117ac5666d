//! Reasons why the board is not found in the events of a moment.

use std::fmt;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

use crate::health::noise::NoiseMeter;
use evcal_detection::circles::reference_frame::UnorderedFrame;
use evcal_detection::detection::pictures::settings::PictureSettings;
use evcal_detection::detection::recognition::other_board::{OtherReading, find_other_board, other_reading};
use evcal_detection::detection::recognition::recognised::{Recognised, find_squares};
use evcal_detection::detection::settings::DetectionSettings;
use evcal_detection::detection::still_views::search::search_views;
use evcal_detection::detection::still_views::{StillView, StillViews};
use evcal_detection::detection::{CircleWindow, DetectionReport, DetectionStage, NoCircle};
use evcal_geometry::board::{Board, CircleBoard};
use evcal_geometry::numerics::statistics::median;
use event_recordings::{Recording, RecordingOptions};

/// Time without the board after which its absence is explained, and the interval between explanations (s).
const PATIENCE: f64 = 1.0;
/// Length of the analysed moment (s), and its largest number of events.
const MOMENT: f64 = 0.5;
const MOST_EVENTS: usize = 1_000_000;
/// Event rate below which there are hardly any events, in events per second.
const FEWEST_EVENTS: f64 = 1000.0;
/// Smallest number of circles in a window that is used.
const FEWEST_CIRCLES: usize = 4;
/// Smallest number of windows with circles from which a reason is concluded.
const FEWEST_WINDOWS: usize = 3;
/// Fraction of noise events above which the scene is considered at rest.
const MOSTLY: f64 = 0.5;
/// Radius below which circles are far away (px); with even smaller dots, the edges of two dots together look like a
/// circle of this size.
const FAR: f64 = 5.0;
/// Rejected pairs of clusters per circle found above which the dots are too small. Only pairs rejected for their size
/// count; a tenth is usual.
const MANY_REFUSED: f64 = 1.0 / 3.0;
/// Distance of a circle's centre from the edge of the sensor, in radii, below which it is at the edge.
const AT_EDGE: f64 = 3.0;

/// Reason why the board is not found.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub enum Obstacle {
    /// There are hardly any events.
    NoEvents,
    /// Most events are noise.
    TooSlow,
    /// Nothing looks like a circle.
    NoCircles,
    /// Nothing looks like the board of squares.
    NoSquares,
    /// Circles are too small.
    TooFar,
    /// Circles are found up to the edge of the sensor, but fewer than half of the board's.
    CutOff,
    /// The circles belong to another board.
    OtherBoard(OtherReading),
    /// There are circles, but they are not the board's.
    NoBoard,
    /// The board is in view, at rest, and blinks.
    Blinks,
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
            Self::Blinks => f.write_str(
                "this board blinks: hold still for half a second in each of six or more places, from all sides, and calibrate the recording at the end",
            ),
            Self::NoBoard => f.write_str("circles, but not those of the board: is it flat, and is it described right?"),
        }
    }
}

/// Reason why the board was not found, with the circles that were found.
#[derive(Clone, Debug, PartialEq)]
pub struct Explanation {
    /// The reason.
    pub obstacle: Obstacle,
    /// The circles in the window with the most circles, as centre and radius (px).
    pub circles: Vec<(Vector2<f64>, f64)>,
}

/// Explains why `board` is not found in `events`, which are in order of time (µs) and from one short moment.
pub fn explain(events: &[Event], board: &Board, sensor: Sensor, settings: &DetectionSettings) -> Explanation {
    let duration = events.first().zip(events.last()).map_or(0.0, |(first, last)| (last.t - first.t) as f64 * 1e-6);
    if (events.len() as f64) < FEWEST_EVENTS * duration.max(MOMENT) {
        return Explanation { obstacle: Obstacle::NoEvents, circles: Vec::new() };
    }
    let is_slow = || share_at_rest(events, duration, sensor) > MOSTLY;
    let Board::Circles(circles) = board else {
        let obstacle = match is_slow() {
            true => Obstacle::TooSlow,
            false => find_other_board(&moment(events, sensor), sensor, board, settings)
                .ok()
                .flatten()
                .map_or(Obstacle::NoSquares, Obstacle::OtherBoard),
        };
        return Explanation { obstacle, circles: Vec::new() };
    };
    let search = |fewest: usize| {
        let mut stage = DetectionStage::for_circles(settings, sensor, fewest);
        stage.push(events);
        stage.into_circles()
    };
    let (whole, report) = search(circles.circle_count().div_ceil(2));
    let explanation = if whole.len() >= FEWEST_WINDOWS {
        Explanation { obstacle: of_whole(&whole, &report, circles, sensor), circles: fullest(whole) }
    } else {
        let (parts, report) = search(FEWEST_CIRCLES);
        let obstacle = match parts.len() >= FEWEST_WINDOWS {
            true => of_parts(&parts, &report, sensor),
            false if is_slow() => Obstacle::TooSlow,
            false if are_small(&parts, &report) => Obstacle::TooFar,
            false => Obstacle::NoCircles,
        };
        Explanation { obstacle, circles: fullest(parts) }
    };
    // Corners of squares look like small circles, or like no circles.
    match explanation.obstacle {
        Obstacle::TooFar | Obstacle::NoCircles | Obstacle::NoBoard => {
            let squares = find_squares(&moment(events, sensor), sensor).ok().flatten();
            let other = squares.map(|found| Obstacle::OtherBoard(OtherReading::Kind(Recognised::Squares(found))));
            other.map_or(explanation, |obstacle| Explanation { obstacle, circles: Vec::new() })
        }
        _ => explanation,
    }
}

/// Returns the events of a moment as a recording.
fn moment(events: &[Event], sensor: Sensor) -> Recording {
    let options = RecordingOptions { sensor: Some(sensor), ..RecordingOptions::default() };
    Recording::from_events("live", events.to_vec(), options)
}

/// Interprets windows with at least half as many circles as the board.
fn of_whole(windows: &[CircleWindow], report: &DetectionReport, board: &CircleBoard, sensor: Sensor) -> Obstacle {
    let frames: Vec<UnorderedFrame> = windows.iter().map(CircleWindow::to_frame).collect();
    match other_reading(&frames, board, sensor) {
        Some(other) if other.pattern() != Some(board.pattern) => Obstacle::OtherBoard(other),
        _ if are_small(windows, report) => Obstacle::TooFar,
        _ => Obstacle::NoBoard,
    }
}

/// Interprets windows with fewer than half of the board's circles.
fn of_parts(windows: &[CircleWindow], report: &DetectionReport, sensor: Sensor) -> Obstacle {
    let at_edge = windows.iter().filter(|window| has_circle_near_edge(window, sensor)).count();
    match at_edge * 2 > windows.len() {
        _ if are_small(windows, report) => Obstacle::TooFar,
        true => Obstacle::CutOff,
        false => Obstacle::NoBoard,
    }
}

/// Returns the circles of the window with the most circles.
fn fullest(windows: Vec<CircleWindow>) -> Vec<(Vector2<f64>, f64)> {
    let fullest = windows.into_iter().max_by_key(|window| window.circles.len());
    fullest.map_or_else(Vec::new, |window| window.circles)
}

/// Returns `true` if the circles are small, or many pairs were rejected only for their size.
fn are_small(windows: &[CircleWindow], report: &DetectionReport) -> bool {
    let mut radii: Vec<f64> = windows.iter().flat_map(|window| &window.circles).map(|(_, radius)| *radius).collect();
    let refused = report.pairs_refused.get(&NoCircle::RadiusOutOfBounds).copied().unwrap_or(0);
    median(&mut radii, f64::total_cmp).is_some_and(|radius| radius < FAR)
        || refused as f64 > MANY_REFUSED * report.circles as f64
}

/// Returns the fraction of the events that would occur without motion.
fn share_at_rest(events: &[Event], duration: f64, sensor: Sensor) -> f64 {
    let mut meter = NoiseMeter::new(sensor);
    meter.push(events);
    let pixels = f64::from(sensor.width) * f64::from(sensor.height);
    meter.rate_so_far().map_or(0.0, |rate| rate * pixels * duration / events.len() as f64)
}

fn has_circle_near_edge(window: &CircleWindow, sensor: Sensor) -> bool {
    let (width, height) = (f64::from(sensor.width), f64::from(sensor.height));
    window.circles.iter().any(|(center, radius)| {
        let room = center.x.min(center.y).min(width - 1.0 - center.x).min(height - 1.0 - center.y);
        room < AT_EDGE * radius
    })
}

/// Returns `true` if the last of the `views` of a camera at rest shows the board.
fn shows(views: &[StillView], board: &Board, settings: &DetectionSettings) -> bool {
    let last = views.last().into_iter().cloned().collect();
    !search_views(board, settings, &PictureSettings::default(), &[last]).frames.is_empty()
}

/// Explains at intervals why a board is not found.
#[derive(Debug, Default)]
pub struct Explainer {
    moment: Vec<Event>,
    /// Views since the last explanation.
    views: Option<StillViews>,
    /// Time at which the board was last seen, or its absence last explained (s).
    settled: f64,
    explanation: Option<Explanation>,
}

impl Explainer {
    /// Adds the next events.
    pub fn push(&mut self, events: &[Event], board: &Board, sensor: Sensor, settings: &DetectionSettings) {
        let Some(now) = events.last().map(|event| event.t as f64 * 1e-6) else { return };
        self.views.get_or_insert_with(|| StillViews::new(sensor)).push(events);
        if now - self.settled < PATIENCE {
            return;
        }
        self.moment.extend_from_slice(events);
        let start = self.moment.first().map_or(now, |event| event.t as f64 * 1e-6);
        if now - start >= MOMENT || self.moment.len() > MOST_EVENTS {
            let views = self.views.take().map(StillViews::finish);
            self.explanation = Some(match views.is_some_and(|views| shows(&views, board, settings)) {
                true => Explanation { obstacle: Obstacle::Blinks, circles: Vec::new() },
                false => explain(&self.moment, board, sensor, settings),
            });
            self.moment.clear();
            self.settled = now;
        }
    }

    /// Records that the board was seen at this time (s).
    pub fn found(&mut self, t: f64) {
        self.moment.clear();
        self.views = None;
        self.explanation = None;
        self.settled = self.settled.max(t);
    }

    /// Records that no event arrived for a while.
    pub fn silence(&mut self) {
        self.moment.clear();
        self.views = None;
        self.explanation = Some(Explanation { obstacle: Obstacle::NoEvents, circles: Vec::new() });
    }

    /// Returns the latest explanation.
    pub fn explanation(&self) -> Option<&Explanation> {
        self.explanation.as_ref()
    }
}

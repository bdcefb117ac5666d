//! Detection of the board: from events to reference frames (sections 1 to 4 of method.md).
//!
//! A recording is cut into chunks of fixed length, and each chunk is searched independently (windows → clusters → circles →
//! grid), so that chunks run in parallel and the result does not depend on the number of threads.

mod board_finder;
pub mod board_stage;
pub mod counted;
pub mod dot_shape;
pub mod exchanged;
pub mod focus;
mod kept_pixels;
pub mod no_board;
mod ordering;
pub mod pictures;
pub mod recognition;
mod report;
pub mod search;
mod second_pass;
pub mod settings;
mod square_finder;
pub mod squares;
pub mod still_views;
pub mod unplaced;

use std::borrow::Cow;
use std::ops::Range;

use evcal_core::cluster::{row_bytes, row_count};

use evcal_core::detector::Detector;
use evcal_core::event::Event;
use evcal_core::grid::{GridCandidate, GridOptions};
use evcal_core::pattern::Pattern;
use evcal_core::sensor::Sensor;
use evcal_core::window::{Outcome, Window, WindowPlanner};
use nalgebra::Vector2;
use rayon::prelude::*;

pub use self::board_finder::PlacedCircle;
use self::board_finder::{BoardFinder, within_capacity};
use self::dot_shape::DotShape;
use self::kept_pixels::KeptPixels;
use self::no_board::NoBoard;
pub use self::ordering::order_frames;
pub use self::report::{DetectionReport, FEWEST_EVENTS, NoCircle, NoPattern, NoPatternCause, too_short};
use self::second_pass::{Spacing, Uncertain, second_pass};
use self::settings::{DetectionSettings, Grid};
use self::unplaced::{UnplacedWindows, is_whole};
use crate::circles::compact_frame::CompactFrame;
use crate::circles::event_pixel::EventPixel;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn, UnorderedCircle, UnorderedFrame};

/// Largest sensor that the detector supports.
pub const LARGEST_SENSOR: Sensor = Sensor::new(1280, 800);
/// Length of the parts of a recording that are searched independently, in parallel (µs).
const CHUNK: i64 = 100_000;
/// If the circles of a window fit several positions on the board, a reference frame determines the right one. It may be
/// at most this far away in time (s).
const LONGEST_PREDICTION: f64 = 0.03;
/// Largest number of runs of pixels in a window.
const RUNS: usize = 16_384;
/// Largest number of clusters of one polarity in a window.
const CLUSTERS: usize = 512;

/// The detector with capacity for the largest sensor; single precision, as on a microcontroller.
type HostDetector = Detector<
    f32,
    { row_bytes(LARGEST_SENSOR.width as usize) },
    { row_count(LARGEST_SENSOR.height as usize) },
    RUNS,
    CLUSTERS,
>;

/// Creates a detector on the heap. Not inlined: its construction uses 620 KiB of stack, which would be part of the frames of
/// rayon's recursion.
#[inline(never)]
fn host_detector() -> Box<HostDetector> {
    Box::new(HostDetector::new())
}

/// Circles of one window, without a board.
#[derive(Clone, Debug, PartialEq)]
pub struct CircleWindow {
    /// Start of the window in seconds since the start of the recording.
    pub start: f64,
    /// End of the window.
    pub end: f64,
    /// Centre and radius in pixels.
    pub circles: Vec<(Vector2<f64>, f64)>,
    /// The events of the window, one entry per pixel and polarity.
    pub pixels: Vec<EventPixel>,
}

impl CircleWindow {
    /// Returns the circles as a frame without a board, at the middle of the window.
    pub fn to_frame(&self) -> UnorderedFrame {
        let t = 0.5 * (self.start + self.end);
        let circles = self.circles.iter();
        let circles =
            circles.map(|&(center, radius)| UnorderedCircle { t, center, radius: Some(radius), velocity: None });
        UnorderedFrame { start: self.start, end: self.end, circles: circles.collect() }
    }
}

/// Target of the search in a window.
#[derive(Clone, Copy, Debug)]
enum Requirement {
    /// The board.
    Board(Pattern),
    /// Any circles, at least this many.
    Circles(usize),
}

/// A window with a detection.
enum Found {
    Frame(ReferenceFrame),
    Circles(CircleWindow),
}

impl Found {
    /// Returns `true` if it is a frame with all rows and columns of the board.
    fn shows_all(&self, pattern: Pattern) -> bool {
        match self {
            Self::Frame(frame) => is_whole(frame, pattern),
            Self::Circles(_) => false,
        }
    }

    fn into_circles(self) -> Option<CircleWindow> {
        match self {
            Self::Frame(_) => None,
            Self::Circles(window) => Some(window),
        }
    }

    fn into_frame(self) -> Option<ReferenceFrame> {
        match self {
            Self::Frame(frame) => Some(frame),
            Self::Circles(_) => None,
        }
    }
}

/// Board index, centre and radius in pixels.
type BoardCircle = (usize, Vector2<f64>, f64);

/// Searches the circles of a window for [`Requirement`].
enum Seeker {
    Board(Pattern, BoardFinder<f32>),
    Circles(usize),
}

/// Result of a chunk.
#[derive(Default)]
struct Searched {
    findings: Vec<Found>,
    uncertain: Vec<Uncertain>,
    /// The window with most circles, of those that have more circles than the board and no position on it.
    unplaced: Option<UnorderedFrame>,
    report: DetectionReport,
    /// Evidence on the form of the dots from all windows with a board, including those that were rejected because of it.
    shape: DotShape,
}

/// Searches a recording, batch by batch, for the board or for circles.
pub struct DetectionStage<'a> {
    settings: Cow<'a, DetectionSettings>,
    sensor: Sensor,
    wanted: Requirement,
    recording: usize,
    /// Events of the waiting chunks, then of the current one.
    events: Vec<Event>,
    /// Index of the current chunk.
    chunk_index: i64,
    /// Index of each complete chunk, and its range in `events`.
    waiting: Vec<(i64, Range<usize>)>,
    frames: Vec<CompactFrame>,
    circle_windows: Vec<CircleWindow>,
    unplaced: UnplacedWindows,
    report: DetectionReport,
    shape: DotShape,
    kept_pixels: KeptPixels,
}

/// Number of chunks that are searched together.
const CHUNKS_TOGETHER: usize = 16;
/// The waiting chunks are searched once they contain this number of events, even if they are fewer than
/// [`CHUNKS_TOGETHER`]. A chunk with more of them, 40 million per second, is divided. All events together therefore take at
/// most 128 MiB.
const EVENTS_TOGETHER: usize = 4 << 20;

impl<'a> DetectionStage<'a> {
    /// Creates a search for a board of `pattern`.
    pub fn for_board(settings: &'a DetectionSettings, sensor: Sensor, pattern: Pattern, recording: usize) -> Self {
        Self::new(settings, sensor, Requirement::Board(pattern), recording)
    }

    /// Creates a search for windows with at least `fewest` circles.
    pub fn for_circles(settings: &'a DetectionSettings, sensor: Sensor, fewest: usize) -> Self {
        Self::new(settings, sensor, Requirement::Circles(fewest), 0)
    }

    fn new(settings: &'a DetectionSettings, sensor: Sensor, wanted: Requirement, recording: usize) -> Self {
        Self {
            settings: settings.for_sensor(sensor),
            sensor,
            wanted,
            recording,
            events: Vec::new(),
            chunk_index: 0,
            waiting: Vec::new(),
            frames: Vec::new(),
            circle_windows: Vec::new(),
            unplaced: UnplacedWindows::new(recording),
            report: DetectionReport::default(),
            shape: DotShape::default(),
            kept_pixels: KeptPixels::default(),
        }
    }

    /// Adds the next events in time order; their times are microseconds since the start of the recording.
    pub fn push(&mut self, mut events: &[Event]) {
        self.report.count_events(events);
        while let Some(first) = events.first() {
            let index = first.t.div_euclid(CHUNK);
            if index != self.chunk_index {
                self.close_chunk();
                self.chunk_index = index;
            }
            let end = events.partition_point(|event| event.t.div_euclid(CHUNK) <= index).max(1);
            let room = EVENTS_TOGETHER - (self.events.len() - self.waiting_events());
            let (now, later) = events.split_at(end.min(room));
            self.events.extend_from_slice(now);
            events = later;
            if end >= room {
                self.close_chunk();
            }
        }
    }

    fn close_chunk(&mut self) {
        let chunk = self.waiting_events()..self.events.len();
        if !chunk.is_empty() {
            self.waiting.push((self.chunk_index, chunk));
        }
        if self.waiting.len() >= CHUNKS_TOGETHER || self.waiting_events() >= EVENTS_TOGETHER {
            self.search();
        }
    }

    /// Returns the number of events in waiting chunks.
    fn waiting_events(&self) -> usize {
        self.waiting.last().map_or(0, |(_, chunk)| chunk.end)
    }

    fn search(&mut self) {
        let searched = self.waiting_events();
        let mut events = std::mem::take(&mut self.events);
        let waiting = std::mem::take(&mut self.waiting).into_iter();
        let waiting: Vec<(i64, &[Event])> =
            waiting.map(|(index, chunk)| (index, events.get(chunk).unwrap_or_default())).collect();
        let parts: Vec<Searched> = waiting
            .par_iter()
            .enumerate()
            .map_init(
                || (host_detector(), self.seeker()),
                |(detector, seeker), (chunk, (index, events))| {
                    let span = index * CHUNK..(index + 1) * CHUNK;
                    self.search_chunk(detector, seeker, chunk, events, span)
                },
            )
            .collect();
        let (mut found, mut uncertain) = (Vec::new(), Vec::new());
        for part in parts {
            self.report.add(&part.report);
            self.shape.add(&part.shape);
            if let Requirement::Board(pattern) = self.wanted {
                let shows_whole_board = part.findings.iter().any(|found| found.shows_all(pattern));
                self.unplaced.take(part.unplaced, shows_whole_board);
            }
            found.extend(part.findings);
            uncertain.extend(part.uncertain);
        }
        match self.wanted {
            Requirement::Board(pattern) => self.place_uncertain(&waiting, found, uncertain, pattern),
            Requirement::Circles(_) => self.circle_windows.extend(found.into_iter().filter_map(Found::into_circles)),
        }
        self.kept_pixels.limit(&mut self.frames);
        // The vector is kept, so that the next chunks reuse its memory.
        events.drain(..searched);
        self.events = events;
    }

    /// Adds the frames `found` in the chunks `waiting`, and the frames of those uncertain windows whose position on the
    /// board follows from neighbouring frames.
    fn place_uncertain(
        &mut self,
        waiting: &[(i64, &[Event])],
        found: Vec<Found>,
        uncertain: Vec<Uncertain>,
        pattern: Pattern,
    ) {
        let window = &self.settings.window;
        let spacing =
            Spacing { gap: f64::from(window.gap) * f64::from(window.step) * 1e-6, longest: LONGEST_PREDICTION };
        let mut finder = BoardFinder::new(pattern);
        let options = self.grid_options(&pattern);
        let place = |window: &Uncertain, expected: &[Option<Vector2<f32>>]| {
            let placed = finder.find_near(&window.candidates, &options, expected).ok()?;
            let (_, events) = waiting.get(window.chunk)?;
            let events = events.get(window.window.first..window.window.last)?;
            let frame = self.frame(&window.window, events, board_circles(&placed, &window.candidates));
            let shape = DotShape::of_frame(&frame, &pattern)?;
            shape.may_be_discs_in_window().then_some(frame)
        };
        let mut latest = self.frames.iter().rev().map(CompactFrame::without_events);
        let before = [latest.next(), latest.next()];
        let before = before.each_ref().map(Option::as_ref);
        let found = found.into_iter().filter_map(Found::into_frame).collect();
        let (frames, added) = second_pass(pattern.circle_count(), before, found, uncertain, spacing, place);
        let circles = frames.iter().map(|frame| frame.circles.len() as u64).sum::<u64>();
        self.frames.extend(frames.into_iter().map(CompactFrame::from));
        self.report.board_circles += circles;
        self.report.found += added;
        self.report.found_by_neighbours += added;
        if let Some(refused) = self.report.grids_refused.get_mut(&NoBoard::PlaceUncertain) {
            *refused -= added.min(*refused);
        }
    }

    fn search_chunk(
        &self,
        detector: &mut HostDetector,
        seeker: &mut Seeker,
        chunk: usize,
        events: &[Event],
        span: Range<i64>,
    ) -> Searched {
        let Searched { mut findings, mut uncertain, mut unplaced, mut report, mut shape } = Searched::default();
        let start = events.first().map_or(span.start, |event| event.t);
        let mut planner = WindowPlanner::new(self.settings.window, start, span.end);
        let detector_settings = self.settings.detector();
        while let Some(window) = planner.next(events) {
            let inside = events.get(window.first..window.last).unwrap_or_default();
            report.windows += 1;
            // The sensor size was checked against the detector's capacity when the recording was opened.
            let Ok(detection) = detector.detect(self.sensor, inside.iter().copied(), &detector_settings) else { break };
            report.overflowed += u64::from(detection.overflowed());
            report.count_pairs(&detection.circles);
            let circles: Vec<GridCandidate<f32>> = detector
                .circles()
                .iter()
                .map(|circle| GridCandidate { center: circle.center, radius: circle.radius })
                .collect();
            match self.find(seeker, &circles, &window, inside, &mut shape) {
                Ok(finding) => {
                    report.found += 1;
                    findings.push(finding);
                    planner.report(Outcome::Found);
                }
                Err(reason) => {
                    if reason == NoBoard::PlaceUncertain {
                        let candidates = within_capacity(&circles).to_vec();
                        uncertain.push(Uncertain { chunk, window, candidates });
                    }
                    let most =
                        unplaced.as_ref().map_or_else(|| self.circles_of_board(), |fullest| fullest.circles.len());
                    if matches!(reason, NoBoard::PlaceUncertain | NoBoard::LargerThanBoard) && circles.len() > most {
                        unplaced = Some(circle_window(&window, &circles, Vec::new()).to_frame());
                    }
                    *report.grids_refused.entry(reason).or_default() += 1;
                    let unique_pixels = detection.clusters.events.saturating_sub(detection.clusters.both_polarities);
                    planner.report(Outcome::NotFound { unique_pixels });
                }
            }
        }
        report.too_few_events += u64::from(planner.too_few_events());
        Searched { findings, uncertain, unplaced, report, shape }
    }

    /// Returns the number of circles of the board.
    fn circles_of_board(&self) -> usize {
        match self.wanted {
            Requirement::Board(pattern) => pattern.circle_count(),
            Requirement::Circles(_) => 0,
        }
    }

    fn seeker(&self) -> Seeker {
        match self.wanted {
            Requirement::Board(pattern) => Seeker::Board(pattern, BoardFinder::new(pattern)),
            Requirement::Circles(fewest) => Seeker::Circles(fewest),
        }
    }

    fn grid_options(&self, pattern: &Pattern) -> GridOptions {
        GridOptions {
            minimum_circles: self.settings.fewest_circles(pattern),
            ..GridOptions::new(pattern, (f64::from(self.sensor.width), f64::from(self.sensor.height)))
        }
    }

    /// Searches a window with these circles and events. Evidence on the form of a board's dots is added to `all`.
    fn find(
        &self,
        seeker: &mut Seeker,
        circles: &[GridCandidate<f32>],
        window: &Window,
        events: &[Event],
        all: &mut DotShape,
    ) -> Result<Found, NoBoard> {
        match seeker {
            Seeker::Board(pattern, finder) => {
                let placed = match self.settings.grid {
                    Grid::Lattice => finder.find(within_capacity(circles), &self.grid_options(pattern))?,
                    Grid::Opencv => (self.settings.opencv.ok_or(NoBoard::OpencvFailed)?.0)(circles, pattern)?,
                };
                let frame = self.frame(window, events, board_circles(&placed, circles));
                let shape = DotShape::of_frame(&frame, pattern).unwrap_or_default();
                all.add(&shape);
                if shape.may_be_discs_in_window() { Ok(Found::Frame(frame)) } else { Err(NoBoard::NotRound) }
            }
            Seeker::Circles(fewest) if circles.len() >= *fewest => {
                Ok(Found::Circles(circle_window(window, circles, unique_pixels(events))))
            }
            Seeker::Circles(_) => Err(NoBoard::TooFewCircles),
        }
    }

    fn frame(&self, window: &Window, events: &[Event], circles: Vec<BoardCircle>) -> ReferenceFrame {
        let (start, end) = (window.start_us as f64 * 1e-6, window.end_us as f64 * 1e-6);
        let circles = circles
            .into_iter()
            .map(|(index, center, radius)| ObservedCircle {
                index,
                t: 0.5 * (start + end),
                center,
                radius: Some(radius),
                velocity: None,
            })
            .collect();
        ReferenceFrame {
            recording: self.recording,
            start,
            end,
            circles,
            seen_in: SeenIn::Events(unique_pixels(events)),
        }
    }

    fn finish(&mut self) {
        self.close_chunk();
        self.search();
        self.drop_if_not_round();
    }

    /// Drops all detections if all windows together show that the dots are not round, although no single one did.
    fn drop_if_not_round(&mut self) {
        if self.frames.is_empty() || self.shape.may_be_discs() {
            return;
        }
        let dropped = self.frames.len() as u64;
        let circles = self.frames.iter().map(|frame| frame.circle_count() as u64).sum::<u64>();
        self.frames.clear();
        self.report.found -= dropped.min(self.report.found);
        self.report.board_circles -= circles.min(self.report.board_circles);
        self.report.found_by_neighbours = self.report.found_by_neighbours.min(self.report.found);
        *self.report.grids_refused.entry(NoBoard::NotRound).or_default() += dropped;
    }

    /// Returns the number of whole chunks that wait for the search.
    pub fn waiting_chunks(&self) -> usize {
        self.waiting.len()
    }

    /// Searches the waiting chunks and returns the reference frames found since the last call, in order of time: for callers that
    /// cannot wait for the end.
    pub fn take_frames(&mut self) -> Vec<ReferenceFrame> {
        self.search();
        self.drop_if_not_round();
        std::mem::take(&mut self.frames).into_iter().map(ReferenceFrame::from).collect()
    }

    /// Returns the reference frames in order of time, and the report.
    pub fn into_frames(self) -> (Vec<ReferenceFrame>, DetectionReport) {
        let (frames, _, report) = self.into_compact_frames();
        (frames.into_iter().map(ReferenceFrame::from).collect(), report)
    }

    /// Returns the frames in compact form, the windows that may show a larger board, and the report.
    pub fn into_compact_frames(mut self) -> (Vec<CompactFrame>, UnplacedWindows, DetectionReport) {
        self.finish();
        (self.frames, self.unplaced, self.report)
    }

    /// Returns the windows with circles in order of time, and the report.
    pub fn into_circles(mut self) -> (Vec<CircleWindow>, DetectionReport) {
        self.finish();
        (self.circle_windows, self.report)
    }
}

fn circle_window(window: &Window, circles: &[GridCandidate<f32>], pixels: Vec<EventPixel>) -> CircleWindow {
    CircleWindow {
        start: window.start_us as f64 * 1e-6,
        end: window.end_us as f64 * 1e-6,
        circles: circles.iter().map(|circle| (circle.center.cast(), f64::from(circle.radius))).collect(),
        pixels,
    }
}

/// Returns the circles of a board among `candidates`.
fn board_circles(placed: &[PlacedCircle], candidates: &[GridCandidate<f32>]) -> Vec<BoardCircle> {
    let circle = |placed: &PlacedCircle| {
        let candidate = candidates.get(placed.candidate)?;
        Some((placed.index, candidate.center.cast(), f64::from(candidate.radius)))
    };
    placed.iter().filter_map(circle).collect()
}

fn unique_pixels(events: &[Event]) -> Vec<EventPixel> {
    let mut pixels: Vec<EventPixel> = events.iter().map(EventPixel::new).collect();
    pixels.sort_unstable();
    pixels.dedup();
    // All frames of a recording keep their pixels, so unused capacity would add up.
    pixels.shrink_to_fit();
    pixels
}

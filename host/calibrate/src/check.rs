//! Check of a recording before a calibration. Some parts, spread evenly over the recording, are evaluated within
//! seconds.

mod advice;
pub mod units;

use std::collections::BTreeSet;
use std::fmt;
use std::ops::ControlFlow;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use serde::{Serialize, Serializer};

use self::advice::next_step;
use self::units::{OtherUnit, other_unit, unusual_unit};
use crate::advice::Advice;
use crate::quality::verdict::Finding;
use evcal_detection::detection::exchanged::{Exchanged, PAIRS, exchanged};
use evcal_detection::detection::focus::{EdgeWidth, edge_width};
use evcal_detection::detection::pictures::settings::PictureSettings;
use evcal_detection::detection::recognition::other_board::find_other_board;
use evcal_detection::detection::recognition::radius::{OtherRadius, other_radius};
use evcal_detection::detection::recognition::recognised::{Recognised, find_board};
use evcal_detection::detection::recognition::stated_board::search_evenly;
use evcal_detection::detection::search::{FoundContent, SearchFor, search_events};
use evcal_detection::detection::settings::DetectionSettings;
use evcal_detection::detection::still_views::search::{recognise_views, search_views};
use evcal_detection::detection::still_views::{FEWEST_VIEWS, LEAST_TIME, StillViews, duration};
use evcal_detection::detection::{DetectionReport, LARGEST_SENSOR, NoPattern, NoPatternCause};
use evcal_detection::diagnosis::bad_pixels::BadPixels;
use evcal_detection::diagnosis::double_edges::DoubleEdges;
use evcal_detection::diagnosis::information::{Information, gather_while};
use evcal_detection::diagnosis::lost_events::LostEvents;
use evcal_geometry::board::{Board, layout_name};
use evcal_solve::solve::event_sample::Thinning;
use event_recordings::given_sensor::counted_from_one;
use event_recordings::pass::read_recording;
use event_recordings::{Recording, RecordingError, RecordingOptions};

/// Approximate number of events in which the board is searched. Of longer recordings, only parts spread evenly over the
/// recording are searched.
const MOST_EVENTS: u64 = 4_000_000;
/// Number of these parts.
const PARTS: i64 = 8;
/// Largest number of events that are counted.
const MOST_READ: u64 = 100_000_000;
/// Largest number of views, spread evenly over a recording, that are searched for the board.
const MOST_VIEWS: usize = 48;
/// Fewest circles of a window without a known board.
const FEWEST_CIRCLES: usize = 8;
/// Length of the time slots in which the board is counted as seen or not (s).
const SLOT: f64 = 0.1;
/// Shortest recording in which flicker is detected (s).
const SHORTEST_FOR_FLICKER: f64 = 0.25;
/// Numbers of columns and rows of the sensor's cells in which circles are counted.
const CELLS: [u16; 2] = [8, 6];

/// Result of the check.
#[derive(Debug, Serialize)]
pub struct Checked {
    /// Rate, duration, size, hot pixels, errors.
    #[serde(flatten)]
    pub information: Information,
    /// `true` if the whole recording was read.
    pub whole: bool,
    /// The more likely unit of the timestamps.
    pub other_unit: Option<OtherUnit>,
    /// The sensor, if its pixels are counted from 1.
    pub counted_from_one: Option<Sensor>,
    /// Hot and silent pixels, repeated events.
    pub pixels: BadPixels,
    /// Edges that appear twice.
    pub double_edges: Option<DoubleEdges>,
    /// Events that were lost at random.
    pub lost_events: Option<LostEvents>,
    /// Detections of the board, or of circles; `None` if the sensor is not known or too large, or timestamps have another unit.
    pub seen: Option<Seen>,
    /// The most important next step. The program words it.
    #[serde(skip)]
    pub next: Advice,
}

/// Statistics of the windows with the board.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Seen {
    /// `true` if something blinks in front of a camera at rest: windows are views then.
    pub is_at_rest: bool,
    /// The board of the search; `None` if windows with at least 8 circles are counted.
    pub board: Option<String>,
    /// The recognised board, if no board was given.
    #[serde(serialize_with = "in_words")]
    pub recognised: Option<Recognised>,
    /// Number of windows with the board.
    pub found: u64,
    /// Number of searched windows, including those with too few events.
    pub windows: u64,
    /// Share of the tenths of a second with events in which it was found.
    pub time_share: f64,
    /// Share of the sensor with circles, in cells of an eighth by a sixth of it.
    pub covered: f64,
    /// Exchanged polarities.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exchanged: Option<Exchanged>,
    /// Width of the circles' edges in the sharpest windows with the board.
    pub edges: Option<EdgeWidth>,
    /// Reason why the board was not found, or differs from the stated one.
    pub failure: Option<BoardFailure>,
}

impl Seen {
    /// Returns `true` if the given board was found, or any board was recognised.
    pub fn shows_a_known_board(&self) -> bool {
        let is_other = |failure: &BoardFailure| match failure {
            BoardFailure::NoPattern(error) => matches!(error.main_cause(), NoPatternCause::OtherBoard(_)),
            BoardFailure::OtherRadius(_) => true,
        };
        self.recognised.is_some() || self.failure.as_ref().map_or(self.board.is_some() && self.found > 0, is_other)
    }
}

/// Reason why the board was not found, or differs from the stated one. Stored as a sentence in files.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BoardFailure {
    /// It was found in no window.
    #[error("{0}")]
    NoPattern(#[source] NoPattern),
    /// Its circles have another radius than stated.
    #[error("{0}")]
    OtherRadius(#[source] OtherRadius),
}

impl BoardFailure {
    /// Returns the remedy.
    fn advice(&self) -> Advice {
        match self {
            Self::NoPattern(error) => Advice::FindBoard(error.clone()),
            Self::OtherRadius(error) => Advice::CorrectRadius(error.clone()),
        }
    }
}

impl Serialize for BoardFailure {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}

/// Checks parts of `recording` that are spread evenly over it: searches for `board`, or for any circles. `of_board` is the
/// difference of the stated board from the recording, if there is one.
///
/// # Errors
/// [`RecordingError`] if no event can be read.
pub fn check(
    recording: &Recording,
    board: Option<&Board>,
    of_board: Option<&Finding>,
    settings: &DetectionSettings,
    pictures: &PictureSettings,
) -> Result<Checked, RecordingError> {
    // Few events are kept, because a file that hardly contains any may take long to read.
    let (mut count, mut last, mut end_of_beginning, mut kept) = (0, 0, None, Vec::new());
    recording.source_files().check()?;
    let mut information = gather_while(recording, &mut |events| {
        count += events.len() as u64;
        last = events.last().map_or(last, |event| event.t);
        if count > MOST_EVENTS {
            kept = Vec::new();
        } else {
            kept.extend_from_slice(events);
        }
        if count >= MOST_EVENTS {
            end_of_beginning.get_or_insert(last);
        }
        if count < MOST_READ { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
    })?;
    recording.source_files().check()?;
    if let Some(error) = information.error.take_if(|error| count == 0 || error.kind.is_repetition()) {
        return Err(error);
    }
    let first = information.times_us.map_or(0, |(first, _)| first);
    let end = last.saturating_sub(first);
    let whole = count < MOST_READ;
    let until = |last: i64| recording.section(first..last.saturating_add(1));
    let beginning = until(end_of_beginning.unwrap_or(last));
    let read = match whole {
        true if count <= MOST_EVENTS => in_memory(recording, kept, &information),
        true => recording.clone(),
        false => until(last),
    };
    let parts = (count > MOST_EVENTS).then(|| even_parts(&read, first, [end, count as i64], &information));
    let searched = parts.transpose()?.unwrap_or_else(|| read.clone());
    let outside = information.report.out_of_range;
    // The rate of a few events that are inside the sensor says nothing about the unit.
    let unit = |found: OtherUnit| (outside <= count).then_some(found);
    let mut other = unusual_unit(recording, information.mean_rate).and_then(unit);
    let counted_from_one =
        if outside > 0 || information.sensor.is_none() { counted_from_one(&beginning) } else { None };
    let mut pixels = BadPixels::default();
    let (mut double_edges, mut lost_events) = (None, None);
    let seen = match information.sensor.or(information.likely_sensor) {
        // With timestamps in another unit nothing can be found, and without events there is nothing.
        _ if other.is_some() || count == 0 => None,
        Some(sensor) if sensor.width <= LARGEST_SENSOR.width && sensor.height <= LARGEST_SENSOR.height => {
            let (bursts, slots) = follow_bursts(&searched, sensor)?;
            pixels = BadPixels::of_counts(&bursts.counts(), usize::from(sensor.width), bursts.repeated());
            if information.coarse_times.is_none() {
                double_edges = DoubleEdges::found(bursts.intervals());
                lost_events = LostEvents::found(bursts.pairs()).filter(LostEvents::is_certain);
            }
            let searched = SearchedRecording { parts: &searched, whole: &read, duration: end };
            Some(match search_still_views(&read, sensor, board, settings, pictures)? {
                // Few views are enough, because the camera may have been carried between them.
                Some(views) if views.at_rest >= LEAST_TIME || views.seen.found >= FEWEST_VIEWS as u64 => views.seen,
                views => {
                    let seen = search_for_board(searched, sensor, slots, board, settings)?;
                    views.map(|views| views.seen).filter(|views| seen.found == 0 && views.found > 0).unwrap_or(seen)
                }
            })
        }
        _ => None,
    };
    if seen.as_ref().is_some_and(|seen| seen.is_at_rest) {
        // Squares that stay dark have no events.
        (pixels.rounded, pixels.silent, lost_events) = (None, None, None);
    } else if seen.as_ref().is_some_and(|seen| seen.found == 0) {
        other = other_unit(&beginning, information.mean_rate).and_then(unit);
    }
    let mut checked = Checked {
        information,
        whole,
        other_unit: other,
        counted_from_one,
        pixels,
        double_edges,
        lost_events,
        seen,
        next: "".into(),
    };
    checked.next = next_step(&checked, of_board, recording);
    Ok(checked)
}

impl Checked {
    /// Returns `true` if the next step is a calibration from the recording, or, without a given board, to measure the
    /// board that was recognised.
    pub fn is_ready(&self) -> bool {
        match &self.next {
            Advice::Calibrate { .. } => true,
            Advice::Measure(found) => !found.is_mirrored(),
            _ => false,
        }
    }
}

/// Returns parts spread evenly over a recording, with about [`MOST_EVENTS`] events in all. The recording begins at
/// `first` (µs), ends `end` µs later and has `count` events.
fn even_parts(
    recording: &Recording,
    first: i64,
    [end, count]: [i64; 2],
    information: &Information,
) -> Result<Recording, RecordingError> {
    let length = (end as f64 * MOST_EVENTS as f64 / count.max(1) as f64 / PARTS as f64) as i64;
    let step = (end - length).max(0).unsigned_abs().div_ceil(PARTS.unsigned_abs() - 1) as i64;
    let is_in_a_part = |t: i64| t - (t / step.max(1)).min(PARTS - 1) * step <= length;
    let mut events = Vec::new();
    read_recording(recording, &mut |batch| {
        // In a file with very many events of one time, all of them are in a part.
        let room = (2 * MOST_EVENTS as usize).saturating_sub(events.len());
        let inside = batch.iter().filter(|event| is_in_a_part(event.t)).take(room);
        events.extend(inside.map(|event| Event { t: event.t + first, ..*event }));
    })?;
    Ok(in_memory(recording, events, information))
}

/// Returns a recording of these `events` of `recording`.
fn in_memory(recording: &Recording, events: Vec<Event>, information: &Information) -> Recording {
    let sensor = information.sensor.or(information.likely_sensor);
    Recording::from_events(recording.path(), events, RecordingOptions { sensor, ..RecordingOptions::default() })
}

/// A recording that is searched for the board.
#[derive(Clone, Copy)]
struct SearchedRecording<'a> {
    /// Parts that are spread evenly over it.
    parts: &'a Recording,
    /// All of it.
    whole: &'a Recording,
    /// Its duration (µs).
    duration: i64,
}

/// Follows the bursts of its pixels; also returns the number of time slots with events.
fn follow_bursts(recording: &Recording, sensor: Sensor) -> Result<(Thinning, usize), RecordingError> {
    let (mut bursts, mut slots) = (Thinning::new(sensor), BTreeSet::new());
    read_recording(recording, &mut |events| {
        // No event is kept.
        bursts.take(events, 0.0, &mut Vec::new());
        // Events are in the order of time, so the first one of each slot is enough.
        slots.extend(events.chunk_by(|a, b| slot(a) == slot(b)).filter_map(|same| same.first().map(slot)));
    })?;
    Ok((bursts, slots.len()))
}

/// Returns the time slot of an event.
fn slot(event: &Event) -> i64 {
    event.t.div_euclid((SLOT * 1e6) as i64)
}

/// Searches for the board, or for circles.
fn search_for_board(
    SearchedRecording { parts, whole, duration }: SearchedRecording,
    sensor: Sensor,
    slots_with_events: usize,
    board: Option<&Board>,
    settings: &DetectionSettings,
) -> Result<Seen, RecordingError> {
    let (content, report) = match board {
        Some(Board::Squares(board)) => {
            let (frames, report) = search_evenly(board, whole, sensor, duration)?;
            (FoundContent::Boards(board.lattice(), frames), report)
        }
        _ => {
            let wanted = board.map_or(SearchFor::Circles(FEWEST_CIRCLES), SearchFor::from);
            let found = search_events(parts, sensor, wanted, settings)?;
            (found.content, found.report)
        }
    };
    let (mut centers, mut times): (Vec<[f64; 2]>, Vec<f64>) = (Vec::new(), Vec::new());
    let (mut edges, mut reversed) = (None, None);
    match &content {
        FoundContent::Boards(_, frames) => {
            centers
                .extend(frames.iter().flat_map(|frame| &frame.circles).map(|circle| <[f64; 2]>::from(circle.center)));
            times.extend(frames.iter().map(|frame| frame.start));
            edges = edge_width(frames);
            let pairs = frames.iter().zip(frames.iter().skip(1));
            reversed = exchanged(pairs.step_by(frames.len().div_ceil(PAIRS).max(1)));
        }
        FoundContent::Windows(windows) => {
            let circles = windows.iter().flat_map(|window| &window.circles);
            centers.extend(circles.map(|(center, _)| <[f64; 2]>::from(*center)));
            times.extend(windows.iter().map(|window| window.start));
        }
        FoundContent::Frames(_) => {}
    }
    let slots: BTreeSet<i64> = times.iter().map(|t| (t / SLOT).floor() as i64).collect();
    let time_share = match board {
        Some(Board::Squares(_)) => report.found as f64 / report.windows.max(1) as f64,
        _ => slots.len() as f64 / slots_with_events.max(1) as f64,
    };
    let failure = match board {
        Some(board) if report.found == 0 => {
            let other = find_other_board(whole, sensor, board, settings)?;
            Some(BoardFailure::NoPattern(report.no_pattern(settings, other)))
        }
        Some(Board::Circles(board)) => match &content {
            FoundContent::Boards(_, frames) => other_radius(frames, board).map(BoardFailure::OtherRadius),
            _ => None,
        },
        Some(Board::Squares(_)) | None => None,
    };
    let recognised = match board {
        // As a calibration recognises it: 4 million events of a large sensor may be too short.
        None => find_board(whole, sensor, settings)?,
        Some(_) => None,
    };
    Ok(Seen {
        is_at_rest: false,
        recognised,
        board: board.map(ToString::to_string),
        found: report.found,
        windows: report.windows + report.too_few_events,
        time_share: time_share.min(1.0),
        covered: covered(&centers, sensor),
        edges,
        exchanged: reversed,
        failure,
    })
}

/// Views of a camera at rest.
struct SeenViews {
    /// Share of the time that they fill.
    at_rest: f64,
    seen: Seen,
}

/// Searches the views of a camera at rest; `None` if it never was.
fn search_still_views(
    recording: &Recording,
    sensor: Sensor,
    board: Option<&Board>,
    settings: &DetectionSettings,
    pictures: &PictureSettings,
) -> Result<Option<SeenViews>, RecordingError> {
    let mut views = StillViews::new(sensor);
    let pass = read_recording(recording, &mut |events| views.push(events))?;
    let mut views = views.finish();
    let time = pass.last.saturating_sub(pass.first) as f64 * 1e-6;
    if views.is_empty() || time <= 0.0 {
        return Ok(None);
    }
    let at_rest = views.iter().map(duration).sum::<f64>() / time;
    let step = views.len().div_ceil(MOST_VIEWS);
    views = views.into_iter().step_by(step).collect();
    let count = views.len() as u64;
    let recognised = if board.is_none() { recognise_views(&views).map(Recognised::Squares) } else { None };
    let found = board.map(|board| search_views(board, settings, pictures, &[views]));
    let frames = found.as_ref().map_or(&[][..], |found| &found.frames);
    let circles = frames.iter().flat_map(|frame| &frame.circles);
    let centers: Vec<[f64; 2]> = circles.map(|circle| circle.center.into()).collect();
    let seen: f64 = frames.iter().map(|frame| frame.end - frame.start).sum();
    let failure = found.as_ref().filter(|found| found.frames.is_empty()).map(|_| {
        let no_pattern = DetectionReport::default().no_pattern(settings, None);
        BoardFailure::NoPattern(no_pattern.at_rest(count))
    });
    let seen = Seen {
        is_at_rest: true,
        recognised,
        board: board.map(ToString::to_string),
        found: frames.len() as u64,
        windows: count,
        time_share: (seen / time).min(1.0),
        covered: covered(&centers, sensor),
        edges: None,
        exchanged: None,
        failure,
    };
    Ok(Some(SeenViews { at_rest, seen }))
}

/// Serialises the layout of a board of circles, such as `acircles:9x4`, or the description of a board of squares with
/// example lengths.
fn in_words<S: Serializer>(found: &Option<Recognised>, serializer: S) -> Result<S::Ok, S::Error> {
    let name = |found: Recognised| match found {
        Recognised::Circles(layout) => layout_name(&layout.pattern),
        Recognised::Squares(_) => found.example(),
    };
    found.map(name).serialize(serializer)
}

/// Returns the share of the sensor's cells that contain one of these positions.
fn covered(places: &[[f64; 2]], sensor: Sensor) -> f64 {
    let [columns, rows] = CELLS;
    let mut cells = vec![false; usize::from(columns) * usize::from(rows)];
    for [x, y] in places {
        let cell = |at: f64, size: u16, count: u16| {
            ((at + 0.5) / f64::from(size) * f64::from(count)).clamp(0.0, f64::from(count - 1)) as usize
        };
        let index = cell(*y, sensor.height, rows) * usize::from(columns) + cell(*x, sensor.width, columns);
        if let Some(cell) = cells.get_mut(index) {
            *cell = true;
        }
    }
    cells.iter().filter(|cell| **cell).count() as f64 / cells.len() as f64
}

impl fmt::Display for Checked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.information)?;
        if !self.whole {
            writeln!(f, "{:<12}the recording is longer; only its first {MOST_READ} events were examined", "part")?;
        }
        if let Some(other) = &self.other_unit {
            writeln!(f, "{:<12}{other}", "time unit")?;
        }
        if let Some(only) = self.information.only_polarity() {
            let only = if only == Polarity::On { "ON" } else { "OFF" };
            writeln!(f, "{:<12}{only} events only: a board is found in ON and OFF events together", "polarity")?;
        }
        if let Some(sensor) = self.counted_from_one {
            writeln!(f, "{:<12}{sensor}, counted from 1", "pixels")?;
        }
        if let Some(repeated) = self.pixels.repeated {
            writeln!(f, "{:<12}{repeated}", "repeated")?;
        }
        if let Some(rounded) = self.pixels.rounded {
            writeln!(f, "{:<12}{rounded}", "pixels")?;
        }
        if self.information.flicker.is_none() {
            let seen =
                if self.information.duration_s < SHORTEST_FOR_FLICKER { "recording too short" } else { "none seen" };
            writeln!(f, "{:<12}{seen}", "flicker")?;
        }
        if let Some(seen) = &self.seen {
            if seen.is_at_rest {
                let Seen { found, windows, .. } = seen;
                writeln!(f, "{:<12}something blinks in front of a camera at rest", "motion")?;
                if let Some(board) = &seen.board {
                    writeln!(f, "{:<12}{board} seen in {found} of {windows} views", "board")?;
                }
                return Ok(());
            }
            let what = match (&seen.board, &seen.recognised) {
                (None, Some(found @ Recognised::Squares(_))) => {
                    // What looks like circles are the squares.
                    return writeln!(f, "{:<12}{found}", "board");
                }
                (Some(board), _) => format!("{board} seen"),
                (None, _) => format!("{FEWEST_CIRCLES} or more circles seen"),
            };
            let Seen { found, windows, time_share, covered, .. } = seen;
            let (time, covered) = (100.0 * time_share, 100.0 * covered);
            writeln!(
                f,
                "{:<12}{what} in {found} of {windows} windows of a few milliseconds, in {time:.0} % of the intervals of 0.1 s with events, and on \
                 {covered:.0} % of the sensor",
                "board"
            )?;
            if let Some(edges) = seen.edges {
                writeln!(f, "{:<12}the circles' edges are {:.1} px wide", "focus", edges.pixels)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A pause of a minute must not reduce the share of the time with the board.
    #[test]
    fn a_time_without_events_has_no_slots() {
        let beginning = (0..10_000).map(|index| 100 * index);
        let end = beginning.clone().map(|t| t + 61_000_000);
        let event = |t: i64| Event { t, x: 1, y: 2, polarity: Polarity::On };
        let events = beginning.chain(end).map(event).collect();
        let recording = Recording::from_events("events", events, RecordingOptions::default());
        let (bursts, slots) = follow_bursts(&recording, Sensor::new(346, 260)).unwrap();
        assert_eq!((bursts.repeated(), slots), (0, 20));
    }

    /// The parts must not all come from the first 0.3 s of a recording with a high event rate.
    #[test]
    fn parts_are_spread_evenly_over_the_whole_recording() {
        let event = |t: i64| Event { t: 500 + t, x: 1, y: 2, polarity: Polarity::On };
        let events = (0..6_000_000).map(|index| event(5 * index)).collect();
        let recording = Recording::from_events("events", events, RecordingOptions::default());
        let information = gather_while(&recording, &mut |_| ControlFlow::Continue(())).unwrap();
        let parts = even_parts(&recording, 500, [5 * 5_999_999, 6_000_000], &information).unwrap();
        let mut seen = Vec::new();
        read_recording(&parts, &mut |events| seen.extend(events.iter().map(|event| event.t))).unwrap();
        assert!(seen.len().abs_diff(4_000_000) < 10, "{}", seen.len());
        assert_eq!((seen.first(), seen.last()), (Some(&0), Some(&(5 * 5_999_999))));
        let of_second = |second: i64| seen.iter().filter(|t| **t / 1_000_000 == second).count();
        assert!((0..30).all(|second| of_second(second) > 10_000), "{:?}", (0..30).map(of_second).collect::<Vec<_>>());
    }

    #[test]
    fn cells_are_counted_once() {
        let sensor = Sensor::new(80, 60);
        assert_eq!(covered(&[], sensor), 0.0);
        assert_eq!(covered(&[[1.0, 1.0], [2.0, 8.0], [79.5, 59.5], [-0.5, 100.0]], sensor), 3.0 / 48.0);
    }
}

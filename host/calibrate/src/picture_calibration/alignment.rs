//! Check that frames and events of the same moment show the board at the same position.
//!
//! No lens is needed for that, because both come from the same pixels. The points of the board in a frame are compared with those
//! in the windows of events before and after it. A program that flips, crops or scales one of the two, or stamps it with another
//! clock, leaves two calibrations that are each consistent, so a comparison of the calibrations does not reveal it.

use std::collections::BTreeMap;
use std::fmt;

use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use evcal_core::sensor::Sensor;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_geometry::board::Board;
use evcal_geometry::numerics::huber::huber_weight;
use evcal_geometry::numerics::statistics::median;
use evcal_solve::trajectory::alignment::MISTAKEN_RATES;

/// Fewest frames for the check.
const FEWEST: usize = 6;
/// Fewest common points of a frame and the events of its moment.
const FEWEST_POINTS: usize = 8;
/// Longest time between the windows of events before and after a frame (s).
const LONGEST_GAP: f64 = 0.06;
/// Largest typical distance of the points of frames and events that agree, as a share of the board's size in the image.
const FITS: f64 = 0.05;
/// Smallest ratio by which another orientation must fit better than the same one.
const BETTER: f64 = 3.0;
/// Difference in scale that is reported.
const OTHER_SCALE: f64 = 0.02;
/// Smallest shift that is reported (px).
const SHIFT: f64 = 1.5;
/// Smallest shift that is reported, as a multiple of the typical remaining distance.
const CLEAR_SHIFT: f64 = 3.0;
/// Typical offset between the clocks of frames and events (s), which separates the effect of motion from a shift.
const USUAL_OFFSET: f64 = 0.01;
/// Number of rounds in which the shift, or the clock, is estimated.
const ROUNDS: usize = 8;
/// Step of the search for the rate of another clock (ratio).
const RATE_STEP: f64 = 0.002;
/// Step of the search for the offset of another clock (s).
const OFFSET_STEP: f64 = 0.01;
/// Largest difference of the rate from the ratio of the time spans of both streams.
const RATE_RANGE: f64 = 0.05;
/// Largest number of frames in the search for another clock.
const MOST_SEARCHED: usize = 40;
/// Longest time that these frames span (s).
const LONGEST_SEARCHED: f64 = 16.0;
/// Smallest share of the frames that must fit with another clock.
const MOST_FIT: f64 = 0.8;
/// Rates closer to 1 than this belong to one clock with an offset.
const SAME_RATE: f64 = 0.003;

/// Orientation of the frames relative to the events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Orientation {
    /// The same orientation.
    Same,
    /// x is flipped.
    FlippedX,
    /// y is flipped.
    FlippedY,
    /// Both are flipped: half a turn.
    FlippedBoth,
    /// x and y are exchanged.
    Transposed,
    /// A quarter turn clockwise, from events to frames.
    QuarterClockwise,
    /// A quarter turn anticlockwise, from events to frames.
    QuarterAnticlockwise,
    /// x and y are exchanged, and both are flipped.
    TransposedFlipped,
}

impl Orientation {
    const ALL: [Self; 8] = [
        Self::Same,
        Self::FlippedX,
        Self::FlippedY,
        Self::FlippedBoth,
        Self::Transposed,
        Self::QuarterClockwise,
        Self::QuarterAnticlockwise,
        Self::TransposedFlipped,
    ];

    /// Returns the position of `place` on a `sensor` with this orientation.
    fn turned(self, place: Vector2<f64>, sensor: Sensor) -> Vector2<f64> {
        let (x, y) = (place.x, place.y);
        let (right, bottom) = (f64::from(sensor.width) - 1.0, f64::from(sensor.height) - 1.0);
        match self {
            Self::Same => Vector2::new(x, y),
            Self::FlippedX => Vector2::new(right - x, y),
            Self::FlippedY => Vector2::new(x, bottom - y),
            Self::FlippedBoth => Vector2::new(right - x, bottom - y),
            Self::Transposed => Vector2::new(y, x),
            Self::QuarterClockwise => Vector2::new(bottom - y, x),
            Self::QuarterAnticlockwise => Vector2::new(y, right - x),
            Self::TransposedFlipped => Vector2::new(bottom - y, right - x),
        }
    }
}

/// Difference between frames and events of the same moment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Misalignment {
    /// The images differ by a rotation, flip, scale or shift.
    Image {
        /// Orientation of the frames relative to the events.
        orientation: Orientation,
        /// Ratio of the size of the board in the frames to that in the events.
        scale: f64,
        /// Added to the position in the events, after rotation and scale, to get the position in the frames (px).
        shift: [f64; 2],
    },
    /// They agree if the clocks differ: a frame at time `t` (s from the first event) shows the events of time
    /// `offset + rate · t`.
    Clock {
        /// Seconds of the events per second of the frames.
        rate: f64,
        /// Time of the events at time zero of the frames (s).
        offset: f64,
    },
    /// They agree with no orientation and no clock.
    Unlike,
}

impl fmt::Display for Misalignment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Image { orientation, scale, shift } => {
                let words = match orientation {
                    Orientation::Same => None,
                    Orientation::FlippedX => Some("flipped left to right (in x)"),
                    Orientation::FlippedY => Some("flipped top to bottom (in y)"),
                    Orientation::FlippedBoth => Some("rotated by 180° (flipped in x and y)"),
                    Orientation::Transposed => Some("transposed (x and y exchanged)"),
                    Orientation::QuarterClockwise => Some("rotated by 90° (x and y exchanged, then flipped in x)"),
                    Orientation::QuarterAnticlockwise => Some("rotated by 90° (x and y exchanged, then flipped in y)"),
                    Orientation::TransposedFlipped => {
                        Some("transposed and rotated by 180° (x and y exchanged, then flipped in x and y)")
                    }
                };
                let mut parts: Vec<String> = words.map(str::to_owned).into_iter().collect();
                if (scale - 1.0).abs() > OTHER_SCALE {
                    parts.push(format!("scaled by {scale:.3}"));
                }
                let [x, y] = shift;
                if x.hypot(y) > SHIFT {
                    parts.push(format!("shifted by ({x:.1}, {y:.1}) px"));
                }
                write!(f, "the frames are {} against the events of the same moment", parts.join(" and "))
            }
            Self::Clock { rate, offset } if (rate - 1.0).abs() <= SAME_RATE => {
                let late = if offset < 0.0 { "later" } else { "earlier" };
                let offset = offset.abs();
                write!(f, "the times of the frames are {offset:.3} s {late} than the events of the same moment")
            }
            Self::Clock { rate, .. } => {
                write!(f, "the clock of the frames runs {:.3} times as fast as the events' clock", 1.0 / rate)
            }
            Self::Unlike => {
                write!(f, "frames and events show the board in different places at the same moment")
            }
        }
    }
}

impl Misalignment {
    /// Returns `true` if frames or events were turned, flipped or transposed.
    pub fn is_turned(&self) -> bool {
        matches!(self, Self::Image { orientation, .. } if *orientation != Orientation::Same)
    }

    /// Returns the remedy.
    pub fn advice(&self) -> &'static str {
        match self {
            Self::Image { .. } => {
                "the driver or a conversion flipped, cropped or scaled one of the two: record or convert both in the same way, or ignore the frames"
            }
            Self::Clock { .. } => {
                "the driver stamped frames and events with different clocks: correct the times, or ignore the frames"
            }
            Self::Unlike => "are they of one camera and of one recording? If not, ignore the frames",
        }
    }
}

/// Positions of the points of the board, by their index.
type Places = Vec<Option<Vector2<f64>>>;

/// The windows of one recording's events, in order of time.
struct EventTrack {
    times: Vec<f64>,
    places: Vec<Places>,
}

/// The board in a frame, with its time.
struct Seen {
    recording: usize,
    t: f64,
    places: Places,
}

/// The board in a frame and in the events of that moment.
struct Pair {
    frame: Places,
    events: Places,
    /// Velocity of the board's middle in the events (px/s).
    velocity: Vector2<f64>,
}

/// Compares the `frames` with the windows of `events` of the same `sensor` that show the `board`; times of both are
/// relative to the recording's first event. Returns `None` if they agree, or too few are of the same time for a
/// decision.
pub fn misalignment(
    events: &[ReferenceFrame],
    frames: &[ReferenceFrame],
    board: &Board,
    sensor: Sensor,
) -> Option<Misalignment> {
    let tracks = tracks(events, board);
    let seen = |frame: &ReferenceFrame| Seen {
        recording: frame.recording,
        t: frame.t(),
        places: places_of(frame, board.point_count()),
    };
    let frames: Vec<Seen> = frames.iter().map(seen).collect();
    let turns = turns(board);
    let pairs: Vec<Pair> = frames.iter().filter_map(|frame| pair(tracks.get(&frame.recording)?, frame)).collect();
    let size = typical_size(&frames)?;
    if pairs.len() >= FEWEST {
        let fits = Orientation::ALL.map(|orientation| fit(&pairs, orientation, sensor, &turns));
        if let Some(image) = image_of(&fits, size, sensor) {
            return image;
        }
    }
    // If a few frames agree, there are too few for a statement about the clock.
    if pairs.len() < FEWEST && pairs.iter().any(|pair| distance(pair, &turns) < FITS * size) {
        return None;
    }
    let clock = tracks.iter().find_map(|(recording, track)| {
        let of_recording: Vec<&Seen> = frames.iter().filter(|frame| frame.recording == *recording).collect();
        clock(track, &of_recording, &turns, FITS * size)
    });
    clock.or((pairs.len() >= FEWEST).then_some(Misalignment::Unlike))
}

/// Returns the result of the best of the `fits`, which are in the order of [`Orientation::ALL`]: `Some(None)` if both agree;
/// `None` if none fits.
fn image_of(fits: &[Option<ImageFit>; 8], size: f64, sensor: Sensor) -> Option<Option<Misalignment>> {
    let cost = |fit: &Option<ImageFit>| fit.as_ref().map_or(f64::INFINITY, |fit| fit.cost);
    let (place, best) = fits.iter().enumerate().min_by(|a, b| cost(a.1).total_cmp(&cost(b.1)))?;
    let same = fits.first()?;
    let (place, fit) = if cost(same) < FITS * size && cost(same) < BETTER * cost(best) {
        (0, same.as_ref()?)
    } else {
        (place, best.as_ref()?)
    };
    if fit.cost > FITS * size {
        return None;
    }
    let orientation = *Orientation::ALL.get(place)?;
    let is_scaled = (fit.scale - 1.0).abs() > OTHER_SCALE;
    // If the difference in scale is too small to be reported, the shift is measured in the middle of the image, where a
    // slightly longer lens causes none.
    let middle = orientation.turned(0.5 * Vector2::new(f64::from(sensor.width), f64::from(sensor.height)), sensor);
    let shift = if is_scaled { fit.shift } else { fit.shift + (fit.scale - 1.0) * middle };
    let is_shifted = shift.norm() > SHIFT.max(CLEAR_SHIFT * fit.cost);
    let shift = if is_shifted { shift.into() } else { [0.0; 2] };
    let differs = orientation != Orientation::Same || is_shifted || is_scaled;
    Some(differs.then_some(Misalignment::Image { orientation, scale: fit.scale, shift }))
}

/// Fit of one orientation.
struct ImageFit {
    /// Typical distance of the frames' points from their prediction by the events (px).
    cost: f64,
    scale: f64,
    shift: Vector2<f64>,
}

/// Estimates scale, shift and offset of the clocks with which the events, in this `orientation`, agree best with the frames.
fn fit(pairs: &[Pair], orientation: Orientation, sensor: Sensor, turns: &[Vec<usize>]) -> Option<ImageFit> {
    let turned = |places: &Places| -> Places {
        places.iter().map(|place| place.map(|place| orientation.turned(place, sensor))).collect()
    };
    let similarities: Vec<(Similarity, Vector2<f64>)> = pairs
        .iter()
        .filter_map(|pair| {
            let events = turned(&pair.events);
            let similarities = turns.iter().filter_map(|turn| compare(&events, &pair.frame, turn));
            let best = similarities.min_by(|a, b| a.spread.total_cmp(&b.spread))?;
            let origin = orientation.turned(Vector2::zeros(), sensor);
            Some((best, orientation.turned(pair.velocity, sensor) - origin))
        })
        .collect();
    let scale =
        median(&mut similarities.iter().map(|(similarity, _)| similarity.scale).collect::<Vec<_>>(), f64::total_cmp)?;
    let offsets: Vec<(Vector2<f64>, Vector2<f64>, f64)> = similarities
        .iter()
        .map(|(similarity, velocity)| (similarity.frame - scale * similarity.events, *velocity, similarity.spread))
        .collect();
    // shift + late · velocity = offset
    let mut solution = Vector3::zeros();
    let mut distances: Vec<f64> = Vec::new();
    for round in 0..ROUNDS {
        let bound = if round == 0 { f64::INFINITY } else { median(&mut distances, f64::total_cmp)?.max(0.1) };
        let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
        matrix[(2, 2)] = bound.min(1.0).powi(2) / USUAL_OFFSET.powi(2);
        let residual = |offset: &Vector2<f64>, velocity: &Vector2<f64>| offset - solution.xy() - solution.z * velocity;
        for (offset, velocity, _) in &offsets {
            let weight = huber_weight(residual(offset, velocity).norm_squared(), bound);
            for axis in 0..2 {
                let mut row = Vector3::new(0.0, 0.0, velocity[axis]);
                row[axis] = 1.0;
                matrix += weight * row * row.transpose();
                right += weight * offset[axis] * row;
            }
        }
        solution = matrix.cholesky()?.solve(&right);
        let residual = |offset: &Vector2<f64>, velocity: &Vector2<f64>| offset - solution.xy() - solution.z * velocity;
        distances =
            offsets.iter().map(|(offset, velocity, spread)| residual(offset, velocity).norm().hypot(*spread)).collect();
    }
    Some(ImageFit { cost: median(&mut distances, f64::total_cmp)?, scale, shift: solution.xy() })
}

/// Relation of the points of a frame and of events.
struct Similarity {
    /// Middle of the common points in the frame and in the events (px).
    frame: Vector2<f64>,
    events: Vector2<f64>,
    /// Ratio of the size in the frame to the size in the events.
    scale: f64,
    /// Remaining distance (px, rms).
    spread: f64,
}

/// Compares points by index; `turn` permutes the points of the frame.
fn compare(events: &Places, frame: &Places, turn: &[usize]) -> Option<Similarity> {
    let shared: Vec<(Vector2<f64>, Vector2<f64>)> = turn
        .iter()
        .enumerate()
        .filter_map(|(index, other)| Some(((*events.get(index)?)?, (*frame.get(*other)?)?)))
        .collect();
    if shared.len() < FEWEST_POINTS {
        return None;
    }
    let count = shared.len() as f64;
    let middle_of_events = shared.iter().map(|(event, _)| event).sum::<Vector2<f64>>() / count;
    let middle_of_frame = shared.iter().map(|(_, frame)| frame).sum::<Vector2<f64>>() / count;
    let centred = || shared.iter().map(|(event, frame)| (event - middle_of_events, frame - middle_of_frame));
    let products: f64 = centred().map(|(event, frame)| event.dot(&frame)).sum();
    let scale = products / centred().map(|(event, _)| event.norm_squared()).sum::<f64>();
    let left: f64 = centred().map(|(event, frame)| (frame - scale * event).norm_squared()).sum();
    (scale > 0.0).then(|| Similarity {
        frame: middle_of_frame,
        events: middle_of_events,
        scale,
        spread: (left / count).sqrt(),
    })
}

/// Returns the clock with which the events agree with `frames` within `bound` px, if there is one.
fn clock(track: &EventTrack, frames: &[&Seen], turns: &[Vec<usize>], bound: f64) -> Option<Misalignment> {
    let (first, last) = (frames.first()?.t, frames.last()?.t);
    let (begin, end) = (*track.times.first()?, *track.times.last()?);
    let near: Vec<&&Seen> = frames.iter().filter(|frame| frame.t - first < LONGEST_SEARCHED).collect();
    let step = near.len().div_ceil(MOST_SEARCHED).max(1);
    let searched: Vec<&Seen> = near.into_iter().step_by(step).copied().collect();
    let spans = (end - begin) / (last - first).max(f64::MIN_POSITIVE);
    let steps = (RATE_RANGE / RATE_STEP).round() as i32;
    let around = (-steps..=steps).map(|step| spans * (1.0 + f64::from(step) * RATE_STEP));
    let mut best: Option<(usize, f64, f64)> = None;
    for rate in MISTAKEN_RATES.into_iter().chain(around) {
        let (low, high) = (begin - rate * searched.last()?.t, end - rate * first);
        let count = ((high - low) / OFFSET_STEP).ceil().max(0.0) as usize;
        for offset in (0..=count).map(|step| low + step as f64 * OFFSET_STEP) {
            let most = best.map_or(0, |(fitting, ..)| fitting);
            if let Some(fitting) = fitting(track, &searched, turns, bound, [rate, offset]).filter(|fits| *fits > most) {
                best = Some((fitting, rate, offset));
            }
        }
    }
    let (_, rate, offset) = best?;
    let [rate, offset] = refined(track, frames, turns, [rate, offset]);
    Some(Misalignment::Clock { rate, offset })
}

/// Returns the number of frames that agree with the events with this clock; `None` if too few or too small a share.
fn fitting(
    track: &EventTrack,
    frames: &[&Seen],
    turns: &[Vec<usize>],
    bound: f64,
    [rate, offset]: [f64; 2],
) -> Option<usize> {
    let (mut compared, mut fitting) = (0, 0);
    for frame in frames {
        let Some(pair) = pair_at(track, frame, offset + rate * frame.t) else { continue };
        compared += 1;
        fitting += usize::from(distance(&pair, turns) < bound);
        // The loop stops early, because most clocks that are tried are wrong.
        if compared - fitting > 2 && (fitting as f64) < MOST_FIT * compared as f64 {
            return None;
        }
    }
    (fitting >= FEWEST && fitting as f64 >= MOST_FIT * compared as f64).then_some(fitting)
}

/// Returns the distance between the points of a frame and of the events (px, rms), for the best rotation of the board.
fn distance(pair: &Pair, turns: &[Vec<usize>]) -> f64 {
    let similarities = turns.iter().filter_map(|turn| compare(&pair.events, &pair.frame, turn));
    similarities
        .map(|similarity| (similarity.frame - similarity.events).norm().hypot(similarity.spread))
        .fold(f64::INFINITY, f64::min)
}

/// Refines the clock so that the middles of the boards are nearest.
fn refined(track: &EventTrack, frames: &[&Seen], turns: &[Vec<usize>], clock: [f64; 2]) -> [f64; 2] {
    let [mut rate, mut offset] = clock;
    for _ in 0..ROUNDS {
        let mut rows: Vec<(f64, Vector2<f64>, Vector2<f64>)> = Vec::new();
        for frame in frames {
            let Some(pair) = pair_at(track, frame, offset + rate * frame.t) else { continue };
            let similarities = turns.iter().filter_map(|turn| compare(&pair.events, &pair.frame, turn));
            let best = similarities.min_by(|a, b| a.spread.total_cmp(&b.spread));
            rows.extend(best.map(|similarity| (frame.t, similarity.frame - similarity.events, pair.velocity)));
        }
        let mut distances: Vec<f64> = rows.iter().map(|(_, distance, _)| distance.norm()).collect();
        let Some(bound) = median(&mut distances, f64::total_cmp) else { break };
        let (mut matrix, mut right) = (nalgebra::Matrix2::zeros(), Vector2::zeros());
        for (t, distance, velocity) in &rows {
            let weight = huber_weight(distance.norm_squared(), bound.max(0.1));
            let row = Vector2::new(*t, 1.0);
            matrix += weight * velocity.norm_squared() * row * row.transpose();
            right += weight * velocity.dot(distance) * row;
        }
        let Some(change) = matrix.cholesky().map(|matrix| matrix.solve(&right)) else { break };
        rate += change.x;
        offset += change.y;
    }
    [rate, offset]
}

/// Returns `frame` with the events of its time, if both show enough of the board.
fn pair(track: &EventTrack, frame: &Seen) -> Option<Pair> {
    pair_at(track, frame, frame.t)
}

/// Returns `frame` with the events of time `t`, interpolated between two windows.
fn pair_at(track: &EventTrack, frame: &Seen, t: f64) -> Option<Pair> {
    let after = track.times.partition_point(|time| *time < t);
    let before = after.checked_sub(1)?;
    let (early, late) = (*track.times.get(before)?, *track.times.get(after)?);
    if late - early > LONGEST_GAP {
        return None;
    }
    let share = (t - early) / (late - early);
    let between: Places = track
        .places
        .get(before)?
        .iter()
        .zip(track.places.get(after)?)
        .map(|(early, late)| Some((*early)?.lerp(&(*late)?, share)))
        .collect();
    let moved: Vec<Vector2<f64>> = track
        .places
        .get(before)?
        .iter()
        .zip(track.places.get(after)?)
        .filter_map(|(early, late)| Some((*late)? - (*early)?))
        .collect();
    if moved.len() < FEWEST_POINTS {
        return None;
    }
    let velocity = moved.iter().sum::<Vector2<f64>>() / (moved.len() as f64 * (late - early));
    Some(Pair { frame: frame.places.clone(), events: between, velocity })
}

/// Returns the windows of each recording in order of time, each time once.
fn tracks(events: &[ReferenceFrame], board: &Board) -> BTreeMap<usize, EventTrack> {
    let mut sorted: Vec<&ReferenceFrame> = events.iter().filter(|frame| frame.t().is_finite()).collect();
    sorted.sort_by(|a, b| a.recording.cmp(&b.recording).then(a.t().total_cmp(&b.t())));
    sorted.dedup_by(|a, b| a.recording == b.recording && a.t() <= b.t());
    let mut tracks: BTreeMap<usize, EventTrack> = BTreeMap::new();
    for frame in sorted {
        let track =
            tracks.entry(frame.recording).or_insert_with(|| EventTrack { times: Vec::new(), places: Vec::new() });
        track.times.push(frame.t());
        track.places.push(places_of(frame, board.point_count()));
    }
    tracks
}

fn places_of(frame: &ReferenceFrame, count: usize) -> Places {
    let mut places = vec![None; count];
    for circle in &frame.circles {
        if let Some(place) = places.get_mut(circle.index) {
            *place = Some(circle.center);
        }
    }
    places
}

/// Returns the median size of the board in the frames: the rms distance of its points from their middle (px).
fn typical_size(frames: &[Seen]) -> Option<f64> {
    let size = |frame: &Seen| {
        let places: Vec<Vector2<f64>> = frame.places.iter().flatten().copied().collect();
        let middle = places.iter().sum::<Vector2<f64>>() / places.len().max(1) as f64;
        let squares: f64 = places.iter().map(|place| (place - middle).norm_squared()).sum();
        (squares / places.len().max(1) as f64).sqrt()
    };
    median(&mut frames.iter().map(size).collect::<Vec<_>>(), f64::total_cmp)
}

/// Returns the permutations of the points for each rotation or flip under which `board` looks the same; the identity comes first.
fn turns(board: &Board) -> Vec<Vec<usize>> {
    let points: Vec<Vector2<f64>> = (0..board.point_count()).map(|index| board.point(index)).collect();
    let middle = board.middle();
    let near = 1e-6 * board.longer_side();
    // About the pixel (0, 0), which is the middle of the board there.
    let moved = |orientation: &Orientation, point: &Vector2<f64>| {
        middle + orientation.turned(point - middle, Sensor::new(1, 1))
    };
    Orientation::ALL
        .iter()
        .filter_map(|orientation| {
            let place = |point| {
                let moved = moved(orientation, point);
                points.iter().position(|other| (other - moved).norm() < near)
            };
            points.iter().map(place).collect()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_detection::circles::reference_frame::{ObservedCircle, SeenIn};

    const SENSOR: Sensor = Sensor::new(346, 260);

    /// The board at time `t` on a path that never repeats, as a pinhole camera sees it.
    fn frame_at(board: &Board, stamp: f64, t: f64, changed: impl Fn(Vector2<f64>) -> Vector2<f64>) -> ReferenceFrame {
        let middle = Vector2::new(
            173.0 + 50.0 * (1.3 * t).sin() + 15.0 * (2.9 * t).sin(),
            130.0 + 40.0 * (1.7 * t + 1.0).sin() + 9.0 * (4.1 * t).cos(),
        );
        let (sin, cos) = (0.4 * (0.9 * t).sin()).sin_cos();
        let pixels_per_metre = 300.0 + 40.0 * (0.6 * t).sin();
        let circle = |index: usize| {
            let point = pixels_per_metre * (board.point(index) - board.middle());
            let place = middle + Vector2::new(cos * point.x - sin * point.y, sin * point.x + cos * point.y);
            ObservedCircle { index, t: stamp, center: changed(place), radius: None, velocity: None }
        };
        let circles = (0..board.point_count()).map(circle).collect();
        ReferenceFrame { recording: 0, start: stamp, end: stamp, circles, seen_in: SeenIn::PassedEvents }
    }

    /// Events of 8 s against frames of the same motion, changed by `changed` and stamped by `clock`.
    fn found(
        board: &Board,
        changed: impl Fn(Vector2<f64>) -> Vector2<f64> + Copy,
        clock: impl Fn(f64) -> f64,
    ) -> Option<Misalignment> {
        let events: Vec<_> = (0..800).map(|window| 0.01 * f64::from(window)).collect();
        let events: Vec<_> = events.iter().map(|&t| frame_at(board, t, t, |place| place)).collect();
        // The latency of pixels is 2 ms.
        let frames: Vec<_> = (0..130).map(|frame| 0.1 + 0.06 * f64::from(frame)).collect();
        let frames: Vec<_> = frames.iter().map(|&t| frame_at(board, clock(t - 0.002), t, changed)).collect();
        misalignment(&events, &frames, board, SENSOR)
    }

    #[test]
    fn frames_of_the_same_image_are_aligned() {
        for board in ["acircles:9x4:55mm:r17.5mm", "acircles:10x4:55mm:r17.5mm", "circles:5x5:50mm:r15mm"] {
            let board: Board = board.parse().unwrap();
            assert_eq!(found(&board, |place| place, |t| t), None, "{board}");
            // A lens that is 1 % longer.
            let longer = |place: Vector2<f64>| Vector2::new(173.0, 130.0) + 1.01 * (place - Vector2::new(173.0, 130.0));
            assert_eq!(found(&board, longer, |t| t), None, "{board}");
        }
    }

    #[test]
    fn each_orientation_is_reported_even_of_boards_with_mirror_symmetry() {
        for board in ["acircles:9x4:55mm:r17.5mm", "acircles:10x4:55mm:r17.5mm", "circles:5x5:50mm:r15mm"] {
            let board: Board = board.parse().unwrap();
            for orientation in Orientation::ALL.into_iter().skip(1) {
                // The grid finder numbers the points as on a valid board, from a corner.
                let turned = |place| orientation.turned(place, SENSOR);
                let found = found(&board, turned, |t| t);
                let Some(Misalignment::Image { orientation: named, shift: [0.0, 0.0], .. }) = found else {
                    panic!("{board}, {orientation:?}: {found:?}");
                };
                assert_eq!(named, orientation, "{board}");
            }
        }
    }

    #[test]
    fn a_crop_and_a_scale_are_named_with_and_without_a_flip() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let cropped = |place: Vector2<f64>| place - Vector2::new(40.0, 30.0);
        let Some(Misalignment::Image { orientation: Orientation::Same, shift: [x, y], .. }) =
            found(&board, cropped, |t| t)
        else {
            panic!("not named");
        };
        assert!((x + 40.0).abs() < 0.3 && (y + 30.0).abs() < 0.3, "({x}, {y})");
        let flipped = |place: Vector2<f64>| Vector2::new(345.0 - place.x - 12.0, place.y);
        let found_flipped = found(&board, flipped, |t| t);
        let Some(Misalignment::Image { orientation: Orientation::FlippedX, shift: [x, _], .. }) = found_flipped else {
            panic!("{found_flipped:?}");
        };
        assert!((x + 12.0).abs() < 0.3, "{x}");
        let half = found(&board, |place| 0.5 * place, |t| t);
        let Some(Misalignment::Image { scale, .. }) = half else { panic!("{half:?}") };
        assert!((scale - 0.5).abs() < 1e-3, "{scale}");
    }

    #[test]
    fn rate_and_offset_of_another_clock_are_measured() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        for (rate, offset) in [(0.5, 0.0), (0.5, -20.0), (2.0, 0.3), (1.0, -1.5), (1.25, 0.0), (1.0, 0.4)] {
            let clock = |t: f64| (t - offset) / rate;
            let found = found(&board, |place| place, clock);
            let Some(Misalignment::Clock { rate: named, offset: at }) = found else {
                panic!("{rate}, {offset}: {found:?}");
            };
            assert!((named - rate).abs() < 2e-3 && (at - offset).abs() < 0.02, "{rate} {offset}: {named} {at}");
        }
    }

    #[test]
    fn frames_of_another_camera_are_detected() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        // A camera next to the first, rotated and tilted: near points move more.
        let next_to_first = |place: Vector2<f64>| {
            Vector2::new(0.8 * place.x + 0.3 * place.y + 0.001 * place.x * place.x, 1.1 * place.y)
        };
        assert_eq!(found(&board, next_to_first, |t| t), Some(Misalignment::Unlike));
    }
}

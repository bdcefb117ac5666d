//! Recognition of the layout of a circle grid, for users who did not state it, or stated it wrongly.
//!
//! Every layout of a plausible number of circles is tried on the circles of a sample of windows. A window counts for a layout by
//! the circles that it places, minus those that it misses. A layout that is too small loses because the grid finder rejects it
//! where the lattice continues, and one that is too large because it is never complete. Spacing and radius cannot be determined:
//! a small board nearby and a large one far away have the same events.

use std::fmt;
use std::ops::ControlFlow;

use evcal_core::event::Event;
use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;

use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, UnorderedFrame};
use crate::detection::CircleWindow;
use crate::detection::DetectionStage;
use crate::detection::order_frames;
use crate::detection::settings::DetectionSettings;
use evcal_geometry::board::{CircleBoard, layout_name};
use evcal_geometry::numerics::statistics::median;
use event_recordings::pass::read_while;
use event_recordings::{Recording, RecordingError};

/// Length of the beginning of a recording that is evaluated (µs).
pub(super) const LONGEST: i64 = 4_000_000;
/// Fewest circles of a window that is evaluated.
pub(in crate::detection) const FEWEST_CIRCLES: usize = 8;
/// Number of windows on which every layout is tried.
const SAMPLE: usize = 40;
/// Smallest share of the windows that the layout must fit.
const FEWEST_FITS: f64 = 0.2;
/// Smallest number of windows that the layout must fit.
const FEWEST_WINDOWS: usize = 5;
/// Range of the number of circles of the layouts, relative to a full window. Clutter adds circles; a board that is never
/// completely in view has fewer.
const COUNTS: std::ops::Range<f64> = 0.4..1.3;
/// Range of rows of the layouts.
const ROWS: std::ops::RangeInclusive<u8> = 3..=20;
/// Range of columns of the layouts.
const COLUMNS: std::ops::RangeInclusive<u8> = 2..=14;

/// The layout that fits most windows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecognisedLayout {
    /// Its layout.
    pub pattern: Pattern,
    /// Number of windows that it fits.
    pub fitting: usize,
    /// Number of windows with enough circles.
    pub windows: usize,
    /// Radius of the circles relative to the spacing, as measured in the image: slightly more than the printed one.
    pub radius: Option<f64>,
}

impl RecognisedLayout {
    /// Names the lengths that the user has to measure.
    pub fn to_measure(&self) -> String {
        let spacing = match self.pattern.layout {
            Layout::Asymmetric => "the spacing (half the distance of neighbours in a row)",
            Layout::Symmetric => "the spacing of neighbours",
        };
        let about = self.radius.map(|radius| format!(" (about {radius:.2} of the spacing)")).unwrap_or_default();
        format!("measure {spacing} and the radius of a circle{about}")
    }

    /// Returns a board of this layout, as users write it.
    pub fn example(&self) -> String {
        format!("{}:55mm:r17.5mm", layout_name(&self.pattern))
    }
}

impl fmt::Display for RecognisedLayout {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { pattern, fitting, windows, .. } = self;
        write!(f, "{}, which fits {fitting} of {windows} windows", layout_name(pattern))
    }
}

/// Searches the first seconds of a recording for the layout of the board; `None` if none fits.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn find_layout(
    recording: &Recording,
    sensor: Sensor,
    settings: &DetectionSettings,
) -> Result<Option<RecognisedLayout>, RecordingError> {
    Ok(recognise(&first_circles(recording, sensor, settings, FEWEST_CIRCLES)?, sensor))
}

/// Returns the windows of the first seconds of a recording that have at least `fewest` circles.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub(in crate::detection) fn first_circles(
    recording: &Recording,
    sensor: Sensor,
    settings: &DetectionSettings,
    fewest: usize,
) -> Result<Vec<UnorderedFrame>, RecordingError> {
    let mut stage = DetectionStage::for_circles(settings, sensor, fewest);
    read_beginning(recording, &mut |events| stage.push(events))?;
    let (windows, _) = stage.into_circles();
    Ok(windows.iter().map(CircleWindow::to_frame).collect())
}

/// Reads the events of the first seconds of a recording.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub(in crate::detection) fn read_beginning(
    recording: &Recording,
    visit: &mut dyn FnMut(&[Event]),
) -> Result<(), RecordingError> {
    read_while(recording, &mut |batch| {
        let count = batch.events.partition_point(|event| event.t <= LONGEST);
        visit(batch.events.get(..count).unwrap_or_default());
        if count < batch.events.len() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    Ok(())
}

/// Returns the layout that fits most of these windows; `None` if none does.
pub(in crate::detection) fn recognise(frames: &[UnorderedFrame], sensor: Sensor) -> Option<RecognisedLayout> {
    let sample = fullest(frames);
    let mut counts: Vec<f64> = sample.iter().map(|frame| frame.circles.len() as f64).collect();
    let full = median(&mut counts, f64::total_cmp)?;
    let tried = layouts().filter(|pattern| COUNTS.contains(&(pattern.circle_count() as f64 / full)));
    let pattern = most_fitting(&sample, tried, sensor)?;
    let (found, _) = order_frames(frames, &pattern, Some(sensor));
    if found.len() < FEWEST_WINDOWS || (found.len() as f64) < FEWEST_FITS * frames.len() as f64 {
        return None;
    }
    let unit = CircleBoard { pattern, spacing: 1.0, radius: 0.0 };
    let mut ratios: Vec<f64> = found.iter().flat_map(|frame| radius_ratios(frame, &unit)).collect();
    let radius = median(&mut ratios, f64::total_cmp).map(|ratio| ratio * unit.neighbour_distance());
    Some(RecognisedLayout { pattern, fitting: found.len(), windows: frames.len(), radius })
}

/// Returns the layout that places most circles of the frames and misses fewest, the first of equals; `None` if all miss more than
/// they place.
pub(in crate::detection) fn most_fitting(
    frames: &[UnorderedFrame],
    patterns: impl DoubleEndedIterator<Item = Pattern>,
    sensor: Sensor,
) -> Option<Pattern> {
    let score = |pattern: &Pattern| {
        let whole = pattern.circle_count();
        let (found, _) = order_frames(frames, pattern, Some(sensor));
        found.iter().map(|frame| (2 * frame.circles.len()).saturating_sub(whole)).sum::<usize>()
    };
    // `max_by_key` returns the last of equal elements, which is the first layout because of `rev`.
    let scored = patterns.map(|pattern| (score(&pattern), pattern)).rev();
    scored.max_by_key(|(score, _)| *score).filter(|best| best.0 > 0).map(|(_, pattern)| pattern)
}

/// Returns the radius divided by the distance of neighbouring centres in the image, for each circle with a neighbour. Only the
/// layout of the board is used.
pub fn radius_ratios(frame: &ReferenceFrame, board: &CircleBoard) -> Vec<f64> {
    let nearest = board.neighbour_distance() * 1.01;
    let circles = &frame.circles;
    let ratio = |(index, circle): (usize, &ObservedCircle)| {
        let place = board.circle_center(circle.index);
        let neighbours = circles.iter().enumerate().filter(|(other, neighbour)| {
            *other != index && (board.circle_center(neighbour.index) - place).norm() < nearest
        });
        let distances: Vec<f64> = neighbours.map(|(_, neighbour)| (neighbour.center - circle.center).norm()).collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        (!distances.is_empty() && mean > 0.0).then(|| circle.radius.map(|radius| radius / mean)).flatten()
    };
    circles.iter().enumerate().filter_map(ratio).collect()
}

/// Selects the half of the windows that have most circles, and returns up to [`SAMPLE`] of them, spread over time.
fn fullest(frames: &[UnorderedFrame]) -> Vec<UnorderedFrame> {
    let mut counts: Vec<usize> = frames.iter().map(|frame| frame.circles.len()).collect();
    counts.sort_unstable();
    let fewest = counts.get(counts.len() / 2).copied().unwrap_or(0);
    let full: Vec<&UnorderedFrame> = frames.iter().filter(|frame| frame.circles.len() >= fewest).collect();
    full.iter().step_by(full.len().div_ceil(SAMPLE).max(1)).map(|frame| (*frame).clone()).collect()
}

/// Returns all layouts that may be printed. A symmetric one looks the same with rows and columns exchanged.
fn layouts() -> impl DoubleEndedIterator<Item = Pattern> {
    [Layout::Asymmetric, Layout::Symmetric].into_iter().flat_map(|layout| {
        ROWS.flat_map(move |rows| COLUMNS.map(move |columns| Pattern { layout, rows, columns }))
            .filter(|pattern| pattern.layout == Layout::Asymmetric || pattern.rows >= pattern.columns)
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::circles::reference_frame::UnorderedCircle;

    const SENSOR: Sensor = Sensor::new(346, 260);

    /// Views of a board that rotates and tilts, with clutter.
    fn views(board: &CircleBoard) -> Vec<UnorderedFrame> {
        (0..60)
            .map(|view| {
                let part = f64::from(view) / 60.0;
                let (sin, cos) = (0.6 * (part - 0.5)).sin_cos();
                let scale = 200.0 / board.longer_side();
                let place = |index: usize| {
                    let point = (board.circle_center(index) - board.middle()) * scale;
                    let turned = Vector2::new(cos * point.x - sin * point.y, sin * point.x + cos * point.y);
                    let nearer = 1.0 + (0.002 * (part - 0.3)) * turned.x + 0.0007 * turned.y;
                    (turned / nearer + Vector2::new(173.0 + 40.0 * (part - 0.5), 130.0), board.radius * scale)
                };
                let clutter = [(Vector2::new(12.0 + f64::from(view), 9.0), 3.0), (Vector2::new(330.0, 240.0), 6.0)];
                let circles = (0..board.circle_count()).map(place).chain(clutter);
                let inside =
                    circles.filter(|(center, _)| (0.0..346.0).contains(&center.x) && (0.0..260.0).contains(&center.y));
                let circle =
                    |(center, radius)| UnorderedCircle { t: part, center, radius: Some(radius), velocity: None };
                UnorderedFrame { start: part, end: part + 0.01, circles: inside.map(circle).collect() }
            })
            .collect()
    }

    #[test]
    fn layouts_are_recognised_whatever_was_printed() {
        for text in [
            "acircles:9x4:55mm:r17.5mm",
            "acircles:11x4:20mm:r6mm",
            "acircles:8x4:20mm:r6mm",
            "acircles:4x9:30mm:r9mm",
            "circles:6x5:20mm:r6mm",
            "circles:7x7:20mm:r6mm",
        ] {
            let board: CircleBoard = text.parse().unwrap();
            let found = recognise(&views(&board), SENSOR).unwrap();
            assert_eq!(found.pattern, board.pattern, "{text}");
            assert!(found.fitting > 50 && found.windows == 60, "{text}: {found:?}");
            let ratio = board.radius / board.spacing;
            assert!((found.radius.unwrap() / ratio - 1.0).abs() < 0.1, "{text}: {found:?}");
        }
    }

    #[test]
    fn circles_without_order_are_not_a_board() {
        let circle = |view: u32, index: u32| {
            let at = |factor: u32, size: u32| f64::from((view * 31 + index * factor + index * index * 17) % size);
            UnorderedCircle {
                t: 0.0,
                center: Vector2::new(at(113, 346), at(71, 260)),
                radius: Some(5.0),
                velocity: None,
            }
        };
        let frames: Vec<UnorderedFrame> = (0..60)
            .map(|view| UnorderedFrame {
                start: 0.0,
                end: 0.01,
                circles: (0..30).map(|index| circle(view, index)).collect(),
            })
            .collect();
        assert_eq!(recognise(&frames, SENSOR), None);
        assert_eq!(recognise(&[], SENSOR), None);
    }
}

//! Comparison of a stated board with some pictures or windows, before the whole recording is searched for it.
//!
//! The pictures are spread over the beginning of the recording, ever farther apart. They end as soon as they show the stated board.

use std::ops::ControlFlow;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::squares::{Charuco, TagGrid};
use evcal_geometry::board::{Board, CircleBoard, SquareBoard};
use evcal_squares::picture::Picture;
use evcal_squares::recognition::recognise;
use evcal_squares::recognition::stated::{Comparison, StatedTags};
use evcal_squares::reconstruction::{Moment, Reconstruction, ReconstructionOptions};
use event_recordings::pass::read_while;
use event_recordings::{Recording, RecordingError};

use super::other_board::{OtherReading, other_squares};
use super::recognised::{Recognised, find_squares, in_lengths_of};
use crate::circles::reference_frame::ReferenceFrame;
use crate::detection::DetectionReport;
use crate::detection::DetectionStage;
use crate::detection::pictures::search::MadeOf;
use crate::detection::settings::DetectionSettings;
use crate::detection::square_finder::SquareFinder;
use crate::detection::squares::SquareStage;

/// Time of the events of one picture (µs). The picture is at its middle.
const WINDOW: i64 = 400_000;
/// The windows from which pictures are made, counted from the beginning.
const WINDOWS: [i64; 12] = [0, 1, 2, 3, 4, 6, 9, 13, 20, 30, 45, 68];
/// Number of windows in which a board of squares is counted, spread evenly over a recording.
const EVEN_WINDOWS: i64 = 24;
/// Time of the events of a window in which a board of circles is searched (µs).
const CIRCLES: i64 = 100_000;
/// Fewest pictures for a decision.
const FEWEST: usize = 3;
/// Number of pictures that must show the board if its tags are too small to be read one by one.
const FEWEST_FOUND: usize = 3;
/// Difference between the measured and the stated ratio of a grid of tags from which the stated one is wrong, and from which it may
/// be. In pictures made of events tags seem too large, small ones by several hundredths of their side.
const WRONG_RATIO: f64 = 0.1;
const DOUBTFUL_RATIO: f64 = 0.028;
/// The same for the markers of a ChArUco board, which seem up to a quarter too small in pictures made of events. A wrong size of
/// them changes no corner, so it never ends the calibration.
const DOUBTFUL_MARKER: f64 = 0.2;
/// Usual ratios are multiples of 0.05; a measured one within this distance is taken for one of them.
const USUAL: f64 = 0.02;

/// Time between the frames that are compared, as a share of the time between windows of events: frames may be few.
const FRAMES_BY_WINDOWS: i64 = 4;

/// Result of the comparison.
#[derive(Clone, Debug, PartialEq)]
pub enum StatedBoard {
    /// The pictures show the stated board.
    Kept,
    /// The pictures do not show a board clearly.
    Unclear,
    /// They show it, but the ratio of its two lengths seems to be another one.
    DoubtfulRatio(OtherRatio),
    /// They show it with another ratio of its two lengths.
    WrongRatio(OtherRatio),
    /// They show a board with the rows, columns, family and lengths of the stated one whose tags are numbered, rotated or bordered
    /// in another way, or frames show its markers in another size.
    Variant(SquareBoard),
    /// They show another board.
    Other(OtherReading),
}

/// The measured ratio of the two lengths of a board of tags.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OtherRatio {
    /// The board with the measured ratio.
    pub board: SquareBoard,
    /// Gap divided by the side of a tag, or side of a marker divided by the side of a square.
    pub measured: f64,
    /// The stated ratio.
    pub stated: f64,
}

/// Compares the `stated` board with pictures made of the events of a recording.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn compare(recording: &Recording, sensor: Sensor, stated: &SquareBoard) -> Result<StatedBoard, RecordingError> {
    let mut pictures = ComparedPictures::new(stated, MadeOf::Events);
    visit(recording, sensor, WINDOWS.map(|window| window * WINDOW), |moment| pictures.add(moment.pictures))?;
    Ok(pictures.compare())
}

/// Compares the `stated` board with frames of a recording.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn compare_frames(recording: &Recording, stated: &SquareBoard) -> Result<StatedBoard, RecordingError> {
    let mut pictures = ComparedPictures::new(stated, MadeOf::Light);
    let mut starts = WINDOWS.map(|window| window * WINDOW / FRAMES_BY_WINDOWS).into_iter().peekable();
    let (mut first, mut flow) = (None, ControlFlow::Continue(()));
    recording.visit_frames(|frame| {
        let (Ok(image), true) = (&frame.image, flow.is_continue()) else { return };
        let time = frame.exposure.0.saturating_sub(*first.get_or_insert(frame.exposure.0));
        if starts.next_if(|start| time >= *start).is_some()
            && let Some(picture) = Picture::from_bytes(image.width(), image.height(), &image.pixels)
        {
            flow = pictures.add(vec![picture]);
        }
    })?;
    Ok(pictures.compare())
}

/// The pictures that are compared with a stated board.
struct ComparedPictures<'a> {
    stated: &'a SquareBoard,
    made_of: MadeOf,
    finder: SquareFinder,
    /// The comparison of its tags; `None` if it has no tags.
    tags: Option<StatedTags>,
    moments: Vec<Vec<Picture>>,
    /// Number of moments that show a board without tags.
    found: usize,
    /// A comparison in which more pictures change nothing.
    clear: Option<Comparison>,
}

impl<'a> ComparedPictures<'a> {
    fn new(stated: &'a SquareBoard, made_of: MadeOf) -> Self {
        let (finder, tags) = (SquareFinder::new(stated), StatedTags::new(stated));
        Self { stated, made_of, finder, tags, moments: Vec::new(), found: 0, clear: None }
    }

    /// Adds the pictures of a moment. Returns `Break` if they are enough.
    fn add(&mut self, pictures: Vec<Picture>) -> ControlFlow<()> {
        match &mut self.tags {
            Some(tags) => {
                tags.add(&pictures);
                // Contradictions need all pictures, because they may show only parts of the board.
                let comparison = Some(tags.compare()).filter(|it| matches!(it, Comparison::Same { .. }));
                self.clear = comparison.filter(|_| tags.exclude_variants());
            }
            None => self.found += usize::from(self.finder.find(&pictures, None).is_ok()),
        }
        self.moments.push(pictures);
        let is_decided = self.clear.is_some() || self.found >= 1;
        if self.moments.len() >= FEWEST && is_decided { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }

    fn compare(self) -> StatedBoard {
        let Self { stated, made_of, finder, tags, moments, found, clear } = self;
        let comparison = clear.or_else(|| tags.as_ref().map(StatedTags::compare)).unwrap_or(Comparison::Unclear);
        match comparison {
            Comparison::Same { ratio } => of_ratio(stated, ratio, made_of),
            Comparison::Other(other) => of_other(other, stated, moments.len()),
            Comparison::Unclear if found > 0 => StatedBoard::Kept,
            Comparison::Unclear => {
                let is_found =
                    |pictures: &&Vec<Picture>| finder.find(pictures.get(..1).unwrap_or_default(), None).is_ok();
                if tags.is_some() && moments.iter().filter(is_found).count() >= FEWEST_FOUND {
                    return StatedBoard::Kept;
                }
                let found = recognise(&moments).filter(|found| !differs_in_ratio_only(&found.board, stated));
                let other = found.and_then(|found| other_squares(found, stated));
                other.map_or(StatedBoard::Unclear, StatedBoard::Other)
            }
        }
    }
}

/// Returns `true` if only the ratio of both lengths, which is measured inaccurately, differs.
fn differs_in_ratio_only(found: &SquareBoard, stated: &SquareBoard) -> bool {
    match (in_lengths_of(found, stated), stated) {
        (Some(SquareBoard::Tags(a)), SquareBoard::Tags(b)) => TagGrid { spacing: b.spacing, ..a } == *b,
        (Some(SquareBoard::Charuco(a)), SquareBoard::Charuco(b)) => Charuco { marker: b.marker, ..a } == *b,
        _ => false,
    }
}

fn of_ratio(stated: &SquareBoard, measured: f64, made_of: MadeOf) -> StatedBoard {
    let (given, board, [wrong, doubtful]) = match stated {
        SquareBoard::Tags(grid) => {
            let usual = rounded(measured, 20.0);
            let spacing = if (measured - usual).abs() < USUAL { usual } else { rounded(measured, 100.0) };
            (grid.spacing, SquareBoard::Tags(TagGrid { spacing, ..*grid }), [WRONG_RATIO, DOUBTFUL_RATIO])
        }
        SquareBoard::Charuco(board) => {
            // Half a millimetre is what a ruler shows.
            let marker = rounded(measured * board.square, 2000.0);
            let other = SquareBoard::Charuco(Charuco { marker, ..*board });
            let given = board.marker / board.square;
            if made_of == MadeOf::Light {
                let is_wrong = (measured - given).abs() > DOUBTFUL_RATIO;
                return if is_wrong { StatedBoard::Variant(other) } else { StatedBoard::Kept };
            }
            (given, other, [f64::INFINITY, DOUBTFUL_MARKER])
        }
        SquareBoard::Checkerboard(_) => return StatedBoard::Kept,
    };
    let ratio = OtherRatio { board, measured, stated: given };
    match (measured - given).abs() {
        difference if difference > wrong => StatedBoard::WrongRatio(ratio),
        difference if difference > doubtful && board != *stated => StatedBoard::DoubtfulRatio(ratio),
        _ => StatedBoard::Kept,
    }
}

fn rounded(value: f64, steps: f64) -> f64 {
    (value * steps).round() / steps
}

/// Returns a board with other tags, in the lengths of the stated one.
fn of_other(other: SquareBoard, stated: &SquareBoard, windows: usize) -> StatedBoard {
    let Some(board) = in_lengths_of(&other, stated) else { return StatedBoard::Kept };
    if is_variant(&board, stated) {
        return StatedBoard::Variant(board);
    }
    StatedBoard::Other(OtherReading::Board { fitting: windows, windows, board: Board::Squares(board) })
}

/// Returns `true` if both boards have the same rows, columns, lengths and family of tags.
fn is_variant(board: &SquareBoard, stated: &SquareBoard) -> bool {
    match (board, stated) {
        (SquareBoard::Tags(a), SquareBoard::Tags(b)) => {
            let TagGrid { dictionary, border, first_id, order, turn, .. } = *a;
            dictionary.family == b.dictionary.family
                && *a == TagGrid { dictionary, border, first_id, order, turn, ..*b }
        }
        (SquareBoard::Charuco(a), SquareBoard::Charuco(b)) => *a == Charuco { layout: a.layout, ..*b },
        _ => false,
    }
}

/// Searches a stated board of circles in windows that are spread over the beginning of the recording. Returns the board of squares that
/// the recording shows instead; `None` if the stated board is found, or if no board of squares is recognised.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn squares_instead_of(
    stated: &CircleBoard,
    recording: &Recording,
    sensor: Sensor,
    settings: &DetectionSettings,
) -> Result<Option<OtherReading>, RecordingError> {
    let stage = || DetectionStage::for_board(settings, sensor, stated.pattern, 0);
    let (mut search, mut is_found) = (stage(), false);
    read_windows(recording, WINDOWS.map(|window| window * WINDOW), CIRCLES, |events| {
        match events {
            Some(events) => search.push(events),
            None => is_found |= std::mem::replace(&mut search, stage()).into_frames().1.found > 0,
        }
        if is_found { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    if is_found {
        return Ok(None);
    }
    Ok(find_squares(recording, sensor)?.map(|found| OtherReading::Kind(Recognised::Squares(found))))
}

/// Searches a board of squares in pictures that are spread evenly over the first `duration` µs of a recording.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn search_evenly(
    board: &SquareBoard,
    recording: &Recording,
    sensor: Sensor,
    duration: i64,
) -> Result<(Vec<ReferenceFrame>, DetectionReport), RecordingError> {
    let mut stage = SquareStage::new(board, ReconstructionOptions::new(sensor), 0);
    let step = ((duration - WINDOW) / (EVEN_WINDOWS - 1)).max(WINDOW);
    visit(recording, sensor, (0..EVEN_WINDOWS).map(|number| number * step), |moment| {
        stage.search_moment(&moment);
        ControlFlow::Continue(())
    })?;
    let (frames, report) = stage.finish();
    Ok((frames.into_iter().map(ReferenceFrame::from).collect(), report))
}

/// Makes a picture of each of the windows with these starts (µs), and passes it to `each` until it returns `Break`.
fn visit(
    recording: &Recording,
    sensor: Sensor,
    starts: impl IntoIterator<Item = i64>,
    mut each: impl FnMut(Moment) -> ControlFlow<()>,
) -> Result<(), RecordingError> {
    let options = ReconstructionOptions { interval: (WINDOW / 2) as u32, ..ReconstructionOptions::new(sensor) };
    let mut reconstruction = Reconstruction::new(options);
    let mut first: Option<Moment> = None;
    read_windows(recording, starts, WINDOW, |events| {
        let Some(events) = events else {
            reconstruction.finish(|block| first = first.take().or(block.into_iter().next()));
            return first.take().map_or(ControlFlow::Continue(()), &mut each);
        };
        reconstruction.push(events, |block| first = first.take().or(block.into_iter().next()));
        ControlFlow::Continue(())
    })
}

/// Passes the events of the windows with these starts and this `length` (µs) to `each`, and `None` at the end of a window, until it
/// returns `Break`.
fn read_windows(
    recording: &Recording,
    starts: impl IntoIterator<Item = i64>,
    length: i64,
    mut each: impl FnMut(Option<&[Event]>) -> ControlFlow<()>,
) -> Result<(), RecordingError> {
    let mut windows = starts.into_iter().peekable();
    let (mut flow, mut is_open) = (ControlFlow::Continue(()), false);
    read_while(recording, &mut |batch| {
        let mut events = batch.events;
        while let Some(start) = windows.peek() {
            let place = |events: &[Event], t: i64| events.iter().position(|event| event.t >= t).unwrap_or(events.len());
            let (_, later) = events.split_at(place(events, *start));
            let (inside, after) = later.split_at(place(later, start + length));
            flow = if inside.is_empty() { ControlFlow::Continue(()) } else { each(Some(inside)) };
            is_open |= !inside.is_empty();
            if after.is_empty() || flow.is_break() {
                return flow;
            }
            flow = if is_open { each(None) } else { ControlFlow::Continue(()) };
            is_open = false;
            if flow.is_break() {
                return flow;
            }
            events = after;
            windows.next();
        }
        ControlFlow::Break(())
    })?;
    if flow.is_continue() && is_open {
        let _ = each(None);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board(text: &str) -> SquareBoard {
        text.parse().unwrap()
    }

    #[test]
    fn a_wrong_ratio_is_distinguished_from_an_inaccurate_one() {
        let of = |stated: &str, measured: f64| match of_ratio(&board(stated), measured, MadeOf::Events) {
            StatedBoard::Kept => "kept".to_owned(),
            StatedBoard::DoubtfulRatio(ratio) => format!("doubtful: {}", ratio.board),
            StatedBoard::WrongRatio(ratio) => format!("wrong: {}", ratio.board),
            other => panic!("{other:?}"),
        };
        assert_eq!(of("aprilgrid:6x6:35.2mm:0.3", 0.304), "kept");
        assert_eq!(of("aprilgrid:6x6:35.2mm:0.29", 0.281), "kept");
        assert_eq!(of("aprilgrid:6x6:35.2mm:0.27", 0.299), "doubtful: aprilgrid:6x6:35.2mm:0.3");
        assert_eq!(of("aprilgrid:6x6:35.2mm:0.33", 0.299), "doubtful: aprilgrid:6x6:35.2mm:0.3");
        assert_eq!(of("aprilgrid:6x6:35.2mm:0.01056", 0.303), "wrong: aprilgrid:6x6:35.2mm:0.3");
        assert_eq!(of("apriltags:3x4:48mm:0.4", 0.251), "wrong: apriltags:3x4:48mm:0.25");
        assert_eq!(of("charuco:5x7:40mm:28mm:DICT_5X5_100", 0.751), "kept");
        assert_eq!(of("charuco:5x7:40mm:20mm:DICT_5X5_100", 0.751), "doubtful: charuco:5x7:40mm:30mm:DICT_5X5_100");
        // Frames show markers in their size, and are searched for them.
        let stated = board("charuco:5x7:40mm:28mm:DICT_5X5_100");
        let in_frames = |measured| of_ratio(&stated, measured, MadeOf::Light);
        assert_eq!(in_frames(0.71), StatedBoard::Kept);
        assert_eq!(in_frames(0.751), StatedBoard::Variant(board("charuco:5x7:40mm:30mm:DICT_5X5_100")));
    }

    #[test]
    fn only_boards_of_the_same_size_and_family_are_variants() {
        let stated = board("aprilgrid:6x6:35.2mm:0.3");
        for (text, is) in [
            ("aprilgrid:6x6:35.2mm:0.3:turned180", true),
            ("aprilgrid:6x6:35.2mm:0.3:first48:border1:down", true),
            ("aprilgrid:6x7:35.2mm:0.3", false),
            ("aprilgrid:6x6:35.2mm:0.25", false),
            ("apriltags:6x6:35.2mm:0.3", false),
            ("aprilgrid:6x6:35.2mm:0.3:36h10", false),
        ] {
            assert_eq!(is_variant(&board(text), &stated), is, "{text}");
        }
        let stated = board("charuco:6x5:40mm:30mm:DICT_4X4_100");
        assert!(is_variant(&board("charuco:6x5:40mm:30mm:DICT_4X4_100:legacy"), &stated));
        assert!(!is_variant(&board("charuco:5x6:40mm:30mm:DICT_4X4_100"), &stated));
    }
}

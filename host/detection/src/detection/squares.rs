//! Search for boards of squares in pictures made of events.
//!
//! The edges of a square board have too few events in a short window. So the events become pictures of log intensity
//! (`evcal_squares::reconstruction`), one every 20 ms with several time constants, and all pictures of a moment are searched for
//! the board.

use evcal_core::event::Event;
use evcal_geometry::board::SquareBoard;
use evcal_squares::found_point::FoundPoint;
use evcal_squares::reconstruction::{Moment, Reconstruction, ReconstructionOptions};
use event_recordings::pictures::GreyImage;
use nalgebra::Vector2;
use rayon::prelude::*;

use super::kept_pixels::KeptPixels;
use super::no_board::NoBoard;
use super::report::DetectionReport;
use super::square_finder::{FoundBoard, SquareFinder};
use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn};

/// Fewest moments that are searched together. Usually they are more, because pictures are computed in blocks.
const TOGETHER: usize = 8;
/// Longest time over which the last positions of the board predict its position (s).
const LONGEST_PREDICTION: f64 = 0.05;
/// Number of moments that one thread searches in turn.
const IN_TURN: usize = 6;
/// Time without the board (s) after which only one moment in [`PROBES`] is searched, until it shows the board again. A board that
/// is in view for a shorter time is of no use.
const LONGEST_ABSENCE: f64 = 1.0;
/// Number of moments for each one that is searched while the board is not in view.
const PROBES: usize = 8;

/// A board and its time (s).
#[derive(Clone)]
struct Seen {
    t: f64,
    board: FoundBoard,
}

/// Searches the events of a recording, batch by batch, for a board of squares.
pub struct SquareStage {
    /// The pictures; `None` only while they are made.
    reconstruction: Option<Reconstruction>,
    finder: SquareFinder,
    recording: usize,
    /// Half of the interval of the pictures (s).
    half_interval: f64,
    waiting: Vec<Moment>,
    frames: Vec<CompactFrame>,
    /// Last detection.
    last: Option<Seen>,
    /// The detection before it.
    before: Option<Seen>,
    report: DetectionReport,
    kept_pixels: KeptPixels,
}

impl SquareStage {
    /// Creates a search for `board` in the pictures of recording number `recording`.
    pub fn new(board: &SquareBoard, options: ReconstructionOptions, recording: usize) -> Self {
        Self {
            half_interval: 0.5e-6 * f64::from(options.interval),
            reconstruction: Some(Reconstruction::new(options)),
            finder: SquareFinder::new(board),
            recording,
            waiting: Vec::new(),
            frames: Vec::new(),
            last: None,
            before: None,
            report: DetectionReport::default(),
            kept_pixels: KeptPixels::default(),
        }
    }

    /// Adds the next events in time order; their times are microseconds since the start of the recording.
    pub fn push(&mut self, events: &[Event]) {
        self.report.count_events(events);
        if let Some(mut reconstruction) = self.reconstruction.take() {
            reconstruction.push(events, |block| self.search_block(block));
            self.reconstruction = Some(reconstruction);
        }
    }

    fn search_block(&mut self, block: Vec<Moment>) {
        self.waiting.extend(block);
        if self.waiting.len() >= TOGETHER {
            self.search();
        }
    }

    /// Searches pictures that were made elsewhere, in time order.
    pub fn search_moment(&mut self, moment: &Moment) {
        self.search_all(std::slice::from_ref(moment));
    }

    /// Returns `true` if pictures wait for the search.
    pub fn has_waiting_pictures(&self) -> bool {
        !self.waiting.is_empty()
    }

    /// Searches the waiting pictures, and returns the frames found since the last call in order of time.
    pub fn take_frames(&mut self) -> Vec<ReferenceFrame> {
        self.search();
        std::mem::take(&mut self.frames).into_iter().map(ReferenceFrame::from).collect()
    }

    /// Returns the frames with the board in order of time, and the report.
    pub fn finish(mut self) -> (Vec<CompactFrame>, DetectionReport) {
        if let Some(mut reconstruction) = self.reconstruction.take() {
            reconstruction.finish(|block| self.search_block(block));
        }
        self.search();
        self.drop_another_board();
        (self.frames, self.report)
    }

    /// Drops all detections if more pictures show another board: a part of it may match by chance.
    fn drop_another_board(&mut self) {
        let refused = |reason: &NoBoard| self.report.grids_refused.get(reason).copied().unwrap_or(0);
        if refused(&NoBoard::OtherCheckerboardSize) + refused(&NoBoard::OtherTags) > self.report.found {
            self.frames.clear();
            (self.report.found, self.report.board_circles) = (0, 0);
        }
    }

    fn search(&mut self) {
        let moments = std::mem::take(&mut self.waiting);
        if moments.is_empty() {
            return;
        }
        let begin = moments.first().map_or(0.0, seconds);
        if self.last.as_ref().is_none_or(|seen| begin - seen.t > LONGEST_ABSENCE) {
            let probes: Vec<&Moment> = moments.iter().step_by(PROBES).collect();
            let probed = probes.par_iter().map(|moment| self.finder.find(&moment.pictures, None).err());
            let refused: Vec<Option<NoBoard>> = probed.collect();
            if refused.iter().all(Option::is_some) {
                self.report.windows += refused.len() as u64;
                refused.into_iter().flatten().for_each(|reason| self.refuse(reason));
                return;
            }
        }
        self.search_all(&moments);
    }

    fn search_all(&mut self, moments: &[Moment]) {
        let found: Vec<Result<FoundBoard, NoBoard>> =
            moments.par_chunks(IN_TURN).flat_map_iter(|moments| self.search_in_turn(moments)).collect();
        for (moment, found) in moments.iter().zip(found) {
            self.report.windows += 1;
            let t = seconds(moment);
            match found {
                Ok(board) => {
                    self.report.found += 1;
                    self.report.board_circles += board.points.len() as u64;
                    self.frames.push(self.frame(t, &board, moment).into());
                    self.before = self.last.replace(Seen { t, board });
                }
                Err(reason) => self.refuse(reason),
            }
        }
        self.kept_pixels.limit(&mut self.frames);
    }

    fn refuse(&mut self, reason: NoBoard) {
        *self.report.grids_refused.entry(reason).or_default() += 1;
    }

    /// Searches each of `moments`, near the board's expected position.
    fn search_in_turn(&self, moments: &[Moment]) -> Vec<Result<FoundBoard, NoBoard>> {
        let (mut last, mut before) = (self.last.clone(), self.before.clone());
        let mut search = |moment: &Moment| {
            let t = seconds(moment);
            let near = last.as_ref().and_then(|last| expected(last, before.as_ref(), t));
            let found = self.finder.find(&moment.pictures, near.as_ref());
            if let Ok(board) = &found {
                before = last.replace(Seen { t, board: board.clone() });
            }
            found
        };
        moments.iter().map(&mut search).collect()
    }

    fn frame(&self, t: f64, board: &FoundBoard, moment: &Moment) -> ReferenceFrame {
        let circle = |point: &FoundPoint| ObservedCircle {
            index: point.index,
            t,
            center: Vector2::from(point.pixel).cast(),
            radius: None,
            velocity: None,
        };
        ReferenceFrame {
            recording: self.recording,
            start: t - self.half_interval,
            end: t + self.half_interval,
            circles: board.points.iter().map(circle).collect(),
            seen_in: grey(moment).map_or(SeenIn::PassedEvents, SeenIn::Reconstruction),
        }
    }
}

/// Returns the board at the time `t`, if it continues its motion since the detection `before`; `None` if the last one is too long ago.
fn expected(last: &Seen, before: Option<&Seen>, t: f64) -> Option<FoundBoard> {
    if t - last.t >= LONGEST_PREDICTION {
        return None;
    }
    let before = before.filter(|before| (0.0..LONGEST_PREDICTION).contains(&(last.t - before.t)) && before.t < last.t);
    let moved = before.map(|before| last.board.continued(&before.board, ((t - last.t) / (last.t - before.t)) as f32));
    Some(moved.unwrap_or_else(|| last.board.clone()))
}

/// Returns the picture for display: the one of the middle time constant, without its darkest and brightest pixels.
fn grey(moment: &Moment) -> Option<GreyImage> {
    let picture = moment.pictures.get(moment.pictures.len() / 2)?;
    let mut sorted = picture.values().to_vec();
    let mut at = |share: f64| {
        let place = (share * (sorted.len().checked_sub(1)? as f64)) as usize;
        Some(*sorted.select_nth_unstable_by(place, f32::total_cmp).1)
    };
    let (dark, bright) = (at(0.01)?, at(0.99)?);
    let range = (bright - dark).max(f32::MIN_POSITIVE);
    let pixels = picture.values().iter().map(|value| (255.0 * (value - dark) / range).clamp(0.0, 255.0) as u8);
    GreyImage::new(picture.width(), picture.height(), pixels.collect())
}

fn seconds(moment: &Moment) -> f64 {
    moment.t as f64 * 1e-6
}

#[cfg(test)]
mod tests {
    use evcal_core::sensor::Sensor;
    use evcal_squares::picture::Picture;

    use super::*;

    fn found_after(reason: NoBoard, refused: u64) -> (usize, u64) {
        let board = "checkerboard:3x4:30mm".parse().unwrap();
        let mut stage = SquareStage::new(&board, ReconstructionOptions::new(Sensor::new(40, 30)), 0);
        let frame = |t: f64| ReferenceFrame {
            recording: 0,
            start: t,
            end: t,
            circles: Vec::new(),
            seen_in: SeenIn::PassedEvents,
        };
        stage.frames = [0.0, 0.02].map(|t| frame(t).into()).to_vec();
        stage.report.found = 2;
        stage.report.grids_refused.insert(reason, refused);
        let (frames, report) = stage.finish();
        (frames.len(), report.found)
    }

    #[test]
    fn a_board_that_more_pictures_contradict_is_dropped() {
        for reason in [NoBoard::OtherCheckerboardSize, NoBoard::OtherTags] {
            assert_eq!(found_after(reason, 3), (0, 0));
            assert_eq!(found_after(reason, 2), (2, 2));
        }
        // A picture in which nothing is found does not contradict.
        assert_eq!(found_after(NoBoard::TooFewCorners, 9), (2, 2));
    }

    /// Noise is searched at one moment in several; a board that is in view is not.
    #[test]
    fn few_moments_are_searched_until_the_board_is_in_view() {
        let board = "checkerboard:3x4:30mm".parse().unwrap();
        let mut stage = SquareStage::new(&board, ReconstructionOptions::new(Sensor::new(64, 48)), 0);
        let picture = |shows_board: bool| {
            let value = |index: usize| {
                let (column, row) = ((index % 64 + 2) / 10, (index / 64 + 6) / 10);
                let is_inside = (1..6).contains(&column) && (1..5).contains(&row);
                if shows_board && is_inside && (column + row) % 2 == 0 { 0.0 } else { 1.0 }
            };
            Picture::new(64, 48, (0..64 * 48).map(value).collect()).unwrap()
        };
        let mut waiting = |moments: std::ops::Range<i64>, shows_board: bool| {
            let moment = |number| Moment { t: 20_000 * number, pictures: vec![picture(shows_board)] };
            stage.waiting = moments.map(moment).collect();
            stage.search();
            (stage.report.windows, stage.report.found)
        };
        assert_eq!(waiting(0..40, false), (5, 0));
        assert_eq!(waiting(40..56, true), (21, 16));
        // Not in view for a short time, then for longer.
        assert_eq!(waiting(56..96, false), (61, 16));
        assert_eq!(waiting(120..136, false), (63, 16));
    }
}

//! Comparison with other boards if the stated board was not found.
//!
//! The circles of the first seconds are compared with boards that users confuse with the stated one: rows and columns exchanged,
//! the other layout. One that fits many windows is reported, otherwise any layout that does ([`super::layout`]). A mirrored print
//! is not one of them: its circles have the same positions as those of a correct print, and lead to the same camera.

use std::fmt;

use evcal_core::event::Event;
use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;

use super::layout::{FEWEST_CIRCLES, RecognisedLayout, beginning, recognise};
use super::settings::DetectionSettings;
use crate::circles::reference_frame::UnorderedFrame;
use crate::detection::{CircleWindow, DetectionStage, order_frames};
use evcal_geometry::board::CircleBoard;

/// Smallest share of the windows with at least half as many circles as the board that another board must fit.
const FEWEST_FITS: f64 = 0.2;

/// A board that fits better than the stated one.
#[derive(Clone, Debug, PartialEq)]
pub struct OtherReading {
    /// Number of windows that it fits.
    pub fitting: usize,
    /// Number of windows with enough circles.
    pub windows: usize,
    /// The board.
    pub board: CircleBoard,
}

impl fmt::Display for OtherReading {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { fitting, windows, board } = self;
        write!(f, "{fitting} of {windows} windows fit the board {board} instead")
    }
}

/// Collects the circles of the first seconds of a recording.
pub struct OtherBoard<'a> {
    stage: DetectionStage<'a>,
    board: CircleBoard,
    sensor: Sensor,
}

impl<'a> OtherBoard<'a> {
    /// Creates the collector for a recording in which `board` was not found.
    pub fn new(settings: &'a DetectionSettings, board: &CircleBoard, sensor: Sensor) -> Self {
        let fewest = FEWEST_CIRCLES.min(half(board));
        Self { stage: DetectionStage::for_circles(settings, sensor, fewest), board: *board, sensor }
    }

    /// Adds the next events; times are relative to the start of the recording.
    pub fn push(&mut self, events: &[Event]) {
        self.stage.push(beginning(events));
    }

    /// Returns the board that the circles fit instead; `None` if none fits.
    pub fn finish(self) -> Option<OtherReading> {
        let (windows, _) = self.stage.into_circles();
        let frames: Vec<UnorderedFrame> = windows.iter().map(CircleWindow::to_frame).collect();
        other_reading(&frames, &self.board, self.sensor)
    }
}

/// Returns the board that the circles of all frames fit instead of `board`: one that users confuse with it, or any recognised
/// layout; `None` if there is none.
pub fn other_reading(all: &[UnorderedFrame], board: &CircleBoard, sensor: Sensor) -> Option<OtherReading> {
    let frames: Vec<UnorderedFrame> = all.iter().filter(|frame| frame.circles.len() >= half(board)).cloned().collect();
    let pattern = board.pattern;
    let exchanged = Pattern { rows: pattern.columns, columns: pattern.rows, ..pattern };
    let layout = match pattern.layout {
        Layout::Asymmetric => Layout::Symmetric,
        Layout::Symmetric => Layout::Asymmetric,
    };
    let readings = [exchanged, Pattern { layout, ..pattern }, Pattern { layout, ..exchanged }].map(|pattern| {
        let (found, _) = order_frames(&frames, &pattern, Some(sensor));
        (found.len(), pattern)
    });
    let (fitting, pattern) = readings.into_iter().max_by_key(|(count, _)| *count)?;
    if fitting > 0 && fitting as f64 >= FEWEST_FITS * frames.len() as f64 {
        return Some(OtherReading { fitting, windows: frames.len(), board: CircleBoard { pattern, ..*board } });
    }
    let RecognisedLayout { pattern, fitting, windows, .. } = recognise(all, sensor)?;
    Some(OtherReading { fitting, windows, board: CircleBoard { pattern, ..*board } })
}

/// Returns half of a board's circles, rounded up.
fn half(board: &CircleBoard) -> usize {
    board.circle_count().div_ceil(2)
}

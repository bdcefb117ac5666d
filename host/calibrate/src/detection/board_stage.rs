//! Search for a board of any kind in the events of a recording.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::Board;

use super::settings::DetectionSettings;
use super::squares::{INTERVAL, SquareStage};
use super::unplaced::UnplacedWindows;
use super::{DetectionReport, DetectionStage};
use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::ReferenceFrame;

/// Interval of the pictures that are searched for squares while a camera sends events (s), longer than the time of a search.
const LIVE_INTERVAL: f64 = 0.04;
/// Number of pictures per chunk of a tenth of a second.
const PICTURES_IN_CHUNK: usize = 2;

/// Searches the events of a recording, batch by batch, for a board of any kind.
pub enum BoardStage<'a> {
    /// Search for circles.
    Circles(Box<DetectionStage<'a>>),
    /// Search for squares.
    Squares(Box<SquareStage>),
}

impl<'a> BoardStage<'a> {
    /// Creates a search for `board` in recording number `recording`.
    pub fn new(board: &Board, settings: &'a DetectionSettings, sensor: Sensor, recording: usize) -> Self {
        Self::with_interval(board, settings, sensor, recording, INTERVAL)
    }

    /// Creates a search in the events of a live camera.
    pub fn live(board: &Board, settings: &'a DetectionSettings, sensor: Sensor) -> Self {
        Self::with_interval(board, settings, sensor, 0, LIVE_INTERVAL)
    }

    fn with_interval(
        board: &Board,
        settings: &'a DetectionSettings,
        sensor: Sensor,
        recording: usize,
        interval: f64,
    ) -> Self {
        match board {
            Board::Circles(board) => {
                Self::Circles(Box::new(DetectionStage::for_board(settings, sensor, board.pattern, recording)))
            }
            Board::Squares(board) => Self::Squares(Box::new(SquareStage::new(board, sensor, recording, interval))),
        }
    }

    /// Adds the next events in order of time (µs from the start of the recording).
    pub fn push(&mut self, events: &[Event]) {
        match self {
            Self::Circles(stage) => stage.push(events),
            Self::Squares(stage) => stage.push(events),
        }
    }

    /// Returns the number of chunks that wait for the search; a chunk is a tenth of a second, unless the settings change it.
    pub fn waiting_chunks(&self) -> usize {
        match self {
            Self::Circles(stage) => stage.waiting_chunks(),
            Self::Squares(stage) => stage.waiting_pictures() / PICTURES_IN_CHUNK,
        }
    }

    /// Searches the waiting events, and returns the frames found since the last call in order of time.
    pub fn take_frames(&mut self) -> Vec<ReferenceFrame> {
        match self {
            Self::Circles(stage) => stage.take_frames(),
            Self::Squares(stage) => stage.take_frames(),
        }
    }

    /// Returns the frames with the board in order of time, the windows with more circles than the board, and the report.
    pub fn into_compact_frames(self, recording: usize) -> (Vec<CompactFrame>, UnplacedWindows, DetectionReport) {
        match self {
            Self::Circles(stage) => stage.into_compact_frames(),
            Self::Squares(stage) => {
                let (frames, report) = stage.finish();
                (frames, UnplacedWindows::new(recording), report)
            }
        }
    }
}

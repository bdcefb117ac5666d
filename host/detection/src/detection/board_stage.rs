//! Search for a board of any kind in the events of a recording.

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::Board;
use evcal_squares::reconstruction::ReconstructionOptions;

use super::DetectionReport;
use super::DetectionStage;
use super::settings::DetectionSettings;
use super::squares::SquareStage;
use super::unplaced::UnplacedWindows;
use crate::circles::compact_frame::CompactFrame;
use crate::circles::reference_frame::ReferenceFrame;

/// Number of chunks of events that are searched at once for circles while a camera sends events: a fifth of a second with the default
/// settings.
const CHUNKS_TOGETHER: usize = 2;

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
        Self::with_pictures(board, settings, ReconstructionOptions::new(sensor), recording)
    }

    /// Creates a search in the events of a live camera.
    pub fn live(board: &Board, settings: &'a DetectionSettings, sensor: Sensor) -> Self {
        Self::with_pictures(board, settings, ReconstructionOptions::live(sensor), 0)
    }

    fn with_pictures(
        board: &Board,
        settings: &'a DetectionSettings,
        pictures: ReconstructionOptions,
        recording: usize,
    ) -> Self {
        match board {
            Board::Circles(board) => {
                Self::Circles(Box::new(DetectionStage::for_board(settings, pictures.sensor, board.pattern, recording)))
            }
            Board::Squares(board) => Self::Squares(Box::new(SquareStage::new(board, pictures, recording))),
        }
    }

    /// Adds the next events in order of time (µs from the start of the recording).
    pub fn push(&mut self, events: &[Event]) {
        match self {
            Self::Circles(stage) => stage.push(events),
            Self::Squares(stage) => stage.push(events),
        }
    }

    /// Returns `true` if enough waits for a search while a camera sends events.
    pub fn is_due(&self) -> bool {
        match self {
            Self::Circles(stage) => stage.waiting_chunks() >= CHUNKS_TOGETHER,
            Self::Squares(stage) => stage.has_waiting_pictures(),
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

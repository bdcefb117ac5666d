//! Search for the board, or for circles of any kind, in one recording or circle stream.

use std::io;
use std::ops::ControlFlow;
use std::path::Path;

use evcal_core::event::Event;
use evcal_core::pattern::Pattern;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

use super::CircleWindow;
use super::DetectionReport;
use super::DetectionStage;
use super::LARGEST_SENSOR;
use super::order_frames;
use super::settings::DetectionSettings;
use super::squares::SquareStage;
use crate::circles::event_pixel::EventPixel;
use crate::circles::reference_frame::{ReferenceFrame, SeenIn, UnorderedFrame};
use crate::circles::stream::CircleStream;
use crate::circles::track::{self, CircleFrames, TrackSource};
use evcal_files::FileError;
use evcal_files::remedies;
use evcal_geometry::board::{Board, SquareBoard};
use evcal_squares::reconstruction::ReconstructionOptions;
use event_recordings::given_sensor::{OtherSensor, check_outside, check_stated};
use event_recordings::likely_sensor::{add_sensor, likely_sensor_of, likely_words};
use event_recordings::pass::read_while;
use event_recordings::pictures::GreyImage;
use event_recordings::{ReadReport, Recording, RecordingError};

/// Target of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SearchFor {
    /// A board of circles.
    Board(Pattern),
    /// A board of squares.
    Squares(SquareBoard),
    /// Circles of any kind, in windows with at least this many.
    Circles(usize),
}

impl From<&Board> for SearchFor {
    fn from(board: &Board) -> Self {
        match board {
            Board::Circles(board) => Self::Board(board.pattern),
            Board::Squares(board) => Self::Squares(*board),
        }
    }
}

/// Result of the search.
#[derive(Clone, Debug)]
pub struct FoundCircles {
    /// The frames or windows.
    pub content: FoundContent,
    /// Statistics of the detection.
    pub report: DetectionReport,
    /// Assumptions made when the recording was read.
    pub notes: Vec<String>,
    /// Start of the times of `content` (µs).
    pub source: TrackSource,
}

/// Frames or windows with the board or circles.
#[derive(Clone, Debug)]
pub enum FoundContent {
    /// The board.
    Boards(Pattern, Vec<ReferenceFrame>),
    /// Circles in events.
    Windows(Vec<CircleWindow>),
    /// Circles in a circle stream.
    Frames(Vec<UnorderedFrame>),
}

/// Content of a window.
#[derive(Clone, Copy, Debug)]
pub enum WindowContent<'a> {
    /// Its events, one entry per pixel and polarity.
    Events(&'a [EventPixel]),
    /// A picture made of events.
    Picture(&'a GreyImage),
}

/// Content of one window, and its circles or corners.
pub struct BestWindow<'a> {
    /// Content of the window.
    pub content: WindowContent<'a>,
    /// Centre and radius in pixels.
    pub circles: Vec<(Vector2<f64>, f64)>,
}

/// Reasons why a recording cannot be searched.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SearchError {
    /// It cannot be read.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// The sensor size is not known.
    #[error("{file} does not say how many pixels the sensor has{}", likely_words(*.likely))]
    SensorUnknown {
        /// The file name.
        file: String,
        /// The smallest usual sensor that includes all pixels of the events.
        likely: Option<Sensor>,
    },
    /// The requested sensor differs from the sensor of the recording.
    #[error("{0}")]
    OtherSensor(#[from] OtherSensor),
    /// The sensor is too large.
    #[error("{file} is of a sensor of {sensor} pixels; up to {} are supported", LARGEST_SENSOR)]
    SensorTooLarge {
        /// The file name.
        file: String,
        /// Its sensor.
        sensor: Sensor,
    },
}

remedies! { SearchError, say;
    Self::Recording(error) => error.remedy(say);
    Self::OtherSensor(error) => error.remedy(say);
    Self::SensorUnknown { likely, .. } => Some(add_sensor(*likely, say));
}

/// Returns the sensor of a recording, if the detector supports it.
///
/// # Errors
/// [`SearchError`] if the sensor is too large, or the recording does not contain its size.
pub fn sensor_of(recording: &Recording) -> Result<Sensor, SearchError> {
    check_stated(recording)?;
    let file = || recording.path().display().to_string();
    let unknown = || SearchError::SensorUnknown { file: file(), likely: likely_sensor_of(recording) };
    let sensor = recording.open()?.information().sensor.ok_or_else(unknown)?;
    if sensor.width > LARGEST_SENSOR.width || sensor.height > LARGEST_SENSOR.height {
        return Err(SearchError::SensorTooLarge { file: file(), sensor });
    }
    Ok(sensor)
}

/// Searches the events of `recording`, which have this `sensor`.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read.
pub fn search_events(
    recording: &Recording,
    sensor: Sensor,
    wanted: SearchFor,
    settings: &DetectionSettings,
) -> Result<FoundCircles, RecordingError> {
    Ok(search(recording, sensor, wanted, settings, |_| {})?.0)
}

/// Does the same as [`search_events`] for a recording whose sensor may have been requested; `progress` gets the share of the
/// recording that was searched, 0 to 1, if it is known.
///
/// # Errors
/// [`SearchError`] if the recording cannot be read, or many events are outside the requested sensor.
pub fn search_events_with_progress(
    recording: &Recording,
    sensor: Sensor,
    wanted: SearchFor,
    settings: &DetectionSettings,
    mut progress: impl FnMut(Option<f64>),
) -> Result<FoundCircles, SearchError> {
    let (found, report) = search(recording, sensor, wanted, settings, &mut progress)?;
    check_outside(recording, &report)?;
    Ok(found)
}

/// Searches; returns the result and the report of the reader.
fn search(
    recording: &Recording,
    sensor: Sensor,
    wanted: SearchFor,
    settings: &DetectionSettings,
    mut progress: impl FnMut(Option<f64>),
) -> Result<(FoundCircles, ReadReport), RecordingError> {
    let mut read = |push: &mut dyn FnMut(&[Event])| {
        read_while(recording, &mut |batch| {
            push(batch.events);
            progress(batch.done);
            ControlFlow::Continue(())
        })
    };
    let (content, report, pass) = match wanted {
        SearchFor::Board(pattern) => {
            let mut stage = DetectionStage::for_board(settings, sensor, pattern, 0);
            let pass = read(&mut |events| stage.push(events))?;
            let (frames, report) = stage.into_frames();
            (FoundContent::Boards(pattern, frames), report, pass)
        }
        SearchFor::Squares(board) => {
            let mut stage = SquareStage::new(&board, ReconstructionOptions::new(sensor), 0);
            let pass = read(&mut |events| stage.push(events))?;
            let (frames, report) = stage.finish();
            let frames = frames.into_iter().map(ReferenceFrame::from).collect();
            (FoundContent::Boards(board.lattice(), frames), report, pass)
        }
        SearchFor::Circles(fewest) => {
            let mut stage = DetectionStage::for_circles(settings, sensor, fewest);
            let pass = read(&mut |events| stage.push(events))?;
            let (windows, report) = stage.into_circles();
            (FoundContent::Windows(windows), report, pass)
        }
    };
    let source = TrackSource { sensor: Some(sensor), time_origin_us: pass.first };
    Ok((FoundCircles { content, report, source, notes: pass.to_report().notes }, pass.report))
}

/// Searches the circles that a device found, which never belong to a board of squares. `sensor` is the given size, if any.
pub fn search_stream(stream: CircleStream, sensor: Option<Sensor>, wanted: SearchFor) -> FoundCircles {
    let track = stream.track;
    let source = TrackSource { sensor: sensor.or(track.source.sensor), ..track.source };
    let frames = match track.frames {
        CircleFrames::Unordered(frames) => frames,
        // A device does not know the board.
        CircleFrames::Ordered(_) => Vec::new(),
    };
    let (content, report) = match wanted {
        SearchFor::Board(pattern) => {
            let (ordered, report) = order_frames(&frames, &pattern, source.sensor);
            (FoundContent::Boards(pattern, ordered), report)
        }
        SearchFor::Squares(board) => (FoundContent::Boards(board.lattice(), Vec::new()), DetectionReport::default()),
        SearchFor::Circles(fewest) => {
            let windows = frames.len() as u64;
            let enough: Vec<UnorderedFrame> =
                frames.into_iter().filter(|frame| frame.circles.len() >= fewest).collect();
            let found = enough.len() as u64;
            let report =
                DetectionReport { windows, found, circles: track.circles as u64, ..DetectionReport::default() };
            (FoundContent::Frames(enough), report)
        }
    };
    FoundCircles { content, report, source, notes: track.notes }
}

impl FoundCircles {
    /// Writes the circles as a circle track.
    ///
    /// # Errors
    /// [`FileError`] if the file cannot be written.
    pub fn write_track(&self, path: &Path) -> Result<(), FileError> {
        evcal_files::write_with(path, |file| -> io::Result<()> {
            match &self.content {
                FoundContent::Boards(pattern, frames) => track::write(file, frames, pattern, self.source),
                FoundContent::Windows(windows) => {
                    let frames: Vec<UnorderedFrame> = windows.iter().map(CircleWindow::to_frame).collect();
                    track::write_unordered(file, &frames, self.source)
                }
                FoundContent::Frames(frames) => track::write_unordered(file, frames, self.source),
            }
        })
    }

    /// Returns the window with most circles; `None` if nothing was found, or for a circle stream, which contains no events.
    pub fn best_window(&self) -> Option<BestWindow<'_>> {
        match &self.content {
            FoundContent::Boards(_, frames) => {
                let frame = frames.iter().rev().max_by_key(|frame| frame.circles.len())?;
                let circles =
                    frame.circles.iter().map(|circle| (circle.center, circle.radius.unwrap_or(1.0))).collect();
                let content = match &frame.seen_in {
                    SeenIn::Reconstruction(picture) => WindowContent::Picture(picture),
                    _ => WindowContent::Events(frame.events().unwrap_or_default()),
                };
                Some(BestWindow { content, circles })
            }
            FoundContent::Windows(windows) => {
                let window = windows.iter().rev().max_by_key(|window| window.circles.len())?;
                Some(BestWindow { content: WindowContent::Events(&window.pixels), circles: window.circles.clone() })
            }
            FoundContent::Frames(_) => None,
        }
    }
}

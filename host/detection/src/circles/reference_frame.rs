//! Reference frames: time windows in which the board was found.

use event_recordings::pictures::GreyImage;
use nalgebra::Vector2;

use crate::circles::event_pixel::EventPixel;

/// One circle of the board as seen in a reference frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedCircle {
    /// Index on the board, row by row (see [`evcal_core::pattern::Pattern::lattice_position`]).
    pub index: usize,
    /// Time of the centre, in seconds since the start of the recording.
    pub t: f64,
    /// Centre in pixels.
    pub center: Vector2<f64>,
    /// Radius in pixels; `None` if a circle file does not contain it.
    pub radius: Option<f64>,
    /// Velocity of the centre in pixels per second, if a circle file contains it.
    pub velocity: Option<Vector2<f64>>,
}

/// A time window or picture in which the board was found: the paper's reference frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ReferenceFrame {
    /// Index of the recording.
    pub recording: usize,
    /// Start of the window in seconds since the start of the recording.
    pub start: f64,
    /// End of the window.
    pub end: f64,
    /// The circles found, ordered by board index, each index at most once.
    pub circles: Vec<ObservedCircle>,
    /// Kind of data in which the board was found.
    pub seen_in: SeenIn,
}

/// Kind of data in which a board was found.
#[derive(Clone, Debug, PartialEq)]
pub enum SeenIn {
    /// The events of a window, one entry per pixel and polarity.
    Events(Vec<EventPixel>),
    /// The events of a window, which were not kept because there are too many.
    PassedEvents,
    /// The circles of a circle track or a circle stream.
    Circles,
    /// One of the camera's own pictures.
    Picture,
    /// A picture made of the events around the frame's time.
    Reconstruction(GreyImage),
}

impl ReferenceFrame {
    /// Returns the events of the window, one entry per pixel and polarity; `None` if the board was not found in events, or they
    /// were not kept.
    pub fn events(&self) -> Option<&[EventPixel]> {
        match &self.seen_in {
            SeenIn::Events(pixels) => Some(pixels),
            SeenIn::PassedEvents | SeenIn::Circles | SeenIn::Picture | SeenIn::Reconstruction(_) => None,
        }
    }

    /// Returns `true` if it has events, or a picture made of them, that can be shown.
    pub fn is_shown(&self) -> bool {
        matches!(self.seen_in, SeenIn::Events(_) | SeenIn::Reconstruction(_))
    }

    /// Returns `true` if the board was found in events.
    pub fn is_from_events(&self) -> bool {
        matches!(self.seen_in, SeenIn::Events(_) | SeenIn::PassedEvents | SeenIn::Reconstruction(_))
    }

    /// Returns the timestamp of the frame: the centre of its window (paper III-A), in seconds.
    pub fn t(&self) -> f64 {
        0.5 * (self.start + self.end)
    }
}

/// A circle whose index on the board is not known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnorderedCircle {
    /// Time of the centre, in seconds since the origin.
    pub t: f64,
    /// Centre in pixels.
    pub center: Vector2<f64>,
    /// Radius in pixels, if the file contains it.
    pub radius: Option<f64>,
    /// Velocity of the centre in pixels per second, if the file contains it.
    pub velocity: Option<Vector2<f64>>,
}

/// Circles that were observed together.
#[derive(Clone, Debug, PartialEq)]
pub struct UnorderedFrame {
    /// Start of the time window in seconds since the origin.
    pub start: f64,
    /// End of the time window.
    pub end: f64,
    /// The circles, in the order of the file.
    pub circles: Vec<UnorderedCircle>,
}

/// One observed circle centre with its own time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointObservation {
    /// Time in seconds.
    pub t: f64,
    /// Centre in pixels.
    pub pixel: Vector2<f64>,
    /// Index of the circle on the board.
    pub circle: usize,
}

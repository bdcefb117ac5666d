//! What the joint solve is fed: events and circle centres, each tied to a circle of the board.

use crate::circles::reference_frame::PointObservation;

/// One associated event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EventObservation {
    /// Time of the event after the centre of its bin in seconds, less the latency of its class as it
    /// was at the association.
    pub dt: f32,
    /// Column in pixels.
    pub x: u16,
    /// Row in pixels.
    pub y: u16,
    /// Index of the circle on the board.
    pub circle: u16,
    /// Event class (see [`crate::solve::event_bias::class`]).
    pub class: u8,
    /// Range of the edge's normal speed (see [`crate::solve::event_bias::speed_range`]).
    pub speed_range: u8,
}

/// The events of one time bin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EventBin {
    /// Centre of the bin in seconds.
    pub t: f64,
    /// First event of the bin in [`SegmentObservations::events`].
    pub first: usize,
    /// One past the last event of the bin.
    pub end: usize,
}

/// All observations of one trajectory segment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SegmentObservations {
    /// Bins in order of time; only bins with events.
    pub bins: Vec<EventBin>,
    /// Events in order of bin, then class.
    pub events: Vec<EventObservation>,
    /// Circle centres in order of time.
    pub points: Vec<PointObservation>,
    /// Times of the events near the board that are too far from every edge to be observations (s).
    pub far: Vec<f32>,
}

impl SegmentObservations {
    /// The bins and circle centres whose time is `wanted`, without the times in [`far`](Self::far).
    pub fn within(&self, wanted: impl Fn(f64) -> bool) -> Self {
        let mut part = Self::default();
        for bin in self.bins.iter().filter(|bin| wanted(bin.t)) {
            let first = part.events.len();
            part.events.extend_from_slice(self.events.get(bin.first..bin.end).unwrap_or_default());
            part.bins.push(EventBin { t: bin.t, first, end: part.events.len() });
        }
        part.points.extend(self.points.iter().filter(|point| wanted(point.t)));
        part
    }
}

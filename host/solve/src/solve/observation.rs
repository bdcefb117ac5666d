//! Observations of the joint solve: events and circle centres, each assigned to an edge or a point of the board.

use evcal_detection::circles::reference_frame::PointObservation;

/// One associated event.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EventObservation {
    /// Time of the event after the centre of its bin in seconds, minus the latency of its class at the time of association.
    pub dt: f32,
    /// Column in pixels.
    pub x: u16,
    /// Row in pixels.
    pub y: u16,
    /// Index of the edge in the board's list of edges.
    pub edge: u16,
    /// Event class (see [`crate::solve::rows::event_bias::EventKind::class`]).
    pub class: u8,
    /// Range of the edge's normal speed (see [`crate::solve::rows::event_bias::speed_range`]).
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
    /// Returns the bins and circle centres whose time is `wanted`, without the times in [`far`](Self::far).
    pub fn at_times(&self, wanted: impl Fn(f64) -> bool) -> Self {
        let mut part = Self::default();
        for bin in self.bins.iter().filter(|bin| wanted(bin.t)) {
            let first = part.events.len();
            part.events.extend_from_slice(self.events.get(bin.first..bin.end).unwrap_or_default());
            part.bins.push(EventBin { t: bin.t, first, end: part.events.len() });
        }
        part.points.extend(self.points.iter().filter(|point| wanted(point.t)));
        part
    }

    /// Returns every `step`-th event and all circle centres, without the times in [`far`](Self::far).
    pub fn every(&self, step: usize) -> Self {
        let mut part = Self { points: self.points.clone(), ..Self::default() };
        let kept = |index: &usize| index.is_multiple_of(step.max(1));
        for bin in &self.bins {
            let first = part.events.len();
            part.events.extend((bin.first..bin.end).filter(kept).filter_map(|index| self.events.get(index)));
            if part.events.len() > first {
                part.bins.push(EventBin { t: bin.t, first, end: part.events.len() });
            }
        }
        part
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thinned_events_stay_in_their_bins() {
        let event = |x| EventObservation { dt: 0.0, x, y: 0, edge: 0, class: 0, speed_range: 0 };
        let bin = |t, first, end| EventBin { t, first, end };
        let all = SegmentObservations {
            bins: vec![bin(0.1, 0, 4), bin(0.2, 4, 6), bin(0.3, 6, 8)],
            events: (0..8).map(event).collect(),
            ..SegmentObservations::default()
        };
        let part = all.every(3);
        assert_eq!(part.events.iter().map(|event| event.x).collect::<Vec<_>>(), [0, 3, 6]);
        assert_eq!(part.bins, [bin(0.1, 0, 2), bin(0.3, 2, 3)]);
        assert_eq!(all.every(1), all);
    }
}

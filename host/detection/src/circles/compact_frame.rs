//! Reference frames that take a fifth of the memory of [`ReferenceFrame`], because a detector finds some hundred per
//! second.

use nalgebra::Vector2;

use super::reference_frame::{ObservedCircle, ReferenceFrame, SeenIn};

/// A circle that a detector found.
#[derive(Clone, Copy, Debug, PartialEq)]
struct CompactCircle {
    center: [f32; 2],
    /// 0 for a corner.
    radius: f32,
}

/// A reference frame whose circles a detector found. The detector uses single precision, so nothing is lost, and all circles have
/// the time of the middle of their window.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactFrame {
    /// Index of the recording.
    pub recording: usize,
    /// Start of the window in seconds since the start of the recording.
    pub start: f64,
    /// End of the window.
    pub end: f64,
    /// Kind of data in which the board was found.
    pub seen_in: SeenIn,
    circles: Box<[CompactCircle]>,
    /// Indices of the circles on the board; empty if they are its first ones in order, for example all of them.
    indices: Box<[u32]>,
}

impl From<ReferenceFrame> for CompactFrame {
    fn from(frame: ReferenceFrame) -> Self {
        let compact = |circle: &ObservedCircle| CompactCircle {
            center: [circle.center.x as f32, circle.center.y as f32],
            radius: circle.radius.unwrap_or_default() as f32,
        };
        let ReferenceFrame { recording, start, end, circles, seen_in } = frame;
        let in_order = circles.iter().enumerate().all(|(place, circle)| place == circle.index);
        let indices = circles.iter().filter(|_| !in_order).map(|circle| circle.index as u32).collect();
        Self { recording, start, end, seen_in, circles: circles.iter().map(compact).collect(), indices }
    }
}

impl From<CompactFrame> for ReferenceFrame {
    fn from(frame: CompactFrame) -> Self {
        let circles = frame.observed();
        let CompactFrame { recording, start, end, seen_in, .. } = frame;
        Self { recording, start, end, circles, seen_in }
    }
}

impl CompactFrame {
    /// Returns the timestamp of the frame: the centre of its window, in seconds.
    pub fn t(&self) -> f64 {
        0.5 * (self.start + self.end)
    }

    /// Returns the number of circles.
    pub fn circle_count(&self) -> usize {
        self.circles.len()
    }

    /// Returns its circles.
    pub fn observed(&self) -> Vec<ObservedCircle> {
        let t = self.t();
        let observed = |(place, circle): (usize, &CompactCircle)| ObservedCircle {
            index: self.indices.get(place).map_or(place, |&index| index as usize),
            t,
            center: Vector2::from(circle.center).cast(),
            radius: (circle.radius > 0.0).then_some(f64::from(circle.radius)),
            velocity: None,
        };
        self.circles.iter().enumerate().map(observed).collect()
    }

    /// Returns the frame without its events.
    pub fn without_events(&self) -> ReferenceFrame {
        ReferenceFrame {
            recording: self.recording,
            start: self.start,
            end: self.end,
            circles: self.observed(),
            seen_in: SeenIn::PassedEvents,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_of_a_detector_is_converted_without_loss() {
        let (start, end) = (0.1, 0.1073);
        let circle = |index: usize, x: f32| ObservedCircle {
            index,
            t: 0.5 * (start + end),
            center: Vector2::new(x, 33.3 * x).cast(),
            radius: Some(f64::from(0.7 * x)),
            velocity: None,
        };
        for circles in [vec![circle(0, 12.3), circle(70_000, 0.1)], vec![circle(0, 12.3), circle(1, 0.1)]] {
            let frame = ReferenceFrame { recording: 1, start, end, circles, seen_in: SeenIn::PassedEvents };
            let compact = CompactFrame::from(frame.clone());
            assert_eq!((compact.circle_count(), compact.without_events()), (2, frame.clone()));
            assert_eq!(ReferenceFrame::from(compact), frame);
        }
    }
}

//! Sharpness of the circles: the width of the band of events about their rims.
//!
//! Motion widens the band too, so the smallest width of the last seconds is kept as well.

use std::collections::VecDeque;

use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::detection::focus::band_width;

/// Time between two measured windows (s).
const INTERVAL: f64 = 0.1;
/// Time over which the smallest width is kept (s).
const KEPT_TIME: f64 = 5.0;

/// Sharpness of circles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focus {
    /// Width of the band about the rims in the latest window (px): twice the median distance from the rim.
    pub width: f64,
    /// Smallest width of the last 5 s (px).
    pub sharpest: f64,
}

/// Measures the sharpness of windows with the board.
#[derive(Clone, Debug, Default)]
pub struct FocusMeter {
    /// Time and width of the windows of the last [`KEPT_TIME`] seconds.
    recent: VecDeque<(f64, f64)>,
}

impl FocusMeter {
    /// Adds a window with the board.
    pub fn see(&mut self, frame: &ReferenceFrame) {
        let now = frame.t();
        if self.recent.back().is_some_and(|(t, _)| (0.0..INTERVAL).contains(&(now - t))) {
            return;
        }
        if let Some(width) = frame.events().and_then(|pixels| band_width(frame, pixels)) {
            self.recent.retain(|(t, _)| (0.0..=KEPT_TIME).contains(&(now - t)));
            self.recent.push_back((now, width));
        }
    }

    /// Returns the sharpness; `None` before the board was seen.
    pub fn focus(&self) -> Option<Focus> {
        let &(_, width) = self.recent.back()?;
        Some(Focus { width, sharpest: self.recent.iter().map(|(_, width)| *width).fold(width, f64::min) })
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::{Event, Polarity};
    use nalgebra::Vector2;

    use super::*;
    use evcal_detection::circles::event_pixel::EventPixel;
    use evcal_detection::circles::reference_frame::{ObservedCircle, SeenIn};

    /// Returns a frame with one circle whose pixels lie up to `half` px on both sides of its rim.
    fn frame(t: f64, half: f64) -> ReferenceFrame {
        let center = Vector2::new(50.0, 40.0);
        let mut pixels = Vec::new();
        for (x, y) in (0..100).flat_map(|x| (0..80).map(move |y| (x, y))) {
            let offset = (Vector2::new(f64::from(x), f64::from(y)) - center).norm() - 20.0;
            if offset.abs() <= half || x == 0 {
                pixels.push(EventPixel::new(&Event { t: 0, x, y, polarity: Polarity::On }));
            }
        }
        let circles = vec![ObservedCircle { index: 0, t, center, radius: Some(20.0), velocity: None }];
        ReferenceFrame { recording: 0, start: t, end: t, circles, seen_in: SeenIn::Events(pixels) }
    }

    #[test]
    fn the_width_of_a_band_is_measured_and_the_sharpest_is_kept() {
        let mut meter = FocusMeter::default();
        assert_eq!(meter.focus(), None);
        meter.see(&frame(0.0, 1.5));
        let sharp = meter.focus().unwrap().width;
        // Half of the pixels of a band of 3 px lie within 1.5 px.
        assert!((sharp - 1.5).abs() < 0.2, "{sharp}");
        meter.see(&frame(0.01, 6.0));
        assert_eq!(meter.focus().unwrap().width, sharp, "too soon");
        meter.see(&frame(1.0, 6.0));
        let Focus { width, sharpest } = meter.focus().unwrap();
        assert!((width - 6.0).abs() < 0.5 && sharpest == sharp, "{width}");
        meter.see(&frame(5.5, 6.0));
        assert!(meter.focus().unwrap().sharpest > 5.0);
    }
}

//! Detection of exchanged polarities. A dark dot sends OFF events on the side towards which it moves, and ON events on the other.

use evcal_core::event::Polarity;
use nalgebra::Vector2;
use serde::Serialize;

use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};

/// Number of pairs of neighbouring windows that are evaluated.
pub const PAIRS: usize = 100;
/// Longest time between the two (s).
const LONGEST: f64 = 0.05;
/// Slowest speed of a circle (px/s) at which its front is known.
const SLOWEST: f64 = 30.0;
/// Largest distance of a pixel from the centre of its circle (radii).
const REACH: f64 = 1.3;
/// Fewest pixels of each polarity.
const FEWEST_PIXELS: f64 = 4.0;
/// Fewest circles for a decision.
const FEWEST_CIRCLES: usize = 200;
/// Polarities are exchanged if more than this share of the circles has ON events in front.
const MOST: f64 = 0.8;

/// ON events are on the side towards which dots move: polarities are exchanged, or the dots are lighter than the paper.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error, Serialize)]
#[error(
    "ON events are in front of moving dots at {:.0} % of {circles} circles, where dark dots send OFF events: ON and OFF are exchanged in the file, or light dots are on dark paper",
    100.0 * share
)]
pub struct Exchanged {
    /// Number of circles that were evaluated.
    pub circles: usize,
    /// Share of the circles with ON events in front.
    pub share: f64,
}

impl Exchanged {
    /// Remedy.
    pub const ADVICE: &str =
        "write 1 for ON, where the pixel became brighter, and 0 for OFF; or print the board dark on light paper";
}

/// Evaluates the circles of windows, each with the following one.
pub fn exchanged<'a>(pairs: impl Iterator<Item = (&'a ReferenceFrame, &'a ReferenceFrame)>) -> Option<Exchanged> {
    let (mut circles, mut in_front) = (0, 0);
    for (frame, next) in pairs {
        let after = next.t() - frame.t();
        let Some(pixels) = frame.events().filter(|_| next.recording == frame.recording && after < LONGEST) else {
            continue;
        };
        for circle in &frame.circles {
            let Some(radius) = circle.radius else { continue };
            let same = |other: &&ObservedCircle| other.index == circle.index;
            let Some(later) = next.circles.iter().find(same) else { continue };
            let velocity = (later.center - circle.center) / after;
            let (mut sums, mut counts) = ([Vector2::<f64>::zeros(); 2], [0.0; 2]);
            for pixel in pixels {
                let place = Vector2::new(f64::from(pixel.x()), f64::from(pixel.y())) - circle.center;
                let kind = usize::from(pixel.polarity() == Polarity::On);
                if place.norm() < REACH * radius
                    && let (Some(sum), Some(count)) = (sums.get_mut(kind), counts.get_mut(kind))
                {
                    *sum += place;
                    *count += 1.0;
                }
            }
            let ([off, on], [off_count, on_count]) = (sums, counts);
            if velocity.norm() < SLOWEST || off_count < FEWEST_PIXELS || on_count < FEWEST_PIXELS {
                continue;
            }
            circles += 1;
            in_front += usize::from((on / on_count - off / off_count).dot(&velocity) > 0.0);
        }
    }
    let share = in_front as f64 / circles.max(1) as f64;
    (circles >= FEWEST_CIRCLES && share > MOST).then_some(Exchanged { circles, share })
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Event;

    use super::*;
    use crate::circles::event_pixel::EventPixel;
    use crate::circles::reference_frame::SeenIn;

    /// A dot of 10 px that moves to the right, with events of polarity `front` at its right rim.
    fn frames(front: Polarity) -> Vec<ReferenceFrame> {
        let back = if front == Polarity::On { Polarity::Off } else { Polarity::On };
        let frame = |number: u16| {
            let x = 40 + number;
            let pixels = (0..20_u16).flat_map(|row| {
                [(x + 10, front), (x - 10, back)]
                    .map(|(x, polarity)| EventPixel::new(&Event { t: 0, x, y: 90 + row, polarity }))
            });
            let start = 0.01 * f64::from(number);
            let center = Vector2::new(f64::from(x), 100.0);
            let circle = ObservedCircle { index: 0, t: start, center, radius: Some(10.0), velocity: None };
            ReferenceFrame {
                recording: 0,
                start,
                end: start,
                circles: vec![circle],
                seen_in: SeenIn::Events(pixels.collect()),
            }
        };
        (0..250).map(frame).collect()
    }

    #[test]
    fn on_events_in_front_are_exchanged() {
        let of = |frames: &[ReferenceFrame]| exchanged(frames.iter().zip(frames.iter().skip(1)));
        assert_eq!(of(&frames(Polarity::Off)), None);
        assert_eq!(of(&frames(Polarity::On)), Some(Exchanged { circles: 249, share: 1.0 }));
        // Too few for a decision.
        assert_eq!(of(&frames(Polarity::On)[..100]), None);
    }
}

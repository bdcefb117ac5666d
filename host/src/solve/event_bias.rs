//! Where events sit relative to the geometric edge of a dot.
//!
//! Events do not happen on the edge: contrast thresholds act on log intensity (the dot looks
//! smaller), each further event of a burst lies deeper in the blurred edge, the blur shifts a curved
//! edge more than a straight one, and the pixel's latency moves edges along the motion, less than in
//! proportion at high speed, and more towards the corners, where lenses give less light. Each event
//! class (polarity × rank in the burst) therefore has its own biases and spread, estimated together
//! with the camera: an event of class c on an edge that moves with normal speed v, of a dot whose
//! radius is ρ pixels, lies
//! `offset + curvature / ρ + bend v² + corner_latency v s² + curvature_latency v / ρ + memory a`
//! from the edge, `latency` after its passage; s is the distance from the middle of the sensor, 1 at
//! its corners, and a the acceleration with which a round dot passes a pixel off its middle.
//! Its spread depends on the speed: slow edges give noise the time to move events, fast ones turn
//! differences between pixels' latencies into pixels.

pub mod bias;
pub mod robust;

use evcal_core::event::Polarity;

use crate::solve::burst::{MAX_RANK, RANK_COUNT};
use bias::{Bias, Biases};

/// Number of event classes: two polarities × ranks.
pub const CLASS_COUNT: usize = 2 * RANK_COUNT;

/// The class of an event.
pub fn class(polarity: Polarity, rank: u8) -> usize {
    polarity.index() * RANK_COUNT + usize::from(rank.min(MAX_RANK))
}

/// What is known of one event class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassBias {
    /// What shifts its events from the edge.
    pub biases: Biases<f64>,
    /// Spread of the class in pixels, for each of the ranges of normal speed of [`speed_range`].
    pub sigma: [f64; SPEED_RANGE_COUNT],
}

/// Number of ranges of speed in which the spread of a class is told apart.
pub const SPEED_RANGE_COUNT: usize = 5;

/// In which range the normal speed of an edge is: below 100, 200, 400, 800 px/s, or above.
pub fn speed_range(normal_speed: f64) -> usize {
    let speed = normal_speed.abs();
    [100.0, 200.0, 400.0, 800.0].iter().filter(|&&bound| speed >= bound).count()
}

/// How an edge passes a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePassage {
    /// Normal speed in px/s, positive where the pixel leaves the dot.
    pub normal_speed: f64,
    /// One over the dot's radius in pixels.
    pub inverse_radius: f64,
    /// Squared distance from the middle of the sensor, 1 at its corners.
    pub corner_share: f64,
    /// Second derivative of the distance from the edge by time (px/s²).
    pub acceleration: f64,
}

impl EdgePassage {
    /// Derivatives of the expected distance by the biases of the class.
    #[inline(always)]
    pub fn derivatives(&self) -> Biases<f64> {
        let speed = self.normal_speed;
        let mut derivatives = Biases::default();
        derivatives[Bias::Offset] = 1.0;
        derivatives[Bias::Latency] = speed;
        derivatives[Bias::Bend] = speed * speed;
        derivatives[Bias::Curvature] = self.inverse_radius;
        derivatives[Bias::CornerLatency] = speed * self.corner_share;
        derivatives[Bias::CurvatureLatency] = speed * self.inverse_radius;
        derivatives[Bias::Memory] = self.acceleration;
        derivatives
    }
}

impl ClassBias {
    /// Distance in pixels from the edge at which an event of the class is expected, the latency left
    /// out: that one moves the pose.
    #[inline(always)]
    pub fn distance(&self, passage: &EdgePassage) -> f64 {
        expected_distance(&self.biases, passage)
    }
}

/// Distance in pixels from the edge at which an event with these biases is expected, the latency left out.
#[inline(always)]
pub fn expected_distance(biases: &Biases<f64>, passage: &EdgePassage) -> f64 {
    let EdgePassage { normal_speed, inverse_radius, corner_share, acceleration } = *passage;
    let latency = biases[Bias::Bend] * normal_speed
        + biases[Bias::CornerLatency] * corner_share
        + biases[Bias::CurvatureLatency] * inverse_radius;
    biases[Bias::Offset]
        + biases[Bias::Curvature] * inverse_radius
        + biases[Bias::Memory] * acceleration
        + normal_speed * latency
}

/// Biases of all event classes.
pub type EventBias = [ClassBias; CLASS_COUNT];

/// Before anything is known: no offset, no latency, a spread of `sigma` pixels.
pub fn unknown(sigma: f64) -> EventBias {
    [ClassBias { biases: Biases::default(), sigma: [sigma; SPEED_RANGE_COUNT] }; CLASS_COUNT]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_distance() {
        let passage =
            EdgePassage { normal_speed: 300.0, inverse_radius: 0.1, corner_share: 0.6, acceleration: -2000.0 };
        let [known, ..] = unknown(1.0);
        for bias in Bias::ALL.into_iter().filter(|&bias| bias != Bias::Latency) {
            let mut moved = known;
            moved.biases[bias] = 2.0;
            let slope = (moved.distance(&passage) - known.distance(&passage)) / 2.0;
            assert!((slope - passage.derivatives()[bias]).abs() <= 1e-12 * slope.abs(), "{bias:?}: {slope}");
        }
    }
}

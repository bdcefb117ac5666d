//! Where events sit relative to the geometric edge of a dot.
//!
//! Events do not happen on the edge: contrast thresholds act on log intensity (the dot looks
//! smaller), each further event of a burst lies deeper in the blurred edge, the blur shifts a curved
//! edge more than a straight one, and the pixel's latency moves edges along the motion, less than in
//! proportion at high speed. Each event class (polarity × rank in the burst) therefore has its own
//! biases and spread, estimated together with the camera: an event of class c on an edge that moves
//! with normal speed v, of a dot whose radius is ρ pixels, lies
//! `offset + curvature / ρ + bend v²` from the edge, `latency` after its passage.

use evcal_core::event::Polarity;

use crate::burst::{MAX_RANK, RANK_COUNT};

/// Number of event classes: two polarities × ranks.
pub const CLASS_COUNT: usize = 2 * RANK_COUNT;

/// The class of an event.
pub fn class(polarity: Polarity, rank: u8) -> usize {
    polarity.index() * RANK_COUNT + usize::from(rank.min(MAX_RANK))
}

/// What is known of one event class.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ClassBias {
    /// Mean signed distance of the class from the geometric edge in pixels, positive outside the
    /// dot.
    pub offset: f64,
    /// What one over the dot's radius in pixels adds to the offset (px²).
    pub curvature: f64,
    /// Delay in seconds between the edge's passage and the event, relative to class 0 (first OFF
    /// event of a burst): a delay common to all classes cannot be told from a shift of the clock.
    pub latency: f64,
    /// What the square of the normal speed in px/s adds to the offset (s²/px), relative to class 0: at
    /// high speed the pixel's low-pass no longer delays by a constant time.
    pub bend: f64,
    /// Spread of the class in pixels.
    pub sigma: f64,
}

/// Number of biases of a class: offset, latency, bend and curvature, in the order in which the joint
/// solve has them.
pub const BIAS_COUNT: usize = 4;

impl ClassBias {
    /// Distance in pixels from the edge at which an event of the class is expected, the latency left
    /// out. `normal_speed` in px/s, `inverse_radius` one over the dot's radius in pixels.
    #[inline(always)]
    pub fn distance(&self, normal_speed: f64, inverse_radius: f64) -> f64 {
        self.offset + self.bend * normal_speed * normal_speed + self.curvature * inverse_radius
    }

    /// Adds a step of the joint solve.
    pub fn update(&mut self, step: [f64; BIAS_COUNT]) {
        self.offset += step[0];
        self.latency += step[1];
        self.bend += step[2];
        self.curvature += step[3];
    }
}

/// Biases of all event classes.
pub type EventBias = [ClassBias; CLASS_COUNT];

/// Before anything is known: no offset, no latency, a spread of `sigma` pixels.
pub fn unknown(sigma: f64) -> EventBias {
    [ClassBias { offset: 0.0, curvature: 0.0, latency: 0.0, bend: 0.0, sigma }; CLASS_COUNT]
}

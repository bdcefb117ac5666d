//! Where events sit relative to the geometric edge of a dot.
//!
//! Events do not happen on the edge: contrast thresholds act on log intensity (the dot looks
//! smaller), each further event of a burst lies deeper in the blurred edge, and the pixel's latency
//! moves edges along the motion. Each event class (polarity × rank in the burst) therefore has its
//! own offset, latency and spread, estimated together with the camera.

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
    /// Delay in seconds between the edge's passage and the event, relative to class 0 (first OFF
    /// event of a burst): a delay common to all classes cannot be told from a shift of the clock.
    pub latency: f64,
    /// Spread of the class around its offset in pixels.
    pub sigma: f64,
}

/// Biases of all event classes.
pub type EventBias = [ClassBias; CLASS_COUNT];

/// Before anything is known: no offset, no latency, a spread of `sigma` pixels.
pub fn unknown(sigma: f64) -> EventBias {
    [ClassBias { offset: 0.0, latency: 0.0, sigma }; CLASS_COUNT]
}

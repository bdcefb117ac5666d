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

pub mod robust;

use evcal_core::event::Polarity;

use crate::solve::burst::{MAX_RANK, RANK_COUNT};

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
    /// What the latency grows by from the middle of the sensor to its corners (s), with the square of
    /// the distance.
    pub corner_latency: f64,
    /// What one over the dot's radius in pixels adds to the latency (s px).
    pub curvature_latency: f64,
    /// What the acceleration of the edge in px/s² adds to the offset (s²): a slow pixel remembers where
    /// the edge was before.
    pub memory: f64,
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

/// Number of biases of a class: offset, latency, bend, curvature, corner latency, curvature latency and
/// memory, in the order in which the joint solve has them.
pub const BIAS_COUNT: usize = 7;

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
    pub fn derivatives(&self) -> [f64; BIAS_COUNT] {
        let speed = self.normal_speed;
        let inverse_radius = self.inverse_radius;
        [
            1.0,
            speed,
            speed * speed,
            inverse_radius,
            speed * self.corner_share,
            speed * inverse_radius,
            self.acceleration,
        ]
    }
}

impl ClassBias {
    /// Distance in pixels from the edge at which an event of the class is expected, the latency left
    /// out: that one moves the pose.
    #[inline(always)]
    pub fn distance(&self, passage: &EdgePassage) -> f64 {
        let EdgePassage { normal_speed, inverse_radius, corner_share, acceleration } = *passage;
        let latency =
            self.bend * normal_speed + self.corner_latency * corner_share + self.curvature_latency * inverse_radius;
        self.offset + self.curvature * inverse_radius + self.memory * acceleration + normal_speed * latency
    }

    /// Adds a step of the joint solve.
    pub fn update(&mut self, step: [f64; BIAS_COUNT]) {
        self.offset += step[0];
        self.latency += step[1];
        self.bend += step[2];
        self.curvature += step[3];
        self.corner_latency += step[4];
        self.curvature_latency += step[5];
        self.memory += step[6];
    }
}

/// Biases of all event classes.
pub type EventBias = [ClassBias; CLASS_COUNT];

/// Before anything is known: no offset, no latency, a spread of `sigma` pixels.
pub fn unknown(sigma: f64) -> EventBias {
    let sigma = [sigma; SPEED_RANGE_COUNT];
    let class = ClassBias {
        offset: 0.0,
        curvature: 0.0,
        latency: 0.0,
        bend: 0.0,
        corner_latency: 0.0,
        curvature_latency: 0.0,
        memory: 0.0,
        sigma,
    };
    [class; CLASS_COUNT]
}

//! Distances at which events happen relative to the geometric edge of a dot.
//!
//! Events do not happen on the edge. Contrast thresholds act on log intensity (the dot looks smaller), each further
//! event of a burst lies deeper in the blurred edge, and blur shifts a curved edge more than a straight one. The
//! pixel's latency shifts edges along the motion. The shift grows less than in proportion to the speed, and it is
//! larger towards the corners of the image, where lenses transmit less light. Each event class (polarity × rank in the
//! burst × length of the burst) therefore has its own biases and spread, estimated together with the camera. An event
//! of class c, on an edge that moves with normal speed v, of a dot whose radius is ρ pixels, lies
//! `offset + curvature / ρ + bend v² + corner_latency v s² + curvature_latency v / ρ + memory a`
//! from the edge, `latency` after its passage. s is the distance from the middle of the sensor, 1 at its corners. a is
//! the acceleration of the edge, which is not zero if the middle of a round dot does not pass over the pixel. At the
//! straight edge of a square, ρ is the width of the dark strip and a is zero. The spread depends on the speed: at slow
//! edges noise has time to shift events; at fast ones the different latencies of pixels become distances.

pub mod bias;
pub mod first_events;
pub mod robust;

use evcal_core::event::Polarity;

use crate::solve::rows::burst::{BurstLength, BurstPosition, MAX_RANK, RANK_COUNT};
use bias::{Bias, Biases};

/// Number of classes for each length of bursts: two polarities × ranks.
pub const CLASSES_OF_LENGTH: usize = 2 * RANK_COUNT;
/// Number of event classes: first the classes of long bursts, then the classes of shorter ones.
pub const CLASS_COUNT: usize = BurstLength::COUNT * CLASSES_OF_LENGTH;
/// Number of biases that a class of shorter bursts has for itself: the first two, offset and latency. It shares the others with
/// the class of long bursts of the same polarity and rank.
const BIASES_OF_SHORTER: usize = 2;
/// Number of biases of all classes.
pub const BIAS_COUNT: usize = Bias::COUNT * CLASSES_OF_LENGTH + BIASES_OF_SHORTER * (CLASS_COUNT - CLASSES_OF_LENGTH);

/// Returns `true` if classes that differ only in the length of the bursts share `bias`.
pub const fn is_shared_bias(bias: Bias) -> bool {
    bias.index() >= BIASES_OF_SHORTER
}

/// Returns `true` if `bias` is not shared by `class` with an earlier class.
pub const fn is_own_bias(class: usize, bias: Bias) -> bool {
    class < CLASSES_OF_LENGTH || !is_shared_bias(bias)
}

/// Returns the index of a bias of `class` among the biases of all classes, below [`BIAS_COUNT`].
pub const fn bias_place(class: usize, bias: Bias) -> usize {
    if class >= CLASSES_OF_LENGTH && is_own_bias(class, bias) {
        Bias::COUNT * CLASSES_OF_LENGTH + BIASES_OF_SHORTER * (class - CLASSES_OF_LENGTH) + bias.index()
    } else {
        Bias::COUNT * (class % CLASSES_OF_LENGTH) + bias.index()
    }
}

/// Properties that all events of a class share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventKind {
    /// Darker or brighter.
    pub polarity: Polarity,
    /// Rank and length of the burst.
    pub place: BurstPosition,
}

impl EventKind {
    /// Returns the index of the class: long bursts come first, and within each length OFF before ON.
    pub fn class(&self) -> usize {
        let burst = 2 * self.place.length.index() + self.polarity.index();
        burst * RANK_COUNT + usize::from(self.place.rank.min(MAX_RANK))
    }

    /// Returns the kind of the events of class number `class`, which is below [`CLASS_COUNT`].
    pub fn of_class(class: usize) -> Self {
        let burst = class / RANK_COUNT;
        let polarity = if burst.is_multiple_of(2) { Polarity::Off } else { Polarity::On };
        let length = BurstLength::ALL.get(burst / 2).copied().unwrap_or_default();
        let place = BurstPosition { rank: (class % RANK_COUNT) as u8, length };
        Self { polarity, place }
    }
}

/// Estimates for one event class.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClassBias {
    /// Biases of the distance from the edge.
    pub biases: Biases<f64>,
    /// Spread of the class in pixels, for each of the ranges of normal speed of [`speed_range`].
    pub sigma: [f64; SPEED_RANGE_COUNT],
}

/// Number of speed ranges with a spread of their own.
pub const SPEED_RANGE_COUNT: usize = 5;

/// Returns the range of a normal speed of an edge: below 100, 200, 400, 800 px/s, or above.
pub fn speed_range(normal_speed: f64) -> usize {
    let speed = normal_speed.abs();
    [100.0, 200.0, 400.0, 800.0].iter().filter(|&&bound| speed >= bound).count()
}

/// Motion of an edge as it passes a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgePassage {
    /// Normal speed in px/s, positive if the pixel becomes brighter.
    pub normal_speed: f64,
    /// One over the dot's radius in pixels; at a straight edge one over the width of its dark strip.
    pub narrowness: f64,
    /// Squared distance from the middle of the sensor, 1 at its corners.
    pub corner_share: f64,
    /// Second derivative of the distance from the edge by time (px/s²).
    pub acceleration: f64,
}

impl EdgePassage {
    /// Returns the derivatives of the expected distance by the biases of the class.
    #[inline(always)]
    pub fn derivatives(&self) -> Biases<f64> {
        let speed = self.normal_speed;
        let mut derivatives = Biases::default();
        derivatives[Bias::Offset] = 1.0;
        derivatives[Bias::Latency] = speed;
        derivatives[Bias::Bend] = speed * speed;
        derivatives[Bias::Curvature] = self.narrowness;
        derivatives[Bias::CornerLatency] = speed * self.corner_share;
        derivatives[Bias::CurvatureLatency] = speed * self.narrowness;
        derivatives[Bias::Memory] = self.acceleration;
        derivatives
    }
}

impl ClassBias {
    /// Returns the distance in pixels from the edge at which an event of the class is expected, without the latency, which acts
    /// on the pose instead.
    #[inline(always)]
    pub fn distance(&self, passage: &EdgePassage) -> f64 {
        expected_distance(&self.biases, passage)
    }
}

/// Returns the distance in pixels from the edge at which an event with these biases is expected, without the latency.
#[inline(always)]
pub fn expected_distance(biases: &Biases<f64>, passage: &EdgePassage) -> f64 {
    let EdgePassage { normal_speed, narrowness, corner_share, acceleration } = *passage;
    let latency = biases[Bias::Bend] * normal_speed
        + biases[Bias::CornerLatency] * corner_share
        + biases[Bias::CurvatureLatency] * narrowness;
    biases[Bias::Offset]
        + biases[Bias::Curvature] * narrowness
        + biases[Bias::Memory] * acceleration
        + normal_speed * latency
}

/// Biases of all event classes.
pub type EventBias = [ClassBias; CLASS_COUNT];

/// Returns the start values: no offset, no latency, a spread of `sigma` pixels.
pub fn unknown(sigma: f64) -> EventBias {
    [ClassBias { biases: Biases::default(), sigma: [sigma; SPEED_RANGE_COUNT] }; CLASS_COUNT]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_class_is_of_one_kind_of_event() {
        for class in 0..CLASS_COUNT {
            assert_eq!(EventKind::of_class(class).class(), class);
        }
        let first = EventKind::of_class(0);
        let place = BurstPosition { rank: 0, length: BurstLength::FiveOrMore };
        assert_eq!(first, EventKind { polarity: Polarity::Off, place });
    }

    #[test]
    fn classes_of_shorter_bursts_share_all_biases_but_offset_and_latency() {
        let mut owners = [0; BIAS_COUNT];
        for class in 0..CLASS_COUNT {
            let kind = EventKind::of_class(class);
            let long = BurstPosition { length: BurstLength::FiveOrMore, ..kind.place };
            let twin = EventKind { place: long, ..kind }.class();
            for bias in Bias::ALL {
                let place = bias_place(class, bias);
                let is_own = twin == class || matches!(bias, Bias::Offset | Bias::Latency);
                assert_eq!(is_own_bias(class, bias), is_own);
                assert_eq!(place == bias_place(twin, bias), twin == class || !is_own, "{class} {bias:?}");
                owners[place] += usize::from(is_own);
            }
        }
        assert_eq!(owners, [1; BIAS_COUNT]);
    }

    #[test]
    fn derivatives_agree_with_the_distance() {
        let passage = EdgePassage { normal_speed: 300.0, narrowness: 0.1, corner_share: 0.6, acceleration: -2000.0 };
        let [known, ..] = unknown(1.0);
        for bias in Bias::ALL.into_iter().filter(|&bias| bias != Bias::Latency) {
            let mut moved = known;
            moved.biases[bias] = 2.0;
            let slope = (moved.distance(&passage) - known.distance(&passage)) / 2.0;
            assert!((slope - passage.derivatives()[bias]).abs() <= 1e-12 * slope.abs(), "{bias:?}: {slope}");
        }
    }
}

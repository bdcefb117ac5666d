//! Where events sit relative to the geometric edge of a dot.
//!
//! Events do not happen on the edge: contrast thresholds act on log intensity (the dot looks
//! smaller), each further event of a burst lies deeper in the blurred edge, the blur shifts a curved
//! edge more than a straight one, and the pixel's latency moves edges along the motion, less than in
//! proportion at high speed, and more towards the corners, where lenses give less light. Each event
//! class (polarity × rank in the burst × length of the burst) therefore has its own biases and spread, estimated together
//! with the camera: an event of class c on an edge that moves with normal speed v, of a dot whose
//! radius is ρ pixels, lies
//! `offset + curvature / ρ + bend v² + corner_latency v s² + curvature_latency v / ρ + memory a`
//! from the edge, `latency` after its passage; s is the distance from the middle of the sensor, 1 at
//! its corners, and a the acceleration with which a round dot passes a pixel off its middle. At the straight edge of a square ρ is the
//! width of the dark strip and 1 / a that of the light one: the next edge reaches into the blur of this one.
//! Its spread depends on the speed: slow edges give noise the time to move events, fast ones turn
//! differences between pixels' latencies into pixels.

pub mod bias;
pub mod first_events;
pub mod robust;

use evcal_core::event::Polarity;

use crate::solve::burst::{BurstLength, BurstPlace, MAX_RANK, RANK_COUNT};
use bias::{Bias, Biases};

/// Number of classes of each length of bursts: two polarities × ranks.
pub const CLASSES_OF_LENGTH: usize = 2 * RANK_COUNT;
/// Number of event classes: those of long bursts, then those of shorter ones.
pub const CLASS_COUNT: usize = BurstLength::COUNT * CLASSES_OF_LENGTH;
/// Classes of shorter bursts have so many biases of their own, the first ones: offset and latency. The others are those of
/// the class of long bursts that differs in this only.
const BIASES_OF_SHORTER: usize = 2;
/// Number of biases of all classes.
pub const BIAS_COUNT: usize = Bias::COUNT * CLASSES_OF_LENGTH + BIASES_OF_SHORTER * (CLASS_COUNT - CLASSES_OF_LENGTH);

/// Whether classes that differ in the length of the bursts only share `bias`.
pub const fn is_shared_bias(bias: Bias) -> bool {
    bias.index() >= BIASES_OF_SHORTER
}

/// Whether `bias` is one that `class` does not share with an earlier class.
pub const fn is_own_bias(class: usize, bias: Bias) -> bool {
    class < CLASSES_OF_LENGTH || !is_shared_bias(bias)
}

/// Place of a bias of `class` among those of all classes, below [`BIAS_COUNT`].
pub const fn bias_place(class: usize, bias: Bias) -> usize {
    if class >= CLASSES_OF_LENGTH && is_own_bias(class, bias) {
        Bias::COUNT * CLASSES_OF_LENGTH + BIASES_OF_SHORTER * (class - CLASSES_OF_LENGTH) + bias.index()
    } else {
        Bias::COUNT * (class % CLASSES_OF_LENGTH) + bias.index()
    }
}

/// What the events of a class have in common.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EventKind {
    /// Darker or brighter.
    pub polarity: Polarity,
    /// Place in the bursts of their pixel.
    pub place: BurstPlace,
}

impl EventKind {
    /// Index of the class: those of long bursts come first, of each length OFF before ON.
    pub fn class(&self) -> usize {
        let burst = 2 * self.place.length.index() + self.polarity.index();
        burst * RANK_COUNT + usize::from(self.place.rank.min(MAX_RANK))
    }

    /// The events of class number `class`, which is below [`CLASS_COUNT`].
    pub fn of_class(class: usize) -> Self {
        let burst = class / RANK_COUNT;
        let polarity = if burst.is_multiple_of(2) { Polarity::Off } else { Polarity::On };
        let length = BurstLength::ALL.get(burst / 2).copied().unwrap_or_default();
        let place = BurstPlace { rank: (class % RANK_COUNT) as u8, length };
        Self { polarity, place }
    }
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
    /// Normal speed in px/s, positive where the pixel becomes brighter.
    pub normal_speed: f64,
    /// One over the dot's radius in pixels; at a straight edge one over the width of its dark strip.
    pub narrowness: f64,
    /// Squared distance from the middle of the sensor, 1 at its corners.
    pub corner_share: f64,
    /// At a rim the second derivative of the distance from the edge by time (px/s²); at a straight edge one over the width of its light
    /// strip in pixels.
    pub memory: f64,
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
        derivatives[Bias::Curvature] = self.narrowness;
        derivatives[Bias::CornerLatency] = speed * self.corner_share;
        derivatives[Bias::CurvatureLatency] = speed * self.narrowness;
        derivatives[Bias::Memory] = self.memory;
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
    let EdgePassage { normal_speed, narrowness, corner_share, memory } = *passage;
    let latency = biases[Bias::Bend] * normal_speed
        + biases[Bias::CornerLatency] * corner_share
        + biases[Bias::CurvatureLatency] * narrowness;
    biases[Bias::Offset] + biases[Bias::Curvature] * narrowness + biases[Bias::Memory] * memory + normal_speed * latency
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
    fn each_class_is_of_one_kind_of_event() {
        for class in 0..CLASS_COUNT {
            assert_eq!(EventKind::of_class(class).class(), class);
        }
        let first = EventKind::of_class(0);
        let place = BurstPlace { rank: 0, length: BurstLength::FiveOrMore };
        assert_eq!(first, EventKind { polarity: Polarity::Off, place });
    }

    #[test]
    fn classes_of_shorter_bursts_share_all_biases_but_offset_and_latency() {
        let mut owners = [0; BIAS_COUNT];
        for class in 0..CLASS_COUNT {
            let kind = EventKind::of_class(class);
            let long = BurstPlace { length: BurstLength::FiveOrMore, ..kind.place };
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
    fn derivatives_are_those_of_the_distance() {
        let passage = EdgePassage { normal_speed: 300.0, narrowness: 0.1, corner_share: 0.6, memory: -2000.0 };
        let [known, ..] = unknown(1.0);
        for bias in Bias::ALL.into_iter().filter(|&bias| bias != Bias::Latency) {
            let mut moved = known;
            moved.biases[bias] = 2.0;
            let slope = (moved.distance(&passage) - known.distance(&passage)) / 2.0;
            assert!((slope - passage.derivatives()[bias]).abs() <= 1e-12 * slope.abs(), "{bias:?}: {slope}");
        }
    }
}

//! The biases of an event class and their one order.

use std::ops::{Index, IndexMut};

use serde::{Deserialize, Serialize};

/// What shifts the events of a class from the edge. The order is that of the joint solve's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bias {
    /// Mean signed distance from the geometric edge, positive outside the dot (px).
    Offset,
    /// Delay between the edge's passage and the event, relative to that of all first OFF events
    /// together (s): a delay common to all classes cannot be told from a shift of the clock.
    Latency,
    /// What the square of the normal speed in px/s adds to the distance, relative to the first OFF event of a burst (s²/px): at
    /// high speed the pixel's low-pass no longer delays by a constant time.
    Bend,
    /// What one over the dot's radius in pixels, or the width of the dark strip, adds to the distance (px²).
    Curvature,
    /// What the latency grows by from the middle of the sensor to its corners, with the square of the
    /// distance (s).
    CornerLatency,
    /// What one over the dot's radius in pixels adds to the latency (s px).
    CurvatureLatency,
    /// What the acceleration of a rim in px/s² adds to the distance (s²): a slow pixel remembers where the edge was before. At a straight
    /// edge, what one over the width of its light strip in pixels adds (px²).
    Memory,
}

impl Bias {
    /// Number of biases of a class.
    pub const COUNT: usize = Self::ALL.len();

    /// All biases, in their order.
    pub const ALL: [Self; 7] = [
        Self::Offset,
        Self::Latency,
        Self::Bend,
        Self::Curvature,
        Self::CornerLatency,
        Self::CurvatureLatency,
        Self::Memory,
    ];

    /// Place in the order.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Name in result files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Offset => "offset",
            Self::Latency => "latency",
            Self::Bend => "bend",
            Self::Curvature => "curvature",
            Self::CornerLatency => "corner_latency",
            Self::CurvatureLatency => "curvature_latency",
            Self::Memory => "memory",
        }
    }

    /// Whether it acts on moving edges only.
    pub const fn needs_motion(self) -> bool {
        !matches!(self, Self::Offset | Self::Curvature)
    }
}

/// One value for each bias.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Biases<T>([T; Bias::COUNT]);

impl<T> Biases<T> {
    /// The value that `of` gives for each bias.
    pub fn from_fn(mut of: impl FnMut(Bias) -> T) -> Self {
        Self(Bias::ALL.map(&mut of))
    }

    /// These values, in the order of [`Bias::ALL`].
    #[inline(always)]
    pub fn from_array(values: [T; Bias::COUNT]) -> Self {
        Self(values)
    }

    /// All values, in the order of [`Bias::ALL`].
    #[inline(always)]
    pub fn as_array(&self) -> &[T; Bias::COUNT] {
        &self.0
    }
}

impl<T> Index<Bias> for Biases<T> {
    type Output = T;

    #[inline(always)]
    fn index(&self, bias: Bias) -> &T {
        &self.0[bias.index()]
    }
}

impl<T> IndexMut<Bias> for Biases<T> {
    #[inline(always)]
    fn index_mut(&mut self, bias: Bias) -> &mut T {
        &mut self.0[bias.index()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bias_stands_in_its_place_under_a_name_of_its_own() {
        let names = Biases::from_fn(Bias::name);
        for (place, bias) in Bias::ALL.into_iter().enumerate() {
            assert_eq!(bias.index(), place);
            assert_eq!(names[bias], names.as_array()[place]);
            assert_eq!(Bias::ALL.iter().filter(|other| other.name() == bias.name()).count(), 1);
        }
    }
}

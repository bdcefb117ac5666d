//! The biases of an event class and their order.

use std::ops::{Index, IndexMut};

use serde::{Deserialize, Serialize};

/// Causes of the distance of a class's events from the edge, in the order of the joint solve's parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bias {
    /// Mean signed distance from the geometric edge, positive outside the dot (px).
    Offset,
    /// Delay between the edge's passage and the event (s), relative to the mean delay of all first OFF events: a delay common to
    /// all classes cannot be distinguished from a shift of the clock.
    Latency,
    /// Coefficient of the squared normal speed (px/s) in the distance, relative to the first OFF event of a burst (s²/px). At
    /// high speed the pixel's low-pass no longer delays by a constant time.
    Bend,
    /// Coefficient of one over the dot's radius in pixels, or over the width of the dark strip, in the distance (px²).
    Curvature,
    /// Increase of the latency from the middle of the sensor to its corners, in proportion to the square of the distance (s).
    CornerLatency,
    /// Coefficient of one over the dot's radius in pixels in the latency (s px).
    CurvatureLatency,
    /// Coefficient of the acceleration of the edge (px/s²) in the distance (s²): a slow pixel still responds to earlier positions
    /// of the edge.
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

    /// Returns the index in [`Bias::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Returns the name in result files.
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

    /// Returns `true` if the bias has an effect on moving edges only.
    pub const fn needs_motion(self) -> bool {
        !matches!(self, Self::Offset | Self::Curvature)
    }
}

/// One value for each bias.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Biases<T>([T; Bias::COUNT]);

impl<T> Biases<T> {
    /// Builds the values from a function of the bias.
    pub fn from_fn(mut of: impl FnMut(Bias) -> T) -> Self {
        Self(Bias::ALL.map(&mut of))
    }

    /// Builds the values from an array in the order of [`Bias::ALL`].
    #[inline(always)]
    pub fn from_array(values: [T; Bias::COUNT]) -> Self {
        Self(values)
    }

    /// Returns all values, in the order of [`Bias::ALL`].
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
    fn every_bias_has_its_index_and_a_unique_name() {
        let names = Biases::from_fn(Bias::name);
        for (place, bias) in Bias::ALL.into_iter().enumerate() {
            assert_eq!(bias.index(), place);
            assert_eq!(names[bias], names.as_array()[place]);
            assert_eq!(Bias::ALL.iter().filter(|other| other.name() == bias.name()).count(), 1);
        }
    }
}

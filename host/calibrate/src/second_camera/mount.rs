//! Relative pose of two cameras on one mount, and the relation of their clocks.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// First of the three rotation parameters of `T_second_first`, perturbed on the right: about the axes of the first camera (rad).
pub const ROTATION: usize = 0;
/// First of the three translation parameters: along the axes of the second camera (m).
pub const TRANSLATION: usize = 3;
/// Offset of the clocks (s).
pub const OFFSET: usize = 6;
/// Relative rate by which the second clock is faster.
pub const RATE: usize = 7;
/// Number of parameters that every mount has.
pub const COUNT: usize = 8;
/// Time from one row of a frame to the next (s), for frame cameras.
pub const LINE_DELAY: usize = 8;
/// Largest number of parameters.
pub const MOST: usize = 9;

/// Prior σ of the relative rate of two clocks.
pub const RATE_SIGMA: f64 = 1e-4;

/// Relative pose and clocks of two cameras.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// `T_second_first`.
    pub second_first: Isometry3<f64>,
    /// t_second = t_first + offset + rate (t_second − middle).
    pub offset: f64,
    /// Relative rate by which the second clock is faster.
    pub rate: f64,
    /// Time of the second clock at which the offset applies (s).
    pub middle: f64,
    /// Delay of the exposure of each row after the one above it (s); `None` for events, which have their own times.
    pub line_delay: Option<f64>,
}

impl Mount {
    /// Returns the time of the first clock at `t` of the second.
    pub fn first_time(&self, t: f64) -> f64 {
        t - self.offset - self.rate * (t - self.middle)
    }

    /// Returns the number of parameters.
    pub fn count(&self) -> usize {
        if self.line_delay.is_some() { MOST } else { COUNT }
    }

    /// Returns the exposure time of the row that is `rows` below the middle of a frame of time `t`, on the second clock.
    pub fn row_time(&self, t: f64, rows: f64) -> f64 {
        t + self.line_delay.unwrap_or(0.0) * rows
    }

    /// Returns the mount after a step of the parameters; missing parameters do not change.
    pub fn moved(&self, step: &[f64]) -> Self {
        let at = |index: usize| step.get(index).copied().unwrap_or(0.0);
        let three = |first: usize| Vector3::from_fn(|axis, _| at(first + axis));
        let Isometry3 { rotation, translation } = self.second_first;
        let mut rotation = rotation * UnitQuaternion::from_scaled_axis(three(ROTATION));
        rotation.renormalize();
        Self {
            second_first: Isometry3::from_parts(Translation3::from(translation.vector + three(TRANSLATION)), rotation),
            offset: self.offset + at(OFFSET),
            rate: self.rate + at(RATE),
            line_delay: self.line_delay.map(|delay| delay + at(LINE_DELAY)),
            ..*self
        }
    }
}

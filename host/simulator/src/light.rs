//! Lamps: their flicker, and their reflection in a glossy print.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// Light that oscillates about its mean, like a lamp on mains.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lamp {
    /// Frequency in hertz: twice the mains frequency.
    pub frequency: f64,
    /// Amplitude as a fraction of the mean, from 0 to below 1 (percent flicker).
    pub depth: f64,
}

impl Lamp {
    /// Returns the light at time `t` (µs), 1 on average.
    pub fn light(&self, t: f64) -> f64 {
        1.0 + self.depth * libm::sin(std::f64::consts::TAU * 1e-6 * self.frequency * t)
    }
}

/// The reflection of a lamp on the sheet: a bright spot that moves with the camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Glare {
    /// Radiance at the centre of the spot, added to the print.
    pub strength: f64,
    /// Standard deviation of the spot on the sheet, in metres.
    pub spread: f64,
    /// Position of the lamp relative to the board's middle, in metres: along x, along y, and towards the camera.
    pub lamp: [f64; 3],
}

impl Default for Glare {
    fn default() -> Self {
        Self { strength: 2.0, spread: 0.05, lamp: [0.1, -0.3, 1.5] }
    }
}

impl Glare {
    /// Distance from the centre of the spot, in standard deviations, beyond which it is dark.
    const REACH: f64 = 5.0;

    /// Returns the radiance added at `point` of the board, whose middle is `middle`, for a camera at `position`.
    pub(super) fn radiance(&self, position: &Vector3<f64>, middle: &Vector2<f64>, point: &Vector2<f64>) -> f64 {
        let [x, y, height] = self.lamp;
        let lamp = middle + Vector2::new(x, y);
        // The camera, at z < 0, sees the lamp as far behind the board as it is in front of it.
        let share = -position.z / (height - position.z);
        let spot = position.xy() + (lamp - position.xy()) * share;
        let square = (point - spot).norm_squared() / (self.spread * self.spread);
        if square > Self::REACH * Self::REACH { 0.0 } else { self.strength * libm::exp(-0.5 * square) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The angle of incidence equals the angle of reflection.
    #[test]
    fn the_spot_obeys_the_law_of_reflection() {
        let glare = Glare { strength: 1.0, spread: 0.01, lamp: [0.3, 0.0, 1.5] };
        let (camera, middle) = (Vector3::new(-0.2, 0.1, -0.5), Vector2::new(0.2, 0.1));
        // The spot is on the line from the camera at x = -0.2 to the lamp at x = 0.5, a quarter of the way, because the
        // camera is 0.5 m and the lamp 1.5 m above the board.
        let spot = Vector2::new(-0.2 + 0.7 * 0.25, 0.1);
        assert!((glare.radiance(&camera, &middle, &spot) - 1.0).abs() < 1e-12);
        assert!(glare.radiance(&camera, &middle, &(spot + Vector2::new(0.01, 0.0))) < 0.61);
        assert_eq!(glare.radiance(&camera, &middle, &(spot + Vector2::new(0.1, 0.0))), 0.0);
    }

    #[test]
    fn flicker_keeps_the_mean() {
        let lamp = Lamp { frequency: 120.0, depth: 0.3 };
        let period = 1e6 / 120.0;
        let lights: Vec<f64> = (0..1000).map(|step| lamp.light(period * f64::from(step) / 1000.0)).collect();
        assert!((lights.iter().sum::<f64>() / 1000.0 - 1.0).abs() < 1e-9);
        let (low, high) = lights.iter().fold((2.0_f64, 0.0_f64), |(low, high), &l| (low.min(l), high.max(l)));
        assert!(((high - low) / (high + low) - 0.3).abs() < 1e-5);
    }
}

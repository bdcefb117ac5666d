//! Dirt on the lens: smudges, far out of focus, that scatter light.

use serde::{Deserialize, Serialize};

/// Smudges on the lens. Behind a smudge, a fraction of the light is averaged over the whole surroundings, so that dots
/// lose contrast.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Smudges {
    /// Number of smudges.
    pub count: u32,
    /// Standard deviation of a smudge, as a fraction of the sensor's width.
    pub spread: f64,
    /// Fraction of the light that is scattered in the middle of a smudge.
    pub scatter: f64,
}

impl Default for Smudges {
    fn default() -> Self {
        Self { count: 5, spread: 0.06, scatter: 0.6 }
    }
}

/// Mean radiance of the surroundings.
const MEAN_RADIANCE: f64 = 0.5;
/// Steps of the two-dimensional golden ratio, which spread positions evenly over the sensor.
const STEPS: [f64; 2] = [0.754_877_666, 0.569_840_291];

impl Smudges {
    /// Returns the fraction of light that is scattered at (x, y), both from 0 to 1 along the sensor's width and height;
    /// `aspect` is its height divided by its width.
    pub fn share(&self, x: f64, y: f64, aspect: f64) -> f64 {
        let smudge = |number: u32| {
            let place = STEPS.map(|step| (0.3 + step * f64::from(number)).fract());
            let (dx, dy) = (x - place[0], (y - place[1]) * aspect);
            libm::exp(-0.5 * (dx * dx + dy * dy) / (self.spread * self.spread))
        };
        self.scatter * (0..self.count).map(smudge).fold(0.0, f64::max)
    }
}

/// Returns the radiance that remains if this `share` is scattered.
#[inline]
pub(super) fn scattered(radiance: f64, share: f64) -> f64 {
    radiance + share * (MEAN_RADIANCE - radiance)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smudges_reduce_the_contrast_locally() {
        let smudges = Smudges::default();
        let shares: Vec<f64> = (0..10_000)
            .map(|step| smudges.share(f64::from(step % 100) / 100.0, f64::from(step / 100) / 100.0, 0.75))
            .collect();
        let touched = shares.iter().filter(|&&share| share > 0.3).count();
        assert!((500..4000).contains(&touched), "{touched}");
        assert!(shares.iter().all(|share| (0.0..=0.6).contains(share)));
        let contrast = scattered(1.0, 0.6) - scattered(0.0, 0.6);
        assert!((contrast - 0.4).abs() < 1e-12);
        assert_eq!(scattered(0.37, 0.0), 0.37);
    }
}

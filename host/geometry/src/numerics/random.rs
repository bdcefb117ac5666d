//! Random numbers of the distributions that the simulator needs, the same on every machine.

use rand::Rng;

/// Returns a uniformly distributed number in [0, 1).
pub fn uniform(rng: &mut impl Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
}

/// Returns a uniformly distributed number in [low, high).
pub fn uniform_in(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    low + (high - low) * uniform(rng)
}

/// Returns an exponentially distributed number with mean 1.
pub fn exponential(rng: &mut impl Rng) -> f64 {
    -libm::log(1.0 - uniform(rng))
}

/// Returns a number with a standard normal distribution (Box and Muller 1958).
pub fn normal(rng: &mut impl Rng) -> f64 {
    let radius = (2.0 * exponential(rng)).sqrt();
    radius * libm::cos(std::f64::consts::TAU * uniform(rng))
}

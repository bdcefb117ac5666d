//! Intensity profile of a blurred edge.

/// The profile of a straight edge under a Gaussian point-spread function: the normal distribution function, from a
/// table with linear interpolation. The error is less than 1e-6.
#[derive(Clone, Debug)]
pub(super) struct EdgeProfile {
    table: Vec<f64>,
}

impl EdgeProfile {
    /// Distance in standard deviations beyond which an edge is invisible (3e-5 of the contrast).
    pub(super) const REACH: f64 = 4.0;
    const STEPS_PER_SIGMA: f64 = 512.0;

    /// Computes the table.
    pub(super) fn new() -> Self {
        let steps = (2.0 * Self::REACH * Self::STEPS_PER_SIGMA) as usize;
        let value = |step: usize| {
            let z = step as f64 / Self::STEPS_PER_SIGMA - Self::REACH;
            0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2)
        };
        Self { table: (0..=steps).map(value).collect() }
    }

    /// Returns the fraction of light from beyond the edge, at `z` standard deviations from it.
    #[inline]
    pub(super) fn share(&self, z: f64) -> f64 {
        let position = (z + Self::REACH) * Self::STEPS_PER_SIGMA;
        if position <= 0.0 {
            return 0.0;
        }
        let step = position as usize;
        match self.table.get(step..step + 2) {
            Some(&[low, high]) => low + (high - low) * (position - step as f64),
            _ => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_edge_profile_is_the_normal_distribution() {
        let profile = EdgeProfile::new();
        for step in -600..600 {
            let z = f64::from(step) * 0.00713;
            let exact = 0.5 * libm::erfc(-z / std::f64::consts::SQRT_2);
            assert!((profile.share(z) - exact).abs() < if z.abs() < 4.0 { 1e-6 } else { 4e-5 }, "{z}");
        }
    }
}

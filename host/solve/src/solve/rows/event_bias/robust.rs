//! Robust offsets and spreads of the event classes from residuals: start values and weights of the solve.

use rayon::prelude::*;

use super::bias::Bias;
use super::{CLASS_COUNT, EventBias, SPEED_RANGE_COUNT};
use evcal_geometry::numerics::statistics::{SIGMA_BY_MEDIAN, median};

/// The residual of one event (px).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClassResidual {
    /// Event class.
    pub class: u8,
    /// Range of the edge's normal speed.
    pub speed_range: u8,
    /// Distance from the position that the model predicts for the event.
    pub residual: f32,
}

/// A class with fewer events keeps its values.
const FEWEST: usize = 100;

/// Smallest number of residuals that a thread processes at once.
const MIN_LENGTH: usize = 65_536;

/// Smallest spread of a class (px): pixels are discrete.
const SMALLEST_SIGMA: f64 = 0.05;

/// Adds the median residual of each class to its offset, and subtracts it from the residuals.
pub fn shift_offsets(bias: &mut EventBias, residuals: &mut [ClassResidual]) {
    let mut of_class: Vec<Vec<f32>> = vec![Vec::new(); CLASS_COUNT];
    for event in residuals.iter() {
        if let Some(values) = of_class.get_mut(usize::from(event.class)) {
            values.push(event.residual);
        }
    }
    let mut medians = [0.0_f32; CLASS_COUNT];
    medians.par_iter_mut().zip(&mut of_class).for_each(|(shift, values)| {
        if values.len() >= FEWEST {
            *shift = median(values, f32::total_cmp).unwrap_or(0.0);
        }
    });
    for (bias, shift) in bias.iter_mut().zip(medians) {
        bias.biases[Bias::Offset] += f64::from(shift);
    }
    residuals.par_iter_mut().with_min_len(MIN_LENGTH).for_each(|event| {
        event.residual -= medians.get(usize::from(event.class)).copied().unwrap_or(0.0);
    });
}

/// Sets the spread of each class in each range of speed to the scaled median of the absolute residuals. Ranges with too few
/// events take the spread of their class.
pub fn class_spreads(bias: &mut EventBias, residuals: &[ClassResidual]) {
    let mut sizes: Vec<[Vec<f32>; SPEED_RANGE_COUNT]> = vec![Default::default(); CLASS_COUNT];
    for event in residuals {
        let class = sizes.get_mut(usize::from(event.class));
        if let Some(values) = class.and_then(|class| class.get_mut(usize::from(event.speed_range))) {
            values.push(event.residual.abs());
        }
    }
    bias.par_iter_mut().zip(&mut sizes).for_each(|(bias, ranges)| {
        let Some(of_class) = spread(&mut ranges.concat()) else { return };
        bias.sigma = std::array::from_fn(|range| spread(&mut ranges[range]).unwrap_or(of_class));
    });
}

/// Sets one spread for all classes, for use without offsets, when the classes are not distinguished.
pub fn common_spread(bias: &mut EventBias, residuals: &[ClassResidual]) {
    let mut sizes: Vec<f32> = residuals.iter().map(|event| event.residual.abs()).collect();
    if let Some(sigma) = spread(&mut sizes) {
        bias.iter_mut().for_each(|bias| bias.sigma = [sigma; SPEED_RANGE_COUNT]);
    }
}

/// Returns the standard deviation of a normal distribution from the absolute residuals; `None` for too few.
fn spread(sizes: &mut [f32]) -> Option<f64> {
    (sizes.len() >= FEWEST)
        .then(|| (SIGMA_BY_MEDIAN * f64::from(median(sizes, f32::total_cmp).unwrap_or(0.0))).max(SMALLEST_SIGMA))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::rows::event_bias::unknown;

    #[test]
    fn offsets_are_medians_and_spreads_their_deviations() {
        let event = |class, speed_range, residual| ClassResidual { class, speed_range, residual };
        let mut residuals: Vec<ClassResidual> =
            (-500..=500).map(|i| event(2, u8::from(i % 2 == 0), 0.25 + i as f32 / 1000.0)).collect();
        let mut bias = unknown(1.0);
        shift_offsets(&mut bias, &mut residuals);
        class_spreads(&mut bias, &residuals);
        assert!((bias[2].biases[Bias::Offset] - 0.25).abs() < 1e-6);
        for range in 0..SPEED_RANGE_COUNT {
            assert!((bias[2].sigma[range] - SIGMA_BY_MEDIAN * 0.25).abs() < 2e-3);
        }
        assert_eq!(bias[0], unknown(1.0)[0]);
        common_spread(&mut bias, &residuals);
        assert!((bias[7].sigma[4] - SIGMA_BY_MEDIAN * 0.25).abs() < 2e-3);
    }
}

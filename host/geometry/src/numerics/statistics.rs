//! Statistics of a set of errors.

use std::cmp::Ordering;
use std::fmt;

/// Ratio of the standard deviation of a normal distribution to the median of its absolute values.
pub const SIGMA_BY_MEDIAN: f64 = 1.4826;

/// Returns the number of decimals at which a standard deviation has two digits; 3 if it is 0.
pub fn decimals(sigma: f64) -> usize {
    if sigma > 0.0 { (1.0 - sigma.log10().floor()).clamp(0.0, 9.0) as usize } else { 3 }
}

/// Statistics of a set of non-negative errors, all in the unit of the errors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Statistics {
    /// Number of errors.
    pub count: usize,
    /// Root of the mean square.
    pub rmse: f64,
    /// Mean.
    pub mean: f64,
    /// Median; the mean of the middle two for an even count.
    pub median: f64,
    /// Standard deviation (dividing by the count).
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
}

impl Statistics {
    /// Returns the statistics of `errors`; `None` if there are no errors.
    pub fn new(mut errors: Vec<f64>) -> Option<Self> {
        errors.sort_by(f64::total_cmp);
        let (min, max) = (*errors.first()?, *errors.last()?);
        let count = errors.len();
        let mean = errors.iter().sum::<f64>() / count as f64;
        let square = errors.iter().map(|error| error * error).sum::<f64>() / count as f64;
        let variance = errors.iter().map(|error| (error - mean) * (error - mean)).sum::<f64>() / count as f64;
        let middle = errors.get((count - 1) / 2..=count / 2)?;
        let median = middle.iter().sum::<f64>() / middle.len() as f64;
        Some(Self { count, rmse: square.sqrt(), mean, median, std: variance.sqrt(), min, max })
    }

    /// Converts the statistics to a unit `factor` times as small.
    pub fn scaled(&self, factor: f64) -> Self {
        let [rmse, mean, median, std, min, max] =
            [self.rmse, self.mean, self.median, self.std, self.min, self.max].map(|value| value * factor);
        Self { count: self.count, rmse, mean, median, std, min, max }
    }
}

impl fmt::Display for Statistics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "rmse {:.4}  mean {:.4}  median {:.4}  std {:.4}  max {:.4}",
            self.rmse, self.mean, self.median, self.std, self.max
        )
    }
}

/// Returns the middle one of `values` in `order`, for an even number the upper one; `None` if there are no values.
/// Changes their order.
pub fn median<T: Copy>(values: &mut [T], order: impl FnMut(&T, &T) -> Ordering) -> Option<T> {
    let middle = values.len() / 2;
    if values.is_empty() {
        return None;
    }
    Some(*values.select_nth_unstable_by(middle, order).1)
}

/// Returns the value below which a `share` (0 to 1) of the `sorted` values lie, to the nearest rank; `None` if there
/// are no values.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let index = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(index).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statistics_of_a_small_set_are_correct() {
        let figures = Statistics::new(vec![4.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!((figures.count, figures.mean, figures.median, figures.min, figures.max), (4, 2.5, 2.5, 1.0, 4.0));
        assert!((figures.rmse - 7.5f64.sqrt()).abs() < 1e-15);
        assert!((figures.std - 1.25f64.sqrt()).abs() < 1e-15);
        assert_eq!(Statistics::new(vec![5.0, 1.0, 2.0]).unwrap().median, 2.0);
        assert_eq!(Statistics::new(Vec::new()), None);
    }
}

//! Estimates the time lag between two series from their normalised correlation over all shifts, with a test for
//! uniqueness.

/// Criteria for a clear result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Smallest number of pairs.
    pub fewest_pairs: f64,
    /// Smallest acceptable correlation.
    pub correlation: f64,
    /// Upper bound of any other peak, as a fraction of the best.
    pub second_peak: f64,
    /// Smallest distance of another peak, in steps.
    pub peak_distance: usize,
}

/// Lag between two series of the same quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lag {
    /// Number of steps by which the second series is later: its value at `i + steps` corresponds to the first series at
    /// `i`.
    pub steps: f64,
    /// Correlation at this lag.
    pub correlation: f64,
}

/// Reason why the lag is not determined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NoLag {
    /// The series do not correlate.
    Unlike {
        /// The largest correlation.
        correlation: f64,
    },
    /// Two shifts fit almost equally well.
    Ambiguous {
        /// The better one, in steps.
        first: f64,
        /// The other one, in steps.
        second: f64,
    },
    /// The first series is nearly constant, so no shift can be determined.
    Steady {
        /// Its mean.
        mean: f64,
    },
}

/// Ratio of standard deviation to mean below which a series is nearly constant.
const STEADY: f64 = 0.2;

/// Sums over the pairs of one shift.
#[derive(Default)]
struct Pairs {
    count: f64,
    x: f64,
    y: f64,
    xx: f64,
    yy: f64,
    xy: f64,
}

impl Pairs {
    fn add(&mut self, x: f64, y: f64) {
        self.count += 1.0;
        self.x += x;
        self.y += y;
        self.xx += x * x;
        self.yy += y * y;
        self.xy += x * y;
    }

    fn correlation(&self, needed: f64) -> Option<f64> {
        let variance = |sum: f64, squares: f64| squares - sum * sum / self.count;
        let (of_x, of_y) = (variance(self.x, self.xx), variance(self.y, self.yy));
        (self.count >= needed && of_x > 0.0 && of_y > 0.0)
            .then(|| (self.xy - self.x * self.y / self.count) / (of_x * of_y).sqrt())
    }
}

/// Returns the lag of `second` relative to `first`; both have one value per step, if it is known.
///
/// # Errors
/// [`NoLag`] if no shift is clearly the best.
pub fn lag(first: &[Option<f64>], second: &[Option<f64>], rules: &Rules) -> Result<Lag, NoLag> {
    best(first, second, rules).map_err(|error| steady(first).map_or(error, |mean| NoLag::Steady { mean }))
}

/// Returns the mean of a nearly constant series; `None` for other series.
fn steady(series: &[Option<f64>]) -> Option<f64> {
    let count = series.iter().flatten().count().max(1) as f64;
    let mean = series.iter().flatten().sum::<f64>() / count;
    let variance = series.iter().flatten().map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    (variance.sqrt() < STEADY * mean).then_some(mean)
}

fn best(first: &[Option<f64>], second: &[Option<f64>], rules: &Rules) -> Result<Lag, NoLag> {
    let peaks = peaks(first, second, rules, 2)?;
    match *peaks.as_slice() {
        [first, second, ..] => Err(NoLag::Ambiguous { first: first.steps.round(), second: second.steps.round() }),
        [one] => Ok(one),
        [] => Err(NoLag::Unlike { correlation: 0.0 }),
    }
}

/// Returns all plausible lags, at most `most`, the best first; other knowledge must decide between them.
///
/// # Errors
/// [`NoLag::Unlike`] if no shift fits. [`NoLag::Steady`] if the first series is nearly constant and not exactly one
/// shift fits.
pub fn lags(first: &[Option<f64>], second: &[Option<f64>], rules: &Rules, most: usize) -> Result<Vec<Lag>, NoLag> {
    let found = peaks(first, second, rules, most);
    match (&found, steady(first)) {
        (Ok(found), Some(_)) if found.len() == 1 => {}
        (_, Some(mean)) => return Err(NoLag::Steady { mean }),
        (_, None) => {}
    }
    found
}

fn peaks(first: &[Option<f64>], second: &[Option<f64>], rules: &Rules, most: usize) -> Result<Vec<Lag>, NoLag> {
    let (from, to) = (-(first.len() as i64), second.len() as i64);
    let correlations: Vec<f64> = (from..=to)
        .map(|shift| {
            let mut pairs = Pairs::default();
            let (skip_first, skip_second) = ((-shift).max(0) as usize, shift.max(0) as usize);
            for (x, y) in first.iter().skip(skip_first).zip(second.iter().skip(skip_second)) {
                if let (Some(x), Some(y)) = (x, y) {
                    pairs.add(*x, *y);
                }
            }
            pairs.correlation(rules.fewest_pairs).unwrap_or(-1.0)
        })
        .collect();
    let best = largest(&correlations, |_| true);
    let Some((best, correlation)) = best.filter(|(_, correlation)| *correlation > rules.correlation) else {
        return Err(NoLag::Unlike { correlation: best.map_or(0.0, |(_, value)| value.max(0.0)) });
    };
    let at = |index: usize| correlations.get(index).copied().unwrap_or(-1.0);
    let mut found = vec![best];
    while found.len() < most {
        let is_peak = |index: usize| {
            found.iter().all(|other| index.abs_diff(*other) > rules.peak_distance)
                && index > 0
                && at(index) >= at(index - 1)
                && at(index) >= at(index + 1)
        };
        match largest(&correlations, is_peak) {
            Some((next, value)) if value > rules.second_peak * correlation => found.push(next),
            _ => break,
        }
    }
    // Maximum of the parabola through the three values.
    let top = |index: usize| {
        let (before, middle, after) = (at(index.saturating_sub(1)), at(index), at(index + 1));
        let bend = before - 2.0 * middle + after;
        let fraction = if bend < 0.0 { (0.5 * (before - after) / bend).clamp(-0.5, 0.5) } else { 0.0 };
        Lag { steps: from as f64 + (index as f64 + fraction), correlation: middle }
    };
    Ok(found.into_iter().map(top).collect())
}

fn largest(values: &[f64], wanted: impl Fn(usize) -> bool) -> Option<(usize, f64)> {
    let wanted = values.iter().copied().enumerate().filter(|(index, _)| wanted(*index));
    wanted.max_by(|a, b| a.1.total_cmp(&b.1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULES: Rules = Rules { fewest_pairs: 200.0, correlation: 0.9, second_peak: 0.9, peak_distance: 20 };

    fn series(value: impl Fn(f64) -> f64, start: f64, count: usize) -> Vec<Option<f64>> {
        (0..count).map(|index| (index % 50 > 2).then(|| value(start + index as f64))).collect()
    }

    fn wavy(t: f64) -> f64 {
        (0.031 * t).sin() + 0.7 * (0.0473 * t + 1.0).sin() + 0.5 * (0.0771 * t).cos() + (0.000_1 * t * t).sin()
    }

    #[test]
    fn a_shift_is_found_between_steps() {
        for later in [-312.3, 0.0, 87.7] {
            let found = lag(&series(wavy, 0.0, 1000), &series(wavy, -later, 1200), &RULES).unwrap();
            assert!((found.steps - later).abs() < 0.05 && found.correlation > 0.99, "{found:?}");
        }
    }

    #[test]
    fn unrelated_and_periodic_series_have_no_lag() {
        let other = |t: f64| (0.11 * t).sin() + (0.002 * t * t).cos();
        let found = lag(&series(wavy, 0.0, 1000), &series(other, 0.0, 1000), &RULES);
        assert!(matches!(found, Err(NoLag::Unlike { correlation }) if correlation < 0.9), "{found:?}");
        let periodic = |t: f64| (0.05 * t).sin();
        let found = lag(&series(periodic, 0.0, 1000), &series(periodic, 0.0, 1000), &RULES);
        let Err(NoLag::Ambiguous { first, second }) = found else { panic!("{found:?}") };
        let periods = (first - second) * 0.05 / std::f64::consts::TAU;
        assert!((periods - periods.round()).abs() < 0.02 && periods.round() != 0.0, "{periods}");
    }

    #[test]
    fn a_constant_series_is_reported() {
        let steady = |seed: f64| series(move |t| 3.0 + 0.1 * (seed * t * t).sin(), 0.0, 1000);
        let found = lag(&steady(0.017), &steady(0.041), &RULES);
        assert!(matches!(found, Err(NoLag::Steady { mean }) if (mean - 3.0).abs() < 0.05), "{found:?}");
        // Small changes of a nearly constant series are sufficient if both series have them.
        let changes = |later: f64| series(|t| 30.0 + wavy(t), later, 1000);
        let found = lag(&changes(0.0), &changes(40.0), &RULES).unwrap();
        assert!((found.steps + 40.0).abs() < 0.05, "{found:?}");
    }
}

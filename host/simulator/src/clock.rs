//! Motion time, which stops during pauses.

use serde::{Deserialize, Serialize};

/// A time interval in seconds since the start of the recording.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interval {
    /// Start.
    pub start: f64,
    /// End, after the start.
    pub end: f64,
}

/// Intervals with level 1, with smooth ramps of fixed length before and after.
#[derive(Clone, Debug, PartialEq)]
pub struct Ramps {
    spans: Vec<Interval>,
    ramp: f64,
}

impl Ramps {
    /// Creates ramps around `spans`, which may have any order; intervals whose ramps would overlap are joined.
    pub fn new(spans: &[Interval], ramp: f64) -> Self {
        let mut sorted = spans.to_vec();
        sorted.sort_by(|a, b| a.start.total_cmp(&b.start));
        let mut joined: Vec<Interval> = Vec::new();
        for span in sorted {
            match joined.last_mut() {
                Some(last) if span.start - last.end < 2.0 * ramp => last.end = last.end.max(span.end),
                _ => joined.push(span),
            }
        }
        Self { spans: joined, ramp }
    }

    /// Returns the level: 0 outside, 1 inside, twice continuously differentiable in between.
    pub fn level(&self, t: f64) -> f64 {
        self.spans.iter().map(|span| self.rise(t, span.start) * self.rise(-t, -span.end)).sum()
    }

    /// Returns the integral of the level from minus infinity to `t`, in seconds.
    pub fn integral(&self, t: f64) -> f64 {
        self.spans.iter().map(|span| self.risen(t - span.start) - self.risen(t - span.end - self.ramp)).sum()
    }

    fn rise(&self, t: f64, start: f64) -> f64 {
        let u = ((t - start) / self.ramp + 1.0).clamp(0.0, 1.0);
        u * u * u * (10.0 + u * (6.0 * u - 15.0))
    }

    /// Returns the integral of a single rise that is complete at 0.
    fn risen(&self, t: f64) -> f64 {
        let u = (t / self.ramp + 1.0).clamp(0.0, 1.0);
        let ramp_part = self.ramp * u * u * u * u * (2.5 + u * (u - 3.0));
        ramp_part + t.max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_is_the_derivative_of_its_integral() {
        let ramps = Ramps::new(&[Interval { start: 3.0, end: 3.5 }, Interval { start: 1.0, end: 1.4 }], 0.2);
        for step in 0..500 {
            let t = f64::from(step) * 0.01;
            let derivative = (ramps.integral(t + 1e-5) - ramps.integral(t - 1e-5)) / 2e-5;
            assert!((derivative - ramps.level(t)).abs() < 1e-6, "at {t}: {derivative} and {}", ramps.level(t));
        }
        assert_eq!(ramps.level(1.2), 1.0);
        assert_eq!(ramps.level(2.0), 0.0);
    }

    #[test]
    fn spans_with_overlapping_ramps_are_merged() {
        let ramps = Ramps::new(&[Interval { start: 1.0, end: 1.4 }, Interval { start: 1.5, end: 1.6 }], 0.2);
        assert_eq!(ramps.level(1.45), 1.0);
        assert_eq!(ramps.spans.len(), 1);
    }
}

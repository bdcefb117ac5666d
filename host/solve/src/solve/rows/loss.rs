//! The robust loss of many observations.

/// Largest factor by which a step is lengthened; with more outliers than this, the weights are not reliable.
const MOST_LENGTHENED: f64 = 1.25;

/// Sums over observations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Loss {
    /// Number of observations.
    pub count: usize,
    /// Sum of ρ.
    pub cost: f64,
    /// Sum of the weights ρ'(r) / r.
    weight: f64,
    /// Number of observations in the quadratic part of the loss.
    squared: usize,
}

impl Loss {
    /// Adds an observation with this cost and weight.
    #[inline(always)]
    pub fn add_observation(&mut self, cost: f64, weight: f64) {
        self.count += 1;
        self.cost += cost;
        self.weight += weight;
        self.squared += usize::from(weight == 1.0);
    }

    /// Adds the sums of other observations.
    pub fn add(&mut self, other: &Self) {
        self.count += other.count;
        self.cost += other.cost;
        self.weight += other.weight;
        self.squared += other.squared;
    }

    /// Adds an observation of another kind with this cost, which does not count in [`Loss::lengthening`].
    pub fn add_cost(&mut self, cost: f64) {
        self.count += 1;
        self.cost += cost;
    }

    /// Returns the loss of the same observations with another weight among observations of other kinds, without
    /// [`Loss::lengthening`]: a step of all parameters cannot have the length of one kind.
    pub fn weighted(self, weight: f64) -> Self {
        Self { count: self.count, cost: weight * self.cost, weight: 0.0, squared: 0 }
    }

    /// Returns the second derivative of the loss as a share of what the weights imply, between 0 and 1: beyond Huber's bound, an
    /// observation has a weight, but its slope does not change.
    pub fn curvature(&self) -> f64 {
        if self.squared > 0 { (self.squared as f64 / self.weight).min(1.0) } else { 1.0 }
    }

    /// Returns the ratio of a Newton step to a Gauss-Newton step. An observation beyond Huber's bound has a weight but its slope
    /// does not change, so the weights imply a curvature that the loss does not have. The ratio is some 1.1; without it, the
    /// first step is a tenth too short.
    pub fn lengthening(&self) -> f64 {
        self.curvature().recip().min(MOST_LENGTHENED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::HUBER;
    use evcal_geometry::numerics::huber::huber;

    /// One lengthened step leads to the robust mean of numbers with outliers.
    #[test]
    fn a_lengthened_step_reaches_the_minimum_of_the_loss() {
        let numbers: Vec<f64> = (0..1000).map(|index| 6.0 * (f64::from(index) / 999.0 - 0.5).powi(3) * 4.0).collect();
        let (start, mut gradient, mut loss) = (0.05, 0.0, Loss::default());
        for number in &numbers {
            let (cost, root_weight) = huber(start - number, HUBER);
            gradient += (start - number) * root_weight * root_weight;
            loss.add_observation(cost, root_weight * root_weight);
        }
        let step = -gradient / loss.weight;
        assert!(step > -0.046, "{step}");
        let lengthened = step * loss.lengthening();
        assert!((lengthened + 0.05).abs() < 0.002, "{lengthened}");
    }
}

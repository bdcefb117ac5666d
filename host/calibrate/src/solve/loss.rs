//! The robust loss of many observations.

/// Largest factor by which a step is lengthened: with more outliers than this stands for, the weights are no guide.
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
    /// Number of observations that count squared.
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

    /// How much longer a step of Newton is than one of Gauss and Newton: an observation beyond the bound of Huber's loss has a weight, but
    /// its slope does not change, so that the weights promise a curvature that the loss does not have. Some 1.1; without it, the first step
    /// falls a tenth short.
    pub fn lengthening(&self) -> f64 {
        if self.squared > 0 { (self.weight / self.squared as f64).clamp(1.0, MOST_LENGTHENED) } else { 1.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::solve::HUBER;
    use evcal_geometry::numerics::huber::huber;

    /// The middle of numbers with outliers is where one lengthened step leads.
    #[test]
    fn a_lengthened_step_leads_to_the_least_loss() {
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

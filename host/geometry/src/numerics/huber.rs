//! Huber's robust loss.

/// Returns Huber's loss of a distance whose square is given: the square itself up to `huber`, linear beyond.
pub fn huber_cost(squared: f64, huber: f64) -> f64 {
    if squared <= huber * huber { squared } else { 2.0 * huber * squared.sqrt() - huber * huber }
}

/// Returns the weight with which iteratively reweighted least squares minimises [`huber_cost`].
pub fn huber_weight(squared: f64, huber: f64) -> f64 {
    if squared <= huber * huber { 1.0 } else { huber / squared.sqrt() }
}

/// Returns Huber's loss of `error` (in units of σ): (cost ρ, square root of the row's weight). Without branches, so
/// that the compiler can vectorise over several errors.
#[inline(always)]
pub fn huber(error: f64, bound: f64) -> (f64, f64) {
    let size = error.abs();
    let near = if size < bound { size } else { bound };
    let far = if size > bound { size } else { bound };
    (near * (size - 0.5 * near), (bound / far).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_of_the_loss_agree() {
        for step in 0..100 {
            let error = 0.07 * f64::from(step) - 3.0;
            let (cost, root_weight) = huber(error, 1.5);
            assert!((2.0 * cost - huber_cost(error * error, 1.5)).abs() < 1e-12);
            assert!((root_weight * root_weight - huber_weight(error * error, 1.5)).abs() < 1e-12);
        }
    }
}

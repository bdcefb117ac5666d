//! Huber's robust loss.

/// Huber's loss of a distance whose square is given: the square itself up to `huber`, linear beyond.
pub fn huber_cost(squared: f64, huber: f64) -> f64 {
    if squared <= huber * huber { squared } else { 2.0 * huber * squared.sqrt() - huber * huber }
}

/// Weight with which iteratively reweighted least squares realises [`huber_cost`].
pub fn huber_weight(squared: f64, huber: f64) -> f64 {
    if squared <= huber * huber { 1.0 } else { huber / squared.sqrt() }
}

/// Huber's loss of `error` (in units of σ): (cost ρ, square root of the row's weight).
#[inline(always)]
pub fn huber(error: f64, bound: f64) -> (f64, f64) {
    let size = error.abs();
    if size <= bound { (0.5 * error * error, 1.0) } else { (bound * (size - 0.5 * bound), (bound / size).sqrt()) }
}

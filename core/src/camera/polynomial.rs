//! Polynomials that determine the end of a camera model's one-to-one domain, and radial functions.
//!
//! Root search: between neighbouring roots of its derivative a polynomial is monotone, so a change of sign between them
//! encloses exactly one root. Applied from the highest derivative down, this finds every real root without start
//! values.

use nalgebra::RealField;

/// Number of halvings after which an interval of any float type used here has collapsed.
const MAX_HALVINGS: usize = 128;

/// Largest number of steps of a safeguarded Newton iteration, which halves the interval when a Newton step does not
/// help.
const MAX_STEPS: usize = 64;

/// Returns `Σ coefficients[i] x^i`.
fn evaluate<T: RealField + Copy>(coefficients: &[T], x: T) -> T {
    coefficients.iter().rev().fold(T::zero(), |sum, &coefficient| sum * x + coefficient)
}

/// Returns the product of two polynomials; terms that do not fit into `C` coefficients are dropped.
pub(super) fn product<T: RealField + Copy, const C: usize>(left: &[T], right: &[T]) -> [T; C] {
    let mut product = [T::zero(); C];
    for (power, &factor) in left.iter().enumerate() {
        for (slot, &other) in product.iter_mut().skip(power).zip(right) {
            *slot += factor * other;
        }
    }
    product
}

/// Returns the end of the interval from 0 on which `Σ coefficients[i] x^i` stays positive, at most `limit`.
///
/// Returns 0 if the polynomial is not positive at 0.
pub(super) fn positive_until<T: RealField + Copy, const N: usize>(coefficients: &[T; N], limit: T) -> T {
    let positive_at_zero = coefficients.first().is_some_and(|&value| value > T::zero());
    if !positive_at_zero {
        return T::zero();
    }
    let mut derivatives: heapless::Vec<[T; N], N> = heapless::Vec::new();
    let mut derivative = *coefficients;
    while derivatives.push(derivative).is_ok() {
        let mut next = [T::zero(); N];
        let mut power = T::zero();
        for (slot, &coefficient) in next.iter_mut().zip(derivative.iter().skip(1)) {
            power += T::one();
            *slot = coefficient * power;
        }
        derivative = next;
    }
    let mut critical: heapless::Vec<T, N> = heapless::Vec::new();
    for polynomial in derivatives.iter().rev() {
        let mut roots: heapless::Vec<T, N> = heapless::Vec::new();
        let mut from = T::zero();
        for &to in critical.iter().chain(core::iter::once(&limit)) {
            if let Some(root) = root_between(polynomial, from, to) {
                // Cannot be full: a polynomial of N coefficients has fewer than N roots.
                let _ = roots.push(root);
            }
            from = to;
        }
        critical = roots;
    }
    critical.first().copied().unwrap_or(limit)
}

/// Returns the last number before a sign change between `from` and `to`, if there is one.
fn root_between<T: RealField + Copy>(coefficients: &[T], from: T, to: T) -> Option<T> {
    let positive = |x: T| evaluate(coefficients, x) > T::zero();
    let sign = positive(from);
    if sign == positive(to) {
        return None;
    }
    let half = nalgebra::convert::<f64, T>(0.5);
    let (mut low, mut high) = (from, to);
    for _ in 0..MAX_HALVINGS {
        let middle = low + (high - low) * half;
        if middle <= low || middle >= high {
            break;
        }
        if positive(middle) == sign {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(low)
}

/// The odd polynomial `f(r) = r (1 + c_1 r² + … + c_N r^2N)` on the interval where it increases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct RadialFunction<T, const N: usize> {
    coefficients: [T; N],
    /// First coefficients of the inverse series v (1 + b1 v² + b2 v⁴ + …).
    inverse: [T; 2],
    /// Upper bound of the arguments.
    limit: T,
    /// Upper bound of the values.
    value_limit: T,
}

impl<T: RealField + Copy, const N: usize> RadialFunction<T, N> {
    /// Creates the function with these coefficients, for arguments up to `limit` or the first maximum.
    ///
    /// `M` must be `N + 1`.
    pub fn new<const M: usize>(coefficients: [T; N], limit: T) -> Self {
        const { assert!(M == N + 1) };
        let mut slope = [T::one(); M];
        let mut power = T::one();
        for (slot, &coefficient) in slope.iter_mut().skip(1).zip(&coefficients) {
            power += nalgebra::convert(2.0);
            *slot = coefficient * power;
        }
        let limit = positive_until(&slope, limit * limit).sqrt();
        let first = coefficients.first().copied().unwrap_or(T::zero());
        let second = coefficients.get(1).copied().unwrap_or(T::zero());
        let inverse = [-first, nalgebra::convert::<f64, T>(3.0) * first * first - second];
        let unlimited = Self { coefficients, inverse, limit, value_limit: T::zero() };
        Self { value_limit: unlimited.value_and_slope(limit).0, ..unlimited }
    }

    /// Returns the coefficients.
    pub fn coefficients(&self) -> &[T; N] {
        &self.coefficients
    }

    /// Returns the upper bound of the arguments.
    pub fn limit(&self) -> T {
        self.limit
    }

    /// Returns `f(r)` and `f'(r)`.
    pub fn value_and_slope(&self, argument: T) -> (T, T) {
        let square = argument * argument;
        let (factor, factor_by_square) = self.factor(square);
        (argument * factor, factor + (square + square) * factor_by_square)
    }

    /// Returns `f(r) / r` and its derivative with respect to r², as functions of r².
    pub fn factor(&self, square: T) -> (T, T) {
        let mut factor = T::zero();
        let mut slope = T::zero();
        for &coefficient in self.coefficients.iter().rev() {
            factor = factor * square + coefficient;
            slope = slope * square + factor;
        }
        (T::one() + factor * square, slope)
    }

    /// Returns the argument in `[0, limit)` with this value; `None` for values outside the range and for NaN.
    pub fn invert(&self, value: T) -> Option<T> {
        if !(value >= T::zero() && value < self.value_limit) {
            return None;
        }
        // The error after a step is about step² f'' / 2 f'. Near a maximum f'' is of order 1; where f is steep, f'' /
        // f' is of order 1.
        let precision = T::default_epsilon() * nalgebra::convert(0.01);
        let half = nalgebra::convert::<f64, T>(0.5);
        let (mut low, mut high) = (T::zero(), self.limit);
        let square = value * value;
        let [b1, b2] = self.inverse;
        let series = value * (T::one() + square * (b1 + square * b2));
        let mut argument = if series >= low && series < high { series } else { high * half };
        let mut last_step = high;
        for _ in 0..MAX_STEPS {
            let (reached, slope) = self.value_and_slope(argument);
            let error = value - reached;
            if error > T::zero() {
                low = argument;
            } else {
                high = argument;
            }
            let step = error / slope;
            let next = argument + step;
            // Steps that do not shrink could oscillate across an inflection forever.
            let shrinks = step.abs() <= last_step.abs() * half;
            let last = argument;
            argument = if next >= low && next <= high && shrinks { next } else { low + (high - low) * half };
            last_step = argument - last;
            if step * step <= precision * slope.min(T::one()) {
                return Some(argument);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn positive_interval_ends_at_the_smallest_root() {
        // (1 - x) (2 - x) (3 - x) = 6 - 11 x + 6 x² - x³
        let end = positive_until(&[6.0, -11.0, 6.0, -1.0], 100.0_f64);
        assert!((end - 1.0).abs() < 1e-14, "{end}");
        assert_eq!(positive_until(&[6.0, -11.0, 6.0, -1.0], 0.5_f64), 0.5);
        assert_eq!(positive_until(&[1.0, 0.0, 2.0], 10.0_f64), 10.0);
        assert_eq!(positive_until(&[0.0, 1.0], 10.0_f64), 0.0);
        assert_eq!(positive_until(&[f64::NAN, 1.0], 10.0_f64), 0.0);
    }

    proptest! {
        #[test]
        fn the_smallest_of_random_roots_is_found(roots in prop::collection::vec(0.1..50.0_f64, 1..6), complex in 0.1..3.0_f64) {
            // Π (1 - x / root) times a factor without real roots.
            let mut polynomial = [0.0; 8];
            polynomial[0] = 1.0;
            for root in &roots {
                polynomial = product(&polynomial, &[1.0, -1.0 / root]);
            }
            polynomial = product(&polynomial, &[1.0, 0.0, complex]);
            let smallest = roots.iter().copied().fold(f64::INFINITY, f64::min);
            let separated = roots.iter().filter(|&&root| root < smallest * 1.01).count() == 1;
            prop_assume!(separated);
            let end = positive_until(&polynomial, 100.0);
            prop_assert!((end - smallest).abs() < 1e-9 * smallest, "{end} {smallest}");
        }

        #[test]
        fn radial_function_is_inverted_up_to_its_maximum(
            coefficients in prop::array::uniform4(-0.5..0.5_f64),
            part in 0.0..0.999_f64,
        ) {
            let function = RadialFunction::new::<5>(coefficients, 3.0);
            let argument = part * function.limit();
            let (value, slope) = function.value_and_slope(argument);
            prop_assert!(slope > 0.0);
            let found = function.invert(value).unwrap();
            prop_assert!((found - argument).abs() < 1e-14 / slope + 1e-14 * argument, "{found} {argument}");
            let (top, _) = function.value_and_slope(function.limit());
            prop_assert_eq!(function.invert(top), None);
        }
    }
}

//! Formats of numbers.

use evcal_geometry::numerics::statistics::decimals;

/// Formats a value and its standard deviation σ, both with the two leading digits of σ; a σ of
/// 0 is "fixed".
pub fn with_sigma(value: f64, sigma: f64) -> (String, String) {
    if !(sigma > 0.0 && sigma.is_finite()) {
        return (signed(value, 5), "fixed".to_owned());
    }
    let decimals = decimals(sigma);
    (signed(value, decimals), format!("{sigma:.decimals$}"))
}

/// Formats a value with a minus sign (U+2212) instead of a hyphen.
pub fn signed(value: f64, decimals: usize) -> String {
    format!("{value:.decimals$}").replace('-', "−")
}

/// Formats a count with thin spaces between thousands.
pub fn count(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}

/// Formats a share of 0 to 1 in percent.
pub fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_have_the_decimals_of_their_standard_deviation() {
        let pair = |value, sigma| with_sigma(value, sigma);
        assert_eq!(pair(331.23456, 0.0123), ("331.235".to_owned(), "0.012".to_owned()));
        assert_eq!(pair(-0.351234, 0.00234), ("−0.3512".to_owned(), "0.0023".to_owned()));
        assert_eq!(pair(331.2, 12.3), ("331".to_owned(), "12".to_owned()));
        assert_eq!(pair(1.5, 0.0), ("1.50000".to_owned(), "fixed".to_owned()));
    }

    #[test]
    fn thousands_are_separated() {
        assert_eq!(count(12), "12");
        assert_eq!(count(1_234_567), "1\u{202f}234\u{202f}567");
        assert_eq!(percent(1.0 / 3.0), "33 %");
    }
}

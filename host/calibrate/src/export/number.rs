//! Formatting of numbers and strings for all readers.

/// Returns the shortest decimal that is read back as the same f64, with a point and without an exponent, which YAML 1.1 and
/// Kalibr accept as a real number.
pub fn decimal(value: f64) -> String {
    let text = value.to_string();
    if text.contains('.') { text } else { format!("{text}.0") }
}

/// Returns a [`decimal`] of six significant digits, for values with a low accuracy.
pub fn significant(value: f64) -> String {
    decimal(format!("{value:.5e}").parse().unwrap_or(value))
}

/// Returns [`decimal`]s separated by commas.
pub fn decimals(values: &[f64]) -> String {
    values.iter().map(|value| decimal(*value)).collect::<Vec<_>>().join(", ")
}

/// Returns text in double quotation marks. The form of JSON is also valid in YAML.
pub fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_large_and_whole_numbers_have_a_point_and_no_exponent() {
        for (value, text) in [(345.0, "345.0"), (-1e-7, "-0.0000001"), (0.1 + 0.2, "0.30000000000000004")] {
            assert_eq!(decimal(value), text);
        }
        for value in [f64::MIN_POSITIVE, 1.7e300, -0.36951234567890123] {
            let text = decimal(value);
            assert!(text.contains('.') && !text.contains('e') && text.parse() == Ok(value), "{text}");
        }
        assert_eq!(decimals(&[1.0, -0.5]), "1.0, -0.5");
        assert_eq!([0.07921633902, -0.000012345678, 0.0].map(significant), ["0.0792163", "-0.0000123457", "0.0"]);
    }
}

//! Exact parsing of numbers: a time in seconds with six decimals loses no microsecond.

use evcal_core::event::Polarity;

use crate::columns::PolarityCode;
use crate::options::TimeUnit;

/// A decimal number without exponent: sign, digits before the point, digits after it.
struct Decimal<'a> {
    negative: bool,
    whole: &'a [u8],
    fraction: &'a [u8],
}

/// Splits `field` into its parts, if it is a decimal number without exponent.
fn decimal(field: &[u8]) -> Option<Decimal<'_>> {
    let (negative, digits) = match field.split_first()? {
        (b'-', rest) => (true, rest),
        (b'+', rest) => (false, rest),
        _ => (false, field),
    };
    let point = digits.iter().position(|&byte| byte == b'.');
    let (whole, fraction) = match point {
        Some(point) => (digits.get(..point)?, digits.get(point + 1..)?),
        None => (digits, &[][..]),
    };
    let all_digits = whole.iter().chain(fraction).all(u8::is_ascii_digit);
    (all_digits && !(whole.is_empty() && fraction.is_empty())).then_some(Decimal { negative, whole, fraction })
}

/// Parses a number that may have an exponent, as written by NumPy. `None` for NaN and infinity.
fn floating(field: &[u8]) -> Option<f64> {
    let value: f64 = std::str::from_utf8(field).ok()?.parse().ok()?;
    value.is_finite().then_some(value)
}

/// `true` if `field` is a number, including NaN and infinity, which the reader then reports.
pub fn is_number(field: &[u8]) -> bool {
    std::str::from_utf8(field).is_ok_and(|field| field.parse::<f64>().is_ok())
}

/// Returns the number in `field` as accurately as f64 allows.
pub fn value(field: &[u8]) -> Option<f64> {
    floating(field)
}

/// Returns the time in `field`, rounded to microseconds.
pub fn microseconds(field: &[u8], unit: TimeUnit) -> Option<i64> {
    let exponent = unit.decimal_exponent();
    let Some(Decimal { negative, whole, fraction }) = decimal(field) else {
        let value = floating(field)? * 10f64.powi(exponent);
        return (value.abs() < 9e18).then_some(value.round() as i64);
    };
    let digit = |byte: &u8| i64::from(byte - b'0');
    let append = |value: i64, digit: i64| value.checked_mul(10)?.checked_add(digit);
    let whole_value = whole.iter().try_fold(0, |value, byte| append(value, digit(byte)))?;
    let magnitude = match usize::try_from(exponent) {
        Ok(places) => {
            let mut digits = fraction.iter().map(digit);
            let value = (0..places).try_fold(whole_value, |value, _| append(value, digits.next().unwrap_or(0)))?;
            value.checked_add(i64::from(digits.next().is_some_and(|digit| digit >= 5)))?
        }
        Err(_) => {
            let divisor = 10i64.checked_pow(exponent.unsigned_abs())?;
            whole_value.checked_add(divisor / 2)? / divisor
        }
    };
    Some(if negative { -magnitude } else { magnitude })
}

/// Returns the whole pixel in `field`. Values out of range become the largest u16, which no sensor has.
pub fn pixel(field: &[u8]) -> Option<u16> {
    if let [b'0'..=b'9', ..] = field
        && field.len() <= 4
        && field.iter().all(u8::is_ascii_digit)
    {
        return Some(field.iter().fold(0, |value, byte| value * 10 + u16::from(byte - b'0')));
    }
    let value = floating(field)?;
    if value.fract() != 0.0 {
        return None;
    }
    Some(if value < 0.0 { u16::MAX } else { value as u16 })
}

/// Returns the polarity in `field`: a word, or a number of `code`.
pub fn polarity(field: &[u8], code: PolarityCode) -> Option<Polarity> {
    if field.eq_ignore_ascii_case(b"true") || field.eq_ignore_ascii_case(b"on") {
        return Some(Polarity::On);
    }
    if field.eq_ignore_ascii_case(b"false") || field.eq_ignore_ascii_case(b"off") {
        return Some(Polarity::Off);
    }
    code.polarity(floating(field)?)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn times_are_exact() {
        let cases = [
            ("0.003811000", TimeUnit::Seconds, Some(3811)),
            ("1468939993.067416", TimeUnit::Seconds, Some(1_468_939_993_067_416)),
            ("1468939993.0674165", TimeUnit::Seconds, Some(1_468_939_993_067_417)),
            ("12", TimeUnit::Seconds, Some(12_000_000)),
            (".5", TimeUnit::Milliseconds, Some(500)),
            ("-0.25", TimeUnit::Seconds, Some(-250_000)),
            ("17", TimeUnit::Microseconds, Some(17)),
            ("17.5", TimeUnit::Microseconds, Some(18)),
            ("1499", TimeUnit::Nanoseconds, Some(1)),
            ("1500", TimeUnit::Nanoseconds, Some(2)),
            ("1.500000000000000000e-03", TimeUnit::Seconds, Some(1500)),
            ("nan", TimeUnit::Seconds, None),
            ("inf", TimeUnit::Microseconds, None),
            ("1e40", TimeUnit::Microseconds, None),
            ("99999999999999999999", TimeUnit::Microseconds, None),
            ("", TimeUnit::Seconds, None),
            (".", TimeUnit::Seconds, None),
            ("-", TimeUnit::Seconds, None),
            ("1.2.3", TimeUnit::Seconds, None),
            ("12us", TimeUnit::Microseconds, None),
        ];
        for (text, unit, expected) in cases {
            assert_eq!(microseconds(text.as_bytes(), unit), expected, "{text}");
        }
    }

    #[test]
    fn pixels_are_whole() {
        let cases = [
            ("0", Some(0)),
            ("345", Some(345)),
            ("0345", Some(345)),
            ("12.0", Some(12)),
            ("1.2e+01", Some(12)),
            ("65535", Some(65_535)),
            ("70000", Some(65_535)),
            ("-1", Some(65_535)),
            ("12.5", None),
            ("nan", None),
            ("x", None),
            ("", None),
        ];
        for (text, expected) in cases {
            assert_eq!(pixel(text.as_bytes()), expected, "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_time_with_decimals_equals_its_microseconds(t in -(1i64 << 55)..(1i64 << 55)) {
            let sign = if t < 0 { "-" } else { "" };
            let text = format!("{sign}{}.{:06}", t.abs() / 1_000_000, t.abs() % 1_000_000);
            prop_assert_eq!(microseconds(text.as_bytes(), TimeUnit::Seconds), Some(t));
        }

        #[test]
        fn arbitrary_fields_do_not_panic(field in prop::collection::vec(any::<u8>(), 0..30)) {
            for unit in [TimeUnit::Seconds, TimeUnit::Nanoseconds] {
                let _ = microseconds(&field, unit);
            }
            let _ = (pixel(&field), polarity(&field, PolarityCode::USUAL), is_number(&field));
        }
    }
}

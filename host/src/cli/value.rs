//! Values that several subcommands take.

use clap::builder::{PossibleValuesParser, TypedValueParser};
use evcal::initial::model_choice::ModelRequest;
use evcal::recording::MAX_SENSOR_SIZE;
use evcal_core::camera::ModelKind;
use evcal_core::sensor::Sensor;

/// Reads the name of a camera model; the help lists them all.
pub fn model() -> impl TypedValueParser<Value = ModelKind> {
    PossibleValuesParser::new(ModelKind::ALL.iter().map(|kind| kind.name())).try_map(|name| name.parse::<ModelKind>())
}

/// Reads the name of a camera model, or `auto`; the help lists them all.
pub fn model_request() -> impl TypedValueParser<Value = ModelRequest> {
    let names = ModelKind::ALL.iter().map(|kind| kind.name()).chain([ModelRequest::AUTO]);
    PossibleValuesParser::new(names).try_map(|name| name.parse::<ModelRequest>())
}

/// Reads `WIDTHxHEIGHT` in pixels.
pub fn sensor(text: &str) -> Result<Sensor, String> {
    let size = |part: &str| part.trim().parse().ok().filter(|size| (1..=MAX_SENSOR_SIZE).contains(size));
    text.split_once('x')
        .and_then(|(width, height)| Some(Sensor::new(size(width)?, size(height)?)))
        .ok_or_else(|| format!("write WIDTHxHEIGHT in pixels, 1 to {MAX_SENSOR_SIZE} each, for example 346x260"))
}

/// Reads a time with its unit; the result is in seconds.
pub fn seconds(text: &str) -> Result<f64, String> {
    // "ms" and "us" end in "s" too, so the longer units are tried first.
    [("ms", 1e-3), ("us", 1e-6), ("min", 60.0), ("s", 1.0)]
        .iter()
        .find_map(|(unit, factor)| Some((text.strip_suffix(unit)?, factor)))
        .and_then(|(number, factor)| Some(number.trim().parse::<f64>().ok()? * factor))
        .filter(|seconds| seconds.is_finite() && *seconds > 0.0)
        .ok_or_else(|| "write a time above 0 with its unit us, ms, s or min, for example 6s".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_are_two_numbers() {
        assert_eq!(sensor("346x260"), Ok(Sensor::new(346, 260)));
        for text in ["", "346", "346x", "0x260", "346x260x3", "-1x5", "40000x5", "346,260"] {
            assert!(sensor(text).unwrap_err().contains("346x260"), "{text}");
        }
    }

    #[test]
    fn times_have_units() {
        for (text, value) in [("6s", 6.0), ("250ms", 0.25), ("40us", 4e-5), ("1.5min", 90.0), ("2 s", 2.0)] {
            assert!((seconds(text).unwrap() - value).abs() < 1e-12 * value, "{text}");
        }
        for text in ["", "6", "s", "-1s", "0s", "nans", "infs", "6h"] {
            assert!(seconds(text).unwrap_err().contains("6s"), "{text}");
        }
    }
}

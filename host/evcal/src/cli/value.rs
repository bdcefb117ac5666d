//! Parsers for the values of options.

use std::ffi::OsStr;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::str::FromStr;

use clap::builder::{PathBufValueParser, PossibleValue, PossibleValuesParser, StringValueParser, TypedValueParser};
use clap::error::{ContextKind, ContextValue, ErrorKind};
use evcal_core::camera::ModelKind;
use evcal_core::sensor::Sensor;
use evcal_solve::initial::model_choice::ModelRequest;
use event_recordings::MAX_SENSOR_SIZE;

/// Names of camera models in other programs, with the corresponding model.
const OTHER_NAMES: &[(&str, &str)] = &[
    ("pinhole", "a pinhole with distortion is radtan (k1 k2 p1 p2 k3, as OpenCV), radtan4 (Kalibr's pinhole-radtan)"),
    ("fisheye", "OpenCV's fisheye is kannala-brandt"),
    ("equidistant", "equidistant (ROS, Kalibr) is kannala-brandt"),
    ("equi", "equidistant (ROS, Kalibr) is kannala-brandt"),
    ("pinhole-equi", "Kalibr's pinhole-equi is kannala-brandt"),
    ("kb4", "basalt's kb4 is kannala-brandt"),
    ("kb", "kb is kannala-brandt"),
    ("pinhole-radtan", "Kalibr's pinhole-radtan is radtan4"),
    ("plumb_bob", "ROS's plumb_bob is radtan"),
    ("brown", "Brown-Conrady is radtan"),
    ("brown-conrady", "Brown-Conrady is radtan"),
    (
        "opencv",
        "OpenCV's model with five coefficients is radtan, with eight radtan8; its fisheye model is kannala-brandt",
    ),
    ("rational", "the rational model of eight coefficients is radtan8"),
    ("rational_polynomial", "ROS's rational_polynomial is radtan8"),
    ("omnidir", "OpenCV's omnidir is omni"),
    ("mei", "Mei's model is omni"),
    ("omni-radtan", "Kalibr's omni-radtan is omni"),
    ("ds", "ds is double-sphere"),
    ("ds-none", "Kalibr's ds-none is double-sphere"),
    ("eucm-none", "Kalibr's eucm-none is eucm"),
    ("atan", "the field-of-view model is fov"),
];

/// Parses the name of a file to write.
pub fn output_file() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| match path.as_os_str() == "-" {
        true => Err("`-` is not accepted as an output; give a file name, or /dev/stdout for a pipe"),
        false => Ok(path),
    })
}

/// Numbers, separated by commas.
#[derive(Clone, Debug)]
pub struct Numbers(pub Vec<f64>);

impl FromStr for Numbers {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let numbers = text.split(',').map(|number| number.trim().parse()).collect::<Result<_, _>>();
        numbers
            .map(Self)
            .map_err(|_| "write numbers with decimal points, separated by commas, such as 331.6,331.1,176.9,134.2")
    }
}

/// Parses the name of a camera model; the help lists all names.
pub fn model() -> impl TypedValueParser<Value = ModelKind> {
    NameParser { names: ModelKind::ALL.iter().map(|kind| kind.name()).collect() }
        .try_map(|name| name.parse::<ModelKind>())
}

/// Parses the name of a camera model, or `auto`; the help lists all names.
pub fn model_request() -> impl TypedValueParser<Value = ModelRequest> {
    let names = ModelKind::ALL.iter().map(|kind| kind.name()).chain([ModelRequest::AUTO]).collect();
    NameParser { names }.try_map(|name| name.parse::<ModelRequest>())
}

/// Parses one of the names; for a name of another program, the error contains the corresponding model.
#[derive(Clone)]
struct NameParser {
    names: Vec<&'static str>,
}

impl TypedValueParser for NameParser {
    type Value = String;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        let given = value.to_string_lossy().to_lowercase();
        let Some((_, meaning)) = OTHER_NAMES.iter().find(|(name, _)| *name == given) else {
            return PossibleValuesParser::new(&self.names).parse_ref(command, argument, value);
        };
        let mut error = clap::Error::new(ErrorKind::ValueValidation).with_cmd(command);
        let argument = argument.map(ToString::to_string).unwrap_or_default();
        error.insert(ContextKind::InvalidArg, ContextValue::String(argument));
        error.insert(ContextKind::InvalidValue, ContextValue::String(given));
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![(*meaning).into()]));
        Err(error)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(self.names.iter().map(PossibleValue::new)))
    }
}

/// Parses the name of one of `all`; the help lists all with their descriptions.
pub fn named<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
    description: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let values = all.iter().map(move |&one| PossibleValue::new(name(one)).help(description(one)));
    PossibleValuesParser::new(values)
        .try_map(move |text| all.iter().copied().find(|&one| name(one) == text).ok_or("no value of this name"))
}

/// Parses a number in `range`.
pub fn number(range: RangeInclusive<f64>, unit: &'static str) -> impl TypedValueParser<Value = f64> {
    StringValueParser::new().try_map(move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| format!("write a number from {} to {}{unit}", range.start(), range.end()))
    })
}

/// Parses an integer in `range`.
pub fn count(range: RangeInclusive<u16>) -> impl TypedValueParser<Value = u16> {
    StringValueParser::new().try_map(move |text| {
        let number = text.parse().ok().filter(|number| range.contains(number));
        number.ok_or_else(|| format!("write a whole number, {} to {}", range.start(), range.end()))
    })
}

/// Parses `WIDTHxHEIGHT` in pixels.
pub fn sensor(text: &str) -> Result<Sensor, String> {
    let size = |part: &str| part.trim().parse().ok().filter(|size| (1..=MAX_SENSOR_SIZE).contains(size));
    text.split_once('x')
        .and_then(|(width, height)| Some(Sensor::new(size(width)?, size(height)?)))
        .ok_or_else(|| format!("write WIDTHxHEIGHT in pixels, 1 to {MAX_SENSOR_SIZE} each, for example 346x260"))
}

/// Parses a time with its unit; returns seconds.
pub fn seconds(text: &str) -> Result<f64, String> {
    // "ms" and "us" also end in "s", so the longer units are tried first.
    [("ms", 1e-3), ("us", 1e-6), ("min", 60.0), ("s", 1.0)]
        .iter()
        .find_map(|(unit, factor)| Some((text.strip_suffix(unit)?, factor)))
        .and_then(|(number, factor)| Some(number.trim().parse::<f64>().ok()? * factor))
        .filter(|seconds| seconds.is_finite() && *seconds > 0.0)
        .ok_or_else(|| "write a time above 0 with its unit us, ms, s or min, for example 6s".to_owned())
}

/// Parses a distance in the image with its unit; returns pixels.
pub fn pixels(text: &str) -> Result<f64, String> {
    let number = text.strip_suffix("px").and_then(|number| number.trim().parse::<f64>().ok());
    number
        .filter(|pixels| pixels.is_finite() && *pixels > 0.0)
        .ok_or_else(|| "write pixels above 0 with their unit, for example 0.05px".to_owned())
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

    #[test]
    fn names_of_other_programs_have_a_corresponding_model() {
        for (name, meaning) in OTHER_NAMES {
            assert_eq!(ModelKind::from_name(name), None, "{name}");
            let known = ModelKind::ALL.iter().any(|kind| meaning.contains(kind.name()));
            assert!(known, "{name}: {meaning}");
        }
    }

    #[test]
    fn pixels_need_their_unit() {
        assert_eq!((pixels("0.05px"), pixels("1 px")), (Ok(0.05), Ok(1.0)));
        for wrong in ["0.05", "px", "0px", "-1px", "infpx", "5mm"] {
            assert!(pixels(wrong).unwrap_err().contains("0.05px"), "{wrong}");
        }
    }
}

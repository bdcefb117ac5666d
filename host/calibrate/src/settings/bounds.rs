//! Check that numbers are within their bounds.

use evcal_core::settings::{Bounds, Group, Kind};
use toml::{Table, Value};

/// A number out of its bounds; names are dotted, as in `detection.cluster.epsilon`.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum OutOfBounds {
    /// It is outside its own bounds.
    #[error("{name} is {value}; it must be {bounds}{}{unit}", if unit.is_empty() { "" } else { " " })]
    Range {
        /// Name of the setting.
        name: String,
        /// Its value.
        value: f64,
        /// Permitted values.
        bounds: Bounds,
        /// Its unit; empty without one.
        unit: &'static str,
    },
    /// It exceeds another setting that limits it.
    #[error("{name} is {value}; it must be at most {other}, which is {most}")]
    Above {
        /// Name of the setting.
        name: String,
        /// Its value.
        value: f64,
        /// Name of the setting that limits it.
        other: String,
        /// Its value.
        most: f64,
    },
}

/// Returns the number of `group`, with its value in `values`, that is out of its bounds.
pub fn check(group: &Group, values: &Table) -> Result<(), OutOfBounds> {
    check_below("", group, values)
}

/// Does the same as [`check`], for the settings whose names begin with `prefix`.
fn check_below(prefix: &str, group: &Group, values: &Table) -> Result<(), OutOfBounds> {
    let numbers = group.settings.iter().filter_map(|setting| match setting.kind {
        Kind::Number { unit, bounds } => Some((setting.name, unit, bounds, number(values, setting.name)?)),
        Kind::Choice | Kind::Group(_) => None,
    });
    for (name, unit, bounds, value) in numbers.clone() {
        if !bounds.contains(value) {
            return Err(OutOfBounds::Range { name: format!("{prefix}{name}"), value, bounds, unit });
        }
    }
    for (name, _, bounds, value) in numbers {
        let other = bounds.up_to.and_then(|other| Some((other, number(values, other)?)));
        if let Some((other, most)) = other.filter(|(_, most)| value > *most) {
            let (name, other) = (format!("{prefix}{name}"), format!("{prefix}{other}"));
            return Err(OutOfBounds::Above { name, value, other, most });
        }
    }
    for setting in group.settings {
        if let (Kind::Group(group), Some(Value::Table(values))) = (&setting.kind, values.get(setting.name)) {
            check_below(&format!("{prefix}{}.", setting.name), group, values)?;
        }
    }
    Ok(())
}

fn number(values: &Table, name: &str) -> Option<f64> {
    match values.get(name)? {
        Value::Float(value) => Some(*value),
        Value::Integer(value) => Some(*value as f64),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::super::Settings;
    use super::*;

    /// Returns the dotted names of all numbers in files with their bounds.
    fn numbers(prefix: &str, group: &Group) -> Vec<(String, Bounds)> {
        let in_files = numbers_of("", &Settings::default().table());
        let of = group.settings.iter().flat_map(|setting| match setting.kind {
            Kind::Number { bounds, .. } => vec![(format!("{prefix}{}", setting.name), bounds)],
            Kind::Group(group) => numbers(&format!("{prefix}{}.", setting.name), group),
            Kind::Choice => Vec::new(),
        });
        of.filter(|(name, _)| in_files.contains(name)).collect()
    }

    /// Returns the dotted names of all numbers in a table.
    fn numbers_of(prefix: &str, table: &Table) -> Vec<String> {
        let paths = table.iter().flat_map(|(name, value)| match value {
            Value::Table(inner) => numbers_of(&format!("{prefix}{name}."), inner),
            Value::Float(_) | Value::Integer(_) => vec![format!("{prefix}{name}")],
            _ => Vec::new(),
        });
        paths.collect()
    }

    #[test]
    fn every_number_has_bounds_and_its_default_is_within() {
        let mut known: Vec<String> = numbers("", &Settings::GROUP).into_iter().map(|(name, _)| name).collect();
        let mut numbers = numbers_of("", &Settings::default().table());
        known.sort_unstable();
        numbers.sort_unstable();
        assert_eq!(known, numbers);
        assert_eq!(check(&Settings::GROUP, &Settings::default().table()), Ok(()));
    }

    /// Returns the error for the defaults with another value of the setting `path`.
    fn message(path: &str, value: f64) -> Result<(), String> {
        let mut settings = Settings::default().table();
        let (tables, name) = path.rsplit_once('.').unwrap();
        let mut table = &mut settings;
        for inner in tables.split('.') {
            table = table[inner].as_table_mut().unwrap();
        }
        table[name] = Value::Float(value);
        check(&Settings::GROUP, &settings).map_err(|error| error.to_string())
    }

    #[test]
    fn a_value_out_of_its_bounds_is_refused_by_name() {
        for (path, bounds) in numbers("", &Settings::GROUP) {
            let below = f64::from(bounds.least) - if bounds.above { 0.0 } else { 0.01 };
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, below] {
                let message = message(&path, value).unwrap_err();
                assert!(message.starts_with(&path), "{path} = {value}: {message}");
            }
            if bounds.most < f32::MAX {
                let message = message(&path, f64::from(bounds.most) * 1.001).unwrap_err();
                assert!(message.contains("to ") || message.contains("at most"), "{message}");
            }
        }
    }

    #[test]
    fn limits_without_values_between_them_are_refused() {
        let mut seen = 0;
        for (path, bounds) in numbers("", &Settings::GROUP) {
            let Some(other) = bounds.up_to else { continue };
            let (group, _) = path.rsplit_once('.').unwrap();
            let message = message(&path, 999.0).unwrap_err();
            assert!(message.contains(&path) && message.contains(&format!("{group}.{other}")), "{message}");
            seen += 1;
        }
        assert_eq!(seen, 2);
    }

    #[test]
    fn an_error_names_the_permitted_range() {
        let message = |path, value| message(path, value).unwrap_err();
        let epsilon = message("detection.cluster.epsilon", 6.0);
        assert_eq!(epsilon, "detection.cluster.epsilon is 6; it must be from 1 to 4.99 px");
        assert_eq!(message("association.band", 0.0), "association.band is 0; it must be above 0 σ");
        assert_eq!(
            message("segment.longest_gap", -0.1),
            "segment.longest_gap is -0.1; it must be above 0 and at most 10 s"
        );
        assert_eq!(
            message("detection.window.min_interval", 17.0),
            "detection.window.min_interval is 17; it must be at most detection.window.max_interval, which is 16"
        );
    }
}

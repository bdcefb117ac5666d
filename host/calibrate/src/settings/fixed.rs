//! Settings of earlier versions that are constants now.
//!
//! Every `settings.toml` of an earlier version contains all of them. If a value equals the built-in one, nothing changes and it
//! is ignored, so that old files can still be read; any other value would silently have no effect, and is an error.

use toml::{Table, Value};

/// Their names and built-in values.
const FIXED: &str = include_str!("fixed.toml");

/// Replacements of some of them: the beginning of a name, and a sentence about the replacement.
const INSTEAD: [(&str, &str); 6] = [
    ("association.", "association.band is the largest distance of events from an edge"),
    ("board.", "board.estimate = false uses the nominal board"),
    ("knots.first", "knots.finest and knots.coarsest bound the distance of knots"),
    ("live.boards", "live.shortest is the shortest time of a session"),
    ("live.first_checkpoint", "it follows live.shortest, two thirds of it"),
    ("verdict.poor", "it follows verdict.good, three times as much"),
];

/// A setting that is fixed now, with another value than the built-in one.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{name} is {stated}, but it is fixed at {built_in} now: leave it out{instead}")]
pub struct FixedSetting {
    /// Dotted name.
    pub name: String,
    /// The value in the file.
    pub stated: String,
    /// The built-in value.
    pub built_in: String,
    /// Replacement, after a semicolon; empty if nothing replaces it.
    pub instead: String,
}

/// Removes settings with their built-in values from `settings`. Returns `true` if there were any.
///
/// # Errors
/// [`FixedSetting`] if such a setting has another value.
pub fn take_fixed(settings: &mut Table) -> Result<bool, FixedSetting> {
    take_below("", &FIXED.parse().unwrap_or_default(), settings)
}

/// Does the same as [`take_fixed`], for the names that begin with `prefix`.
fn take_below(prefix: &str, fixed: &Table, settings: &mut Table) -> Result<bool, FixedSetting> {
    let mut taken = false;
    for (name, built_in) in fixed {
        let dotted = format!("{prefix}{name}");
        match (built_in, settings.get_mut(name)) {
            (Value::Table(fixed), Some(Value::Table(stated))) => {
                taken |= take_below(&format!("{dotted}."), fixed, stated)?;
                // Some sections become empty and are removed.
                if stated.is_empty() {
                    settings.remove(name);
                }
            }
            (built_in, Some(stated)) if number(stated).is_some() && number(stated) == number(built_in) => {
                settings.remove(name);
                taken = true;
            }
            (built_in, Some(stated)) => {
                let instead = INSTEAD.iter().find(|(beginning, _)| dotted.starts_with(beginning));
                let instead = instead.map_or_else(String::new, |(_, instead)| format!("; {instead}"));
                let (stated, built_in) = (stated.to_string(), built_in.to_string());
                return Err(FixedSetting { name: dotted, stated, built_in, instead });
            }
            (_, None) => {}
        }
    }
    Ok(taken)
}

fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|value| value as f64))
}

#[cfg(test)]
mod tests {
    use super::super::Settings;
    use super::*;

    fn fixed() -> Table {
        FIXED.parse().unwrap()
    }

    /// Merges `more` into `settings`.
    fn merge(settings: &mut Table, more: Table) {
        for (name, value) in more {
            match (settings.get_mut(&name), value) {
                (Some(Value::Table(own)), Value::Table(more)) => merge(own, more),
                (None, value) => _ = settings.insert(name, value),
                (Some(_), _) => panic!("{name} can be set"),
            }
        }
    }

    #[test]
    fn a_file_of_an_earlier_version_is_read_as_the_settings_that_are_left() {
        let mut old = Settings::default().table();
        merge(&mut old, fixed());
        assert_eq!(take_fixed(&mut old), Ok(true));
        assert_eq!(old, Settings::default().table());
        assert_eq!(take_fixed(&mut old), Ok(false));
    }

    #[test]
    fn the_error_about_another_value_names_the_setting_and_its_fixed_value() {
        let message = |text: &str| take_fixed(&mut text.parse().unwrap()).unwrap_err().to_string();
        assert_eq!(message("solve.huber = 3"), "solve.huber is 3, but it is fixed at 1.5 now: leave it out");
        let poor = message("verdict.poor = 0.5");
        assert!(
            poor.ends_with("fixed at 0.3 now: leave it out; it follows verdict.good, three times as much"),
            "{poor}"
        );
        assert!(message("model_choice.views = \"many\"").starts_with("model_choice.views is \"many\", "));
    }
}

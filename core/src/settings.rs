//! Self-describing settings: unit, bounds and meaning are declared together with the field.
//!
//! The macro [`settings!`](crate::settings!) turns one declaration into a structure, its defaults and a description.
//! Programs use the description to check settings files and to document the settings, so each setting is declared in
//! one place only.
//!
//! ```
//! use evcal_core::settings::{Kind, at_least};
//!
//! evcal_core::settings! {
//!     /// Waiting for an answer.
//!     #[derive(Clone, Debug, PartialEq)]
//!     pub struct WaitSettings {
//!         /// Longest time to wait.
//!         pub longest: f64 = 0.5, "s", at_least(0.0);
//!         /// `true` to report the end of the wait.
//!         pub loud: bool = true;
//!     }
//! }
//!
//! assert_eq!(WaitSettings::default(), WaitSettings { longest: 0.5, loud: true });
//! let longest = &WaitSettings::GROUP.settings[0];
//! assert_eq!((longest.name, longest.meaning), ("longest", " Longest time to wait."));
//! let Kind::Number { unit, bounds } = longest.kind else { panic!() };
//! assert!(unit == "s" && bounds.contains(0.0) && !bounds.contains(-0.1) && !bounds.contains(f64::NAN));
//! ```

use core::fmt;

/// A structure of settings.
#[derive(Clone, Copy, Debug)]
pub struct Group {
    /// Purpose: the documentation of the structure, each line with a space before it.
    pub meaning: &'static str,
    /// Its settings in the order of the fields.
    pub settings: &'static [Setting],
}

/// One setting.
#[derive(Clone, Copy, Debug)]
pub struct Setting {
    /// Name of the field.
    pub name: &'static str,
    /// Meaning: the documentation of the field, each line with a space before it.
    pub meaning: &'static str,
    /// Type of value and, for a number, its unit and bounds.
    pub kind: Kind,
}

/// Type of a setting's value.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A number.
    Number {
        /// Its unit; empty for a plain number.
        unit: &'static str,
        /// Allowed range.
        bounds: Bounds,
    },
    /// A name or a boolean.
    Choice,
    /// A structure of further settings.
    Group(&'static Group),
}

/// Allowed range of a number. Infinities and NaN are never in range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// The smallest number.
    pub least: f32,
    /// `true` if `least` itself is not allowed.
    pub above: bool,
    /// The largest number; `f32::MAX` if there is no upper bound.
    pub most: f32,
    /// Another setting of the same structure that the number must not exceed.
    pub up_to: Option<&'static str>,
}

/// Returns the range of numbers greater than `least`.
pub const fn above(least: f32) -> Bounds {
    Bounds { above: true, ..at_least(least) }
}

/// Returns the range of numbers equal to or greater than `least`.
pub const fn at_least(least: f32) -> Bounds {
    Bounds { least, above: false, most: f32::MAX, up_to: None }
}

/// Returns the range from `least` to `most`, both included.
pub const fn from_to(least: f32, most: f32) -> Bounds {
    at_least(least).at_most(most)
}

impl Bounds {
    /// Returns the same range limited to at most `most`.
    pub const fn at_most(self, most: f32) -> Self {
        Self { most, ..self }
    }

    /// Returns the same range limited by the setting `name` of the same structure.
    pub const fn up_to(self, name: &'static str) -> Self {
        Self { up_to: Some(name), ..self }
    }

    /// Returns `true` if a number, rounded to single precision, is within the bounds; ignores [`up_to`](Self::up_to).
    pub fn contains(&self, value: f64) -> bool {
        let value = value as f32;
        value <= self.most && if self.above { value > self.least } else { value >= self.least }
    }
}

/// Formats the range as in "it must be from 1 to 4.99"; ignores [`up_to`](Bounds::up_to).
impl fmt::Display for Bounds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { least, above, most, .. } = *self;
        match (above, most == f32::MAX) {
            (false, false) => write!(f, "from {least} to {most}"),
            (true, false) => write!(f, "above {least} and at most {most}"),
            (true, true) => write!(f, "above {least}"),
            (false, true) => write!(f, "at least {least}"),
        }
    }
}

/// Declares a structure of settings: fields with their defaults, units and bounds.
///
/// - `name: Type = default, "unit", bounds;` is a number ([`above`], [`at_least`], [`from_to`]); `""` is the unit of a
///   plain number;
/// - `name: Type = default;` is a name or a boolean;
/// - `name: Type;` is another structure that was declared with this macro.
///
/// Generates the structure with the given attributes, its `Default`, and the constant `GROUP`, a [`Group`]. The
/// documentation of the structure and its fields is shown to users, so write whole sentences without links.
#[macro_export]
macro_rules! settings {
    (
        $(#[$($attribute:tt)*])*
        $visibility:vis struct $name:ident {
            $(
                $(#[$($field_attribute:tt)*])*
                $field_visibility:vis $field:ident: $type:ty $(= $default:expr $(, $unit:literal, $bounds:expr)?)?;
            )*
        }
    ) => {
        $(#[$($attribute)*])*
        $visibility struct $name {
            $(
                $(#[$($field_attribute)*])*
                $(
                    #[doc = concat!("\n\nDefault: `", stringify!($default), "`.")]
                    $(#[doc = concat!("Unit: `", $unit, "`. Allowed: `", stringify!($bounds), "`.")])?
                )?
                $field_visibility $field: $type,
            )*
        }

        impl ::core::default::Default for $name {
            fn default() -> Self {
                Self { $($field: $crate::settings!(@default [$($default)?])),* }
            }
        }

        impl $name {
            /// Description of the settings.
            pub const GROUP: $crate::settings::Group = $crate::settings::Group {
                meaning: concat!($($crate::settings!(@meaning $($attribute)*)),*),
                settings: &[$(
                    $crate::settings::Setting {
                        name: stringify!($field),
                        meaning: concat!($($crate::settings!(@meaning $($field_attribute)*)),*),
                        kind: $crate::settings!(@kind [$type] [$($default)?] [$($($unit, $bounds)?)?]),
                    }
                ),*],
            };
        }
    };
    (@default []) => { ::core::default::Default::default() };
    (@default [$default:expr]) => { $default };
    (@meaning doc = $text:literal) => { $text };
    (@meaning $($other:tt)*) => { "" };
    (@kind [$type:ty] [] []) => { $crate::settings::Kind::Group(&<$type>::GROUP) };
    (@kind [$type:ty] [$default:expr] []) => { $crate::settings::Kind::Choice };
    (@kind [$type:ty] [$default:expr] [$unit:literal, $bounds:expr]) => {
        $crate::settings::Kind::Number { unit: $unit, bounds: $bounds }
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    crate::settings! {
        /// Outside,
        /// in two lines.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct Outer {
            /// A length.
            pub length: f32 = 2.5, "px", above(0.0).at_most(10.0);
            /// A choice.
            pub choice: bool = true;
            /// Inside.
            pub inner: Inner;
        }
    }

    crate::settings! {
        /// Inside.
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct Inner {
            /// Few.
            pub few: u16 = 3, "", at_least(1.0).up_to("many");
            /// Many.
            pub many: u16 = 5, "", at_least(1.0);
        }
    }

    #[test]
    fn a_declaration_makes_defaults_and_description() {
        let expected = Outer { length: 2.5, choice: true, inner: Inner { few: 3, many: 5 } };
        assert_eq!(Outer::default(), expected);
        assert_eq!(Outer::GROUP.meaning, " Outside, in two lines.");
        let [length, choice, inner] = Outer::GROUP.settings else { panic!() };
        assert_eq!((length.name, length.meaning), ("length", " A length."));
        assert!(matches!(length.kind, Kind::Number { unit: "px", bounds } if bounds == above(0.0).at_most(10.0)));
        assert!(matches!(choice.kind, Kind::Choice));
        assert!(matches!(inner.kind, Kind::Group(group) if group.settings.len() == 2));
    }

    #[test]
    fn bounds_match_their_text() {
        for (bounds, inside, outside, text) in [
            (above(0.0), 1e-9, 0.0, "above 0"),
            (at_least(1.0), 1.0, 0.999, "at least 1"),
            (from_to(1.0, 4.99), 4.99, 5.0, "from 1 to 4.99"),
            (above(0.0).at_most(10.0), 10.0, 10.1, "above 0 and at most 10"),
        ] {
            assert_eq!(bounds.to_string(), text);
            assert!(bounds.contains(inside) && !bounds.contains(outside), "{text}");
            assert!(
                [f64::NAN, f64::INFINITY, f64::NEG_INFINITY].iter().all(|value| !bounds.contains(*value)),
                "{text}"
            );
        }
    }
}

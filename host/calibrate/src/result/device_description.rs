//! What was found about a device on the mount, in the form in which terminal and report show it.

use std::fmt;

use evcal_geometry::numerics::statistics::decimals;
use serde::{Deserialize, Serialize};

/// A number with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Uncertain<T> {
    /// The number; `None` or null if it was not measured.
    pub value: T,
    /// Its standard deviation.
    pub sigma: T,
}

/// A unit, and the factor from the unit of a result to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// Its symbol; empty for a ratio.
    pub name: &'static str,
    /// The factor.
    pub factor: f64,
}

impl Unit {
    /// No unit.
    pub const RATIO: Self = Self { name: "", factor: 1.0 };
    /// Of a length in metres.
    pub const MILLIMETRE: Self = Self { name: "mm", factor: 1e3 };
}

/// A number as it is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    /// The number.
    pub value: f64,
    /// Its standard deviation; `None` if it has none.
    pub sigma: Option<f64>,
    /// Number of decimals of both.
    pub decimals: usize,
}

impl Shown {
    fn new(value: f64, sigma: f64) -> Self {
        Self { value, sigma: Some(sigma), decimals: decimals(sigma) }
    }
}

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { value, sigma, decimals } = *self;
        write!(f, "{value:.decimals$}")?;
        sigma.map_or(Ok(()), |sigma| write!(f, " ± {sigma:.decimals$}"))
    }
}

/// A quantity: one value, or one along each axis. A value that was not measured is `None`.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// What it is, with its sign or direction.
    pub name: String,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
    /// The values.
    pub values: Vec<Option<Shown>>,
}

impl Quantity {
    /// Returns a quantity along three axes.
    pub fn along_axes(name: &str, unit: Unit, value: [Option<f64>; 3], sigma: [Option<f64>; 3]) -> Self {
        let shown =
            |(value, sigma): (Option<f64>, Option<f64>)| Some(Shown::new(unit.factor * value?, unit.factor * sigma?));
        Self { name: name.to_owned(), unit: unit.name, values: value.into_iter().zip(sigma).map(shown).collect() }
    }

    /// Returns one number.
    pub fn one(name: &str, unit: Unit, number: Uncertain<f64>) -> Self {
        let shown = Shown::new(unit.factor * number.value, unit.factor * number.sigma);
        Self { name: name.to_owned(), unit: unit.name, values: vec![Some(shown)] }
    }

    /// Returns numbers without standard deviations.
    pub fn plain(name: String, unit: &'static str, values: &[f64], decimals: usize) -> Self {
        let shown = values.iter().map(|&value| Some(Shown { value, sigma: None, decimals }));
        Self { name, unit, values: shown.collect() }
    }

    /// Returns the quantity, not measured unless `is_known`.
    pub fn known_if(self, is_known: bool) -> Self {
        if is_known { self } else { Self { values: vec![None; self.values.len()], ..self } }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: ", self.name)?;
        if self.values.iter().all(Option::is_none) {
            return f.write_str("not measured");
        }
        let shown = |value: &Option<Shown>| value.map_or_else(|| "not measured".to_owned(), |value| value.to_string());
        f.write_str(&self.values.iter().map(shown).collect::<Vec<_>>().join(", "))?;
        if self.unit.is_empty() { Ok(()) } else { write!(f, " {}", self.unit) }
    }
}

/// A device on the mount: its text is a heading and a list of sentences.
#[derive(Clone, Debug, PartialEq)]
pub struct DeviceDescription {
    /// What it is, and from how many observations.
    pub heading: String,
    /// The verdict.
    pub verdict: String,
    /// Its quantities.
    pub quantities: Vec<Quantity>,
    /// What else is to be known of them, as sentences without a full stop.
    pub notes: Vec<String>,
    /// Findings, as sentences.
    pub findings: Vec<String>,
}

impl fmt::Display for DeviceDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:\n  {}", self.heading, self.verdict)?;
        self.quantities.iter().try_for_each(|quantity| write!(f, "\n  {quantity}"))?;
        self.notes.iter().chain(&self.findings).try_for_each(|sentence| write!(f, "\n  {sentence}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_have_the_decimals_of_their_standard_deviation() {
        let (value, sigma) = ([Some(1e-3), None, Some(-2e-3)], [Some(1.2e-5), None, Some(1e-3)]);
        let place = Quantity::along_axes("position", Unit::MILLIMETRE, value, sigma);
        assert_eq!(place.to_string(), "position: 1.000 ± 0.012, not measured, -2.0 ± 1.0 mm");
        assert_eq!(place.known_if(false).to_string(), "position: not measured");
        let ratio = Quantity::one("size", Unit::RATIO, Uncertain { value: 1.0012, sigma: 0.0032 });
        assert_eq!(ratio.to_string(), "size: 1.0012 ± 0.0032");
        assert_eq!(Quantity::plain("noise".to_owned(), "µg/√Hz", &[67.4], 0).to_string(), "noise: 67 µg/√Hz");
    }
}

//! Comparison of the parameters of two calibrations.

use std::fmt;

use evcal_core::camera::{Camera, ModelKind};
use serde::Serialize;

/// One parameter in two calibrations.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ParameterPair {
    /// Name of the parameter.
    pub name: &'static str,
    /// Its value in the first calibration, if the model has it.
    pub first: Option<f64>,
    /// Its value in the second calibration, if the model has it.
    pub second: Option<f64>,
    /// `true` if it has the same meaning in both.
    pub means_the_same: bool,
}

impl ParameterPair {
    /// Returns the second value minus the first, if both have the parameter with the same meaning.
    pub fn difference(&self) -> Option<f64> {
        if self.means_the_same { Some(self.second? - self.first?) } else { None }
    }
}

/// The parameters of two calibrations. Parameters of equal name have the same meaning only if the models are equal: coefficients
/// of different models are not comparable.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IntrinsicsComparison {
    /// Name of the first camera model.
    pub first_model: &'static str,
    /// Name of the second camera model.
    pub second_model: &'static str,
    /// The parameters of the first model in their order, then those that only the second has.
    pub parameters: Vec<ParameterPair>,
}

/// Parameters with the same meaning in all models whose fx and fy are the focal lengths on the axis.
const PINHOLE: [&str; 4] = ["fx", "fy", "cx", "cy"];

/// Compares the parameters of two calibrations.
pub fn compare_intrinsics(first: &Camera<f64>, second: &Camera<f64>) -> IntrinsicsComparison {
    let named = |camera: &Camera<f64>| -> Vec<(&'static str, f64)> {
        camera.kind().parameter_names().iter().copied().zip(camera.parameters()).collect()
    };
    let (first_values, second_values) = (named(first), named(second));
    let value =
        |values: &[(&str, f64)], name: &str| values.iter().find(|(other, _)| *other == name).map(|(_, value)| *value);
    let family = |camera: &Camera<f64>| match camera.kind() {
        ModelKind::Radtan4 | ModelKind::Radtan | ModelKind::Radtan8 => ModelKind::Radtan,
        other => other,
    };
    let same_family = family(first) == family(second);
    // If fx is the focal length on the axis in both, it can be compared.
    let is_plain = |camera: &Camera<f64>| {
        let axial = camera.axial_focal_lengths();
        axial.is_some_and(|[fx, _]| camera.parameters().first().is_some_and(|own| (own - fx).abs() <= 1e-9 * fx))
    };
    let plain = is_plain(first) && is_plain(second);
    let only_second = second_values.iter().filter(|(name, _)| value(&first_values, name).is_none());
    let parameters = first_values
        .iter()
        .chain(only_second)
        .map(|&(name, _)| ParameterPair {
            name,
            first: value(&first_values, name),
            second: value(&second_values, name),
            means_the_same: same_family || (plain && PINHOLE.contains(&name)),
        })
        .collect();
    IntrinsicsComparison { first_model: first.kind().name(), second_model: second.kind().name(), parameters }
}

/// Value from which a number no longer fits its column.
const LARGE: f64 = 1e9;

impl fmt::Display for IntrinsicsComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<5} {:>16} {:>16} {:>12}", "", self.first_model, self.second_model, "difference")?;
        let number = |value: Option<f64>| match value {
            None => "-".to_owned(),
            Some(value) if value.abs() >= LARGE => format!("{value:.5e}"),
            Some(value) => format!("{value:.5}"),
        };
        for pair in &self.parameters {
            let difference = number(pair.difference());
            write!(f, "\n{:<5} {:>16} {:>16} {difference:>12}", pair.name, number(pair.first), number(pair.second))?;
            if pair.name.starts_with('f')
                && let (Some(first), Some(difference)) = (pair.first, pair.difference())
            {
                let percent = 100.0 * difference / first;
                if percent.abs() < LARGE { write!(f, " ({percent:+.3} %)") } else { write!(f, " ({percent:+.3e} %)") }?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parameters_are_paired_by_name() {
        let first = Camera::from_parameters(ModelKind::Radtan4, &[200.0, 201.0, 170.0, 130.0, -0.3, 0.1, 0.001, 0.002])
            .unwrap();
        let second =
            Camera::from_parameters(ModelKind::Radtan, &[201.0, 201.0, 171.0, 129.5, -0.3, 0.1, 0.001, 0.0, -0.02])
                .unwrap();
        let comparison = compare_intrinsics(&first, &second);
        let find = |name: &str| comparison.parameters.iter().find(|pair| pair.name == name).unwrap();
        assert_eq!(find("cy").difference(), Some(-0.5));
        assert_eq!(find("p2").difference(), Some(-0.002));
        assert_eq!((find("k3").first, find("k3").second), (None, Some(-0.02)));
        assert_eq!(comparison.parameters.len(), 9);
        let text = comparison.to_string();
        assert!(text.contains("(+0.500 %)") && text.lines().count() == 10, "{text}");
    }

    /// A focal length of 1e308 was printed with all its 309 digits.
    #[test]
    fn huge_parameters_fit_their_columns() {
        let camera = |f: f64| {
            Camera::from_parameters(ModelKind::Radtan4, &[200.0, f, 170.0, 130.0, -0.3, 0.1, 0.001, 0.002]).unwrap()
        };
        let text = compare_intrinsics(&camera(201.0), &camera(1e308)).to_string();
        assert!(text.contains("1.00000e308") && text.lines().all(|line| line.len() < 80), "{text}");
    }

    /// The difference of k1 of different models is not an error.
    #[test]
    fn coefficients_of_other_models_are_not_subtracted() {
        let first = Camera::from_parameters(ModelKind::Radtan4, &[200.0, 201.0, 170.0, 130.0, -0.3, 0.1, 0.001, 0.002])
            .unwrap();
        let second =
            Camera::from_parameters(ModelKind::KannalaBrandt, &[201.0, 201.0, 171.0, 129.5, 0.02, 0.01, 0.001, 0.0])
                .unwrap();
        let comparison = compare_intrinsics(&first, &second);
        let difference = |name: &str| {
            comparison.parameters.iter().find(|pair| pair.name == name).and_then(ParameterPair::difference)
        };
        assert_eq!((difference("fx"), difference("k1"), difference("k2")), (Some(1.0), None, None));
    }
}

//! The parameters of two calibrations side by side.

use std::fmt;

use evcal_core::camera::Camera;
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
}

impl ParameterPair {
    /// Second less first, where both have the parameter.
    pub fn difference(&self) -> Option<f64> {
        Some(self.second? - self.first?)
    }
}

/// The parameters of two calibrations. Those of equal name mean the same only if the models do.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IntrinsicsComparison {
    /// Name of the first camera model.
    pub first_model: &'static str,
    /// Name of the second camera model.
    pub second_model: &'static str,
    /// The parameters of the first model in their order, then those that only the second has.
    pub parameters: Vec<ParameterPair>,
}

/// Puts the parameters of two calibrations side by side.
pub fn compare_intrinsics(first: &Camera<f64>, second: &Camera<f64>) -> IntrinsicsComparison {
    let named = |camera: &Camera<f64>| -> Vec<(&'static str, f64)> {
        camera.kind().parameter_names().iter().copied().zip(camera.parameters()).collect()
    };
    let (first_values, second_values) = (named(first), named(second));
    let value =
        |values: &[(&str, f64)], name: &str| values.iter().find(|(other, _)| *other == name).map(|(_, value)| *value);
    let only_second = second_values.iter().filter(|(name, _)| value(&first_values, name).is_none());
    let parameters = first_values
        .iter()
        .chain(only_second)
        .map(|&(name, _)| ParameterPair {
            name,
            first: value(&first_values, name),
            second: value(&second_values, name),
        })
        .collect();
    IntrinsicsComparison { first_model: first.kind().name(), second_model: second.kind().name(), parameters }
}

impl fmt::Display for IntrinsicsComparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:<5} {:>16} {:>16} {:>12}", "", self.first_model, self.second_model, "difference")?;
        let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.5}"));
        for pair in &self.parameters {
            let difference = number(pair.difference());
            write!(f, "\n{:<5} {:>16} {:>16} {difference:>12}", pair.name, number(pair.first), number(pair.second))?;
            if pair.name.starts_with('f')
                && let (Some(first), Some(difference)) = (pair.first, pair.difference())
            {
                write!(f, " ({:+.3} %)", 100.0 * difference / first)?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;

    #[test]
    fn parameters_meet_by_name() {
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
}

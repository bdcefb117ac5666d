//! Parameters and their standard deviations as a table.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::format::{Content, Format};
use super::number::decimal;

/// `parameters.csv`: below comments a line of names, then one line a parameter. `sigma` is empty where it is
/// not known; the unit of coefficients is empty.
pub const FORMAT: Format =
    Format { name: "csv", file: "parameters.csv", models: ModelKind::ALL, substitutes: &[], write };

fn write(content: &Content) -> String {
    let calibrated = content.calibrated;
    let (width, height) = calibrated.sensor;
    let mut text = String::new();
    for remark in content.remarks() {
        let _ = writeln!(text, "# {remark}");
    }
    let _ = write!(text, "# model {}, sensor {width} x {height}\nparameter,value,sigma,unit\n", content.model);
    let sigma = calibrated.sigma.as_deref().unwrap_or_default();
    let values = content.matrix.iter().chain(content.distortion);
    for (index, (name, value)) in content.model.parameter_names().iter().zip(values).enumerate() {
        let sigma = sigma.get(index).map(|sigma| decimal(*sigma)).unwrap_or_default();
        let unit = if index < 4 { "px" } else { "" };
        let _ = writeln!(text, "{name},{},{sigma},{unit}", decimal(*value));
    }
    text
}

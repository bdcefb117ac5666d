//! Parameters, their standard deviations and covariances as a table.

use std::fmt::Write as _;

use evcal_core::camera::ModelKind;

use super::content::{Content, ExportFormat};
use super::number::{decimal, significant};
use evcal_core::sensor::Sensor;

/// `parameters.csv`: comments, a line of names, then one line per parameter. `sigma` and the covariances with all parameters
/// (`covariance_fx` …) are empty if they are not known; the unit of coefficients is empty.
pub const FORMAT: ExportFormat = ExportFormat {
    name: "csv",
    program: "the table",
    file: "parameters.csv",
    models: ModelKind::ALL,
    substitutes: &[],
    write,
    first_pixel: 0.0,
    front_only: false,
};

fn write(content: &Content) -> String {
    let calibrated = content.calibrated;
    let Sensor { width, height } = calibrated.sensor;
    let mut text = String::new();
    for remark in content.remarks() {
        let _ = writeln!(text, "# {remark}");
    }
    let names = content.model.parameter_names();
    let _ = write!(text, "# model {}, sensor {width} x {height}\nparameter,value,sigma,unit", content.model);
    names.iter().for_each(|name| text += &format!(",covariance_{name}"));
    text += "\n";
    let sigma = calibrated.sigma.as_deref().unwrap_or_default();
    let values = content.matrix.iter().chain(content.distortion);
    for (index, (name, value)) in names.iter().zip(values).enumerate() {
        let sigma = sigma.get(index).map(|sigma| significant(*sigma)).unwrap_or_default();
        let unit = if index < 4 { "px" } else { "" };
        let _ = write!(text, "{name},{},{sigma},{unit}", decimal(*value));
        let covariances = calibrated.covariance.as_ref().and_then(|rows| rows.get(index));
        for other in 0..names.len() {
            let covariance = covariances.and_then(|row| row.get(other));
            text += &format!(",{}", covariance.map(|value| significant(*value)).unwrap_or_default());
        }
        text += "\n";
    }
    text
}

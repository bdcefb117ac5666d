//! Texts with places for the values of a camera.
//!
//! A place is `$` with a name: a parameter of the model; `$matrix` (fx, fy, cx, cy) and `$distortion` (all coefficients) as lists;
//! `$width`, `$height`; `$name` and `$topic` in quotation marks; `$remarks`, lines of comments that begin with `#`, or `$comment`,
//! the remarks in quotation marks.

use evcal_core::camera::ModelKind;
use evcal_core::sensor::Sensor;

use super::content::Content;
use super::number::{decimal, decimals, quoted};

/// Returns `template` with the values of a camera at their places.
pub fn fill(template: &str, content: &Content) -> String {
    let mut parts = template.split('$');
    let mut text = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(|character: char| !character.is_ascii_alphanumeric()).unwrap_or(part.len());
        let (name, rest) = part.split_at(end);
        text += &value(name, content).unwrap_or_else(|| format!("${name}"));
        text += rest;
    }
    text
}

fn value(name: &str, content: &Content) -> Option<String> {
    let Sensor { width, height } = content.calibrated.sensor;
    let parameter = |kind: ModelKind| {
        let index = kind.parameter_names().iter().position(|other| *other == name)?;
        content.matrix.iter().chain(content.distortion).nth(index).copied().map(decimal)
    };
    match name {
        "width" => Some(width.to_string()),
        "height" => Some(height.to_string()),
        "name" => Some(quoted(&content.calibrated.name)),
        "topic" => Some(quoted(&content.calibrated.ros_topic)),
        "matrix" => Some(decimals(&content.matrix)),
        "distortion" => Some(decimals(content.distortion)),
        "remarks" => Some(content.remarks().iter().map(|remark| format!("# {remark}")).collect::<Vec<_>>().join("\n")),
        "comment" => Some(quoted(&content.remarks().join("; "))),
        _ => parameter(content.model),
    }
}

//! Numbers and poses in the JSON that the program writes.

use nalgebra::{Isometry3, Matrix4, Translation3, UnitQuaternion};
use serde_json::Value;

/// Returns all numbers in nested lists, in order.
pub fn numbers(value: &Value) -> Vec<f64> {
    leaves(value).into_iter().map(|value| value.as_f64().unwrap_or_else(|| panic!("{value} is not a number"))).collect()
}

/// Returns all numbers in nested lists, in order, with NaN for values that were not measured.
pub fn measured_numbers(value: &Value) -> Vec<f64> {
    leaves(value).into_iter().map(|value| value.as_f64().unwrap_or(f64::NAN)).collect()
}

fn leaves(value: &Value) -> Vec<&Value> {
    match value {
        Value::Array(values) => values.iter().flat_map(leaves).collect(),
        value => vec![value],
    }
}

/// Returns the pose whose homogeneous matrix is given row by row.
pub fn pose(value: &Value) -> Isometry3<f64> {
    let matrix = Matrix4::from_row_slice(&numbers(value));
    let rotation = UnitQuaternion::from_matrix(&matrix.fixed_view::<3, 3>(0, 0).into_owned());
    Isometry3::from_parts(Translation3::from(matrix.fixed_view::<3, 1>(0, 3).into_owned()), rotation)
}

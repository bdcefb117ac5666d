//! Points and poses in OpenCV's types.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use opencv::core::{Mat, Vector};
use opencv::prelude::*;

/// Returns one row of points; `point` converts each of them.
pub fn row<P: DataType>(points: &[[f64; 2]], point: impl Fn([f64; 2]) -> P) -> opencv::Result<Mat> {
    Mat::from_exact_iter(points.iter().map(|&from| point(from)))
}

/// Returns a matrix of doubles with `rows` rows.
pub fn matrix(values: &[f64], rows: i32) -> opencv::Result<Mat> {
    Mat::from_slice(values)?.reshape(1, rows)?.try_clone()
}

/// Returns the entries of a matrix of doubles, row by row; `None` for another type or for infinities and NaN.
pub fn doubles(matrix: &Mat) -> Option<Vec<f64>> {
    let values = matrix.reshape(1, 1).ok()?.data_typed::<f64>().ok()?.to_vec();
    values.iter().all(|value| value.is_finite()).then_some(values)
}

/// Returns the poses `T_camera_world`, whose rotations are axis times angle (rad); `None` for each that is not finite.
pub fn poses(rotations: &Vector<Mat>, translations: &Vector<Mat>) -> Vec<Option<Isometry3<f64>>> {
    let pose = |(rotation, translation)| {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(triple(&rotation)?));
        let pose = Isometry3::from_parts(Translation3::from(triple(&translation)?), rotation);
        pose.to_homogeneous().iter().all(|value| value.is_finite()).then_some(pose)
    };
    rotations.iter().zip(translations).map(pose).collect()
}

fn triple(matrix: &Mat) -> Option<[f64; 3]> {
    doubles(matrix)?.try_into().ok()
}

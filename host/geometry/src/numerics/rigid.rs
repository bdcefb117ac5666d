//! Rigid motions: poses from matrices, small steps of a pose, and the rotation between two sets of directions.

use nalgebra::{Isometry3, Matrix3, Matrix4, Rotation3, Translation3, UnitQuaternion, Vector3, Vector6};

/// Returns the pose whose homogeneous matrix has these rows.
pub fn pose_of_rows(rows: &[[f64; 4]; 4]) -> Isometry3<f64> {
    let matrix = Matrix4::from(*rows).transpose();
    let rotation = Rotation3::from_matrix_unchecked(matrix.fixed_view::<3, 3>(0, 0).into_owned());
    let translation = Translation3::from(matrix.fixed_view::<3, 1>(0, 3).into_owned());
    Isometry3::from_parts(translation, UnitQuaternion::from_rotation_matrix(&rotation))
}

/// Returns `pose` with a small rotation (rad, camera axes) from the left and a small translation (m).
pub fn step_pose(pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let rotation = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
    let mut rotation = rotation * pose.rotation;
    rotation.renormalize();
    Isometry3::from_parts(Translation3::from(pose.translation.vector + step.fixed_rows::<3>(3)), rotation)
}

/// Returns the rotation R that minimises Σ |a − R b|² over the pairs (a, b) (Kabsch 1976).
pub fn best_rotation(pairs: impl Iterator<Item = (Vector3<f64>, Vector3<f64>)>) -> Rotation3<f64> {
    let covariance = pairs.map(|(a, b)| a * b.transpose()).sum::<Matrix3<f64>>();
    let svd = covariance.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Rotation3::identity();
    };
    // nalgebra sorts the singular values, so the last direction is the least certain: flip it if the best orthogonal
    // matrix is a reflection.
    let mirror = if (u * v_t).determinant() < 0.0 { -1.0 } else { 1.0 };
    let turn = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror));
    Rotation3::from_matrix_unchecked(u * turn * v_t)
}

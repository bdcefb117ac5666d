//! What an error of the camera's intrinsics does to what lies between camera and capture.
//!
//! It shifts and turns all poses of the camera in nearly the same way: a focal length that is too long puts the camera further from
//! the board, and with it the body further back along the line of sight. No block of time shows that.

use nalgebra::{DMatrix, Isometry3, SMatrix};

use super::error::MotionCaptureError;
use super::fit::{COUNT, Equations, Fitted, Gradient, Normal};
use super::path::Path;
use evcal_geometry::timed_pose::TimedPose;

/// About so many poses are looked at.
const POSES: usize = 500;
/// Numbers of a pose.
const POSE: usize = 6;

/// How sure intrinsics are, and what follows from them.
pub struct IntrinsicsError<'a> {
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// How `T_world_camera`, as it is found from the board, follows them: three rows of its translation (m, axes of the world), three of its
    /// rotation (rad, about the axes of the camera), a column for each intrinsic parameter. `None` for a pose from which the board
    /// cannot be seen.
    pub poses_by: &'a dyn Fn(&Isometry3<f64>) -> Option<DMatrix<f64>>,
}

/// Variance of each parameter of `fitted` by the error of the intrinsics.
///
/// # Errors
/// [`MotionCaptureError::Singular`].
pub fn variances(
    path: &Path,
    capture: &[TimedPose],
    fitted: &Fitted,
    intrinsics: &IntrinsicsError,
) -> Result<Gradient, MotionCaptureError> {
    let at = &fitted.hand_eye;
    let mut equations = Equations::none();
    fitted.priors.add(at, &mut equations.normal, &mut Gradient::zeros());
    let mut right = DMatrix::zeros(COUNT, intrinsics.covariance.nrows());
    for (body, moment) in at.matched(path, capture).step_by((fitted.used / POSES).max(1)) {
        let Some(pose_by) = (intrinsics.poses_by)(&moment.pose) else { continue };
        let (error, by) = at.row(body, &moment);
        let weights = fitted.spread.weights(&error);
        equations.add(&error, &by, &fitted.spread);
        let weighted = SMatrix::<f64, COUNT, POSE>::from_fn(|row, column| by[(column, row)] * weights[column / 3]);
        right += weighted * at.by_camera_pose(&moment) * pose_by;
    }
    let normal: Normal = equations.normal;
    let follows = normal.cholesky().ok_or(MotionCaptureError::Singular)?.solve(&right);
    let variance = |row: usize| (follows.row(row) * &intrinsics.covariance * follows.row(row).transpose())[(0, 0)];
    Ok(Gradient::from_fn(|row, _| variance(row).max(0.0)))
}

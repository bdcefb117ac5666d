//! Effect of an error of the camera's intrinsics on the relation of camera and capture.
//!
//! It shifts and rotates all poses of the camera in nearly the same way: a focal length that is too long moves the camera away
//! from the board, and with it the marker body along the line of sight. Blocks of time do not show that.

use nalgebra::{DMatrix, Isometry3, SMatrix};

use super::error::MotionCaptureError;
use super::fit::{COUNT, Equations, Fitted, Gradient, Normal};
use super::path::Path;
use evcal_geometry::timed_pose::TimedPose;

/// Approximate number of poses that are evaluated.
const POSES: usize = 500;
/// Number of parameters of a pose.
const POSE: usize = 6;

/// Uncertainty of intrinsics, and its effect on poses.
pub struct IntrinsicsError<'a> {
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Derivatives of `T_world_camera`, as estimated from the board, by the intrinsics: three rows of its translation (m, axes of
    /// the world), three of its rotation (rad, about the axes of the camera), and a column for each intrinsic parameter. `None`
    /// for a pose from which the board is not visible.
    pub poses_by: &'a dyn Fn(&Isometry3<f64>) -> Option<DMatrix<f64>>,
}

/// Returns the variance of each parameter of `fitted` from the error of the intrinsics.
///
/// # Errors
/// [`MotionCaptureError::Singular`] if the poses do not determine the parameters.
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

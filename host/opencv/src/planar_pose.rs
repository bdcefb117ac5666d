//! The pose of a plane.

use nalgebra::Isometry3;
use opencv::core::{CV_64F, Mat, Point2d, Point3d, Vector, no_array};
use opencv::prelude::*;

use super::{MINIMUM_POINTS, OpencvError};
use crate::functions::{GENERIC_IPPE, SOLVEPNP_IPPE, solve_pnp_generic, solve_pnp_ransac};
use crate::matrices::{poses, row};
use crate::threads::call;

/// Result of [`solve_pnp_ransac_ippe`].
#[derive(Clone, Debug, PartialEq)]
pub struct RansacPose {
    /// `T_camera_world`, the better solution first; a plane that appears small has two that fit almost
    /// equally well.
    pub solutions: Vec<Isometry3<f64>>,
    /// Indices of the points that agree with the pose, ascending.
    pub inliers: Vec<usize>,
}

/// Estimates the pose of a plane by OpenCV's `solvePnPRansac`, then IPPE (Collins & Bartoli 2014) on its inliers.
///
/// `object` are points on the board plane in metres, `normalised` their undistorted images x/z, y/z, `threshold` the
/// largest distance of an inlier in the same unit (pixels divided by focal length), `iterations` the largest number of
/// samples. Returns `Ok(None)` if there is no pose with at least [`MINIMUM_POINTS`] inliers.
pub fn solve_pnp_ransac_ippe(
    object: &[[f64; 2]],
    normalised: &[[f64; 2]],
    threshold: f64,
    iterations: u16,
) -> Result<Option<RansacPose>, OpencvError> {
    const CALL: &str = "solvePnPRansac";
    if object.len() != normalised.len()
        || object.len() < MINIMUM_POINTS
        || !object.iter().chain(normalised).flatten().all(|value| value.is_finite())
    {
        return Err(OpencvError::Input { call: CALL });
    }
    let ransac = || {
        let (mut rotation, mut translation, mut inliers) = (Mat::default(), Mat::default(), Mat::default());
        let found = solve_pnp_ransac(
            &row(object, object_point)?,
            &row(normalised, image_point)?,
            &identity()?,
            &no_array(),
            &mut rotation,
            &mut translation,
            false,
            i32::from(iterations),
            threshold as f32,
            0.999,
            &mut inliers,
            SOLVEPNP_IPPE,
        )?;
        if found && !inliers.empty() {
            Ok(inliers.reshape(1, 1)?.data_typed::<i32>()?.to_vec())
        } else {
            Ok(Vec::new())
        }
    };
    let mut inliers: Vec<usize> = call(CALL, ransac)?
        .into_iter()
        .filter_map(|index| usize::try_from(index).ok().filter(|&index| index < object.len()))
        .collect();
    inliers.sort_unstable();
    inliers.dedup();
    if inliers.len() < MINIMUM_POINTS {
        return Ok(None);
    }
    let chosen = |points: &[[f64; 2]]| -> Vec<[f64; 2]> {
        inliers.iter().filter_map(|&index| points.get(index).copied()).collect()
    };
    let solutions = solve_ippe(&chosen(object), &chosen(normalised))?;
    Ok((!solutions.is_empty()).then_some(RansacPose { solutions, inliers }))
}

/// Returns both poses `T_camera_world` of a plane by IPPE, the better one first; points as in
/// [`solve_pnp_ransac_ippe`].
pub fn solve_ippe(object: &[[f64; 2]], normalised: &[[f64; 2]]) -> Result<Vec<Isometry3<f64>>, OpencvError> {
    const CALL: &str = "solvePnPGeneric";
    if object.len() != normalised.len() || object.len() < MINIMUM_POINTS {
        return Err(OpencvError::Input { call: CALL });
    }
    let ippe = || {
        let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        solve_pnp_generic(
            &row(object, object_point)?,
            &row(normalised, image_point)?,
            &identity()?,
            &no_array(),
            &mut rotations,
            &mut translations,
            false,
            GENERIC_IPPE,
            &no_array(),
            &no_array(),
            &mut no_array(),
        )?;
        Ok((rotations, translations))
    };
    let (rotations, translations) = call(CALL, ippe)?;
    Ok(poses(&rotations, &translations).into_iter().flatten().collect())
}

fn object_point([x, y]: [f64; 2]) -> Point3d {
    Point3d::new(x, y, 0.0)
}

fn image_point([x, y]: [f64; 2]) -> Point2d {
    Point2d::new(x, y)
}

/// Returns the camera matrix of undistorted points x/z, y/z.
fn identity() -> opencv::Result<Mat> {
    Mat::eye(3, 3, CV_64F)?.to_mat()
}

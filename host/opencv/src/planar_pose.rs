//! The pose of a plane.

use nalgebra::Isometry3;

use super::{MINIMUM_POINTS, OpencvError, bridge, isometry};

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
    if object.len() != normalised.len()
        || object.len() < MINIMUM_POINTS
        || !object.iter().chain(normalised).flatten().all(|value| value.is_finite())
    {
        return Err(OpencvError::Input { call: "solvePnPRansac" });
    }
    let mut inliers: Vec<usize> = bridge::solve_pnp_ransac(object, normalised, iterations, threshold as f32)?
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
    if object.len() != normalised.len() || object.len() < MINIMUM_POINTS {
        return Err(OpencvError::Input { call: "solvePnPGeneric" });
    }
    Ok(bridge::solve_ippe(object, normalised)?.iter().filter_map(isometry).collect())
}

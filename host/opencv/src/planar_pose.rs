//! The pose of a plane.

use nalgebra::Isometry3;
use opencv::calib3d;
use opencv::core::{self, Mat, Vector, no_array};
use opencv::prelude::*;

use super::{MINIMUM_POINTS, OpencvError, SINGLE_THREAD, doubles, exception, points_2d, points_3d, pose};

/// Result of [`solve_pnp_ransac_ippe`].
#[derive(Clone, Debug, PartialEq)]
pub struct RansacPose {
    /// `T_camera_world`, the better solution first; a plane seen at a small angle has two that fit
    /// almost equally well.
    pub solutions: Vec<Isometry3<f64>>,
    /// Indices of the points that agree with the pose, ascending.
    pub inliers: Vec<usize>,
}

/// Pose of a plane by OpenCV's `solvePnPRansac`, then IPPE (Collins & Bartoli 2014) on its inliers.
///
/// `object` are points on the board plane in metres, `normalised` their images x/z, y/z free of
/// distortion, `threshold` the largest distance of an inlier in the same unit (pixels over focal
/// length), `iterations` the largest number of samples. `Ok(None)`: no pose with at least
/// [`MINIMUM_POINTS`] inliers.
pub fn solve_pnp_ransac_ippe(
    object: &[[f64; 2]],
    normalised: &[[f64; 2]],
    threshold: f64,
    iterations: u16,
) -> Result<Option<RansacPose>, OpencvError> {
    const CALL: &str = "solvePnPRansac";
    SINGLE_THREAD.clone()?;
    if object.len() != normalised.len()
        || object.len() < MINIMUM_POINTS
        || !object.iter().chain(normalised).flatten().all(|value| value.is_finite())
    {
        return Err(OpencvError::Input { call: CALL });
    }
    let ransac = || -> opencv::Result<_> {
        let (mut rotation, mut translation, mut inliers) = (Mat::default(), Mat::default(), Mat::default());
        let found = calib3d::solve_pnp_ransac(
            &points_3d(object)?,
            &points_2d(normalised)?,
            &Mat::eye(3, 3, core::CV_64F)?.to_mat()?,
            &no_array(),
            &mut rotation,
            &mut translation,
            false,
            i32::from(iterations),
            threshold as f32,
            0.999,
            &mut inliers,
            calib3d::SOLVEPNP_IPPE,
        )?;
        let inliers = if found { inliers.reshape(1, 1)?.data_typed::<i32>()?.to_vec() } else { Vec::new() };
        Ok(inliers)
    };
    let mut inliers: Vec<usize> = ransac()
        .map_err(|error| exception(CALL, error))?
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

/// Both poses `T_camera_world` of a plane by IPPE, the one that fits better first; points as in
/// [`solve_pnp_ransac_ippe`].
pub fn solve_ippe(object: &[[f64; 2]], normalised: &[[f64; 2]]) -> Result<Vec<Isometry3<f64>>, OpencvError> {
    const CALL: &str = "solvePnPGeneric";
    SINGLE_THREAD.clone()?;
    if object.len() != normalised.len() || object.len() < MINIMUM_POINTS {
        return Err(OpencvError::Input { call: CALL });
    }
    let run = || -> opencv::Result<_> {
        let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        calib3d::solve_pnp_generic(
            &points_3d(object)?,
            &points_2d(normalised)?,
            &Mat::eye(3, 3, core::CV_64F)?.to_mat()?,
            &no_array(),
            &mut rotations,
            &mut translations,
            false,
            calib3d::SolvePnPMethod::SOLVEPNP_IPPE,
            &no_array(),
            &no_array(),
            &mut no_array(),
        )?;
        Ok((rotations, translations))
    };
    let (rotations, translations) = run().map_err(|error| exception(CALL, error))?;
    Ok(rotations.iter().zip(translations).filter_map(|(r, t)| pose(&doubles(&r)?, &doubles(&t)?)).collect())
}

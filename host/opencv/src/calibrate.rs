//! Cameras from views of a board.

use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use opencv::calib3d;
use opencv::core::{self, Mat, Point2d, Scalar, Size, TermCriteria, Vector, no_array};
use opencv::prelude::*;

use super::{
    OpencvError, SINGLE_THREAD, View, doubles, matrix, points_2d, points_2f, points_3d, points_3f, poses, usable,
    with_room,
};

/// Which distortion coefficients `calibrateCamera` may move; the others stay zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PinholeDistortion {
    /// k1, k2, p1, p2.
    RadialTangential4,
    /// k1, k2, p1, p2, k3.
    RadialTangential5,
    /// k1, k2, p1, p2, k3, k4, k5, k6 (rational).
    RadialTangential8,
    /// k1, k2, k3 without tangential terms.
    Radial3,
}

impl PinholeDistortion {
    /// Length of the coefficient vector in OpenCV's order.
    pub fn coefficient_count(self) -> usize {
        match self {
            Self::RadialTangential4 => 4,
            Self::RadialTangential5 | Self::Radial3 => 5,
            Self::RadialTangential8 => 8,
        }
    }

    fn flags(self) -> i32 {
        match self {
            Self::RadialTangential4 => calib3d::CALIB_FIX_K3,
            Self::RadialTangential5 => 0,
            Self::RadialTangential8 => calib3d::CALIB_RATIONAL_MODEL,
            Self::Radial3 => calib3d::CALIB_ZERO_TANGENT_DIST,
        }
    }
}

/// Camera matrix and distortion in OpenCV's order.
#[derive(Clone, Debug, PartialEq)]
pub struct Intrinsics {
    /// Focal lengths fx, fy in pixels.
    pub focal: [f64; 2],
    /// Principal point cx, cy in pixels.
    pub center: [f64; 2],
    /// k1, k2, p1, p2, … of a pinhole camera, k1 … k4 of a fisheye camera.
    pub distortion: Vec<f64>,
}

/// A calibration by OpenCV.
#[derive(Clone, Debug, PartialEq)]
pub struct OpencvCalibration {
    /// The camera.
    pub intrinsics: Intrinsics,
    /// Root mean square of the distances between measured and projected points, in pixels.
    pub rms: f64,
    /// Index of each used view in the input.
    pub views: Vec<usize>,
    /// Root mean square distance of each used view, in pixels.
    pub view_rms: Vec<f64>,
    /// `T_camera_world` of each used view.
    pub poses: Vec<Isometry3<f64>>,
}

/// Most iterations of a calibration, and the relative change of the parameters that ends it. The
/// bundle refinement goes on from there.
const CALIBRATION_ITERATIONS: i32 = 40;
const CALIBRATION_CHANGE: f64 = 1e-7;

fn intrinsics_of(camera_matrix: &Mat, distortion: &Mat, coefficients: usize) -> Option<Intrinsics> {
    let &[fx, _, cx, _, fy, cy, _, _, _] = doubles(camera_matrix)?.as_slice() else { return None };
    let distortion = doubles(distortion)?.get(..coefficients)?.to_vec();
    (fx > 0.0 && fy > 0.0).then_some(Intrinsics { focal: [fx, fy], center: [cx, cy], distortion })
}

/// What a calibration of OpenCV gives back.
struct RawCalibration {
    camera_matrix: Mat,
    coefficients: Mat,
    rms: f64,
    view_rms: Vec<f64>,
    rotations: Vector<Mat>,
    translations: Vector<Mat>,
}

impl RawCalibration {
    /// `None` unless all of it is there, for this number of views and of coefficients, and finite.
    fn checked(self, views: usize, coefficients: usize) -> Option<OpencvCalibration> {
        let intrinsics = intrinsics_of(&self.camera_matrix, &self.coefficients, coefficients)?;
        let poses = poses(&self.rotations, &self.translations)?;
        let Self { rms, view_rms, .. } = self;
        let finite = rms.is_finite() && view_rms.iter().all(|rms| rms.is_finite());
        let complete = finite && view_rms.len() == views && poses.len() == views;
        complete.then(|| OpencvCalibration { intrinsics, rms, views: (0..views).collect(), view_rms, poses })
    }
}

/// OpenCV's `calibrateCamera` (Zhang 2000) on `views` of a planar board.
///
/// `sensor` is (width, height) in pixels and serves for the first guess of the principal point.
/// With a `guess` the iteration starts there. Views with fewer than [`MINIMUM_POINTS`](super::MINIMUM_POINTS) points are
/// an error: the caller chooses its views.
pub fn calibrate_pinhole(
    views: &[View],
    sensor: Sensor,
    distortion: PinholeDistortion,
    guess: Option<&Intrinsics>,
) -> Result<OpencvCalibration, OpencvError> {
    const CALL: &str = "calibrateCamera";
    SINGLE_THREAD.clone()?;
    if views.is_empty() || !views.iter().all(usable) {
        return Err(OpencvError::Input { call: CALL });
    }
    let run = || -> opencv::Result<_> {
        let object: Vector<Mat> = views.iter().map(|v| points_3f(&v.object)).collect::<opencv::Result<_>>()?;
        let image: Vector<Mat> = views.iter().map(|v| points_2f(&v.image)).collect::<opencv::Result<_>>()?;
        let mut start = vec![0.0; distortion.coefficient_count()];
        let mut camera_matrix = Mat::eye(3, 3, core::CV_64F)?.to_mat()?;
        // LU is much faster than the default SVD, and the refinement that follows needs no more.
        let mut flags = distortion.flags() | calib3d::CALIB_USE_LU;
        if let Some(guess) = guess {
            flags |= calib3d::CALIB_USE_INTRINSIC_GUESS;
            let [fx, fy] = guess.focal;
            let [cx, cy] = guess.center;
            camera_matrix = matrix(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], 3)?;
            start.iter_mut().zip(&guess.distortion).for_each(|(start, guess)| *start = *guess);
        }
        let mut coefficients = matrix(&start, 1)?;
        let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        let mut view_rms = Mat::default();
        let rms = calib3d::calibrate_camera_extended(
            &object,
            &image,
            Size::new(i32::from(sensor.width), i32::from(sensor.height)),
            &mut camera_matrix,
            &mut coefficients,
            &mut rotations,
            &mut translations,
            &mut no_array(),
            &mut no_array(),
            &mut view_rms,
            flags,
            TermCriteria { typ: 3, max_count: CALIBRATION_ITERATIONS, epsilon: CALIBRATION_CHANGE },
        )?;
        let view_rms = doubles(&view_rms).unwrap_or_default();
        Ok(RawCalibration { camera_matrix, coefficients, rms, view_rms, rotations, translations })
    };
    let raw = with_room(CALL, run)?;
    raw.checked(views.len(), distortion.coefficient_count()).ok_or(OpencvError::Unusable { call: CALL })
}

fn calibrate_fisheye_once(views: &[&View], sensor: Sensor, iterations: i32) -> Result<OpencvCalibration, OpencvError> {
    const CALL: &str = "fisheye::calibrate";
    let run = || -> opencv::Result<_> {
        let object: Vector<Mat> = views.iter().map(|v| points_3d(&v.object)).collect::<opencv::Result<_>>()?;
        let image: Vector<Mat> = views.iter().map(|v| points_2d(&v.image)).collect::<opencv::Result<_>>()?;
        let mut camera_matrix = Mat::eye(3, 3, core::CV_64F)?.to_mat()?;
        let mut coefficients = Mat::new_rows_cols_with_default(4, 1, core::CV_64F, Scalar::all(0.0))?;
        let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        let rms = calib3d::calibrate(
            &object,
            &image,
            Size::new(i32::from(sensor.width), i32::from(sensor.height)),
            &mut camera_matrix,
            &mut coefficients,
            &mut rotations,
            &mut translations,
            calib3d::Fisheye_CALIB_RECOMPUTE_EXTRINSIC | calib3d::Fisheye_CALIB_FIX_SKEW,
            TermCriteria { typ: 3, max_count: iterations, epsilon: CALIBRATION_CHANGE },
        )?;
        let mut view_rms = Vec::with_capacity(views.len());
        for (index, view) in views.iter().enumerate() {
            let mut projected = Mat::default();
            calib3d::fisheye_project_points_vec_def(
                &object.get(index)?,
                &mut projected,
                &rotations.get(index)?,
                &translations.get(index)?,
                &camera_matrix,
                &coefficients,
            )?;
            let sum: f64 = projected
                .data_typed::<Point2d>()?
                .iter()
                .zip(&view.image)
                .map(|(p, q)| (p.x - q[0]).powi(2) + (p.y - q[1]).powi(2))
                .sum();
            view_rms.push((sum / view.image.len() as f64).sqrt());
        }
        Ok(RawCalibration { camera_matrix, coefficients, rms, view_rms, rotations, translations })
    };
    let raw = with_room(CALL, run)?;
    raw.checked(views.len(), 4).ok_or(OpencvError::Unusable { call: CALL })
}

/// The views among `indices` that OpenCV's fisheye calibration can digest, found by halving.
fn digestible(views: &[View], indices: &[usize], sensor: Sensor) -> Vec<usize> {
    // Below a handful of views the calibration itself is undetermined, and a failure says nothing.
    const SMALLEST_SET: usize = 3;
    let chosen: Vec<&View> = indices.iter().filter_map(|&index| views.get(index)).collect();
    if calibrate_fisheye_once(&chosen, sensor, 3).is_ok() {
        return indices.to_vec();
    }
    if indices.len() < 2 * SMALLEST_SET {
        return Vec::new();
    }
    let (first, second) = indices.split_at(indices.len() / 2);
    let mut kept = digestible(views, first, sensor);
    kept.extend(digestible(views, second, sensor));
    kept
}

/// OpenCV's `fisheye::calibrate` (Kannala-Brandt, k1 … k4) on `views` of a planar board.
///
/// It throws when a single view displeases it; such views are searched out and left away. What was
/// used is in [`OpencvCalibration::views`].
pub fn calibrate_fisheye(views: &[View], sensor: Sensor) -> Result<OpencvCalibration, OpencvError> {
    SINGLE_THREAD.clone()?;
    if views.is_empty() || !views.iter().all(usable) {
        return Err(OpencvError::Input { call: "fisheye::calibrate" });
    }
    let all: Vec<&View> = views.iter().collect();
    let error = match calibrate_fisheye_once(&all, sensor, CALIBRATION_ITERATIONS) {
        Ok(calibration) => return Ok(calibration),
        Err(error) => error,
    };
    let indices: Vec<usize> = (0..views.len()).collect();
    let kept = digestible(views, &indices, sensor);
    if kept.is_empty() || kept.len() == views.len() {
        return Err(error);
    }
    let chosen: Vec<&View> = kept.iter().filter_map(|&index| views.get(index)).collect();
    calibrate_fisheye_once(&chosen, sensor, CALIBRATION_ITERATIONS)
        .map(|calibration| OpencvCalibration { views: kept, ..calibration })
}

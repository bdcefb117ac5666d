//! Calibration of cameras from views of a board.

use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;
use opencv::core::{
    CV_64F, Mat, Point2d, Point2f, Point3d, Point3f, Scalar, Size, TermCriteria, TermCriteria_COUNT, TermCriteria_EPS,
    Vector, no_array,
};
use opencv::prelude::*;

use super::{OpencvError, View, usable};
use crate::functions;
use crate::matrices::{doubles, matrix, poses, row};
use crate::threads::call_with_large_stack;

/// Distortion coefficients that `calibrateCamera` estimates; the others stay zero.
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
    /// Returns the length of the coefficient vector in OpenCV's order.
    pub fn coefficient_count(self) -> usize {
        match self {
            Self::RadialTangential4 => 4,
            Self::RadialTangential5 | Self::Radial3 => 5,
            Self::RadialTangential8 => 8,
        }
    }

    fn flags(self) -> i32 {
        match self {
            Self::RadialTangential4 => functions::CALIB_FIX_K3,
            Self::RadialTangential5 => 0,
            Self::RadialTangential8 => functions::CALIB_RATIONAL_MODEL,
            Self::Radial3 => functions::CALIB_ZERO_TANGENT_DIST,
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

/// Largest number of iterations of a calibration, and the relative change of the parameters at which it ends. The
/// bundle adjustment continues from the result.
const CALIBRATION_ITERATIONS: i32 = 40;
const CALIBRATION_CHANGE: f64 = 1e-7;

fn criteria(iterations: i32) -> TermCriteria {
    let typ = TermCriteria_COUNT | TermCriteria_EPS;
    TermCriteria { typ, max_count: iterations, epsilon: CALIBRATION_CHANGE }
}

fn size(sensor: Sensor) -> Size {
    Size::new(i32::from(sensor.width), i32::from(sensor.height))
}

/// The result of a calibration in OpenCV's types.
struct RawCalibration {
    camera_matrix: Mat,
    coefficients: Mat,
    rms: f64,
    view_rms: Vec<f64>,
    rotations: Vector<Mat>,
    translations: Vector<Mat>,
}

impl RawCalibration {
    /// Returns `None` unless all of it exists for this number of views and coefficients and is finite, and the focal
    /// lengths are positive.
    fn checked(self, views: usize, coefficients: usize) -> Option<OpencvCalibration> {
        let Self { rms, view_rms, .. } = self;
        let &[fx, _, cx, _, fy, cy, _, _, _] = doubles(&self.camera_matrix)?.as_slice() else { return None };
        // calibrateCamera can return more coefficients than it has estimated.
        let distortion = doubles(&self.coefficients)?.get(..coefficients)?.to_vec();
        let poses: Vec<_> = poses(&self.rotations, &self.translations).into_iter().collect::<Option<_>>()?;
        let finite = view_rms.iter().chain([&rms]).all(|rms| rms.is_finite());
        let complete = view_rms.len() == views && poses.len() == views;
        let intrinsics = Intrinsics { focal: [fx, fy], center: [cx, cy], distortion };
        let usable = finite && complete && fx > 0.0 && fy > 0.0;
        usable.then(|| OpencvCalibration { intrinsics, rms, views: (0..views).collect(), view_rms, poses })
    }
}

/// Calls OpenCV's `calibrateCamera` (Zhang 2000) on `views` of a planar board.
///
/// `sensor` is the size in pixels, used for the initial principal point. With a `guess` the iteration starts there.
/// Views with fewer than [`MINIMUM_POINTS`](super::MINIMUM_POINTS) points are an error: the caller chooses the views.
pub fn calibrate_pinhole(
    views: &[View],
    sensor: Sensor,
    distortion: PinholeDistortion,
    guess: Option<&Intrinsics>,
) -> Result<OpencvCalibration, OpencvError> {
    const CALL: &str = "calibrateCamera";
    if views.is_empty() || !views.iter().all(usable) {
        return Err(OpencvError::Input { call: CALL });
    }
    let run = || {
        let row_of_object = |view: &View| row(&view.object, |[x, y]| Point3f::new(x as f32, y as f32, 0.0));
        let row_of_image = |view: &View| row(&view.image, |[x, y]| Point2f::new(x as f32, y as f32));
        let object: Vector<Mat> = views.iter().map(row_of_object).collect::<opencv::Result<_>>()?;
        let image: Vector<Mat> = views.iter().map(row_of_image).collect::<opencv::Result<_>>()?;
        let mut start = vec![0.0; distortion.coefficient_count()];
        let mut camera_matrix = Mat::eye(3, 3, CV_64F)?.to_mat()?;
        // LU is much faster than the default SVD, and the refinement that follows needs no more.
        let mut flags = distortion.flags() | functions::CALIB_USE_LU;
        if let Some(&Intrinsics { focal: [fx, fy], center: [cx, cy], ref distortion }) = guess {
            flags |= functions::CALIB_USE_INTRINSIC_GUESS;
            camera_matrix = matrix(&[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0], 3)?;
            start.iter_mut().zip(distortion).for_each(|(start, guess)| *start = *guess);
        }
        let mut coefficients = matrix(&start, 1)?;
        let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        let mut view_rms = Mat::default();
        let rms = functions::calibrate_camera_extended(
            &object,
            &image,
            size(sensor),
            &mut camera_matrix,
            &mut coefficients,
            &mut rotations,
            &mut translations,
            &mut no_array(),
            &mut no_array(),
            &mut view_rms,
            flags,
            criteria(CALIBRATION_ITERATIONS),
        )?;
        let view_rms = doubles(&view_rms).unwrap_or_default();
        Ok(RawCalibration { camera_matrix, coefficients, rms, view_rms, rotations, translations })
    };
    let raw = call_with_large_stack(CALL, run)?;
    raw.checked(views.len(), distortion.coefficient_count()).ok_or(OpencvError::Unusable { call: CALL })
}

fn calibrate_fisheye_once(views: &[&View], sensor: Sensor, iterations: i32) -> Result<OpencvCalibration, OpencvError> {
    const CALL: &str = "fisheye::calibrate";
    let run = || {
        let row_of_object = |view: &&View| row(&view.object, |[x, y]| Point3d::new(x, y, 0.0));
        let row_of_image = |view: &&View| row(&view.image, |[x, y]| Point2d::new(x, y));
        let object: Vector<Mat> = views.iter().map(row_of_object).collect::<opencv::Result<_>>()?;
        let image: Vector<Mat> = views.iter().map(row_of_image).collect::<opencv::Result<_>>()?;
        let mut camera_matrix = Mat::eye(3, 3, CV_64F)?.to_mat()?;
        let mut coefficients = Mat::new_rows_cols_with_default(4, 1, CV_64F, Scalar::all(0.0))?;
        let (mut rotations, mut translations) = (Vector::<Mat>::new(), Vector::<Mat>::new());
        let rms = functions::fisheye_calibrate(
            &object,
            &image,
            size(sensor),
            &mut camera_matrix,
            &mut coefficients,
            &mut rotations,
            &mut translations,
            functions::FISHEYE_RECOMPUTE_EXTRINSIC | functions::FISHEYE_FIX_SKEW,
            criteria(iterations),
        )?;
        let mut view_rms = Vec::with_capacity(views.len());
        for (index, view) in views.iter().enumerate() {
            let mut projected = Vector::<Point2d>::new();
            functions::fisheye_project_points(
                &object.get(index)?,
                &mut projected,
                &rotations.get(index)?,
                &translations.get(index)?,
                &camera_matrix,
                &coefficients,
            )?;
            let distances = projected.iter().zip(&view.image).map(|(p, [x, y])| (p.x - x).powi(2) + (p.y - y).powi(2));
            view_rms.push((distances.sum::<f64>() / view.image.len() as f64).sqrt());
        }
        Ok(RawCalibration { camera_matrix, coefficients, rms, view_rms, rotations, translations })
    };
    let raw = call_with_large_stack(CALL, run)?;
    raw.checked(views.len(), 4).ok_or(OpencvError::Unusable { call: CALL })
}

/// Returns the views among `indices` that OpenCV's fisheye calibration accepts, found by bisection.
fn digestible(views: &[View], indices: &[usize], sensor: Sensor) -> Vec<usize> {
    // With fewer views the calibration itself is undetermined, so a failure is not informative.
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

/// Calls OpenCV's `fisheye::calibrate` (Kannala-Brandt, k1 … k4) on `views` of a planar board.
///
/// OpenCV throws an exception because of a single unsuitable view; such views are found and excluded.
/// [`OpencvCalibration::views`] lists the views used.
pub fn calibrate_fisheye(views: &[View], sensor: Sensor) -> Result<OpencvCalibration, OpencvError> {
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

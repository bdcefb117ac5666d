//! Everything that evcal asks of OpenCV, behind plain inputs and outputs.
//!
//! Guarantees: no OpenCV type leaves this module, every `cv::Exception` arrives as an
//! [`OpencvError`], results that are not finite are errors too, and OpenCV runs on the calling
//! thread only, so that its results do not depend on the number of threads.

use std::sync::LazyLock;

use evcal_core::pattern::{Layout, Pattern};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use opencv::core::{self, Mat, Point2d, Point2f, Point3d, Point3f, Scalar, Size, TermCriteria, Vector};
use opencv::prelude::*;
use opencv::{calib3d, core::no_array};

/// The fewest points of a view that fix its homography.
pub const MINIMUM_POINTS: usize = 4;

/// Why a call of OpenCV gave no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OpencvError {
    /// OpenCV threw an exception.
    #[error("OpenCV's {call} failed: {message}")]
    Exception {
        /// The function called.
        call: &'static str,
        /// What OpenCV said.
        message: String,
    },
    /// OpenCV returned, but with infinities or NaN, or a shape that its manual does not name.
    #[error("OpenCV's {call} gave a result that is not usable")]
    Unusable {
        /// The function called.
        call: &'static str,
    },
    /// The views handed in cannot be calibrated.
    #[error("{call} needs views of at least {MINIMUM_POINTS} points with as many image points as object points")]
    Input {
        /// The function called.
        call: &'static str,
    },
}

/// Points of one view of the board.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct View {
    /// Points on the board plane (z = 0), in metres.
    pub object: Vec<[f64; 2]>,
    /// Their images in pixels, in the same order.
    pub image: Vec<[f64; 2]>,
}

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
pub struct Calibration {
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

/// Stack of the calibrations: OpenBLAS, which many machines have in place of the reference BLAS, puts
/// work space on the stack that the usual 2 to 8 MiB cannot hold.
const STACK: usize = 64 << 20;

/// Runs a calibration with room on its stack.
fn with_room<T: Send>(call: &'static str, work: impl FnOnce() -> opencv::Result<T> + Send) -> Result<T, OpencvError> {
    let outcome = std::thread::scope(|scope| {
        let thread = std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, work);
        let thread = thread.map_err(|error| OpencvError::Exception { call, message: error.to_string() })?;
        Ok(thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic)))
    })?;
    outcome.map_err(|error| exception(call, error))
}

static SINGLE_THREAD: LazyLock<Result<(), OpencvError>> =
    LazyLock::new(|| core::set_num_threads(1).map_err(|error| exception("setNumThreads", error)));

fn exception(call: &'static str, error: opencv::Error) -> OpencvError {
    OpencvError::Exception { call, message: error.message.trim().to_owned() }
}

fn points_3f(points: &[[f64; 2]]) -> opencv::Result<Mat> {
    Mat::from_exact_iter(points.iter().map(|p| Point3f::new(p[0] as f32, p[1] as f32, 0.0)))
}

fn points_2f(points: &[[f64; 2]]) -> opencv::Result<Mat> {
    Mat::from_exact_iter(points.iter().map(|p| Point2f::new(p[0] as f32, p[1] as f32)))
}

fn points_3d(points: &[[f64; 2]]) -> opencv::Result<Mat> {
    Mat::from_exact_iter(points.iter().map(|p| Point3d::new(p[0], p[1], 0.0)))
}

fn points_2d(points: &[[f64; 2]]) -> opencv::Result<Mat> {
    Mat::from_exact_iter(points.iter().map(|p| Point2d::new(p[0], p[1])))
}

fn matrix(values: &[f64], rows: i32) -> opencv::Result<Mat> {
    Mat::from_slice(values)?.reshape(1, rows)?.try_clone()
}

/// The entries of a matrix of doubles, row by row; `None` for any other matrix or for infinities.
fn doubles(mat: &Mat) -> Option<Vec<f64>> {
    let values = mat.reshape(1, 1).ok()?.data_typed::<f64>().ok()?.to_vec();
    values.iter().all(|value| value.is_finite()).then_some(values)
}

fn pose(rotation: &[f64], translation: &[f64]) -> Option<Isometry3<f64>> {
    let (&[rx, ry, rz], &[tx, ty, tz]) = (rotation, translation) else { return None };
    let pose = Isometry3::from_parts(
        Translation3::new(tx, ty, tz),
        UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz)),
    );
    pose.to_homogeneous().iter().all(|value| value.is_finite()).then_some(pose)
}

fn poses(rotations: &Vector<Mat>, translations: &Vector<Mat>) -> Option<Vec<Isometry3<f64>>> {
    rotations.iter().zip(translations).map(|(r, t)| pose(&doubles(&r)?, &doubles(&t)?)).collect()
}

fn usable(view: &View) -> bool {
    view.object.len() == view.image.len()
        && view.object.len() >= MINIMUM_POINTS
        && view.object.iter().chain(&view.image).flatten().all(|value| value.is_finite())
}

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
    fn checked(self, views: usize, coefficients: usize) -> Option<Calibration> {
        let intrinsics = intrinsics_of(&self.camera_matrix, &self.coefficients, coefficients)?;
        let poses = poses(&self.rotations, &self.translations)?;
        let Self { rms, view_rms, .. } = self;
        let finite = rms.is_finite() && view_rms.iter().all(|rms| rms.is_finite());
        let complete = finite && view_rms.len() == views && poses.len() == views;
        complete.then(|| Calibration { intrinsics, rms, views: (0..views).collect(), view_rms, poses })
    }
}

/// OpenCV's `calibrateCamera` (Zhang 2000) on `views` of a planar board.
///
/// `sensor` is (width, height) in pixels and serves for the first guess of the principal point.
/// With a `guess` the iteration starts there. Views with fewer than [`MINIMUM_POINTS`] points are
/// an error: the caller chooses its views.
pub fn calibrate_pinhole(
    views: &[View],
    sensor: (u16, u16),
    distortion: PinholeDistortion,
    guess: Option<&Intrinsics>,
) -> Result<Calibration, OpencvError> {
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
            Size::new(i32::from(sensor.0), i32::from(sensor.1)),
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

fn calibrate_fisheye_once(views: &[&View], sensor: (u16, u16), iterations: i32) -> Result<Calibration, OpencvError> {
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
            Size::new(i32::from(sensor.0), i32::from(sensor.1)),
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
fn digestible(views: &[View], indices: &[usize], sensor: (u16, u16)) -> Vec<usize> {
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
/// used is in [`Calibration::views`].
pub fn calibrate_fisheye(views: &[View], sensor: (u16, u16)) -> Result<Calibration, OpencvError> {
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
        .map(|calibration| Calibration { views: kept, ..calibration })
}

/// Result of [`solve_pnp_ransac_ippe`].
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarPose {
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
) -> Result<Option<PlanarPose>, OpencvError> {
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
    Ok((!solutions.is_empty()).then_some(PlanarPose { solutions, inliers }))
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

/// OpenCV's `findCirclesGrid` on candidate centres (pixels): for every circle of the board, in board
/// order, the index of its candidate. `None` when the board was not found.
///
/// OpenCV does not check that the order is not mirrored; the caller does.
pub fn find_circles_grid(points: &[Vector2<f64>], pattern: Pattern) -> Result<Option<Vec<usize>>, OpencvError> {
    const CALL: &str = "findCirclesGrid";
    SINGLE_THREAD.clone()?;
    if points.len() < pattern.circle_count() || !points.iter().all(|p| p.x.is_finite() && p.y.is_finite()) {
        return Ok(None);
    }
    let flags = match pattern.layout {
        Layout::Asymmetric => calib3d::CALIB_CB_ASYMMETRIC_GRID,
        Layout::Symmetric => calib3d::CALIB_CB_SYMMETRIC_GRID,
    };
    let run = || -> opencv::Result<_> {
        let candidates: Vector<Point2f> = points.iter().map(|p| Point2f::new(p.x as f32, p.y as f32)).collect();
        let mut centers = Vector::<Point2f>::new();
        let size = Size::new(i32::from(pattern.columns), i32::from(pattern.rows));
        let found = calib3d::find_circles_grid(&candidates, size, &mut centers, flags, None)?;
        Ok(found.then_some(centers))
    };
    let Some(centers) = run().map_err(|error| exception(CALL, error))? else { return Ok(None) };
    // The second of OpenCV's attempts returns points that it has moved to and fro through a
    // homography, so they equal their candidates but for rounding.
    const ROUNDING: f64 = 0.01;
    let mut order = Vec::with_capacity(centers.len());
    for center in centers {
        let center = Vector2::new(f64::from(center.x), f64::from(center.y));
        let nearest = points
            .iter()
            .enumerate()
            .map(|(index, point)| ((point - center).norm(), index))
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        match nearest {
            Some((distance, index)) if distance < ROUNDING && !order.contains(&index) => order.push(index),
            _ => return Ok(None),
        }
    }
    Ok((order.len() == pattern.circle_count()).then_some(order))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: (u16, u16) = (346, 260);

    fn object() -> Vec<[f64; 2]> {
        (0..35).map(|index| [f64::from(index % 7) * 0.04, f64::from(index / 7) * 0.04]).collect()
    }

    fn pose_of_view(view: u32) -> Isometry3<f64> {
        let wave = |rate: f64| (rate * f64::from(view)).sin();
        let tilt = UnitQuaternion::from_euler_angles(0.5 * wave(1.1), 0.5 * wave(2.3), 0.4 * wave(0.7));
        Isometry3::from_parts(Translation3::new(-0.12 + 0.05 * wave(1.7), -0.08 + 0.04 * wave(0.4), 0.4), tilt)
    }

    /// x/z, y/z of the board's points.
    fn normalised(pose: &Isometry3<f64>) -> Vec<[f64; 2]> {
        object()
            .iter()
            .map(|point| pose * nalgebra::Point3::new(point[0], point[1], 0.0))
            .map(|point| [point.x / point.z, point.y / point.z])
            .collect()
    }

    fn views(distort: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<View> {
        (0..20)
            .map(|view| View {
                object: object(),
                image: normalised(&pose_of_view(view)).into_iter().map(&distort).collect(),
            })
            .collect()
    }

    fn brown([x, y]: [f64; 2]) -> [f64; 2] {
        let (k1, k2, p1, p2) = (-0.3, 0.1, 1e-3, -2e-3);
        let s = x * x + y * y;
        let d = 1.0 + k1 * s + k2 * s * s;
        let u = x * d + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x);
        let v = y * d + 2.0 * p2 * x * y + p1 * (s + 2.0 * y * y);
        [345.0 * u + 170.0, 344.0 * v + 127.0]
    }

    fn equidistant([x, y]: [f64; 2]) -> [f64; 2] {
        let r = x.hypot(y);
        let theta = r.atan();
        let d = theta * (1.0 + 0.02 * theta.powi(2) - 0.01 * theta.powi(4));
        let scale = if r > 0.0 { d / r } else { 1.0 };
        [210.0 * x * scale + 174.0, 209.0 * y * scale + 131.0]
    }

    #[test]
    fn pinhole_calibration_finds_the_camera_and_the_poses() {
        let calibration = calibrate_pinhole(&views(brown), SENSOR, PinholeDistortion::RadialTangential4, None).unwrap();
        let Intrinsics { focal, center, distortion } = &calibration.intrinsics;
        // Points go to OpenCV in single precision.
        for (found, truth) in focal.iter().chain(center).zip([345.0, 344.0, 170.0, 127.0]) {
            assert!((found - truth).abs() < 0.01, "{found} {truth}");
        }
        for (found, truth) in distortion.iter().zip([-0.3, 0.1, 1e-3, -2e-3]) {
            assert!((found - truth).abs() < 1e-3, "{found} {truth}");
        }
        assert!(calibration.rms < 1e-3 && calibration.view_rms.iter().all(|rms| *rms < 1e-3));
        for (view, pose) in calibration.poses.iter().enumerate() {
            assert!((pose.to_homogeneous() - pose_of_view(view as u32).to_homogeneous()).norm() < 1e-3);
        }
        let again = calibrate_pinhole(
            &views(brown),
            SENSOR,
            PinholeDistortion::RadialTangential8,
            Some(&calibration.intrinsics),
        );
        assert_eq!(again.unwrap().intrinsics.distortion.len(), 8);
    }

    #[test]
    fn fisheye_calibration_finds_the_camera_and_leaves_out_a_view_that_it_cannot_digest() {
        let mut views = views(equidistant);
        // All points of a view in one: no homography, an exception from OpenCV.
        let point = views[4].image[0];
        views[4].image.iter_mut().for_each(|image| *image = point);
        let calibration = calibrate_fisheye(&views, SENSOR).unwrap();
        assert!(!calibration.views.contains(&4) && calibration.views.len() >= 14, "{:?}", calibration.views);
        let Intrinsics { focal, center, .. } = calibration.intrinsics;
        for (found, truth) in focal.iter().chain(&center).zip([210.0, 209.0, 174.0, 131.0]) {
            assert!((found - truth).abs() < 0.1, "{found} {truth}");
        }
    }

    #[test]
    fn what_cannot_be_calibrated_is_an_error_and_no_abort() {
        let line = View {
            object: (0..10).map(|index| [f64::from(index), 0.0]).collect(),
            image: (0..10).map(|index| [f64::from(index), 0.0]).collect(),
        };
        let unequal = View { object: object(), image: vec![[0.0; 2]; 3] };
        let nan = View { object: object(), image: vec![[f64::NAN; 2]; 35] };
        for views in [vec![], vec![line; 5], vec![unequal], vec![nan]] {
            assert!(calibrate_pinhole(&views, SENSOR, PinholeDistortion::RadialTangential5, None).is_err());
            assert!(calibrate_fisheye(&views, SENSOR).is_err());
        }
    }

    #[test]
    fn pnp_finds_the_pose_and_the_outliers() {
        let truth = pose_of_view(3);
        let mut image = normalised(&truth);
        for index in [2, 17, 30] {
            image[index][0] += 0.05;
        }
        let found = solve_pnp_ransac_ippe(&object(), &image, 3.0 / 345.0, 100).unwrap().unwrap();
        let expected: Vec<usize> = (0..35).filter(|index| ![2, 17, 30].contains(index)).collect();
        assert_eq!(found.inliers, expected);
        assert!((found.solutions[0].to_homogeneous() - truth.to_homogeneous()).norm() < 1e-6);
        assert!(solve_pnp_ransac_ippe(&object()[..3], &image[..3], 0.01, 100).is_err());
    }

    #[test]
    fn grid_of_clean_points_is_found_in_board_order() {
        let pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };
        let points: Vec<Vector2<f64>> = (0..pattern.circle_count())
            .map(|index| {
                let (x, y) = pattern.lattice_position(index);
                Vector2::new(60.0 + 24.0 * f64::from(x) + 2.0 * f64::from(y), 30.0 + 20.0 * f64::from(y))
            })
            .collect();
        let shuffled: Vec<Vector2<f64>> = (0..36).map(|index| points[index * 7 % 36]).collect();
        let order = find_circles_grid(&shuffled, pattern).unwrap().unwrap();
        for (index, candidate) in order.into_iter().enumerate() {
            assert_eq!(shuffled[candidate], points[index]);
        }
        assert_eq!(find_circles_grid(&points[..30], pattern), Ok(None));
    }
}

#![doc = include_str!("../README.md")]
// No input makes it panic; the program prints.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod calibrate;
mod circles_grid;
mod opencv_start;
mod planar_pose;
mod start;
#[cfg(test)]
mod tests;

use std::sync::LazyLock;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use opencv::core::{self, Mat, Point2d, Point2f, Point3d, Point3f, Vector};
use opencv::prelude::*;

pub use calibrate::{Intrinsics, OpencvCalibration, PinholeDistortion, calibrate_fisheye, calibrate_pinhole};
pub use circles_grid::find_circles_grid;
pub use planar_pose::{RansacPose, solve_ippe, solve_pnp_ransac_ippe};
pub use start::{Opencv, WHOLE_BOARD};

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

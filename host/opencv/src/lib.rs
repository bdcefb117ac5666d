#![doc = include_str!("../README.md")]
// These lints hold because no input may cause a panic, and because only the program prints, never a library.
#![deny(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable, clippy::get_unwrap)]
#![deny(clippy::print_stdout, clippy::print_stderr)]

mod calibrate;
mod circles_grid;
mod functions;
mod matrices;
mod opencv_start;
mod planar_pose;
mod start;
#[cfg(test)]
mod tests;
mod threads;

pub use calibrate::{Intrinsics, OpencvCalibration, PinholeDistortion, calibrate_fisheye, calibrate_pinhole};
pub use circles_grid::find_circles_grid;
pub use planar_pose::{RansacPose, solve_ippe, solve_pnp_ransac_ippe};
pub use start::{Opencv, WHOLE_BOARD};

/// Smallest number of points of a view that determines its homography.
pub const MINIMUM_POINTS: usize = 4;

/// Reason why a call of OpenCV had no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum OpencvError {
    /// OpenCV threw an exception.
    #[error("OpenCV's {call} failed: {message}")]
    Exception {
        /// The function called.
        call: &'static str,
        /// Error message of OpenCV.
        message: String,
    },
    /// OpenCV's result contains infinities or NaN, or has a shape that its manual does not describe.
    #[error("OpenCV's {call} returned an unusable result")]
    Unusable {
        /// The function called.
        call: &'static str,
    },
    /// The given views cannot be calibrated.
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

fn usable(view: &View) -> bool {
    view.object.len() == view.image.len()
        && view.object.len() >= MINIMUM_POINTS
        && view.object.iter().chain(&view.image).flatten().all(|value| value.is_finite())
}

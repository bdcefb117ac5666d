//! Comparison of a calibration's trajectory with a file of motion capture.

use std::io;
use std::path::{Path, PathBuf};

use evcal_files::remedies;
use evcal_files::text;
use nalgebra::Isometry3;

use super::comparison::TRAJECTORY_FILE;
use super::pose_by_intrinsics::{KnownCamera, pose_by_intrinsics};
use evcal_geometry::lens::camera_file::camera_path;
use evcal_geometry::tum::{self, TumError};
use evcal_solve::motion_capture::error::MotionCaptureError;
use evcal_solve::motion_capture::file::{self, CaptureFileError};
use evcal_solve::motion_capture::intrinsics_error::IntrinsicsError;
use evcal_solve::motion_capture::{Compared, compare};

/// The files to compare.
#[derive(Clone, Debug)]
pub struct CapturedFiles {
    /// The calibration file or its folder.
    pub calibration: PathBuf,
    /// Trajectory (TUM); `None` for `trajectory.txt` next to the calibration.
    pub trajectory: Option<PathBuf>,
    /// The capture.
    pub capture: PathBuf,
    /// The marker body on the camera, if the capture contains several.
    pub body: Option<String>,
}

/// Reasons why files cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CapturedError {
    /// The trajectory cannot be opened.
    #[error("{}: {error}: give the trajectory of the camera", file.display())]
    Open {
        /// The trajectory.
        file: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// The trajectory cannot be read.
    #[error("{}: {error}", file.display())]
    Trajectory {
        /// The trajectory.
        file: PathBuf,
        /// The reason.
        error: TumError,
    },
    /// The capture cannot be read.
    #[error("{0}")]
    Capture(#[from] CaptureFileError),
    /// Trajectory and capture are inconsistent.
    #[error("{} and {}: {error}", trajectory.display(), capture.display())]
    Compare {
        /// The trajectory.
        trajectory: PathBuf,
        /// The capture.
        capture: PathBuf,
        /// The reason.
        error: MotionCaptureError,
    },
}

remedies! { CapturedError, say;
    Self::Open { .. } => "give it with {}", say.trajectory?;
    Self::Capture(error) => error.remedy(say);
}

/// Compares the trajectory of a calibration with a capture. Returns the result and the name of the trajectory's file. If the
/// camera is known, σ include the error of its intrinsics.
///
/// # Errors
/// [`CapturedError`] names the file, the problem and the remedy.
pub fn compare_captured(
    files: &CapturedFiles,
    known: Option<&KnownCamera>,
) -> Result<(PathBuf, Compared), CapturedError> {
    let default_path = || camera_path(&files.calibration).with_file_name(TRAJECTORY_FILE);
    let trajectory = files.trajectory.clone().unwrap_or_else(default_path);
    let camera = read_trajectory(&trajectory)?;
    let capture = file::read(&files.capture, files.body.as_deref())?;
    let poses_by = |pose: &Isometry3<f64>| known.and_then(|known| pose_by_intrinsics(known, pose));
    let intrinsics = known.map(|known| IntrinsicsError { covariance: known.covariance.clone(), poses_by: &poses_by });
    match compare(&camera, &capture, intrinsics.as_ref()) {
        Ok(compared) => Ok((trajectory, compared)),
        Err(error) => Err(CapturedError::Compare { trajectory, capture: files.capture.clone(), error }),
    }
}

fn read_trajectory(path: &Path) -> Result<Vec<evcal_geometry::timed_pose::TimedPose>, CapturedError> {
    let text = text::table(path).map_err(|error| CapturedError::Open { file: path.to_owned(), error })?;
    tum::read(text.as_bytes()).map_err(|error| CapturedError::Trajectory { file: path.to_owned(), error })
}

//! Comparison of a calibration with the truth or another calibration, from their files.

use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;
use evcal_files::remedies;
use evcal_files::text;

use super::intrinsics::{IntrinsicsComparison, compare_intrinsics};
use super::printed_board::{BoardComparison, compare_boards};
use super::trajectory_error::{AbsoluteTrajectoryError, Association, TooFewMatches, best_time_shift, trajectory_error};
use evcal_geometry::lens::camera_file::{self, CameraFileError, camera_path};
use evcal_geometry::lens::projection_difference::{NoCommonView, ProjectionDifference, projection_difference};
use evcal_geometry::timed_pose::TimedPose;
use evcal_geometry::tum::{self, TumError};

/// Name of the trajectory file next to a calibration or truth.
pub const TRAJECTORY_FILE: &str = "trajectory.txt";

/// The files to compare.
#[derive(Clone, Debug)]
pub struct ComparedFiles {
    /// The calibration file or its folder.
    pub calibration: PathBuf,
    /// The truth or another calibration: the file or its folder.
    pub truth: PathBuf,
    /// Estimated trajectory (TUM); `None` for [`TRAJECTORY_FILE`] next to the calibration, if it exists.
    pub trajectory: Option<PathBuf>,
    /// True trajectory; `None` for [`TRAJECTORY_FILE`] next to the truth, if it exists.
    pub true_trajectory: Option<PathBuf>,
    /// Largest constant difference of the clocks in the search, in seconds.
    pub time_shift: f64,
}

/// Comparison of a calibration with the truth.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The calibration's file.
    pub calibration: PathBuf,
    /// The truth's file.
    pub truth: PathBuf,
    /// Comparison of the parameters; the truth is the first calibration.
    pub intrinsics: IntrinsicsComparison,
    /// Difference of the projections.
    pub projection: ProjectionDifference,
    /// The board, if one of the files contains a shape other than the nominal one.
    pub board: Option<BoardComparison>,
    /// The trajectories, if both have one.
    pub trajectory: ComparedTrajectories,
}

/// Result of the comparison of the trajectories.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum ComparedTrajectories {
    /// At least one does not exist.
    Missing,
    /// The files next to the cameras have no common times: they are of different recordings.
    OtherTimes {
        /// The estimated trajectory's file.
        estimate: PathBuf,
        /// The true trajectory's file.
        truth: PathBuf,
    },
    /// The file next to a camera is empty: no pose was determined well enough.
    WithoutPoses(PathBuf),
    /// They were compared.
    Compared(Box<TrajectoryComparison>),
}

/// Comparison of two trajectories.
#[derive(Clone, Debug)]
pub struct TrajectoryComparison {
    /// The estimated trajectory's file.
    pub estimate: PathBuf,
    /// The true trajectory's file.
    pub truth: PathBuf,
    /// Error with the original times.
    pub direct: AbsoluteTrajectoryError,
    /// Error with the best time shift of the estimate; `None` if too few poses are left.
    pub shifted: Option<AbsoluteTrajectoryError>,
}

impl TrajectoryComparison {
    /// Returns `true` if both are of one recording, that is if one follows the other.
    pub fn is_related(&self) -> bool {
        self.direct.is_related() || self.shifted.as_ref().is_some_and(AbsoluteTrajectoryError::is_related)
    }
}

/// Source of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryOf {
    /// The estimated one.
    Calibration,
    /// The one with which it is compared.
    Truth,
}

impl fmt::Display for TrajectoryOf {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Calibration => "the calibration",
            Self::Truth => "the truth",
        })
    }
}

/// Reasons why files cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CompareError {
    /// A camera cannot be read.
    #[error("{0}")]
    Camera(#[from] CameraFileError),
    /// They are of different sensors.
    #[error(
        "{} is for a sensor of {}x{} pixels, {} for one of {}x{}: they cannot be compared",
        calibration.display(), sensor.width, sensor.height, truth.display(), true_sensor.width, true_sensor.height
    )]
    SensorsDiffer {
        /// The calibration.
        calibration: PathBuf,
        /// Its sensor.
        sensor: Sensor,
        /// The truth.
        truth: PathBuf,
        /// Its sensor.
        true_sensor: Sensor,
    },
    /// The cameras have no common field of view.
    #[error("{0}")]
    Projection(#[from] NoCommonView),
    /// One trajectory was named, and the other does not exist at its default path.
    #[error("there is no {TRAJECTORY_FILE} next to {}: name the trajectory of {which} too", file.display())]
    NoTrajectory {
        /// The camera file next to which the trajectory is missing.
        file: PathBuf,
        /// Source of the trajectory.
        which: TrajectoryOf,
    },
    /// A trajectory cannot be opened.
    #[error("{}: {error}", file.display())]
    Open {
        /// The trajectory.
        file: PathBuf,
        /// The error of the system.
        error: io::Error,
    },
    /// A trajectory cannot be read.
    #[error("{}: {error}", file.display())]
    Trajectory {
        /// The trajectory.
        file: PathBuf,
        /// The reason.
        error: TumError,
    },
    /// The trajectories have too few common times.
    #[error("{} and {}: {error}", estimate.display(), truth.display())]
    FewPoses {
        /// The estimated trajectory.
        estimate: PathBuf,
        /// The true trajectory.
        truth: PathBuf,
        /// The reason.
        error: TooFewMatches,
    },
}

remedies! { CompareError, say;
    Self::NoTrajectory { which: TrajectoryOf::Calibration, .. } => "give it with {}", say.trajectory?;
    Self::NoTrajectory { which: TrajectoryOf::Truth, .. } => "give it with {}", say.true_trajectory?;
}

/// Compares a calibration with the truth or with another calibration.
///
/// # Errors
/// [`CompareError`] if a file cannot be read, or they are not of the same camera.
pub fn compare(files: &ComparedFiles) -> Result<Comparison, CompareError> {
    let (calibration, truth) = (camera_path(&files.calibration), camera_path(&files.truth));
    let (camera, sensor) = camera_file::read(&calibration)?;
    let (true_camera, true_sensor) = camera_file::read(&truth)?;
    if sensor != true_sensor {
        return Err(CompareError::SensorsDiffer { calibration, sensor, truth, true_sensor });
    }
    let intrinsics = compare_intrinsics(&true_camera, &camera);
    let projection = projection_difference(&true_camera, &camera, sensor)?;
    let board = compare_boards(&calibration, &truth);
    let named = files.trajectory.is_some() || files.true_trajectory.is_some();
    let trajectory = match trajectories(files, &calibration, &truth)? {
        None => ComparedTrajectories::Missing,
        Some((estimate, truth)) => match compare_trajectories(estimate, truth, files.time_shift) {
            Ok(compared) => ComparedTrajectories::Compared(Box::new(compared)),
            // They were not requested.
            Err(CompareError::FewPoses { estimate, truth, .. }) if !named => {
                ComparedTrajectories::OtherTimes { estimate, truth }
            }
            Err(CompareError::Trajectory { file, error: TumError::Empty }) if !named => {
                ComparedTrajectories::WithoutPoses(file)
            }
            Err(error) => return Err(error),
        },
    };
    Ok(Comparison { calibration, truth, intrinsics, projection, board, trajectory })
}

/// Returns the estimated and the true trajectory file; `None` if none was requested and not both exist.
fn trajectories(
    files: &ComparedFiles,
    calibration: &Path,
    truth: &Path,
) -> Result<Option<(PathBuf, PathBuf)>, CompareError> {
    let trajectory_next_to = |file: &Path| Some(file.with_file_name(TRAJECTORY_FILE)).filter(|path| path.exists());
    let estimate = files.trajectory.clone().or_else(|| trajectory_next_to(calibration));
    let real = files.true_trajectory.clone().or_else(|| trajectory_next_to(truth));
    let missing = |which, file: &Path| CompareError::NoTrajectory { file: file.to_owned(), which };
    match (estimate, real) {
        (Some(estimate), Some(real)) => Ok(Some((estimate, real))),
        (Some(_), None) if files.trajectory.is_some() => Err(missing(TrajectoryOf::Truth, truth)),
        (None, Some(_)) if files.true_trajectory.is_some() => Err(missing(TrajectoryOf::Calibration, calibration)),
        _ => Ok(None),
    }
}

fn read_trajectory(path: &Path) -> Result<Vec<TimedPose>, CompareError> {
    let text = text::table(path).map_err(|error| CompareError::Open { file: path.to_owned(), error })?;
    tum::read(text.as_bytes()).map_err(|error| CompareError::Trajectory { file: path.to_owned(), error })
}

fn compare_trajectories(estimate: PathBuf, truth: PathBuf, range: f64) -> Result<TrajectoryComparison, CompareError> {
    let (estimated, real) = (read_trajectory(&estimate)?, read_trajectory(&truth)?);
    let error = |shift| trajectory_error(&real, &estimated, Association::Interpolated, shift);
    let direct = match error(0.0) {
        Ok(direct) => direct,
        Err(error) => return Err(CompareError::FewPoses { estimate, truth, error }),
    };
    let shifted = best_time_shift(&real, &estimated, range).and_then(|shift| error(shift).ok());
    Ok(TrajectoryComparison { estimate, truth, direct, shifted })
}

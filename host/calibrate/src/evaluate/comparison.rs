//! A calibration against the truth or another calibration, from their files.

use std::fmt;
use std::fs::File;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;

use super::intrinsics::{IntrinsicsComparison, compare_intrinsics};
use super::printed_board::{BoardComparison, compare_boards};
use super::trajectory_error::{AbsoluteTrajectoryError, Association, TooFewMatches, best_time_shift, trajectory_error};
use evcal_geometry::lens::camera_file::{self, CameraFileError, camera_path};
use evcal_geometry::lens::projection_difference::{NoCommonView, ProjectionDifference, projection_difference};
use evcal_geometry::timed_pose::TimedPose;
use evcal_geometry::tum::{self, TumError};

/// Name of the trajectory beside a calibration or truth.
pub const TRAJECTORY_FILE: &str = "trajectory.txt";

/// What is compared with what.
#[derive(Clone, Debug)]
pub struct ComparedFiles {
    /// The calibration, or its folder.
    pub calibration: PathBuf,
    /// The truth or another calibration, or its folder.
    pub truth: PathBuf,
    /// Estimated trajectory (TUM); without it, [`TRAJECTORY_FILE`] beside the calibration, if it is there.
    pub trajectory: Option<PathBuf>,
    /// True trajectory; without it, [`TRAJECTORY_FILE`] beside the truth, if it is there.
    pub true_trajectory: Option<PathBuf>,
    /// Largest constant difference of the clocks that is looked for, in seconds.
    pub time_shift: f64,
}

/// How far a calibration is from the truth.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// The calibration's file.
    pub calibration: PathBuf,
    /// The truth's file.
    pub truth: PathBuf,
    /// Parameter by parameter; the truth is the first.
    pub intrinsics: IntrinsicsComparison,
    /// Where both put the same point in the image.
    pub projection: ProjectionDifference,
    /// The board, where one of both says that it is not as stated.
    pub board: Option<BoardComparison>,
    /// The trajectories, if both have one.
    pub trajectory: ComparedTrajectories,
}

/// What became of the trajectories.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub enum ComparedTrajectories {
    /// Not both have one.
    Missing,
    /// They lie beside the cameras, but not at the same times: they are of different recordings.
    OtherTimes {
        /// The estimated trajectory's file.
        estimate: PathBuf,
        /// The true trajectory's file.
        truth: PathBuf,
    },
    /// The one beside a camera is empty: no pose was sure enough to be written.
    WithoutPoses(PathBuf),
    /// They were compared.
    Compared(Box<TrajectoryComparison>),
}

/// How far a trajectory is from the true one.
#[derive(Clone, Debug)]
pub struct TrajectoryComparison {
    /// The estimated trajectory's file.
    pub estimate: PathBuf,
    /// The true trajectory's file.
    pub truth: PathBuf,
    /// With the times as they are.
    pub direct: AbsoluteTrajectoryError,
    /// With the times of the estimate shifted to fit best; `None` where too little is left.
    pub shifted: Option<AbsoluteTrajectoryError>,
}

impl TrajectoryComparison {
    /// Whether both are of one recording: whether one follows the other at all.
    pub fn is_related(&self) -> bool {
        self.direct.is_related() || self.shifted.as_ref().is_some_and(AbsoluteTrajectoryError::is_related)
    }
}

/// Whose trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrajectoryOf {
    /// The estimated one.
    Calibration,
    /// The one that it is compared with.
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

/// Why files cannot be compared.
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
    /// The cameras see nothing in common.
    #[error("{0}")]
    Projection(#[from] NoCommonView),
    /// One trajectory was named, and the other is not where it is looked for.
    #[error("there is no {TRAJECTORY_FILE} beside {}: name the trajectory of {which} too", file.display())]
    NoTrajectory {
        /// What the trajectory is not beside.
        file: PathBuf,
        /// Whose it is.
        which: TrajectoryOf,
    },
    /// A trajectory cannot be opened.
    #[error("{}: {error}", file.display())]
    Open {
        /// The trajectory.
        file: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// A trajectory cannot be read.
    #[error("{}: {error}", file.display())]
    Trajectory {
        /// The trajectory.
        file: PathBuf,
        /// Why.
        error: TumError,
    },
    /// The trajectories have too little in common.
    #[error("{} and {}: {error}", estimate.display(), truth.display())]
    FewPoses {
        /// The estimated trajectory.
        estimate: PathBuf,
        /// The true trajectory.
        truth: PathBuf,
        /// Why.
        error: TooFewMatches,
    },
}

/// Compares a calibration with the truth or with another calibration.
///
/// # Errors
/// [`CompareError`] when a file cannot be read, or they are not of the same camera.
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
            // Nobody asked for them.
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

/// The estimated and the true trajectory file; `None` when none was asked for and not both are there.
fn trajectories(
    files: &ComparedFiles,
    calibration: &Path,
    truth: &Path,
) -> Result<Option<(PathBuf, PathBuf)>, CompareError> {
    let beside = |file: &Path| Some(file.with_file_name(TRAJECTORY_FILE)).filter(|path| path.exists());
    let estimate = files.trajectory.clone().or_else(|| beside(calibration));
    let real = files.true_trajectory.clone().or_else(|| beside(truth));
    let missing = |which, file: &Path| CompareError::NoTrajectory { file: file.to_owned(), which };
    match (estimate, real) {
        (Some(estimate), Some(real)) => Ok(Some((estimate, real))),
        (Some(_), None) if files.trajectory.is_some() => Err(missing(TrajectoryOf::Truth, truth)),
        (None, Some(_)) if files.true_trajectory.is_some() => Err(missing(TrajectoryOf::Calibration, calibration)),
        _ => Ok(None),
    }
}

fn read_trajectory(path: &Path) -> Result<Vec<TimedPose>, CompareError> {
    let file = File::open(path).map_err(|error| CompareError::Open { file: path.to_owned(), error })?;
    tum::read(BufReader::new(file)).map_err(|error| CompareError::Trajectory { file: path.to_owned(), error })
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

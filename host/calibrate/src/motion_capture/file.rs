//! Files of motion capture: poses of a body in the frame of the capture, `T_mocap_body`.
//!
//! | format | known by |
//! |---|---|
//! | OptiTrack Motive CSV | its first line, which begins with `Format Version` |
//! | EuRoC (`state_groundtruth_estimate0`, `vicon0`) | its first line, which begins with `#timestamp` |
//! | TUM, `t tx ty tz qx qy qz qw` | anything else |

mod euroc;
mod motive;

use std::io;
use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use evcal_geometry::timed_pose::TimedPose;
use evcal_geometry::tum::{self, TumError};

/// How far the length of a quaternion may be from 1.
const UNIT_LENGTH: f64 = 0.01;

/// Why a capture cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct CaptureFileError {
    /// The file.
    pub path: PathBuf,
    /// Why.
    pub reason: CaptureError,
}

/// What is wrong with the content of a capture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// The system says so.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// No pose of a trajectory in TUM form.
    #[error("{0}; EuRoC's CSV with its first line and the CSV of OptiTrack Motive are read too")]
    Tum(#[from] TumError),
    /// A field that is no number.
    #[error("line {line}: {text:?} is not a number: mend or delete the line")]
    Number {
        /// Number of the line, from 1.
        line: usize,
        /// What is there.
        text: String,
    },
    /// A quaternion that is no rotation.
    #[error("line {line}: the quaternion has length {length:.3}, not 1: check the order of the columns")]
    Length {
        /// Number of the line, from 1.
        line: usize,
        /// Its length.
        length: f64,
    },
    /// Times that do not rise.
    #[error("line {line}: its time is not after that of the line before: sort the lines, and leave out doubles")]
    Order {
        /// Number of the line, from 1.
        line: usize,
    },
    /// Angles in place of quaternions.
    #[error("rotations are {found:?}: export from Motive with Rotation Type Quaternion")]
    RotationType {
        /// What the file says.
        found: String,
    },
    /// A unit that is not known.
    #[error("lengths are in {found:?}: export from Motive in Meters, Centimeters or Millimeters")]
    LengthUnits {
        /// What the file says.
        found: String,
    },
    /// Positions relative to something else.
    #[error("the coordinate space is {found:?}: export from Motive with Coordinate Space Global")]
    CoordinateSpace {
        /// What the file says.
        found: String,
    },
    /// No rigid body.
    #[error("there is no rigid body in the file: export from Motive with rigid bodies, in one file")]
    NoBody,
    /// Another rigid body was asked for.
    #[error("there is no rigid body {wanted:?}; there are {names}: name one of them")]
    OtherBodies {
        /// What was asked for.
        wanted: String,
        /// Those of the file.
        names: String,
    },
    /// Which one?
    #[error("there are several rigid bodies, {names}: name that on the camera")]
    SeveralBodies {
        /// Those of the file.
        names: String,
    },
    /// A name without a choice.
    #[error("only files of OptiTrack Motive name bodies: name none")]
    NoNames,
    /// No pose.
    #[error("there is no pose in the file")]
    Empty,
}

/// Reads the poses of a body, `body` where the file holds several; times in seconds on the clock of the capture.
///
/// # Errors
/// [`CaptureFileError`] names the line.
pub fn read(path: &Path, body: Option<&str>) -> Result<Vec<TimedPose>, CaptureFileError> {
    let poses = std::fs::read_to_string(path).map_err(CaptureError::from).and_then(|text| parse(&text, body));
    poses.map_err(|reason| CaptureFileError { path: path.to_owned(), reason })
}

fn parse(text: &str, body: Option<&str>) -> Result<Vec<TimedPose>, CaptureError> {
    let text = text.trim_start_matches('\u{feff}');
    let poses = if text.starts_with("Format Version") {
        motive::parse(text, body)?
    } else if body.is_some() {
        return Err(CaptureError::NoNames);
    } else if text.starts_with("#timestamp") {
        euroc::parse(text)?
    } else {
        tum::read(text.as_bytes())?
    };
    if poses.is_empty() { Err(CaptureError::Empty) } else { Ok(poses) }
}

fn number(field: Option<&&str>, line: usize) -> Result<f64, CaptureError> {
    let text = field.copied().unwrap_or_default().trim();
    let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
    value.ok_or_else(|| CaptureError::Number { line, text: text.to_owned() })
}

/// Appends the pose of a line; the quaternion is w x y z.
fn push(
    poses: &mut Vec<TimedPose>,
    line: usize,
    t: f64,
    position: Vector3<f64>,
    quaternion: [f64; 4],
) -> Result<(), CaptureError> {
    let [w, x, y, z] = quaternion;
    let quaternion = Quaternion::new(w, x, y, z);
    let length = quaternion.norm();
    if (length - 1.0).abs() > UNIT_LENGTH {
        return Err(CaptureError::Length { line, length });
    }
    if poses.last().is_some_and(|before| t <= before.t) {
        return Err(CaptureError::Order { line });
    }
    let rotation = UnitQuaternion::from_quaternion(quaternion);
    poses.push(TimedPose { t, pose: Isometry3::from_parts(Translation3::from(position), rotation) });
    Ok(())
}

#[cfg(test)]
mod tests;

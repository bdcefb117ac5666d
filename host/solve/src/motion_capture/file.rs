//! Files of motion capture: poses of a marker body in the frame of the capture, `T_mocap_body`.
//!
//! | format | recognised by |
//! |---|---|
//! | OptiTrack Motive CSV | its first line, which begins with `Format Version` |
//! | EuRoC (`state_groundtruth_estimate0`, `vicon0`) | its first line, which begins with `#timestamp` |
//! | TUM, `t tx ty tz qx qy qz qw` | anything else |

mod euroc;
mod motive;

use std::io;
use std::path::{Path, PathBuf};

use evcal_files::remedies;
use evcal_files::text::excerpt;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

use evcal_geometry::timed_pose::TimedPose;
use evcal_geometry::tum::{self, TumError};

/// Largest deviation of a quaternion's length from 1.
const UNIT_LENGTH: f64 = 0.01;

/// Error of reading a capture.
#[derive(Debug, thiserror::Error)]
#[error("{}: {reason}", path.display())]
pub struct CaptureFileError {
    /// The file.
    pub path: PathBuf,
    /// The reason.
    pub reason: CaptureError,
}

remedies! { CaptureFileError, say;
    Self { reason: CaptureError::OtherBodies { .. } | CaptureError::SeveralBodies { .. }, .. } =>
        "choose it with {}", say.body?;
    Self { reason: CaptureError::NoNames, .. } => "leave out {}", say.body?;
}

/// Problems of the content of a capture.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CaptureError {
    /// Reading the file failed.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The file is not a trajectory in TUM form.
    #[error("{0}; EuRoC's CSV with its first line and the CSV of OptiTrack Motive are read too")]
    Tum(#[from] TumError),
    /// A field is not a number.
    #[error("line {line}: {text:?} is not a number: correct or delete the line")]
    Number {
        /// Number of the line, from 1.
        line: usize,
        /// The text found there.
        text: String,
    },
    /// A quaternion is not a rotation.
    #[error("line {line}: the quaternion has length {length:.3}, not 1: check the order of the columns")]
    Length {
        /// Number of the line, from 1.
        line: usize,
        /// Its length.
        length: f64,
    },
    /// Times do not increase.
    #[error("line {line}: its time is not after the time of the previous line: sort the lines, and remove duplicates")]
    Order {
        /// Number of the line, from 1.
        line: usize,
    },
    /// The file has angles instead of quaternions.
    #[error("rotations are {found:?}: export from Motive with Rotation Type Quaternion")]
    RotationType {
        /// The value in the file.
        found: String,
    },
    /// The unit is unknown.
    #[error("lengths are in {found:?}: export from Motive in Meters, Centimeters or Millimeters")]
    LengthUnits {
        /// The value in the file.
        found: String,
    },
    /// Positions are relative to something else.
    #[error("the coordinate space is {found:?}: export from Motive with Coordinate Space Global")]
    CoordinateSpace {
        /// The value in the file.
        found: String,
    },
    /// The file contains no rigid body.
    #[error("there is no rigid body in the file: export from Motive with rigid bodies, in one file")]
    NoBody,
    /// The requested rigid body is not in the file.
    #[error("there is no rigid body {wanted:?}; there are {names}: name one of them")]
    OtherBodies {
        /// Requested body.
        wanted: String,
        /// Bodies in the file.
        names: String,
    },
    /// The file contains several bodies, and none was requested.
    #[error("there are several rigid bodies, {names}: name the one on the camera")]
    SeveralBodies {
        /// Bodies in the file.
        names: String,
    },
    /// A body was requested, but the format has no names.
    #[error("only files of OptiTrack Motive contain names of bodies: do not name one")]
    NoNames,
    /// The file contains no pose.
    #[error("there is no pose in the file")]
    Empty,
}

/// Reads the poses of a marker body; `body` selects one if the file contains several. Times are in seconds on the clock of the
/// capture.
///
/// # Errors
/// [`CaptureFileError`] names the line.
pub fn read(path: &Path, body: Option<&str>) -> Result<Vec<TimedPose>, CaptureFileError> {
    let poses = evcal_files::text::table(path).map_err(CaptureError::from).and_then(|text| parse(&text, body));
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
    value.ok_or_else(|| CaptureError::Number { line, text: excerpt(text).into_owned() })
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

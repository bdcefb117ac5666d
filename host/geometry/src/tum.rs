//! Trajectories in the text format of the TUM RGB-D benchmark: one pose per line, `t tx ty tz qx qy qz qw`, `#` for
//! comments.

use std::io::{self, BufRead, Write};

use evcal_files::text::excerpt;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};

use crate::timed_pose::TimedPose;

/// Reason why a line is not a pose.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum PoseLineError {
    /// More or fewer fields than a pose has.
    #[error("has {0} fields, not 8")]
    FieldCount(usize),
    /// A field is not a number.
    #[error("{0:?} is not a finite number")]
    Number(String),
    /// The quaternion is not a rotation; contains its length.
    #[error("the quaternion has length {0:.3}, not 1")]
    Length(f64),
    /// The times do not increase.
    #[error("its time {t} is not after that of the previous pose, {before}")]
    Order {
        /// Its time in seconds.
        t: f64,
        /// Time of the previous pose in seconds.
        before: f64,
    },
}

/// Reason why a trajectory could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TumError {
    /// The file could not be read.
    #[error("trajectory: {0}")]
    Io(#[from] io::Error),
    /// A line is not a pose.
    #[error("trajectory, line {line}: {reason}; write \"t tx ty tz qx qy qz qw\" (seconds, metres, unit quaternion)")]
    Line {
        /// Number of the line, from 1.
        line: usize,
        /// The problem.
        reason: PoseLineError,
    },
    /// The file contains no pose.
    #[error("trajectory: there is no pose in the file")]
    Empty,
}

/// Reads a trajectory: fields separated by blanks or commas, strictly increasing times, quaternions of a length from
/// 0.99 to 1.01 (they are normalised).
pub fn read(reader: impl BufRead) -> Result<Vec<TimedPose>, TumError> {
    let mut poses: Vec<TimedPose> = Vec::new();
    for (index, text) in reader.lines().enumerate() {
        let text = text?;
        let content = text.split('#').next().unwrap_or_default().trim();
        if content.is_empty() {
            continue;
        }
        let error = |reason| TumError::Line { line: index + 1, reason };
        let pose = parse(content).map_err(error)?;
        if let Some(before) = poses.last()
            && pose.t <= before.t
        {
            return Err(error(PoseLineError::Order { t: pose.t, before: before.t }));
        }
        poses.push(pose);
    }
    if poses.is_empty() { Err(TumError::Empty) } else { Ok(poses) }
}

fn parse(content: &str) -> Result<TimedPose, PoseLineError> {
    let mut fields = [0.0; 8];
    let parts: Vec<&str> =
        content.split(|c: char| c.is_whitespace() || c == ',').filter(|part| !part.is_empty()).collect();
    if parts.len() != fields.len() {
        return Err(PoseLineError::FieldCount(parts.len()));
    }
    for (field, part) in fields.iter_mut().zip(parts) {
        *field = part
            .parse()
            .ok()
            .filter(|value: &f64| value.is_finite())
            .ok_or_else(|| PoseLineError::Number(excerpt(part).into_owned()))?;
    }
    let [t, x, y, z, i, j, k, w] = fields;
    let quaternion = Quaternion::new(w, i, j, k);
    if (quaternion.norm() - 1.0).abs() > 0.01 {
        return Err(PoseLineError::Length(quaternion.norm()));
    }
    let pose = Isometry3::from_parts(Translation3::new(x, y, z), UnitQuaternion::from_quaternion(quaternion));
    Ok(TimedPose { t, pose })
}

/// Writes a trajectory, to microseconds and nanometres. Its first line names the fields and the `pose`, for example
/// `T_world_camera`.
pub fn write(mut writer: impl Write, pose: &str, poses: &[TimedPose]) -> io::Result<()> {
    writeln!(writer, "# t tx ty tz qx qy qz qw: seconds, {pose} in metres")?;
    for TimedPose { t, pose } in poses {
        let translation = pose.translation.vector;
        let rotation = pose.rotation.coords;
        writeln!(
            writer,
            "{t:.6} {:.9} {:.9} {:.9} {:.12} {:.12} {:.12} {:.12}",
            translation.x, translation.y, translation.z, rotation.x, rotation.y, rotation.z, rotation.w
        )?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    #[test]
    fn a_trajectory_survives_a_round_trip() {
        let poses: Vec<TimedPose> = (0..20)
            .map(|index| {
                let s = f64::from(index);
                TimedPose {
                    t: 0.001 * s,
                    pose: Isometry3::new(Vector3::new(0.1 * s, -0.02, 0.5), Vector3::new(0.3 * s, 0.1, -0.2 * s)),
                }
            })
            .collect();
        let mut text = Vec::new();
        write(&mut text, "T_world_camera", &poses).unwrap();
        let back = read(text.as_slice()).unwrap();
        assert_eq!(back.len(), poses.len());
        for (a, b) in poses.iter().zip(&back) {
            assert!((a.t - b.t).abs() < 1e-9);
            assert!((a.pose.translation.vector - b.pose.translation.vector).norm() < 2e-9);
            assert!(a.pose.rotation.angle_to(&b.pose.rotation) < 1e-10);
        }
    }

    #[test]
    fn the_order_of_the_quaternion_is_x_y_z_w() {
        // A rotation by 90° about z.
        let text = "0.5 1 2 3 0 0 0.70710678118 0.70710678118";
        let poses = read(text.as_bytes()).unwrap();
        let turned = poses[0].pose.rotation * Vector3::x();
        assert!((turned - Vector3::y()).norm() < 1e-9, "{turned}");
    }

    #[test]
    fn an_error_names_its_line() {
        let cases = [
            ("# c\n1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", "line 3: has 7 fields"),
            ("1 0 0 0 0 0 0 x\n", "line 1: \"x\" is not"),
            ("1 0 0 0 0 0 0 NaN\n", "line 1: \"NaN\" is not"),
            ("1 0 0 0 0 0 0 2\n", "line 1: the quaternion has length 2.000"),
            ("2 0 0 0 0 0 0 1\n\n2 0 0 0 0 0 0 1\n", "line 3: its time 2 is not after that of the previous pose, 2"),
            ("# nothing\n", "no pose"),
        ];
        for (text, part) in cases {
            let message = read(text.as_bytes()).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}

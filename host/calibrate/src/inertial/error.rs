//! Errors of the calibration of an IMU.

use super::csv::CsvError;
use evcal_files::remedies;
use evcal_files::remedy::Words;
use evcal_solve::solve::SolveError;
use evcal_solve::trajectory::alignment::AlignmentError;
use evcal_solve::trajectory::first::FirstTrajectoryError;
use event_recordings::RecordingError;

/// The likely unit of readings, for messages.
pub const IN_G: &str = "g, and were read as m/s²";
/// The same.
pub const IN_METRES: &str = "m/s², and were read as g";
/// The same.
pub const IN_DEGREES: &str = "°/s, and were read as rad/s";
/// The same.
pub const IN_RADIANS: &str = "rad/s, and were read as °/s";
/// The same.
pub const IN_ANOTHER: &str = "another unit than stated";

/// Reasons why an IMU cannot be calibrated, with remedies.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InertialError {
    /// A recording could not be read.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// A file of samples could not be read.
    #[error("{0}")]
    Csv(#[from] CsvError),
    /// The poses of the pictures from which the camera was calibrated form no trajectory.
    #[error("an IMU is calibrated along trajectories: {0}")]
    NoTrajectory(#[from] FirstTrajectoryError),
    /// One file of samples cannot belong to several recordings.
    #[error("a file of IMU samples belongs to one recording: calibrate with one recording")]
    SeveralRecordings,
    /// There are no samples.
    #[error("{file} contains no IMU samples")]
    NoSamples {
        /// The recording.
        file: String,
    },
    /// No sample could be read.
    #[error("no IMU sample could be read: {}", damages.join("; "))]
    Lost {
        /// The damage, as sentences.
        damages: Vec<String>,
    },
    /// Too few samples were taken while the board was in view.
    #[error(
        "the board was seen during only {seconds:.2} s of the IMU samples; {needed:.0} s are needed: record longer, with the board in view. If it was seen for longer, the times of the samples have another unit or rate"
    )]
    TooShort {
        /// Length of the samples (s).
        seconds: f64,
        /// Required length (s).
        needed: f64,
    },
    /// The sampling rate is too low.
    #[error(
        "the IMU has {rate:.0} samples per second, too few to follow a hand; {needed:.0} are needed, and 200 are better: set a higher rate"
    )]
    TooSlow {
        /// Samples per second.
        rate: f64,
        /// Required samples per second.
        needed: f64,
    },
    /// Too many readings are saturated.
    #[error(
        "{:.1} % of the IMU samples are saturated: set a larger range of accelerometer and gyroscope, or move more gently",
        100.0 * share
    )]
    Saturated {
        /// Share of the samples.
        share: f64,
    },
    /// All samples have the same timestamp.
    #[error(
        "all IMU samples have the timestamp {t:.6} s: the driver did not stamp them; record with timestamps, or give a file of samples with their times"
    )]
    OneTime {
        /// The timestamp (s).
        t: f64,
    },
    /// The samples lack a quantity.
    #[error(
        "the IMU samples contain no {what}: give samples with accelerations and angular velocities; if each sensor has a stream of its own, both are needed"
    )]
    Lacks {
        /// The quantity.
        what: &'static str,
    },
    /// Units were stated for samples whose format determines them.
    #[error(
        "{file} is not a recording of messages, and its format determines the units of the IMU samples: do not state them"
    )]
    UnitsOfFormat {
        /// The recording.
        file: String,
    },
    /// Accelerations are in another unit.
    #[error("a resting accelerometer would read {reading:.3} g: the accelerations seem to be in {unit}{}", remedy(*.of_file))]
    AccelerationUnit {
        /// Median acceleration in g.
        reading: f64,
        /// The likely unit.
        unit: &'static str,
        /// `true` if the samples are from a file of their own.
        of_file: bool,
    },
    /// Gravity was removed from the accelerations.
    #[error(
        "the accelerations are only {reading:.2} g, so gravity seems to have been removed: give the raw readings of the accelerometer"
    )]
    GravityRemoved {
        /// Median acceleration, or gravity if it was fitted, in g.
        reading: f64,
    },
    /// Angular velocities are in another unit.
    #[error(
        "the gyroscope reads {factor:.3} times the rotation rate of the camera: the angular velocities seem to be in {unit}{}",
        remedy(*.of_file)
    )]
    AngularUnit {
        /// Reading divided by truth.
        factor: f64,
        /// The likely unit.
        unit: &'static str,
        /// `true` if the samples are from a file of their own.
        of_file: bool,
    },
    /// The motion does not determine the alignment.
    #[error(transparent)]
    Alignment(#[from] AlignmentError),
    /// The coordinate system is mirrored.
    #[error("the axes of the IMU are left-handed: change the sign of one axis of both sensors")]
    LeftHanded,
    /// The accelerometer measures the opposite of each acceleration: its sign is wrong, or the camera's image is mirrored.
    #[error(
        "the accelerometer measures the opposite of each acceleration of the camera: the image is mirrored, or all its axes have the opposite sign"
    )]
    OppositeAccelerations,
    /// Gravity has an unexpected magnitude.
    #[error("{}", gravity_in_words(*size, *stated, *motion))]
    GravitySize {
        /// Estimated magnitude (m/s²).
        size: f64,
        /// Expected magnitude (m/s²).
        stated: f64,
        /// Acceleration of the camera by its motion (m/s², root mean square).
        motion: f64,
    },
    /// The equations have no solution.
    #[error(
        "the motion does not determine the parameters of the IMU: rotate the camera about two axes, and tilt it by more than 30 degrees"
    )]
    Singular,
    /// The model does not fit the samples.
    #[error(
        "the IMU samples do not fit the motion of the camera (residual {gyroscope:.2} °/s and {accelerometer:.2} m/s²): check that IMU and camera are fixed to each other and the board is described as printed"
    )]
    NotExplained {
        /// Root mean square of the gyroscope's residuals in °/s.
        gyroscope: f64,
        /// Root mean square of the accelerometer's residuals in m/s².
        accelerometer: f64,
    },
    /// The equations could not be built.
    #[error(transparent)]
    Solve(SolveError),
}

remedies! { InertialError, say;
    Self::Recording(error) => error.remedy(say);
    Self::NoSamples { .. } => "record with the IMU enabled, or give its samples with {}", say.imu_file?;
    Self::OneTime { .. } | Self::Lacks { .. } => "write them to a CSV file, and give it with {}", say.imu_file?;
    Self::UnitsOfFormat { .. } => "leave out {}", say.imu_units?;
    Self::AccelerationUnit { unit, of_file: false, .. } | Self::AngularUnit { unit, of_file: false, .. } =>
        remedy_of_units(unit, say);
}

/// Returns the remedy for samples of a recording that seem to be in another unit.
fn remedy_of_units(unit: &str, say: &Words) -> Option<String> {
    let in_file = "write the samples with the units in its header to a CSV file, and give it with";
    let file = say.imu_file?;
    Some(match (say.imu_units, unit) {
        (Some(option), IN_G) => format!("add {}", option.with("g")),
        (Some(option), IN_DEGREES) => {
            format!("add {}, or g,deg_s if accelerations are in g too", option.with("deg_s"))
        }
        (Some(option), _) => format!("correct {option}, or {in_file} {file}"),
        (None, _) => format!("{in_file} {file}"),
    })
}

impl From<SolveError> for InertialError {
    fn from(error: SolveError) -> Self {
        if error == SolveError::OutOfBand { Self::Solve(error) } else { Self::Singular }
    }
}

impl InertialError {
    /// Returns the error about accelerations in another unit, in a file of samples.
    pub(super) fn acceleration_unit(reading: f64, unit: &'static str) -> Self {
        Self::AccelerationUnit { reading, unit, of_file: true }
    }

    /// Returns the same error about samples from a recording.
    pub(crate) fn of_recording(mut self) -> Self {
        if let Self::AccelerationUnit { of_file, .. } | Self::AngularUnit { of_file, .. } = &mut self {
            *of_file = false;
        }
        self
    }
}

fn remedy(of_file: bool) -> &'static str {
    if of_file {
        ": state their unit in the header of the file"
    } else {
        ", which is not the unit of the recording's format"
    }
}

/// Acceleration of the camera, as a share of gravity, from which the motion is the likely cause.
const VIOLENT: f64 = 0.5;

fn gravity_in_words(size: f64, stated: f64, motion: f64) -> String {
    let mistakes = "check the unit of the accelerations, the signs of the accelerometer's axes and the spacing of the board, or the axes of \
                    both sensors are left-handed";
    let found = format!("gravity is estimated as {size:.2} m/s², not {stated:.2}");
    if motion > VIOLENT * stated {
        format!(
            "{found}, from a motion that accelerated the camera by {motion:.1} m/s² (rms), which hides gravity: move more gently, at least for \
             some seconds; if it is the same then, {mistakes}"
        )
    } else {
        format!("{found}: {mistakes}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// If the motion is violent, the message names the motion, not a fault of the IMU.
    #[test]
    fn a_wrong_size_of_gravity_is_attributed_to_a_violent_motion_first() {
        let message = |motion| InertialError::GravitySize { size: 7.1, stated: 9.81, motion }.to_string();
        assert!(message(9.0).contains("accelerated the camera by 9.0 m/s²") && message(9.0).contains("more gently"));
        assert!(!message(1.0).contains("gently") && message(1.0).contains("unit of the accelerations"));
    }
}

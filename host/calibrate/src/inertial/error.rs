//! Why an inertial unit cannot be calibrated.

use super::csv::CsvError;
use crate::solve::control_band::NotPositiveDefinite;
use crate::trajectory::alignment::AlignmentError;
use event_recordings::RecordingError;

/// Why an inertial unit cannot be calibrated, and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InertialError {
    /// A recording could not be read.
    #[error("{0}")]
    Recording(#[from] RecordingError),
    /// A file of samples could not be read.
    #[error("{0}")]
    Csv(#[from] CsvError),
    /// The camera was calibrated from pictures, each with a pose of its own.
    #[error("an inertial unit is calibrated along trajectories, and frames alone give none: calibrate from events")]
    NoTrajectory,
    /// One file of samples cannot belong to several recordings.
    #[error("a file of inertial samples belongs to one recording: calibrate with one recording")]
    SeveralRecordings,
    /// There are no samples.
    #[error("{file} holds no inertial samples: record with the IMU on, or give a CSV file of them")]
    NoSamples {
        /// The recording.
        file: String,
    },
    /// Not one sample could be read.
    #[error("no inertial sample could be read: {}", damages.join("; "))]
    Lost {
        /// What is damaged, in sentences.
        damages: Vec<String>,
    },
    /// There are too few samples at a time when the board was seen.
    #[error(
        "only {seconds:.1} s of inertial samples lie where the board was seen; {needed:.0} s are needed: record longer, with the board in view"
    )]
    TooShort {
        /// How much there is.
        seconds: f64,
        /// How much is needed.
        needed: f64,
    },
    /// The samples end before a calibration can begin.
    #[error(
        "the inertial samples last {seconds:.1} s only; {needed:.0} s are needed, and 20 s are better: record longer"
    )]
    ShortRecording {
        /// From the first to the last sample.
        seconds: f64,
        /// How much is needed.
        needed: f64,
    },
    /// The samples are too far apart in time.
    #[error(
        "the inertial unit gives {rate:.0} samples a second, too few to follow a hand; {needed:.0} are needed, and 200 are better: set a higher rate"
    )]
    TooSlow {
        /// Samples a second.
        rate: f64,
        /// How many are needed.
        needed: f64,
    },
    /// Readings stay at the end of the scale.
    #[error(
        "{:.1} % of the inertial samples are at the end of their scale: set a larger range of accelerometer and gyroscope, or move more gently",
        100.0 * share
    )]
    Saturated {
        /// Share of the samples.
        share: f64,
    },
    /// Accelerations are in another unit.
    #[error(
        "a resting accelerometer would read {reading:.3} g: the accelerations seem to be in {unit}: state their unit in the header of the file"
    )]
    AccelerationUnit {
        /// Median size of the acceleration in g.
        reading: f64,
        /// The likely unit.
        unit: &'static str,
    },
    /// Gravity was taken off.
    #[error(
        "accelerations show {reading:.2} g only, so that gravity seems to be removed: give the raw readings of the accelerometer"
    )]
    GravityRemoved {
        /// Median size of the acceleration, or gravity where it was fitted, in g.
        reading: f64,
    },
    /// Angular velocities are in another unit.
    #[error(
        "the gyroscope reads {factor:.3} times what the camera turns: the angular velocities seem to be in {unit}: state their unit in the header of the file"
    )]
    AngularUnit {
        /// Reading over truth.
        factor: f64,
        /// The likely unit.
        unit: &'static str,
    },
    /// The motion does not tell how the two are aligned.
    #[error(transparent)]
    Alignment(#[from] AlignmentError),
    /// A mirrored coordinate system.
    #[error("the axes of the inertial unit are left-handed: change the sign of one axis of both sensors")]
    LeftHanded,
    /// Gravity does not have its size.
    #[error("{}", gravity_in_words(*size, *stated, *motion))]
    GravitySize {
        /// Found (m/s²).
        size: f64,
        /// Stated (m/s²).
        stated: f64,
        /// Acceleration of the camera by its motion (m/s², root mean square).
        motion: f64,
    },
    /// The equations have no solution.
    #[error(
        "the motion does not determine the inertial unit: turn the camera about two axes, and tilt it by more than 30 degrees"
    )]
    Singular,
    /// The model does not fit.
    #[error(
        "the inertial samples do not fit the motion of the camera (residual {gyroscope:.2} °/s and {accelerometer:.2} m/s²): check that unit and camera are fixed to each other and the board is described as printed"
    )]
    NotExplained {
        /// Root mean square of the gyroscope's residuals in °/s.
        gyroscope: f64,
        /// The same for the accelerometer in m/s².
        accelerometer: f64,
    },
}

impl From<NotPositiveDefinite> for InertialError {
    fn from(_: NotPositiveDefinite) -> Self {
        Self::Singular
    }
}

/// Acceleration of the camera, as a share of gravity, from which the motion is to blame.
const VIOLENT: f64 = 0.5;

fn gravity_in_words(size: f64, stated: f64, motion: f64) -> String {
    let mistakes = "check the unit of the accelerations, the signs of the accelerometer's axes and the spacing of the board, or the axes of \
                    both sensors are left-handed";
    let found = format!("gravity comes out as {size:.2} m/s², not {stated:.2}");
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

    /// A unit that was all right was accused.
    #[test]
    fn a_violent_motion_is_named_before_the_unit_is_accused() {
        let told = |motion| InertialError::GravitySize { size: 7.1, stated: 9.81, motion }.to_string();
        assert!(told(9.0).contains("accelerated the camera by 9.0 m/s²") && told(9.0).contains("more gently"));
        assert!(!told(1.0).contains("gently") && told(1.0).contains("unit of the accelerations"));
    }
}

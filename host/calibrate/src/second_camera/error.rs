//! Errors of the calibration of a second camera.

use evcal_files::remedies;
use evcal_solve::solve::SolveError;
use evcal_solve::trajectory::alignment::AlignmentError;

/// Reasons why a second camera cannot be calibrated against the first, with remedies.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SecondCameraError {
    /// A camera was calibrated from pictures, each with a separate pose, or from circles.
    #[error(
        "cameras are calibrated against the trajectory of the first one's events: calibrate the first from a recording of events, not from frames or circles"
    )]
    NoTrajectory,
    /// The second camera was calibrated from circles.
    #[error("give events, not circles, of the second camera: circles do not determine its motion well enough")]
    CirclesOfSecond,
    /// It is not known which recording of the first camera belongs to the recording of the second.
    #[error("a second camera belongs to one recording of the first: give only one")]
    SeveralRecordings,
    /// Both recordings are the same.
    #[error("{file} contains the events of a camera that was already given")]
    SameRecording {
        /// The file name.
        file: String,
    },
    /// The common time is too short.
    #[error(
        "both cameras saw the board for only {seconds:.2} s; {needed:.0} s are needed: record longer, with the board in view of both"
    )]
    TooShort {
        /// Common time (s).
        seconds: f64,
        /// Required time (s).
        needed: f64,
    },
    /// The cameras hardly saw the whole board at the same time.
    #[error(
        "the motion of the first camera is known for {:.1} s, of the second for {:.1} s, and of both together for less than {needed:.0} s at any offset of their clocks: record longer, with the whole board in view of both",
        seconds[0],
        seconds[1]
    )]
    HardlyTogether {
        /// Time of each camera with a known motion (s).
        seconds: [f64; 2],
        /// Required time (s).
        needed: f64,
    },
    /// The motion does not determine the alignment.
    #[error(transparent)]
    Alignment(#[from] AlignmentError),
    /// The board is symmetric, and the motion does not determine its orientation.
    #[error(
        "the board is symmetric, and the motion does not determine its orientation in each camera: use a board with an odd number of shifted rows, such as acircles:9x4"
    )]
    SymmetricBoard,
    /// The motions match only if one of both images is mirrored.
    #[error(
        "the image of one of the two cameras is mirrored: their motions match only then; see in a picture of each which side is wrong"
    )]
    Mirrored,
    /// The transform is not constant.
    #[error(
        "the two cameras are not rigidly connected (relative motion: {:.1} mm and {degrees:.2}°): fix both to one mount, and do not move the board",
        1e3 * distance
    )]
    NotFixed {
        /// Typical change of the position (m).
        distance: f64,
        /// Typical change of the rotation (degrees).
        degrees: f64,
    },
    /// The times of the second camera's pictures, or one of the clocks, jump.
    #[error(
        "the times of the second camera scatter by {:.1} ms against the first: with other times, both would be rigidly connected. Take the times from the cameras, not from the computer that stores the pictures",
        1e3 * seconds
    )]
    ScatteredTimes {
        /// Spread (σ) of the errors of times (s).
        seconds: f64,
    },
    /// The second camera has a rolling shutter, which was not requested.
    #[error(
        "the second camera has a rolling shutter: each row of its frames is exposed {:.2} ± {:.2} µs after the one above it ({:.1} ms from the first to the last): a rolling shutter must be declared",
        1e6 * line_delay, 1e6 * sigma, 1e3 * line_delay * f64::from(*rows)
    )]
    RollingShutter {
        /// Time from row to row (s).
        line_delay: f64,
        /// Its σ.
        sigma: f64,
        /// Number of rows.
        rows: u16,
    },
    /// The equations have no solution.
    #[error(
        "the events do not determine the pose of the second camera: rotate about two axes, with the board in view of both cameras"
    )]
    Singular,
    /// The equations could not be built.
    #[error(transparent)]
    Solve(SolveError),
}

remedies! { SecondCameraError, say;
    Self::NoTrajectory => "leave out {}, and give a recording of events before {}", say.frames_only?, say.with?;
    Self::CirclesOfSecond => "give its events with {}", say.with?;
    Self::SeveralRecordings => "give one recording before {}", say.with?;
    Self::SameRecording { .. } => "give the recording of another camera with {}", say.with?;
    Self::RollingShutter { .. } => "add {}", say.rolling_shutter?;
}

impl From<SolveError> for SecondCameraError {
    fn from(error: SolveError) -> Self {
        if error == SolveError::OutOfBand { Self::Solve(error) } else { Self::Singular }
    }
}

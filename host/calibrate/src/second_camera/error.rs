//! Why a second camera cannot be calibrated against the first.

use crate::solve::control_band::NotPositiveDefinite;
use crate::trajectory::alignment::AlignmentError;

/// Why a second camera cannot be calibrated against the first, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SecondCameraError {
    /// A camera was calibrated from pictures, each with a pose of its own, or from circles.
    #[error(
        "cameras are calibrated against the trajectory of the first one's events: calibrate the first from a recording of events, not from frames or circles"
    )]
    NoTrajectory,
    /// The second camera was calibrated from circles.
    #[error("give events, not circles, of the second camera: circles tell too little of the time between them")]
    CirclesOfSecond,
    /// Which recording of the first camera belongs to that of the second?
    #[error("a second camera belongs to one recording of the first: give only one")]
    SeveralRecordings,
    /// The same events twice.
    #[error("{file} holds the events of a camera that is there already: give the recording of another camera")]
    SameRecording {
        /// The file.
        file: String,
    },
    /// Too little in common.
    #[error(
        "only {seconds:.1} s have the board before both cameras; {needed:.0} s are needed: record longer, with the board in view of both"
    )]
    TooShort {
        /// What there is.
        seconds: f64,
        /// What is needed.
        needed: f64,
    },
    /// The motion does not tell how the two are aligned.
    #[error(transparent)]
    Alignment(#[from] AlignmentError),
    /// The board looks the same from both sides, and so do both answers.
    #[error(
        "the board looks the same after a turn, and the motion does not tell which way round each camera sees it: use a board with an odd number of shifted rows, such as acircles:9x4"
    )]
    SymmetricBoard,
    /// No fixed transform.
    #[error(
        "nothing fixed lies between the two cameras (they move by {:.1} mm and {degrees:.2}° against each other): fix both to one mount, and do not move the board",
        1e3 * distance
    )]
    NotFixed {
        /// Usual change of the place (m).
        distance: f64,
        /// Usual change of the rotation (degrees).
        degrees: f64,
    },
    /// The rows of its frames are exposed one after the other, which nobody said.
    #[error(
        "the second camera has a rolling shutter: each row of its frames is exposed {:.2} ± {:.2} µs after the one above it ({:.1} ms from the first to the last): state that it has",
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
        "the events do not determine where the second camera is: turn about two axes, with the board in view of both cameras"
    )]
    Singular,
}

impl From<NotPositiveDefinite> for SecondCameraError {
    fn from(_: NotPositiveDefinite) -> Self {
        Self::Singular
    }
}

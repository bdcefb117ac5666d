//! Why a trajectory cannot be compared with a capture.

use crate::trajectory::alignment::AlignmentError;

/// Why a trajectory cannot be compared with a capture, and what to do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MotionCaptureError {
    /// Times that are no seconds.
    #[error("the capture has a pose every {interval} s, which no system has: give times in seconds")]
    Times {
        /// Usual time from pose to pose.
        interval: f64,
    },
    /// Too few poses of the camera.
    #[error(
        "the camera's trajectory has a pose every {:.0} ms, too few to follow a hand: calibrate from events, which gives 200 a second",
        1e3 * interval
    )]
    Sparse {
        /// Usual time from pose to pose.
        interval: f64,
    },
    /// Little in common.
    #[error(
        "only {seconds:.1} s of the capture lie where the camera's trajectory is known; {needed:.0} s are needed: record longer, with board and markers in view"
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
    /// w stands first.
    #[error("the quaternions of the capture seem to have w first, and were read as x y z w: write them as qx qy qz qw")]
    QuaternionOrder,
    /// T_body_mocap in place of T_mocap_body.
    #[error(
        "the poses of the capture seem to be inverted (the room seen from the body): give those of the body in the room"
    )]
    Inverted,
    /// Rotations are inverse, positions are not.
    #[error(
        "the quaternions of the capture seem to be those of the opposite rotation (conjugate): change the sign of qx, qy and qz"
    )]
    Conjugate,
    /// A mirrored frame.
    #[error("the axes of the capture are left-handed: change the sign of one axis, or export with right-handed axes")]
    LeftHanded,
    /// Same speed, other axes.
    #[error(
        "camera and body turn equally fast, but about axes that no fixed mount explains ({:.0} % of the turns left): check the convention of the quaternions, and that the body is fixed to the camera",
        100.0 * left
    )]
    OtherAxes {
        /// Share of the squares of the angular velocities that is left.
        left: f64,
    },
    /// Lengths in another unit.
    #[error(
        "the capture moves {scale:.4} times as far as the camera: its positions seem to be in {unit}: give them in metres"
    )]
    LengthUnit {
        /// Lengths in the capture over those on the board.
        scale: f64,
        /// The likely unit.
        unit: &'static str,
    },
    /// Lengths that differ.
    #[error(
        "the capture moves {scale:.4} times as far as the camera: measure the spacing of the board, and calibrate the capture system"
    )]
    Lengths {
        /// Lengths in the capture over those on the board.
        scale: f64,
    },
    /// The equations have no solution.
    #[error("the motion does not determine where the body sits: turn the camera about two axes and move it")]
    Singular,
}

//! Errors of the comparison of a trajectory with a capture.

use crate::trajectory::alignment::AlignmentError;

/// Reasons why a trajectory cannot be compared with a capture, with remedies.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MotionCaptureError {
    /// Times are not in seconds.
    #[error("the capture has a pose every {interval} s, which no system has: give times in seconds")]
    Times {
        /// Median time between poses.
        interval: f64,
    },
    /// The camera has too few poses.
    #[error(
        "the camera's trajectory has a pose every {:.0} ms, too few to follow a hand: calibrate from events, which yields 200 per second",
        1e3 * interval
    )]
    Sparse {
        /// Median time between poses.
        interval: f64,
    },
    /// The common time is too short.
    #[error(
        "only {seconds:.2} s of the capture overlap with the camera's trajectory; {needed:.0} s are needed: record longer, with board and markers in view"
    )]
    TooShort {
        /// Common time (s).
        seconds: f64,
        /// Required time (s).
        needed: f64,
    },
    /// The motion does not determine the alignment.
    #[error(transparent)]
    Alignment(#[from] AlignmentError),
    /// The quaternions have w first.
    #[error("the quaternions of the capture seem to have w first, and were read as x y z w: write them as qx qy qz qw")]
    QuaternionOrder,
    /// The poses are T_body_mocap instead of T_mocap_body.
    #[error(
        "the poses of the capture seem to be inverted (the room seen from the body): give the poses of the body in the room"
    )]
    Inverted,
    /// Rotations are inverted, positions are not.
    #[error(
        "the quaternions of the capture seem to be conjugate (the opposite rotation): change the sign of qx, qy and qz"
    )]
    Conjugate,
    /// The frame is mirrored.
    #[error("the axes of the capture are left-handed: change the sign of one axis, or export with right-handed axes")]
    LeftHanded,
    /// The rotation rates agree, but not the axes.
    #[error(
        "camera and body rotate equally fast, but about axes that no fixed mount explains ({:.0} % of the rotation unexplained): check the convention of the quaternions, and that the body is fixed to the camera",
        100.0 * left
    )]
    OtherAxes {
        /// Unexplained share of the squared angular velocities.
        left: f64,
    },
    /// Lengths have another unit.
    #[error(
        "the capture moves {scale:.4} times as far as the camera: its positions seem to be in {unit}: give them in metres"
    )]
    LengthUnit {
        /// Ratio of lengths in the capture to those on the board.
        scale: f64,
        /// The likely unit.
        unit: &'static str,
    },
    /// Lengths differ.
    #[error(
        "the capture moves {scale:.4} times as far as the camera: measure the spacing of the board, and calibrate the capture system"
    )]
    Lengths {
        /// Ratio of lengths in the capture to those on the board.
        scale: f64,
    },
    /// The equations have no solution.
    #[error("the motion does not determine the pose of the marker body: rotate the camera about two axes and move it")]
    Singular,
}

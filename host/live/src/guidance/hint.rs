//! Hints for the person who holds the board, one at a time.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, Vector2, Vector3};

use super::board_pose::BoardPose;
use crate::Tilt;

/// Tolerance of the position in the image, as a fraction of the sensor's width.
const NEAR_ENOUGH: f64 = 0.15;
/// Tolerance of the ratio of distances.
const SIZE_ENOUGH: f64 = 1.1;
/// Tolerance of the angle between the boards' normals (rad).
const TILT_ENOUGH: f64 = 12.0 * PI / 180.0;
/// Tolerance of the rotation about the camera's axis (rad).
const ROLL_ENOUGH: f64 = 25.0 * PI / 180.0;
/// Factor by which another hint must be more important than the current one.
const WORTH_CHANGE: f64 = 1.5;
/// A board that is being swung may be this far from the target pose (in units of the tolerance).
const SWUNG: f64 = 1.5;

/// Motion of the board about a pose: only motion triggers events, and a changing tilt is most informative.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Swing {
    /// About a vertical axis.
    Sideways,
    /// About a horizontal axis.
    ToAndFro,
}

impl Swing {
    /// Returns the swing about the axis of the pose's tilt.
    pub fn of(place: &BoardPose) -> Self {
        if place.tilt.x.abs() > place.tilt.y.abs() { Self::ToAndFro } else { Self::Sideways }
    }
}

/// Instruction for the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Hint {
    /// The board was not seen yet.
    Show,
    /// The board was seen before, but is not seen now.
    Lost,
    /// Move it in the image by (x, y): x is −1 (left), 0 or 1 (right), y is −1 (up), 0 or 1 (down).
    Shift(i8, i8),
    /// Bring it closer.
    Closer,
    /// Take it farther away.
    Farther,
    /// Tilt it until this side is nearer.
    Nearer(Tilt),
    /// Turn it clockwise, as the camera sees it.
    Clockwise,
    /// Turn it counterclockwise.
    Counterclockwise,
    /// The board is at its target pose.
    Stay,
    /// The board is at its target pose: swing it there.
    Swing(Swing),
    /// Enough was seen.
    Done,
}

impl Hint {
    /// Returns the text of the hint, for a view as seen by the camera or in a mirror.
    pub fn words(self, mirrored: bool) -> &'static str {
        match self {
            Self::Show => "show the board",
            Self::Lost => "bring the board back",
            Self::Shift(x, y) => shift(if mirrored { -x } else { x }, y),
            Self::Closer => "closer",
            Self::Farther => "farther away",
            Self::Nearer(side) => match (side, mirrored) {
                (Tilt::Left, false) | (Tilt::Right, true) => "left edge nearer",
                (Tilt::Right, false) | (Tilt::Left, true) => "right edge nearer",
                (Tilt::Top, _) => "top edge nearer",
                (Tilt::Bottom, _) => "bottom edge nearer",
            },
            Self::Clockwise if mirrored => "turn it counterclockwise",
            Self::Counterclockwise if mirrored => "turn it clockwise",
            Self::Clockwise => "turn it clockwise",
            Self::Counterclockwise => "turn it counterclockwise",
            Self::Stay => "keep moving here",
            Self::Swing(Swing::Sideways) => "swing it left and right",
            Self::Swing(Swing::ToAndFro) => "tilt it to and fro",
            Self::Done => "done",
        }
    }

    /// Returns `true` if two hints concern the same quantity, in any direction.
    fn has_same_kind(self, other: Self) -> bool {
        std::mem::discriminant(&self) == std::mem::discriminant(&other)
    }
}

fn shift(x: i8, y: i8) -> &'static str {
    match (x, y) {
        (0, ..=-1) => "up",
        (0, _) => "down",
        (..=-1, 0) => "to the left",
        (_, 0) => "to the right",
        (..=-1, ..=-1) => "to the upper left",
        (..=-1, _) => "to the lower left",
        (_, ..=-1) => "to the upper right",
        (_, _) => "to the lower right",
    }
}

/// A visible board.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
    /// Its middle in camera coordinates (m).
    pub middle: Vector3<f64>,
    /// Its middle in the image (px).
    pub pixel: Vector2<f64>,
}

/// Returns the deviations of `now` from `goal`, each in units of its tolerance, with the corresponding hint. A rotation
/// of the board by 180° about the camera's axis is not an error, because the board looks the same.
pub fn errors(now: &Seen, goal: &Seen, width: f64) -> [(Hint, f64); 4] {
    let shift = goal.pixel - now.pixel;
    let eighth = |part: f64| if part.abs() > shift.norm() * (PI / 8.0).sin() { part.signum() as i8 } else { 0 };
    let ratio = now.middle.z / goal.middle.z;
    let (normal, wanted) = (now.pose.rotation * Vector3::z(), goal.pose.rotation * Vector3::z());
    // Depth on the board decreases along its normal's direction in the image.
    let lean = (wanted - normal).xy();
    let side = match (lean.x.abs() > lean.y.abs(), lean.x > 0.0, lean.y > 0.0) {
        (true, true, _) => Tilt::Right,
        (true, false, _) => Tilt::Left,
        (false, _, true) => Tilt::Bottom,
        (false, _, false) => Tilt::Top,
    };
    let turn = half_turn(roll(&goal.pose) - roll(&now.pose));
    [
        (Hint::Shift(eighth(shift.x), eighth(shift.y)), shift.norm() / (NEAR_ENOUGH * width)),
        (if ratio > 1.0 { Hint::Closer } else { Hint::Farther }, ratio.ln().abs() / SIZE_ENOUGH.ln()),
        (Hint::Nearer(side), normal.angle(&wanted) / TILT_ENOUGH),
        (if turn > 0.0 { Hint::Clockwise } else { Hint::Counterclockwise }, turn.abs() / ROLL_ENOUGH),
    ]
}

/// Returns the hint for these errors: the largest error, or the previous hint while it is about equally important.
pub fn choose(errors: &[(Hint, f64); 4], before: Hint) -> Hint {
    let largest = errors.iter().fold((Hint::Stay, 1.0), |best, error| if error.1 > best.1 { *error } else { best });
    let same = errors.iter().find(|(hint, _)| hint.has_same_kind(before));
    match same {
        _ if matches!(before, Hint::Stay | Hint::Swing(_)) && largest.1 < SWUNG => Hint::Stay,
        Some(&(hint, error)) if error > 1.0 && largest.1 < WORTH_CHANGE * error => hint,
        _ => largest.0,
    }
}

/// Returns the rotation of the board's rows in the image, positive clockwise (rad).
pub fn roll(pose: &Isometry3<f64>) -> f64 {
    let row = pose.rotation * Vector3::x();
    row.y.atan2(row.x)
}

/// Reduces an angle modulo 180° to −90° to 90°.
pub fn half_turn(angle: f64) -> f64 {
    (angle + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2
}

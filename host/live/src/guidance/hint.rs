//! One hint at a time, in the words of whoever holds the board.

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::{Isometry3, Vector2, Vector3};

use super::place::Place;
use crate::Tilt;

/// Distance in the image that is near enough, as a share of the sensor's width.
const NEAR_ENOUGH: f64 = 0.15;
/// Ratio of distances that is near enough.
const SIZE_ENOUGH: f64 = 1.1;
/// Angle between the boards' normals that is near enough (rad).
const TILT_ENOUGH: f64 = 12.0 * PI / 180.0;
/// Turn about the camera's axis that is near enough (rad).
const ROLL_ENOUGH: f64 = 25.0 * PI / 180.0;
/// Another hint must be worth this much more than the one that is shown.
const WORTH_CHANGE: f64 = 1.5;
/// A board that is swung about its place may be so far from it, in units of what is near enough.
const SWUNG: f64 = 1.5;

/// How to move the board about a place: only what moves makes events, and a changing tilt tells most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Swing {
    /// About a vertical axis.
    Sideways,
    /// About a horizontal axis.
    ToAndFro,
}

impl Swing {
    /// About the axis about which the place is tilted.
    pub fn of(place: &Place) -> Self {
        if place.tilt.x.abs() > place.tilt.y.abs() { Self::ToAndFro } else { Self::Sideways }
    }
}

/// What to do with the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Hint {
    /// It was not seen yet.
    Show,
    /// It was seen, and is not any more.
    Lost,
    /// Move it in the image: to the right, downwards (each −1, 0 or 1).
    Shift(i8, i8),
    /// Bring it closer.
    Closer,
    /// Take it farther away.
    Farther,
    /// Tilt it until this side is nearer.
    Nearer(Tilt),
    /// Turn it clockwise, as the camera sees it.
    Clockwise,
    /// Turn it the other way.
    Counterclockwise,
    /// It is where it should be.
    Stay,
    /// It is where it should be: move it about there.
    Swing(Swing),
    /// Enough was seen.
    Done,
}

impl Hint {
    /// The hint in words, as the camera sees the board, or as one sees it in a mirror.
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

    /// Whether two hints speak of the same thing, whatever the direction.
    fn is_like(self, other: Self) -> bool {
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

/// A board in front of the camera.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
    /// Its middle in camera coordinates (m).
    pub middle: Vector3<f64>,
    /// Its middle in the image (px).
    pub pixel: Vector2<f64>,
}

/// How far `now` is from `goal`, each kind of error in units of what is near enough, with the hint that goes with it.
/// Half a turn of the board about the camera's axis is no error: it looks the same.
pub fn errors(now: &Seen, goal: &Seen, width: f64) -> [(Hint, f64); 4] {
    let shift = goal.pixel - now.pixel;
    let eighth = |part: f64| if part.abs() > shift.norm() * (PI / 8.0).sin() { part.signum() as i8 } else { 0 };
    let ratio = now.middle.z / goal.middle.z;
    let (normal, wanted) = (now.pose.rotation * Vector3::z(), goal.pose.rotation * Vector3::z());
    // Depth on the board falls along its normal's direction in the image.
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

/// The hint for these errors: the largest, or the one before as long as it is worth about as much.
pub fn choose(errors: &[(Hint, f64); 4], before: Hint) -> Hint {
    let largest = errors.iter().fold((Hint::Stay, 1.0), |best, error| if error.1 > best.1 { *error } else { best });
    let same = errors.iter().find(|(hint, _)| hint.is_like(before));
    match same {
        _ if matches!(before, Hint::Stay | Hint::Swing(_)) && largest.1 < SWUNG => Hint::Stay,
        Some(&(hint, error)) if error > 1.0 && largest.1 < WORTH_CHANGE * error => hint,
        _ => largest.0,
    }
}

/// Turn of the board's rows in the image, positive clockwise (rad).
pub fn roll(pose: &Isometry3<f64>) -> f64 {
    let row = pose.rotation * Vector3::x();
    row.y.atan2(row.x)
}

/// An angle up to half turns, from −90° to 90°.
pub fn half_turn(angle: f64) -> f64 {
    (angle + FRAC_PI_2).rem_euclid(PI) - FRAC_PI_2
}

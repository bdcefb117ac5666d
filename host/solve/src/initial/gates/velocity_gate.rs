//! Velocity gate: neither board nor camera can jump from one frame to the next.
//!
//! Two neighbouring frames contradict each other if the motion between them is too fast; a frame is dropped if most of its
//! neighbours contradict it. A frame is also dropped if it lies too far off the lines through its neighbours: even a moderate
//! speed can require an impossible acceleration, for example if all circles of a frame are numbered one row too far.

use nalgebra::{Isometry3, Translation3};

use super::neighbour_vote::{Voter, vote};
use crate::initial::settings::{InitialSettings, MAX_MOTION_GAP};
use evcal_geometry::board::Board;
use evcal_geometry::numerics::statistics::median;

/// A frame with a pose, as input of the gate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Recording of the frame.
    pub recording: usize,
    /// Time of the frame in seconds.
    pub t: f64,
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
}

/// Distance that noise of the poses explains at any speed (m).
const POSITION_FLOOR: f64 = 0.02;
/// Angle that noise of the poses explains at any speed (rad).
const ANGLE_FLOOR: f64 = 0.05;
/// Largest acceleration (m/s²); a frame is compared with the line between its neighbours.
const MAX_ACCELERATION: f64 = 60.0;
/// Largest angular acceleration (rad/s²).
const MAX_ANGULAR_ACCELERATION: f64 = 300.0;
/// Largest acceleration and angular acceleration as a multiple of the recording's median.
const MAX_ACCELERATION_RATIO: f64 = 4.0;

/// Nearest frames on each side through which lines are drawn to check a frame.
const LINE_REACH: usize = 3;

/// Lines whose limit is more than this many times the narrowest one are ignored.
const WIDEST_LIMIT: f64 = 2.0;

/// A waypoint with its pose relative to the middle of the board.
#[derive(Clone, Copy)]
struct Centered {
    recording: usize,
    t: f64,
    /// `T_camera_middle`: the board's middle in camera coordinates, and the board's rotation.
    pose: Isometry3<f64>,
}

/// Distance in m and angle in rad between two poses.
///
/// The distance is measured for the camera in board coordinates or for the board's middle in camera coordinates, whichever is
/// less: rotation of either one about itself moves the other far.
fn motion(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
    let camera = (a.inverse().translation.vector - b.inverse().translation.vector).norm();
    let board = (a.translation.vector - b.translation.vector).norm();
    (camera.min(board), a.rotation.angle_to(&b.rotation))
}

/// Returns `true` for each of `waypoints`, in the order of recording and time, that is kept.
pub fn velocity_gate(waypoints: &[Waypoint], board: &Board, settings: &InitialSettings) -> Vec<bool> {
    let middle = Translation3::new(board.middle().x, board.middle().y, 0.0);
    let centered: Vec<Centered> = waypoints
        .iter()
        .map(|waypoint| Centered { recording: waypoint.recording, t: waypoint.t, pose: waypoint.pose * middle })
        .collect();
    let voters: Vec<Voter> =
        waypoints.iter().map(|waypoint| Voter { recording: waypoint.recording, t: waypoint.t }).collect();
    let kept = vote(&voters, |a, b| {
        let (a, b) = (centered.get(a)?, centered.get(b)?);
        let elapsed = (b.t - a.t).abs();
        let (distance, angle) = motion(&a.pose, &b.pose);
        (elapsed <= MAX_MOTION_GAP).then_some(
            distance <= POSITION_FLOOR + settings.max_speed * elapsed
                && angle <= ANGLE_FLOOR + settings.max_angular_speed * elapsed,
        )
    });
    smooth(&centered, kept)
}

/// Removes the frames that lie too far off the lines through their neighbours, the worst first, because its neighbours may only
/// look bad because of it.
fn smooth(waypoints: &[Centered], mut kept: Vec<bool>) -> Vec<bool> {
    let mut alive: Vec<usize> = kept.iter().enumerate().filter(|(_, kept)| **kept).map(|(index, _)| index).collect();
    let limits = Limits::new(waypoints, &alive);
    let judge = |alive: &[usize], position: usize| judge(waypoints, alive, position, &limits);
    let mut verdicts: Vec<Contradiction> = (0..alive.len()).map(|position| judge(&alive, position)).collect();
    loop {
        let worst = verdicts
            .iter()
            .enumerate()
            .filter(|(_, verdict)| verdict.contradicted > 0.5)
            .max_by(|(a, first), (b, second)| {
                let contradicted = first.contradicted.total_cmp(&second.contradicted);
                contradicted.then(first.excess.total_cmp(&second.excess)).then(b.cmp(a))
            })
            .map(|(position, _)| position);
        let Some(position) = worst else { break };
        if let Some(kept) = alive.get(position).and_then(|&index| kept.get_mut(index)) {
            *kept = false;
        }
        alive.remove(position);
        verdicts.remove(position);
        let first = position.saturating_sub(LINE_REACH);
        for (position, verdict) in verdicts.iter_mut().enumerate().skip(first).take(2 * LINE_REACH) {
            *verdict = judge(&alive, position);
        }
    }
    kept
}

/// Largest accelerations of a frame relative to the line through two others.
struct Limits {
    acceleration: f64,
    angular_acceleration: f64,
}

impl Limits {
    /// Returns the general limits, lowered if the recording's own motion is much gentler.
    fn new(waypoints: &[Centered], alive: &[usize]) -> Self {
        let mut accelerations = Vec::new();
        let mut angular_accelerations = Vec::new();
        for window in alive.windows(3) {
            let [before, here, after] = window else { continue };
            let (Some(before), Some(here), Some(after)) =
                (waypoints.get(*before), waypoints.get(*here), waypoints.get(*after))
            else {
                continue;
            };
            if let Some(line) = Line::new(before, after, here) {
                accelerations.push(line.distance / line.curvature);
                angular_accelerations.push(line.angle / line.curvature);
            }
        }
        let limit = |mut seen: Vec<f64>, most: f64| {
            let usual = median(&mut seen, f64::total_cmp);
            usual.map_or(most, |usual| (MAX_ACCELERATION_RATIO * usual).min(most))
        };
        Self {
            acceleration: limit(accelerations, MAX_ACCELERATION),
            angular_acceleration: limit(angular_accelerations, MAX_ANGULAR_ACCELERATION),
        }
    }
}

/// Deviation of a frame from the line through two others.
struct Line {
    distance: f64,
    angle: f64,
    /// Distance from the line per acceleration, in s²: a motion `a t² / 2` leaves the line through its points at t₁ and t₂ by `a
    /// |t − t₁| |t − t₂| / 2`.
    curvature: f64,
    /// Weight of the noise of the two others: 1 between them, more beyond.
    leverage: f64,
}

impl Line {
    fn new(a: &Centered, b: &Centered, here: &Centered) -> Option<Self> {
        let elapsed = b.t - a.t;
        let span = a.t.max(b.t).max(here.t) - a.t.min(b.t).min(here.t);
        let same = a.recording == here.recording && b.recording == here.recording;
        if !same || elapsed == 0.0 || here.t == a.t || here.t == b.t || span > MAX_MOTION_GAP {
            return None;
        }
        let part = (here.t - a.t) / elapsed;
        let rotation = a.pose.rotation * (a.pose.rotation.inverse() * b.pose.rotation).powf(part);
        let position = a.pose.translation.vector.lerp(&b.pose.translation.vector, part);
        let expected = Isometry3::from_parts(Translation3::from(position), rotation);
        let (distance, angle) = motion(&expected, &here.pose);
        let curvature = 0.5 * ((here.t - a.t) * (here.t - b.t)).abs();
        Some(Self { distance, angle, curvature, leverage: (1.0 + part.abs() + (1.0 - part).abs()) / 2.0 })
    }
}

/// Deviation of a frame from the lines through its neighbours.
#[derive(Clone, Copy, Debug, Default)]
struct Contradiction {
    /// Fraction of the lines from which the frame is too far.
    contradicted: f64,
    /// Median over the lines of the ratio of the distance to its limit.
    excess: f64,
}

fn judge(waypoints: &[Centered], alive: &[usize], position: usize, limits: &Limits) -> Contradiction {
    let Some(here) = alive.get(position).and_then(|&index| waypoints.get(index)) else {
        return Contradiction::default();
    };
    let first = position.saturating_sub(LINE_REACH);
    let neighbours: Vec<&Centered> = alive
        .iter()
        .enumerate()
        .skip(first)
        .take(position - first + LINE_REACH + 1)
        .filter(|(other, _)| *other != position)
        .filter_map(|(_, &index)| waypoints.get(index))
        .collect();
    // Limit of the distance and ratio to the limit for each line.
    let mut lines: Vec<(f64, f64)> = Vec::new();
    for (rank, a) in neighbours.iter().enumerate() {
        for line in neighbours.iter().skip(rank + 1).filter_map(|b| Line::new(a, b, here)) {
            let far = POSITION_FLOOR * line.leverage + limits.acceleration * line.curvature;
            let turned = ANGLE_FLOOR * line.leverage + limits.angular_acceleration * line.curvature;
            lines.push((far, (line.distance / far).max(line.angle / turned)));
        }
    }
    let narrowest = lines.iter().map(|line| line.0).fold(f64::INFINITY, f64::min);
    let mut excesses: Vec<f64> =
        lines.iter().filter(|line| line.0 <= WIDEST_LIMIT * narrowest).map(|line| line.1).collect();
    let contradicted = excesses.iter().filter(|excess| **excess > 1.0).count() as f64;
    let count = excesses.len() as f64;
    match median(&mut excesses, f64::total_cmp) {
        Some(excess) => Contradiction { contradicted: contradicted / count, excess },
        None => Contradiction::default(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    /// A hand's motion: 20 cm at 1.5 Hz, and a roll.
    fn waypoint(t: f64) -> Waypoint {
        let phase = 1.5 * std::f64::consts::TAU * t;
        let pose = Isometry3::new(
            Vector3::new(0.2 * phase.sin(), 0.1 * phase.cos(), 0.6),
            Vector3::new(0.1 * phase.sin(), 0.2, 0.5 * phase.cos()),
        );
        Waypoint { recording: 0, t, pose }
    }

    #[test]
    fn frames_numbered_one_row_too_far_are_dropped_and_the_others_are_kept() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        // On this board a wrong number is at least half a row and a column off: 78 mm.
        let shift = nalgebra::Translation3::new(0.055, 0.055, 0.0);
        // With 20 ms between frames, the motion of frames 0 and 1 together is possible for a hand.
        let cases: [(f64, &[i32]); 3] =
            [(0.005, &[0, 1, 40, 77, 78, 99]), (0.01, &[0, 1, 40, 77, 78, 99]), (0.02, &[0, 40, 77, 78, 99])];
        for (step, wrong) in cases {
            let waypoints: Vec<Waypoint> = (0..100)
                .map(|index| {
                    let mut waypoint = waypoint(f64::from(index) * step);
                    if wrong.contains(&index) {
                        waypoint.pose *= shift;
                    }
                    waypoint
                })
                .collect();
            let kept = velocity_gate(&waypoints, &board, &InitialSettings::default());
            let dropped: Vec<usize> =
                kept.iter().enumerate().filter(|(_, kept)| !**kept).map(|(index, _)| index).collect();
            let expected: Vec<usize> = wrong.iter().map(|&index| index as usize).collect();
            assert_eq!(dropped, expected, "{step}");
        }
    }

    #[test]
    fn rotation_of_a_distant_board_about_itself_is_not_a_jump() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let middle = Vector3::new(board.middle().x, board.middle().y, 0.0);
        // The board rotates at 15 rad/s about its middle, 1 m away: the camera moves at 15 m/s around it.
        let waypoints: Vec<Waypoint> = (0..20)
            .map(|index| {
                let t = f64::from(index) * 0.005;
                let turn = Isometry3::new(Vector3::new(0.0, 0.0, 1.0), Vector3::new(0.0, 0.6 * (25.0 * t).sin(), 0.0));
                Waypoint { recording: 0, t, pose: turn * nalgebra::Translation3::from(-middle) }
            })
            .collect();
        assert!(velocity_gate(&waypoints, &board, &InitialSettings::default()).iter().all(|kept| *kept));
    }
}

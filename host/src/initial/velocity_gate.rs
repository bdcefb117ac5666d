//! Velocity gate: neither board nor camera can jump from one frame to the next.
//!
//! Two neighbouring frames contradict each other if the motion between them is too fast; a frame is
//! dropped if most of its neighbours contradict it. A frame is dropped, too, if it lies too far off
//! the line between its neighbours: what is no speed record can still be an impossible acceleration,
//! for example when all circles of a frame are named one row too far.

use nalgebra::{Isometry3, Point3};

use super::neighbour_vote::{Voter, vote};
use super::settings::InitialSettings;
use crate::board::Board;

/// A frame with a pose, as the gate sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Recording of the frame.
    pub recording: usize,
    /// Time of the frame in seconds.
    pub t: f64,
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
}

/// Distance in m and angle in rad between two poses.
///
/// The distance is that of the camera in board coordinates or that of the board's middle in camera
/// coordinates, whichever is less: turning one of them about itself moves the other far.
fn motion(a: &Isometry3<f64>, b: &Isometry3<f64>, middle: &Point3<f64>) -> (f64, f64) {
    let camera = (a.inverse().translation.vector - b.inverse().translation.vector).norm();
    let board = (a * middle - b * middle).norm();
    (camera.min(board), a.rotation.angle_to(&b.rotation))
}

/// The pose at `t` on the straight line from `a` to `b`.
fn interpolate(a: &Waypoint, b: &Waypoint, t: f64) -> Isometry3<f64> {
    let part = (t - a.t) / (b.t - a.t);
    a.pose.try_lerp_slerp(&b.pose, part, 1e-9).unwrap_or(a.pose)
}

/// For each of `waypoints`, in the order of recording and time, whether it stays.
pub fn velocity_gate(waypoints: &[Waypoint], board: &Board, settings: &InitialSettings) -> Vec<bool> {
    let middle = Point3::new(board.middle().x, board.middle().y, 0.0);
    let voters: Vec<Voter> =
        waypoints.iter().map(|waypoint| Voter { recording: waypoint.recording, t: waypoint.t }).collect();
    let mut kept = vote(&voters, settings.voters, |a, b| {
        let (a, b) = (waypoints.get(a)?, waypoints.get(b)?);
        let elapsed = (b.t - a.t).abs();
        let (distance, angle) = motion(&a.pose, &b.pose, &middle);
        (elapsed <= settings.max_motion_gap).then_some(
            distance <= settings.position_floor + settings.max_speed * elapsed
                && angle <= settings.angle_floor + settings.max_angular_speed * elapsed,
        )
    });
    // The worst frame leaves first: its neighbours may only look bad because of it.
    loop {
        let alive: Vec<(usize, &Waypoint)> =
            waypoints.iter().enumerate().zip(&kept).filter(|(_, kept)| **kept).map(|(waypoint, _)| waypoint).collect();
        let worst = alive
            .windows(3)
            .filter_map(|window| {
                let [(_, before), (index, here), (_, after)] = window else { return None };
                Some((*index, excess(before, here, after, &middle, settings)?))
            })
            .filter(|(_, excess)| *excess > 1.0)
            .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        let Some(kept) = worst.and_then(|(index, _)| kept.get_mut(index)) else { break };
        *kept = false;
    }
    kept
}

/// How far `here` lies off the line from `before` to `after`, as a multiple of what the largest
/// acceleration explains; `None` where the frames are too far apart to tell.
fn excess(
    before: &Waypoint,
    here: &Waypoint,
    after: &Waypoint,
    middle: &Point3<f64>,
    settings: &InitialSettings,
) -> Option<f64> {
    let same = before.recording == here.recording && after.recording == here.recording;
    let (first, second) = (here.t - before.t, after.t - here.t);
    if !same || first + second > settings.max_motion_gap || first <= 0.0 || second <= 0.0 {
        return None;
    }
    let (distance, angle) = motion(&interpolate(before, after, here.t), &here.pose, middle);
    // A motion s = a t²/2 leaves its chord by a/2 times the product of the two parts.
    let curvature = 0.5 * first * second;
    let far = distance / (settings.position_floor + settings.max_acceleration * curvature);
    let turned = angle / (settings.angle_floor + settings.max_angular_acceleration * curvature);
    Some(far.max(turned))
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
    fn frames_named_one_row_too_far_leave_and_the_others_stay() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        for step in [0.005, 0.02, 0.03] {
            let wrong = [0, 1, 40, 77, 78, 99];
            let waypoints: Vec<Waypoint> = (0..100)
                .map(|index| {
                    let mut waypoint = waypoint(f64::from(index) * step);
                    if wrong.contains(&index) {
                        waypoint.pose *= nalgebra::Translation3::new(0.0, 0.055, 0.0);
                    }
                    waypoint
                })
                .collect();
            let kept = velocity_gate(&waypoints, &board, &InitialSettings::default());
            let dropped: Vec<usize> =
                kept.iter().enumerate().filter(|(_, kept)| !**kept).map(|(index, _)| index).collect();
            // At 30 ms a hand can do such a jump at the very ends, where there is no line to compare.
            let expected: Vec<usize> = wrong
                .iter()
                .map(|&index| index as usize)
                .filter(|index| step < 0.01 || (2..98).contains(index))
                .collect();
            for index in &expected {
                assert!(dropped.contains(index), "{step}: {dropped:?}");
            }
            for index in &dropped {
                assert!(wrong.contains(&(*index as i32)), "{step}: {dropped:?}");
            }
        }
    }

    #[test]
    fn turning_about_itself_at_a_distance_is_no_jump() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let middle = Vector3::new(board.middle().x, board.middle().y, 0.0);
        // The board turns at 15 rad/s about its middle, 1 m away: the camera moves at 15 m/s around it.
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

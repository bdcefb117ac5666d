//! Two cameras on a mount with a known transform.

use std::ops::Range;

use nalgebra::Vector3;

use super::*;
use evcal_geometry::board::Board;
use evcal_geometry::timed_pose::TimedPose;
use evcal_solve::trajectory::RotationSpline;
use evcal_solve::trajectory::alignment::AlignmentError;
use evcal_solve::trajectory::fit::{TrajectoryShape, fit};

const SECONDS: f64 = 24.0;
const OFFSET_TRUE: f64 = -1.237_45;
const RATE_TRUE: f64 = 60e-6;

/// `T_world_camera`, which never repeats; `turn` scales the rotation.
pub fn first_pose(t: f64, turn: f64) -> Isometry3<f64> {
    let turns = Vector3::new(
        0.4 * (2.1 * t).sin() + 0.2 * (5.3 * t + 0.4).sin() + 0.1 * (0.23 * t * t).cos(),
        0.3 * (1.7 * t + 1.0).cos() + 0.2 * (4.7 * t).sin() + 0.1 * (0.31 * t * t).sin(),
        0.3 * (1.3 * t).sin() + 0.15 * (6.1 * t).cos() + 0.1 * (0.27 * t * t).sin(),
    );
    let position = Vector3::new(
        0.2 + 0.2 * (1.1 * t).sin() + 0.03 * (7.0 * t).cos(),
        0.2 + 0.15 * (1.9 * t).cos(),
        -0.7 + 0.15 * (0.9 * t + 1.0).sin(),
    );
    Isometry3::new(position, turns * turn)
}

fn second_first() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(-0.1, 0.01, 0.02), Vector3::new(0.02, 0.15, -0.3))
}

pub fn fitted_to(pose: impl Fn(f64) -> Isometry3<f64>, span: Range<f64>) -> Trajectory {
    let count = (200.0 * (span.end - span.start)) as usize;
    let times =
        (0..=count).map(|index| (span.start + (span.end - span.start) * index as f64 / count as f64).min(span.end));
    let poses: Vec<TimedPose> = times.map(|t| TimedPose { t, pose: pose(t) }).collect();
    let shape = TrajectoryShape { degree: 3, rotation: RotationSpline::Quaternion, knot_spacing: 0.0175 };
    fit(0, &poses, span.start, span.end, &shape).unwrap()
}

fn first(turn: f64) -> Vec<Trajectory> {
    vec![
        fitted_to(|t| first_pose(t, turn), 0.0..0.6 * SECONDS),
        fitted_to(|t| first_pose(t, turn), 0.65 * SECONDS..SECONDS),
    ]
}

/// The second camera, which sees the board in the orientation `world`.
fn second(turn: f64, world: Isometry3<f64>) -> Vec<Trajectory> {
    let middle = 0.5 * SECONDS + OFFSET_TRUE;
    let pose = move |t: f64| {
        let time = t - OFFSET_TRUE - RATE_TRUE * (t - middle);
        world.inverse() * first_pose(time, turn) * second_first().inverse()
    };
    vec![fitted_to(pose, 1.0..0.5 * SECONDS), fitted_to(pose, 0.55 * SECONDS..SECONDS + 2.0)]
}

fn board(name: &str) -> Symmetries {
    Symmetries::of(&name.parse::<Board>().unwrap())
}

fn check(found: &Start) {
    let moved = found.mount.second_first.inverse() * second_first();
    assert!(moved.translation.vector.norm() < 1e-5 && moved.rotation.angle() < 1e-5, "{found:?}");
    let truth = |t: f64| t - OFFSET_TRUE - RATE_TRUE * (t - 0.5 * SECONDS - OFFSET_TRUE);
    for t in [2.0, 10.0, 20.0] {
        // The weak prior changes the rate by 0.3 %, which is 2 µs at the ends.
        assert!((found.mount.first_time(t) - truth(t)).abs() < 4e-6, "{found:?}");
    }
}

#[test]
fn transform_offset_and_rate_are_found() {
    let found = start(
        &first(1.0),
        &Seen::along(&second(1.0, Isometry3::identity())),
        &board("acircles:9x4:55mm:r17.5mm"),
        LOOSE,
    )
    .unwrap();
    check(&found);
    assert!(found.turns.values().all(|turn| *turn == 0) && found.correlation > 0.99);
    // Both saw the board, except for gaps and ends.
    assert!((18.0..22.5).contains(&found.seconds), "{}", found.seconds);
}

/// From poses of single frames at other times, with a pause.
#[test]
fn transform_offset_and_rate_are_found_from_frames() {
    let symmetries = board("acircles:10x4:55mm:r17.5mm");
    let along = second(1.0, symmetries.rotations[1].pose);
    let times = (0..600).map(|frame| 1.0 + f64::from(frame) / 30.0);
    let frames = times.filter_map(|t| Some((t, pose_of(&inner_sample(&along, t)?.1))));
    let seen = Seen::in_frames(frames);
    assert_eq!(seen.poses.last().map(|last| last.segment), Some(1));
    let found = start(&first(1.0), &seen, &symmetries, LOOSE).unwrap();
    check(&found);
    assert!(found.turns.values().all(|turn| *turn == 1) && found.correlation > 0.95, "{found:?}");
}

/// The times of frames are off by 2 ms to either side, or jump by 8 ms: with the right times the mount is rigid. A loose mount is not.
#[test]
fn times_that_scatter_are_named_and_a_loose_mount_is_not() {
    let along = second(1.0, Isometry3::identity());
    let scatter = |time: fn(u32) -> f64, pose: fn(u32) -> Isometry3<f64>| {
        let frame = |frame: u32| {
            let t = 1.0 + f64::from(frame) / 30.0;
            Some((t + time(frame), pose_of(&inner_sample(&along, t)?.1) * pose(frame)))
        };
        let seen = Seen::in_frames((0..600).filter_map(frame));
        start(&first(1.0), &seen, &board("acircles:9x4:55mm:r17.5mm"), LOOSE).unwrap().time_scatter
    };
    let still = |_| Isometry3::identity();
    assert_eq!(scatter(|_| 0.0, still), None);
    let every_other = scatter(|frame| if frame % 2 == 0 { 2e-3 } else { -2e-3 }, still).unwrap();
    assert!((every_other / 2e-3 - 1.0).abs() < 0.1, "{every_other}");
    let jump = scatter(|frame| if frame < 300 { 0.0 } else { 8e-3 }, still).unwrap();
    // A rate of the clock makes up for three quarters of the variance of a step.
    assert!((jump / 2e-3 - 1.0).abs() < 0.2, "{jump}");
    let swings = |frame: u32| Isometry3::new(Vector3::zeros(), Vector3::y() * 0.01 * (0.1 * f64::from(frame)).sin());
    assert_eq!(scatter(|_| 0.0, swings), None);
}

#[test]
fn a_board_seen_in_another_orientation_is_rotated_back() {
    for name in ["acircles:10x4:55mm:r17.5mm", "circles:5x5:50mm:r15mm"] {
        let symmetries = board(name);
        for (index, turn) in symmetries.rotations.iter().enumerate() {
            let found = start(&first(1.0), &Seen::along(&second(1.0, turn.pose)), &symmetries, LOOSE).unwrap();
            check(&found);
            assert!(found.turns.values().all(|found| *found == index), "{name} {index}: {:?}", found.turns);
        }
    }
}

/// Motion along the line of sight at the middle of the board, with rotation about it, does not determine the orientation of the
/// board.
#[test]
fn a_motion_that_does_not_determine_the_orientation_of_the_board_is_refused() {
    let symmetries = board("circles:5x4:50mm:r15mm");
    let middle = Vector3::new(0.075, 0.1, 0.0);
    let along = |t: f64| {
        let turn = 0.4 * (2.1 * t).sin()
            + 0.3 * (0.9 * t * t).sin()
            + 0.2 * (5.3 * t + 0.4).sin()
            + 0.3 * (0.31 * t * t).cos();
        Isometry3::new(middle - Vector3::z() * (0.7 + 0.1 * (1.3 * t).sin()), Vector3::z() * turn)
    };
    let aside = Isometry3::new(Vector3::new(0.0, 0.0, 0.05), Vector3::zeros());
    let one = vec![fitted_to(along, 0.0..10.0)];
    let other = vec![fitted_to(|t| along(t) * aside, 0.0..10.0)];
    assert_eq!(start(&one, &Seen::along(&other), &symmetries, LOOSE), Err(SecondCameraError::SymmetricBoard));
}

/// Its rotation rate is periodic, its position is not.
#[test]
fn an_offset_that_rotations_do_not_determine_is_found_from_the_positions() {
    let pose = |t: f64| {
        let turn = Vector3::new(0.4 * (4.0 * t).sin(), 0.3 * (8.0 * t).cos(), 0.0);
        Isometry3::new(Vector3::new(0.2 + 0.05 * (1.1 * t).sin(), 0.2 + 0.03 * (0.1 * t * t).cos(), -0.7), turn)
    };
    let later = |t: f64| pose(t - 0.8) * second_first().inverse();
    let symmetries = board("acircles:9x4:55mm:r17.5mm");
    let second = [fitted_to(later, 0.8..6.8)];
    let found = start(&[fitted_to(pose, 0.0..6.0)], &Seen::along(&second), &symmetries, LOOSE).unwrap();
    assert!((found.mount.offset - 0.8).abs() < 2e-3, "{}", found.mount.offset);
}

/// The rows of the second camera's image come from below, and it sees the rows of circles, of which there is an odd number, in
/// the opposite order.
#[test]
fn a_mirrored_camera_is_named() {
    let name = "acircles:9x4:55mm:r17.5mm";
    let (low, high) = name.parse::<Board>().unwrap().extent();
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    let mirrored = |t: f64| {
        let pose = first_pose(t, 1.0) * second_first().inverse();
        let rotation = flip * pose.rotation.to_rotation_matrix().into_inner() * flip;
        let rotation = UnitQuaternion::from_matrix(&rotation);
        let place = flip * pose.translation.vector + Vector3::new(0.0, low.y + high.y, 0.0);
        Isometry3::from_parts(place.into(), rotation)
    };
    let seen = Seen::along(&[fitted_to(mirrored, 0.0..SECONDS)]);
    assert_eq!(start(&first(1.0), &seen, &board(name), LOOSE), Err(SecondCameraError::Mirrored));
    let shown_by_tags = Symmetries { reflection: None, ..board(name) };
    let error = start(&first(1.0), &seen, &shown_by_tags, LOOSE).unwrap_err();
    assert!(matches!(error, SecondCameraError::NotFixed { .. }), "{error}");
}

#[test]
fn mistakes_are_named() {
    let symmetries = board("acircles:9x4:55mm:r17.5mm");
    let refused = |first: &[Trajectory], second: &[Trajectory]| {
        start(first, &Seen::along(second), &symmetries, LOOSE).unwrap_err()
    };
    let still = |t: f64| first_pose(t, 0.0);
    let error = refused(&[fitted_to(still, 0.0..8.0)], &[fitted_to(still, 0.0..8.0)]);
    assert!(matches!(error, SecondCameraError::Alignment(AlignmentError::LittleRotation { .. })), "{error}");
    let other = |t: f64| first_pose(0.77 * t + 100.0, 1.0);
    let error = refused(&first(1.0), &[fitted_to(other, 0.0..20.0)]);
    assert!(matches!(error, SecondCameraError::Alignment(AlignmentError::OtherMotion { .. })), "{error}");
    let periodic = |t: f64| {
        Isometry3::new(Vector3::new(0.2, 0.2, -0.7), Vector3::new(0.4 * (4.0 * t).sin(), 0.3 * (8.0 * t).cos(), 0.0))
    };
    let error = refused(&[fitted_to(periodic, 0.0..12.0)], &[fitted_to(periodic, 0.0..12.0)]);
    assert!(matches!(error, SecondCameraError::Alignment(AlignmentError::Ambiguous { .. })), "{error}");
    let even = |t: f64| Isometry3::new(Vector3::new(0.2, 0.2, -0.7), Vector3::y() * (0.2 * t - 1.2));
    let error = refused(&[fitted_to(even, 0.0..12.0)], &[fitted_to(even, 0.0..12.0)]);
    assert!(matches!(error, SecondCameraError::Alignment(AlignmentError::EvenRotation { .. })), "{error}");
    // A mount that bends by 10 cm, back and forth.
    let loose =
        |t: f64| first_pose(t, 1.0) * Isometry3::new(Vector3::new(0.1 * (0.7 * t).sin(), 0.0, 0.0), Vector3::zeros());
    let error = refused(&first(1.0), &[fitted_to(loose, 0.0..SECONDS)]);
    assert!(matches!(error, SecondCameraError::NotFixed { distance, .. } if distance > 0.02), "{error}");
    let error = refused(&first(1.0), &[]);
    assert!(matches!(error, SecondCameraError::HardlyTogether { seconds: [_, 0.0], .. }), "{error}");
}

/// A camera with a small view sees the whole board again and again, but never for long. No offset of the clocks then gives both
/// enough time, which says nothing about their motion.
#[test]
fn cameras_that_hardly_saw_the_board_together_are_not_taken_for_strangers() {
    let all = first(1.0);
    let short: Vec<Trajectory> = (0..6)
        .map(|index| fitted_to(|t| first_pose(t, 1.0), 3.0 * f64::from(index)..3.0 * f64::from(index) + 0.25))
        .collect();
    let symmetric = board("acircles:9x4:55mm:r17.5mm");
    let error = start(&all, &Seen::along(&short), &symmetric, LOOSE).unwrap_err();
    let SecondCameraError::HardlyTogether { seconds, needed } = &error else { panic!("{error}") };
    assert!(seconds[0] > 15.0 && seconds[1] < 1.5 && *needed == FEWEST_SECONDS, "{error}");
    assert!(error.to_string().contains("with the whole board in view of both"), "{error}");
}

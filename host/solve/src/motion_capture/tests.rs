//! A camera with a known motion, and a marker body on it.

use nalgebra::{Translation3, UnitQuaternion};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::trajectory::alignment::AlignmentError;
use evcal_geometry::numerics::random::normal;

const SECONDS: f64 = 24.0;
const OFFSET_TRUE: f64 = 3.217_45;
const DRIFT_TRUE: f64 = 40e-6;

/// `T_world_camera`, which never repeats; `turn` scales the rotation about each axis.
fn camera(t: f64, turn: Vector3<f64>) -> Isometry3<f64> {
    let turns = Vector3::new(
        0.4 * (2.1 * t).sin() + 0.2 * (5.3 * t + 0.4).sin() + 0.1 * (0.23 * t * t).cos(),
        0.3 * (1.7 * t + 1.0).cos() + 0.2 * (4.7 * t).sin() + 0.1 * (0.31 * t * t).sin(),
        0.3 * (1.3 * t).sin() + 0.15 * (6.1 * t).cos() + 0.1 * (0.27 * t * t).sin(),
    );
    let position = Vector3::new(
        0.2 * (1.1 * t).sin() + 0.03 * (7.0 * t).cos(),
        0.15 * (1.9 * t).cos(),
        -0.7 + 0.15 * (0.9 * t + 1.0).sin(),
    );
    Isometry3::new(position, turns.component_mul(&turn))
}

fn free() -> Vector3<f64> {
    Vector3::new(1.0, 1.0, 1.0)
}

fn camera_poses(turn: Vector3<f64>) -> Vec<TimedPose> {
    let count = (200.0 * SECONDS) as usize;
    (0..=count).map(|index| index as f64 / 200.0).map(|t| TimedPose { t, pose: camera(t, turn) }).collect()
}

fn camera_body() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(0.03, -0.06, -0.02), Vector3::new(0.2, -1.4, 0.9))
}

fn mocap_world() -> Isometry3<f64> {
    Isometry3::new(Vector3::new(1.2, 0.8, -2.5), Vector3::new(-0.3, 2.0, 0.5))
}

/// Noise of a capture.
struct Noise {
    /// Of positions (m).
    position: f64,
    /// Of rotations (degrees).
    rotation: f64,
}

const NONE: Noise = Noise { position: 0.0, rotation: 0.0 };
const USUAL: Noise = Noise { position: 3e-4, rotation: 0.2 };

/// Returns the poses of a capture with `noise`.
fn capture(turn: Vector3<f64>, noise: Noise) -> Vec<TimedPose> {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut vector = |size: f64| Vector3::from_fn(|_, _| size * normal(&mut random));
    let count = (120.0 * (SECONDS + 4.0)) as usize;
    (0..count)
        .map(|index| {
            let t = OFFSET_TRUE - 2.0 + index as f64 / 120.0;
            let event_time = t - OFFSET_TRUE - DRIFT_TRUE * (t - OFFSET_TRUE - 0.5 * SECONDS);
            let pose = mocap_world() * camera(event_time, turn) * camera_body();
            let rotation = pose.rotation * UnitQuaternion::new(vector(noise.rotation.to_radians()));
            let position = Translation3::from(pose.translation.vector + vector(noise.position));
            TimedPose { t, pose: Isometry3::from_parts(position, rotation) }
        })
        .collect()
}

fn changed(change: impl Fn(Isometry3<f64>) -> Isometry3<f64>) -> Vec<TimedPose> {
    capture(free(), USUAL).iter().map(|pose| TimedPose { t: pose.t, pose: change(pose.pose) }).collect()
}

#[test]
fn a_perfect_capture_yields_the_truth() {
    let found = compare(&camera_poses(free()), &capture(free(), NONE), None).unwrap();
    let moved = found.camera_body.pose.inverse() * camera_body();
    assert!(moved.translation.vector.norm() < 1e-6 && moved.rotation.angle() < 1e-6, "{found:?}");
    let moved = found.mocap_world.pose.inverse() * mocap_world();
    assert!(moved.translation.vector.norm() < 1e-6 && moved.rotation.angle() < 1e-6, "{found:?}");
    assert!((found.offset.value - OFFSET_TRUE).abs() < 1e-6, "{:?}", found.offset);
    assert!((found.drift.unwrap().value - DRIFT_TRUE).abs() < 1e-6, "{:?}", found.drift);
    assert!((found.scale.value - 1.0).abs() < 1e-6 && !found.lengths_differ());
    assert!(found.errors.held_out.position.sizes.rmse < 2e-6, "{:?}", found.errors);
}

#[test]
fn noise_is_measured_and_subtracted() {
    let (position, rotation) = (3e-4, 0.2);
    let found = compare(&camera_poses(free()), &capture(free(), Noise { position, rotation }), None).unwrap();
    let moved = found.camera_body.pose.inverse() * camera_body();
    assert!(moved.translation.vector.norm() < 5.0 * found.camera_body.translation_sigma.norm());
    assert!(found.camera_body.translation_sigma.norm() < 1e-4, "{found:?}");
    assert!(moved.rotation.angle() < 5.0 * found.camera_body.rotation_sigma.norm());
    assert!((found.offset.value - OFFSET_TRUE).abs() < 5.0 * found.offset.sigma && found.offset.sigma < 1e-4);
    assert!((found.spread.position / position - 1.0).abs() < 0.05, "{:?}", found.spread);
    assert!((found.spread.rotation / rotation.to_radians() - 1.0).abs() < 0.05, "{:?}", found.spread);
    // The camera's poses are exact: all errors are noise, apart from chance in the difference of both.
    let errors = &found.errors.held_out;
    // The squared error is within 3 σ of zero, and its σ is twice the error times the σ of the error.
    for errors in [&errors.position, &errors.rotation] {
        assert!(errors.error.value < 6.0 * errors.error.sigma && errors.error.sigma < 0.3 * errors.noise, "{errors:?}");
    }
    assert!(errors.position.sizes.rmse > 5e-4, "{errors:?}");
    assert!((found.rate - 120.0).abs() < 1e-6 && found.missing < 1e-9);
}

/// The error of a smooth trajectory is estimated correctly, whatever the noise of the capture.
#[test]
fn the_error_of_a_trajectory_is_measured_despite_noise() {
    let wrong =
        |t: f64| Vector3::new((19.0 * t + 0.1 * t * t).sin(), (23.0 * t).cos(), (29.0 * t + 0.2 * t * t).sin()) * 4e-4;
    let poses: Vec<TimedPose> = camera_poses(free())
        .iter()
        .map(|pose| TimedPose { t: pose.t, pose: Translation3::from(wrong(pose.t)) * pose.pose })
        .collect();
    let found = compare(&poses, &capture(free(), USUAL), None).unwrap();
    let truth = (1.5f64).sqrt() * 4e-4;
    let errors = &found.errors.held_out.position;
    assert!((errors.error.value / truth - 1.0).abs() < 0.05 && errors.error.sigma < 0.05 * truth, "{errors:?} {truth}");
    assert!(errors.sizes.rmse > 1.3 * truth, "{errors:?}");
}

#[test]
fn missing_poses_and_outliers_do_not_change_the_result() {
    let mut capture = capture(free(), USUAL);
    capture.retain(|pose| (pose.t * 1.7).fract() > 0.1);
    for pose in capture.iter_mut().step_by(97) {
        pose.pose.translation.vector.x += 0.05;
    }
    let found = compare(&camera_poses(free()), &capture, None).unwrap();
    let moved = found.camera_body.pose.inverse() * camera_body();
    assert!(moved.translation.vector.norm() < 2e-4 && moved.rotation.angle() < 2e-4, "{found:?}");
    assert!((0.07..0.13).contains(&found.missing), "{}", found.missing);
}

#[test]
fn degenerate_motion_is_refused() {
    let refused = |turn: Vector3<f64>| compare(&camera_poses(turn), &capture(turn, USUAL), None).unwrap_err();
    assert!(matches!(refused(Vector3::zeros()), MotionCaptureError::Alignment(AlignmentError::LittleRotation { .. })));
    for (axis, name) in ["x axis", "y axis", "z axis"].into_iter().enumerate() {
        let error = refused(Vector3::from_fn(|row, _| if row == axis { 1.0 } else { 0.0 }));
        assert!(error.to_string().contains(name), "{error}");
    }
    let short = &capture(free(), USUAL)[..600];
    let error = compare(&camera_poses(free()), short, None).unwrap_err();
    assert!(matches!(error, MotionCaptureError::TooShort { .. }), "{error}");
    let sparse: Vec<TimedPose> = camera_poses(free()).into_iter().step_by(8).collect();
    let error = compare(&sparse, &capture(free(), NONE), None).unwrap_err();
    assert!(error.to_string().contains("every 40 ms"), "{error}");
}

#[test]
fn motion_that_does_not_determine_the_clock_offset_is_refused() {
    let refused = |pose: fn(f64) -> Isometry3<f64>| {
        let mut camera = camera_poses(free());
        camera.iter_mut().for_each(|one| one.pose = pose(one.t));
        let mut body = capture(free(), NONE);
        body.iter_mut().for_each(|one| one.pose = mocap_world() * pose(one.t - OFFSET_TRUE) * camera_body());
        compare(&camera, &body, None).unwrap_err()
    };
    let error = refused(|t| Isometry3::new(Vector3::z() * -0.7, Vector3::y() * (0.2 * t - 2.4)));
    assert!(matches!(error, MotionCaptureError::Alignment(AlignmentError::EvenRotation { .. })), "{error}");
    let error = refused(|t| {
        Isometry3::new(Vector3::z() * -0.7, Vector3::new(0.4 * (4.0 * t).sin(), 0.3 * (8.0 * t).cos(), 0.0))
    });
    assert!(matches!(error, MotionCaptureError::Alignment(AlignmentError::Ambiguous { .. })), "{error}");
}

#[test]
fn mistakes_in_a_capture_are_named() {
    let camera = camera_poses(free());
    let refused = |words: &str, capture: &[TimedPose]| {
        let error = compare(&camera, capture, None).unwrap_err().to_string();
        assert!(error.contains(words), "wanted {words:?}: {error}");
    };
    let longer = |factor: f64| {
        changed(|pose| Isometry3::from_parts(Translation3::from(pose.translation.vector * factor), pose.rotation))
    };
    refused("in millimetres", &longer(1000.0));
    refused("in centimetres", &longer(100.0));
    refused("measure the spacing", &longer(1.05));
    refused("inverted", &changed(|pose| pose.inverse()));
    refused(
        "w first",
        &changed(|pose| {
            let [x, y, z, w]: [f64; 4] = pose.rotation.coords.into();
            let rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(z, w, x, y));
            Isometry3::from_parts(pose.translation, rotation)
        }),
    );
    let quaternion = |w, x, y, z| UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
    refused("conjugate", &changed(|pose| Isometry3::from_parts(pose.translation, pose.rotation.inverse())));
    // y and z are exchanged: a mirror.
    refused(
        "left-handed",
        &changed(|pose| {
            let (p, q) = (pose.translation, pose.rotation.coords);
            Isometry3::from_parts(Translation3::new(p.x, p.z, p.y), quaternion(q.w, -q.x, -q.z, -q.y))
        }),
    );
    // Only the columns of y and z of the quaternion are exchanged.
    refused(
        "no fixed mount",
        &changed(|pose| {
            let q = pose.rotation.coords;
            Isometry3::from_parts(pose.translation, quaternion(q.w, q.x, q.z, q.y))
        }),
    );
    let mut other = capture(free(), USUAL);
    other.iter_mut().for_each(|pose| pose.pose = self::camera(0.77 * pose.t + 100.0, free()));
    refused("does not match the camera", &other);
    let mut late = capture(free(), USUAL);
    late.iter_mut().for_each(|pose| pose.t *= 1e9);
    refused("times in seconds", &late);
}

#[test]
fn a_slightly_wrong_board_is_reported() {
    let capture =
        changed(|pose| Isometry3::from_parts(Translation3::from(pose.translation.vector * 1.01), pose.rotation));
    let found = compare(&camera_poses(free()), &capture, None).unwrap();
    // The body's distance from the camera is scaled, too.
    assert!((found.scale.value - 1.01).abs() < 3e-4, "{:?}", found.scale);
    assert!(found.lengths_differ());
}

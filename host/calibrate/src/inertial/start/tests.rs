use evcal_core::spline::rotation::exp;
use nalgebra::{Isometry3, Rotation3};

use super::super::prediction::{accelerometer, gyroscope};
use super::super::solve::smooth_trajectories;
use super::*;
use evcal_geometry::timed_pose::TimedPose;
use evcal_solve::trajectory::fit::{TrajectoryShape, fit};
use evcal_solve::trajectory::{RotationSpline, Trajectory};

const GRAVITY: f64 = 9.81;

/// A motion that does not repeat, with rotations `turns` about the three axes (rad).
fn hand(turns: [f64; 3]) -> Trajectory {
    of_motion(|t| hand_pose(t, turns))
}

fn hand_pose(t: f64, turns: [f64; 3]) -> Isometry3<f64> {
    let wave = |t: f64, seed: f64| (2.1 * t + seed).sin() + 0.7 * (3.7 * t * (1.0 + 0.02 * t) + 2.0 * seed).sin();
    let turn = Vector3::new(turns[0] * wave(t, 0.3), turns[1] * wave(t, 1.9), turns[2] * wave(t, 4.0));
    let place = Vector3::new(0.1 * wave(t, 2.2), 0.1 * wave(t, 5.0), -0.7 + 0.1 * wave(t, 1.1));
    Isometry3::from_parts(place.into(), exp(&turn))
}

fn of_motion(pose: impl Fn(f64) -> Isometry3<f64>) -> Trajectory {
    let poses: Vec<TimedPose> =
        (0..=2400).map(|index| 0.005 * f64::from(index)).map(|t| TimedPose { t, pose: pose(t) }).collect();
    let shape = TrajectoryShape { degree: 3, rotation: RotationSpline::Quaternion, knot_spacing: 0.015 };
    let cubic = fit(0, &poses, 0.0, 12.0, &shape).unwrap();
    smooth_trajectories(&[cubic], 0.02).unwrap().remove(0)
}

fn unit(rotation: UnitQuaternion<f64>, delay: f64) -> InertialParameters {
    InertialParameters {
        rotation,
        position: Vector3::new(0.02, -0.03, 0.05),
        gyroscope_delay: delay,
        accelerometer_delay: delay,
        gyroscope_bias: Vector3::new(0.05, -0.1, 0.02),
        accelerometer_bias: Vector3::new(0.1, 0.2, -0.1),
        ..InertialParameters::perfect(Vector3::new(0.3, 0.9, 0.1).normalize() * GRAVITY, 6.0)
    }
}

/// Samples of the IMU along `trajectory` at `rate` per second.
fn samples(trajectory: &Trajectory, unit: &InertialParameters, rate: f64) -> Vec<Sample> {
    let count = (12.0 * rate) as i32;
    let at = |index: i32| {
        let t = f64::from(index) / rate + unit.gyroscope_delay;
        Some(Sample {
            t,
            acceleration: accelerometer(trajectory, unit, t)?.value,
            angular_velocity: gyroscope(trajectory, unit, t)?.value,
        })
    };
    (0..count).filter_map(at).collect()
}

/// The 24 rotations that map axes to axes, and the 24 mirrored ones.
fn axis_turns() -> Vec<Matrix3<f64>> {
    let orders = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]];
    let turn = |order: [usize; 3], signs: usize| {
        let mut matrix = Matrix3::zeros();
        for (row, column) in order.into_iter().enumerate() {
            matrix[(row, column)] = if signs >> row & 1 == 1 { -1.0 } else { 1.0 };
        }
        matrix
    };
    orders.into_iter().flat_map(|order| (0..8).map(move |signs| turn(order, signs))).collect()
}

fn check(found: &Start, truth: &InertialParameters) {
    let parameters = &found.parameters;
    let error = parameters.rotation.angle_to(&truth.rotation);
    assert!(error < 0.02, "rotation is off by {error}");
    assert!((parameters.gyroscope_delay - truth.gyroscope_delay).abs() < 4e-3, "{}", parameters.gyroscope_delay);
    assert!((parameters.position - truth.position).norm() < 0.02, "{}", parameters.position);
    assert!(parameters.gravity.angle(&truth.gravity) < 0.02);
    assert!(found.correlation > 0.97, "{}", found.correlation);
}

#[test]
fn any_axes_are_found_and_mirrored_ones_are_named() {
    let trajectory = hand([0.3, 0.35, 0.25]);
    let plain = samples(&trajectory, &unit(UnitQuaternion::identity(), 0.003), 250.0);
    for turn in axis_turns() {
        let turned: Vec<Sample> = plain
            .iter()
            .map(|sample| Sample {
                acceleration: turn * sample.acceleration,
                angular_velocity: turn * sample.angular_velocity,
                ..*sample
            })
            .collect();
        let found = start(&[&trajectory], &turned, GRAVITY);
        if turn.determinant() > 0.0 {
            check(
                &found.unwrap(),
                &unit(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn)), 0.003),
            );
        } else {
            assert!(matches!(found, Err(InertialError::LeftHanded)), "{turn}: {found:?}");
        }
    }
}

/// The camera's rows come from below, or the accelerometer has the opposite sign.
#[test]
fn a_mirrored_image_and_opposite_accelerations_are_named() {
    let turns = [0.3, 0.35, 0.25];
    let truth = unit(exp(&Vector3::new(1.0, -2.0, 0.5)), 0.003);
    let plain = samples(&hand(turns), &truth, 250.0);
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
    let mirrored = of_motion(|t| {
        let pose = hand_pose(t, turns);
        let rotation = UnitQuaternion::from_matrix(&(flip * pose.rotation.to_rotation_matrix().into_inner() * flip));
        Isometry3::from_parts((flip * pose.translation.vector).into(), rotation)
    });
    let opposite = |sample: &Sample| Sample { acceleration: -sample.acceleration, ..*sample };
    let opposite: Vec<Sample> = plain.iter().map(opposite).collect();
    for (trajectory, samples) in [(mirrored, plain), (hand(turns), opposite)] {
        let error = start(&[&trajectory], &samples, GRAVITY).unwrap_err();
        assert!(matches!(error, InertialError::OppositeAccelerations), "{error}");
    }
}

#[test]
fn any_offset_and_rate_lead_to_the_same_position() {
    let trajectory = hand([0.3, 0.35, 0.25]);
    for (delay, rate) in [(-5.0, 1000.0), (5.0, 200.0), (0.002, 50.0), (-1.3, 20.0), (2.0, 100.0)] {
        let truth = unit(exp(&Vector3::new(1.0, -2.0, 0.5)), delay);
        let mut samples = samples(&trajectory, &truth, rate);
        // A gap of half a second.
        samples.retain(|sample| !(4.0..4.5).contains(&(sample.t - delay)));
        check(&start(&[&trajectory], &samples, GRAVITY).unwrap(), &truth);
    }
}

#[test]
fn degenerate_motions_are_named() {
    let truth = unit(exp(&Vector3::new(1.0, -2.0, 0.5)), 0.003);
    let refusal = |trajectory: &Trajectory| {
        let samples = samples(trajectory, &truth, 250.0);
        start(&[trajectory], &samples, GRAVITY).map(|found| found.parameters).unwrap_err()
    };
    let still = refusal(&hand([0.0; 3]));
    assert!(matches!(still, InertialError::Alignment(AlignmentError::LittleRotation { .. })), "{still}");
    let one = refusal(&hand([0.0, 0.3, 0.0]));
    assert!(
        matches!(one, InertialError::Alignment(AlignmentError::OneAxis { axis }) if axis.starts_with('y')),
        "{one}"
    );
    let swing = refusal(&of_motion(|t| {
        let turn = Vector3::new(0.3 * (4.0 * t).sin(), 0.2 * (4.0 * t + 1.0).sin(), 0.0);
        Isometry3::new(Vector3::new(0.0, 0.0, -0.7), turn)
    }));
    assert!(matches!(swing, InertialError::Alignment(AlignmentError::Ambiguous { .. })), "{swing}");
    // A turntable.
    let table = refusal(&of_motion(|t| Isometry3::new(Vector3::new(0.0, 0.0, -0.7), Vector3::new(0.0, 0.4 * t, 0.0))));
    assert!(!table.to_string().is_empty());
}

/// The magnitudes of the rates repeat every 1.7 s, but not their directions. The motion was called periodic.
#[test]
fn directions_decide_between_offsets_with_equal_rates() {
    let trajectory = of_motion(|t| {
        let axis = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.9 * t + 0.8 * (0.7 * t).sin());
        let turn = axis * Vector3::new(0.4 * (std::f64::consts::TAU * t / 1.7).sin(), 0.0, 0.0);
        Isometry3::from_parts(Vector3::new(0.1 * (2.3 * t).sin(), 0.1 * (1.9 * t).cos(), -0.7).into(), exp(&turn))
    });
    let truth = unit(exp(&Vector3::new(1.0, -2.0, 0.5)), 0.2);
    let samples = samples(&trajectory, &truth, 250.0);
    let found = start(&[&trajectory], &samples, GRAVITY).unwrap();
    assert!((found.parameters.gyroscope_delay - 0.2).abs() < 2e-3, "{}", found.parameters.gyroscope_delay);
}

#[test]
fn a_clock_at_another_rate_is_named() {
    let trajectory = hand([0.3, 0.35, 0.25]);
    let truth = unit(exp(&Vector3::new(1.0, -2.0, 0.5)), 0.003);
    for (stamped, began) in [(2.0, 0.0), (2.0, 20.0), (0.5, 0.0)] {
        let mut samples = samples(&trajectory, &truth, 250.0);
        samples.iter_mut().for_each(|sample| sample.t = began + stamped * sample.t);
        let error = start(&[&trajectory], &samples, GRAVITY).unwrap_err();
        let InertialError::Alignment(AlignmentError::OtherRate { rate }) = error else { panic!("{error}") };
        assert!((rate - stamped).abs() < 1e-9, "{rate}");
    }
}

#[test]
fn a_wrong_size_of_gravity_is_named() {
    let trajectory = hand([0.3, 0.35, 0.25]);
    let samples = samples(&trajectory, &unit(UnitQuaternion::identity(), 0.003), 250.0);
    let error = start(&[&trajectory], &samples, 11.0).unwrap_err();
    assert!(matches!(error, InertialError::GravitySize { size, .. } if (size - GRAVITY).abs() < 0.1), "{error}");
    for stated in [f64::NAN, 0.0] {
        let error = start(&[&trajectory], &samples, stated).unwrap_err();
        assert!(matches!(error, InertialError::GravitySize { .. }), "{stated}: {error}");
    }
}

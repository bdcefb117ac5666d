//! Derivatives compared with differences.

use evcal_core::spline::rotation::exp;

use super::*;
use evcal_solve::trajectory::CONTROL_POINT_PARAMETERS;

fn trajectory() -> Trajectory {
    let count = 12;
    let turn = |i: usize| {
        let x = i as f64;
        exp(&Vector3::new(0.3 * (0.9 * x).sin(), 0.2 * (0.7 * x).cos(), 0.1 * x))
    };
    let mut knots = vec![0.0; 6];
    knots.extend((1..count - 5).map(|i| 0.022 * i as f64));
    knots.extend([0.022 * (count - 5) as f64; 6]);
    Trajectory {
        recording: 0,
        knots,
        degree: 5,
        translation: (0..count).map(|i| Vector3::new((i as f64).sin(), (2.0 * i as f64).cos(), 0.3) * 0.01).collect(),
        rotation: RotationControl::Quaternion((0..count).map(|i| turn(i).into_inner()).collect()),
    }
}

fn parameters() -> InertialParameters {
    InertialParameters {
        rotation: exp(&Vector3::new(0.3, -1.2, 0.4)),
        position: Vector3::new(0.03, -0.02, -0.05),
        gyroscope_delay: 0.003,
        accelerometer_delay: 0.002,
        gyroscope_bias: Vector3::new(0.1, 0.02, -0.03),
        accelerometer_bias: Vector3::new(0.2, -0.1, 0.3),
        gravity: Vector3::new(1.0, 9.0, -2.0),
        accelerometer_matrix: Matrix3::new(1.01, 0.0, 0.0, 0.02, 0.98, 0.0, -0.01, 0.005, 1.02),
        gyroscope_matrix: Matrix3::new(0.99, 0.0, 0.0, 0.01, 1.03, 0.0, 0.02, -0.015, 1.0),
        gyroscope_from_imu: exp(&Vector3::new(0.01, 0.02, -0.03)),
        board_scale: 1.02,
        clock_drift: 1e-4,
        gyroscope_filter: 2e-6,
        accelerometer_filter: 1e-6,
        middle: 0.05,
    }
}

type Sensor = fn(&Trajectory, &InertialParameters, f64) -> Option<Prediction>;

#[test]
fn derivatives_by_parameters_agree_with_differences() {
    let trajectory = trajectory();
    let step = 1e-6;
    for sensor in [gyroscope as Sensor, accelerometer] {
        for index in 0..COUNT {
            let mut parameters = parameters();
            if [ACCELEROMETER_DELAY, CLOCK_DRIFT].contains(&index) {
                // The derivative neglects that the filter's term changes with time, so the filter is switched off.
                parameters.accelerometer_filter = 0.0;
            }
            let at = |size: f64| {
                let mut delta = [0.0; COUNT];
                delta[index] = size;
                sensor(&trajectory, &parameters.moved(&delta), 0.094).unwrap().value
            };
            let here = sensor(&trajectory, &parameters, 0.094).unwrap().by_parameters[index];
            let numeric = (at(step) - at(-step)) / (2.0 * step);
            assert!((numeric - here).norm() < 1e-3 * (1.0 + numeric.norm()), "{index}: {numeric} {here}");
        }
    }
}

#[test]
fn derivatives_by_control_points_agree_with_differences() {
    let (trajectory, parameters) = (trajectory(), parameters());
    for sensor in [gyroscope as Sensor, accelerometer] {
        let here = sensor(&trajectory, &parameters, 0.09).unwrap();
        for place in 0..MAX_ORDER {
            for axis in 0..CONTROL_POINT_PARAMETERS {
                let at = |size: f64| {
                    let mut delta = vec![0.0; CONTROL_POINT_PARAMETERS * trajectory.control_point_count()];
                    delta[CONTROL_POINT_PARAMETERS * (here.first + place) + axis] = size;
                    let mut moved = trajectory.clone();
                    moved.update(&delta);
                    sensor(&moved, &parameters, 0.09).unwrap().value
                };
                let numeric = (at(1e-7) - at(-1e-7)) / 2e-7;
                let expected: Vector3<f64> = if axis < 3 {
                    here.by_rotation[place].column(axis).into()
                } else {
                    here.by_translation[place].column(axis - 3).into()
                };
                assert!((numeric - expected).norm() < 1e-4 * (1.0 + numeric.norm()), "{place} {axis}");
            }
        }
    }
}

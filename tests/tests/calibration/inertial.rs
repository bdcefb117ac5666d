//! Calibration of an IMU on the camera from a simulated recording: the estimate is close to the truth, and faulty samples are
//! reported.

use std::fs;
use std::ops::ControlFlow;
use std::path::PathBuf;

use evcal_calibrate::calibrate::calibrate;
use evcal_calibrate::calibrate::calibrated::{Calibrated, Evidence};
use evcal_calibrate::calibrate::inertia::{InertialRequest, calibrate_inertial};
use evcal_calibrate::inertial::calibration::InertialCalibration;
use evcal_calibrate::inertial::error::InertialError;
use evcal_calibrate::inertial::parameters::{
    ACCELEROMETER_BIAS, ACCELEROMETER_DELAY, ACCELEROMETER_MATRIX, BOARD_SCALE, CLOCK_DRIFT, GYROSCOPE_BIAS,
    GYROSCOPE_DELAY, GYROSCOPE_MATRIX, POSITION, ROTATION, TRIANGLE,
};
use evcal_calibrate::inertial::sample::Sample;
use evcal_calibrate::inertial::settings::InertialSettings;
use evcal_calibrate::inertial::stream::read;
use evcal_calibrate::inertial::{RecordedSamples, calibrate_unit};
use evcal_calibrate::quality::verdict::Cause;
use evcal_calibrate::task::input::Input;
use evcal_calibrate::task::{PictureUse, Task};
use evcal_geometry::numerics::gravity::STANDARD_GRAVITY;
use evcal_tests::lens::{Lens, RADTAN4};
use evcal_tests::values::numbers;
use evcal_tests::{BOARD, evcal, one_axis, read_json, text};
use event_recordings::RecordingOptions;
use nalgebra::{Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector3};
use serde_json::Value;

const LENS: Lens = RADTAN4;

/// Ground truth of the simulation, from `truth.json`; the biases of both sensors in SI units.
struct Truth {
    gyroscope_bias: Vector3<f64>,
    accelerometer_bias: Vector3<f64>,
    imu_from_camera: Matrix4<f64>,
    accelerometer: Matrix3<f64>,
    gyroscope: Matrix3<f64>,
}

impl Truth {
    fn new(file: &Value) -> Self {
        let bias = &file["davis"]["imu_bias"];
        let mount = &bias["mount"];
        let vector = |value: &Value, unit: f64| Vector3::from_vec(numbers(value)) * unit;
        Self {
            gyroscope_bias: vector(&bias["angular_velocity"], 1f64.to_radians()),
            accelerometer_bias: vector(&bias["acceleration"], STANDARD_GRAVITY),
            imu_from_camera: Matrix4::from_row_slice(&numbers(&mount["imu_from_camera"])),
            accelerometer: Matrix3::from_row_slice(&numbers(&mount["accelerometer_matrix"])),
            gyroscope: Matrix3::from_row_slice(&numbers(&mount["gyroscope_matrix"])),
        }
    }

    /// Returns the errors of rotation (rad, axes of the camera) and position (m, camera frame).
    fn errors(&self, found: &InertialCalibration) -> (Vector3<f64>, Vector3<f64>) {
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
            self.imu_from_camera.fixed_view::<3, 3>(0, 0).into_owned(),
        ));
        let position = -(rotation.inverse() * self.imu_from_camera.fixed_view::<3, 1>(0, 3).into_owned());
        ((rotation.inverse() * found.parameters.rotation).scaled_axis(), found.parameters.position - position)
    }
}

fn check(found: &InertialCalibration, truth: &Truth) {
    let (rotation, position) = truth.errors(found);
    let assert_within = |name: &str, first: usize, errors: &[f64], bound: f64| {
        for (axis, error) in errors.iter().enumerate() {
            let sigma = found.sigma(first + axis);
            assert!(
                error.abs() < bound && error.abs() < 4.5 * sigma,
                "{name} {axis}: off by {error}, reported σ {sigma}"
            );
            assert!(sigma < bound, "{name} {axis}: σ {sigma}");
        }
    };
    assert_within("rotation", ROTATION, rotation.as_slice(), 0.1f64.to_radians());
    assert_within("position", POSITION, position.as_slice(), 1.5e-3);
    let parameters = &found.parameters;
    // The delay includes the pixel latency of 0.1 to 0.2 ms; the delay between the sensors of the IMU does not.
    let (gyroscope, accelerometer) = (parameters.gyroscope_delay, parameters.accelerometer_delay);
    assert!((2.5e-3..2.95e-3).contains(&gyroscope), "{gyroscope}");
    assert!((gyroscope - accelerometer - 1e-3).abs() < 1e-4, "{gyroscope} {accelerometer}");
    assert!(found.sigma(GYROSCOPE_DELAY).max(found.sigma(ACCELEROMETER_DELAY)) < 1e-4);
    let bias = parameters.gyroscope_bias - truth.gyroscope_bias;
    assert_within("gyroscope's bias", GYROSCOPE_BIAS, bias.as_slice(), 0.05f64.to_radians());
    let bias = parameters.accelerometer_bias - truth.accelerometer_bias;
    assert_within("accelerometer's bias", ACCELEROMETER_BIAS, bias.as_slice(), 3e-3 * STANDARD_GRAVITY);
    let entries = |matrix: Matrix3<f64>| TRIANGLE.map(|index| matrix[index]);
    assert_within(
        "accelerometer's scale",
        ACCELEROMETER_MATRIX,
        &entries(parameters.accelerometer_matrix - truth.accelerometer),
        3e-3,
    );
    assert_within("gyroscope's scale", GYROSCOPE_MATRIX, &entries(parameters.gyroscope_matrix - truth.gyroscope), 2e-3);
    let tilt = parameters.gravity.angle(&Vector3::y()).to_degrees();
    assert!(tilt < 0.1, "gravity is off by {tilt} degrees");
    assert!((parameters.board_scale - 1.0).abs() < 3e-3, "{}", parameters.board_scale);
}

/// A calibrated camera with IMU samples, which the tests change before they calibrate the IMU.
struct Bench<'a> {
    calibrated: &'a Calibrated,
    samples: Vec<Sample>,
}

impl Bench<'_> {
    fn with(&self, change: impl Fn(&mut Vec<Sample>)) -> Result<InertialCalibration, InertialError> {
        let mut samples = self.samples.clone();
        change(&mut samples);
        let recorded =
            vec![RecordedSamples { recording: 0, samples, start: self.calibrated.starts[0], lost: Vec::new() }];
        let Evidence::Events(events) = &self.calibrated.evidence else { panic!("no trajectory") };
        calibrate_unit(
            recorded,
            &events.refined,
            &self.calibrated.quality.uncertainty,
            None,
            &InertialSettings::default(),
        )
    }

    fn rejected(&self, words: &str, change: impl Fn(&mut Sample)) {
        let error = self.with(|samples| samples.iter_mut().for_each(&change)).err().map(|error| error.to_string());
        assert!(error.as_ref().is_some_and(|error| error.contains(words)), "wanted {words:?}: {error:?}");
    }
}

#[test]
fn the_imu_is_estimated_correctly_and_faulty_samples_are_reported() {
    let folder = recording();
    let truth = Truth::new(&read_json(&folder.join("truth.json")));
    let board = BOARD.parse().unwrap();
    let inputs = [Input::open(&folder.join("events.aedat4"), &RecordingOptions::default(), &board).unwrap()];
    let task = Task { pictures: PictureUse::Ignore, ..Task::new(&inputs, &board) };
    let mut calibrated = calibrate(&task, |_| ControlFlow::Continue(())).unwrap();
    let found = calibrate_inertial(&task, &calibrated, &InertialRequest::default(), None).unwrap();
    check(&found, &truth);
    assert!(found.camera_moved.unwrap() < 2.0, "the camera moved by {:?} σ", found.camera_moved);
    assert_eq!(found.findings, [], "there are no findings");

    let Input::Events(recording) = &inputs[0] else { panic!("a recording") };
    let bench = Bench { calibrated: &calibrated, samples: read(recording).unwrap().samples };
    wrong_units_and_axes(&bench);
    other_clocks_and_axes(&bench, &found, &truth);
    drifting(&bench, &found);
    losing(&bench, &found);
    at_its_limit(&bench, &found);
    without_gravity(&bench, &found);
    loose(&bench);

    calibrated.inertial = Some(found);
    files(&calibrated, &task);
}

fn recording() -> PathBuf {
    LENS.simulation("inertial", &["--motion", "fast", "--duration", "8s", "--imu", "davis346"])
}

#[test]
fn the_imu_is_calibrated_along_the_trajectory_of_frames() {
    let options = ["--motion", "fast", "--duration", "5s", "--imu", "davis346", "--frames", "25"];
    let folder = LENS.simulation("inertial-frames", &options);
    let truth = Truth::new(&read_json(&folder.join("truth.json")));
    let board = BOARD.parse().unwrap();
    let inputs = [Input::open(&folder.join("events.aedat4"), &RecordingOptions::default(), &board).unwrap()];
    let task = Task { pictures: PictureUse::Only, ..Task::new(&inputs, &board) };
    let calibrated = calibrate(&task, |_| ControlFlow::Continue(())).unwrap();
    let found = calibrate_inertial(&task, &calibrated, &InertialRequest::default(), None).unwrap();
    let (rotation, position) = truth.errors(&found);
    for (first, errors, limit) in [(ROTATION, rotation, 0.1f64.to_radians()), (POSITION, position, 2e-3)] {
        for axis in 0..3 {
            let (error, sigma) = (errors[axis].abs(), found.sigma(first + axis));
            assert!(error < limit && error < 4.0 * sigma && sigma < limit, "{first} {axis}: off by {error} ± {sigma}");
        }
    }
    assert!(found.parameters.gravity.angle(&Vector3::y()) < 0.1f64.to_radians(), "{}", found.parameters.gravity);
}

/// The nominal spacing of the board is 1 % too large.
fn causes(found: &InertialCalibration) -> Vec<Cause> {
    found.findings.iter().map(|finding| finding.cause).collect()
}

#[test]
fn a_wrong_nominal_spacing_is_reported() {
    let board = "acircles:9x4:55.55mm:r17.675mm".parse().unwrap();
    let inputs = [Input::open(&recording().join("events.aedat4"), &RecordingOptions::default(), &board).unwrap()];
    let task = Task { pictures: PictureUse::Ignore, ..Task::new(&inputs, &board) };
    let calibrated = calibrate(&task, |_| ControlFlow::Continue(())).unwrap();
    let found = calibrate_inertial(&task, &calibrated, &InertialRequest::default(), None).unwrap();
    assert_eq!(causes(&found), [Cause::BoardSpacing]);
    let (scale, sigma) = (found.parameters.board_scale, found.sigma(BOARD_SCALE));
    assert!((scale - 1.0 / 1.01).abs() < 3e-3 && sigma < 3.5e-3, "{scale} ± {sigma}");
}

/// The message names the axis, and the camera is calibrated nevertheless. The tests of `evcal-calibrate` cover other such
/// motions.
#[test]
fn a_motion_that_does_not_determine_the_imu_is_rejected() {
    let scratch = tempfile::tempdir().unwrap();
    let (events, result) = (one_axis().join("events.aedat4"), scratch.path().join("result"));
    let finished = evcal(&["calibrate", text(&events), "--board", BOARD, "--accept-any", "-o", text(&result), "--imu"]);
    assert_eq!(finished.code, Some(1), "{}", finished.stdout);
    let words = "about one axis only, its y axis (downwards)";
    assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
    assert!(!finished.stdout.contains("IMU, from"), "{}", finished.stdout);
    let file = read_json(&result.join("calibration.json"));
    assert!(file["inertial"].is_null() && file["camera"].is_object());
}

/// The IMU slips by one degree in the middle of the recording: the camera is good, the IMU is not, and the exit code is 3.
#[test]
fn a_loose_imu_has_the_exit_code_for_not_good_enough() {
    let scratch = tempfile::tempdir().unwrap();
    let simulation = recording();
    let table = fs::read_to_string(simulation.join("imu.csv")).unwrap();
    let (half, mut slipped) = (table.lines().count() / 2, String::new());
    for (index, line) in table.lines().enumerate() {
        let numbers: Vec<f64> = line.split(',').filter_map(|number| number.parse().ok()).collect();
        match numbers.as_slice() {
            [t, sensors @ ..] if index > half && sensors.len() == 6 => {
                let turned: Vec<f64> =
                    sensors.chunks(3).flat_map(|axes| (slip() * Vector3::from_row_slice(axes)).data.0[0]).collect();
                let turned: Vec<String> = turned.iter().map(f64::to_string).collect();
                slipped.push_str(&format!("{t},{}\n", turned.join(",")));
            }
            _ => slipped.push_str(&format!("{line}\n")),
        }
    }
    let (samples, result) = (scratch.path().join("slipped.csv"), scratch.path().join("result"));
    fs::write(&samples, slipped).unwrap();
    let events = simulation.join("events.aedat4");
    let options = ["--board", BOARD, "--imu", text(&samples), "-o", text(&result)];
    let finished = evcal(&[&["calibrate", text(&events)], &options[..]].concat());
    assert_eq!(finished.code, Some(3), "{}", finished.stderr);
    assert!(
        finished.stdout.contains("parts of the recording disagree on the position of the IMU"),
        "{}",
        finished.stdout
    );
    let file = read_json(&result.join("calibration.json"));
    assert_eq!(file["inertial"]["grade"], "not-good");
    assert_ne!(file["verdict"]["grade"], "not-good");
    // The report begins with both verdicts.
    let report = fs::read_to_string(result.join("report.html")).unwrap();
    let head = report.split("<dl").next().unwrap_or_default();
    let verdicts: Vec<&str> = head.split("<div class=\"verdict ").skip(1).collect();
    assert!(
        matches!(verdicts.as_slice(), [camera, unit]
        if camera.contains("Camera: ") && unit.starts_with("not-good") && unit.contains("IMU: Not good enough")),
        "{head}"
    );
}

fn slip() -> UnitQuaternion<f64> {
    UnitQuaternion::new(Vector3::new(1f64.to_radians(), 0.0, 0.0))
}

fn wrong_units_and_axes(bench: &Bench) {
    bench.rejected("m/s², and were read as g", |sample| sample.acceleration *= STANDARD_GRAVITY);
    bench.rejected("°/s, and were read as rad/s", |sample| sample.angular_velocity *= 1f64.to_degrees());
    bench.rejected("rad/s, and were read as °/s", |sample| sample.angular_velocity *= 1f64.to_radians());
    bench.rejected("left-handed", |sample| {
        sample.acceleration.x *= -1.0;
        sample.angular_velocity.x *= -1.0;
    });
    bench.rejected("are saturated", |sample| {
        sample.angular_velocity = sample.angular_velocity.map(|rate| rate.clamp(-0.5, 0.5));
    });
    // Gyroscope and accelerometer of different axes.
    bench.rejected("gravity is estimated as", |sample| sample.acceleration = sample.acceleration.yzx());
    let backwards = bench.with(|samples| {
        let end = samples.last().map_or(0.0, |last| last.t);
        samples.reverse();
        samples.iter_mut().for_each(|sample| sample.t = end - sample.t);
    });
    let error = backwards.unwrap_err().to_string();
    assert!(error.contains("does not match the camera"), "{error}");
}

/// The IMU slips by one degree in the middle of the recording.
fn loose(bench: &Bench) {
    let found = bench.with(|samples| {
        let half = samples.len() / 2;
        for sample in samples.iter_mut().skip(half) {
            sample.acceleration = slip() * sample.acceleration;
            sample.angular_velocity = slip() * sample.angular_velocity;
        }
    });
    let found = found.unwrap();
    assert_eq!(causes(&found), [Cause::Loose], "{}", found.block_scatter);
}

/// The IMU's clock is 4 s ahead, and its axes are rotated by 120°.
fn other_clocks_and_axes(bench: &Bench, before: &InertialCalibration, truth: &Truth) {
    let turned = UnitQuaternion::new(Vector3::repeat(120f64.to_radians() / 3f64.sqrt()));
    let found = bench.with(|samples| {
        for sample in samples {
            sample.t += 4.0;
            sample.acceleration = turned * sample.acceleration;
            sample.angular_velocity = turned * sample.angular_velocity;
        }
    });
    let found = found.unwrap();
    let mut other_axes = Truth { imu_from_camera: truth.imu_from_camera, ..*truth };
    other_axes.imu_from_camera = turned.to_homogeneous() * truth.imu_from_camera;
    let (rotation, position) = other_axes.errors(&found);
    // The sensor matrices are triangular in the rotated axes, so the definition of the IMU's axes changes by the misalignment.
    assert!(rotation.norm() < 4f64.to_radians() && position.norm() < 2e-3, "{rotation} {position}");
    assert!((found.parameters.position - before.parameters.position).norm() < 1e-3);
    assert_eq!(found.findings, []);
    let delay = found.parameters.gyroscope_delay - before.parameters.gyroscope_delay;
    assert!((delay - 4.0).abs() < 1e-3, "{delay}");
}

/// The IMU's clock is 200 ppm too fast.
fn drifting(bench: &Bench, before: &InertialCalibration) {
    let found = bench.with(|samples| samples.iter_mut().for_each(|sample| sample.t *= 1.0 + 200e-6)).unwrap();
    assert_eq!(causes(&found), [Cause::ClockRate]);
    let (drift, sigma) = (found.parameters.clock_drift, found.sigma(CLOCK_DRIFT));
    assert!((drift - 200e-6).abs() < 4.5 * sigma && sigma < 30e-6, "{drift} ± {sigma}");
    assert!((found.parameters.position - before.parameters.position).norm() < 1e-3);
}

/// One sample in 20 is lost.
fn losing(bench: &Bench, before: &InertialCalibration) {
    let found = bench.with(|samples| {
        *samples = samples.iter().enumerate().filter(|(index, _)| index * 7 % 20 != 3).map(|(_, one)| *one).collect();
    });
    let found = found.unwrap();
    assert_eq!(causes(&found), [Cause::MissingSamples]);
    let share = found.streams.iter().map(|stream| stream.missing).fold(0.0, f64::max);
    assert!((share - 0.05).abs() < 1e-3, "{share}");
    assert!((found.parameters.position - before.parameters.position).norm() < 1e-3);
}

/// The gyroscope occasionally reaches the limit of its range.
fn at_its_limit(bench: &Bench, before: &InertialCalibration) {
    let mut rates: Vec<f64> = bench.samples.iter().map(|sample| sample.angular_velocity.x).collect();
    rates.sort_by(f64::total_cmp);
    let limit = rates[rates.len() * 97 / 100];
    let found = bench.with(|samples| {
        samples.iter_mut().for_each(|sample| sample.angular_velocity.x = sample.angular_velocity.x.min(limit));
    });
    let found = found.unwrap();
    assert_eq!(causes(&found), [Cause::SaturatedSamples]);
    let share = found.streams.iter().map(|stream| stream.saturated).fold(0.0, f64::max);
    assert!((share - 0.03).abs() < 2e-3, "{share}");
    assert!((found.parameters.position - before.parameters.position).norm() < 1.5e-3);
}

/// The accelerations do not contain gravity.
fn without_gravity(bench: &Bench, before: &InertialCalibration) {
    let Evidence::Events(events) = &bench.calibrated.evidence else { panic!("no trajectory") };
    let parameters = &before.parameters;
    let start = bench.calibrated.starts[0];
    let error = bench.with(|samples| {
        samples.retain_mut(|sample| {
            let t = parameters.accelerometer_time(sample.t - start);
            let Some(pose) = events.refined.state.trajectories.iter().find_map(|one| one.pose(t)) else { return false };
            sample.acceleration += parameters.rotation * pose.rotation.inverse_transform_vector(&parameters.gravity);
            true
        });
    });
    let error = error.unwrap_err().to_string();
    assert!(error.contains("gravity seems to have been removed"), "{error}");
}

fn files(calibrated: &Calibrated, task: &Task) {
    let folder = tempfile::tempdir().unwrap();
    let written = evcal::write_new_folder(folder.path().join("result"), calibrated, task).unwrap();
    let folder = folder.path().join("result");
    assert!(written.summary.result.contains("t_gyroscope − t_events: 2."), "{}", written.summary.result);
    let json = &read_json(&folder.join("calibration.json"))["inertial"];
    assert!(json["verdict"].as_str().is_some_and(|verdict| verdict.starts_with("Good: the rotation is known to ")));
    assert!(written.summary.result.contains(json["verdict"].as_str().unwrap()), "{}", written.summary.result);
    let correlations = json["correlations"].as_array().unwrap();
    assert_eq!(correlations.len(), ACCELEROMETER_MATRIX + 2 * TRIANGLE.len());
    for (index, row) in correlations.iter().enumerate() {
        let row = numbers(row);
        assert!(
            (row[index] - 1.0).abs() < 1e-12 && row.iter().all(|value| value.abs() < 1.0 + 1e-12),
            "{index}: {row:?}"
        );
    }
    // The delays refer to the middle of the recording of 8 s.
    assert!((json["delays_at"].as_f64().unwrap() - calibrated.starts[0] - 4.0).abs() < 0.5, "{}", json["delays_at"]);
    let focal = |text: &str| {
        let line = text.lines().find_map(|line| line.trim().strip_prefix("intrinsics: "));
        numbers(&serde_json::from_str(line.unwrap()).unwrap())[0]
    };
    let imu_from_camera = Matrix4::from_row_slice(&numbers(&json["T_imu_camera"]));
    let text = std::fs::read_to_string(folder.join("exports/camchain-imucam.yaml")).unwrap();
    let solved = &json["solved_together"]["parameters"]["fx"];
    assert!((focal(&text) - solved.as_f64().unwrap()).abs() < 1.0, "{solved} in {text}");
    let rows = text.lines().skip_while(|line| !line.contains("T_cam_imu:")).skip(1).take(4);
    let entries: Vec<f64> = rows
        .flat_map(|row| numbers(&serde_json::from_str(row.trim().trim_start_matches("- ")).expect("a row of numbers")))
        .collect();
    let camera_from_imu = Matrix4::from_row_slice(&entries);
    assert!((camera_from_imu * imu_from_camera - Matrix4::identity()).norm() < 1e-9, "{text}");
    let shift = text.lines().find_map(|line| line.trim().strip_prefix("timeshift_cam_imu: ")?.parse::<f64>().ok());
    assert_eq!(shift, json["gyroscope"]["delay"]["value"].as_f64());
    let imu = std::fs::read_to_string(folder.join("exports/imu.yaml")).unwrap();
    for key in ["model: scale-misalignment", "update_rate: 1000", "C_gyro_i:", "gyroscope_noise_density:"] {
        assert!(imu.contains(key), "{key} in {imu}");
    }
    for name in ["kalibr_imucam_chain.yaml", "kalibr_imu_chain.yaml", "vins-fusion.yaml", "static_transform.yaml"] {
        assert!(folder.join("exports").join(name).exists(), "{name}");
    }
    let report = std::fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(report.contains("Axes of the camera and of the IMU."));
    assert!(report.contains("<h2 id=\"imu-heading\">IMU</h2>") && report.contains("Spectrum of the residuals"));
}

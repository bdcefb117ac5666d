//! Errors and reported uncertainties of devices fixed to the camera. Simulates recordings with an IMU like the DAVIS346's, a second
//! camera or motion-capture markers, calibrates each, and compares with the ground truth.
//!
//! ```text
//! cargo run --release -p evcal-tests --example rigs -- inertial|stereo|motion-capture [FIRST-LAST [SIMULATE-OPTION...]]
//! ```
//!
//! The second camera takes frames with `--second-frames`, or with `frames` in a file of `--second-camera`. Failed calibrations and
//! values that were not measured are printed but not counted. The table is printed after each seed, so a run may be ended at any time.

use std::path::Path;

use evcal_tests::values::{measured_numbers, pose};
use evcal_tests::{BOARD, evcal, json, read_json, succeed, text};
use nalgebra::{Isometry3, Vector3};
use serde_json::Value;

/// Errors of a scalar or of the components of a vector, with their reported σ.
struct Figure {
    name: &'static str,
    errors: Vec<f64>,
    sigmas: Vec<f64>,
}

/// Creates a figure from the known errors and σ, multiplied by `factor`.
fn figure(name: &'static str, errors: &[f64], sigmas: &[f64], factor: f64) -> Figure {
    let known = errors.iter().zip(sigmas).filter(|(error, sigma)| error.is_finite() && **sigma > 0.0);
    let (errors, sigmas) = known.map(|(error, sigma)| (factor * error, factor * sigma)).unzip();
    Figure { name, errors, sigmas }
}

/// Simulates and calibrates in a folder with these options and returns the errors.
type Trial = fn(&Path, &[&str]) -> Vec<Figure>;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let kind = arguments.next().unwrap_or_else(|| "inertial".to_owned());
    let (trial, usual): (Trial, _) = match kind.as_str() {
        "inertial" => (inertial, "201-204"),
        "stereo" => (stereo, "601-604"),
        "motion-capture" => (motion_capture, "511-514"),
        other => panic!("{other} must be inertial, stereo or motion-capture"),
    };
    let range = arguments.next().unwrap_or_else(|| usual.to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 201-220");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let mut options: Vec<String> = arguments.collect();
    if options.is_empty() {
        options = ["--motion", "fast", "--duration", "30s"].map(str::to_owned).to_vec();
    }
    println!("{kind}, {}", options.join(" "));
    let (mut all, mut calibrated): (Vec<Figure>, Vec<String>) = (Vec::new(), Vec::new());
    for seed in seed(first)..=seed(last) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let seed = seed.to_string();
        println!("seed {seed}");
        let of_seed = options.iter().map(String::as_str).chain(["--seed", &seed]);
        let figures = trial(folder.path(), &of_seed.collect::<Vec<&str>>());
        if figures.is_empty() {
            continue;
        }
        calibrated.push(seed);
        for one in figures {
            println!("  {}", row(&one));
            match all.iter_mut().find(|figure| figure.name == one.name) {
                Some(figure) => {
                    figure.errors.extend(one.errors);
                    figure.sigmas.extend(one.sigmas);
                }
                None => all.push(one),
            }
        }
        println!("seeds {}", calibrated.join(" "));
        table(&all);
    }
}

/// Formats a scalar with its σ, or the norm and the largest component of a vector.
fn row(Figure { name, errors, sigmas }: &Figure) -> String {
    let norm = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
    let largest = |values: &[f64]| values.iter().map(|value| value.abs()).fold(0.0, f64::max);
    match (errors.as_slice(), sigmas.as_slice()) {
        ([error], [sigma]) => format!("{name:<34} {error:>10.4} ± {sigma:.4}"),
        _ => format!(
            "{name:<34} {:>10.4} ± {:.4}, largest component {:.4} ± {:.4}",
            norm(errors),
            norm(sigmas),
            largest(errors),
            largest(sigmas)
        ),
    }
}

/// Prints median and maximum of the absolute errors, the mean of error / σ, its standard deviation and root mean square, and the
/// number of errors within 1.96 σ.
fn table(figures: &[Figure]) {
    println!(
        "{:<34} {:>10} {:>10} {:>8} {:>9} {:>9} {:>9}",
        "", "median", "largest", "mean/σ", "scatter/σ", "error/σ", "in 95 %"
    );
    for Figure { name, errors, sigmas } in figures.iter().filter(|figure| !figure.errors.is_empty()) {
        let mut sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let ratios: Vec<f64> = errors.iter().zip(sigmas).map(|(error, sigma)| error / sigma).collect();
        let count = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / count;
        let about = |middle: f64, freedom: f64| {
            (ratios.iter().map(|ratio| (ratio - middle).powi(2)).sum::<f64>() / freedom).sqrt()
        };
        let (scatter, rms) = (about(mean, count - 1.0), about(0.0, count));
        let inside = ratios.iter().filter(|ratio| ratio.abs() < 1.96).count();
        let (median, largest) = (sizes[sizes.len() / 2], sizes[sizes.len() - 1]);
        println!(
            "{name:<34} {median:>10.4} {largest:>10.4} {mean:>8.2} {scatter:>9.2} {rms:>9.2} {inside:>4} of {}",
            ratios.len()
        );
    }
}

fn number(value: &Value) -> f64 {
    measured_numbers(value)[0]
}

fn difference(found: &Value, truth: &[f64]) -> Vec<f64> {
    measured_numbers(found).iter().zip(truth).map(|(found, truth)| found - truth).collect()
}

/// Returns rotation (rad) and translation (m) from `truth` to `found`, along the axes of `truth`.
fn moved(found: &Isometry3<f64>, truth: &Isometry3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let turned = (truth.rotation.inverse() * found.rotation).scaled_axis();
    (turned, found.translation.vector - truth.translation.vector)
}

/// Returns the errors of the IMU's parameters; nothing if it was not calibrated. The delays include the pixel latency.
fn inertial(folder: &Path, options: &[&str]) -> Vec<Figure> {
    const GRAVITY: f64 = 9.80665;
    let (recording, result) = (folder.join("recording"), folder.join("result"));
    let simulate = ["simulate", "-o", text(&recording), "--board", BOARD, "--imu", "davis346"];
    succeed(&[&simulate[..], options].concat());
    let events = recording.join("events.aedat4");
    let finished = evcal(&["calibrate", text(&events), "--board", BOARD, "--imu", "--accept-any", "-o", text(&result)]);
    let file = result.join("calibration.json");
    let found = if file.exists() { read_json(&file)["inertial"].clone() } else { Value::Null };
    found["findings"].as_array().into_iter().flatten().for_each(|finding| println!("  finding: {finding}"));
    if found.is_null() {
        println!("  {}", finished.messages().join("\n  "));
        return Vec::new();
    }
    let truth = &read_json(&recording.join("truth.json"))["davis"]["imu_bias"];
    let mount = pose(&truth["mount"]["imu_from_camera"]);
    let rotation = match &found["T_imu_camera"] {
        Value::Null => Vector3::repeat(f64::NAN),
        value => moved(&pose(value), &mount).0,
    };
    let (position, sigma) = (&found["position_in_camera"], measured_numbers(&found["position_in_camera"]["sigma"]));
    let position_error = difference(&position["value"], mount.inverse().translation.vector.as_slice());
    let along = |axis: usize, name| figure(name, &position_error[axis..=axis], &sigma[axis..=axis], 1e3);
    let delay = |sensor: &str| {
        let delay = &found[sensor]["delay"];
        (number(&delay["value"]), number(&delay["sigma"]))
    };
    let ((gyroscope, of_gyroscope), (accelerometer, of_accelerometer)) = (delay("gyroscope"), delay("accelerometer"));
    let down = Vector3::from_vec(measured_numbers(&found["gravity"])).normalize();
    let bias = |sensor: &str, of_truth: &str, unit: f64| {
        let truth: Vec<f64> = measured_numbers(&truth[of_truth]).into_iter().map(|value| value * unit).collect();
        (difference(&found[sensor]["bias"]["value"], &truth), measured_numbers(&found[sensor]["bias"]["sigma"]))
    };
    let matrix = |sensor: &str, of_truth: &str| {
        let truth = measured_numbers(&truth["mount"][of_truth]);
        (difference(&found[sensor]["matrix"], &truth), measured_numbers(&found[sensor]["matrix_sigma"]))
    };
    let (of_gyroscope_bias, of_accelerometer_bias) =
        (bias("gyroscope", "angular_velocity", 1f64.to_radians()), bias("accelerometer", "acceleration", GRAVITY));
    let (of_gyroscope_matrix, of_accelerometer_matrix) =
        (matrix("gyroscope", "gyroscope_matrix"), matrix("accelerometer", "accelerometer_matrix"));
    let density = |sensor: &str| measured_numbers(&found[sensor]["noise_density"]).iter().sum::<f64>() / 3.0;
    // The simulated noise densities are 0.01 °/s/√Hz and 300 µg/√Hz.
    let (gyroscope_noise, accelerometer_noise) =
        (density("gyroscope").to_degrees() / 0.01, density("accelerometer") / GRAVITY / 300e-6);
    vec![
        figure(
            "rotation (degrees)",
            rotation.as_slice(),
            &measured_numbers(&found["rotation_sigma"]),
            1f64.to_degrees(),
        ),
        along(0, "x (mm)"),
        along(1, "y (mm)"),
        along(2, "z (mm)"),
        figure("gyroscope's delay - 2.9 (ms)", &[gyroscope - 2.9e-3], &[of_gyroscope], 1e3),
        figure("delay difference - 1 (ms)", &[gyroscope - accelerometer - 1e-3], &[of_accelerometer], 1e3),
        figure("gravity (degrees)", &[down.x, down.z], &[number(&found["gravity_sigma"]); 2], 1f64.to_degrees()),
        figure("gyroscope's bias (degrees/s)", &of_gyroscope_bias.0, &of_gyroscope_bias.1, 1f64.to_degrees()),
        figure("accelerometer's bias (mg)", &of_accelerometer_bias.0, &of_accelerometer_bias.1, 1e3 / GRAVITY),
        figure("gyroscope's scale (%)", &of_gyroscope_matrix.0, &of_gyroscope_matrix.1, 100.0),
        figure("accelerometer's scale (%)", &of_accelerometer_matrix.0, &of_accelerometer_matrix.1, 100.0),
        figure("gyroscope's noise (%)", &[gyroscope_noise - 1.0], &[0.05], 100.0),
        figure("accelerometer's noise (%)", &[accelerometer_noise - 1.0], &[0.05], 100.0),
    ]
}

fn stereo(folder: &Path, options: &[&str]) -> Vec<Figure> {
    let (recording, result) = (folder.join("recording"), folder.join("result"));
    let second = if options.contains(&"--second-camera") { &[][..] } else { &["--second-camera"] };
    let simulate = [&["simulate", "-o", text(&recording), "--board", BOARD], second, options].concat();
    succeed(&simulate);
    let truth = &read_json(&recording.join("truth.json"))["second_camera"];
    let settings = &truth["settings"];
    let frames = &settings["frames"];
    let line_delay = if frames.is_null() { 0.0 } else { 1e-6 * number(&frames["line_delay"]) };
    let name = if frames.is_null() { "second.aedat4" } else { "second" };
    let (first, second) = (recording.join("events.aedat4"), recording.join(name));
    let shutter = if line_delay == 0.0 { &[][..] } else { &["--rolling-shutter"] };
    let calibrate = ["calibrate", text(&first), "--with", text(&second), "--board", BOARD, "--accept-any"];
    succeed(&[&calibrate[..], shutter, &["-o", text(&result)]].concat());
    let found = &read_json(&result.join("calibration.json"))["second_cameras"][0];
    let (turned, moved) = moved(&pose(&found["T_second_first"]), &pose(&truth["T_second_first"]));
    let rate = 1e-6 * number(&settings["clock_drift"]);
    // t_second = offset + t_first (1 + rate). The reported offset is valid at a time of the second clock.
    let at = number(&found["time_offset_at"]);
    let clocks = at - (at - number(&settings["clock_offset"])) / (1.0 + rate);
    // Frames have the timestamp of their first row; the offset refers to the middle row.
    let offset = clocks - line_delay * 0.5 * (number(&truth["sensor"]["height"]) - 1.0);
    // The reported rate is the rate of the first clock relative to the second.
    let single = |name, found: &Value, truth: f64, factor: f64| {
        figure(name, &[number(&found["value"]) - truth], &[number(&found["sigma"])], factor)
    };
    vec![
        figure(
            "rotation (0.001°)",
            turned.as_slice(),
            &measured_numbers(&found["rotation_sigma"]),
            1e3f64.to_degrees(),
        ),
        figure("position (µm)", moved.as_slice(), &measured_numbers(&found["translation_sigma"]), 1e6),
        single("offset (µs)", &found["time_offset"], offset, 1e6),
        single("clock rate (ppm)", &found["clock_rate"], rate / (1.0 + rate), 1e6),
        single("line delay (ns)", &found["frames"]["line_delay"], line_delay, 1e9),
    ]
}

/// Returns the errors of the comparison with motion capture. The offset includes the pixel latency.
fn motion_capture(folder: &Path, options: &[&str]) -> Vec<Figure> {
    let (recording, result) = (folder.join("recording"), folder.join("result"));
    succeed(&[&["simulate", "-o", text(&recording), "--board", BOARD, "--motion-capture"], options].concat());
    let events = recording.join("events.aedat4");
    succeed(&["calibrate", text(&events), "--board", BOARD, "--accept-any", "-o", text(&result)]);
    let capture = recording.join("motion_capture.txt");
    let found = json(&["evaluate", text(&result), "--motion-capture", text(&capture), "--json"]);
    let against = json(&["evaluate", text(&result), "--truth", text(&recording), "--json"]);
    let truth = read_json(&recording.join("truth.json"));
    let body = &found["T_camera_body"];
    let (turned, moved) = moved(&pose(&body["matrix"]), &pose(&truth["motion_capture"]["T_camera_body"]));
    let settings = &truth["motion_capture"]["settings"];
    let middle = 0.5 * number(&truth["settings"]["duration"]);
    let clock = number(&settings["clock_offset"]) + 1e-6 * number(&settings["clock_drift"]) * middle;
    let error = &found["held_out"]["position"]["error"];
    let true_error = number(&against["trajectory"]["best_time_shift"]["aligned_m"]["rmse"]);
    println!("  held-out error {:.3} mm, true error {:.3} mm", 1e3 * number(&error["value"]), 1e3 * true_error);
    vec![
        figure("rotation (degrees)", turned.as_slice(), &measured_numbers(&body["rotation_sigma"]), 1f64.to_degrees()),
        figure("position (mm)", moved.as_slice(), &measured_numbers(&body["translation_sigma"]), 1e3),
        figure("offset (µs)", &[number(&found["offset"]["value"]) - clock], &[number(&found["offset"]["sigma"])], 1e6),
        figure("held-out error (mm)", &[number(&error["value"]) - true_error], &[number(&error["sigma"])], 1e3),
    ]
}

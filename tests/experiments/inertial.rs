//! Is the inertial unit where it should be, and are the stated uncertainties true? Simulates recordings with a unit like that of a
//! DAVIS346, calibrates each with `--imu`, and compares with the truth.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/inertial [FIRST-LAST [SIMULATE-OPTION...]]
//! ```

use std::path::Path;

use evcal_tests::values::measured_numbers;
use evcal_tests::{BOARD, read_json, succeed, text};
use nalgebra::{Matrix4, Rotation3, UnitQuaternion, Vector3};
use serde_json::Value;

/// Name, unit, errors and stated σ of each seed.
struct Figure {
    name: &'static str,
    errors: Vec<f64>,
    sigmas: Vec<f64>,
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "201-220".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 201-220");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let mut options: Vec<String> = arguments.collect();
    if options.is_empty() {
        options = ["--motion", "fast", "--duration", "30s"].map(str::to_owned).to_vec();
    }
    let mut figures: Vec<Figure> = Vec::new();
    for seed in seed(first)..=seed(last) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (name, error, sigma) in trial(folder.path(), seed, &options) {
            match figures.iter_mut().find(|figure| figure.name == name) {
                Some(figure) => {
                    figure.errors.push(error);
                    figure.sigmas.push(sigma);
                }
                None => figures.push(Figure { name, errors: vec![error], sigmas: vec![sigma] }),
            }
        }
    }
    println!("seeds {range}, {}", options.join(" "));
    println!("{:<34} {:>10} {:>10} {:>10} {:>9}", "", "median", "largest", "error/σ", "in 95 %");
    for Figure { name, errors, sigmas } in &figures {
        let mut sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let ratios: Vec<f64> = errors.iter().zip(sigmas).map(|(error, sigma)| error / sigma).collect();
        let rms = (ratios.iter().map(|ratio| ratio * ratio).sum::<f64>() / ratios.len() as f64).sqrt();
        let inside = ratios.iter().filter(|ratio| ratio.abs() < 1.96).count() as f64 / ratios.len() as f64;
        let (median, largest) = (sizes[sizes.len() / 2], sizes[sizes.len() - 1]);
        println!("{name:<34} {median:>10.4} {largest:>10.4} {rms:>10.2} {:>7.0} %", 100.0 * inside);
    }
}

/// Errors with their σ; the delay as it is, for the latency of the pixels is part of it.
fn trial(folder: &Path, seed: u64, options: &[String]) -> Vec<(&'static str, f64, f64)> {
    let (recording, result) = (folder.join("recording"), folder.join("result"));
    let seed = seed.to_string();
    let simulate = ["simulate", "-o", text(&recording), "--board", BOARD, "--imu", "davis346", "--seed", &seed];
    succeed(&[&simulate[..], &options.iter().map(String::as_str).collect::<Vec<_>>()].concat());
    let events = recording.join("events.aedat4");
    succeed(&["calibrate", text(&events), "--board", BOARD, "--imu", "--accept-any", "-o", text(&result)]);
    let found = &read_json(&result.join("calibration.json"))["inertial"];
    let bias = &read_json(&recording.join("truth.json"))["davis"]["imu_bias"];
    let matrix = |value: &Value| Matrix4::from_row_slice(&measured_numbers(value));
    let turn = |matrix: &Matrix4<f64>| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
            matrix.fixed_view::<3, 3>(0, 0).into_owned(),
        ))
    };
    let truth = matrix(&bias["mount"]["imu_from_camera"]);
    let place = -(turn(&truth).inverse() * truth.fixed_view::<3, 1>(0, 3).into_owned());
    let rotation = (turn(&truth).inverse() * turn(&matrix(&found["T_imu_camera"]))).scaled_axis();
    let mut list = Vec::new();
    let mut add = |name, errors: &[f64], sigmas: &[f64], factor: f64| {
        let pairs = errors.iter().zip(sigmas);
        list.extend(pairs.map(|(error, sigma)| (name, factor * error, factor * sigma)));
    };
    add("rotation (degrees)", rotation.as_slice(), &measured_numbers(&found["rotation_sigma"]), 1f64.to_degrees());
    let (at, sigma) = (&found["position_in_camera"]["value"], measured_numbers(&found["position_in_camera"]["sigma"]));
    for (axis, name) in ["x (mm)", "y (mm)", "z (mm)"].into_iter().enumerate() {
        add(name, &[measured_numbers(at)[axis] - place[axis]], &[sigma[axis]], 1e3);
    }
    let delay = |sensor: &str| {
        let delay = &found[sensor]["delay"];
        (measured_numbers(&delay["value"])[0], measured_numbers(&delay["sigma"])[0])
    };
    let ((gyroscope, of_gyroscope), (accelerometer, of_accelerometer)) = (delay("gyroscope"), delay("accelerometer"));
    add("gyroscope's delay less 2.9 (ms)", &[gyroscope - 2.9e-3], &[of_gyroscope], 1e3);
    add("its difference less 1 (ms)", &[gyroscope - accelerometer - 1e-3], &[of_accelerometer], 1e3);
    let down = Vector3::from_vec(measured_numbers(&found["gravity"])).normalize();
    let of_down = measured_numbers(&found["gravity_sigma"])[0];
    add("gravity (degrees)", &[down.x, down.z], &[of_down; 2], 1f64.to_degrees());
    let sensors = [
        ("gyroscope", "angular_velocity", "gyroscope's bias (degrees/s)", 1f64.to_degrees(), 1f64.to_radians()),
        ("accelerometer", "acceleration", "accelerometer's bias (mg)", 1e3 / 9.80665, 9.80665),
    ];
    for (sensor, truth, name, factor, unit) in sensors {
        let truths = measured_numbers(&bias[truth]).into_iter().map(|value| value * unit);
        let errors: Vec<f64> = measured_numbers(&found[sensor]["bias"]["value"])
            .iter()
            .zip(truths)
            .map(|(found, truth)| found - truth)
            .collect();
        add(name, &errors, &measured_numbers(&found[sensor]["bias"]["sigma"]), factor);
    }
    for (sensor, truth, name) in [
        ("gyroscope", "gyroscope_matrix", "gyroscope's scale (%)"),
        ("accelerometer", "accelerometer_matrix", "accelerometer's scale (%)"),
    ] {
        let (found, truth, sigma) = (
            measured_numbers(&found[sensor]["matrix"]),
            measured_numbers(&bias["mount"][truth]),
            measured_numbers(&found[sensor]["matrix_sigma"]),
        );
        let errors = found.iter().zip(&truth).zip(&sigma).filter(|(_, sigma)| **sigma > 0.0);
        let (errors, sigmas): (Vec<f64>, Vec<f64>) =
            errors.map(|((found, truth), sigma)| (found - truth, *sigma)).unzip();
        add(name, &errors, &sigmas, 100.0);
    }
    let mean = |value: &Value| measured_numbers(value).iter().sum::<f64>() / 3.0;
    let density = mean(&found["gyroscope"]["noise_density"]).to_degrees() / 0.01;
    add("gyroscope's noise (%)", &[density - 1.0], &[0.05], 100.0);
    let density = mean(&found["accelerometer"]["noise_density"]) / 9.80665 / 300e-6;
    add("accelerometer's noise (%)", &[density - 1.0], &[0.05], 100.0);
    list
}

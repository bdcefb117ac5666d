//! Is the inertial unit where it should be, and are the stated uncertainties true? Simulates recordings with a unit like that of a
//! DAVIS346, calibrates each with `--imu`, and compares with the truth. What was not measured, or not calibrated at all, is told and counts
//! for nothing. The table follows after each seed, so that a run may be ended at any time.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/inertial [FIRST-LAST [SIMULATE-OPTION...]]
//! ```

use std::path::Path;

use evcal_tests::values::measured_numbers;
use evcal_tests::{BOARD, evcal, read_json, succeed, text};
use nalgebra::{Matrix4, Rotation3, UnitQuaternion, Vector3};
use serde_json::Value;

/// Name with its unit, errors and stated σ over the seeds.
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
    let mut calibrated = Vec::new();
    for seed in seed(first)..=seed(last) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let Some(trial) = trial(folder.path(), seed, &options) else { continue };
        calibrated.push(seed.to_string());
        for (name, error, sigma) in trial {
            println!("  {name:<34} {error:>10.4} ± {sigma:<8.4} {:>6.2}", error / sigma);
            match figures.iter_mut().find(|figure| figure.name == name) {
                Some(figure) => {
                    figure.errors.push(error);
                    figure.sigmas.push(sigma);
                }
                None => figures.push(Figure { name, errors: vec![error], sigmas: vec![sigma] }),
            }
        }
        println!("seeds {}, {}", calibrated.join(" "), options.join(" "));
        table(&figures);
    }
}

/// Sizes of the errors; the mean of error over σ, its scatter about that mean and about zero, and how many errors are within 1.96 σ.
fn table(figures: &[Figure]) {
    println!(
        "{:<34} {:>10} {:>10} {:>8} {:>9} {:>9} {:>9}",
        "", "median", "largest", "mean/σ", "scatter/σ", "error/σ", "in 95 %"
    );
    for Figure { name, errors, sigmas } in figures {
        let mut sizes: Vec<f64> = errors.iter().map(|error| error.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let ratios: Vec<f64> = errors.iter().zip(sigmas).map(|(error, sigma)| error / sigma).collect();
        let count = ratios.len() as f64;
        let mean = ratios.iter().sum::<f64>() / count;
        let about = |middle: f64, freedom: f64| {
            (ratios.iter().map(|ratio| (ratio - middle).powi(2)).sum::<f64>() / freedom).sqrt()
        };
        let (scatter, rms) = (about(mean, count - 1.0), about(0.0, count));
        let inside = ratios.iter().filter(|ratio| ratio.abs() < 1.96).count() as f64 / count;
        let (median, largest) = (sizes[sizes.len() / 2], sizes[sizes.len() - 1]);
        println!(
            "{name:<34} {median:>10.4} {largest:>10.4} {mean:>8.2} {scatter:>9.2} {rms:>9.2} {:>7.0} %",
            100.0 * inside
        );
    }
}

/// Seconds that the processor spent on programs that were started and have ended; none where the system does not tell.
fn seconds_of_children() -> Option<f64> {
    const TICKS: f64 = 100.0;
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Fields 16 and 17; the name, field 2, may have blanks in its brackets.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace().skip(13);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / TICKS)
}

/// Errors with their σ where both are known; the delay as it is, for the latency of the pixels is part of it. None where the unit
/// was not calibrated.
fn trial(folder: &Path, seed: u64, options: &[String]) -> Option<Vec<(&'static str, f64, f64)>> {
    let (recording, result) = (folder.join("recording"), folder.join("result"));
    let seed = seed.to_string();
    let simulate = ["simulate", "-o", text(&recording), "--board", BOARD, "--imu", "davis346", "--seed", &seed];
    succeed(&[&simulate[..], &options.iter().map(String::as_str).collect::<Vec<_>>()].concat());
    let events = recording.join("events.aedat4");
    let before = seconds_of_children();
    let finished = evcal(&["calibrate", text(&events), "--board", BOARD, "--imu", "--accept-any", "-o", text(&result)]);
    let spent = before.zip(seconds_of_children()).map_or(f64::NAN, |(before, after)| after - before);
    let file = result.join("calibration.json");
    let found = if file.exists() { read_json(&file)["inertial"].clone() } else { Value::Null };
    println!(
        "seed {seed}: exit code {:?}, {spent:.0} s of processor time, camera moved {}, scatter of blocks {}",
        finished.code, found["camera_moved"], found["block_scatter"]
    );
    found["findings"].as_array().into_iter().flatten().for_each(|finding| println!("  finding: {finding}"));
    if found.is_null() {
        println!("  {}", finished.said().join("\n  "));
        return None;
    }
    let bias = &read_json(&recording.join("truth.json"))["davis"]["imu_bias"];
    let matrix = |value: &Value| Matrix4::from_row_slice(&measured_numbers(value));
    let turn = |matrix: &Matrix4<f64>| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(
            matrix.fixed_view::<3, 3>(0, 0).into_owned(),
        ))
    };
    let truth = matrix(&bias["mount"]["imu_from_camera"]);
    let place = -(turn(&truth).inverse() * truth.fixed_view::<3, 1>(0, 3).into_owned());
    let rotation = match &found["T_imu_camera"] {
        Value::Null => Vector3::repeat(f64::NAN),
        value => (turn(&truth).inverse() * turn(&matrix(value))).scaled_axis(),
    };
    let mut list = Vec::new();
    let mut add = |name, errors: &[f64], sigmas: &[f64], factor: f64| {
        let pairs = errors.iter().zip(sigmas);
        let known = pairs.filter(|(error, sigma)| error.is_finite() && **sigma > 0.0);
        list.extend(known.map(|(error, sigma)| (name, factor * error, factor * sigma)));
    };
    add("rotation (degrees)", rotation.as_slice(), &measured_numbers(&found["rotation_sigma"]), 1f64.to_degrees());
    let (at, sigma) = (&found["position_in_camera"]["value"], measured_numbers(&found["position_in_camera"]["sigma"]));
    for (axis, name) in ["x (mm)", "y (mm)", "z (mm)"].into_iter().enumerate() {
        add(name, &[measured_numbers(at)[axis] - place[axis]], &sigma[axis..=axis], 1e3);
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
    Some(list)
}

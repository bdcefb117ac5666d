//! Is the second camera where it should be, and are the stated uncertainties true? Simulates recordings of two cameras on one
//! mount, calibrates each with `--with`, and compares with the truth. The second takes frames with `--second-frames`, or with `frames`
//! in a file of `--second-camera` behind `--motion` and the like.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/stereo [FIRST-LAST [SIMULATE-OPTION...]]
//! ```

use std::path::Path;

use evcal_tests::values::{measured_numbers, pose};
use evcal_tests::{BOARD, read_json, succeed, text};
use serde_json::Value;

/// Error and stated σ of one parameter.
struct Figure {
    error: f64,
    sigma: f64,
}

/// Names of the figures of a trial, with the units in which they are printed.
const NAMES: [&str; 9] = [
    "rotation about x (0.001°)",
    "rotation about y (0.001°)",
    "rotation about z (0.001°)",
    "place along x (µm)",
    "place along y (µm)",
    "place along z (µm)",
    "offset (µs)",
    "clock rate (ppm)",
    "line delay (ns)",
];

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "601-605".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 601-605");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let mut options: Vec<String> = arguments.collect();
    if options.is_empty() {
        options = ["--motion", "fast", "--duration", "30s"].map(str::to_owned).to_vec();
    }
    println!("seeds {range}, {}", options.join(" "));
    println!("{:>4} {:>9} {:>8} {:>8} {:>8} {:>10} {:>8}", "seed", "angle °", "σ", "place mm", "σ", "offset µs", "σ");
    let mut trials: Vec<[Figure; NAMES.len()]> = Vec::new();
    for seed in seed(first)..=seed(last) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let figures = trial(folder.path(), seed, &options);
        println!("{seed:>4} {}", row(&figures));
        trials.push(figures);
    }
    println!("{:<28} {:>9} {:>9} {:>9} {:>9}", "", "mean", "scatter", "σ", "error/σ");
    for (index, name) in NAMES.into_iter().enumerate() {
        let of = || trials.iter().map(|figures| &figures[index]);
        // Rates are not stated for short recordings, line delays not for events.
        if of().any(|figure| figure.error.is_nan()) {
            continue;
        }
        let count = trials.len() as f64;
        let mean = of().map(|figure| figure.error).sum::<f64>() / count;
        let scatter = of().map(|figure| (figure.error - mean).powi(2)).sum::<f64>() / (count - 1.0).max(1.0);
        let sigma = of().map(|figure| figure.sigma).sum::<f64>() / count;
        let ratio = of().map(|figure| (figure.error / figure.sigma).powi(2)).sum::<f64>() / count;
        println!("{name:<28} {mean:>9.2} {:>9.2} {sigma:>9.2} {:>9.2}", scatter.sqrt(), ratio.sqrt());
    }
}

/// Sizes of the errors of rotation, place and offset, each with the root of the sum of the variances of its parts.
fn row(figures: &[Figure]) -> String {
    let norm = |from: usize, value: fn(&Figure) -> f64| {
        figures[from..from + 3].iter().map(|figure| value(figure).powi(2)).sum::<f64>().sqrt()
    };
    format!(
        "{:>9.4} {:>8.4} {:>8.4} {:>8.4} {:>10.1} {:>8.1}",
        1e-3 * norm(0, |figure| figure.error),
        1e-3 * norm(0, |figure| figure.sigma),
        1e-3 * norm(3, |figure| figure.error),
        1e-3 * norm(3, |figure| figure.sigma),
        figures[6].error,
        figures[6].sigma
    )
}

fn number(value: &Value) -> f64 {
    measured_numbers(value)[0]
}

fn trial(folder: &Path, seed: u64, options: &[String]) -> [Figure; NAMES.len()] {
    let (recording, result) = (folder.join("recording"), folder.join("result"));
    let seed = seed.to_string();
    let mut simulate = vec!["simulate", "-o", text(&recording), "--board", BOARD, "--seed", &seed];
    if !options.iter().any(|option| option == "--second-camera") {
        simulate.push("--second-camera");
    }
    succeed(&[&simulate[..], &options.iter().map(String::as_str).collect::<Vec<_>>()].concat());
    let truth = &read_json(&recording.join("truth.json"))["second_camera"];
    let frames = &truth["settings"]["frames"];
    let line_delay = if frames.is_null() { 0.0 } else { 1e-6 * number(&frames["line_delay"]) };
    let name = if frames.is_null() { "second.aedat4" } else { "second" };
    let (first, second) = (recording.join("events.aedat4"), recording.join(name));
    let mut calibrate = vec!["calibrate", text(&first), "--with", text(&second), "--board", BOARD, "--accept-any"];
    if line_delay != 0.0 {
        calibrate.push("--rolling-shutter");
    }
    succeed(&[&calibrate[..], &["-o", text(&result)]].concat());
    let found = &read_json(&result.join("calibration.json"))["second_cameras"][0];
    let (is, was) = (pose(&found["T_second_first"]), pose(&truth["T_second_first"]));
    let turned = (was.rotation.inverse() * is.rotation).scaled_axis().map(f64::to_degrees);
    let moved = is.translation.vector - was.translation.vector;
    let settings = &truth["settings"];
    let rate = 1e-6 * number(&settings["clock_drift"]);
    // t_second = offset + t_first (1 + rate); the stated offset is that at a time of the second clock.
    let at = number(&found["time_offset_at"]);
    let clocks = at - (at - number(&settings["clock_offset"])) / (1.0 + rate);
    // Frames are stamped by their first row; the offset is that of the middle one.
    let offset = clocks - line_delay * 0.5 * (number(&truth["sensor"]["height"]) - 1.0);
    let sigma = |name: &str, axis: usize| measured_numbers(&found[name])[axis];
    std::array::from_fn(|index| match index {
        0..3 => Figure { error: 1e3 * turned[index], sigma: 1e3 * sigma("rotation_sigma", index).to_degrees() },
        3..6 => Figure { error: 1e6 * moved[index - 3], sigma: 1e6 * sigma("translation_sigma", index - 3) },
        6 => Figure {
            error: 1e6 * (number(&found["time_offset"]["value"]) - offset),
            sigma: 1e6 * number(&found["time_offset"]["sigma"]),
        },
        8 => Figure {
            error: 1e9 * (number(&found["frames"]["line_delay"]["value"]) - line_delay),
            sigma: 1e9 * number(&found["frames"]["line_delay"]["sigma"]),
        },
        _ => Figure {
            // The rate is that of the first clock against the second.
            error: 1e6 * (number(&found["clock_rate"]["value"]) - rate / (1.0 + rate)),
            sigma: 1e6 * number(&found["clock_rate"]["sigma"]),
        },
    })
}

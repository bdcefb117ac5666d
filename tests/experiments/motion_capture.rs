//! Is the body where it should be, and the error that is held out the true one? Simulates recordings with motion capture,
//! calibrates each, and compares.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/motion_capture [FIRST-LAST [SIMULATE-OPTION...]]
//! ```

use std::path::Path;

use evcal_tests::values::{measured_numbers, pose};
use evcal_tests::{BOARD, json, read_json, succeed, text};
use serde_json::Value;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "401-408".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 401-408");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let mut options: Vec<String> = arguments.collect();
    if options.is_empty() {
        options = ["--motion", "fast", "--duration", "30s"].map(str::to_owned).to_vec();
    }
    println!("{}", options.join(" "));
    println!(
        "{:>4} {:>9} {:>7} {:>9} {:>7} {:>10} {:>7} {:>9} {:>9} {:>7}",
        "seed", "body mm", "σ", "degrees", "σ", "offset µs", "σ", "error mm", "true mm", "ratio"
    );
    for seed in seed(first)..=seed(last) {
        let folder = tempfile::tempdir().expect("a temporary folder");
        println!("{seed:>4} {}", trial(folder.path(), seed, &options));
    }
}

/// Errors of `T_camera_body`, the offset less that of the clocks (the latency of the pixels is part of it), and both errors of the
/// trajectory.
fn trial(folder: &Path, seed: u64, options: &[String]) -> String {
    let (recording, result) = (folder.join("recording"), folder.join("result"));
    let seed = seed.to_string();
    let simulate = ["simulate", "-o", text(&recording), "--board", BOARD, "--motion-capture", "--seed", &seed];
    succeed(&[&simulate[..], &options.iter().map(String::as_str).collect::<Vec<_>>()].concat());
    let events = recording.join("events.aedat4");
    succeed(&["calibrate", text(&events), "--board", BOARD, "--accept-any", "-o", text(&result)]);
    let capture = recording.join("motion_capture.txt");
    let found = json(&["evaluate", text(&result), "--motion-capture", text(&capture), "--json"]);
    let against = json(&["evaluate", text(&result), "--truth", text(&recording), "--json"]);
    let truth = read_json(&recording.join("truth.json"));
    let (is, was) = (pose(&found["T_camera_body"]["matrix"]), pose(&truth["motion_capture"]["T_camera_body"]));
    let largest = |value: &Value| measured_numbers(value).into_iter().fold(0.0, f64::max);
    let settings = &truth["motion_capture"]["settings"];
    let number = |value: &Value| measured_numbers(value)[0];
    let middle = 0.5 * number(&truth["settings"]["duration"]);
    let clock = number(&settings["clock_offset"]) + 1e-6 * number(&settings["clock_drift"]) * middle;
    let (error, truth) = (
        number(&found["held_out"]["position"]["error"]["value"]),
        number(&against["trajectory"]["best_time_shift"]["aligned_m"]["rmse"]),
    );
    format!(
        "{:>9.3} {:>7.3} {:>9.4} {:>7.4} {:>10.1} {:>7.1} {:>9.3} {:>9.3} {:>7.3}",
        1e3 * (is.translation.vector - was.translation.vector).amax(),
        1e3 * largest(&found["T_camera_body"]["translation_sigma"]),
        (was.rotation.inverse() * is.rotation).scaled_axis().amax().to_degrees(),
        largest(&found["T_camera_body"]["rotation_sigma"]).to_degrees(),
        1e6 * (number(&found["offset"]["value"]) - clock),
        1e6 * number(&found["offset"]["sigma"]),
        1e3 * error,
        1e3 * truth,
        error / truth
    )
}

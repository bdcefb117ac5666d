//! What each choice of the solver is worth: the same simulated recordings, one choice changed at a time.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/choices
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use evcal_tests::lens::{KANNALA_BRANDT, Lens, RADTAN};
use evcal_tests::{BOARD, evcal, json, text};
use serde_json::Value;
use tempfile::TempDir;

/// What is changed, options, and settings.
const CHOICES: [(&str, &[&str], &str); 15] = [
    ("default", &[], ""),
    ("soft extraction", &["--extraction", "soft"], ""),
    ("SO(3) spline", &["--rotation", "so3"], ""),
    ("even knots, 8.75 ms", &[], "[knots]\nfinest = 0.00875\ncoarsest = 0.00875"),
    ("even knots, 35 ms", &[], "[knots]\nfinest = 0.035\ncoarsest = 0.035"),
    ("band of 2 σ", &[], "[association]\nband = 2.0"),
    ("a fifth of the events", &[], "[association]\nmost_events = 200000"),
    ("no latencies", &[], "[refinement]\nlatencies = false"),
    ("no biases of events", &[], "[refinement]\nlatencies = false\noffsets = false"),
    ("the paper's residual", &[], "[solve]\nresidual = \"plane\""),
];

/// Name, lens, and options of the simulator.
const RECORDINGS: [(&str, Lens, &[&str]); 3] = [
    ("radtan", RADTAN, &["--motion", "fast", "--duration", "4s"]),
    ("Kannala-Brandt", KANNALA_BRANDT, &["--motion", "fast", "--duration", "4s"]),
    ("low light", RADTAN, &["--motion", "fast", "--duration", "4s", "--light", "low"]),
];

fn main() {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let recordings = RECORDINGS.map(|(name, lens, options)| (lens, lens.simulation(&name.replace(' ', "-"), options)));
    let names = RECORDINGS.map(|(name, ..)| name);
    println!("Δf (%), Δc (px), projection rms / max (px), ATE (mm)");
    println!("| choice | {} |", names.join(" | "));
    println!("|---|{}", "---|".repeat(names.len()));
    for (name, options, settings) in CHOICES {
        let cells = recordings.each_ref().map(|(lens, recording)| cell(&folder, *lens, recording, options, settings));
        println!("| {name} | {} |", cells.join(" | "));
    }
}

fn cell(folder: &TempDir, lens: Lens, recording: &Path, options: &[&str], settings: &str) -> String {
    let file: PathBuf = folder.path().join("settings.toml");
    fs::write(&file, settings).expect("settings can be written");
    let output = folder.path().join("output");
    let _ = fs::remove_dir_all(&output);
    let events = recording.join("events.aedat4");
    let common = ["calibrate", text(&events), "--accept-any", "--board", BOARD, "--model", lens.model];
    let rest = ["--settings", text(&file), "-o", text(&output)];
    let finished = evcal(&[&common[..], options, &rest].concat());
    if finished.code != Some(0) {
        return finished.stderr.trim().to_owned();
    }
    let figures = json(&["evaluate", text(&output), "--truth", text(recording), "--json"]);
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let parameter = |name: &str| &figures["intrinsics"]["parameters"][name];
    let difference = |name: &str| number(&parameter(name)["difference"]);
    let relative = |name: &str| 100.0 * difference(name) / number(&parameter(name)["truth"]);
    let larger = |a: f64, b: f64| if a.abs() > b.abs() { a } else { b };
    format!(
        "{:+.3}, {:+.2}, {:.3} / {:.3}, {:.2}",
        larger(relative("fx"), relative("fy")),
        larger(difference("cx"), difference("cy")),
        number(&figures["projection_difference"]["rms_px"]),
        number(&figures["projection_difference"]["max_px"]),
        1e3 * number(&figures["trajectory"]["best_time_shift"]["as_is_m"]["rmse"])
    )
}

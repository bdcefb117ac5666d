//! What more events in the joint solve are worth: the same simulated recordings, with another bound on the events of the last round.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/events_used [FIRST-LAST [MODEL]]
//! ```

use std::fs;
use std::path::{Path, PathBuf};

use evcal_tests::accuracy::Accuracy;
use evcal_tests::lens::{self, Lens};
use evcal_tests::{BOARD, read_json, succeed, text};

/// `association.most_events`. The fourth is the default.
const EVENTS: [u32; 6] = [50_000, 100_000, 300_000, 1_000_000, 2_000_000, 4_000_000];

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "1-8".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 1-8");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let model = arguments.next().unwrap_or_else(|| "radtan".to_owned());
    let lens = lens::ALL.into_iter().find(|lens| lens.model == model).expect("one of the models of the tests");
    let folder = tempfile::tempdir().expect("a folder can be made");
    let simulated = |seed: u64| {
        let options = ["--motion", "fast", "--duration", "4s", "--seed", &seed.to_string()];
        lens.simulation(&format!("events-used-{seed}"), &options)
    };
    let recordings: Vec<PathBuf> = (seed(first)..=seed(last)).map(simulated).collect();
    println!("{} recordings, seeds {range}, {model}; root mean squares over them", recordings.len());
    println!("| at most | focal lengths (%) | projection (px) | stated, 95 % (px) | ATE (mm) |");
    println!("|---|---|---|---|---|");
    for most in EVENTS {
        let trials: Vec<(Accuracy, f64)> =
            recordings.iter().map(|recording| calibrated(lens, folder.path(), recording, most)).collect();
        let rms = |figure: fn(&(Accuracy, f64)) -> f64| {
            (trials.iter().map(|trial| figure(trial).powi(2)).sum::<f64>() / trials.len() as f64).sqrt()
        };
        println!(
            "| {most} | {:.4} | {:.4} | {:.3} | {:.3} |",
            100.0 * rms(|(accuracy, _)| accuracy.focal),
            rms(|(accuracy, _)| accuracy.projection_rms),
            rms(|&(_, stated)| stated),
            1e3 * rms(|(accuracy, _)| accuracy.position),
        );
    }
}

fn calibrated(lens: Lens, folder: &Path, recording: &Path, most: u32) -> (Accuracy, f64) {
    let (settings, output) = (folder.join("settings.toml"), folder.join("calibration"));
    fs::write(&settings, format!("[association]\nmost_events = {most}\n")).expect("settings can be written");
    let events = recording.join("events.aedat4");
    let common = ["calibrate", text(&events), "--board", BOARD, "--model", lens.model, "--accept-any"];
    succeed(&[&common[..], &["--settings", text(&settings), "--force", "-o", text(&output)]].concat());
    let stated = read_json(&output.join("calibration.json"))["uncertainty"]["projection_rms_95"].as_f64();
    (Accuracy::of(&output, recording), stated.expect("the projection's bound is stated"))
}

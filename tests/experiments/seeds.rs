//! Are the stated uncertainties true? Simulates many recordings through one lens, calibrates each, and
//! compares errors with what was stated.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/seeds [FIRST-LAST [MODEL [SIMULATE-OPTION...]]]
//! ```

use std::path::Path;

use evcal_tests::lens::{self, Lens};
use evcal_tests::{BOARD, json, read_json, succeed, text};
use serde_json::Value;

/// What one seed gave.
struct Trial {
    errors: Vec<f64>,
    sigma: Vec<f64>,
    /// Projection difference from the truth, rms over the sensor (px).
    difference: f64,
    /// What it is expected to be, and to stay below in 95 of 100 cases.
    expected: [f64; 2],
    /// The same of the two halves of the recording.
    halves: Option<(f64, [f64; 2])>,
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "1-32".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 1-32");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let seeds = seed(first)..=seed(last);
    let model = arguments.next().unwrap_or_else(|| "radtan".to_owned());
    let lens = lens::ALL.into_iter().find(|lens| lens.model == model).expect("one of the models of the tests");
    let options: Vec<String> = arguments.collect();
    let trials: Vec<Trial> = seeds.filter_map(|seed| trial(lens, seed, &options)).collect();
    println!("{} of seeds {range} calibrated, {model} {}", trials.len(), options.join(" "));
    let names = lens.kind().parameter_names();
    println!("{:<4} {:>11} {:>11} {:>11} {:>7} {:>9}", "", "mean error", "scatter", "stated σ", "ratio", "in 95 %");
    let mut inside_all = 0;
    for (index, name) in names.iter().enumerate() {
        let errors: Vec<f64> = trials.iter().map(|trial| trial.errors[index]).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let scatter = (errors.iter().map(|error| (error - mean) * (error - mean)).sum::<f64>()
            / (errors.len().max(2) - 1) as f64)
            .sqrt();
        let stated = root_mean_square(trials.iter().map(|trial| trial.sigma[index]));
        let inside = trials.iter().filter(|trial| trial.errors[index].abs() < 1.96 * trial.sigma[index]).count();
        inside_all += inside;
        let ratio = stated / scatter;
        println!(
            "{name:<4} {mean:>11.5} {scatter:>11.5} {stated:>11.5} {ratio:>7.2} {:>7.1} %",
            share(inside, trials.len())
        );
    }
    println!("all parameters: truth inside in {:.1} %", share(inside_all, names.len() * trials.len()));
    compare("projection", trials.iter().map(|trial| (trial.difference, trial.expected)));
    compare("split halves", trials.iter().filter_map(|trial| trial.halves));
}

fn trial(lens: Lens, seed: u64, options: &[String]) -> Option<Trial> {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let (simulation, calibration) = (folder.path().join("simulation"), folder.path().join("calibration"));
    let seed = seed.to_string();
    let mut simulate = vec!["simulate", "--board", BOARD, "--model", lens.model, "--parameters", lens.parameters];
    simulate.extend(["--motion", "fast", "--duration", "4s", "--seed", &seed]);
    // A later option takes the place of an earlier one.
    let given = |option: &&str| options.iter().any(|given| given == option);
    for option in ["--motion", "--duration"] {
        if given(&option) {
            let place = simulate.iter().position(|argument| *argument == option)?;
            simulate.drain(place..place + 2);
        }
    }
    simulate.extend(options.iter().map(String::as_str));
    simulate.extend(["-o", text(&simulation)]);
    succeed(&simulate);
    let events = simulation.join("events.aedat4");
    let calibrate = ["calibrate", text(&events), "--board", BOARD, "--model", lens.model, "-o", text(&calibration)];
    let finished = evcal_tests::evcal(&calibrate);
    if finished.code != Some(0) {
        println!("seed {seed}: {}", finished.stderr.trim());
        return None;
    }
    Some(Trial::of(lens, &calibration, &simulation))
}

impl Trial {
    fn of(lens: Lens, calibration: &Path, truth: &Path) -> Self {
        let result = read_json(&calibration.join("calibration.json"));
        let evaluation = json(&["evaluate", text(calibration), "--truth", text(truth), "--json"]);
        let number = |value: &Value| value.as_f64().expect("a number");
        let names = lens.kind().parameter_names();
        let errors = names.iter().map(|name| number(&evaluation["intrinsics"]["parameters"][*name]["difference"]));
        let uncertainty = &result["uncertainty"];
        let halves = &result["split_half"];
        Self {
            errors: errors.collect(),
            sigma: names.iter().map(|name| number(&result["sigma"]["parameters"][*name])).collect(),
            difference: number(&evaluation["projection_difference"]["rms_px"]),
            expected: [number(&uncertainty["projection_rms"]), number(&uncertainty["projection_rms_95"])],
            halves: halves["bound"]
                .as_f64()
                .map(|bound| (number(&halves["difference_rms"]), [number(&halves["expected_rms"]), bound])),
        }
    }
}

fn compare(what: &str, found: impl Iterator<Item = (f64, [f64; 2])>) {
    let found: Vec<(f64, [f64; 2])> = found.collect();
    let inside = found.iter().filter(|(difference, [_, bound])| difference < bound).count();
    println!(
        "{what}: {:.4} px rms, {:.4} px expected, inside the 95 % bound in {:.1} % of {}",
        root_mean_square(found.iter().map(|(difference, _)| *difference)),
        root_mean_square(found.iter().map(|(_, [expected, _])| *expected)),
        share(inside, found.len()),
        found.len()
    );
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.collect();
    (values.iter().map(|value| value * value).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

fn share(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}

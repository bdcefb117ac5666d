//! What goes wrong in a room: is a calibration right within what it states, or refused, and is the cause named?
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/rooms [FIRST-LAST [EFFECT...]]
//! ```

use evcal_tests::lens::RADTAN;
use serde_json::Value;

/// Effects, as `evcal simulate --effects` takes them; a pause is a motion.
const EFFECTS: [&str; 14] = [
    "none",
    "flicker:100Hz:5%",
    "flicker:100Hz:20%",
    "flicker:120Hz:10%",
    "flicker:120Hz:30%",
    "background",
    "hand",
    "glare",
    "smudges",
    "defocus:1px",
    "defocus:2.5px",
    "hot-pixels:300",
    "dead-columns:10",
    "pause",
];

/// A calibration and the truth.
struct Trial {
    /// Error of fx (%).
    focal: f64,
    /// Projection difference from the truth, rms over the sensor, and its stated 95 % bound (px).
    difference: f64,
    bound: f64,
    grade: String,
    causes: Vec<String>,
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "1-4".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 1-4");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let seeds = seed(first)..=seed(last);
    let mut effects: Vec<String> = arguments.collect();
    if effects.is_empty() {
        effects = EFFECTS.map(str::to_owned).to_vec();
    }
    println!(
        "| effect | Δfx, rms (%) | projection, rms and largest of {range} (px) | stated, 95 % (px) | inside | verdicts | causes named |"
    );
    println!("|---|---|---|---|---|---|---|");
    for effect in &effects {
        let outcomes: Vec<Result<Trial, String>> = seeds.clone().map(|seed| trial(effect, seed)).collect();
        print_row(effect, &outcomes);
    }
}

fn trial(effect: &str, seed: u64) -> Result<Trial, String> {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let seed = seed.to_string();
    let motion = if effect == "pause" { "paused" } else { "fast" };
    let effects = match effect {
        "none" | "pause" => Vec::new(),
        effect => vec!["--effects", effect],
    };
    let options = [&["--motion", motion, "--seed", &seed][..], &effects].concat();
    let evcal_tests::Trial { result, evaluation, .. } = evcal_tests::trial(folder.path(), &RADTAN, &options)?;
    let number = |value: &Value| value.as_f64().expect("a number");
    let word = |value: &Value| value.as_str().expect("a word").to_owned();
    let fx: f64 = RADTAN.parameters.split(',').next().and_then(|fx| fx.parse().ok()).expect("fx");
    Ok(Trial {
        focal: 100.0 * number(&evaluation["intrinsics"]["parameters"]["fx"]["difference"]) / fx,
        difference: number(&evaluation["projection_difference"]["rms_px"]),
        bound: number(&result["uncertainty"]["projection_rms_95"]),
        grade: word(&result["verdict"]["grade"]),
        causes: result["verdict"]["findings"]
            .as_array()
            .expect("findings")
            .iter()
            .map(|finding| format!("{} ({})", word(&finding["cause"]), word(&finding["severity"])))
            .collect(),
    })
}

fn print_row(effect: &str, outcomes: &[Result<Trial, String>]) {
    let trials: Vec<&Trial> = outcomes.iter().flatten().collect();
    let rms = |of: &dyn Fn(&Trial) -> f64| {
        (trials.iter().map(|trial| of(trial).powi(2)).sum::<f64>() / trials.len().max(1) as f64).sqrt()
    };
    let largest = trials.iter().map(|trial| trial.difference).fold(0.0, f64::max);
    let inside = trials.iter().filter(|trial| trial.difference < trial.bound).count();
    let verdicts =
        counted(trials.iter().map(|trial| trial.grade.clone()).chain(
            outcomes.iter().filter_map(|outcome| outcome.as_ref().err()).map(|error| format!("refused: {error}")),
        ));
    if trials.is_empty() {
        println!("| {effect} | – | – | – | – | {verdicts} | |");
        return;
    }
    let causes = counted(trials.iter().flat_map(|trial| trial.causes.iter().cloned()));
    println!(
        "| {effect} | {:.3} | {:.3}, {largest:.3} | {:.3} | {inside} of {} | {verdicts} | {causes} |",
        rms(&|trial| trial.focal),
        rms(&|trial| trial.difference),
        rms(&|trial| trial.bound),
        trials.len(),
    );
}

/// Each of the words once, with how often it came.
fn counted(words: impl Iterator<Item = String>) -> String {
    let mut counts: std::collections::BTreeMap<String, usize> = std::collections::BTreeMap::new();
    words.for_each(|word| *counts.entry(word).or_default() += 1);
    counts.iter().map(|(word, count)| format!("{count} {word}")).collect::<Vec<_>>().join(", ")
}

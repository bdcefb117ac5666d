//! Boards that are bent, or printed other than stated: is the defect found and stated, is the focal length right, and are flat
//! boards left alone?
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/boards [FIRST-LAST [DEFECT...]]
//! ```

use evcal_tests::lens::RADTAN;
use serde_json::Value;

/// Defects by name, and the options of `evcal simulate` that make them.
const DEFECTS: [(&str, &[&str]); 9] = [
    ("none", &[]),
    ("bend-1mm", &["--bend=1mm,0mm"]),
    ("bend-2mm", &["--bend=0mm,-2mm"]),
    ("bend-4mm", &["--bend=4mm,0mm"]),
    ("bend-saddle", &["--bend=2mm,-1mm"]),
    ("print-x", &["--print-ratio", "1.003"]),
    ("print-y", &["--print-ratio", "0.997"]),
    ("radius", &["--printed-radius", "17.025mm"]),
    ("all", &["--bend=-1mm,2mm", "--print-ratio", "1.002", "--printed-radius", "18mm"]),
];

/// Parameters of the board in `calibration.json`, with their truth where a recording does not say otherwise.
const PARAMETERS: [&str; 4] = ["print_ratio", "bend_x", "bend_y", "radius"];

/// A calibration and the truth.
struct Trial {
    /// Larger error of fx and fy (%), and that with the board taken as it is stated.
    focal: f64,
    focal_as_stated: f64,
    /// Projection difference from the truth and its stated 95 % bound (px).
    difference: f64,
    bound: f64,
    /// Largest error of an estimated parameter of the board in σ; and their names.
    worst: f64,
    estimated: Vec<&'static str>,
    /// Whether all that is wrong with the board was estimated, and nothing else.
    right: bool,
    /// Largest step of a parameter that is as stated, in σ.
    suspicion: f64,
    grade: String,
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "1-2".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 1-2");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let seeds = seed(first)..=seed(last);
    let wanted: Vec<String> = arguments.collect();
    println!(
        "| defect | Δf as stated, rms (%) | Δf, rms and largest of {range} (%) | projection, rms (px) | inside its 95 % bound | \
         found, and nothing else | stated within 2 σ | largest error (σ) | largest step of what is as stated (σ) | verdicts |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for (defect, options) in DEFECTS {
        if wanted.is_empty() || wanted.iter().any(|wanted| wanted == defect) {
            let trials: Vec<Result<Trial, String>> = seeds.clone().map(|seed| trial(options, seed)).collect();
            print_row(defect, &trials);
        }
    }
}

fn trial(defect: &[&str], seed: u64) -> Result<Trial, String> {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let seed = seed.to_string();
    let options = [&["--motion", "fast", "--seed", &seed][..], defect].concat();
    let evcal_tests::Trial { result, evaluation, truth } = evcal_tests::trial(folder.path(), &RADTAN, &options)?;
    let truth = true_board(&truth);
    Ok(judged(&result, &evaluation, truth))
}

/// The parameters of the board as it was simulated.
fn true_board(truth: &Value) -> [f64; 4] {
    let printed = &truth["settings"]["scene"]["printed"];
    if printed.is_null() {
        return STATED;
    }
    [
        number(&printed["print_ratio"]),
        number(&printed["bend"][0]),
        number(&printed["bend"][1]),
        number(&printed["radius"]),
    ]
}

/// The same of a board as it is stated.
const STATED: [f64; 4] = [1.0, 0.0, 0.0, 0.0175];

fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

fn judged(result: &Value, evaluation: &Value, truth: [f64; 4]) -> Trial {
    let true_focal: Vec<f64> = RADTAN.parameters.split(',').take(2).map(|text| text.parse().expect("f")).collect();
    let error = |camera: &Value| {
        let errors = ["fx", "fy"].iter().zip(&true_focal);
        errors.map(|(name, truth)| 100.0 * (number(&camera["parameters"][*name]) / truth - 1.0)).fold(0.0, larger)
    };
    let board = &result["printed_board"];
    let as_stated = if board["camera_as_stated"].is_null() { &result["camera"] } else { &board["camera_as_stated"] };
    let (mut worst, mut suspicion, mut estimated, mut right): (f64, f64, _, _) = (0.0, 0.0, Vec::new(), true);
    for ((name, truth), stated) in PARAMETERS.into_iter().zip(truth).zip(STATED) {
        let parameter = &board[name];
        let is_estimated = parameter["estimated"].as_bool().expect("true or false");
        right &= is_estimated == ((truth - stated).abs() > 1e-12);
        if is_estimated {
            estimated.push(name);
            worst = larger(worst, (number(&parameter["value"]) - truth) / number(&parameter["sigma"]));
        } else if !parameter["if_free"].is_null() {
            let free = &parameter["if_free"];
            suspicion = larger(suspicion, (number(&free["value"]) - stated) / number(&free["sigma"]));
        }
    }
    Trial {
        focal: error(&result["camera"]),
        focal_as_stated: error(as_stated),
        difference: number(&evaluation["projection_difference"]["rms_px"]),
        bound: number(&result["uncertainty"]["projection_rms_95"]),
        worst: worst.abs(),
        estimated,
        right,
        suspicion: suspicion.abs(),
        grade: result["verdict"]["grade"].as_str().expect("a grade").to_owned(),
    }
}

/// The number that is further from zero.
fn larger(a: f64, b: f64) -> f64 {
    if b.abs() > a.abs() { b } else { a }
}

fn print_row(defect: &str, outcomes: &[Result<Trial, String>]) {
    let trials: Vec<&Trial> = outcomes.iter().flatten().collect();
    let refused = outcomes.len() - trials.len();
    let rms = |of: &dyn Fn(&Trial) -> f64| {
        (trials.iter().map(|trial| of(trial).powi(2)).sum::<f64>() / trials.len().max(1) as f64).sqrt()
    };
    let largest = |of: &dyn Fn(&Trial) -> f64| trials.iter().map(|trial| of(trial).abs()).fold(0.0, f64::max);
    let count = |of: &dyn Fn(&Trial) -> bool| trials.iter().filter(|trial| of(trial)).count();
    let mut grades: Vec<String> = ["good", "usable", "not-good"]
        .iter()
        .map(|grade| (grade, count(&|trial| trial.grade == *grade)))
        .filter(|(_, count)| *count > 0)
        .map(|(grade, count)| format!("{count} {grade}"))
        .collect();
    if refused > 0 {
        grades.push(format!("{refused} refused"));
    }
    println!(
        "| {defect} | {:.3} | {:.3}, {:.3} | {:.3} | {} of {} | {} | {} | {:.1} | {:.1} | {} |",
        rms(&|trial| trial.focal_as_stated),
        rms(&|trial| trial.focal),
        largest(&|trial| trial.focal),
        rms(&|trial| trial.difference),
        count(&|trial| trial.difference < trial.bound),
        trials.len(),
        count(&|trial| trial.right),
        count(&|trial| trial.worst < 2.0),
        largest(&|trial| trial.worst),
        largest(&|trial| trial.suspicion),
        grades.join(", "),
    );
    for (trial, outcome) in trials.iter().zip(1..).filter(|(trial, _)| !trial.right) {
        eprintln!("{defect}, calibration {outcome}: estimated {}", trial.estimated.join(", "));
    }
}

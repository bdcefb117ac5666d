//! Comparison of actual errors with reported uncertainties: simulates many recordings through one lens, calibrates each, and
//! compares the errors of camera and poses with their reported σ.
//!
//! ```text
//! cargo run --release -p evcal-tests --example seeds -- [FIRST-LAST [MODEL [SIMULATE-OPTION...]]]
//! ```

use std::io::BufReader;
use std::path::Path;

use evcal_calibrate::evaluate::trajectory_error::best_time_shift;
use evcal_geometry::timed_pose::TimedPose;
use evcal_geometry::tum;
use evcal_tests::lens::{self, Lens};
use evcal_tests::{BOARD, json, read_json, succeed, text};
use serde_json::Value;

/// Errors and reported uncertainties of one seed.
struct Trial {
    errors: Vec<f64>,
    sigma: Vec<f64>,
    /// Projection difference from the truth, rms over the sensor (px).
    difference: f64,
    /// Expected projection difference (rms, px) and its 95 % bound (px).
    expected: [f64; 2],
    /// Part of the expected difference due to the event model (px rms, σ).
    of_model: f64,
    /// Difference between the two halves of the recording, its expected value and 95 % bound (px).
    halves: Option<(f64, [f64; 2])>,
    poses: Poses,
    /// Dimensions of the board, from [`MEASURES`], that were estimated although the simulated board has its nominal dimensions.
    misjudged: Vec<&'static str>,
}

/// Dimensions in which a printed board may differ from the nominal one.
const MEASURES: [&str; 4] = ["print_ratio", "bend_x", "bend_y", "radius"];

/// Errors of the camera centres of one recording, in the frame of the board.
struct Poses {
    /// Root mean square distance (m).
    rms: f64,
    /// Root mean square distance over the worst 0.1 s (m).
    worst: f64,
    /// Number of compared coordinates of camera centres, and of those within 1.96 reported σ of the truth.
    compared: usize,
    inside: usize,
    /// Poses that are not in trajectory.txt because they are too uncertain or in an excluded interval.
    undetermined: usize,
    /// `true` if the verdict is that the calibration is not good enough.
    not_good: bool,
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
    println!("{:<4} {:>11} {:>11} {:>11} {:>7} {:>9}", "", "mean error", "scatter", "reported σ", "ratio", "in 95 %");
    let mut inside_all = 0;
    for (index, name) in names.iter().enumerate() {
        let errors: Vec<f64> = trials.iter().map(|trial| trial.errors[index]).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let scatter = (errors.iter().map(|error| (error - mean) * (error - mean)).sum::<f64>()
            / (errors.len().max(2) - 1) as f64)
            .sqrt();
        let reported = root_mean_square(trials.iter().map(|trial| trial.sigma[index]));
        let inside = trials.iter().filter(|trial| trial.errors[index].abs() < 1.96 * trial.sigma[index]).count();
        inside_all += inside;
        let ratio = reported / scatter;
        println!(
            "{name:<4} {mean:>11.5} {scatter:>11.5} {reported:>11.5} {ratio:>7.2} {:>7.1} %",
            share(inside, trials.len())
        );
    }
    println!("all parameters: truth within 95 % in {:.1} %", share(inside_all, names.len() * trials.len()));
    compare("projection", trials.iter().map(|trial| (trial.difference, trial.expected)));
    compare("split halves", trials.iter().filter_map(|trial| trial.halves));
    let poses = || trials.iter().map(|trial| &trial.poses);
    let largest = |values: &mut dyn Iterator<Item = f64>| 1e3 * values.fold(0.0, f64::max);
    println!(
        "camera centres: {:.2} mm rms, {:.2} mm in the worst recording, {:.2} mm in the worst 0.1 s; truth within 95 % in {:.1} %; {} poses not determined",
        1e3 * root_mean_square(poses().map(|poses| poses.rms)),
        largest(&mut poses().map(|poses| poses.rms)),
        largest(&mut poses().map(|poses| poses.worst)),
        share(poses().map(|poses| poses.inside).sum(), poses().map(|poses| poses.compared).sum()),
        poses().map(|poses| poses.undetermined).sum::<usize>()
    );
    println!("verdict \"not good enough\": {}", poses().filter(|poses| poses.not_good).count());
    let misjudged = |measure| trials.iter().filter(|trial| trial.misjudged.contains(measure)).count();
    let counts: Vec<String> = MEASURES.iter().map(|measure| format!("{} {measure}", misjudged(measure))).collect();
    println!("boards that were estimated to differ from the nominal ones, of {}: {}", trials.len(), counts.join(", "));
}

fn trial(lens: Lens, seed: u64, options: &[String]) -> Option<Trial> {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let (simulation, calibration) = (folder.path().join("simulation"), folder.path().join("calibration"));
    let seed = seed.to_string();
    let mut simulate = vec!["simulate", "--board", BOARD, "--model", lens.model, "--parameters", lens.parameters];
    simulate.extend(["--motion", "fast", "--duration", "4s", "--seed", &seed]);
    // A given option replaces the default.
    let given = |option: &&str| options.iter().any(|given| given == option);
    for option in ["--motion", "--duration"] {
        if given(&option) {
            let index = simulate.iter().position(|argument| *argument == option)?;
            simulate.drain(index..index + 2);
        }
    }
    simulate.extend(options.iter().map(String::as_str));
    simulate.extend(["-o", text(&simulation)]);
    succeed(&simulate);
    let events = simulation.join("events.aedat4");
    // Calibrations that are not good enough count as well.
    let calibrate =
        ["calibrate", text(&events), "--board", BOARD, "--model", lens.model, "--accept-any", "-o", text(&calibration)];
    let finished = evcal_tests::evcal(&calibrate);
    if finished.code != Some(0) {
        println!("seed {seed}: {}", finished.stderr.trim());
        return None;
    }
    let trial = Trial::of(lens, &calibration, &simulation);
    let [_, bound] = trial.expected;
    let halves = trial.halves.map_or_else(
        || "no halves".to_owned(),
        |(difference, [expected, bound])| {
            format!("halves {difference:.4} px, {expected:.4} expected, {bound:.4} bound")
        },
    );
    println!(
        "seed {seed}: {:.4} px error, {bound:.4} bound; {halves}; model of events {:.4} px",
        trial.difference, trial.of_model
    );
    Some(trial)
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
            of_model: number(&uncertainty["projection_parts"]["event_model"]),
            halves: halves["bound"]
                .as_f64()
                .map(|bound| (number(&halves["difference_rms"]), [number(&halves["expected_rms"]), bound])),
            poses: Poses::of(calibration, truth, result["verdict"]["grade"] == "not-good"),
            misjudged: MEASURES
                .into_iter()
                .filter(|measure| result["printed_board"][*measure]["estimated"] == true)
                .collect(),
        }
    }
}

impl Poses {
    /// Compares the poses in the folder `calibration` with the poses in the folder `truth`. The clocks differ by the pixel latency.
    fn of(calibration: &Path, truth: &Path, not_good: bool) -> Self {
        let real = trajectory(truth);
        let estimated = trajectory(calibration);
        let shift = best_time_shift(&real, &estimated, 0.02).expect("trajectories overlap");
        let offset = |t: f64, centre: [f64; 3]| -> Option<[f64; 3]> {
            let after = real.partition_point(|pose| pose.t < t + shift);
            let (a, b) = (real.get(after.checked_sub(1)?)?, real.get(after)?);
            let share = (t + shift - a.t) / (b.t - a.t);
            let at = a.pose.translation.vector.lerp(&b.pose.translation.vector, share);
            Some(std::array::from_fn(|axis| centre[axis] - at[axis]))
        };
        let square = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
        let squares: Vec<(f64, f64)> = estimated
            .iter()
            .filter_map(|pose| Some((pose.t, square(offset(pose.t, pose.pose.translation.vector.into())?))))
            .collect();
        let mean = |part: &[(f64, f64)]| part.iter().map(|(_, square)| square).sum::<f64>() / part.len() as f64;
        let tenth = |t: f64| (10.0 * t).floor();
        let (mut compared, mut inside, mut rows) = (0, 0, 0);
        let table = std::fs::read_to_string(calibration.join("trajectory.csv")).expect("poses with their sigma");
        for line in table.lines().skip(1) {
            rows += 1;
            let fields: Vec<f64> = line.split(',').filter_map(|field| field.parse().ok()).collect();
            let &[t, x, y, z, _, _, _, _, a, b, c, ..] = fields.as_slice() else { continue };
            let Some(offset) = offset(t, [x, y, z]) else { continue };
            compared += 3;
            inside += offset.iter().zip([a, b, c]).filter(|(offset, sigma)| offset.abs() < 1.96 * sigma).count();
        }
        Self {
            rms: mean(&squares).sqrt(),
            worst: squares.chunk_by(|a, b| tenth(a.0) == tenth(b.0)).map(mean).fold(0.0, f64::max).sqrt(),
            compared,
            inside,
            undetermined: rows - estimated.len(),
            not_good,
        }
    }
}

fn trajectory(folder: &Path) -> Vec<TimedPose> {
    let file = std::fs::File::open(folder.join("trajectory.txt")).expect("a trajectory");
    tum::read(BufReader::new(file)).expect("a TUM file")
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

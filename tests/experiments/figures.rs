//! The tables of docs/accuracy.md: simulates recordings, calibrates them, and compares with the truth.
//!
//! ```text
//! cargo run --release -p evcal-tests --example figures -- [TABLE [FIRST-LAST]]
//! ```
//!
//! TABLE is a name in [`tables`]; the default is all tables, which take half an hour on two cores. Each row summarises the seeds
//! from FIRST to LAST, 1-1 by default.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use evcal_tests::lens::{self, EUCM, FOV, KANNALA_BRANDT, Lens, RADTAN, RADTAN8};
use evcal_tests::{BOARD, camera, json, program, read_json, succeed, text};
use serde_json::Value;

/// A simulated recording and the options of its calibration.
struct Row {
    name: String,
    lens: Lens,
    board: &'static str,
    /// Model of the calibration.
    model: &'static str,
    /// Options of `evcal simulate` and `evcal calibrate`.
    simulate: Vec<&'static str>,
    calibrate: Vec<&'static str>,
}

impl Row {
    /// Creates a row that is calibrated with the lens's own model.
    fn new(name: &str, lens: Lens, simulate: &[&'static str]) -> Self {
        let (name, model) = (name.to_owned(), lens.model);
        Self { name, lens, board: BOARD, model, simulate: simulate.to_vec(), calibrate: Vec::new() }
    }
}

const FAST: [&str; 4] = ["--motion", "fast", "--duration", "4s"];

/// Lenses in front of 1280 × 720 pixels: a narrow one and two of 95 degrees.
const LARGE: [Lens; 3] = [
    Lens { model: "radtan", parameters: "1262.1,1260.4,645.2,352.9,-0.36,0.17,-0.0005,0.0003,-0.05" },
    Lens { model: "kannala-brandt", parameters: "726.3,725.1,633.8,364.7,-0.018,0.006,-0.003,0.0006" },
    Lens { model: "eucm", parameters: "726.3,725.1,633.8,364.7,0.6,1.12" },
];

/// Boards of squares.
const SQUARES: [&str; 5] = [
    "checkerboard:6x9:25mm",
    "charuco:5x7:30mm:22mm:DICT_5X5_100",
    "aprilgrid:6x6:35.2mm:0.3",
    "aprilgrid:6x6:35.2mm:0.3:border1",
    "apriltags:3x4:60mm:0.25",
];

/// Boards in frames: the squares, smaller tags, and dots.
const IN_FRAMES: [&str; 6] = [
    "checkerboard:6x9:25mm",
    "charuco:5x7:30mm:22mm:DICT_5X5_100",
    "aprilgrid:6x6:35.2mm:0.3",
    "apriltags:3x4:45mm:0.25",
    "apriltags:3x4:45mm:0.25:border2",
    BOARD,
];

/// Lenses and unsuitable models.
const WRONG_MODELS: [(Lens, [&str; 3]); 5] = [
    (RADTAN, ["radtan4", "ucm", "fov"]),
    (RADTAN8, ["radtan4", "ucm", "fov"]),
    (KANNALA_BRANDT, ["radtan4", "radtan", "fov"]),
    (EUCM, ["radtan4", "radtan", "ucm"]),
    (FOV, ["radtan4", "radtan", "ucm"]),
];

/// Deviations of the printed board from its nominal dimensions, and the options that simulate them.
const BOARDS: [(&str, &[&str]); 9] = [
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

/// Disturbances in a room, as values of `evcal simulate --effects`.
const ROOMS: [&str; 12] = [
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
];

/// Returns all tables by name.
fn tables() -> Vec<(&'static str, Vec<Row>)> {
    let recordings = vec![
        Row::new("fast, 6 s", RADTAN, &["--motion", "fast", "--duration", "6s"]),
        Row::new("fast, 5 s", KANNALA_BRANDT, &["--motion", "fast", "--duration", "5s"]),
        Row::new("blur, low light, 3 s", RADTAN, &["--motion", "blur", "--light", "low", "--duration", "3s"]),
        Row::new("violent, 4 s", RADTAN, &["--motion", "violent", "--duration", "4s"]),
        Row::new("fast, 20 s", RADTAN, &["--motion", "fast", "--duration", "20s"]),
    ];
    let models = lens::ALL.map(|lens| Row::new("own model", lens, &FAST)).into();
    let large = LARGE.map(|lens| Row::new("imx636", lens, &[&FAST[..], &["--sensor", "imx636"]].concat()));
    let squares =
        SQUARES.map(|board| [RADTAN, KANNALA_BRANDT, EUCM].map(|lens| Row { board, ..Row::new(board, lens, &FAST) }));
    let slow = ["--motion", "slow", "--duration", "3s", "--frames", "25"];
    let in_frames = IN_FRAMES.map(|board| {
        [RADTAN, KANNALA_BRANDT, EUCM].map(|lens| Row {
            board,
            calibrate: vec!["--frames-only"],
            ..Row::new(board, lens, &slow)
        })
    });
    let wrong = |(lens, models): (Lens, [&'static str; 3])| {
        models.map(|model| Row { model, ..Row::new(&format!("as {model}"), lens, &FAST) })
    };
    let choices = [("default", &[][..]), ("soft", &["--extraction", "soft"]), ("so3", &["--rotation", "so3"])];
    let choice = |(name, options): (&str, &[&'static str])| {
        let low_light = [&FAST[..], &["--light", "low"]].concat();
        let recordings =
            [("", RADTAN, &FAST[..]), ("", KANNALA_BRANDT, &FAST[..]), (", low light", RADTAN, &low_light[..])];
        recordings.map(|(light, lens, simulate)| Row {
            calibrate: options.to_vec(),
            ..Row::new(&format!("{name}{light}"), lens, simulate)
        })
    };
    let boards = BOARDS.map(|(name, options)| Row::new(name, RADTAN, &[&FAST[..], options].concat()));
    let mut rooms = vec![Row::new("none", RADTAN, &FAST)];
    rooms.extend(ROOMS.map(|effect| Row::new(effect, RADTAN, &[&FAST[..], &["--effects", effect]].concat())));
    rooms.push(Row::new("pause", RADTAN, &["--motion", "paused", "--duration", "4s"]));
    vec![
        ("recordings", recordings),
        ("models", models),
        ("sensors", large.into()),
        ("squares", squares.into_iter().flatten().collect()),
        ("frames", in_frames.into_iter().flatten().collect()),
        ("wrong-models", WRONG_MODELS.into_iter().flat_map(wrong).collect()),
        ("choices", choices.into_iter().flat_map(choice).collect()),
        ("boards", boards.into()),
        ("rooms", rooms),
    ]
}

/// Errors and verdict of one calibration.
struct Trial {
    /// Larger relative error of the two focal lengths on the axis (%), and larger error of the two principal point coordinates (px).
    focal: f64,
    center: f64,
    /// Projection difference over the sensor (px): root mean square, maximum, and the reported 95 % bound.
    rms: f64,
    max: f64,
    bound: f64,
    /// Root mean square error of the trajectory after the best time shift (mm).
    position: f64,
    grade: String,
    /// Causes of the verdict's findings, and the recommended model.
    findings: Vec<String>,
    /// Larger relative error of fx and fy with the nominal board (%), if the printed board was found to differ from it.
    focal_nominal: Option<f64>,
    events: f64,
    run: Run,
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let range = arguments.get(1).map_or("1-1", String::as_str);
    let (first, last) = range.split_once('-').expect("the first and the last seed: 1-8");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let seeds = seed(first)..=seed(last);
    for (name, rows) in tables() {
        if arguments.first().is_none_or(|wanted| wanted == name) {
            println!("\n{name}, seeds {range}\n");
            print_table(&rows, &seeds);
        }
    }
}

fn print_table(rows: &[Row], seeds: &RangeInclusive<u64>) {
    println!(
        "| recording | lens | Δf (%) | Δc (px) | projection rms / max (px) | reported 95 % (px) | inside | ATE (mm) | verdict | findings | \
         million events | processor time per million events (s) | elapsed time (s) | memory (MB) |"
    );
    println!("|{}", "---|".repeat(14));
    for row in rows {
        let outcomes: Vec<Result<Trial, String>> = seeds.clone().map(|seed| trial(row, seed)).collect();
        let trials: Vec<&Trial> = outcomes.iter().flatten().collect();
        let failed =
            outcomes.iter().filter_map(|outcome| outcome.as_ref().err()).map(|error| format!("failed: {error}"));
        let verdicts = counted(trials.iter().map(|trial| trial.grade.clone()).chain(failed));
        let (name, model) = (&row.name, row.lens.model);
        if trials.is_empty() {
            println!("| {name} | {model} | | | | | | | {verdicts} | | | | | |");
            continue;
        }
        let rms = |of: fn(&Trial) -> f64| {
            (trials.iter().map(|trial| of(trial).powi(2)).sum::<f64>() / trials.len() as f64).sqrt()
        };
        let mut findings = counted(trials.iter().flat_map(|trial| trial.findings.iter().cloned()));
        if trials.iter().any(|trial| trial.focal_nominal.is_some()) {
            findings += &format!("; nominal board Δf {:.3} %", rms(|trial| trial.focal_nominal.unwrap_or(trial.focal)));
        }
        println!(
            "| {name} | {model} | {:.3} | {:.2} | {:.3} / {:.3} | {:.3} | {} of {} | {:.2} | {verdicts} | {findings} | {:.1} | {:.2} | {:.1} | {:.0} |",
            rms(|trial| trial.focal),
            rms(|trial| trial.center),
            rms(|trial| trial.rms),
            trials.iter().map(|trial| trial.max).fold(0.0, f64::max),
            rms(|trial| trial.bound),
            trials.iter().filter(|trial| trial.rms < trial.bound).count(),
            trials.len(),
            rms(|trial| trial.position),
            rms(|trial| 1e-6 * trial.events),
            rms(|trial| 1e6 * trial.run.processor / trial.events),
            rms(|trial| trial.run.wall),
            rms(|trial| trial.run.memory),
        );
    }
}

/// Lists the distinct words, each with its count if it occurs more than once.
fn counted(words: impl Iterator<Item = String>) -> String {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    words.for_each(|word| *counts.entry(word).or_default() += 1);
    let words = counts.iter().map(|(word, count)| if *count == 1 { word.clone() } else { format!("{count} {word}") });
    words.collect::<Vec<_>>().join(", ")
}

/// Simulates and calibrates. Returns the program's message if the calibration fails.
fn trial(row: &Row, seed: u64) -> Result<Trial, String> {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let (simulation, calibration) = (folder.path().join("simulation"), folder.path().join("calibration"));
    let seed = seed.to_string();
    let scene = ["--board", row.board, "--model", row.lens.model, "--parameters", row.lens.parameters, "--seed", &seed];
    succeed(&[&["simulate", "-o", text(&simulation)][..], &scene, &row.simulate].concat());
    let events = simulation.join("events.aedat4");
    let options = ["--board", row.board, "--model", row.model, "--accept-any", "-o", text(&calibration)];
    let run = Run::of(&[&["calibrate", text(&events)][..], &options, &row.calibrate].concat())?;
    let result = read_json(&calibration.join("calibration.json"));
    let evaluation = json(&["evaluate", text(&calibration), "--truth", text(&simulation), "--json"]);
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let word = |value: &Value| value.as_str().expect("a word").to_owned();
    let [found, truth] =
        [calibration.join("calibration.json"), simulation.join("truth.json")].map(|file| camera(&file));
    let axial =
        |camera: &evcal_core::camera::Camera<f64>| camera.axial_focal_lengths().expect("the axis is in every domain");
    let focal = axial(&found).into_iter().zip(axial(&truth)).map(|(found, truth)| 100.0 * (found / truth - 1.0).abs());
    let center =
        found.parameters()[2..4].iter().zip(&truth.parameters()[2..4]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    let found_causes = result["verdict"]["findings"].as_array().expect("findings");
    let mut findings: Vec<String> = found_causes
        .iter()
        .map(|finding| format!("{} ({})", word(&finding["cause"]), word(&finding["severity"])))
        .collect();
    findings.extend(result["misfit"]["better_model"].as_str().map(|model| format!("better: {model}")));
    let nominal = &result["printed_board"]["camera_as_stated"]["parameters"];
    let focal_nominal = (!nominal.is_null()).then(|| {
        let errors = ["fx", "fy"].iter().zip(truth.parameters());
        errors.map(|(name, truth)| 100.0 * (number(&nominal[*name]) / truth - 1.0).abs()).fold(0.0, f64::max)
    });
    let projection = &evaluation["projection_difference"];
    Ok(Trial {
        focal: focal.fold(0.0, f64::max),
        center,
        rms: number(&projection["rms_px"]),
        max: number(&projection["max_px"]),
        bound: number(&result["uncertainty"]["projection_rms_95"]),
        position: 1e3 * number(&evaluation["trajectory"]["best_time_shift"]["as_is_m"]["rmse"]),
        grade: word(&result["verdict"]["grade"]),
        findings,
        focal_nominal,
        events: number(&result["stages"]["recordings"][0]["count"]),
        run,
    })
}

/// Cost of a run of the program: processor time (s), elapsed time (s) and peak memory (MB). NaN if the system does not report it.
struct Run {
    processor: f64,
    wall: f64,
    memory: f64,
}

impl Run {
    /// Runs the program. Returns the first line of its error message if it fails.
    fn of(arguments: &[&str]) -> Result<Self, String> {
        let errors = tempfile::NamedTempFile::new().expect("a file can be made");
        let (start, before) = (Instant::now(), seconds_of_children());
        let mut command = Command::new(program());
        command.args(arguments).stdout(Stdio::null()).stderr(errors.reopen().expect("a file can be written"));
        let mut child = command.spawn().expect("evcal starts");
        let mut memory = f64::NAN;
        let status = loop {
            memory = most_memory(child.id()).unwrap_or(memory);
            if let Some(status) = child.try_wait().expect("it is a child of this program") {
                break status;
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        let wall = start.elapsed().as_secs_f64();
        if !status.success() {
            let messages = std::fs::read_to_string(errors.path()).expect("errors are text");
            return Err(messages.lines().find(|line| !line.ends_with(" ...")).unwrap_or_default().to_owned());
        }
        let processor = before.zip(seconds_of_children()).map_or(f64::NAN, |(before, after)| after - before);
        Ok(Self { processor, wall, memory })
    }
}

/// Returns the processor time in seconds of all ended child processes.
fn seconds_of_children() -> Option<f64> {
    const TICKS: f64 = 100.0;
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Fields 16 and 17. Field 2, the name in brackets, may contain spaces.
    let mut fields = text.rsplit_once(')')?.1.split_whitespace().skip(13);
    let mut ticks = || fields.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / TICKS)
}

/// Returns the peak memory of the process so far (MB).
fn most_memory(process: u32) -> Option<f64> {
    let text = std::fs::read_to_string(Path::new("/proc").join(process.to_string()).join("status")).ok()?;
    let kilobytes = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().strip_suffix(" kB")?;
    Some(kilobytes.parse::<f64>().ok()? * 1024.0 / 1e6)
}

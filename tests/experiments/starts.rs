//! The native start against OpenCV's: how far apart are the cameras that the joint solve starts from, and those that it gives?
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/starts                             # every model
//! target/release/examples/starts MODEL...                    # these models
//! target/release/examples/starts --recording FILE MODEL BOARD   # another recording
//! ```
//!
//! Narrow models are fitted to the recording in `fixtures/board`, wide ones to a simulated wide lens: 2 s of each. Clutter is the
//! Newton's cradle of `fixtures`, whose events are added to the board's, over and over. Where the starts keep different numbers of
//! frames, these are told.

use std::ops::ControlFlow;
use std::path::Path;

use evcal::calibrate::{Task, calibrate};
use evcal::detection::search::{FoundContent, SearchFor, search_events};
use evcal::initial::model_choice::ModelRequest;
use evcal::initial::{InitialSettings, Start, initial_model};
use evcal::lens::projection_difference::projection_difference;
use evcal::settings::Settings;
use evcal::{Board, Calibrated, Input, Recording, RecordingOptions};
use evcal_core::camera::{Camera, ModelKind};
use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use evcal_tests::lens::KANNALA_BRANDT;
use evcal_tests::{BOARD, all_events, session};

/// Length of the recordings (µs).
const LENGTH: i64 = 2_000_000;

/// Views of the input with few of them.
const FEW: usize = 6;

/// Seeds of RANSAC that are compared.
const SEEDS: u64 = 32;

/// The native start that is compared with OpenCV's.
const NATIVE: Start = Start::Native { seed: 0 };

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    println!("| model | input | first cameras differ, rms / max (px) | results differ, rms / max (px) |");
    println!("|---|---|---|---|");
    if let ["--recording", file, model, board] = arguments.as_slice() {
        let kind = ModelKind::from_name(model).expect("a model of evcal's");
        Comparison { kind, board: board.parse().expect("a board") }.all(&events(Path::new(file)));
        return;
    }
    for &kind in ModelKind::ALL.iter().filter(|kind| arguments.is_empty() || arguments.contains(&kind.name())) {
        Comparison { kind, board: BOARD.parse().expect("a board") }.all(&events(&recording_for(kind)));
    }
}

/// A recording through a lens that this model can follow.
fn recording_for(kind: ModelKind) -> std::path::PathBuf {
    match kind {
        ModelKind::Radtan4 | ModelKind::Radtan | ModelKind::Radtan8 | ModelKind::InverseRadial => {
            session().join("events.dvraw")
        }
        _ => KANNALA_BRANDT.recording().join("events.aedat4"),
    }
}

/// The first events of a recording, times from its first.
fn events(path: &Path) -> Vec<Event> {
    let recording = Recording::new(path, RecordingOptions::default()).expect("a recording");
    let mut all = all_events(&mut recording.open().expect("its header is whole"));
    let start = all.first().map_or(0, |event: &Event| event.t);
    all.iter_mut().for_each(|event| event.t -= start);
    all.retain(|event| event.t < LENGTH);
    all
}

/// The events of the Newton's cradle besides.
fn with_clutter(board: &[Event]) -> Vec<Event> {
    let cradle = events(&session().with_file_name("newtons-cradle.dvraw"));
    let period = cradle.last().expect("it holds events").t + 1;
    let rounds = (0..=LENGTH / period)
        .flat_map(|round| cradle.iter().map(move |event| Event { t: event.t + round * period, ..*event }));
    let mut all: Vec<Event> = board.iter().copied().chain(rounds.filter(|event| event.t < LENGTH)).collect();
    all.sort_by_key(|event| event.t);
    all
}

/// A recording that is in memory.
fn recording(events: &[Event]) -> Recording {
    let options = RecordingOptions { sensor: Some(SENSOR), ..RecordingOptions::default() };
    Recording::from_events("events", events.to_vec(), options)
}

/// What is calibrated again and again.
struct Comparison {
    kind: ModelKind,
    board: Board,
}

impl Comparison {
    fn all(&self, events: &[Event]) {
        let usual = Settings::default();
        let native = self.both("a recording", events, &usual);
        let mut few = Settings::default();
        let stage = &mut few.initial;
        (stage.start_views, stage.first_bundle_views, stage.bundle_views, stage.min_frames) = (FEW, FEW, FEW, FEW);
        self.both(&format!("{FEW} views"), events, &few);
        self.both("clutter", &with_clutter(events), &usual);
        self.seeds(events, &native);
    }

    fn calibrated(&self, events: &[Event], settings: &Settings, start: Start) -> Calibrated {
        let inputs = [Input::from(recording(events))];
        let settings = Settings { initial: InitialSettings { start, ..settings.initial.clone() }, ..settings.clone() };
        let model = ModelRequest::Given(self.kind);
        let task = Task { model, settings: &settings, ..Task::new(&inputs, &self.board) };
        calibrate(&task, |_| ControlFlow::Continue(())).expect("it can be calibrated")
    }

    /// A row for both starts from one input; the calibration that started natively.
    fn both(&self, name: &str, events: &[Event], settings: &Settings) -> Calibrated {
        let opencv = self.calibrated(events, settings, Start::Opencv);
        let native = self.calibrated(events, settings, NATIVE);
        // Where OpenCV's camera explains too few views, the native one is taken.
        let own = if opencv.initial().report.native_start { ", OpenCV fails" } else { "" };
        self.tell(&format!("{name}{own}"), &opencv, &native);
        native
    }

    /// A row for the seed of RANSAC that leads furthest away from that of `reference`.
    fn seeds(&self, events: &[Event], reference: &Calibrated) {
        let recording = recording(events);
        let wanted = SearchFor::Board(self.board.pattern);
        let found = search_events(&recording, SENSOR, wanted, &Settings::default().detection).expect("events");
        let FoundContent::Boards(_, frames) = found.content else { panic!("a board was looked for") };
        let first_camera = |seed: u64| {
            let settings = InitialSettings { start: Start::Native { seed }, ..InitialSettings::default() };
            let model = initial_model(&frames, &self.board, SENSOR, self.kind, &settings);
            model.expect("every seed finds a camera").camera
        };
        let first = first_camera(0);
        let apart = (1..SEEDS).map(|seed| (seed, difference(&first, &first_camera(seed))));
        let furthest = apart.max_by(|a, b| a.1[1].total_cmp(&b.1[1]));
        let (seed, [rms, max]) = furthest.expect("there are seeds");
        let other = self.calibrated(events, &Settings::default(), Start::Native { seed });
        let [last_rms, last_max] = difference(reference.camera(), other.camera());
        let name = format!("{SEEDS} seeds: 0 and {seed}");
        println!("| `{}` | {name} | {rms:.6} / {max:.6} | {last_rms:.6} / {last_max:.6} |", self.kind);
    }

    fn tell(&self, name: &str, first: &Calibrated, second: &Calibrated) {
        let [rms, max] = difference(&first.initial().camera, &second.initial().camera);
        let [last_rms, last_max] = difference(first.camera(), second.camera());
        // Of other frames there are other cameras.
        let frames = match [first, second].map(|calibrated| calibrated.initial().frames.len()) {
            [one, other] if one == other => String::new(),
            [one, other] => format!(", {one} and {other} frames"),
        };
        println!("| `{}` | {name}{frames} | {rms:.6} / {max:.6} | {last_rms:.6} / {last_max:.6} |", self.kind);
    }
}

/// The sensor of all of them.
const SENSOR: Sensor = Sensor::new(346, 260);

/// Root mean square and largest projection difference (px).
fn difference(first: &Camera<f64>, second: &Camera<f64>) -> [f64; 2] {
    let difference = projection_difference(first, second, SENSOR).expect("both cover the sensor");
    [difference.rms, difference.max]
}

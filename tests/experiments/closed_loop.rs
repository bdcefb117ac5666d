//! Somebody who follows the ghost of `evcal live`: how long it takes, and whether the result is true.
//!
//! ```text
//! cargo build --release --workspace --examples
//! target/release/examples/closed_loop [FIRST-LAST [ghost|frontal]]
//! ```
//!
//! A simulated person moves the board at up to 0.35 m/s and 1 rad/s, with a tremor and a swing of 4 cm, and sees what the
//! detector and the guidance make of the events so far. `frontal` listens to nobody and never tilts the board.

use std::cell::RefCell;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::{Arc, Mutex};

use evcal_calibrate::calibrate::Task;
use evcal_calibrate::calibrate::beginning::calibrate_beginning;
use evcal_calibrate::settings::Settings;
use evcal_core::camera::Camera;
use evcal_core::event::Event;
use evcal_geometry::board::Board;
use evcal_geometry::numerics::random::{normal, uniform_in};
use evcal_live::checkpoint::{Checkpoints, Stated, Telling};
use evcal_live::guidance::Place;
use evcal_live::observer::{Observer, Seen};
use evcal_live::wanted::words;
use evcal_simulator::presets::{LightPreset, MotionPreset};
use evcal_simulator::rays::Rays;
use evcal_simulator::recording::DAVIS346_SENSOR;
use evcal_simulator::scene::SceneSettings;
use evcal_simulator::{Simulation, SimulationSettings};
use evcal_tests::lens::RADTAN;
use evcal_tests::{BOARD, json, read_json, succeed, text};
use event_recordings::write::{EventWriter, OutputFormat};
use event_recordings::{Recording, RecordingOptions};
use nalgebra::{Isometry3, Vector2, Vector3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Nobody holds a board for longer (s).
const LONGEST: f64 = 90.0;
/// The person decides so often (s).
const STEP: f64 = 0.1;
/// Decisions are made so many steps before they are seen: a smooth path needs them, and so does a person.
const AHEAD: usize = 4;
/// Length of the simulation's slices (s).
const SLICE: f64 = 0.025;
/// Errors of the hands (rad, m).
const HANDS: (f64, f64) = (0.1, 0.02);
/// Speed of the hands (m/s, rad/s).
const SPEED: (f64, f64) = (0.35, 1.0);
/// The result of a checkpoint is told when the recording is so many times as long.
const TOLD_AT_LENGTH: f64 = 1.3;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let range = arguments.next().unwrap_or_else(|| "1-5".to_owned());
    let (first, last) = range.split_once('-').expect("the first and the last seed: 1-5");
    let seed = |text: &str| text.parse::<u64>().expect("a seed is a whole number");
    let follows = match arguments.next().as_deref() {
        None | Some("ghost") => Follows::Ghost,
        Some("frontal") => Follows::Nobody,
        Some(other) => panic!("{other} is neither ghost nor frontal"),
    };
    println!("seed  ended after  board seen  stated 95 %  true error (px)  events");
    for seed in seed(first)..=seed(last) {
        session(seed, follows);
    }
}

/// Whom the person listens to.
#[derive(Clone, Copy, PartialEq)]
enum Follows {
    Ghost,
    /// Holds the board frontally.
    Nobody,
}

/// Position of the board (m), tilt and turn (rad).
type Pose = [f64; 6];

struct Person {
    follows: Follows,
    board: Board,
    random: ChaCha8Rng,
    at: Place,
    goal: Place,
    followed: Option<Place>,
    tremor: Pose,
    /// Where the board is at multiples of [`STEP`], the first three before the beginning.
    path: Vec<Pose>,
}

impl Person {
    fn new(follows: Follows, board: Board, seed: u64) -> Self {
        let at = Place { position: Vector3::new(0.0, 0.0, 1.0), tilt: Vector2::zeros(), roll: 0.0 };
        let random = ChaCha8Rng::seed_from_u64(seed);
        Self { follows, board, random, at, goal: at, followed: None, tremor: [0.0; 6], path: Vec::new() }
    }

    /// Goes on for one step, towards the ghost at `wanted`.
    fn step(&mut self, wanted: Option<Place>) {
        let is_new = match self.follows {
            Follows::Ghost => self.followed != wanted,
            Follows::Nobody => self.path.len().is_multiple_of(20),
        };
        if is_new {
            self.followed = wanted;
            let wanted = match self.follows {
                Follows::Ghost => wanted.unwrap_or(self.goal),
                Follows::Nobody => self.somewhere_frontal(),
            };
            let (turn, shift) = HANDS;
            let mut shaken = |size: f64| normal(&mut self.random) * size;
            self.goal = Place {
                position: wanted.position + Vector3::new(shaken(shift), shaken(shift), shaken(shift)),
                tilt: wanted.tilt + Vector2::new(shaken(turn), shaken(turn)),
                roll: wanted.roll + shaken(turn),
            };
        }
        let way = self.goal.position - self.at.position;
        let turn = (self.goal.tilt - self.at.tilt).push(self.goal.roll - self.at.roll);
        self.at.position += way * (SPEED.0 * STEP / way.norm().max(1e-9)).min(0.5);
        let turn = turn * (SPEED.1 * STEP / turn.norm().max(1e-9)).min(0.5);
        self.at.tilt += turn.xy();
        self.at.roll += turn.z;
        for (index, part) in self.tremor.iter_mut().enumerate() {
            *part = 0.8 * *part + normal(&mut self.random) * if index < 3 { 0.006 } else { 0.02 };
        }
        // Without motion there are no events: a person who is told so swings the board.
        let t = self.path.len() as f64 * STEP;
        let swing = [0.04 * (5.0 * t).sin(), 0.04 * (3.7 * t).cos(), 0.0, 0.0, 0.0, 0.0];
        let Place { position, tilt, roll } = self.at;
        let held = [position.x, position.y, position.z, tilt.x, tilt.y, roll];
        self.path.push(std::array::from_fn(|axis| held[axis] + swing[axis] + self.tremor[axis]));
    }

    fn somewhere_frontal(&mut self) -> Place {
        let [x, y] = [0.12, 0.08].map(|size| size * normal(&mut self.random));
        let z = uniform_in(&mut self.random, 0.8, 1.2);
        Place { position: Vector3::new(x, y, z), tilt: Vector2::zeros(), roll: 0.0 }
    }

    /// `T_world_camera` at `t` seconds: a uniform cubic B-spline through the path.
    fn pose(&self, t: f64) -> Isometry3<f64> {
        let u = (t / STEP).max(0.0);
        let (first, u) = (u.floor() as usize, u.fract());
        let weights = [
            (1.0 - u).powi(3) / 6.0,
            (3.0 * u.powi(3) - 6.0 * u * u + 4.0) / 6.0,
            (-3.0 * u.powi(3) + 3.0 * u * u + 3.0 * u + 1.0) / 6.0,
            u.powi(3) / 6.0,
        ];
        let knots = &self.path[first..first + weights.len()];
        let at = |axis: usize| knots.iter().zip(weights).map(|(knot, weight)| knot[axis] * weight).sum();
        let place =
            Place { position: Vector3::from_fn(|axis, _| at(axis)), tilt: Vector2::new(at(3), at(4)), roll: at(5) };
        place.pose(&self.board).inverse()
    }
}

fn session(seed: u64, follows: Follows) {
    let folder = tempfile::tempdir().expect("a folder can be made");
    let settings = Settings::default();
    let board: Board = BOARD.parse().expect("a board");
    let parameters: Vec<f64> = RADTAN.parameters.split(',').map(|number| number.parse().expect("a number")).collect();
    let camera = Camera::from_parameters(RADTAN.kind(), &parameters).expect("a lens");
    let simulated = SimulationSettings {
        duration: LONGEST,
        seed,
        scene: SceneSettings::default(),
        sensor: LightPreset::Default.sensor(),
        motion: MotionPreset::Slow.settings(LONGEST),
    };
    let simulation =
        Simulation::new(Rays::new(&camera, DAVIS346_SENSOR), board, simulated).expect("the lens sees the board");

    let recorded = Arc::new(Mutex::new(Vec::<Event>::new()));
    let (of_checkpoint, file) = (Arc::clone(&recorded), folder.path().join("beginning.aedat4"));
    let calibrate = move |seconds: f64, _: &_| {
        write(&file, &of_checkpoint.lock().expect("no thread panics"));
        state(&file, seconds, &board)
    };
    let telling = Telling::AtLength(TOLD_AT_LENGTH);
    let (target, first) = (settings.live.target, settings.live.first_checkpoint());
    let checkpoints = Checkpoints::start(telling, target, first, calibrate).expect("threads");
    let observer = Observer::new(&settings.detection, &settings.initial, &settings.live, &board, DAVIS346_SENSOR);
    let mut observer = observer.with_checkpoints(checkpoints);

    let person = RefCell::new(Person::new(follows, board, seed));
    for _ in 0..AHEAD {
        person.borrow_mut().step(None);
    }
    let (mut now, mut steps, mut seen_steps) = (0.0, 0_u32, 0_u32);
    let mut last: Option<Seen> = None;
    let ended = simulation.run_along(
        |t| person.borrow().pose(t),
        |events| {
            now += SLICE;
            recorded.lock().expect("no thread panics").extend_from_slice(events);
            observer.push(events);
            let mut person = person.borrow_mut();
            // The next slice needs the path a little beyond its end.
            while person.path.len() < ((now + 2.0 * SLICE) / STEP) as usize + AHEAD {
                let seen = observer.seen();
                steps += 1;
                seen_steps += u32::from(seen.board.as_ref().is_some_and(|board| seen.t - board.t < 0.3));
                let is_enough = seen.is_enough();
                last = Some(seen);
                if is_enough {
                    return Err(());
                }
                person.step(observer.wanted_place());
            }
            Ok(())
        },
    );
    let events = recorded.lock().expect("no thread panics");
    let (stated, error) = result(folder.path(), &events);
    let seen = 100.0 * f64::from(seen_steps) / f64::from(steps.max(1));
    let end = match ended {
        Err(()) => format!("{now:.1} s"),
        Ok(_) => "never".to_owned(),
    };
    let share = events.len() as f64 * 1e-6;
    println!("{seed:<5} {end:>11} {seen:>9.0} % {stated:>12.3} {error:>16.3} {share:>6.1} million");
    if let (Ok(_), Some(seen)) = (ended, last) {
        println!("      still wanted: {}", words(&seen.missing(), false).join(", "));
    }
}

/// What a calibration of the first `seconds` states.
fn state(file: &Path, seconds: f64, board: &Board) -> Result<Stated, String> {
    let recording = Recording::new(file, RecordingOptions::default()).map_err(|error| error.to_string())?;
    let task = Task::new(&[], board);
    let calibrated = calibrate_beginning(&recording, seconds, &task, |_| ControlFlow::Continue(()))
        .map_err(|error| error.to_string())?;
    let halves = calibrated.events().and_then(|events| events.trust.split_half.as_ref());
    let projection = &calibrated.trust.projection;
    Ok(Stated {
        rms: projection.rms,
        max: projection.max,
        halves_agree: halves.is_some_and(|halves| halves.consistent()),
    })
}

fn write(file: &Path, events: &[Event]) {
    let format = OutputFormat::from_extension(file).expect("a format that is written");
    let mut writer = EventWriter::create(file, format, DAVIS346_SENSOR, "simulated").expect("a file can be made");
    writer.write(events).expect("it can be written");
    writer.finish().expect("it can be closed");
}

/// What the calibration of the whole recording states (95 %), and its true error: projection, root mean square over the
/// sensor (px).
fn result(folder: &Path, events: &[Event]) -> (f64, f64) {
    let (recording, truth, out) = (folder.join("events.aedat4"), folder.join("truth"), folder.join("calibration"));
    write(&recording, events);
    let lens = ["--model", RADTAN.model, "--parameters", RADTAN.parameters, "--duration", "0.1s"];
    succeed(&[&["simulate", "-o", text(&truth)][..], &lens].concat());
    succeed(&["calibrate", text(&recording), "--board", BOARD, "--accept-any", "-o", text(&out)]);
    let evaluation = json(&["evaluate", text(&out), "--truth", text(&truth.join("truth.json")), "--json"]);
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    let calibration = read_json(&out.join("calibration.json"));
    (number(&calibration["uncertainty"]["projection_rms_95"]), number(&evaluation["projection_difference"]["rms_px"]))
}

//! The whole calibration: stages 1 to 11 in their order.

mod frames;

use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};

use evcal_core::event::Event;
use serde::Serialize;

use crate::board::Board;
use crate::circle_stream::{self, CircleStream};
use crate::circle_track::{self, CircleFrames, CircleTrack, CircleTrackError};
use crate::detection::{DetectionReport, DetectionStage, LARGEST_SENSOR, order_frames};
use crate::event_bias::unknown;
use crate::frames::calibration::NoFrameCalibration;
use crate::frames::joint::{JointPoints, JointReport, NoJointPoints};
use crate::frames::witness::FrameOutcome;
use crate::initial::{InitialError, InitialModel, InitialReport, initial_model};
use crate::model_choice::{CANDIDATES, ModelChoice, ModelRequest, choose_model};
use crate::other_board::OtherBoard;
use crate::reference_frame::ReferenceFrame;
use crate::refinement::{Refined, RefinementError, RefinementInput, RoundReport, StageSettings, refine};
use crate::segment::{SegmentReport, SegmentSettings, segment};
use crate::serial::{SerialAddress, SerialError};
use crate::settings::Settings;
use crate::solve::observation::PointObservation;
use crate::solve::{SolveError, State};
use crate::source::{ReadReport, Recording, RecordingKind, SourceError, SourceOptions, sniff};
use crate::timed_pose::TimedPose;
use crate::trajectory::fit::{TrajectoryShape, fit, resampled};
use crate::trajectory::{Trajectory, TrajectoryError};
use crate::trust::{Trust, examine};
use crate::verdict::{Verdict, verdict};

pub use self::frames::calibrate_from_frames;

/// One input: events or circles.
pub enum Input {
    /// A recording of events.
    Events(Recording),
    /// Reference frames from a circle track or circle stream, times from `start`.
    Circles {
        /// The file or port.
        path: PathBuf,
        /// Sensor size in pixels, if a device told it.
        sensor: Option<(u16, u16)>,
        /// Its frames; their recording number is set by the calibration.
        frames: Vec<ReferenceFrame>,
        /// Time in the file at which the frames' times count from, in seconds.
        start: f64,
        /// What was taken for granted when the file was read.
        notes: Vec<String>,
        /// What the grid finder made of circles without a place on the board.
        detection: DetectionReport,
    },
}

/// What the camera's own frames are for, where the recordings have them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FrameUse {
    /// They are calibrated apart, and compared with the events.
    #[default]
    Witness,
    /// They are compared, then frames and events are solved together.
    Joint,
    /// Nothing.
    Ignore,
}

/// What is calibrated, from what.
pub struct Task<'a> {
    /// Recordings of one camera.
    pub inputs: &'a [Input],
    /// The board in front of it.
    pub board: &'a Board,
    /// The camera model wanted.
    pub model: ModelRequest,
    /// Sensor size where the recordings do not tell it.
    pub sensor: Option<(u16, u16)>,
    /// What frames are for.
    pub frames: FrameUse,
    /// Thresholds.
    pub settings: &'a Settings,
    /// The command line, for the report; may be empty.
    pub command_line: &'a str,
}

/// A calibrated camera and how it came about.
pub struct Calibrated {
    /// Sensor size in pixels.
    pub sensor: (u16, u16),
    /// Camera, event biases and trajectories.
    pub refined: Refined,
    /// The model that the joint solve started from.
    pub initial: InitialModel,
    /// All reference frames found, also those that fell away later.
    pub frames: Vec<ReferenceFrame>,
    /// For each input the time of its first event or circle in the file (s).
    pub starts: Vec<f64>,
    /// What the camera's own frames say of it; `None` where the recordings have none.
    pub witness: Option<FrameOutcome>,
    /// How frames and events were solved together, if they were.
    pub joint: Option<JointReport>,
    /// Stage reports.
    pub reports: StageReports,
    /// How sure the result is, and what speaks for it.
    pub trust: Trust,
    /// Whether it is good.
    pub verdict: Verdict,
}

/// What every stage took in and gave out.
#[derive(Clone, Debug, Serialize)]
pub struct StageReports {
    /// What each recording held.
    pub recordings: Vec<RecordingReport>,
    /// Stages 2 to 5.
    pub detection: DetectionReport,
    /// Stages 6 and 7.
    pub initial: InitialReport,
    /// How the camera model was chosen, where that was left to the program.
    pub model_choice: Option<ModelChoice>,
    /// Stage 8.
    pub segments: SegmentReport,
    /// Segments whose spline could not be fitted.
    pub segments_without_spline: usize,
    /// Stages 10 and 11, one entry a round.
    pub rounds: Vec<RoundReport>,
}

/// What was read of a recording.
#[derive(Clone, Debug, Serialize)]
pub struct RecordingReport {
    /// Events or circles read.
    pub count: u64,
    /// Duration in seconds.
    pub duration: f64,
    /// What was assumed, repaired or lost, in sentences.
    pub notes: Vec<String>,
}

/// Why a calibration failed.
#[derive(Debug, thiserror::Error)]
pub enum CalibrateError {
    /// A recording could not be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The sensor size is not known.
    #[error("{file} does not say how many pixels the sensor has: add --sensor WIDTHxHEIGHT")]
    SensorUnknown {
        /// The file.
        file: String,
    },
    /// The sensor is too large.
    #[error("{file} is of a sensor with {} x {} pixels; up to {} x {} are supported", .sensor.0, .sensor.1, LARGEST_SENSOR.0, LARGEST_SENSOR.1)]
    SensorTooLarge {
        /// The file.
        file: String,
        /// Its size.
        sensor: (u16, u16),
    },
    /// The recordings are of different sensors.
    #[error("{file} is of a sensor with {} x {} pixels, the recordings before it of one with {} x {}: calibrate one camera at a time", .sensor.0, .sensor.1, .before.0, .before.1)]
    SensorsDiffer {
        /// The file.
        file: String,
        /// Its sensor.
        sensor: (u16, u16),
        /// The sensor of the recordings before it.
        before: (u16, u16),
    },
    /// There are no events.
    #[error("{file} holds no events")]
    Empty {
        /// The file.
        file: String,
    },
    /// The board was not found.
    #[error("{0}")]
    NoPattern(String),
    /// No initial model.
    #[error(transparent)]
    Initial(#[from] InitialError),
    /// No segment is long enough.
    #[error(
        "the board was found in {frames} windows, but never often enough in a row for a trajectory ({too_few} groups of fewer than {fewest}): keep the whole board in view and moving"
    )]
    NoSegment {
        /// Reference frames.
        frames: usize,
        /// Groups that were too short.
        too_few: usize,
        /// Frames needed.
        fewest: usize,
    },
    /// No segment has a spline.
    #[error("no trajectory could be fitted: {0}")]
    Trajectory(TrajectoryError),
    /// The joint solve failed.
    #[error(transparent)]
    Solve(SolveError),
    /// There are no frames.
    #[error("{file} holds no frames, and frames were asked for: record with --frames, or leave them out")]
    NoFrames {
        /// The files.
        file: String,
    },
    /// The frames give no calibration.
    #[error("no calibration from the camera's frames: {0}")]
    Frames(NoFrameCalibration),
    /// Frames and events cannot be solved together.
    #[error("frames and events cannot be solved together: {0}")]
    JointFrames(NoJointPoints),
}

impl From<RefinementError<SourceError>> for CalibrateError {
    fn from(error: RefinementError<SourceError>) -> Self {
        match error {
            RefinementError::Read(error) => Self::Source(error),
            RefinementError::Solve(error) => Self::Solve(error),
        }
    }
}

/// Calibrates a camera. `progress` is told what is going on, in words.
///
/// # Errors
/// [`CalibrateError`] says which stage found nothing to go on with, and what to do.
pub fn calibrate(task: &Task, mut progress: impl FnMut(&str)) -> Result<Calibrated, CalibrateError> {
    let settings = task.settings;
    let detected = detect_all(task, &mut progress)?;
    let Detected { sensor, frames, starts, recordings, detection, events, damage } = detected;
    if let (true, Some(damage)) = (frames.is_empty(), damage) {
        return Err(CalibrateError::Source(damage));
    }
    if frames.is_empty() {
        let other = other_board(task, sensor)?.map(|other| format!("; {other}"));
        return Err(CalibrateError::NoPattern(no_pattern(&detection, settings) + &other.unwrap_or_default()));
    }
    progress(&format!("initial model from {} reference frames", frames.len()));
    let (initial, model_choice) = match task.model {
        ModelRequest::Given(model) => (initial_model(&frames, task.board, sensor, model, &settings.initial)?, None),
        ModelRequest::Auto => {
            let (stage, choice) = (&settings.initial, &settings.model_choice);
            let told = |model| progress(&format!("initial model {model} from {} reference frames", frames.len()));
            let (initial, choice) = choose_model(&frames, task.board, sensor, &CANDIDATES, stage, choice, told)?;
            (initial, Some(choice))
        }
    };

    progress("trajectory");
    let times: Vec<(usize, f64)> = initial
        .frames
        .iter()
        .filter_map(|posed| frames.get(posed.frame).map(|frame| (frame.recording, frame.t())))
        .collect();
    let segmentation = SegmentSettings {
        longest_gap: settings.segment.longest_gap.max(settings.segment.longest_gap_ratio * typical_interval(&times)),
        ..settings.segment.clone()
    };
    let (ranges, segments) = segment(&times, settings.spline.degree, &segmentation);
    if ranges.is_empty() {
        let fewest = settings.segment.fewest_frames.max(settings.spline.degree + 1);
        let too_few = segments.too_few_frames + segments.too_short;
        return Err(CalibrateError::NoSegment { frames: segments.frames_in, too_few, fewest });
    }
    let shape = TrajectoryShape {
        degree: settings.spline.degree,
        rotation: settings.spline.rotation,
        knot_spacing: settings.spline.knot_spacing,
    };
    let mut trajectories: Vec<Trajectory> = Vec::new();
    let mut points: Vec<Vec<PointObservation>> = Vec::new();
    let mut failure = None;
    for range in &ranges {
        match fit_segment(&initial, &frames, range.clone(), &shape) {
            Ok((trajectory, observations)) => {
                trajectories.push(trajectory);
                points.push(observations);
            }
            Err(error) => failure = Some(error),
        }
    }
    let segments_without_spline = ranges.len() - trajectories.len();
    if let (true, Some(error)) = (trajectories.is_empty(), failure) {
        return Err(CalibrateError::Trajectory(error));
    }

    let read = |index: usize, visit: &mut dyn FnMut(&[Event])| read_events(task.inputs, index, visit).map(|_| ());
    let input = RefinementInput {
        board: task.board,
        sensor,
        recordings: task.inputs.len(),
        events,
        read: &read,
        points,
        point_sigma: initial.report.rms.max(0.02),
    };
    let stage =
        StageSettings { refinement: &settings.refinement, association: &settings.association, solve: &settings.solve };
    let solved = |input: &RefinementInput<SourceError>, state: State, progress: &mut dyn FnMut(&str)| {
        refine(input, state, stage, |round| progress(&format!("joint solve, round {}", round + 1)))
    };
    let state = State { camera: initial.camera, bias: unknown(settings.refinement.first_sigma), trajectories };
    let mut refined = solved(&input, state, &mut progress)?;

    progress("examination");
    let examined = |refined: &Refined| examine(refined, task.board, settings).map_err(CalibrateError::Solve);
    let mut trust = examined(&refined)?;
    let (mut witness, mut joint) = (None, None);
    if task.frames != FrameUse::Ignore {
        let seen = frames::see_frames(task, Some(&starts), &mut progress)?;
        let from_frames = frames::frame_calibration(task, seen, sensor, initial.camera.kind(), &mut progress);
        witness = from_frames
            .as_ref()
            .map(|calibration| frames::outcome(task, &refined.state.camera, &trust.uncertainty, sensor, calibration));
        if task.frames == FrameUse::Joint {
            let JointPoints { points, report } =
                frames::observations(task, &refined, &trust.uncertainty, from_frames.as_ref())?;
            let input = RefinementInput { points, point_sigma: report.sigma, ..input };
            refined = solved(&input, refined.state, &mut progress)?;
            trust = examined(&refined)?;
            joint = Some(report);
        }
    }
    let reports = StageReports {
        recordings,
        detection,
        initial: initial.report.clone(),
        model_choice,
        segments,
        segments_without_spline,
        rounds: refined.rounds.clone(),
    };
    let findings = witness.as_ref().and_then(FrameOutcome::finding).into_iter().collect();
    let verdict = verdict(&refined.state.camera, &trust, task.board, sensor, findings, &settings.verdict);
    Ok(Calibrated { sensor, refined, initial, frames, starts, witness, joint, reports, trust, verdict })
}

/// Median time between neighbouring frames of a recording (s), 0 without any.
fn typical_interval(times: &[(usize, f64)]) -> f64 {
    let pairs = times.iter().zip(times.iter().skip(1));
    let mut intervals: Vec<f64> = pairs.filter(|(a, b)| a.0 == b.0).map(|(a, b)| b.1 - a.1).collect();
    let middle = intervals.len() / 2;
    if intervals.is_empty() {
        return 0.0;
    }
    *intervals.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The spline of one segment, and its circle centres where there are no events.
fn fit_segment(
    initial: &InitialModel,
    frames: &[ReferenceFrame],
    range: std::ops::Range<usize>,
    shape: &TrajectoryShape,
) -> Result<(Trajectory, Vec<PointObservation>), TrajectoryError> {
    let posed = initial.frames.get(range).unwrap_or_default();
    let in_frames = |index: usize| frames.get(index);
    let poses: Vec<TimedPose> = posed
        .iter()
        .filter_map(|posed| in_frames(posed.frame).map(|frame| TimedPose { t: frame.t(), pose: posed.pose }))
        .collect();
    let spans: Vec<(f64, f64)> =
        posed.iter().filter_map(|posed| in_frames(posed.frame)).map(|frame| (frame.start, frame.end)).collect();
    let from_circles = posed.iter().filter_map(|posed| in_frames(posed.frame)).all(|frame| frame.pixels.is_empty());
    let mut points: Vec<PointObservation> = Vec::new();
    if from_circles {
        points.extend(posed.iter().flat_map(|posed| &posed.circles).map(|circle| PointObservation {
            t: circle.t,
            pixel: circle.center,
            circle: circle.index,
        }));
        points.sort_by(|a, b| a.t.total_cmp(&b.t).then(a.circle.cmp(&b.circle)));
    }
    let first = points.first().map_or(f64::INFINITY, |point| point.t);
    let last = points.last().map_or(f64::NEG_INFINITY, |point| point.t);
    let start = spans.iter().fold(first, |start, span| start.min(span.0));
    let end = spans.iter().fold(last, |end, span| end.max(span.1));
    let recording = posed.first().and_then(|posed| in_frames(posed.frame)).map_or(0, |frame| frame.recording);
    let trajectory = fit(recording, &poses, start, end, shape)?;
    Ok((if from_circles { trajectory } else { resampled(&trajectory, shape)? }, points))
}

struct Detected {
    sensor: (u16, u16),
    frames: Vec<ReferenceFrame>,
    starts: Vec<f64>,
    recordings: Vec<RecordingReport>,
    detection: DetectionReport,
    events: u64,
    /// What the first damaged recording broke off with.
    damage: Option<SourceError>,
}

fn detect_all(task: &Task, progress: &mut impl FnMut(&str)) -> Result<Detected, CalibrateError> {
    let mut all = Detected {
        sensor: (0, 0),
        frames: Vec::new(),
        starts: Vec::new(),
        recordings: Vec::new(),
        detection: DetectionReport::default(),
        events: 0,
        damage: None,
    };
    for (index, input) in task.inputs.iter().enumerate() {
        let sensor = sensor_of(input, task.sensor)?;
        if index > 0 && sensor != all.sensor {
            let file = file_of(input);
            return Err(CalibrateError::SensorsDiffer { file, sensor, before: all.sensor });
        }
        all.sensor = sensor;
        progress(&format!("looking for the board in {}", file_of(input)));
        match input {
            Input::Events(_) => {
                let mut stage = DetectionStage::for_board(&task.settings.detection, sensor, task.board.pattern, index);
                let pass = read_events(task.inputs, index, &mut |events| stage.push(events))?;
                if pass.count == 0 {
                    return Err(CalibrateError::Empty { file: file_of(input) });
                }
                let (frames, report) = stage.into_frames();
                all.frames.extend(frames);
                all.detection.add(&report);
                all.events += pass.count;
                all.starts.push(pass.first as f64 * 1e-6);
                all.recordings.push(pass.to_report());
                all.damage = all.damage.or(pass.damage);
            }
            Input::Circles { frames, start, notes, detection, .. } => {
                all.detection.add(detection);
                let count = frames.iter().map(|frame| frame.circles.len() as u64).sum();
                let duration = frames.last().map_or(0.0, |last| last.end) - frames.first().map_or(0.0, |f| f.start);
                all.frames.extend(frames.iter().cloned().map(|frame| ReferenceFrame { recording: index, ..frame }));
                all.starts.push(*start);
                all.recordings.push(RecordingReport { count, duration, notes: notes.clone() });
            }
        }
    }
    Ok(all)
}

/// The file or port of an input.
pub fn file_of(input: &Input) -> String {
    match input {
        Input::Events(recording) => recording.path().display().to_string(),
        Input::Circles { path, .. } => path.display().to_string(),
    }
}

fn sensor_of(input: &Input, given: Option<(u16, u16)>) -> Result<(u16, u16), CalibrateError> {
    let sensor = match input {
        Input::Events(recording) => recording.open()?.information().sensor.or(given),
        Input::Circles { sensor, .. } => given.or(*sensor),
    };
    let sensor = sensor.ok_or_else(|| CalibrateError::SensorUnknown { file: file_of(input) })?;
    if sensor.0 > LARGEST_SENSOR.0 || sensor.1 > LARGEST_SENSOR.1 {
        return Err(CalibrateError::SensorTooLarge { file: file_of(input), sensor });
    }
    Ok(sensor)
}

/// What one pass through a recording met.
pub struct Pass {
    /// Events handed out.
    pub count: u64,
    /// Time of the first event in the file (µs).
    pub first: i64,
    /// Time of the last event in the file (µs).
    pub last: i64,
    /// What the reader assumed.
    pub assumptions: Vec<String>,
    /// What the reader met.
    pub report: ReadReport,
    /// What ended the pass before the end of the recording.
    pub damage: Option<SourceError>,
}

impl Pass {
    /// The pass as a report.
    pub fn to_report(&self) -> RecordingReport {
        let mut notes = self.assumptions.clone();
        let report = &self.report;
        if let Some(truncation) = &report.truncated {
            notes.push(truncation.to_string());
        }
        let mut note = |count: u64, what: &str| {
            if count > 0 {
                notes.push(format!("{count} {what}"));
            }
        };
        note(report.out_of_range, "events outside the sensor dropped");
        note(report.steps_back, "steps back in time put in order");
        note(report.clock_resets, "clock resets bridged");
        note(report.damaged_packets, "damaged packets left out");
        notes.extend(report.stream.notes());
        if let Some(error) = &self.damage {
            notes.push(format!("read up to its damage only: {error}"));
        }
        RecordingReport { count: self.count, duration: (self.last - self.first) as f64 * 1e-6, notes }
    }
}

/// Hands all events of an input to `visit`, with times from its first event; nothing for circles.
///
/// # Errors
/// [`SourceError`] when the recording cannot be read.
pub fn read_events(inputs: &[Input], index: usize, visit: &mut dyn FnMut(&[Event])) -> Result<Pass, SourceError> {
    let Some(Input::Events(recording)) = inputs.get(index) else {
        let report = ReadReport::default();
        return Ok(Pass { count: 0, first: 0, last: 0, assumptions: Vec::new(), report, damage: None });
    };
    read_recording(recording, visit)
}

/// Batches that are read while earlier ones are worked on.
const READ_AHEAD: usize = 4;

/// Hands all events of a recording to `visit`, with times from its first event; of a damaged recording
/// those before the damage. A thread of its own reads ahead.
///
/// # Errors
/// [`SourceError`] when not one event can be read.
pub fn read_recording(recording: &Recording, visit: &mut dyn FnMut(&[Event])) -> Result<Pass, SourceError> {
    std::thread::scope(|scope| {
        let (sender, batches) = sync_channel(READ_AHEAD);
        let reader = scope.spawn(move || read_ahead(recording, &sender));
        for events in batches {
            visit(&events);
        }
        reader.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })
}

fn read_ahead(recording: &Recording, sender: &SyncSender<Vec<Event>>) -> Result<Pass, SourceError> {
    let mut reader = recording.open()?;
    let (mut count, mut first, mut last) = (0, None, 0);
    let damage = loop {
        let mut events = Vec::new();
        match reader.next_batch(&mut events) {
            Ok(true) => {}
            Ok(false) => break None,
            // What was read before the damage counts.
            Err(error) if count > 0 => break Some(error),
            Err(error) => return Err(error),
        }
        let start = *first.get_or_insert_with(|| events.first().map_or(0, |event| event.t));
        last = events.last().map_or(last, |event| event.t);
        count += events.len() as u64;
        for event in &mut events {
            event.t -= start;
        }
        if sender.send(events).is_err() {
            // Nobody listens any more.
            break None;
        }
    };
    let assumptions = reader.information().notes.clone();
    Ok(Pass { count, first: first.unwrap_or(0), last, assumptions, report: reader.report().clone(), damage })
}

/// What the board in the recordings looks like, if not like the stated one.
fn other_board(task: &Task, sensor: (u16, u16)) -> Result<Option<String>, SourceError> {
    for (index, input) in task.inputs.iter().enumerate() {
        if let Input::Events(_) = input {
            let mut other = OtherBoard::new(&task.settings.detection, task.board, sensor);
            read_events(task.inputs, index, &mut |events| other.push(events))?;
            if let Some(found) = other.finish() {
                return Ok(Some(found));
            }
        }
    }
    Ok(None)
}

/// Why no window held the board, and what to do about it.
fn no_pattern(report: &DetectionReport, settings: &Settings) -> String {
    let total = report.windows + report.too_few_events;
    let mut text = format!("no pattern found in {total} windows");
    let mut reasons: Vec<(&str, u64)> = report.grids_refused.iter().map(|(reason, count)| (*reason, *count)).collect();
    reasons.push(("too few events", report.too_few_events));
    reasons.sort_by(|a, b| b.1.cmp(&a.1).then(a.0.cmp(b.0)));
    let Some(&(reason, count)) = reasons.first().filter(|reason| reason.1 > 0) else { return text };
    let advice = match reason {
        "too few events" => {
            format!(
                "move faster or raise detection.window.max_interval (now {})",
                settings.detection.window.max_interval
            )
        }
        "too few circles" => {
            "is the board in view, moving and in focus? Try --extraction soft, or move faster".to_owned()
        }
        "circles beside the board" | "too few circles of a board" | "place on the board not certain" => {
            "is --board right: rows and columns, acircles or circles?".to_owned()
        }
        _ => "is the board in view and flat, and is --board right?".to_owned(),
    };
    text += &format!(": {count} had {reason}: {advice}");
    text
}

impl Input {
    /// Opens a recording, a circle track or a circle stream, whichever `path` is. Circles without a place on
    /// the board are ordered by the grid finder.
    ///
    /// # Errors
    /// [`InputError`] when it is neither, or cannot be read.
    pub fn open(path: &Path, options: &SourceOptions, board: &Board) -> Result<Self, InputError> {
        match sniff(path)? {
            RecordingKind::Events { .. } => Ok(Self::Events(Recording::new(path, options.clone())?)),
            RecordingKind::CircleTrack => {
                let track = circle_track::read(path, &board.pattern, 0)?;
                Ok(Self::from_track(path, track, None, board))
            }
            RecordingKind::CircleStream => Ok(Self::from_stream(path, circle_stream::read(path)?, board)),
        }
    }

    /// Listens to a serial port; `progress` is told what came so far.
    ///
    /// # Errors
    /// [`SerialError`] when no circle comes.
    pub fn listen(address: &SerialAddress, board: &Board, progress: impl FnMut(&str)) -> Result<Self, SerialError> {
        let stream = address.receive(progress)?;
        Ok(Self::from_stream(Path::new(&address.to_string()), stream, board))
    }

    fn from_stream(path: &Path, stream: CircleStream, board: &Board) -> Self {
        Self::from_track(path, stream.track, stream.sensor, board)
    }

    fn from_track(path: &Path, track: CircleTrack, sensor: Option<(u16, u16)>, board: &Board) -> Self {
        let (frames, detection) = match track.frames {
            CircleFrames::Ordered(frames) => (frames, DetectionReport::default()),
            CircleFrames::Unordered(frames) => order_frames(&frames, &board.pattern, sensor),
        };
        let start = track.time_origin_us as f64 * 1e-6;
        Self::Circles { path: path.to_owned(), sensor, frames, start, notes: track.notes, detection }
    }
}

/// Why an input could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// It is no recording that can be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// It is a circle track with a mistake in it, or a circle stream without circles.
    #[error(transparent)]
    Circles(#[from] CircleTrackError),
}

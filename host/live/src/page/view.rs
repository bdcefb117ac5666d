//! The state in the form that the page receives.

use std::time::{SystemTime, UNIX_EPOCH};

use nalgebra::Vector2;
use serde::Serialize;

use crate::checkpoint::{CalibrationStep, Checkpoint};
use crate::guidance::{Hint, Swing};
use crate::health;
use crate::picture::EventPicture;
use crate::wanted::words;
use crate::{DISTANCES, Seen, Tilt};
use event_recordings::pictures::GreyImage;

/// Phase of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// The board was not seen yet.
    Waiting,
    /// The board is being observed.
    Recording,
    /// The recording has ended, and the camera is being calibrated.
    Calibrating,
    /// There is a result.
    Done,
    /// The calibration failed.
    Failed,
}

/// The result of a calibration.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcome {
    /// Verdict in words, or the reason of a failure.
    pub verdict: String,
    /// Camera model.
    pub model: String,
    /// Camera matrix, row by row.
    pub matrix: [[f64; 3]; 3],
    /// Distortion coefficients.
    pub distortion: Vec<f64>,
    /// Reported error of the projection, root mean square over the sensor (px).
    pub sigma: Option<f64>,
    /// `true` if that error is below the target, the calibration is good enough, and the board was seen in the whole
    /// image and tilted to all sides.
    pub is_target_met: bool,
    /// Folder of the results.
    pub folder: String,
    /// Path of the report on this server.
    pub report: Option<String>,
    /// The files of the results.
    pub files: Vec<FileLink>,
    /// `true` if another recording can be made.
    pub can_record: bool,
}

/// A result file.
#[derive(Clone, Debug, Serialize)]
pub struct FileLink {
    /// Its name in the folder of the results.
    pub name: String,
    /// Its path on this server.
    pub path: String,
}

/// Data that were not processed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Events that the camera dropped; `None` for a recording.
    pub dropped: Option<u64>,
    /// Transfers that the detector skipped.
    pub not_searched: u64,
    /// Transfers that the picture skipped.
    pub not_drawn: u64,
}

/// Additional content of a state.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Context {
    /// Data that were not processed.
    pub losses: Losses,
    /// `true` if the page is mirrored at first.
    pub mirrored: bool,
    /// `true` if there may be frames.
    pub has_frames: bool,
    /// `true` if frames are shown.
    pub shows_frames: bool,
    /// Number of earlier recordings that are calibrated together with this one.
    pub before: usize,
}

/// Texts for a view as seen by the camera, and for a mirrored view.
#[derive(Serialize)]
struct Words<T> {
    plain: T,
    mirrored: T,
}

#[derive(Serialize)]
struct Outline {
    t: f64,
    corners: Vec<[f64; 2]>,
    velocity: Vec<[f64; 2]>,
    circles: Vec<[f64; 3]>,
}

#[derive(Serialize)]
struct Ghost {
    outline: Vec<[f64; 2]>,
    corners: Vec<[f64; 2]>,
    gained: f64,
    /// Distance of the board from it, in units of the tolerance.
    distance: Option<f64>,
    /// `true` if the board swings about a vertical axis.
    sideways: bool,
}

#[derive(Serialize)]
struct Named {
    name: &'static str,
    /// The name in a mirrored view.
    mirrored: &'static str,
    count: u64,
}

#[derive(Serialize)]
struct Coverage<'a> {
    columns: u16,
    rows: u16,
    cells: &'a [f64],
    /// Error of the projection in each cell (px); may be empty.
    sigma: Vec<Option<f64>>,
    covered: f64,
    boards: u64,
    tilts: Vec<Named>,
    distances: Vec<Named>,
}

#[derive(Serialize)]
struct Health {
    /// Events per second.
    rate: f64,
    /// Rate in the busiest hundredth of a second as a fraction of the camera's limit.
    load: Option<f64>,
    /// Fraction of ON events; `None` without events.
    on_share: Option<f64>,
    /// Events per second of a pixel at rest.
    noise: Option<f64>,
    hot_pixels: Option<usize>,
    /// Frequency (Hz), 0 for no flicker; `None` until it is known.
    flicker: Option<f64>,
    /// Width of the circles' edges, and the smallest width of the last seconds (px).
    focus: Option<[f64; 2]>,
    dropped: Option<u64>,
    not_searched: u64,
    not_drawn: u64,
}

impl Health {
    fn new(health: &health::Health, losses: Losses) -> Self {
        Self {
            rate: health.rates.map_or(0.0, |rates| rates.mean),
            load: health.rates.and_then(|rates| rates.load),
            on_share: health.rates.map(|rates| rates.on_share),
            noise: health.noise,
            hot_pixels: health.hot_pixels,
            flicker: health.flicker.map(|flicker| flicker.map_or(0.0, |flicker| flicker.frequency)),
            focus: health.focus.map(|focus| [focus.width, focus.sharpest]),
            dropped: losses.dropped,
            not_searched: losses.not_searched,
            not_drawn: losses.not_drawn,
        }
    }
}

/// Explanation why the board is not found.
#[derive(Serialize)]
struct Nothing {
    reason: String,
    /// The circles in the window with the most circles, as centre and radius (px).
    circles: Vec<[f64; 3]>,
}

#[derive(Serialize)]
struct CheckpointView<'a> {
    t: f64,
    stated: Option<f64>,
    largest: Option<f64>,
    halves_agree: Option<bool>,
    failed: Option<&'a str>,
}

impl<'a> CheckpointView<'a> {
    fn new(checkpoint: &'a Checkpoint) -> Self {
        let accuracy = checkpoint.accuracy.as_ref().ok();
        Self {
            t: checkpoint.t,
            stated: accuracy.map(|accuracy| accuracy.rms),
            largest: accuracy.map(|accuracy| accuracy.max),
            halves_agree: accuracy.map(|accuracy| accuracy.halves_agree),
            failed: checkpoint.accuracy.as_ref().err().map(String::as_str),
        }
    }
}

/// A step of a calibration.
#[derive(Serialize)]
struct StepView {
    text: String,
    /// Finished share of the step, 0 to 1.
    done: Option<f64>,
}

impl From<CalibrationStep> for StepView {
    fn from(step: CalibrationStep) -> Self {
        Self { text: step.text, done: step.done }
    }
}

/// A complete state.
#[derive(Serialize)]
pub struct View<'a> {
    phase: Phase,
    /// Time at which the state was created (ms since 1970 by the computer's clock).
    made: u64,
    /// Sensor time of the picture (s since the first event).
    t: f64,
    sensor: [u16; 2],
    hint: Words<&'static str>,
    /// `true` if the board is at its target and should be swung there.
    is_there: bool,
    /// Progress, 0 to 1.
    progress: f64,
    missing: Words<Vec<String>>,
    /// `true` if the page is mirrored at first.
    mirrored: bool,
    /// `true` if there may be frames.
    has_frames: bool,
    /// `true` if frames are shown.
    shows_frames: bool,
    /// Size of the frame whose pixels follow the picture of the events.
    frame: Option<[usize; 2]>,
    /// Number of earlier recordings that are calibrated together with this one.
    before: usize,
    /// Number of target poses at which the board stayed long enough.
    used_up: u64,
    board: Option<Outline>,
    ghost: Option<Ghost>,
    coverage: Coverage<'a>,
    health: Health,
    nothing: Option<Nothing>,
    /// Expected error by the quick estimate (px).
    sigma: Option<f64>,
    /// Expected error of a calibration now (px).
    about: Option<f64>,
    /// The latest checkpoint.
    checkpoint: Option<CheckpointView<'a>>,
    /// Length of the part that is being calibrated, from the first event (s).
    checkpoint_under_way: Option<f64>,
    /// Current step of a calibration that the page waits for; meanwhile there are no instructions.
    step: Option<StepView>,
    /// Target of the error (px).
    target: f64,
    /// Focal lengths and principal point of the provisional camera (px).
    camera: Option<[f64; 4]>,
    outcome: Option<&'a Outcome>,
}

fn pairs(points: &[Vector2<f64>]) -> Vec<[f64; 2]> {
    // A tenth of a pixel is sufficient for display.
    points.iter().map(|point| [rounded(point.x), rounded(point.y)]).collect()
}

fn circles(found: impl Iterator<Item = (Vector2<f64>, Option<f64>)>) -> Vec<[f64; 3]> {
    found.map(|(center, radius)| [rounded(center.x), rounded(center.y), rounded(radius.unwrap_or(3.0))]).collect()
}

fn rounded(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

/// Returns the state while the board is observed, with a frame if there is one.
pub fn observing<'a>(picture: &EventPicture, frame: Option<&GreyImage>, seen: &'a Seen, context: Context) -> View<'a> {
    let phase = if seen.board.is_none() { Phase::Waiting } else { Phase::Recording };
    let sensor = picture.sensor();
    let frame = frame.map(|frame| [frame.width(), frame.height()]);
    View { frame, ..state(phase, picture.seconds(), [sensor.width, sensor.height], seen, context, None) }
}

/// Returns the state while the camera is calibrated after the recording.
pub fn calibrating(sensor: [u16; 2], seen: &Seen, context: Context, step: CalibrationStep) -> View<'_> {
    View { step: Some(step.into()), ..state(Phase::Calibrating, seen.t, sensor, seen, context, None) }
}

/// Returns the state after the recording.
pub fn ended<'a>(
    phase: Phase,
    sensor: [u16; 2],
    seen: &'a Seen,
    context: Context,
    outcome: Option<&'a Outcome>,
) -> View<'a> {
    state(phase, seen.t, sensor, seen, context, outcome)
}

fn state<'a>(
    phase: Phase,
    t: f64,
    sensor: [u16; 2],
    seen: &'a Seen,
    context: Context,
    outcome: Option<&'a Outcome>,
) -> View<'a> {
    let coverage = &seen.coverage;
    let tilts = Tilt::ALL.iter().zip(coverage.tilts).map(|(tilt, count)| Named {
        name: tilt.name(),
        mirrored: tilt.seen(true).name(),
        count,
    });
    let distances = DISTANCES.iter().zip(coverage.distances).map(|(name, count)| Named { name, mirrored: name, count });
    let missing = seen.missing();
    let made = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64);
    View {
        phase,
        made,
        t,
        sensor,
        hint: Words { plain: seen.hint.words(false), mirrored: seen.hint.words(true) },
        is_there: matches!(seen.hint, Hint::Stay | Hint::Swing(_)),
        progress: seen.progress(),
        missing: Words { plain: words(&missing, false), mirrored: words(&missing, true) },
        mirrored: context.mirrored,
        has_frames: context.has_frames,
        shows_frames: context.shows_frames,
        frame: None,
        before: context.before,
        used_up: seen.used_up,
        board: seen.board.as_ref().map(|board| Outline {
            t: board.t,
            corners: pairs(&board.corners),
            velocity: pairs(&board.velocity),
            circles: circles(board.circles.iter().copied()),
        }),
        ghost: seen.ghost.as_ref().map(|ghost| Ghost {
            outline: pairs(&ghost.outline),
            corners: pairs(&ghost.corners),
            gained: ghost.gained,
            distance: ghost.distance.map(|distance| (distance * 100.0).round() / 100.0),
            sideways: ghost.swing == Swing::Sideways,
        }),
        coverage: Coverage {
            columns: coverage.size.0,
            rows: coverage.size.1,
            cells: &coverage.cells,
            sigma: seen.sigma_in_cells.iter().map(|sigma| sigma.map(|sigma| (sigma * 1e4).round() / 1e4)).collect(),
            covered: coverage.covered,
            boards: coverage.boards,
            tilts: tilts.collect(),
            distances: distances.collect(),
        },
        health: Health::new(&seen.health, context.losses),
        nothing: seen.explanation.as_ref().map(|explanation| Nothing {
            reason: explanation.obstacle.to_string(),
            circles: circles(explanation.circles.iter().map(|(center, radius)| (*center, Some(*radius)))),
        }),
        sigma: seen.sigma,
        about: seen.about,
        checkpoint: seen.checkpoint.as_ref().map(CheckpointView::new),
        checkpoint_under_way: seen.calibrating_until,
        step: seen.running_calibration.as_ref().and_then(|running| running.awaited()).map(StepView::from),
        target: seen.target,
        camera: seen.camera,
        outcome,
    }
}

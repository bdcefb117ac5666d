//! Converts events to the current state of the board and the camera.

use std::collections::VecDeque;
use std::sync::Arc;

use evcal_core::event::Event;
use evcal_core::sensor::Sensor;
use nalgebra::Vector2;

use super::checkpoint::{Checkpoint, Checkpoints, RunningCalibration};
use super::guidance::{BoardPose, GhostOutline, Guidance, Hint, corners};
use super::health::{Health, HealthMonitor};
use super::obstacle::{Explainer, Explanation};
use super::wanted::Requirement;
use super::{CoverageSummary, LiveCoverage};
use evcal_calibrate::settings::LiveSettings;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::detection::board_stage::BoardStage;
use evcal_detection::detection::settings::DetectionSettings;
use evcal_geometry::board::Board;
use evcal_geometry::board::homography::homography;
use evcal_solve::initial::InitialSettings;

/// Interval between summaries of the coverage (s of the sensor's clock); each summary processes all views.
const SUMMARY: f64 = 0.5;
/// Time over which the board's motion is assumed linear (s): long enough to average the noise of its outline.
const STRAIGHT: f64 = 0.1;

/// Largest progress that is reported before enough was seen.
const ALMOST: f64 = 0.99;

/// The board in the image, and its motion.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardOutline {
    /// Sensor time (s since the first event).
    pub t: f64,
    /// Corners (px), clockwise on the print, starting next to the first circle.
    pub corners: [Vector2<f64>; 4],
    /// Velocity of each corner (px/s).
    pub velocity: [Vector2<f64>; 4],
    /// The circles found: centre and, if known, radius (px).
    pub circles: Vec<(Vector2<f64>, Option<f64>)>,
}

/// State of a live session.
#[derive(Clone, Debug)]
pub struct Seen {
    /// Sensor time of the latest event (s since the first).
    pub t: f64,
    /// Boards, coverage and tilts.
    pub coverage: CoverageSummary,
    /// Last position of the board.
    pub board: Option<BoardOutline>,
    /// Target pose of the board.
    pub ghost: Option<GhostOutline>,
    /// Number of target poses at which the board stayed long enough.
    pub used_up: u64,
    /// Current hint.
    pub hint: Hint,
    /// Expected error of the camera by the quick estimate from windows alone (px, root mean square over the sensor);
    /// `None` before there is a camera. The error of the calibration itself is several times smaller.
    pub sigma: Option<f64>,
    /// The latest calibration of the recording so far.
    pub checkpoint: Option<Checkpoint>,
    /// Time up to which the recording is being calibrated (s since the first event).
    pub calibrating_until: Option<f64>,
    /// Steps of that calibration, current whenever they are read.
    pub running_calibration: Option<Arc<RunningCalibration>>,
    /// Expected error of a calibration now (px, root mean square over the sensor), estimated from the latest checkpoint
    /// and the windows since then.
    pub about: Option<f64>,
    /// Largest acceptable error (px).
    pub target: f64,
    /// Time since the board was first seen (s).
    pub watched: f64,
    /// Shortest time for which the board must be seen (s).
    pub shortest: f64,
    /// The error in each cell of the coverage (px, root mean square), row by row: the expected error of a calibration
    /// now, or the quick estimate before the first checkpoint. Empty before there is a camera; `None` for cells that
    /// its lens does not see.
    pub sigma_in_cells: Vec<Option<f64>>,
    /// The provisional camera's focal lengths and principal point (px).
    pub camera: Option<[f64; 4]>,
    /// State of the camera.
    pub health: Health,
    /// Reason why the board is not found, while it is not.
    pub explanation: Option<Explanation>,
    /// Number of transfers skipped because the detector was busy.
    pub left_out: u64,
}

impl Seen {
    /// Returns `true` if enough was seen for a calibration, so that no requirement remains.
    pub fn is_enough(&self) -> bool {
        self.missing().is_empty()
    }

    /// Returns the remaining requirements; empty if enough was seen.
    pub fn missing(&self) -> Vec<Requirement> {
        let mut missing = self.coverage.missing.clone();
        if self.watched < self.shortest {
            missing.push(Requirement::Time(self.shortest - self.watched));
        }
        match &self.checkpoint {
            Some(checkpoint) => missing.extend(checkpoint.missing(self.target).map(Requirement::Checkpoint)),
            None if self.sigma.is_none() => missing.push(Requirement::OtherTilts),
            None => missing.push(Requirement::FirstCheckpoint),
        }
        missing
    }

    /// Returns the progress, 0 to 1: the mean over all criteria, so that every improvement is visible. It is 1 only if
    /// [`Seen::is_enough`].
    pub fn progress(&self) -> f64 {
        if self.is_enough() {
            return 1.0;
        }
        let of_time = if self.shortest > 0.0 { (self.watched / self.shortest).min(1.0) } else { 1.0 };
        // The error decreases with the square root of time.
        let of_error = self.about.map_or(0.0, |about| (self.target / about).powi(2).min(1.0));
        let [of_boards, of_sensor, of_tilts] = self.coverage.fulfilled;
        let shares = [of_boards, of_sensor, of_tilts, of_time, of_error];
        (shares.iter().sum::<f64>() / shares.len() as f64).min(ALMOST)
    }
}

/// Knowledge from earlier recordings.
pub struct Memory {
    coverage: LiveCoverage,
    guidance: Option<Guidance>,
}

/// Searches for the board in events as they arrive.
pub struct Observer<'a> {
    detection: &'a DetectionSettings,
    sensor: Sensor,
    stage: BoardStage<'a>,
    health: HealthMonitor,
    explainer: Explainer,
    coverage: LiveCoverage,
    /// The latest summary, and its time.
    summary: (CoverageSummary, f64),
    /// The error in each cell of the summary, by the quick estimate.
    sigma_in_cells: Vec<Option<f64>>,
    guidance: Option<Guidance>,
    checkpoints: Option<Checkpoints>,
    board: Board,
    target: f64,
    shortest: f64,
    /// Time at which the board was first seen (s).
    first_seen: Option<f64>,
    latest: f64,
    outline: Option<BoardOutline>,
    /// Positions of its corners in the last [`STRAIGHT`] seconds.
    path: VecDeque<(f64, [Vector2<f64>; 4])>,
}

impl<'a> Observer<'a> {
    /// Creates an observer for this sensor. Without [`Observer::with_checkpoints`] it never sees enough.
    pub fn new(
        detection: &'a DetectionSettings,
        initial: &InitialSettings,
        live: &LiveSettings,
        board: &Board,
        sensor: Sensor,
    ) -> Self {
        let coverage = LiveCoverage::new(live, board, sensor);
        Self {
            detection,
            sensor,
            health: HealthMonitor::new(sensor),
            explainer: Explainer::default(),
            summary: (coverage.summary(), 0.0),
            sigma_in_cells: Vec::new(),
            stage: BoardStage::live(board, detection, sensor),
            coverage,
            guidance: Guidance::new(board, sensor, initial),
            checkpoints: None,
            board: *board,
            target: live.target,
            shortest: live.shortest,
            first_seen: None,
            latest: 0.0,
            outline: None,
            path: VecDeque::new(),
        }
    }

    /// Adds checkpoints, which determine when enough was recorded.
    pub fn with_checkpoints(self, checkpoints: Checkpoints) -> Self {
        Self { checkpoints: Some(checkpoints), ..self }
    }

    /// Adds the next events, with times from the first (µs) that never decrease. Returns `true` if the state changed.
    pub fn push(&mut self, events: &[Event]) -> bool {
        if let Some(event) = events.last() {
            self.latest = event.t as f64 * 1e-6;
        }
        self.health.push(events);
        self.explainer.push(events, &self.board, self.sensor, self.detection);
        self.stage.push(events);
        let is_due = self.stage.is_due();
        if is_due {
            self.search();
        }
        is_due
    }

    fn search(&mut self) {
        for frame in self.stage.take_frames() {
            self.first_seen.get_or_insert(frame.start);
            self.health.see(&frame);
            self.explainer.found(frame.t());
            self.coverage.add(&frame);
            self.outline = self.outline_of(&frame);
            if let Some(guidance) = &mut self.guidance {
                guidance.add(&frame);
                guidance.advise(frame.t());
                if let Some(focal_length) = guidance.camera().and_then(|camera| camera.parameters().first().copied()) {
                    self.coverage.set_focal_length(focal_length);
                }
            }
        }
        if let Some(guidance) = &mut self.guidance {
            guidance.advise(self.latest);
        }
        if self.latest - self.summary.1 >= SUMMARY {
            self.summarise();
        }
        self.check();
    }

    /// Updates the checkpoints, also while no events arrive. Returns `true` if a result was reported.
    pub fn check(&mut self) -> bool {
        let reported =
            self.checkpoints.as_mut().and_then(|checkpoints| checkpoints.advance(self.latest, self.first_seen));
        let reported = reported.map(|checkpoint| checkpoint.t);
        if let (Some(t), Some(guidance)) = (reported, &mut self.guidance) {
            guidance.mark(t);
        }
        reported.is_some()
    }

    /// Records that no event arrived for `seconds`, because the sensor's clock does not advance without events.
    pub fn silence(&mut self, seconds: f64) {
        self.explainer.silence();
        if let Some(guidance) = &mut self.guidance {
            guidance.advise(self.latest + seconds);
        }
    }

    /// Processes all waiting events, and updates the summary.
    pub fn finish(&mut self) {
        self.search();
        self.summarise();
    }

    fn summarise(&mut self) {
        self.summary = (self.coverage.summary(), self.latest);
        let size = self.summary.0.size;
        self.sigma_in_cells =
            self.guidance.as_ref().and_then(|guidance| guidance.sigma_in_cells(size.0, size.1)).unwrap_or_default();
    }

    /// Returns the knowledge for another recording of the same camera that is calibrated together with this one.
    pub fn into_memory(self) -> Memory {
        Memory { coverage: self.coverage, guidance: self.guidance }
    }

    /// Adds the knowledge from earlier recordings.
    pub fn with_memory(mut self, memory: Memory) -> Self {
        self.coverage = memory.coverage;
        self.guidance = memory.guidance;
        if let Some(guidance) = &mut self.guidance {
            guidance.begin_again();
        }
        self.summarise();
        self
    }

    /// Returns the current state.
    pub fn seen(&self) -> Seen {
        let guidance = self.guidance.as_ref();
        let (sigma, about) = (guidance.and_then(Guidance::sigma), self.about());
        let scale = about.zip(sigma).map_or(1.0, |(about, sigma)| about / sigma);
        let mut seen = Seen {
            t: self.latest,
            coverage: self.summary.0.clone(),
            board: self.outline.clone(),
            ghost: guidance.and_then(Guidance::ghost),
            used_up: guidance.map_or(0, Guidance::used_up),
            hint: guidance.map_or(Hint::Show, Guidance::hint),
            sigma,
            about,
            sigma_in_cells: self.sigma_in_cells.iter().map(|sigma| Some(scale * (*sigma)?)).collect(),
            checkpoint: self.checkpoints.as_ref().and_then(Checkpoints::latest).cloned(),
            calibrating_until: self.checkpoints.as_ref().and_then(Checkpoints::running_length),
            running_calibration: self.checkpoints.as_ref().map(Checkpoints::running),
            target: self.target,
            watched: self.first_seen.map_or(0.0, |first| self.latest - first),
            shortest: self.shortest,
            camera: guidance.and_then(Guidance::camera).and_then(|camera| {
                let parameters = camera.parameters();
                parameters.get(..4).and_then(|first| first.try_into().ok())
            }),
            health: self.health.health(),
            explanation: self.explainer.explanation().cloned(),
            left_out: 0,
        };
        if seen.is_enough() {
            (seen.hint, seen.ghost) = (Hint::Done, None);
        }
        seen
    }

    /// Returns the target pose of the board, for callers that need numbers.
    pub fn goal_pose(&self) -> Option<BoardPose> {
        self.guidance.as_ref().and_then(Guidance::place)
    }

    /// Returns the expected error of a calibration now.
    fn about(&self) -> Option<f64> {
        let accuracy = self.checkpoints.as_ref()?.latest()?.accuracy.as_ref().ok()?;
        Some(accuracy.rms * self.guidance.as_ref()?.ratio_since_mark()?)
    }

    fn outline_of(&mut self, frame: &ReferenceFrame) -> Option<BoardOutline> {
        let plane: Vec<Vector2<f64>> = frame.circles.iter().map(|circle| self.board.point(circle.index)).collect();
        let image: Vec<Vector2<f64>> = frame.circles.iter().map(|circle| circle.center).collect();
        let homography = homography(&plane, &image)?;
        let corners = corners(&self.board).map(|corner| {
            let image = homography * corner.push(1.0);
            image.xy() / image.z
        });
        let now = frame.t();
        self.path.retain(|(t, _)| (0.0..=STRAIGHT).contains(&(now - t)));
        let mut velocity = [Vector2::zeros(); 4];
        if let Some((t, before)) = self.path.front().filter(|(t, _)| *t < now) {
            for (velocity, (now_at, before)) in velocity.iter_mut().zip(corners.iter().zip(before)) {
                *velocity = (now_at - before) / (now - t);
            }
        }
        self.path.push_back((now, corners));
        let circles = frame.circles.iter().map(|circle| (circle.center, circle.radius)).collect();
        Some(BoardOutline { t: frame.t(), corners, velocity, circles })
    }
}

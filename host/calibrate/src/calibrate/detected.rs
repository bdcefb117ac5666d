//! Sections 1 to 4 of method.md: from recordings to reference frames.

use super::kept_events::KeptEvents;
use crate::calibrate::findings::health::Health;
use crate::check::units::other_unit;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::input::Input;
use crate::task::progress::Progress;
use evcal_core::sensor::Sensor;
use evcal_detection::circles::compact_frame::CompactFrame;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::detection::board_stage::BoardStage;
use evcal_detection::detection::exchanged::{Exchanged, PAIRS, exchanged};
use evcal_detection::detection::focus::{WINDOWS, edge_width};
use evcal_detection::detection::no_board::NoBoard;
use evcal_detection::detection::recognition::other_board::{OtherReading, find_other_board};
use evcal_detection::detection::unplaced::UnplacedWindows;
use evcal_detection::detection::{DetectionReport, LARGEST_SENSOR};
use evcal_detection::diagnosis::bad_pixels::BadPixels;
use evcal_detection::diagnosis::disorder::Disorder;
use evcal_detection::diagnosis::double_edges::DoubleEdges;
use evcal_detection::diagnosis::fingerprint::Fingerprint;
use evcal_detection::diagnosis::flicker::RateBins;
use evcal_detection::diagnosis::lost_events::LostEvents;
use evcal_detection::diagnosis::saturation::SaturationDetector;
use evcal_detection::diagnosis::time_steps::TimeSteps;
use evcal_solve::solve::event_sample::{EventSample, Thinning};
use evcal_solve::solve::left_out::{LeftOut, Reason};
use event_recordings::given_sensor::{OtherSensor, check_outside, check_stated, counted_from_one};
use event_recordings::likely_sensor::likely_sensor_of;
use event_recordings::pass::RecordingReport;
use event_recordings::{Recording, RecordingError};

/// Result of the search for the board.
pub(super) struct Detected {
    pub(super) sensor: Sensor,
    /// Windows of recordings that show the board, in order of recording and time.
    pub(super) windows: Vec<CompactFrame>,
    /// Frames of circle inputs.
    pub(super) frames: Vec<ReferenceFrame>,
    pub(super) starts: Vec<f64>,
    pub(super) recordings: Vec<RecordingReport>,
    pub(super) detection: DetectionReport,
    /// Windows with more circles than the board has, one entry per recording of events.
    pub(super) unplaced: Vec<UnplacedWindows>,
    pub(super) events: KeptEvents,
    /// For each input, `true` if it is known to contain no pictures.
    pub(super) without_pictures: Vec<bool>,
    /// Intervals in which the readout was saturated.
    pub(super) saturated: Vec<LeftOut>,
    /// Findings on light and pixels, one entry per recording.
    pub(super) health: Vec<Health>,
}

/// Two recordings contain the same events if more than this share of the events of the smaller one is in both.
const SAME: f64 = 0.02;

/// A board is mirrored or inverted if more than one picture in this number shows that; a single one is misread now and then.
const FEWEST_CHANGED: u64 = 10;

/// Ratio of the number of sampled events to the largest number of events of the joint solve. About half of the events
/// are on an edge of the board. If the board is seldom in view, the sample is not enough and the recordings are read
/// again.
const SAMPLE_TIMES: usize = 3;

/// Fingerprints of the recordings of a calibration, to detect duplicates.
#[derive(Default)]
pub(super) struct Fingerprints(Vec<(String, Fingerprint)>);

impl Fingerprints {
    /// Adds the fingerprint of `file`.
    ///
    /// # Errors
    /// [`CalibrateError::SameEvents`] if another file contains the same events.
    pub(super) fn add(&mut self, file: String, fingerprint: Fingerprint) -> Result<(), CalibrateError> {
        if let Some((other, _)) = self.0.iter().find(|(_, other)| other.shared(&fingerprint) > SAME) {
            return Err(CalibrateError::SameEvents { file, other: other.clone() });
        }
        self.0.push((file, fingerprint));
        Ok(())
    }
}

/// Searches for the board in all recordings.
///
/// # Errors
/// [`CalibrateError`] if it is not found, or a recording cannot be used.
pub(super) fn detect(task: &Task, progress: &Progress) -> Result<Detected, CalibrateError> {
    match task.readers {
        Some(readers) => readers.install(|| detect_all(task, progress)),
        None => detect_all(task, progress),
    }
}

fn detect_all(task: &Task, progress: &Progress) -> Result<Detected, CalibrateError> {
    let sensor = common_sensor(task)?;
    let mut all = Detected {
        sensor,
        windows: Vec::new(),
        frames: Vec::new(),
        starts: Vec::new(),
        recordings: Vec::new(),
        detection: DetectionReport::default(),
        unplaced: Vec::new(),
        events: KeptEvents {
            sample: EventSample::new(SAMPLE_TIMES * task.settings.association.most_events),
            counts: None,
        },
        without_pictures: vec![false; task.inputs.len()],
        saturated: Vec::new(),
        health: Vec::new(),
    };
    let mut fingerprints = Fingerprints::default();
    // The error at which the first damaged recording ends.
    let mut damage = None;
    for (index, input) in task.inputs.iter().enumerate() {
        progress.report(format!("looking for the board in {}", input.short_name()))?;
        match input {
            Input::Events(recording) => {
                let (fingerprint, broken) = all.search_recording(task, index, recording, progress)?;
                fingerprints.add(input.name(), fingerprint)?;
                damage = damage.or(broken);
            }
            Input::Images(_) => return Err(CalibrateError::OnlyFrames { file: input.name() }),
            Input::Circles { frames, start, notes, detection, .. } => {
                all.take_circles(index, frames, *start, notes, detection);
            }
        }
    }
    match damage {
        _ if !all.frames.is_empty() || !all.windows.is_empty() => Ok(all),
        Some(damage) => Err(CalibrateError::Source(damage)),
        None => {
            check_units(task, &all.recordings)?;
            check_area(task, &all.health)?;
            let other = other_board(task, all.sensor, progress)?;
            // If another board is recognised, coarse times are not the reason why the nominal board was not found.
            if other.is_none() {
                check_times(task, &all.health)?;
            }
            Err(CalibrateError::NoPattern(all.detection.no_pattern(&task.settings.detection, other)))
        }
    }
}

impl Detected {
    /// Searches for the board in recording `index`, and collects the sample of events and the findings on light and
    /// pixels. Returns the fingerprint of the recording (empty if there is no other recording to compare it with), and
    /// the error at which a damaged recording ends.
    fn search_recording(
        &mut self,
        task: &Task,
        index: usize,
        recording: &Recording,
        progress: &Progress,
    ) -> Result<(Fingerprint, Option<RecordingError>), CalibrateError> {
        let sensor = self.sensor;
        let mut stage = BoardStage::new(task.board, &task.settings.detection, sensor, index);
        let (mut fingerprint, mut saturation) = (Fingerprint::default(), SaturationDetector::default());
        let mut thinning = Thinning::new(sensor);
        self.events.sample.begin(index);
        let (mut bins, mut steps) = (RateBins::default(), TimeSteps::default());
        let may_repeat = task.inputs.len() > 1;
        let pass = progress.read(task.inputs, index, &mut |events| {
            if may_repeat {
                fingerprint.push(events);
            }
            saturation.push(events);
            bins.push(events);
            steps.push(events);
            stage.push(events);
            self.events.sample.push(events, &mut thinning);
        })?;
        self.events.sample.end(&mut thinning);
        check_outside(recording, &pass.report)?;
        if pass.count == 0 {
            return Err(CalibrateError::Empty { file: recording.path().display().to_string() });
        }
        let intervals = saturation.finish().intervals.into_iter();
        self.saturated.extend(intervals.map(|(start, end)| LeftOut {
            recording: index,
            start,
            end,
            reason: Reason::Saturated,
        }));
        let (windows, unplaced, report) = stage.into_compact_frames(index);
        if let Some(exchanged) = exchanged_in(&windows) {
            return Err(CalibrateError::Exchanged { file: recording.path().display().to_string(), exchanged });
        }
        let [inverted, mirrored] = [NoBoard::Inverted, NoBoard::MirroredPrint]
            .map(|reason| report.grids_refused.get(&reason).copied().unwrap_or(0));
        if inverted.max(mirrored) > report.found.max(report.windows / FEWEST_CHANGED) {
            let (file, windows) = (recording.path().display().to_string(), report.windows);
            return Err(if inverted > mirrored {
                CalibrateError::Inverted { file, inverted, windows }
            } else {
                CalibrateError::Mirrored { file, mirrored, windows }
            });
        }
        self.unplaced.push(unplaced);
        let coarse_times = steps.coarse(pass.first);
        let may_flicker = !coarse_times.is_some_and(|times| times.looks_like_flicker());
        self.health.push(Health {
            flicker: bins.flicker().filter(|_| may_flicker),
            always_full: bins.is_even(),
            pixels: BadPixels::of_counts(&thinning.counts(), usize::from(sensor.width), thinning.repeated()),
            double_edges: DoubleEdges::found(thinning.intervals()).filter(|_| coarse_times.is_none()),
            lost_events: LostEvents::found(thinning.pairs()).filter(|_| coarse_times.is_none()),
            disorder: Disorder::met(&pass.report),
            coarse_times,
            edges: edge_width(&evenly_chosen(&windows)),
        });
        self.windows.extend(windows);
        self.detection.add(&report);
        let counts = self.events.counts.get_or_insert_default();
        counts.resize(index, 0);
        counts.push(pass.count);
        self.starts.push(pass.first as f64 * 1e-6);
        self.recordings.push(pass.to_report());
        if let Some(without) = self.without_pictures.get_mut(index) {
            *without = pass.damage.is_none() && pass.report.frames == Some(0);
        }
        Ok((fingerprint, pass.damage))
    }

    /// Adds the circles of input `index`, with times from `start` (s).
    fn take_circles(
        &mut self,
        index: usize,
        frames: &[ReferenceFrame],
        start: f64,
        notes: &[String],
        detection: &DetectionReport,
    ) {
        self.detection.add(detection);
        let count = frames.iter().map(|frame| frame.circles.len() as u64).sum();
        let duration = frames.last().map_or(0.0, |last| last.end) - frames.first().map_or(0.0, |f| f.start);
        self.frames.extend(frames.iter().cloned().map(|frame| ReferenceFrame { recording: index, ..frame }));
        self.starts.push(start);
        self.recordings.push(RecordingReport {
            count,
            duration,
            camera_name: None,
            began: None,
            notes: notes.to_vec(),
        });
    }
}

/// Returns the evidence that ON and OFF are exchanged, from windows spread evenly over the recording; `None` if they
/// are not.
fn exchanged_in(windows: &[CompactFrame]) -> Option<Exchanged> {
    let pairs = windows.windows(2).step_by(windows.len().div_ceil(PAIRS).max(1));
    let pairs = pairs.map(|pair| pair.iter().cloned().map(ReferenceFrame::from).collect::<Vec<_>>());
    let pairs: Vec<Vec<ReferenceFrame>> = pairs.collect();
    exchanged(pairs.iter().filter_map(|pair| Some((pair.first()?, pair.last()?))))
}

/// Returns the windows in which the width of edges is measured, spread evenly over the recording.
fn evenly_chosen(windows: &[CompactFrame]) -> Vec<ReferenceFrame> {
    windows.iter().step_by(windows.len().div_ceil(WINDOWS).max(1)).cloned().map(ReferenceFrame::from).collect()
}

/// Returns the sensor of all inputs.
pub(super) fn common_sensor(task: &Task) -> Result<Sensor, CalibrateError> {
    let mut common = None;
    for input in task.inputs {
        let sensor = sensor_of(input, task.sensor)?;
        let before = *common.get_or_insert(sensor);
        if sensor != before {
            return Err(CalibrateError::SensorsDiffer { file: input.name(), sensor, before });
        }
    }
    common.ok_or(CalibrateError::NoInput)
}

/// Returns the sensor of an input. The `given` sensor is used if a recording of events does not contain its own; for
/// circles, it overrides the reported one.
fn sensor_of(input: &Input, given: Option<Sensor>) -> Result<Sensor, CalibrateError> {
    let sensor = match input {
        // The search in frames does not depend on the sensor size.
        Input::Images(images) => return Ok(images.sensor()),
        Input::Events(recording) => {
            check_stated(recording)?;
            recording.open()?.information().sensor.or(given)
        }
        Input::Circles { sensor, .. } => given.or(*sensor),
    };
    if let (None, Input::Events(recording)) = (sensor, input)
        && let Some(sensor) = counted_from_one(recording)
    {
        return Err(OtherSensor::CountedFromOne { file: input.name(), sensor }.into());
    }
    let sensor = sensor.ok_or_else(|| {
        let likely = match input {
            Input::Events(recording) => likely_sensor_of(recording),
            Input::Images(_) | Input::Circles { .. } => None,
        };
        CalibrateError::SensorUnknown { file: input.name(), likely }
    })?;
    let is_searched = matches!(input, Input::Events(_));
    if is_searched && (sensor.width > LARGEST_SENSOR.width || sensor.height > LARGEST_SENSOR.height) {
        return Err(CalibrateError::SensorTooLarge { file: input.name(), sensor });
    }
    Ok(sensor)
}

/// Returns an error if the event rate is implausible for the unit of the timestamps.
fn check_units(task: &Task, reports: &[RecordingReport]) -> Result<(), CalibrateError> {
    for (input, report) in task.inputs.iter().zip(reports) {
        let Input::Events(recording) = input else { continue };
        if let Some(unit) = other_unit(recording, report.count as f64 / report.duration) {
            return Err(CalibrateError::TimeUnit { file: input.name(), unit });
        }
    }
    Ok(())
}

/// Smallest silent share of the sensor that can be the reason why no board is found.
const SILENT: f64 = 0.2;

/// Returns an error if a large part of a sensor sends nothing.
fn check_area(task: &Task, health: &[Health]) -> Result<(), CalibrateError> {
    let events = task.inputs.iter().filter(|input| matches!(input, Input::Events(_)));
    let silent = events.zip(health).find_map(|(input, health)| {
        let silent = health.pixels.silent.clone().filter(|silent| silent.silent_area() >= SILENT)?;
        Some((input.name(), silent))
    });
    silent.map_or(Ok(()), |(file, silent)| Err(CalibrateError::SilentArea { file, silent }))
}

/// Returns an error if the timestamps of a recording are too coarse.
fn check_times(task: &Task, health: &[Health]) -> Result<(), CalibrateError> {
    let events = task.inputs.iter().filter(|input| matches!(input, Input::Events(_)));
    let coarse = events.zip(health).find_map(|(input, health)| Some((input.name(), health.coarse_times?)));
    coarse.map_or(Ok(()), |(file, times)| Err(CalibrateError::CoarseTimes { file, times }))
}

/// Returns the other board that the recordings show instead of the nominal one, if there is one.
fn other_board(task: &Task, sensor: Sensor, progress: &Progress) -> Result<Option<OtherReading>, CalibrateError> {
    for input in task.inputs {
        if let Input::Events(recording) = input {
            progress.report(format!("looking for another board in {}", input.short_name()))?;
            let found = find_other_board(recording, sensor, task.board, &task.settings.detection)?;
            if found.is_some() {
                return Ok(found);
            }
        }
    }
    Ok(None)
}

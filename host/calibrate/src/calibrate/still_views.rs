//! Calibration from a board that blinks in front of a camera at rest: every view is a picture with its own pose.

use std::ops::ControlFlow;

use evcal_core::sensor::Sensor;
use event_recordings::given_sensor::check_outside;
use event_recordings::pass::RecordingReport;

use super::calibrated::Calibrated;
use super::detected::{Fingerprints, common_sensor};
use super::pictures::{SeenPictures, calibrate_seen};
use crate::picture_calibration::calibration::PictureSource;
use crate::settings::Settings;
use crate::task::PictureUse;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::input::{Input, read_events};
use crate::task::progress::Progress;
use evcal_detection::detection::still_views::search::{FoundInViews, search_views};
use evcal_detection::detection::still_views::{FEWEST_VIEWS, LEAST_TIME, StillView, StillViews, duration};
use evcal_detection::diagnosis::fingerprint::Fingerprint;
use evcal_solve::initial::InitialSettings;

/// Result of an attempt to calibrate from views.
pub(super) enum AtRest {
    /// The board blinks.
    Calibrated(Box<Calibrated>),
    /// The camera was at rest and something blinked, but the board was not found in any of this number of views.
    WithoutBoard(u64),
    /// The camera was hardly ever at rest.
    Moved,
}

/// The views of all recordings.
struct Views {
    sensor: Sensor,
    /// One entry for each recording.
    views: Vec<Vec<StillView>>,
    recordings: Vec<RecordingReport>,
    starts: Vec<f64>,
}

/// Returns `true` if camera and board are at rest when the first recording begins, `false` also if that is unknown.
pub(super) fn begins_at_rest(task: &Task) -> bool {
    // Circles are never at rest, and a device may state a sensor of any size.
    let (Some(Input::Events(_)), Ok(sensor)) = (task.inputs.first(), common_sensor(task)) else { return false };
    let mut views = StillViews::new(sensor);
    let mut is_at_rest = None;
    let read = read_events(task.inputs, 0, &mut |batch| {
        views.push(batch.events);
        is_at_rest = views.begins_at_rest();
        if is_at_rest.is_some() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    read.is_ok() && is_at_rest == Some(true)
}

/// Calibrates from views, if those with the board fill `least_time`, a share of the recordings.
///
/// # Errors
/// [`CalibrateError`].
pub(super) fn calibrate(task: &Task, least_time: f64, progress: &Progress) -> Result<AtRest, CalibrateError> {
    if !task.inputs.iter().all(|input| matches!(input, Input::Events(_))) {
        return Ok(AtRest::Moved);
    }
    let views = collect(task, progress)?;
    let time: f64 = views.recordings.iter().map(|recording| recording.duration).sum();
    let FoundInViews { frames, report } =
        search_views(task.board, &task.settings.detection, &task.settings.frames, &views.views);
    let at_rest: f64 = views.views.iter().flatten().map(duration).sum();
    let seen: f64 = frames.iter().map(|frame| frame.end - frame.start).sum();
    if frames.is_empty() || seen < least_time * time {
        let is_at_rest = frames.is_empty() && report.frames > 0 && at_rest >= LEAST_TIME * time;
        return Ok(if is_at_rest { AtRest::WithoutBoard(report.frames) } else { AtRest::Moved });
    }
    if matches!(task.pictures, PictureUse::Joint | PictureUse::SecondCamera) && frames.len() >= FEWEST_VIEWS {
        return Err(CalibrateError::BlinkingWithFrames { views: frames.len() });
    }
    let seen = SeenPictures { frames, pictures: Vec::new(), report, starts: views.starts };
    let initial = InitialSettings { min_frames: FEWEST_VIEWS, ..task.settings.initial.clone() };
    let settings = Settings { initial, ..task.settings.clone() };
    let task = Task { settings: &settings, ..*task };
    let source = PictureSource::StillViews;
    let calibrated = calibrate_seen(&task, seen, source, views.sensor, views.recordings, progress)?;
    Ok(AtRest::Calibrated(Box::new(calibrated)))
}

/// Makes pictures of all views.
fn collect(task: &Task, progress: &Progress) -> Result<Views, CalibrateError> {
    let sensor = common_sensor(task)?;
    let mut all = Views { sensor, views: Vec::new(), recordings: Vec::new(), starts: Vec::new() };
    let mut fingerprints = Fingerprints::default();
    for (index, input) in task.inputs.iter().enumerate() {
        progress.report(format!("looking for a board at rest in {}", input.short_name()))?;
        let (mut views, mut fingerprint) = (StillViews::new(sensor), Fingerprint::default());
        let pass = progress.read(task.inputs, index, &mut |events| {
            views.push(events);
            fingerprint.push(events);
        })?;
        if let Input::Events(recording) = input {
            check_outside(recording, &pass.report)?;
        }
        fingerprints.add(input.name(), fingerprint)?;
        all.views.push(views.finish());
        all.starts.push(pass.first as f64 * 1e-6);
        all.recordings.push(pass.to_report());
    }
    Ok(all)
}

#[cfg(test)]
mod tests;

//! The calibration of a recording's beginning, while the rest is still being recorded.

use std::ops::ControlFlow;

use super::calibrate;
use super::calibrated::Calibrated;
use crate::task::PictureUse;
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::input::Input;
use crate::task::step::Step;
use event_recordings::{Recording, RecordingError};

/// Calibrates as `task` describes, from its inputs and the events of the first `seconds` of `recording`. The result does not
/// change if the file grows meanwhile, as long as it was long enough at the start.
///
/// # Errors
/// [`CalibrateError`], as for [`calibrate`].
pub fn calibrate_beginning(
    recording: &Recording,
    seconds: f64,
    task: &Task,
    progress: impl FnMut(Step) -> ControlFlow<()> + Send,
) -> Result<Calibrated, CalibrateError> {
    let end = first_time(recording)?.saturating_add((seconds * 1e6) as i64);
    let mut inputs = task.inputs.to_vec();
    inputs.push(Input::from(recording.section(i64::MIN..end).still_written()));
    calibrate(&Task { inputs: &inputs, pictures: PictureUse::Ignore, ..*task }, progress)
}

/// Returns the time of the first event (µs, as in the file).
fn first_time(recording: &Recording) -> Result<i64, RecordingError> {
    let (mut reader, mut events) = (recording.open()?, Vec::new());
    while events.is_empty() && reader.next_batch(&mut events)? {}
    Ok(events.first().map_or(0, |event| event.t))
}

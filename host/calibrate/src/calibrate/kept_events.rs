//! Events with their ranks in bursts: kept in memory, or from recordings that are read again.

use evcal_core::sensor::Sensor;

use super::interval_choice::{ChosenSeconds, IntervalChoice, second_of};
use crate::task::Task;
use crate::task::error::CalibrateError;
use crate::task::input::Input;
use crate::task::progress::Progress;
use evcal_solve::solve::event_sample::{EventSample, RankedEvent, Thinning};
use evcal_solve::solve::refinement::{EventInput, ReadRecording};

/// Ratio of the number of kept events to the largest number of events of the joint solve.
const SAMPLE_TIMES: usize = 2;

/// The events that the rounds of association can use.
pub(super) struct KeptEvents {
    /// An even sample of the events, as many as fit into memory.
    pub(super) sample: EventSample,
    /// Number of events of each input, 0 for circles; `None` if all inputs are circles.
    pub(super) counts: Option<Vec<u64>>,
}

impl KeptEvents {
    /// Returns the events of the chosen seconds alone. A sample of all events of a long recording would have too few in
    /// each second.
    ///
    /// # Errors
    /// [`CalibrateError`] if a recording cannot be read, or the caller cancels.
    pub(super) fn of_choice(
        self,
        choice: Option<&IntervalChoice>,
        task: &Task,
        sensor: Sensor,
        progress: &Progress,
    ) -> Result<Self, CalibrateError> {
        let Some(choice) = choice else { return Ok(self) };
        // The memory is sufficient for one sample only.
        drop(self);
        let (sample, counts) = events_of(task, &ChosenSeconds::new(choice), sensor, progress)?;
        Ok(Self { sample, counts: Some(counts) })
    }

    /// Returns a function that reads events for a round of association: from the sample, or from the recordings if the sample has
    /// too few.
    pub(super) fn reader<'a>(
        &'a self,
        task: &'a Task,
        sensor: Sensor,
        progress: &'a Progress,
    ) -> Box<ReadRecording<'a, CalibrateError>> {
        Box::new(move |index, share, visit| {
            progress.go_on()?;
            if self.sample.read(index, share, visit) {
                return Ok(());
            }
            read_share(task, index, share, sensor, progress, visit)
        })
    }

    /// Returns the events as input of the joint solve.
    pub(super) fn input<'a>(
        &'a self,
        read: &'a ReadRecording<'a, CalibrateError>,
    ) -> Option<EventInput<'a, CalibrateError>> {
        self.counts.as_deref().map(|counts| EventInput { counts, read })
    }
}

/// Reads the recordings again. Returns an even sample of the events in the `chosen` seconds, and the number of these events in
/// each input.
///
/// # Errors
/// [`CalibrateError`] if a recording cannot be read, or the caller cancels.
fn events_of(
    task: &Task,
    chosen: &ChosenSeconds,
    sensor: Sensor,
    progress: &Progress,
) -> Result<(EventSample, Vec<u64>), CalibrateError> {
    let mut sample = EventSample::new(SAMPLE_TIMES * task.settings.association.most_events);
    let mut counts = vec![0; task.inputs.len()];
    for (index, (input, count)) in task.inputs.iter().zip(&mut counts).enumerate() {
        let Input::Events(_) = input else { continue };
        progress.report(format!("reading the chosen seconds of {}", input.short_name()))?;
        let mut thinning = Thinning::new(sensor);
        sample.begin(index);
        progress.read(task.inputs, index, &mut |events| {
            for events in events.chunk_by(|a, b| second(a.t) == second(b.t)) {
                if events.first().is_some_and(|event| chosen.has(index, second(event.t))) {
                    *count += events.len() as u64;
                    sample.push(events, &mut thinning);
                } else {
                    sample.pass(events, &mut thinning);
                }
            }
        })?;
        sample.end(&mut thinning);
    }
    Ok((sample, counts))
}

/// Reads recording number `index` again, and passes an even `share` of 0 to 1 of its events to `visit`, in the order of time.
///
/// # Errors
/// [`CalibrateError`] if the recording cannot be read, or the caller cancels.
pub(super) fn read_share(
    task: &Task,
    index: usize,
    share: f64,
    sensor: Sensor,
    progress: &Progress,
    visit: &mut dyn FnMut(&[RankedEvent]),
) -> Result<(), CalibrateError> {
    let mut thinning = Thinning::new(sensor);
    let mut kept = Vec::new();
    progress.read(task.inputs, index, &mut |events| {
        kept.clear();
        thinning.take(events, share, &mut kept);
        visit(&kept);
    })?;
    kept.clear();
    thinning.take_rest(&mut kept);
    visit(&kept);
    Ok(())
}

fn second(t: i64) -> i64 {
    second_of(t as f64 * 1e-6)
}

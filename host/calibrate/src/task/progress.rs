//! Progress reporting and cancellation.

use std::ops::ControlFlow;
use std::sync::{Mutex, PoisonError};

use evcal_core::event::Event;

use super::error::CalibrateError;
use super::input::{Input, read_events};
use super::step::Step;
use event_recordings::pass::Pass;

/// Callback for progress, which can cancel the calibration.
pub(crate) type ProgressCallback<'a> = dyn FnMut(Step) -> ControlFlow<()> + Send + 'a;

/// Reports progress to the caller, and remembers that the caller cancelled.
pub(crate) struct Progress<'a>(Mutex<State<'a>>);

struct State<'a> {
    on_progress: &'a mut ProgressCallback<'a>,
    /// The last reported text.
    text: String,
    /// Number of events of each recording that was read to its end, by input.
    known: Vec<Option<u64>>,
    /// Progress of the current step, if the step measures it.
    done: Option<f64>,
    /// Number of events read since the text was reported.
    read: u64,
    stopped: bool,
}

impl State<'_> {
    fn ask(&mut self, done: Option<f64>) -> Result<(), CalibrateError> {
        self.stopped = self.stopped || (self.on_progress)(Step { text: &self.text, done }).is_break();
        if self.stopped { Err(CalibrateError::Stopped) } else { Ok(()) }
    }

    /// Returns the number of events of all recordings, once each was read to its end.
    fn total(&self) -> Option<u64> {
        self.known.iter().copied().sum()
    }

    /// Returns the progress of a pass after `count` more events: over all recordings once each was read, before that within the
    /// file if the reader knows it.
    fn done(&mut self, count: usize, of_file: Option<f64>) -> Option<f64> {
        self.read += count as u64;
        if self.done.is_some() {
            return self.done;
        }
        match self.total() {
            Some(total) if total > 0 => Some((self.read as f64 / total as f64).min(1.0)),
            _ => of_file,
        }
    }
}

impl<'a> Progress<'a> {
    /// Creates the progress of a calibration of `inputs`.
    pub(crate) fn new(inputs: &[Input], on_progress: &'a mut ProgressCallback<'a>) -> Self {
        let known = inputs.iter().map(|input| matches!(input, Input::Circles { .. }).then_some(0)).collect();
        Self(Mutex::new(State { on_progress, text: String::new(), done: None, known, read: 0, stopped: false }))
    }

    /// Reports the next step.
    ///
    /// # Errors
    /// [`CalibrateError::Stopped`] once the caller cancelled; it is not asked again.
    pub(crate) fn report(&self, text: impl Into<String>) -> Result<(), CalibrateError> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.text = text.into();
        (state.done, state.read) = (None, 0);
        state.ask(None)
    }

    /// Reports the progress of the step `text`, 0 to 1. It never decreases, and reading does not change it.
    ///
    /// # Errors
    /// As for [`Progress::report`].
    pub(crate) fn report_part(&self, text: &str, done: f64) -> Result<(), CalibrateError> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let before = state.done.filter(|_| state.text == text).unwrap_or(0.0);
        text.clone_into(&mut state.text);
        state.done = Some(done.max(before));
        let done = state.done;
        state.ask(done)
    }

    /// Reports the current step again, to give the caller the chance to cancel.
    ///
    /// # Errors
    /// As for [`Progress::report`].
    pub(crate) fn go_on(&self) -> Result<(), CalibrateError> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let done = state.done;
        state.ask(done)
    }

    /// Passes all events of an input to `visit`, like [`read_events`], until the caller cancels.
    ///
    /// # Errors
    /// [`CalibrateError`] if the recording cannot be read, or the caller cancels.
    pub(crate) fn read(
        &self,
        inputs: &[Input],
        index: usize,
        visit: &mut dyn FnMut(&[Event]),
    ) -> Result<Pass, CalibrateError> {
        let mut asked = Ok(());
        let pass = read_events(inputs, index, &mut |batch| {
            let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            let done = state.done(batch.events.len(), batch.done);
            asked = state.ask(done);
            drop(state);
            match asked {
                Ok(()) => {
                    visit(batch.events);
                    ControlFlow::Continue(())
                }
                Err(_) => ControlFlow::Break(()),
            }
        })?;
        asked?;
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = state.known.get_mut(index) {
            *known = Some(pass.count);
        }
        if state.total().is_some_and(|total| state.read >= total) {
            // The steps after reading take an unknown time.
            let done = state.done;
            state.ask(done)?;
        }
        Ok(pass)
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::calibrate::calibrate;
    use crate::task::Task;
    use event_recordings::{Recording, RecordingOptions};

    fn input() -> [Input; 1] {
        let event = |t| Event { t, x: (t % 346) as u16, y: (t % 260) as u16, polarity: Polarity::On };
        let options = RecordingOptions { sensor: Some(Sensor::new(346, 260)), ..RecordingOptions::default() };
        [Recording::from_events("array", (0..1_000_000).map(event).collect(), options).into()]
    }

    #[test]
    fn reading_ends_when_the_caller_cancels_and_the_caller_is_not_asked_again() {
        let inputs = input();
        let (mut asked, mut visited) = (0, 0);
        let mut last = 0.0;
        let mut on_progress = |step: Step| {
            assert_eq!(step.text, "reading");
            // Not known before the first events were read.
            assert_eq!(step.done.is_some(), asked > 0);
            assert!(step.done.is_none_or(|done| done > last && done < 1.0), "{step:?}");
            last = step.done.unwrap_or(last);
            asked += 1;
            if asked < 4 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let progress = Progress::new(&inputs, &mut on_progress);
        progress.report("reading").unwrap();
        let read = progress.read(&inputs, 0, &mut |events| visited += events.len());
        assert!(matches!(read.err(), Some(CalibrateError::Stopped)));
        assert!(matches!(progress.go_on(), Err(CalibrateError::Stopped)));
        drop(progress);
        assert!(asked == 4 && visited > 0 && visited < 1_000_000, "{asked} {visited}");
    }

    #[test]
    fn a_pass_through_recordings_that_were_read_before_counts_all_of_them() {
        let inputs: Vec<Input> = input().into_iter().chain(input()).collect();
        let mut steps: Vec<(String, Option<f64>)> = Vec::new();
        let mut on_progress = |step: Step| {
            steps.push((step.text.to_owned(), step.done));
            ControlFlow::Continue(())
        };
        let progress = Progress::new(&inputs, &mut on_progress);
        for text in ["first", "second"] {
            for index in 0..2 {
                if text == "first" || index == 0 {
                    progress.report(text).unwrap();
                }
                progress.read(&inputs, index, &mut |_| {}).unwrap();
            }
        }
        drop(progress);
        let of = |text: &str| {
            let of_text = steps.iter().filter(|(other, _)| other == text);
            of_text.filter_map(|(_, done)| *done).collect::<Vec<f64>>()
        };
        // Each file on its own, then both as one. The last events are passed on after the end of the file was read.
        let mut first = of("first");
        first.dedup();
        assert_eq!(first.iter().filter(|done| **done == 1.0).count(), 2, "{first:?}");
        let second = of("second");
        assert!(second.is_sorted() && second.last() == Some(&1.0), "{second:?}");
        assert!(second.iter().any(|done| (done - 0.5).abs() < 1e-9), "{second:?}");
    }

    #[test]
    fn progress_measured_by_a_step_never_decreases_while_events_are_read() {
        let inputs = input();
        let mut steps: Vec<(String, Option<f64>)> = Vec::new();
        let mut on_progress = |step: Step| {
            steps.push((step.text.to_owned(), step.done));
            ControlFlow::Continue(())
        };
        let progress = Progress::new(&inputs, &mut on_progress);
        progress.report_part("round", 0.1).unwrap();
        progress.read(&inputs, 0, &mut |_| {}).unwrap();
        progress.report_part("round", 0.4).unwrap();
        progress.report_part("round", 0.3).unwrap();
        progress.go_on().unwrap();
        progress.report_part("next round", 0.2).unwrap();
        progress.report("end").unwrap();
        drop(progress);
        let of =
            |text: &str| steps.iter().filter(|(other, _)| other == text).map(|(_, done)| *done).collect::<Vec<_>>();
        let round = of("round");
        assert!(round.len() > 4 && round[..round.len() - 3].iter().all(|done| *done == Some(0.1)), "{round:?}");
        assert_eq!(round[round.len() - 3..], [Some(0.4); 3]);
        assert_eq!((of("next round"), of("end")), (vec![Some(0.2)], vec![None]));
    }

    #[test]
    fn a_calibration_can_be_cancelled() {
        let (inputs, board) = (input(), "acircles:9x4:55mm:r17.5mm".parse().unwrap());
        let mut steps = Vec::new();
        let ended = calibrate(&Task::new(&inputs, &board), |step| {
            steps.push(step.text.to_owned());
            ControlFlow::Break(())
        });
        assert!(matches!(ended.err(), Some(CalibrateError::Stopped)));
        assert_eq!(steps, ["looking for the board in array"]);
    }
}

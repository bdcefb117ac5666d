//! The caller's ear: it is told what is going on, and may end it.

use std::ops::ControlFlow;
use std::sync::{Mutex, PoisonError};

use evcal_core::event::Event;

use super::error::CalibrateError;
use super::input::{Input, read_events};
use crate::recording::pass::Pass;

/// What a caller is told with, and what it answers.
pub(super) type Tell<'a> = dyn FnMut(&str) -> ControlFlow<()> + Send + 'a;

/// Tells the caller what is going on, and remembers that it wanted the end.
pub(super) struct Progress<'a>(Mutex<State<'a>>);

struct State<'a> {
    tell: &'a mut Tell<'a>,
    /// What was told last.
    text: String,
    stopped: bool,
}

impl State<'_> {
    fn ask(&mut self) -> Result<(), CalibrateError> {
        self.stopped = self.stopped || (self.tell)(&self.text).is_break();
        if self.stopped { Err(CalibrateError::Stopped) } else { Ok(()) }
    }
}

impl<'a> Progress<'a> {
    pub(super) fn new(tell: &'a mut Tell<'a>) -> Self {
        Self(Mutex::new(State { tell, text: String::new(), stopped: false }))
    }

    /// Tells what begins now.
    ///
    /// # Errors
    /// [`CalibrateError::Stopped`] once the caller wants the end; it is not asked again.
    pub(super) fn tell(&self, text: impl Into<String>) -> Result<(), CalibrateError> {
        let mut state = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        state.text = text.into();
        state.ask()
    }

    /// Tells the same again: is it still to go on?
    ///
    /// # Errors
    /// As [`Progress::tell`].
    pub(super) fn go_on(&self) -> Result<(), CalibrateError> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).ask()
    }

    /// Hands all events of an input to `visit`, as [`read_events`] does, as long as the caller lets it.
    ///
    /// # Errors
    /// [`CalibrateError`] when the recording cannot be read, or the caller wants the end.
    pub(super) fn read(
        &self,
        inputs: &[Input],
        index: usize,
        visit: &mut dyn FnMut(&[Event]),
    ) -> Result<Pass, CalibrateError> {
        let mut asked = Ok(());
        let pass = read_events(inputs, index, &mut |events| {
            asked = self.go_on();
            match asked {
                Ok(()) => {
                    visit(events);
                    ControlFlow::Continue(())
                }
                Err(_) => ControlFlow::Break(()),
            }
        })?;
        asked.map(|()| pass)
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::calibrate::{Task, calibrate};
    use crate::recording::{Recording, RecordingOptions};

    fn input() -> [Input; 1] {
        let event = |t| Event { t, x: (t % 346) as u16, y: (t % 260) as u16, polarity: Polarity::On };
        let options = RecordingOptions { sensor: Some(Sensor::new(346, 260)), ..RecordingOptions::default() };
        [Recording::from_events("array", (0..1_000_000).map(event).collect(), options).into()]
    }

    #[test]
    fn reading_ends_with_the_first_no_and_nobody_is_asked_again() {
        let inputs = input();
        let (mut asked, mut visited) = (0, 0);
        let mut tell = |text: &str| {
            assert_eq!(text, "reading");
            asked += 1;
            if asked < 4 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) }
        };
        let progress = Progress::new(&mut tell);
        progress.tell("reading").unwrap();
        let read = progress.read(&inputs, 0, &mut |events| visited += events.len());
        assert!(matches!(read.err(), Some(CalibrateError::Stopped)));
        assert!(matches!(progress.go_on(), Err(CalibrateError::Stopped)));
        drop(progress);
        assert!(asked == 4 && visited > 0 && visited < 1_000_000, "{asked} {visited}");
    }

    #[test]
    fn a_calibration_can_be_ended() {
        let (inputs, board) = (input(), "acircles:9x4:55mm:r17.5mm".parse().unwrap());
        let mut told = Vec::new();
        let ended = calibrate(&Task::new(&inputs, &board), |text| {
            told.push(text.to_owned());
            ControlFlow::Break(())
        });
        assert!(matches!(ended.err(), Some(CalibrateError::Stopped)));
        assert_eq!(told, ["looking for the board in array"]);
    }
}

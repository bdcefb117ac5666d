//! Checkpoints: full calibrations of the recording so far, while it continues.
//!
//! A thread of low priority computes them, with its own workers, so that neither the recording nor the display waits
//! for them. A checkpoint reports the same as a calibration of the same part of the recording. Between two checkpoints
//! the error is only estimated, from the windows since the last one.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::background::{give_way, workers};

/// Largest acceptable error anywhere on the sensor, as a multiple of the target.
const LARGEST: f64 = 3.0;
/// Smallest and largest growth of the recording's length from one checkpoint to the next.
const GROWTH: [f64; 2] = [1.3, 2.0];
/// Growth of the recording's length after a calibration that failed.
const GROWTH_AFTER_FAILURE: f64 = 1.5;

/// Accuracy that a calibration reports.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReportedAccuracy {
    /// Expected error of the projection, root mean square over the sensor (px).
    pub rms: f64,
    /// Largest standard deviation of the projection anywhere on the sensor (px).
    pub max: f64,
    /// `true` if separate calibrations of two halves of the recording differ by no more than expected.
    pub halves_agree: bool,
}

/// A calibration of the beginning of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// Length of the part that was calibrated, from the first event (s).
    pub t: f64,
    /// The reported accuracy, or the reason why the calibration failed.
    pub accuracy: Result<ReportedAccuracy, String>,
}

impl Checkpoint {
    /// Describes why the calibration is not good enough; `None` if it is.
    pub fn missing(&self, target: f64) -> Option<String> {
        match &self.accuracy {
            Err(reason) => Some(format!("a calibration; that of the first {:.0} s failed: {reason}", self.t)),
            Ok(accuracy) if accuracy.rms > target => {
                Some(format!("more views (stated ±{:.3} px, wanted {target})", accuracy.rms))
            }
            Ok(accuracy) if accuracy.max > LARGEST * target => Some(format!(
                "more views where the error is largest (stated ±{:.3} px there, at most {:.3} wanted)",
                accuracy.max,
                LARGEST * target
            )),
            Ok(accuracy) if !accuracy.halves_agree => {
                Some("more views: two halves of the recording differ by more than stated".to_owned())
            }
            Ok(_) => None,
        }
    }

    /// Returns the time of the next checkpoint (s since the first event); errors decrease with the square root of time.
    fn next(&self, target: f64) -> f64 {
        let growth = match &self.accuracy {
            Err(_) => GROWTH_AFTER_FAILURE,
            Ok(_) if self.missing(target).is_none() => GROWTH[1],
            Ok(accuracy) => {
                let excess = (accuracy.rms / target).max(accuracy.max / (LARGEST * target));
                (excess * excess).clamp(GROWTH[0], GROWTH[1])
            }
        };
        self.t * growth
    }
}

/// Time at which the result of a checkpoint is reported.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReportTime {
    /// Immediately.
    WhenReady,
    /// When the recording has grown by this factor since the checkpoint started, after waiting for the result if
    /// necessary. Reports are then independent of the speed of a replay.
    AtLength(f64),
}

/// A step of a calibration, to be shown while the recording waits for the result.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationStep {
    /// Name of the step.
    pub text: String,
    /// Finished share of the step, 0 to 1; `None` if it is not known.
    pub done: Option<f64>,
}

/// The calibration of a checkpoint in progress, shared with other threads.
#[derive(Debug, Default)]
pub struct RunningCalibration {
    stop: AtomicBool,
    /// `true` while the recording waits for the result.
    is_awaited: AtomicBool,
    step: Mutex<CalibrationStep>,
}

impl RunningCalibration {
    /// Returns `true` if the calibration should end early.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Reports the current step.
    pub fn report(&self, text: &str, done: Option<f64>) {
        *self.step() = CalibrationStep { text: text.to_owned(), done };
    }

    /// Returns the current step while the recording waits for the result.
    pub fn awaited(&self) -> Option<CalibrationStep> {
        self.is_awaited.load(Ordering::Relaxed).then(|| self.step().clone())
    }

    fn step(&self) -> MutexGuard<'_, CalibrationStep> {
        self.step.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Computes checkpoints in the background, one at a time.
pub struct Checkpoints {
    requests: Sender<f64>,
    results: Receiver<Checkpoint>,
    report_time: ReportTime,
    target: f64,
    /// Time from the first sight of the board to the first checkpoint (s).
    first: f64,
    /// Start of the checkpoint in progress.
    begun: Option<f64>,
    /// Start of the next checkpoint; `None` before the board was seen.
    next: Option<f64>,
    latest: Option<Checkpoint>,
    running: Arc<RunningCalibration>,
}

impl Checkpoints {
    /// Starts the thread. `calibrate` receives the length of the part to calibrate, from the first event (s), reports
    /// its steps, and should end early once it is stopped. The first checkpoint starts `first` seconds after the board
    /// was first seen; the interval between later ones depends on the remaining distance to `target` (px).
    ///
    /// # Errors
    /// If the system cannot create threads.
    pub fn start(
        report_time: ReportTime,
        target: f64,
        first: f64,
        mut calibrate: impl FnMut(f64, &RunningCalibration) -> Result<ReportedAccuracy, String> + Send + 'static,
    ) -> io::Result<Self> {
        let pool = workers("checkpoint")?;
        let (requests, wanted) = channel::<f64>();
        let (sender, results) = channel();
        let running = Arc::new(RunningCalibration::default());
        let running_of_thread = Arc::clone(&running);
        thread::Builder::new().name("checkpoints".to_owned()).spawn(move || {
            give_way();
            for t in wanted {
                let accuracy = pool.install(|| calibrate(t, &running_of_thread));
                if sender.send(Checkpoint { t, accuracy }).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self { requests, results, report_time, target, first, begun: None, next: None, latest: None, running })
    }

    /// Returns the latest reported result.
    pub fn latest(&self) -> Option<&Checkpoint> {
        self.latest.as_ref()
    }

    /// Returns the length of the part that is being calibrated, from the first event (s).
    pub fn running_length(&self) -> Option<f64> {
        self.begun
    }

    /// Returns the checkpoint in progress, for other threads.
    pub fn running(&self) -> Arc<RunningCalibration> {
        Arc::clone(&self.running)
    }

    /// Starts a checkpoint that is due at `now` (s since the first event); `first_seen` is the time at which the board
    /// was first seen. Returns a result once, when it is to be reported.
    pub fn advance(&mut self, now: f64, first_seen: Option<f64>) -> Option<&Checkpoint> {
        let Some(begun) = self.begun else {
            self.next = self.next.or(first_seen.map(|seen| seen + self.first));
            if self.next.is_some_and(|next| now >= next) {
                // If the thread has ended, there will be no more checkpoints.
                self.begun = self.requests.send(now).ok().map(|()| now);
            }
            return None;
        };
        let result = match self.report_time {
            ReportTime::WhenReady => self.results.try_recv(),
            ReportTime::AtLength(growth) if now < growth * begun => Err(TryRecvError::Empty),
            ReportTime::AtLength(_) => {
                self.running.is_awaited.store(true, Ordering::Relaxed);
                let result = self.results.recv().map_err(TryRecvError::from);
                self.running.is_awaited.store(false, Ordering::Relaxed);
                result
            }
        };
        match result {
            Ok(checkpoint) => {
                self.begun = None;
                self.next = Some(checkpoint.next(self.target).max(now));
                self.latest = Some(checkpoint);
                self.latest.as_ref()
            }
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => {
                (self.begun, self.next) = (None, Some(f64::INFINITY));
                None
            }
        }
    }
}

impl Drop for Checkpoints {
    fn drop(&mut self) {
        // The thread is not joined, because that would delay the final calibration.
        self.running.stop.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: ReportedAccuracy = ReportedAccuracy { rms: 0.04, max: 0.1, halves_agree: true };

    fn missing(accuracy: ReportedAccuracy) -> Option<String> {
        Checkpoint { t: 10.0, accuracy: Ok(accuracy) }.missing(0.05)
    }

    #[test]
    fn each_unmet_criterion_is_reported() {
        assert_eq!(missing(GOOD), None);
        assert!(missing(ReportedAccuracy { rms: 0.051, ..GOOD }).unwrap().contains("±0.051 px, wanted 0.05"));
        assert!(missing(ReportedAccuracy { max: 0.151, ..GOOD }).unwrap().contains("where the error is largest"));
        assert!(missing(ReportedAccuracy { halves_agree: false, ..GOOD }).unwrap().contains("halves"));
        let failed = Checkpoint { t: 10.0, accuracy: Err("no board".to_owned()) };
        assert!(failed.missing(0.05).unwrap().contains("no board"));
    }

    #[test]
    fn the_next_checkpoint_is_when_the_target_may_be_reached() {
        let next = |accuracy| Checkpoint { t: 10.0, accuracy }.next(0.05);
        assert!((next(Ok(ReportedAccuracy { rms: 0.06, ..GOOD })) - 14.4).abs() < 1e-9);
        assert!((next(Ok(ReportedAccuracy { max: 0.18, ..GOOD })) - 14.4).abs() < 1e-9);
        assert_eq!(next(Ok(ReportedAccuracy { rms: 1.0, ..GOOD })), 20.0);
        assert_eq!(next(Ok(ReportedAccuracy { halves_agree: false, ..GOOD })), 13.0);
        assert_eq!(next(Err(String::new())), 15.0);
    }

    /// Returns the sensor times at which checkpoints started, and at which they were reported.
    fn reported(report_time: ReportTime) -> Vec<(f64, f64)> {
        let work = |t: f64, _: &RunningCalibration| Ok(ReportedAccuracy { rms: 0.2 / t.sqrt(), ..GOOD });
        let mut checkpoints = Checkpoints::start(report_time, 0.05, 4.0, work).unwrap();
        let mut reported = Vec::new();
        for step in 0..300 {
            let now = f64::from(step) * 0.1;
            if let Some(checkpoint) = checkpoints.advance(now, (now >= 2.0).then_some(2.0)) {
                assert_eq!(checkpoint.accuracy, Ok(ReportedAccuracy { rms: 0.2 / checkpoint.t.sqrt(), ..GOOD }));
                reported.push((checkpoint.t, now));
            }
        }
        reported
    }

    #[test]
    fn checkpoints_of_a_replay_are_reported_at_definite_times() {
        let first = reported(ReportTime::AtLength(1.5));
        assert_eq!(first, reported(ReportTime::AtLength(1.5)));
        assert_eq!(first.first(), Some(&(6.0, 9.0)));
        assert!(
            first.iter().all(|(begun, reported)| *reported >= 1.5 * begun && *reported < 1.5 * begun + 0.11),
            "{first:?}"
        );
        assert!(first.len() >= 2);
    }

    /// A step is shown only while the recording waits for the result.
    #[test]
    fn an_awaited_checkpoint_reports_its_step() {
        let (go, may_go) = channel::<()>();
        let work = move |_: f64, running: &RunningCalibration| {
            running.report("joint solve", Some(0.25));
            let _ = may_go.recv();
            Ok(GOOD)
        };
        let mut checkpoints = Checkpoints::start(ReportTime::AtLength(1.5), 0.05, 2.0, work).unwrap();
        let running = checkpoints.running();
        checkpoints.advance(2.0, Some(0.0));
        assert_eq!((checkpoints.running_length(), running.awaited()), (Some(2.0), None));
        let watcher = thread::spawn(move || {
            let step = loop {
                match running.awaited() {
                    Some(step) if step.done.is_some() => break step,
                    _ => thread::yield_now(),
                }
            };
            drop(go);
            (step, running)
        });
        assert!(checkpoints.advance(3.0, Some(0.0)).is_some());
        let (step, running) = watcher.join().unwrap();
        assert_eq!(step, CalibrationStep { text: "joint solve".to_owned(), done: Some(0.25) });
        assert_eq!(running.awaited(), None);
    }

    /// Whatever a calibration does, the caller continues at once.
    #[test]
    fn a_running_calibration_does_not_block_and_is_cancelled_on_drop() {
        let (ended, end) = channel();
        let work = move |_: f64, running: &RunningCalibration| {
            while !running.is_stopped() {
                thread::yield_now();
            }
            let _ = ended.send(());
            Err("ended".to_owned())
        };
        let mut checkpoints = Checkpoints::start(ReportTime::WhenReady, 0.05, 1.0, work).unwrap();
        for step in 0..100 {
            assert_eq!(checkpoints.advance(f64::from(step), Some(0.0)), None);
        }
        assert_eq!(checkpoints.running_length(), Some(1.0));
        drop(checkpoints);
        assert_eq!(end.recv(), Ok(()));
    }
}

//! Checkpoints: real calibrations of what was recorded so far, while the recording goes on.
//!
//! A thread of low priority makes them, with workers of its own, so that neither the recording nor the display
//! waits for one. What a checkpoint states is what a calibration states of the same part of the recording. Between
//! two of them the error is only estimated, from the windows that came since.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, TryRecvError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;

use super::background::{give_way, workers};

/// The largest error anywhere on the sensor may be so many times the target.
const LARGEST: f64 = 3.0;
/// The next checkpoint comes when the recording is so many times as long: at least, and at most.
const GROWTH: [f64; 2] = [1.3, 2.0];
/// The same after a calibration that failed.
const GROWTH_AFTER_FAILURE: f64 = 1.5;

/// What a calibration states of itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stated {
    /// Error of the projection to be expected, root mean square over the sensor (px).
    pub rms: f64,
    /// Greatest standard deviation of the projection anywhere on the sensor (px).
    pub max: f64,
    /// Whether two halves of the recording, calibrated apart, differ by no more than stated.
    pub halves_agree: bool,
}

/// A calibration of the beginning of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    /// End of that beginning (s since the first event).
    pub t: f64,
    /// What it states, or why there is none.
    pub stated: Result<Stated, String>,
}

impl Checkpoint {
    /// What keeps it from being good enough, in words; nothing where it is.
    pub fn missing(&self, target: f64) -> Option<String> {
        match &self.stated {
            Err(reason) => Some(format!("a calibration; that of the first {:.0} s failed: {reason}", self.t)),
            Ok(stated) if stated.rms > target => {
                Some(format!("more views (stated ±{:.3} px, wanted {target})", stated.rms))
            }
            Ok(stated) if stated.max > LARGEST * target => Some(format!(
                "more views where the error is largest (stated ±{:.3} px there, at most {:.3} wanted)",
                stated.max,
                LARGEST * target
            )),
            Ok(stated) if !stated.halves_agree => {
                Some("more views: two halves of the recording differ by more than stated".to_owned())
            }
            Ok(_) => None,
        }
    }

    /// When the next one is worth its time (s since the first event): errors fall with the square root of time.
    fn next(&self, target: f64) -> f64 {
        let growth = match &self.stated {
            Err(_) => GROWTH_AFTER_FAILURE,
            Ok(_) if self.missing(target).is_none() => GROWTH[1],
            Ok(stated) => {
                let excess = (stated.rms / target).max(stated.max / (LARGEST * target));
                (excess * excess).clamp(GROWTH[0], GROWTH[1])
            }
        };
        self.t * growth
    }
}

/// When the result of a checkpoint is told.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Telling {
    /// As soon as it is there.
    WhenReady,
    /// When the recording is so many times as long, and it is waited for then: the same at every speed of a replay.
    AtLength(f64),
}

/// A step of a calibration, for who waits for it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CalibrationStep {
    /// What is done.
    pub text: String,
    /// Which part of it is done, 0 to 1; `None` where that is not known.
    pub done: Option<f64>,
}

/// The calibration of a checkpoint that is being made, as other threads see it.
#[derive(Debug, Default)]
pub struct Underway {
    stop: AtomicBool,
    /// Whether the recording stands still until it is made.
    is_awaited: AtomicBool,
    step: Mutex<CalibrationStep>,
}

impl Underway {
    /// Whether it should end early.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Tells how far it is.
    pub fn tell(&self, text: &str, done: Option<f64>) {
        *self.step() = CalibrationStep { text: text.to_owned(), done };
    }

    /// How far it is, while the recording stands still until it is made.
    pub fn awaited(&self) -> Option<CalibrationStep> {
        self.is_awaited.load(Ordering::Relaxed).then(|| self.step().clone())
    }

    fn step(&self) -> MutexGuard<'_, CalibrationStep> {
        self.step.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Makes checkpoints in the background, one at a time.
pub struct Checkpoints {
    requests: Sender<f64>,
    results: Receiver<Checkpoint>,
    telling: Telling,
    target: f64,
    /// The first one is made so long after the board was first seen (s).
    first: f64,
    /// When the one under way began.
    begun: Option<f64>,
    /// When the next one begins; `None` before the board was seen.
    next: Option<f64>,
    latest: Option<Checkpoint>,
    underway: Arc<Underway>,
}

impl Checkpoints {
    /// `calibrate` gets the length of the beginning to calibrate (s), tells how far it is, and should end early once it is stopped. The
    /// first is made `first` seconds after the board was first seen; later ones are as far apart as the way to `target`
    /// (px) demands.
    ///
    /// # Errors
    /// When the system gives no threads.
    pub fn start(
        telling: Telling,
        target: f64,
        first: f64,
        mut calibrate: impl FnMut(f64, &Underway) -> Result<Stated, String> + Send + 'static,
    ) -> io::Result<Self> {
        let pool = workers("checkpoint")?;
        let (requests, wanted) = channel::<f64>();
        let (sender, results) = channel();
        let underway = Arc::new(Underway::default());
        let of_thread = Arc::clone(&underway);
        thread::Builder::new().name("checkpoints".to_owned()).spawn(move || {
            give_way();
            for t in wanted {
                let stated = pool.install(|| calibrate(t, &of_thread));
                if sender.send(Checkpoint { t, stated }).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self { requests, results, telling, target, first, begun: None, next: None, latest: None, underway })
    }

    /// The latest result that was told.
    pub fn latest(&self) -> Option<&Checkpoint> {
        self.latest.as_ref()
    }

    /// End of the beginning that is being calibrated (s since the first event).
    pub fn under_way(&self) -> Option<f64> {
        self.begun
    }

    /// How far that is, for other threads.
    pub fn underway(&self) -> Arc<Underway> {
        Arc::clone(&self.underway)
    }

    /// Begins what is due at `now` (s since the first event); `first_seen` is when the board was seen first. A result that
    /// is to be told now, once.
    pub fn advance(&mut self, now: f64, first_seen: Option<f64>) -> Option<&Checkpoint> {
        let Some(begun) = self.begun else {
            self.next = self.next.or(first_seen.map(|seen| seen + self.first));
            if self.next.is_some_and(|next| now >= next) {
                // A thread that has ended makes no more of them.
                self.begun = self.requests.send(now).ok().map(|()| now);
            }
            return None;
        };
        let result = match self.telling {
            Telling::WhenReady => self.results.try_recv(),
            Telling::AtLength(growth) if now < growth * begun => Err(TryRecvError::Empty),
            Telling::AtLength(_) => {
                self.underway.is_awaited.store(true, Ordering::Relaxed);
                let result = self.results.recv().map_err(TryRecvError::from);
                self.underway.is_awaited.store(false, Ordering::Relaxed);
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
        // It is not waited for: the calibration that follows has the higher priority.
        self.underway.stop.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: Stated = Stated { rms: 0.04, max: 0.1, halves_agree: true };

    fn missing(stated: Stated) -> Option<String> {
        Checkpoint { t: 10.0, stated: Ok(stated) }.missing(0.05)
    }

    #[test]
    fn each_criterion_counts_by_itself() {
        assert_eq!(missing(GOOD), None);
        assert!(missing(Stated { rms: 0.051, ..GOOD }).unwrap().contains("±0.051 px, wanted 0.05"));
        assert!(missing(Stated { max: 0.151, ..GOOD }).unwrap().contains("where the error is largest"));
        assert!(missing(Stated { halves_agree: false, ..GOOD }).unwrap().contains("halves"));
        let failed = Checkpoint { t: 10.0, stated: Err("no board".to_owned()) };
        assert!(failed.missing(0.05).unwrap().contains("no board"));
    }

    #[test]
    fn the_next_one_comes_when_the_target_may_be_reached() {
        let next = |stated| Checkpoint { t: 10.0, stated }.next(0.05);
        assert!((next(Ok(Stated { rms: 0.06, ..GOOD })) - 14.4).abs() < 1e-9);
        assert!((next(Ok(Stated { max: 0.18, ..GOOD })) - 14.4).abs() < 1e-9);
        assert_eq!(next(Ok(Stated { rms: 1.0, ..GOOD })), 20.0);
        assert_eq!(next(Ok(Stated { halves_agree: false, ..GOOD })), 13.0);
        assert_eq!(next(Err(String::new())), 15.0);
    }

    /// The sensor's times at which checkpoints began, and those at which they were told.
    fn told(telling: Telling) -> Vec<(f64, f64)> {
        let work = |t: f64, _: &Underway| Ok(Stated { rms: 0.2 / t.sqrt(), ..GOOD });
        let mut checkpoints = Checkpoints::start(telling, 0.05, 4.0, work).unwrap();
        let mut told = Vec::new();
        for step in 0..300 {
            let now = f64::from(step) * 0.1;
            if let Some(checkpoint) = checkpoints.advance(now, (now >= 2.0).then_some(2.0)) {
                assert_eq!(checkpoint.stated, Ok(Stated { rms: 0.2 / checkpoint.t.sqrt(), ..GOOD }));
                told.push((checkpoint.t, now));
            }
        }
        told
    }

    #[test]
    fn in_a_replay_they_are_told_at_definite_times() {
        let first = told(Telling::AtLength(1.5));
        assert_eq!(first, told(Telling::AtLength(1.5)));
        assert_eq!(first.first(), Some(&(6.0, 9.0)));
        assert!(first.iter().all(|(begun, told)| *told >= 1.5 * begun && *told < 1.5 * begun + 0.11), "{first:?}");
        assert!(first.len() >= 2);
    }

    /// Only while the recording stands still for it there is a step to show.
    #[test]
    fn what_is_waited_for_tells_how_far_it_is() {
        let (go, may_go) = channel::<()>();
        let work = move |_: f64, underway: &Underway| {
            underway.tell("joint solve", Some(0.25));
            let _ = may_go.recv();
            Ok(GOOD)
        };
        let mut checkpoints = Checkpoints::start(Telling::AtLength(1.5), 0.05, 2.0, work).unwrap();
        let underway = checkpoints.underway();
        checkpoints.advance(2.0, Some(0.0));
        assert_eq!((checkpoints.under_way(), underway.awaited()), (Some(2.0), None));
        let watcher = thread::spawn(move || {
            let step = loop {
                match underway.awaited() {
                    Some(step) if step.done.is_some() => break step,
                    _ => thread::yield_now(),
                }
            };
            drop(go);
            (step, underway)
        });
        assert!(checkpoints.advance(3.0, Some(0.0)).is_some());
        let (step, underway) = watcher.join().unwrap();
        assert_eq!(step, CalibrationStep { text: "joint solve".to_owned(), done: Some(0.25) });
        assert_eq!(underway.awaited(), None);
    }

    /// Whatever a calibration does, who asks goes on at once.
    #[test]
    fn a_calibration_under_way_is_not_waited_for_and_told_to_end() {
        let (ended, end) = channel();
        let work = move |_: f64, underway: &Underway| {
            while !underway.is_stopped() {
                thread::yield_now();
            }
            let _ = ended.send(());
            Err("ended".to_owned())
        };
        let mut checkpoints = Checkpoints::start(Telling::WhenReady, 0.05, 1.0, work).unwrap();
        for step in 0..100 {
            assert_eq!(checkpoints.advance(f64::from(step), Some(0.0)), None);
        }
        assert_eq!(checkpoints.under_way(), Some(1.0));
        drop(checkpoints);
        assert_eq!(end.recv(), Ok(()));
    }
}

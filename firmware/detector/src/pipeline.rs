//! The pipeline from events to frames of circles.

use core::fmt;

use evcal_core::budget::LoadShedder;
use evcal_core::circle::CircleCandidate;
use evcal_core::cluster::SensorTooLarge;
use evcal_core::detector::{Detection, Detector};
use evcal_core::event::Event;
use evcal_core::filter::{EventFate, EventFilter, FilterStorage, StorageTooSmall};
use evcal_core::window::{EventStorage, Outcome, Progress, WindowBuffer};
use evcal_link::{Encoder, Losses, Message, Statistics};

use crate::Settings;
use crate::messages::{Capacities, circle, hello, losses_since, time, window_end};

/// Interval in microseconds at which a device repeats its description and its counts.
const ANNOUNCE_EVERY_US: i64 = 1_000_000;

/// All storage of a [`Pipeline`].
///
/// `ROW_BYTES` and `ROWS` follow from the sensor by [`row_bytes`](crate::row_bytes) and
/// [`row_count`](crate::row_count). `RUNS` and `CLUSTERS` have the same meaning as in [`Detector`], `EVENTS` is the
/// capacity of a window in events, `CELLS` and `SLOTS` have the same meaning as in [`EventFilter`]. The initial value
/// is all zeros.
#[derive(Debug)]
pub struct Storage<
    const ROW_BYTES: usize,
    const ROWS: usize,
    const RUNS: usize,
    const CLUSTERS: usize,
    const EVENTS: usize,
    const CELLS: usize,
    const SLOTS: usize,
> {
    detector: Detector<f32, ROW_BYTES, ROWS, RUNS, CLUSTERS>,
    events: EventStorage<EVENTS>,
    filter: FilterStorage<CELLS, SLOTS>,
}

impl<
    const ROW_BYTES: usize,
    const ROWS: usize,
    const RUNS: usize,
    const CLUSTERS: usize,
    const EVENTS: usize,
    const CELLS: usize,
    const SLOTS: usize,
> Storage<ROW_BYTES, ROWS, RUNS, CLUSTERS, EVENTS, CELLS, SLOTS>
{
    /// Creates empty storage.
    pub const fn new() -> Self {
        Self { detector: Detector::new(), events: EventStorage::new(), filter: FilterStorage::new() }
    }
}

impl<
    const ROW_BYTES: usize,
    const ROWS: usize,
    const RUNS: usize,
    const CLUSTERS: usize,
    const EVENTS: usize,
    const CELLS: usize,
    const SLOTS: usize,
> Default for Storage<ROW_BYTES, ROWS, RUNS, CLUSTERS, EVENTS, CELLS, SLOTS>
{
    fn default() -> Self {
        Self::new()
    }
}

/// The storage is too small for the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SetupError {
    /// The storage of the detector: `ROW_BYTES`, `ROWS`.
    Detector(SensorTooLarge),
    /// The storage of the filter: `CELLS`, `SLOTS`.
    Filter(StorageTooSmall),
}

impl From<SensorTooLarge> for SetupError {
    fn from(error: SensorTooLarge) -> Self {
        Self::Detector(error)
    }
}

impl From<StorageTooSmall> for SetupError {
    fn from(error: StorageTooSmall) -> Self {
        Self::Filter(error)
    }
}

impl fmt::Display for SetupError {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Detector(error) => error.fmt(formatter),
            Self::Filter(error) => error.fmt(formatter),
        }
    }
}

impl core::error::Error for SetupError {}

/// Finds the circles in a stream of events and sends them to the host.
///
/// Push events; when a window is [`Progress::Complete`], call [`detect`](Self::detect) and then
/// [`report`](Self::report), which moves on to the next window. These are two calls, so that a device can measure the
/// time of a detection, or send with interrupts enabled.
#[derive(Debug)]
pub struct Pipeline<
    'a,
    const ROW_BYTES: usize,
    const ROWS: usize,
    const RUNS: usize,
    const CLUSTERS: usize,
    const EVENTS: usize,
    const CELLS: usize,
    const SLOTS: usize,
> {
    settings: Settings,
    filter: EventFilter<'a, CELLS, SLOTS>,
    shedder: LoadShedder,
    windows: WindowBuffer<'a, EVENTS>,
    detector: &'a mut Detector<f32, ROW_BYTES, ROWS, RUNS, CLUSTERS>,
    detection: Option<Detection>,
    encoder: Encoder,
    statistics: Statistics,
    /// [`Statistics::losses`] at the time when the last window was sent.
    reported_losses: Losses,
    undecodable: u32,
    announced_us: Option<i64>,
}

impl<
    'a,
    const ROW_BYTES: usize,
    const ROWS: usize,
    const RUNS: usize,
    const CLUSTERS: usize,
    const EVENTS: usize,
    const CELLS: usize,
    const SLOTS: usize,
> Pipeline<'a, ROW_BYTES, ROWS, RUNS, CLUSTERS, EVENTS, CELLS, SLOTS>
{
    /// Creates a pipeline with empty storage. A window never contains more than `EVENTS` events.
    ///
    /// # Errors
    /// Returns an error if the storage is too small for the sensor.
    pub fn new(
        mut settings: Settings,
        storage: &'a mut Storage<ROW_BYTES, ROWS, RUNS, CLUSTERS, EVENTS, CELLS, SLOTS>,
    ) -> Result<Self, SetupError> {
        storage.detector.detect(settings.sensor, [], &settings.detector)?;
        settings.window.most_events = settings.window.most_events.min(EVENTS as u32);
        Ok(Self {
            settings,
            filter: EventFilter::new(settings.sensor, settings.filter, &mut storage.filter)?,
            shedder: LoadShedder::new(settings.budget),
            windows: WindowBuffer::new(settings.window, 0, &mut storage.events),
            detector: &mut storage.detector,
            detection: None,
            encoder: Encoder::new(),
            statistics: Statistics::default(),
            reported_losses: Losses::default(),
            undecodable: 0,
            announced_us: None,
        })
    }

    /// Processes the next event of the sensor.
    pub fn push(&mut self, event: Event) -> Progress {
        self.statistics.events = self.statistics.events.wrapping_add(1);
        if self.filter.judge(&event) != EventFate::Keep {
            return Progress::Collecting;
        }
        // Events between two windows cost almost nothing, so they do not use the budget.
        if event.t >= self.windows.start_us() {
            let was_shedding = self.shedder.is_shedding();
            if !self.shedder.admit(&event) {
                return Progress::Collecting;
            }
            if was_shedding {
                self.windows.restart(event.t);
            }
        }
        self.windows.push(event)
    }

    /// Finds the circles of the complete window.
    pub fn detect(&mut self) {
        self.statistics.windows = self.statistics.windows.saturating_add(1);
        let Self { settings, windows, detector, detection, .. } = self;
        // The constructor has checked that the sensor fits.
        *detection = detector.detect(settings.sensor, windows.events(), &settings.detector).ok();
    }

    /// Sends the circles of the window if there are enough of them, and moves on to the next window, which may already
    /// be complete.
    ///
    /// `send` returns `false` if the output has no room for a whole frame: the frame is then lost, which both sides
    /// count.
    pub fn report(&mut self, send: &mut impl FnMut(&[u8]) -> bool) -> Progress {
        let detection = self.detection.take().unwrap_or_default();
        let window = self.windows.window();
        let enough = self.detector.circles().len() >= usize::from(self.settings.fewest_circles);
        let outcome = if enough && detection.circles.circles > 0 {
            self.send_window(&detection, send);
            Outcome::Found
        } else {
            Outcome::NotFound { unique_pixels: detection.clusters.unique_pixels() }
        };
        self.announce(window.end_us, send);
        self.windows.report(outcome)
    }

    /// Sends the description of this device and its counts, if the last description was sent at least a second before
    /// `time_us` (on the clock of the events). Call it at the start, and while no events arrive.
    pub fn announce(&mut self, time_us: i64, send: &mut impl FnMut(&[u8]) -> bool) {
        if self.announced_us.is_some_and(|before| time_us.saturating_sub(before) < ANNOUNCE_EVERY_US) {
            return;
        }
        let capacities = Capacities { events: EVENTS, runs: RUNS, clusters: CLUSTERS };
        let hello = hello(&self.settings, capacities, self.announced_us.is_none(), time_us);
        self.announced_us = Some(time_us);
        self.send(&Message::Hello(hello), send);
        self.send_statistics(time_us, send);
    }

    /// Sends the counts, at the end of a recording.
    pub fn send_statistics(&mut self, time_us: i64, send: &mut impl FnMut(&[u8]) -> bool) {
        let statistics = Statistics { time_us: time(time_us), ..self.statistics() };
        self.send(&Message::Statistics(statistics), send);
    }

    /// Sets the number of words, since the start of the sensor's stream, that produced no event.
    pub const fn count_undecodable(&mut self, so_far: u32) {
        self.undecodable = so_far;
    }

    /// Returns the counts since the start.
    pub fn statistics(&self) -> Statistics {
        let counts = self.windows.counts();
        let filtered = self.filter.counts();
        Statistics {
            windows_too_few_events: counts.too_few_events,
            out_of_order: counts.out_of_order,
            losses: Losses {
                undecodable: self.undecodable.saturating_add(filtered.outside),
                hot: filtered.hot,
                background: filtered.background,
                refractory: filtered.refractory,
                shed: self.shedder.shed().saturating_add(counts.forgotten),
                overflow: counts.overflow,
                in_gap: counts.before_start,
            },
            ..self.statistics
        }
    }

    /// Returns the number of events in the current window.
    pub const fn window_events(&self) -> usize {
        self.windows.window().len()
    }

    /// Returns the circles of the last window, in pixels.
    pub fn circles(&self) -> &[CircleCandidate<f32>] {
        self.detector.circles()
    }

    fn send_window(&mut self, detection: &Detection, send: &mut impl FnMut(&[u8]) -> bool) {
        let window = self.windows.window();
        let number = self.statistics.windows_sent;
        let mut unsent = 0_u32;
        for found in self.detector.circles() {
            let frame = self.encoder.encode(&Message::Circle(circle(number, &window, found)));
            unsent += u32::from(!send(&frame));
        }
        let losses = self.statistics().losses;
        let since = losses_since(&self.reported_losses, &losses);
        let frame = self.encoder.encode(&Message::WindowEnd(window_end(number, &window, detection, since)));
        unsent += u32::from(!send(&frame));
        self.reported_losses = losses;
        self.statistics.windows_sent = number.saturating_add(1);
        self.statistics.frames_unsent = self.statistics.frames_unsent.saturating_add(unsent);
    }

    fn send(&mut self, message: &Message, send: &mut impl FnMut(&[u8]) -> bool) {
        let frame = self.encoder.encode(message);
        if !send(&frame) {
            self.statistics.frames_unsent = self.statistics.frames_unsent.saturating_add(1);
        }
    }
}

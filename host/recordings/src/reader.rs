//! One pass through a recording of any format, with the checks that all events must pass.

use std::ops::Range;
use std::path::{Path, PathBuf};

use evcal_core::event::{Event, Polarity};
use evcal_files::visible;

use crate::error::{RecordingError, RecordingErrorKind, most_events};
use crate::options::RecordingOptions;
use crate::order::{Order, WINDOW};
use crate::read_report::ReadReport;
use evcal_core::sensor::Sensor;

/// Largest step back, in microseconds, that counts as jitter: such events are sorted. A larger step back means that the
/// clock was reset.
const LARGEST_JITTER: i64 = WINDOW;
/// After a clock reset, times continue this many microseconds after the latest event.
pub(super) const PAUSE_AFTER_RESET: i64 = 1_000_000;
/// Number of clock resets above which a file counts as unsorted.
const MAX_RESETS: u64 = 16;
/// Largest number of consecutive events more than 0.1 s early that count as strays. More of them mean a clock reset.
const MOST_STRAYS: usize = 8;
/// One stray is allowed per this many events, in addition to [`MAX_RESETS`]. More strays mean that the file is
/// unsorted.
const EVENTS_PER_STRAY: u64 = 100;
/// Number of events at the beginning that are examined together to find strays among the first ones.
const BEGINNING: usize = 64;
/// Number of decoded events that are checked and handed on together. A packet of a few kilobytes can contain millions of
/// events, of which every stage would keep several copies.
const MOST_TOGETHER: usize = 1 << 18;
/// Number of events of one polarity at the beginning of a file from which it may be sorted by polarity.
const MANY_OF_A_POLARITY: u64 = 1000;
/// Times beyond ±2⁵⁵ µs (1100 years) are rejected. With at most [`MAX_RESETS`] shifts of twice that, no returned time
/// exceeds 2⁶¹ µs.
const MAX_TIME: i64 = 1 << 55;

/// The largest sensor width or height that can be read.
pub const MAX_SENSOR_SIZE: u16 = Sensor::MOST_PIXELS_A_SIDE;

/// Properties of a recording that are known before its first event is read.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RecordingInformation {
    /// Name of the format.
    pub format: &'static str,
    /// Width and height of the sensor in pixels: [`RecordingOptions::sensor`] if given, else the size in the file.
    pub sensor: Option<Sensor>,
    /// Model and serial number of the camera, as in the file.
    pub camera_name: Option<String>,
    /// Date of the recording, as in the header of the file.
    pub began: Option<String>,
    /// Assumptions and observations of the reader, as sentences for the user.
    pub notes: Vec<String>,
}

/// Decoder of one format: turns bytes into events, in file order.
pub trait Decode: Send {
    /// Appends the next events to `batch`, which is empty, and counts everything else in `report`. Returns `false`
    /// at the end of the file.
    ///
    /// # Errors
    /// Events that were decoded before the error are in `batch` and are valid.
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError>;

    /// Fraction of the file that has been read, 0 to 1, for a progress display; `None` if unknown.
    fn done(&self) -> Option<f64>;
}

/// A file that was opened for its events.
pub struct Opened {
    /// Properties from the header of the file.
    pub information: RecordingInformation,
    /// `true` if times that were taken for nanoseconds could also be microseconds.
    pub is_unit_doubtful: bool,
    /// Decoder at the beginning of the file.
    pub decoder: Box<dyn Decode>,
}

impl Opened {
    /// Returns a file whose unit of time is certain.
    pub fn new(information: RecordingInformation, decoder: impl Decode + 'static) -> Self {
        Self { information, is_unit_doubtful: false, decoder: Box::new(decoder) }
    }
}

/// One pass through a recording.
pub struct EventReader {
    path: PathBuf,
    decoder: Box<dyn Decode>,
    information: RecordingInformation,
    report: ReadReport,
    clock: Option<Clock>,
    /// The first events, until there are enough to find strays among them.
    beginning: Option<Vec<Event>>,
    /// `true` once an event inside the sensor would be outside with x and y exchanged.
    is_upright: bool,
    /// The polarity of all events so far; `None` if there are both.
    only: Option<Polarity>,
    /// The decoder's latest events, and how many of them were checked.
    batch: Vec<Event>,
    checked: usize,
    /// `true` once the decoder has returned its last events.
    is_decoded: bool,
    /// Events that are too early: either strays or the first events after a clock reset.
    early: Vec<Event>,
    decoded: u64,
    /// Number of events that passed all checks.
    admitted: u64,
    /// The events that passed all checks and are not returned yet, sorted by time.
    order: Order,
    /// `true` if no event of the current batch is earlier than one before it.
    is_in_order: bool,
    ended: bool,
    pending: Option<RecordingError>,
    span: Option<Range<i64>>,
    /// Size in bytes of the files, which limits the number of events.
    bytes: Option<u64>,
}

/// Time of the events so far.
struct Clock {
    /// Latest time of an event.
    latest: i64,
    /// Offset in µs added to the file's times since the latest clock reset.
    shift: i64,
}

impl EventReader {
    pub(super) fn new(path: &Path, opened: Opened, options: &RecordingOptions) -> Result<Self, RecordingError> {
        let Opened { mut information, decoder, .. } = opened;
        information.camera_name = information.camera_name.map(|name| visible::name(&name).into_owned());
        if let Some(sensor) = options.sensor {
            if let Some(Sensor { width, height }) = information.sensor.filter(|&own| own != sensor) {
                information.notes.push(format!(
                    "the file states a sensor of {width} x {height} pixels; the requested size, {} x {}, is used",
                    sensor.width, sensor.height
                ));
            }
            information.sensor = Some(sensor);
        }
        if let Some(Sensor { width, height }) = information.sensor
            && !((1..=MAX_SENSOR_SIZE).contains(&width) && (1..=MAX_SENSOR_SIZE).contains(&height))
        {
            let kind = RecordingErrorKind::Sensor { width: width.into(), height: height.into() };
            return Err(RecordingError::new(path, kind));
        }
        Ok(Self {
            path: path.to_owned(),
            decoder,
            information,
            report: ReadReport::default(),
            clock: None,
            beginning: Some(Vec::new()),
            is_upright: false,
            only: None,
            batch: Vec::new(),
            checked: 0,
            is_decoded: false,
            early: Vec::new(),
            decoded: 0,
            admitted: 0,
            order: Order::new(WINDOW),
            is_in_order: true,
            ended: false,
            pending: None,
            span: None,
            bytes: None,
        })
    }

    /// Limits the pass to events with times in `span`, and their number by the size of the files in bytes.
    pub(super) fn limited_to(self, span: Option<Range<i64>>, bytes: Option<u64>) -> Self {
        Self { span, bytes, ..self }
    }

    /// Returns each event as soon as it is decoded. Events that are earlier than one before them get its time.
    pub(super) fn without_delay(self) -> Self {
        Self { order: Order::new(0), ..self }
    }

    /// Properties of the recording.
    pub fn information(&self) -> &RecordingInformation {
        &self.information
    }

    /// Fraction of the recording that has been read, 0 to 1, for a progress display; `None` if unknown.
    pub fn done(&self) -> Option<f64> {
        // Where the requested span ends in the file is unknown.
        if self.span.is_some() { None } else { self.decoder.done() }
    }

    /// Number of events that were read but not returned yet, because an earlier one might follow.
    pub fn waiting(&self) -> usize {
        self.order.count() + self.batch.len().saturating_sub(self.checked)
    }

    /// Counts and corrections of this pass so far; complete once [`Self::next_batch`] has returned `Ok(false)`.
    pub fn report(&self) -> &ReadReport {
        &self.report
    }

    /// Replaces the content of `events` with the next events, at least one. At the end, returns `false` and leaves
    /// `events` empty.
    ///
    /// Times are in microseconds of the file's clock and never decrease within a pass:
    /// - Events up to 0.1 s earlier than the latest one are sorted. More than about a million events in 0.1 s are too
    ///   many for the window: an event that is earlier than one already returned then gets its time.
    /// - A larger step back means that the clock was reset: all later times are shifted so that they continue 1 s
    ///   after the latest event.
    /// - Up to 8 such early events are strays, and dropped, if the events after them continue as before, or if the
    ///   recording ends with them. Strays among the first 64 events, more than 0.1 s away from all that follow, are
    ///   dropped too.
    ///
    /// Events outside the sensor are dropped. [`Self::report`] counts all of this.
    ///
    /// # Errors
    /// The events before an error are returned first. After the error, the pass has ended.
    pub fn next_batch(&mut self, events: &mut Vec<Event>) -> Result<bool, RecordingError> {
        events.clear();
        while events.is_empty() {
            if self.order.pop(self.ended, events) {
                self.report.events += events.len() as u64;
                self.cut(events);
                continue;
            }
            if self.ended {
                return self.pending.take().map_or(Ok(false), Err);
            }
            if self.checked >= self.batch.len() {
                self.decode();
            }
            let batch = std::mem::take(&mut self.batch);
            let start = self.checked;
            self.checked = (start + MOST_TOGETHER).min(batch.len());
            self.ended = self.is_decoded && self.checked == batch.len();
            self.is_in_order = true;
            let mut admitted = self.order.buffer();
            let checked = self.check(batch.get(start..self.checked).unwrap_or_default(), &mut admitted);
            self.batch = batch;
            let checked = checked.and_then(|()| match self.bytes {
                Some(bytes) if self.decoded > most_events(bytes) => Err(RecordingErrorKind::too_many(bytes)),
                _ => Ok(()),
            });
            if let Err(kind) = checked {
                self.ended = true;
                self.pending = Some(RecordingError::new(&self.path, kind));
            }
            let latest = self.clock.as_ref().map_or(i64::MIN, |clock| clock.latest);
            self.order.push(admitted, latest, self.is_in_order, &mut self.report);
        }
        Ok(true)
    }

    /// Decodes the next events of the file.
    fn decode(&mut self) {
        self.checked = 0;
        self.batch.clear();
        match self.decoder.decode(&mut self.batch, &mut self.report) {
            Ok(more) => self.is_decoded = !more,
            Err(error) => {
                self.is_decoded = true;
                self.pending =
                    Some(if self.decoded == 0 && self.batch.is_empty() { error.of_the_start() } else { error });
            }
        }
    }

    /// Removes the events outside the requested span. After its end, nothing more is read.
    fn cut(&mut self, events: &mut Vec<Event>) {
        let Some(Range { start, end }) = self.span else { return };
        if events.last().is_some_and(|event| event.t >= end) {
            self.ended = true;
            self.pending = None;
            self.order.clear();
        }
        let before = events.len();
        events.retain(|event| (start..end).contains(&event.t));
        self.report.events -= (before - events.len()) as u64;
    }

    /// Appends the valid events of `batch` to `events`, in the order of the file. After an error, `events` contains the
    /// events before it.
    fn check(&mut self, batch: &[Event], events: &mut Vec<Event>) -> Result<(), RecordingErrorKind> {
        let Sensor { width, height } = self.information.sensor.unwrap_or(Sensor::new(MAX_SENSOR_SIZE, MAX_SENSOR_SIZE));
        let (mut exchanged, mut is_upright) = (0, self.is_upright);
        let admitted = batch.iter().try_for_each(|&event| {
            self.decoded += 1;
            let exchanged_is_inside = event.y < width && event.x < height;
            if event.x >= width || event.y >= height {
                self.report.out_of_range += 1;
                self.report.no_pixel += u64::from(event.x >= MAX_SENSOR_SIZE || event.y >= MAX_SENSOR_SIZE);
                exchanged += u64::from(exchanged_is_inside);
                return Ok(());
            }
            is_upright |= !exchanged_is_inside;
            self.begin_or_admit(event, events)
        });
        self.is_upright = is_upright;
        self.report.exchanged = if is_upright { 0 } else { self.report.exchanged + exchanged };
        let begun = if self.ended || admitted.is_err() { self.begin(events) } else { Ok(()) };
        let rest = if self.ended { self.end(events) } else { Ok(()) };
        self.admitted += events.len() as u64;
        admitted.and(begun).and(rest)
    }

    /// Keeps `event` among the first events, or admits it.
    #[inline]
    fn begin_or_admit(&mut self, event: Event, events: &mut Vec<Event>) -> Result<(), RecordingErrorKind> {
        if !(-MAX_TIME..=MAX_TIME).contains(&event.t) {
            return Err(self.out_of_range(event.t));
        }
        if let Some(beginning) = &mut self.beginning {
            if beginning.len() < BEGINNING {
                beginning.push(event);
                return Ok(());
            }
            self.begin(events)?;
        }
        self.admit(event, events)
    }

    /// Admits the first events, without the strays before them.
    #[cold]
    fn begin(&mut self, events: &mut Vec<Event>) -> Result<(), RecordingErrorKind> {
        let Some(beginning) = self.beginning.take() else { return Ok(()) };
        let strays = if beginning.len() < BEGINNING { 0 } else { leading_strays(&beginning) };
        self.report.strays += strays as u64;
        beginning.into_iter().skip(strays).try_for_each(|event| self.admit(event, events))
    }

    /// Returns `event` to the caller, or keeps it until it is known to be a stray or the first event after a clock
    /// reset.
    #[inline]
    fn admit(&mut self, event: Event, events: &mut Vec<Event>) -> Result<(), RecordingErrorKind> {
        let clock = self.clock.get_or_insert_with(|| {
            self.only = Some(event.polarity);
            Clock { latest: event.t, shift: 0 }
        });
        let step = clock.latest - (event.t + clock.shift);
        if step > LARGEST_JITTER {
            return self.keep_early(event, events);
        }
        if !self.early.is_empty() {
            self.drop_early(events.len())?;
        }
        self.hand_out(event, events);
        Ok(())
    }

    /// Keeps an event that is too early.
    #[cold]
    fn keep_early(&mut self, event: Event, events: &mut Vec<Event>) -> Result<(), RecordingErrorKind> {
        if self.early.last().is_some_and(|last| event.t < last.t - LARGEST_JITTER) {
            // The early events did not continue either: the clock was reset before them, and this event is
            // another early one.
            self.reset(events)?;
            return self.admit(event, events);
        }
        self.early.push(event);
        if self.early.len() > MOST_STRAYS { self.reset(events) } else { Ok(()) }
    }

    #[inline]
    fn hand_out(&mut self, event: Event, events: &mut Vec<Event>) {
        let Some(clock) = &mut self.clock else { return };
        self.only = self.only.filter(|only| *only == event.polarity);
        let t = event.t + clock.shift;
        if t < clock.latest {
            self.is_in_order = false;
        } else {
            clock.latest = t;
        }
        events.push(Event { t, ..event });
    }

    /// Drops the early events as strays. `waiting` is the number of events that `admitted` does not count yet.
    fn drop_early(&mut self, waiting: usize) -> Result<(), RecordingErrorKind> {
        self.report.strays += self.early.len() as u64;
        self.early.clear();
        if self.report.strays > MAX_RESETS + (self.admitted + waiting as u64) / EVENTS_PER_STRAY {
            return Err(self.out_of_order(self.report.strays));
        }
        Ok(())
    }

    /// Handles early events at the end of the recording: a few of them after many other events are strays.
    fn end(&mut self, events: &mut Vec<Event>) -> Result<(), RecordingErrorKind> {
        let before = self.admitted + events.len() as u64;
        if !self.early.is_empty() && before >= EVENTS_PER_STRAY * self.early.len() as u64 {
            return self.drop_early(events.len());
        }
        self.reset(events)
    }

    /// Treats the early events, if any, as the first ones after a clock reset, and shifts their times and all later
    /// ones.
    fn reset(&mut self, events: &mut Vec<Event>) -> Result<(), RecordingErrorKind> {
        let early = std::mem::take(&mut self.early);
        let (Some(first), Some(clock)) = (early.first(), &mut self.clock) else { return Ok(()) };
        self.report.clock_resets += 1;
        let before = self.admitted + events.len() as u64;
        if let Some(only) = self.only.filter(|_| before > MANY_OF_A_POLARITY)
            && early.iter().all(|event| event.polarity != only)
        {
            return Err(self.sorted_by_polarity(only));
        }
        if self.report.clock_resets > MAX_RESETS {
            return Err(self.out_of_order(self.report.clock_resets));
        }
        clock.latest += PAUSE_AFTER_RESET;
        clock.shift = clock.latest - first.t;
        early.into_iter().for_each(|event| self.hand_out(event, events));
        Ok(())
    }

    #[cold]
    fn out_of_range(&self, t: i64) -> RecordingErrorKind {
        let what =
            format!("its time, {t} µs, is out of range: the file is damaged here, or its times are in another unit");
        RecordingErrorKind::Event { event: self.decoded, what }
    }

    fn sorted_by_polarity(&self, first: Polarity) -> RecordingErrorKind {
        let [first, second] = if first == Polarity::On { ["ON", "OFF"] } else { ["OFF", "ON"] };
        let what = format!(
            "all events up to here are {first}, and earlier events follow, which are {second}: the events are sorted by polarity and must be sorted by time first"
        );
        RecordingErrorKind::Event { event: self.decoded, what }
    }

    fn out_of_order(&self, times: u64) -> RecordingErrorKind {
        let what = format!(
            "time went back by more than 0.1 s {times} times up to here: the events are not in order and must be sorted by time first"
        );
        RecordingErrorKind::Event { event: self.decoded, what }
    }
}

/// Returns the number of strays at the front: the few events before a step in time, forward or back, after which no
/// other step follows.
fn leading_strays(events: &[Event]) -> usize {
    let is_step = |pair: &[Event]| pair[1].t.abs_diff(pair[0].t) > LARGEST_JITTER.unsigned_abs();
    let last = events.windows(2).rposition(is_step).map_or(0, |index| index + 1);
    if last <= MOST_STRAYS { last } else { 0 }
}

#[cfg(test)]
mod tests {
    use evcal_core::event::Polarity;

    use super::*;

    /// Decoder that returns so many of the given events at a time.
    struct Given(Vec<Event>, usize);

    impl Decode for Given {
        fn decode(&mut self, batch: &mut Vec<Event>, _: &mut ReadReport) -> Result<bool, RecordingError> {
            let count = self.0.len().min(self.1);
            batch.extend(self.0.drain(..count));
            Ok(!self.0.is_empty())
        }

        fn done(&self) -> Option<f64> {
            None
        }
    }

    fn reader(events: Vec<Event>, own: Option<Sensor>, wanted: Option<Sensor>) -> EventReader {
        reader_of(events, own, wanted, 2)
    }

    fn reader_of(events: Vec<Event>, own: Option<Sensor>, wanted: Option<Sensor>, together: usize) -> EventReader {
        let information = RecordingInformation { format: "given", sensor: own, ..Default::default() };
        let options = RecordingOptions { sensor: wanted, ..RecordingOptions::default() };
        EventReader::new(Path::new("given"), Opened::new(information, Given(events, together)), &options).unwrap()
    }

    fn at(t: i64) -> Event {
        Event { t, x: 1, y: 2, polarity: Polarity::On }
    }

    /// Returns the times of all events read, the report, and the error at the end.
    fn times(events: Vec<Event>) -> (Vec<i64>, ReadReport, Option<RecordingError>) {
        let mut reader = reader(events, None, None);
        let (mut all, mut batch) = (Vec::new(), Vec::new());
        let error = loop {
            match reader.next_batch(&mut batch) {
                Ok(true) => all.extend(batch.iter().map(|event| event.t)),
                Ok(false) => break None,
                Err(error) => break Some(error),
            }
        };
        assert!(!reader.next_batch(&mut batch).unwrap(), "nothing follows the end or an error");
        (all, reader.report().clone(), error)
    }

    /// A packet with millions of events was handed on whole, and five of them waited for the caller.
    #[test]
    fn large_batches_of_a_decoder_are_handed_on_in_pieces() {
        let truth: Vec<Event> = (0..5 * MOST_TOGETHER as i64 / 2).map(|index| at(index / 7)).collect();
        for together in [1000, MOST_TOGETHER, MOST_TOGETHER + 1, truth.len()] {
            let mut reader = reader_of(truth.clone(), None, None, together);
            let (mut all, mut batch) = (Vec::new(), Vec::new());
            while reader.next_batch(&mut batch).unwrap() {
                assert!((1..=MOST_TOGETHER).contains(&batch.len()));
                all.extend_from_slice(&batch);
            }
            assert!(all == truth && reader.waiting() == 0 && reader.report().events == truth.len() as u64);
        }
    }

    #[test]
    fn small_steps_back_are_sorted() {
        let (times, report, error) = times([5, 10, 8, 9, 10, 12, -20].map(at).to_vec());
        assert_eq!(times, [-20, 5, 8, 9, 10, 10, 12]);
        assert_eq!((report.sorted, report.largest_delay, report.steps_back, report.clock_resets), (3, 32, 0, 0));
        assert!(error.is_none());
    }

    #[test]
    fn after_a_clock_reset_times_continue_one_second_later() {
        let (times, report, error) = times([7_000_000, 7_000_100, 0, 50, 60, 55].map(at).to_vec());
        assert_eq!(times, [7_000_000, 7_000_100, 8_000_100, 8_000_150, 8_000_155, 8_000_160]);
        assert_eq!((report.sorted, report.steps_back, report.clock_resets), (1, 0, 1));
        assert!(error.is_none());
    }

    #[test]
    fn a_few_early_events_are_dropped() {
        let (times, report, error) =
            times([2_000_000, 1_000_010, 2_000_020, 1_000_030, 1_000_031, 2_000_030].map(at).to_vec());
        assert_eq!(times, [2_000_000, 2_000_020, 2_000_030]);
        assert_eq!((report.events, report.strays, report.clock_resets), (3, 3, 0));
        assert!(error.is_none());
        // Too many to be strays.
        let many = (0..60).map(|index| at(if index % 2 == 0 { 2_000_000 + index } else { index }));
        let (times, report, error) = self::times(many.collect());
        assert!(error.unwrap().to_string().contains("sort"));
        assert_eq!((times.len() as u64, report.strays), (report.events, 17));
    }

    /// The first or last events of a camera may have wrong times. That is not a clock reset.
    #[test]
    fn strays_at_the_beginning_and_the_end_are_dropped() {
        let usual = |count: i64| (0..count).map(|index| 5_000_000 + 100 * index);
        for (front, end) in [
            (vec![4_001_000], vec![]),
            (vec![4_001_000, 4_001_010, 4_300_000], vec![]),
            (vec![9_000_000, 9_000_001], vec![]),
            (vec![], vec![4_100_000, 4_100_001]),
            (vec![4_001_000], vec![4_100_000]),
        ] {
            let strays = (front.len() + end.len()) as u64;
            let all = front.into_iter().chain(usual(1000)).chain(end);
            let (times, report, error) = times(all.map(at).collect());
            assert!(times.into_iter().eq(usual(1000)));
            assert_eq!((report.strays, report.clock_resets, report.steps_back), (strays, 0, 0));
            assert!(error.is_none());
        }
        // Among a few events, strays cannot be identified.
        let (times, report, _) = times(vec![at(9_000_000), at(0), at(100), at(1_000_000)]);
        assert_eq!((times.len(), report.strays, report.clock_resets), (4, 0, 1));
    }

    /// If there are more early events at the beginning than can be strays, they belong to the recording.
    #[test]
    fn a_pause_after_the_beginning_does_not_drop_the_beginning() {
        for first in [9, 63, 100] {
            let (times, report, _) = times((0..first).chain(7_000_000..7_000_200).map(at).collect());
            assert_eq!((times.len() as i64, report.strays), (first + 200, 0));
        }
    }

    #[test]
    fn exchanged_coordinates_are_reported() {
        let (sensor, turned) = (Some(Sensor::new(346, 260)), |x, y| Event { x, y, ..at(0) });
        for (events, exchanged, no_pixel) in [
            (vec![turned(3, 4), turned(259, 345), turned(100, 300)], 2, 0),
            // x = 300 is outside a sensor with exchanged sides.
            (vec![turned(3, 4), turned(259, 345), turned(300, 3)], 0, 0),
            (vec![turned(3, 4), turned(u16::MAX, 7)], 0, 1),
        ] {
            let mut reader = reader(events, sensor, None);
            let mut batch = Vec::new();
            while reader.next_batch(&mut batch).unwrap() {}
            let report = reader.report();
            assert_eq!(
                (report.exchanged, report.no_pixel, report.are_coordinates_exchanged()),
                (exchanged, no_pixel, exchanged > 0)
            );
        }
    }

    #[test]
    fn an_unsorted_recording_is_rejected() {
        let events = (0..100).map(|index| at((index * 7 % 10) * 1_000_000)).collect();
        let (times, report, error) = times(events);
        assert!(error.unwrap().to_string().contains("sort"));
        assert!(times.is_sorted() && times.len() as u64 == report.events && report.events > 16);
    }

    #[test]
    fn a_recording_sorted_by_polarity_is_rejected() {
        let run = |polarity| (0..1500).map(move |index| Event { polarity, ..at(index * 1000) });
        let (_, _, error) = times(run(Polarity::On).chain(run(Polarity::Off)).collect());
        assert!(error.unwrap().to_string().contains("follow, which are OFF: the events are sorted by polarity"));
        // Clock resets.
        let both = || run(Polarity::On).zip(run(Polarity::Off)).flat_map(|(on, off)| [on, off]);
        let one_after_both = both().chain(run(Polarity::Off)).collect();
        let both_after_one = run(Polarity::On).chain(both()).collect();
        for events in [one_after_both, both_after_one] {
            let (_, report, error) = times(events);
            assert_eq!((report.clock_resets, error.is_none()), (1, true));
        }
    }

    #[test]
    fn an_impossible_time_ends_the_recording_after_the_events_before_it() {
        for t in [i64::MIN, i64::MAX, 1 << 56] {
            let (times, report, error) = times(vec![at(1), at(2), at(3), at(t), at(5)]);
            assert_eq!((times, report.events), (vec![1, 2, 3], 3));
            assert!(error.unwrap().to_string().contains("event 4"));
        }
    }

    #[test]
    fn events_outside_the_sensor_are_dropped_and_counted() {
        let events: Vec<Event> = [(0, 0), (345, 259), (346, 0), (0, 260), (u16::MAX, u16::MAX), (32_766, 32_766)]
            .map(|(x, y)| Event { x, y, ..at(0) })
            .to_vec();
        for (own, wanted, kept) in [
            (Some((346, 260)), None, 2),
            (None, None, 5),
            (None, Some((1, 1)), 1),
            (Some((346, 260)), Some((347, 261)), 4),
        ] {
            let mut reader = reader(events.clone(), own.map(Sensor::from), wanted.map(Sensor::from));
            let mut batch = Vec::new();
            while reader.next_batch(&mut batch).unwrap() {}
            let report = reader.report();
            assert_eq!((report.events, report.out_of_range), (kept, events.len() as u64 - kept), "{own:?} {wanted:?}");
            assert_eq!(reader.information().notes.is_empty(), own.is_none() || wanted.is_none());
        }
    }

    #[test]
    fn an_impossible_sensor_size_is_rejected() {
        for sensor in [Sensor::new(0, 260), Sensor::new(346, 0), Sensor::new(32_768, 260)] {
            let information =
                RecordingInformation { format: "given", sensor: Some(sensor), ..RecordingInformation::default() };
            let opened = Opened::new(information, Given(Vec::new(), 2));
            assert!(EventReader::new(Path::new("given"), opened, &RecordingOptions::default()).is_err());
        }
    }
}

//! Reconstruction of log-intensity pictures from events.
//!
//! For each pixel, the events before a moment are summed with a leak (time constant τ), and the events after it are
//! summed backwards with opposite sign. The mean of both is the log intensity without its slow changes. Because past
//! and future have the same weight, edges appear at their true position at that moment: the response to a frequency ω
//! is ω² / (ω² + 1/τ²), which has no phase. (The leaky integral alone, as in Scheerlinck et al., ACCV 2018, smears
//! every edge backwards along its path.)
//!
//! A short τ suits fast motion, a long one slow motion, so there is one picture per τ at every moment.

use std::collections::VecDeque;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use rayon::prelude::*;

use crate::picture::Picture;

/// Events later than this many time constants after a moment are ignored.
const REACH: f64 = 3.0;
/// Memory limit in bytes of the pictures that are computed at once, a block. (A picture also needs later events, so the
/// events after a block are processed again in the next one. Large blocks make this rare.)
const BLOCK_BYTES: usize = 128 << 20;
/// Largest number of events of an interval that count: 400 million per second. Files may contain very many events of one time.
const MOST_CHANGES: usize = 1 << 23;
/// Fewest events per second, as a share of the sensor's pixels, of which pictures are made. A board in slow motion causes ten times
/// as many. With timestamps in a wrong unit, seconds become hours.
const LEAST_RATE: f64 = 0.05;
/// Number of equal parts of an interval; all events in one part have the same weight.
const SLOTS: u32 = 128;
/// Largest ratio of the ON and OFF thresholds of a sensor.
const MOST_RATIO: f64 = 8.0;
/// Number of pixels of a sensor whose events count: 4096 × 4096.
const MOST_PIXELS: u32 = 1 << 24;

/// Settings of the reconstruction.
#[derive(Clone, Debug, PartialEq)]
pub struct ReconstructionOptions {
    /// Size of the sensor; events outside it are ignored, and events of pixels after the first 2²⁴.
    pub sensor: Sensor,
    /// Time between pictures in microseconds, at least 1.
    pub interval: u32,
    /// Time constants τ in seconds, at least one millisecond each.
    pub time_constants: Vec<f64>,
    /// Limit of the integral of a pixel in OFF thresholds, so that a hot pixel, or a pixel that missed events, soon
    /// returns to normal.
    pub limit: f32,
    /// Longest time in seconds after a moment whose events count, at least one interval. If it is shorter than three time constants,
    /// the picture is ready sooner, and its edges lag behind their motion.
    pub look_ahead: f64,
    /// Largest number of pictures that are computed at once, at least one. More cost less time each, and arrive later.
    pub at_once: usize,
}

impl ReconstructionOptions {
    /// Returns options for a picture every 20 ms, with time constants for medium, slow and fast motion.
    pub fn new(sensor: Sensor) -> Self {
        let time_constants = vec![0.1, 0.3, 0.05];
        Self { sensor, interval: 20_000, time_constants, limit: 6.0, look_ahead: f64::INFINITY, at_once: usize::MAX }
    }

    /// Returns options for pictures that a person waits for: every 40 ms, each at most 80 ms after its moment.
    pub fn live(sensor: Sensor) -> Self {
        let time_constants = vec![0.05, 0.1];
        Self { interval: 40_000, time_constants, look_ahead: 0.08, at_once: 1, ..Self::new(sensor) }
    }
}

/// The pictures of one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct Moment {
    /// Time in microseconds.
    pub t: i64,
    /// Log intensity in OFF thresholds, one picture per time constant.
    pub pictures: Vec<Picture>,
}

/// A change at one pixel within an interval, in four bytes, because the changes of two seconds wait for their pictures: polarity
/// (bit 0, 1 for ON), slot (bits 1 to 7), pixel (bits 8 to 31).
#[derive(Clone, Copy)]
struct Change(u32);

impl Change {
    /// Returns the change of an event; `None` from pixel [`MOST_PIXELS`] on. `slot` must be less than [`SLOTS`].
    fn new(pixel: u32, slot: u32, polarity: Polarity) -> Option<Self> {
        let on = u32::from(polarity == Polarity::On);
        (pixel < MOST_PIXELS).then_some(Self(pixel << 8 | slot << 1 | on))
    }

    fn pixel(self) -> usize {
        (self.0 >> 8) as usize
    }

    fn slot(self) -> usize {
        (self.0 >> 1 & (SLOTS - 1)) as usize
    }

    fn is_on(self) -> bool {
        self.0 & 1 == 1
    }
}

/// Reconstructs pictures from a stream of events. There are none of times with hardly any events. Pictures are returned up to six times the longest τ after their
/// moment, unless the options limit it; memory grows with the events of that time, not with the length of the recording.
pub struct Reconstruction {
    options: ReconstructionOptions,
    bands: Vec<Band>,
    /// Beginning of the first interval in microseconds.
    start: Option<i64>,
    /// Complete intervals whose pictures are not computed yet, and the events of the intervals after them.
    intervals: VecDeque<Box<[Change]>>,
    /// The interval that events are added to.
    current: Vec<Change>,
    /// Number of intervals whose pictures are computed at once.
    block: usize,
    /// Number of intervals after a block whose events count.
    reach: usize,
}

impl Reconstruction {
    /// Creates a reconstruction at the beginning of a stream. Options out of range are clamped.
    pub fn new(mut options: ReconstructionOptions) -> Self {
        options.interval = options.interval.max(1);
        let size = pixels(options.sensor);
        let bands: Vec<Band> =
            options.time_constants.iter().map(|&tau| Band::new(tau.clamp(1e-3, 100.0), &options, size)).collect();
        let reach = bands.iter().map(|band| band.reach).max().unwrap_or(1);
        let picture_bytes = size.saturating_mul(size_of::<f32>() * bands.len()).max(1);
        let block = (BLOCK_BYTES / picture_bytes).min(options.at_once).clamp(1, reach);
        Self { options, bands, start: None, intervals: VecDeque::new(), current: Vec::new(), block, reach }
    }

    /// Adds events, in order of time, and passes all complete pictures to `each`, in order of time and in blocks, because the
    /// pictures of few events may be too many for the memory. An event earlier than the previous one counts as simultaneous.
    pub fn push(&mut self, events: &[Event], mut each: impl FnMut(Vec<Moment>)) {
        let Sensor { width, height } = self.options.sensor;
        let interval = i64::from(self.options.interval);
        for event in events.iter().filter(|event| event.x < width && event.y < height) {
            let mut start = self.start.unwrap_or(event.t);
            // A long silence ends the pictures; they resume with the next event.
            let silence = interval.saturating_mul((self.intervals.len() + 2 * self.reach) as i64);
            if event.t.saturating_sub(start) > silence {
                self.finish(&mut each);
                start = event.t;
            }
            self.start = Some(start);
            let mut since = event.t.saturating_sub(self.current_start());
            while since >= interval {
                self.close_interval(&mut each);
                since -= interval;
            }
            let pixel = u32::from(event.y) * u32::from(width) + u32::from(event.x);
            let slot = (since.max(0) * i64::from(SLOTS) / interval) as u32;
            if self.current.len() < MOST_CHANGES {
                self.current.extend(Change::new(pixel, slot, event.polarity));
            }
        }
    }

    /// Ends the stream, and passes the remaining pictures to `each`. Later events begin a new stream.
    pub fn finish(&mut self, mut each: impl FnMut(Vec<Moment>)) {
        if self.start.is_some() {
            self.intervals.push_back(std::mem::take(&mut self.current).into());
        }
        while !self.intervals.is_empty() {
            self.make(&mut each);
        }
        self.start = None;
        self.forget();
    }

    /// Forgets the events before the first interval.
    fn forget(&mut self) {
        self.bands.iter_mut().for_each(|band| band.past.fill(0.0));
    }

    fn current_start(&self) -> i64 {
        let elapsed = (self.intervals.len() as i64).saturating_mul(self.options.interval.into());
        self.start.unwrap_or(0).saturating_add(elapsed)
    }

    fn close_interval(&mut self, each: &mut impl FnMut(Vec<Moment>)) {
        self.intervals.push_back(self.current.as_slice().into());
        self.current.clear();
        if self.intervals.len() >= self.block + self.reach {
            self.make(each);
        }
    }

    /// Computes the pictures at the ends of the first intervals, and removes these intervals.
    fn make(&mut self, each: &mut impl FnMut(Vec<Moment>)) {
        let intervals = self.intervals.make_contiguous();
        let block = self.block.min(intervals.len());
        let step = i64::from(self.options.interval);
        let count: usize = intervals.iter().map(|changes| changes.len()).sum();
        let seconds = intervals.len() as f64 * step as f64 * 1e-6;
        if (count as f64) < LEAST_RATE * seconds * pixels(self.options.sensor) as f64 {
            self.start = self.start.map(|start| start.saturating_add(step.saturating_mul(block as i64)));
            self.forget();
            self.intervals.drain(..block);
            return;
        }
        let ratio = on_weight(intervals);
        let pictures: Vec<Vec<Vec<f32>>> =
            self.bands.par_iter_mut().map(|band| band.pictures(intervals, block, ratio)).collect();
        let mut bands: Vec<_> = pictures.into_iter().map(Vec::into_iter).collect();
        let Sensor { width, height } = self.options.sensor;
        let of_band = |band: &mut std::vec::IntoIter<Vec<f32>>| Picture::new(width.into(), height.into(), band.next()?);
        let moments = (0..block).map(|_| {
            let t = self.start.unwrap_or(0).saturating_add(step);
            self.start = Some(t);
            Moment { t, pictures: bands.iter_mut().filter_map(of_band).collect() }
        });
        each(moments.collect());
        self.intervals.drain(..block);
    }
}

fn pixels(sensor: Sensor) -> usize {
    usize::from(sensor.width) * usize::from(sensor.height)
}

/// Returns the number of OFF events per ON event, which is the weight of an ON event, because over time a pixel becomes
/// brighter by as much as darker.
fn on_weight(intervals: &[Box<[Change]>]) -> f32 {
    let all: usize = intervals.iter().map(|changes| changes.len()).sum();
    let on: usize = intervals.iter().map(|changes| changes.iter().filter(|change| change.is_on()).count()).sum();
    let ratio = (all - on) as f64 / on.max(1) as f64;
    ratio.clamp(1.0 / MOST_RATIO, MOST_RATIO) as f32
}

/// State of the pictures of one time constant.
///
/// Within an interval the state does not leak. Instead, weight and limit of an event grow with its time, and at the end
/// of the interval everything is scaled down at once.
struct Band {
    /// Number of future intervals that count.
    reach: usize,
    /// The growth exp(t/τ) from an end of the interval to the middle of each slot.
    growth: [f32; SLOTS as usize],
    /// The leak of a whole interval.
    leak: f32,
    limit: f32,
    /// The integral over the past at the end of the last interval whose picture was computed.
    past: Vec<f32>,
}

impl Band {
    fn new(tau: f64, options: &ReconstructionOptions, size: usize) -> Self {
        let interval = f64::from(options.interval) * 1e-6;
        let growth = |slot: usize| libm::exp((slot as f64 + 0.5) / f64::from(SLOTS) * interval / tau) as f32;
        Self {
            reach: (((REACH * tau).min(options.look_ahead) / interval).ceil() as usize).max(1),
            growth: std::array::from_fn(growth),
            leak: libm::exp(-interval / tau) as f32,
            limit: options.limit.max(0.0),
            past: vec![0.0; size],
        }
    }

    /// Returns the pictures at the ends of the first `block` intervals.
    fn pictures(&mut self, intervals: &[Box<[Change]>], block: usize, on_weight: f32) -> Vec<Vec<f32>> {
        let mut state = vec![0.0; self.past.len()];
        let mut pictures = Vec::with_capacity(block);
        let last = intervals.len().min(block + self.reach);
        for (index, changes) in intervals.iter().enumerate().take(last).skip(1).rev() {
            let slots = |change: &Change| SLOTS as usize - 1 - change.slot();
            self.add(&mut state, changes.iter().rev(), slots, [1.0, -on_weight]);
            if index <= block {
                pictures.push(state.clone());
            }
        }
        // After the last interval there is no future.
        if pictures.len() < block {
            pictures.insert(0, vec![0.0; self.past.len()]);
        }
        pictures.reverse();
        let mut past = std::mem::take(&mut self.past);
        for (picture, changes) in pictures.iter_mut().zip(intervals) {
            self.add(&mut past, changes.iter(), |change| change.slot(), [-1.0, on_weight]);
            for (value, past) in picture.iter_mut().zip(&past) {
                *value = 0.5 * (*value + past);
            }
        }
        self.past = past;
        pictures
    }

    /// Adds the changes of an interval to the state and applies the leak; `weights` are the weights of OFF and ON.
    fn add<'a>(
        &self,
        state: &mut [f32],
        changes: impl Iterator<Item = &'a Change>,
        slot: impl Fn(&Change) -> usize,
        weights: [f32; 2],
    ) {
        for change in changes {
            let growth = self.growth[slot(change)];
            if let Some(value) = state.get_mut(change.pixel()) {
                let limit = self.limit * growth;
                *value = (*value + weights[usize::from(change.is_on())] * growth).max(-limit).min(limit);
            }
        }
        for value in state {
            *value *= self.leak;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SENSOR: Sensor = Sensor { width: 96, height: 4 };
    /// Width of the dark bar in pixels.
    const BAR: f64 = 12.0;

    /// Returns the events of a dark bar that moves over the sensor at `speed` (px/s); its left edge is at column 30 at
    /// `middle` (s). A pixel emits six OFF events at the leading edge and `on` ON events at the trailing edge, while
    /// the edge crosses it.
    fn bar(speed: f64, middle: f64, on: u32) -> Vec<Event> {
        let mut events = Vec::new();
        for (x, y) in (0..SENSOR.height).flat_map(|y| (0..SENSOR.width).map(move |x| (x, y))) {
            let [left, right] = [30.0, 30.0 + BAR].map(|edge| middle + (f64::from(x) - edge) / speed);
            let (dark, bright) = if speed > 0.0 { (right, left) } else { (left, right) };
            for (time, count, polarity) in [(dark, 6, Polarity::Off), (bright, on, Polarity::On)] {
                events.extend((0..count).map(|index| {
                    let t = time + ((f64::from(index) + 0.5) / f64::from(count) - 0.5) / speed.abs();
                    Event { t: (t * 1e6).round() as i64, x, y, polarity }
                }));
            }
        }
        events.retain(|event| event.t >= 0);
        events.sort_by_key(|event| event.t);
        events
    }

    fn moments(options: &ReconstructionOptions, events: &[Event], part: usize) -> Vec<Moment> {
        let mut reconstruction = Reconstruction::new(options.clone());
        let mut moments = Vec::new();
        for part in events.chunks(part) {
            reconstruction.push(part, |block| moments.extend(block));
        }
        reconstruction.finish(|block| moments.extend(block));
        moments
    }

    /// Returns the columns at which a row crosses the level halfway between both sides of each edge.
    fn edges(row: &[f32]) -> [f64; 2] {
        let darkest = (0..row.len()).min_by(|&a, &b| row[a].total_cmp(&row[b])).unwrap();
        let crossing = |outward: isize| {
            let at = |steps: usize| row[darkest.checked_add_signed(outward * steps as isize).unwrap()];
            let brightest = (1..20).map(at).fold(f32::NEG_INFINITY, f32::max);
            let level = 0.5 * (row[darkest] + brightest);
            let before = (0..20).take_while(|&steps| at(steps) < level).last().unwrap();
            let part = (level - at(before)) / (at(before + 1) - at(before));
            darkest as f64 + outward as f64 * (before as f64 + f64::from(part))
        };
        [crossing(-1), crossing(1)]
    }

    #[test]
    fn edges_are_at_their_position_at_the_time_of_the_picture() {
        let options = ReconstructionOptions { limit: 20.0, ..ReconstructionOptions::new(SENSOR) };
        for speed in [150.0, -150.0] {
            let events = bar(speed, 0.4, 6);
            let moments = moments(&options, &events, 100);
            let moment = moments.iter().min_by_key(|moment| (moment.t - 400_000).abs()).unwrap();
            let left = 30.0 + speed * (moment.t as f64 * 1e-6 - 0.4);
            assert_eq!(moment.pictures.len(), 3);
            for (picture, tau) in moment.pictures.iter().zip(&options.time_constants) {
                let row = &picture.values()[..SENSOR.width.into()];
                let found = edges(row);
                for (found, truth) in found.into_iter().zip([left, left + BAR]) {
                    assert!((found - truth).abs() < 0.3, "{speed} px/s, τ {tau} s: {found} px, is {truth} px");
                }
            }
        }
    }

    #[test]
    fn pixels_are_as_bright_after_the_bar_as_before_it() {
        // The same contrast causes twice as many OFF as ON events.
        let options =
            ReconstructionOptions { limit: 20.0, time_constants: vec![0.3], ..ReconstructionOptions::new(SENSOR) };
        let moments = moments(&options, &bar(150.0, 0.6, 3), 1000);
        let moment = moments.iter().min_by_key(|moment| (moment.t - 600_000).abs()).unwrap();
        let left = (30.0 + 150.0 * (moment.t as f64 * 1e-6 - 0.6)) as usize;
        let row = moment.pictures[0].values();
        let (behind, ahead) = (row[left - 4], row[left + BAR as usize + 4]);
        let dark = row[left + BAR as usize / 2];
        assert!((behind - ahead).abs() < 0.5 && dark < behind - 5.0, "{behind} {dark} {ahead}");
    }

    #[test]
    fn pictures_depend_neither_on_the_parts_nor_on_the_threads() {
        let options = ReconstructionOptions::new(SENSOR);
        let events = bar(100.0, 0.5, 6);
        let once = moments(&options, &events, events.len());
        assert!(once.windows(2).all(|pair| pair[1].t - pair[0].t == 20_000));
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        for part in [1, 777] {
            assert!(pool.install(|| moments(&options, &events, part)) == once);
        }
    }

    /// With nanoseconds read as microseconds, four seconds became more than an hour, with a picture of nothing every 20 ms.
    #[test]
    fn times_with_hardly_any_events_have_no_pictures() {
        let options = ReconstructionOptions::new(SENSOR);
        let mut events = bar(200.0, 0.2, 6);
        let whole = moments(&options, &events, 1000).len();
        let slow: Vec<Event> = events.iter().map(|event| Event { t: event.t * 1000, ..*event }).collect();
        // The last events are those of a short time.
        assert!(moments(&options, &slow, 1000).len() < 100);
        // What follows is as if there was nothing before.
        let first = events[0];
        events.splice(0..0, (0..600).map(|index| Event { t: index * 100_000 - 70_000_000, ..first }));
        let after = moments(&options, &events, 1000).len();
        assert!(after.abs_diff(whole) < 60, "{after} {whole}");
    }

    #[test]
    fn a_long_silence_has_no_pictures() {
        let options = ReconstructionOptions::new(SENSOR);
        let mut events = bar(200.0, 0.2, 6);
        let end = events.last().unwrap().t;
        let later: Vec<Event> = events.iter().map(|event| Event { t: event.t + i64::MAX / 2, ..*event }).collect();
        let first = moments(&options, &events, 100);
        assert!(first.last().unwrap().t < end + 20_000);
        events.extend(&later);
        let both = moments(&options, &events, 100);
        assert_eq!(both.len(), 2 * first.len());
        assert!(both[first.len()..].iter().zip(&first).all(|(later, first)| later.pictures == first.pictures));
    }

    #[test]
    fn a_hot_pixel_stays_within_the_limit() {
        let options = ReconstructionOptions::new(SENSOR);
        let hot = |t| Event { t, x: 7, y: 2, polarity: Polarity::On };
        let events: Vec<Event> = (0..500_000).step_by(100).map(hot).collect();
        let moments = moments(&options, &events, 1000);
        let largest = moments.iter().flat_map(|moment| &moment.pictures).flat_map(|picture| picture.values());
        assert!(largest.fold(0.0_f32, |most, value| most.max(value.abs())) <= options.limit);
    }
}

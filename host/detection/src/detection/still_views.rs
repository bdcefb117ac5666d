//! Pictures of a board that blinks in front of a camera at rest.
//!
//! The events are cut into blocks of some hundredths of a second. While camera and board are at rest, all blocks have events at the same
//! pixels; after a motion they are at other pixels. Successive blocks that agree form a view. A block next to a motion is left out,
//! because the motion may reach into it. Pixels of a blinking square send events at every change of the light, pixels of a square that
//! stays dark send none. So the number of events of each pixel is a picture of the board.

pub mod search;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use event_recordings::pictures::{GreyImage, TimedImage};

/// Fewest views of a calibration. So few are enough because the person chose each pose, unlike the poses of frames of a moving camera.
pub const FEWEST_VIEWS: usize = 6;
/// The board is taken for a blinking one if views with it fill at least this share of the time.
pub const LEAST_TIME: f64 = 0.3;
/// Shortest block (µs), in which a light that blinks at 10 Hz changes once.
const BLOCK: i64 = 50_000;
/// Longest time (µs) in which a block must have its events.
const LONGEST_BLOCK: i64 = 1_000_000;
/// A block has at least one event per this number of pixels of the sensor.
const PIXELS_PER_EVENT: usize = 20;
/// Fewest blocks of a view.
const LEAST_BLOCKS: usize = 4;
/// Least correlation of a block with the first of its view. Boards at rest have 0.9 and more, also with ten noise events of each pixel
/// per second; boards in slow motion 0.7 at most after a twentieth of a second.
const LEAST_CORRELATION: f64 = 0.8;
/// Pixels along a side of the squares that are compared.
const COMPARED: usize = 2;
/// Numbers of events below this share of the usual one are taken for noise when blocks are compared.
const NOISE: f64 = 0.4;
/// Largest ratio of variance to mean of the numbers of events in small squares, if the events are noise; 1 without hot pixels.
const MOST_RANDOM: f64 = 1.5;
/// In so short a time (µs) a screen changes at most once.
const MOMENT: i64 = 5_000;
/// A block at least as long as this (µs) contains few changes of the light. It ends between two of them, because a block with a part of
/// a change differs from the others.
const SLOW: i64 = 100_000;
/// The light is changing if the event rate of the last moment is this many times the rate of the block.
const CHANGING: f64 = 3.0;
/// Shortest time (µs) for which the rate of a moment is computed.
const SHORTEST_MOMENT: f64 = 1000.0;
/// Largest number of views that are kept; a calibration needs a tenth of them.
const MOST_VIEWS: usize = 400;
/// Number of events of a white pixel in a picture, as a multiple of the median of the blinking pixels.
const WHITE: f64 = 1.2;
/// One pixel in this number may be hot.
const HOT: usize = 1000;

/// Collects the views of one recording.
#[derive(Debug)]
pub struct StillViews {
    sensor: Sensor,
    block: Block,
    view: Option<OpenView>,
    views: Vec<StillView>,
    /// The block does not end before this time (µs).
    not_before: i64,
    /// `true` if the block was continued because the light was changing.
    has_waited: bool,
    /// `true` if a block differed from the one before.
    has_moved: bool,
}

/// A view: two pictures of the same events.
#[derive(Clone, Debug)]
pub struct StillView {
    /// The numbers of events: what blinks is bright.
    pub counts: TimedImage,
    /// The directions of the changes. In a pattern that alternates with its negative, some pixels become bright while others become dark:
    /// one group is white here and the other black (which one is arbitrary), and pixels without changes are grey.
    pub changes: TimedImage,
}

/// The events of a block by pixel.
#[derive(Clone, Debug)]
struct Block {
    start: i64,
    end: i64,
    events: usize,
    counts: Vec<u32>,
    /// ON minus OFF events of each pixel. The events of a moment count with the opposite sign if they disagree with the sum so far.
    changes: Vec<i32>,
    /// The last moment: its start, and the pixel and sign of each of its events.
    moment: (i64, Vec<Change>),
}

/// The change that an event shows: 1 or -1.
#[derive(Clone, Copy, Debug)]
struct Change {
    pixel: u32,
    sign: i32,
}

/// Largest mean number of a pixel's changes in a moment that are kept. No light changes as much, but files may contain very many events
/// of one time.
const MOST_CHANGES: usize = 16;

/// A view that may continue: blocks that agree.
#[derive(Debug)]
struct OpenView {
    /// The first block, in the form in which blocks are compared.
    first: Vec<f64>,
    /// `true` if the motion before the view may reach into the first block.
    follows_motion: bool,
    /// Number of blocks in the sum.
    blocks: usize,
    sum: Block,
    /// The last block, in which the next motion may have begun.
    last: Block,
}

impl StillViews {
    /// Creates an empty collection for a recording of this sensor.
    pub fn new(sensor: Sensor) -> Self {
        let pixels = usize::from(sensor.width) * usize::from(sensor.height);
        Self {
            sensor,
            block: Block::new(pixels),
            view: None,
            views: Vec::new(),
            not_before: i64::MIN,
            has_waited: false,
            has_moved: false,
        }
    }

    /// Takes the next events, in order of time.
    pub fn push(&mut self, events: &[Event]) {
        for event in events {
            if self.block.events == 0 {
                (self.block.start, self.block.end) = (event.t, event.t);
            }
            let length = event.t.saturating_sub(self.block.start);
            let is_full = self.block.events >= self.fewest_events() && event.t >= self.not_before;
            let ends = is_full && length >= BLOCK || length >= LONGEST_BLOCK;
            if ends && length < LONGEST_BLOCK && self.block.is_noise(self.sensor) {
                self.not_before = event.t.saturating_add(BLOCK / 2);
            } else if ends
                && (SLOW..LONGEST_BLOCK).contains(&length)
                && !self.has_waited
                && self.block.is_changing(event.t)
            {
                self.not_before = event.t.saturating_add(BLOCK / 2);
                self.has_waited = true;
            } else if ends {
                self.has_waited = false;
                self.end_block(is_full);
                (self.block.start, self.block.end) = (event.t, event.t);
            }
            self.block.add(event, self.sensor);
        }
    }

    /// Returns the smallest number of events of the current block: about as many as in the blocks before, because there is only noise
    /// between two changes of the light.
    fn fewest_events(&self) -> usize {
        let usual = self.view.as_ref().map_or(0, |view| (view.sum.events + view.last.events) / (view.blocks + 1));
        (usual / 4 * 3).max(self.block.counts.len() / PIXELS_PER_EVENT)
    }

    /// Returns `true` if camera and board were at rest from the beginning; `None` until that is known.
    pub fn begins_at_rest(&self) -> Option<bool> {
        let blocks = self.view.as_ref().map_or(0, |view| view.blocks);
        match (self.has_moved, !self.views.is_empty() || blocks >= LEAST_BLOCKS) {
            (_, true) => Some(true),
            (true, false) => Some(false),
            (false, false) => None,
        }
    }

    /// Returns the views, in order of time. The exposure of their pictures lasts from the first to the last event (µs).
    pub fn finish(mut self) -> Vec<StillView> {
        if let Some(view) = &mut self.view {
            view.sum.append(&view.last);
            view.blocks += 1;
        }
        self.end_view();
        self.views
    }

    fn end_block(&mut self, is_full: bool) {
        let next = Block::new(self.block.counts.len());
        let mut block = std::mem::replace(&mut self.block, next);
        block.end_moment();
        if !is_full {
            // So few events in the longest block mean that nothing blinks.
            self.has_moved = true;
            self.end_view();
            return;
        }
        let compared = block.compared(self.sensor);
        match &mut self.view {
            Some(view) if correlation(&view.first, &compared) >= LEAST_CORRELATION => {
                if view.follows_motion {
                    *view = OpenView::new(compared, block, false);
                } else {
                    let before = std::mem::replace(&mut view.last, block);
                    view.sum.append(&before);
                    view.blocks += 1;
                }
            }
            other => {
                self.has_moved |= other.is_some();
                self.end_view();
                self.view = Some(OpenView::new(compared, block, self.has_moved));
            }
        }
    }

    fn end_view(&mut self) {
        let view = self.view.take().filter(|view| view.blocks >= LEAST_BLOCKS && self.views.len() < MOST_VIEWS);
        self.views.extend(view.and_then(|view| view.sum.view(self.sensor)));
    }
}

impl OpenView {
    fn new(first: Vec<f64>, last: Block, follows_motion: bool) -> Self {
        let sum = Block { start: last.start, ..Block::new(last.counts.len()) };
        Self { first, follows_motion, blocks: 0, sum, last }
    }
}

/// Duration of a view (s).
pub fn duration(view: &StillView) -> f64 {
    let (start, end) = view.counts.exposure;
    end.saturating_sub(start) as f64 * 1e-6
}

impl Block {
    fn new(pixels: usize) -> Self {
        Self { start: 0, end: 0, events: 0, counts: vec![0; pixels], changes: vec![0; pixels], moment: (0, Vec::new()) }
    }

    fn add(&mut self, event: &Event, sensor: Sensor) {
        let pixel = usize::from(event.y) * usize::from(sensor.width) + usize::from(event.x);
        if event.x < sensor.width
            && let Some(count) = self.counts.get_mut(pixel)
        {
            *count = count.saturating_add(1);
            if event.t.saturating_sub(self.moment.0) >= MOMENT {
                self.end_moment();
                self.moment.0 = event.t;
            }
            if self.moment.1.len() < MOST_CHANGES * self.counts.len() {
                let sign = if event.polarity == Polarity::On { 1 } else { -1 };
                self.moment.1.push(Change { pixel: pixel as u32, sign });
            }
        }
        self.end = event.t;
        self.events += 1;
    }

    /// Adds the changes of the last moment.
    fn end_moment(&mut self) {
        let changes = std::mem::take(&mut self.moment.1);
        let known =
            changes.iter().map(|change| i64::from(change.sign * self.changes.get(change.pixel as usize).unwrap_or(&0)));
        let sign = if known.sum::<i64>() < 0 { -1 } else { 1 };
        for change in &changes {
            if let Some(sum) = self.changes.get_mut(change.pixel as usize) {
                *sum += sign * change.sign;
            }
        }
    }

    fn append(&mut self, other: &Self) {
        self.end = other.end;
        self.events += other.events;
        for (count, other) in self.counts.iter_mut().zip(&other.counts) {
            *count = count.saturating_add(*other);
        }
        let products = self.changes.iter().zip(&other.changes).map(|(a, b)| i64::from(*a) * i64::from(*b));
        let sign = if products.sum::<i64>() < 0 { -1 } else { 1 };
        for (change, other) in self.changes.iter_mut().zip(&other.changes) {
            *change += sign * other;
        }
    }

    /// Returns `true` if the last moment before `now` has far more events than the block on average.
    fn is_changing(&self, now: i64) -> bool {
        let (start, changes) = &self.moment;
        let (moment, block) = (now.saturating_sub(*start) as f64, now.saturating_sub(self.start) as f64);
        changes.len() as f64 * block > CHANGING * self.events as f64 * moment.max(SHORTEST_MOMENT)
    }

    /// Returns `true` if the events are spread at random over the sensor.
    fn is_noise(&self, sensor: Sensor) -> bool {
        let sums = self.sums(sensor);
        let (mut sum, mut squares) = (0.0, 0.0);
        for &count in &sums {
            sum += f64::from(count);
            squares += f64::from(count) * f64::from(count);
        }
        let mean = sum / sums.len().max(1) as f64;
        squares / sum - mean < MOST_RANDOM
    }

    /// Returns the square roots of the numbers of events in small squares, less noise. The roots have the same variance
    /// everywhere.
    fn compared(&self, sensor: Sensor) -> Vec<f64> {
        let sums = self.sums(sensor);
        let noise = NOISE * usual_count(&sums).unwrap_or(0.0);
        sums.iter().map(|&sum| (f64::from(sum) - noise).max(0.0).sqrt()).collect()
    }

    /// Returns the numbers of events in small squares.
    fn sums(&self, sensor: Sensor) -> Vec<u32> {
        let columns = usize::from(sensor.width).div_ceil(COMPARED);
        let rows = usize::from(sensor.height).div_ceil(COMPARED);
        let mut sums = vec![0_u32; columns * rows];
        for (y, row) in self.counts.chunks_exact(usize::from(sensor.width).max(1)).enumerate() {
            for (x, &count) in row.iter().enumerate() {
                if let Some(sum) = sums.get_mut(y / COMPARED * columns + x / COMPARED) {
                    *sum = sum.saturating_add(count);
                }
            }
        }
        sums
    }

    fn view(&self, sensor: Sensor) -> Option<StillView> {
        let white = WHITE * usual_count(&self.counts)?;
        let grey = |level: f64| (level * 255.0).clamp(0.0, 255.0).round() as u8;
        let picture = |pixels: Vec<u8>| {
            let image = GreyImage::new(sensor.width.into(), sensor.height.into(), pixels)?;
            let exposure = (self.start, self.end);
            Some(TimedImage { exposure, exposure_known: true, position: (0, 0), image: Ok(image) })
        };
        let change = |change: &i32| grey(0.5 + 0.5 * f64::from(*change) / white);
        Some(StillView {
            counts: picture(self.counts.iter().map(|count| grey(f64::from(*count) / white)).collect())?,
            changes: picture(self.changes.iter().map(change).collect())?,
        })
    }
}

/// Returns the number of events of a usual pixel (or square of pixels) that blinks: the median of all numbers that are
/// at least half of their mean, after the hot pixels were removed. In this mean, each number has itself as weight.
fn usual_count(counts: &[u32]) -> Option<f64> {
    let mut sorted: Vec<u32> = counts.iter().copied().filter(|count| *count > 0).collect();
    sorted.sort_unstable();
    sorted.truncate(sorted.len() - sorted.len().min(counts.len() / HOT));
    let (sum, squares) = sorted.iter().fold((0.0, 0.0), |(sum, squares), &count| {
        let count = f64::from(count);
        (sum + count, squares + count * count)
    });
    let blinking = sorted.partition_point(|&count| f64::from(count) < 0.5 * squares / sum);
    sorted.get(blinking + (sorted.len() - blinking) / 2).map(|&count| f64::from(count))
}

fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let count = a.len().max(1) as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / count, b.iter().sum::<f64>() / count);
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        ab += a * b;
        aa += a * a;
        bb += b * b;
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const SENSOR: Sensor = Sensor::new(120, 90);
    const SQUARE: f64 = 12.0;

    /// Returns events of `seconds`: a pattern of squares, every other of which blinks with `frequency`, at the position
    /// `place` of the time, and `noise` events per second.
    fn noisy_squares(seconds: f64, frequency: f64, noise: f64, place: impl Fn(f64) -> f64) -> Vec<Event> {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let mut events = Vec::new();
        for flip in 0..(2.0 * seconds * frequency) as usize {
            let t = 0.5 * flip as f64 / frequency;
            let polarity = if flip % 2 == 0 { Polarity::On } else { Polarity::Off };
            for (x, y) in (20..100).flat_map(|x| (20..70).map(move |y| (x, y))) {
                let square = ((f64::from(x) - place(t)) / SQUARE).floor() + (f64::from(y) / SQUARE).floor();
                for _ in 0..if square.rem_euclid(2.0) < 1.0 { random.random_range(1..4) } else { 0 } {
                    let t = ((t + random.random::<f64>() * 0.005) * 1e6) as i64;
                    events.push(Event { t, x, y, polarity });
                }
            }
        }
        for _ in 0..(seconds * noise) as usize {
            let t = (random.random::<f64>() * seconds * 1e6) as i64;
            events.push(Event {
                t,
                x: random.random_range(0..120),
                y: random.random_range(0..90),
                polarity: Polarity::On,
            });
        }
        events.sort_by_key(|event| event.t);
        events
    }

    fn squares(seconds: f64, frequency: f64, place: impl Fn(f64) -> f64) -> Vec<Event> {
        noisy_squares(seconds, frequency, 2000.0, place)
    }

    fn views(events: &[Event]) -> Vec<StillView> {
        let mut views = StillViews::new(SENSOR);
        events.chunks(777).for_each(|events| views.push(events));
        views.finish()
    }

    #[test]
    fn a_view_shows_the_blinking_squares() {
        for frequency in [2.0, 10.0, 50.0] {
            let mut events = squares(2.0, frequency, |_| 0.0);
            // A hot pixel.
            events.iter_mut().step_by(9).for_each(|event| (event.x, event.y) = (3, 4));
            let views = views(&events);
            let [view] = &views[..] else { panic!("{} views at {frequency} Hz", views.len()) };
            assert!(duration(view) > 1.4);
            let image = view.counts.image.as_ref().unwrap();
            let at = |x: usize, y: usize| image.get(x, y).unwrap();
            assert!(at(30, 30) > 150 && at(42, 30) < 20 && at(30, 42) < 20 && at(42, 42) > 150 && at(5, 80) < 20);
        }
    }

    #[test]
    fn a_pattern_that_alternates_with_its_negative_appears_in_the_picture_of_changes() {
        let mut events = Vec::new();
        for (flip, (x, y)) in
            (0..20).flat_map(|flip| (20..100).flat_map(move |x| (20..70).map(move |y| (flip, (x, y)))))
        {
            let is_dark = (f64::from(x) / SQUARE).floor() + (f64::from(y) / SQUARE).floor();
            let polarity = if (is_dark % 2.0 < 1.0) == (flip % 2 == 0) { Polarity::On } else { Polarity::Off };
            events.extend([0, 700].map(|late| Event { t: flip * 50_000 + late, x, y, polarity }));
        }
        events.sort_by_key(|event| event.t);
        let views = views(&events);
        let [view] = &views[..] else { panic!("{} views", views.len()) };
        let at = |picture: &TimedImage, x: usize, y: usize| picture.image.as_ref().unwrap().get(x, y).unwrap();
        assert!(at(&view.counts, 30, 30) == at(&view.counts, 42, 30) && at(&view.counts, 5, 80) == 0);
        let [here, right, below] = [(30, 30), (42, 30), (30, 42)].map(|(x, y)| at(&view.changes, x, y));
        assert!(here.abs_diff(right) > 150 && right == below && at(&view.changes, 5, 80).abs_diff(127) <= 1);
    }

    /// Between two changes of the light there is only noise.
    #[test]
    fn slow_blinking_in_noise_is_a_view() {
        let pixels = f64::from(SENSOR.width) * f64::from(SENSOR.height);
        let views = views(&noisy_squares(3.0, 2.0, 2.0 * pixels, |_| 0.0));
        let [view] = &views[..] else { panic!("{} views", views.len()) };
        assert!(duration(view) > 2.0, "{}", duration(view));
    }

    /// Ten noise events of every pixel per second are usual in dim light. They must not end a view.
    #[test]
    fn noise_does_not_end_a_view() {
        let pixels = f64::from(SENSOR.width) * f64::from(SENSOR.height);
        let views = views(&noisy_squares(1.0, 10.0, 10.0 * pixels, |_| 0.0));
        let [view] = &views[..] else { panic!("{} views", views.len()) };
        assert!(duration(view) > 0.8, "{}", duration(view));
        let place = |t: f64| 20.0 * t;
        assert!(self::views(&noisy_squares(1.0, 10.0, 10.0 * pixels, place)).is_empty());
    }

    #[test]
    fn a_view_ends_when_the_board_moves() {
        // Two views, and a motion between them at 40 px/s.
        let place = |t: f64| ((t - 1.0) * 40.0).clamp(0.0, 30.0);
        let views = views(&squares(3.0, 30.0, place));
        let [before, after] = &views[..] else { panic!("{} views", views.len()) };
        assert!(before.counts.exposure.1 <= 1_200_000 && after.counts.exposure.0 >= 1_600_000);
        let grey = |view: &StillView, x: usize| view.counts.image.as_ref().unwrap().get(x, 30).unwrap();
        assert!(grey(before, 30) > 150 && grey(before, 42) < 20 && grey(after, 36) > 150 && grey(after, 48) < 20);
    }

    #[test]
    fn rest_or_motion_at_the_beginning_is_known_within_0_4_s() {
        let known = |events: &[Event]| {
            let mut views = StillViews::new(SENSOR);
            events.chunks(500).find_map(|events| {
                views.push(events);
                Some((views.begins_at_rest()?, events.last()?.t))
            })
        };
        let (is_at_rest, t) = known(&squares(2.0, 30.0, |_| 0.0)).unwrap();
        assert!(is_at_rest && t < 400_000, "{t}");
        let (is_at_rest, t) = known(&squares(2.0, 30.0, |t| 60.0 * t)).unwrap();
        assert!(!is_at_rest && t < 400_000, "{t}");
        // Noise alone is not a view.
        let noise: Vec<Event> = squares(2.0, 0.1, |_| 0.0).into_iter().filter(|event| event.t > 10_000).collect();
        assert!(views(&noise).is_empty() && known(&noise).is_none_or(|(is_at_rest, _)| !is_at_rest));
    }
}

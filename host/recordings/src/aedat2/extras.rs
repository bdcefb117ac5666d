//! Frames and IMU samples of a DAVIS in AEDAT 2.0.
//!
//! | word | bits |
//! |---|---|
//! | level of a pixel | 31 set; 22–30 row, from below; 12–21 column, from the left (unlike in events); 10–11: 0 after the reset, 1 after the exposure; 0–9 level |
//! | part of an IMU sample | 31, 11 and 10 set; 28–30: 0 to 2 acceleration x, y, z, 3 temperature, 4 to 6 rate about x, y, z; 12–27 value |
//!
//! The brightness of a pixel is the decrease of its level during the exposure (jAER: `DavisChip`, `DavisBaseCamera`,
//! `IMUSample`). Samples are in the axes of the IMU, because jAER's sources contradict each other about its orientation
//! to the sensor.

use std::collections::VecDeque;
use std::path::Path;

use evcal_core::sensor::Sensor;

use super::{Clock, Layout, RECORD, Ranges, is_level, is_sample, start, words};
use crate::bytes::ByteReader;
use crate::error::RecordingError;
use crate::extras::{Extras, Frame, InertialSample, Item, Items, find_streams};
use crate::options::RecordingOptions;
use crate::pictures::NoImage;
use crate::read_report::ReadReport;

/// Names under which the reader of the events counts these words.
pub const LEVELS: &str = "words of frames";
pub const SAMPLES: &str = "words of IMU samples";
/// Number of bytes that are read at a time; a multiple of [`RECORD`].
const BLOCK: u64 = 1 << 15;
/// Number of words per sample.
const PARTS: usize = 7;
/// Value of a word at the end of the range.
const UNITS: f32 = 32_768.0;
const DEGREES_PER_UNIT: f32 = 1.0 / 340.0;
const ZERO_DEGREES: f32 = 35.0;

/// Levels of the pixels of a frame, either after the reset or after the exposure.
struct Levels {
    /// Level of each pixel of the sensor, row by row.
    levels: Vec<Option<u16>>,
    /// Indices of the pixels that have a level. They make small frames cheap: a file may contain very many frames
    /// of few pixels.
    indices: Vec<usize>,
    /// Times of the first and the last level.
    times: Option<(i64, i64)>,
}

impl Levels {
    fn new(sensor: Sensor) -> Self {
        Self { levels: vec![None; sensor.pixel_count()], indices: Vec::new(), times: None }
    }

    fn get(&self, index: usize) -> Option<u16> {
        self.levels.get(index).copied().flatten()
    }

    fn set(&mut self, index: usize, level: u16, t: i64) {
        self.times = Some((self.times.map_or(t, |times| times.0), t));
        if let Some(known) = self.levels.get_mut(index)
            && known.replace(level).is_none()
        {
            self.indices.push(index);
        }
    }

    fn clear(&mut self) {
        for index in self.indices.drain(..) {
            if let Some(level) = self.levels.get_mut(index) {
                *level = None;
            }
        }
        self.times = None;
    }
}

/// A frame whose levels are still being read.
struct Growing {
    sensor: Sensor,
    reset: Levels,
    exposed: Levels,
}

impl Growing {
    fn new(sensor: Sensor) -> Self {
        Self { sensor, reset: Levels::new(sensor), exposed: Levels::new(sensor) }
    }

    /// Adds a level. Returns up to two frames: the previous frame if this level begins another one, and the current
    /// frame if this level completes it.
    fn push(&mut self, word: u32, t: i64) -> [Option<Frame>; 2] {
        let (width, height) = (usize::from(self.sensor.width), usize::from(self.sensor.height));
        let (column, row) = ((word >> 12 & 0x3ff) as usize, (word >> 22 & 0x1ff) as usize);
        let Some(row) = height.checked_sub(1 + row).filter(|_| column < width) else { return [None, None] };
        let (index, level) = (row * width + column, (word & 0x3ff) as u16);
        match word >> 10 & 3 {
            0 => {
                // With a rolling shutter, rows are reset while others are read.
                let again = self.reset.get(index).is_some() && self.exposed.times.is_some();
                let before = if again { self.take() } else { None };
                self.reset.set(index, level, t);
                [before, None]
            }
            1 => {
                self.exposed.set(index, level, t);
                let complete = if self.exposed.indices.len() == width * height { self.take() } else { None };
                [None, complete]
            }
            // A third read, which current cameras do not send.
            _ => [None, None],
        }
    }

    /// Returns the frame if its levels so far fill a rectangle, and begins another one.
    fn take(&mut self) -> Option<Frame> {
        let frame = self.frame();
        self.reset.clear();
        self.exposed.clear();
        frame
    }

    fn frame(&self) -> Option<Frame> {
        let (reset, exposed) = (self.reset.times?, self.exposed.times?);
        let width = usize::from(self.sensor.width).max(1);
        let columns = || self.exposed.indices.iter().map(|index| index % width);
        let rows = || self.exposed.indices.iter().map(|index| index / width);
        let (left, right) = (columns().min()?, columns().max()?);
        let (top, bottom) = (rows().min()?, rows().max()?);
        let value = |index: usize| {
            let fallen = self.reset.get(index)?.saturating_sub(self.exposed.get(index)?);
            // Keeps the upper 8 of 10 bits.
            Some((fallen >> 2) as u8)
        };
        let indices = (top..=bottom).flat_map(|row| (left..=right).map(move |column| row * width + column));
        let pixels = indices.map(value).collect::<Option<Vec<u8>>>()?;
        // With a rolling shutter, resets continue while the first rows are read, so there is no common
        // exposure of all rows.
        let exposure = (reset.1 <= exposed.0).then_some((reset.1, exposed.0));
        let (begin, end) = exposure.unwrap_or((reset.0, exposed.1));
        Some(Frame {
            t: begin.midpoint(end),
            exposure,
            readout: Some((reset.0, exposed.1)),
            size: ((right - left + 1) as u16, (bottom - top + 1) as u16),
            position: (left as u16, top as u16),
            channels: 1,
            pixels,
        })
    }
}

/// An IMU sample whose parts are still being read, in their order.
#[derive(Default)]
struct Sample {
    ranges: Ranges,
    t: i64,
    parts: Vec<f32>,
}

impl Sample {
    /// Adds a part. Returns the sample if the part completes it.
    fn push(&mut self, word: u32, t: i64) -> Option<InertialSample> {
        let part = (word >> 28 & 7) as usize;
        if part == 0 {
            (self.t, self.parts) = (t, Vec::new());
        }
        if part != self.parts.len() {
            // A part was lost, so this sample is discarded.
            self.parts.clear();
            return None;
        }
        self.parts.push(f32::from(((word >> 12 & 0xffff) as u16).cast_signed()));
        let &[ax, ay, az, temperature, gx, gy, gz] = <&[f32; PARTS]>::try_from(self.parts.as_slice()).ok()?;
        self.parts.clear();
        Some(InertialSample {
            t: self.t,
            temperature: temperature * DEGREES_PER_UNIT + ZERO_DEGREES,
            acceleration: [ax, ay, az].map(|value| value * self.ranges.acceleration / UNITS),
            angular_velocity: [gx, gy, gz].map(|value| value * self.ranges.angular_velocity / UNITS),
        })
    }
}

/// Reader of the words of a file, which builds frames and samples from them.
struct Words {
    file: ByteReader,
    clock: Clock,
    frame: Growing,
    sample: Sample,
    block: Vec<u8>,
    /// Complete frames and samples that have not been returned yet, in order.
    waiting: VecDeque<Item>,
    ended: bool,
}

/// Opens the frames and IMU samples of the file at `path`. A camera that is not a DAVIS has none.
pub fn items(path: &Path, options: &RecordingOptions) -> Result<Items, RecordingError> {
    let start = start(path, options)?;
    let Layout::Davis(sensor) = start.layout else { return Ok(Box::new(std::iter::empty())) };
    Ok(Box::new(Words {
        file: start.file,
        clock: start.clock,
        frame: Growing::new(sensor),
        sample: Sample { ranges: start.ranges, ..Sample::default() },
        block: Vec::new(),
        waiting: VecDeque::new(),
        ended: false,
    }))
}

/// Opens the frames and IMU samples of the file at `path`, in the order in which they are complete.
pub fn open(path: &Path, options: &RecordingOptions) -> Result<Extras, RecordingError> {
    let streams = find_streams(items(path, options)?)?;
    Ok(Extras::new(streams, [LEVELS, SAMPLES].map(str::to_owned), items(path, options)?))
}

impl Words {
    /// Reads a block of words.
    fn read(&mut self) -> Result<(), RecordingError> {
        // The reader of the events reports a record that is cut off.
        self.ended = !self.file.read_records::<RECORD>(&mut self.block, BLOCK, &mut ReadReport::default())?;
        for record in self.block.as_chunks().0 {
            let (word, time) = words(*record);
            let t = self.clock.time(time);
            if is_sample(word) {
                self.waiting.extend(self.sample.push(word, t).map(Item::Inertial));
            } else if is_level(word) {
                self.waiting.extend(self.frame.push(word, t).into_iter().flatten().map(item));
            }
        }
        if self.ended {
            self.waiting.extend(self.frame.take().map(item));
        }
        Ok(())
    }
}

impl Iterator for Words {
    type Item = Result<Item, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.waiting.is_empty() && !self.ended {
            if let Err(error) = self.read() {
                return Some(Err(error));
            }
        }
        self.waiting.pop_front().map(Ok)
    }
}

fn item(frame: Frame) -> Item {
    let reason = frame.exposure.is_none().then_some(NoImage::RollingShutter);
    Item::Frame(frame, reason)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extras::{Extra, OtherStreams};
    use crate::pictures::TimedImage;
    use crate::{Recording, testing};

    const SENSOR: Sensor = Sensor::new(240, 180);
    const RESET: u32 = 0;
    const EXPOSED: u32 = 1 << 10;

    /// Returns the word of a level; x counts from the left and y from above.
    fn level(x: u32, y: u32, cycle: u32, level: u32) -> u32 {
        0x8000_0000 | (179 - y) << 22 | x << 12 | cycle | level
    }

    fn sample(t: u32, values: [i16; PARTS]) -> Vec<[u32; 2]> {
        let word = |(part, value): (u32, i16)| 0x8000_0c00 | part << 28 | u32::from(value.cast_unsigned()) << 12;
        (0..).zip(values).map(|part| [word(part), t]).collect()
    }

    /// Returns the words of a frame of 3 x 2 pixels, whose levels are read column by column.
    fn frame(t: u32) -> Vec<[u32; 2]> {
        let pixels = || (0..3).flat_map(|x| (0..2).map(move |y| (x, y)));
        let reset = pixels().zip(t..).map(|((x, y), t)| [level(10 + x, 20 + y, RESET, 900), t]);
        let fallen = |x: u32, y: u32| 4 * (1 + x + 3 * y);
        let exposed =
            pixels().zip(t + 1000..).map(|((x, y), t)| [level(10 + x, 20 + y, EXPOSED, 900 - fallen(x, y)), t]);
        reset.chain(exposed).collect()
    }

    fn event(t: u32) -> [u32; 2] {
        [(179 - 7) << 22 | (239 - 5) << 12 | 1 << 11, t]
    }

    fn recording(records: &[[u32; 2]]) -> (tempfile::TempDir, Recording) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.aedat");
        std::fs::write(&path, file(records)).unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        (directory, recording)
    }

    fn file(records: &[[u32; 2]]) -> Vec<u8> {
        let lines = "#!AER-DAT2.0\r\n# AEChip: eu.seebetter.ini.chips.davis.DAVIS240C\r\n";
        lines.bytes().chain(records.iter().flatten().flat_map(|value| value.to_be_bytes())).collect()
    }

    #[test]
    fn frames_and_samples_are_decoded() {
        // The clock overflows its 32 bits.
        let t = 0x7fff_ff00;
        let records = [
            vec![event(t)],
            frame(t + 10),
            sample(t + 3000, [4096, -4096, 2048, 340, 4096, -4096, 2048]),
            // Two parts are missing, so this is not a sample.
            sample(t + 4000, [1; PARTS])[..5].to_vec(),
            sample(t + 5000, [0; PARTS]),
            frame(t + 6000),
            vec![event(t + 8000)],
        ];
        let (_directory, recording) = recording(&records.concat());
        let mut extras = recording.open_extras().unwrap();
        assert_eq!(extras.streams(), OtherStreams { frames: true, imu: true });
        let t = i64::from(t);
        let picture = |t: i64| Frame {
            t: (t + 5).midpoint(t + 1000),
            exposure: Some((t + 5, t + 1000)),
            readout: Some((t, t + 1005)),
            size: (3, 2),
            position: (10, 20),
            channels: 1,
            pixels: vec![1, 2, 3, 4, 5, 6],
        };
        let zero =
            InertialSample { t: t + 5000, temperature: 35.0, acceleration: [0.0; 3], angular_velocity: [0.0; 3] };
        let first = InertialSample {
            t: t + 3000,
            temperature: 36.0,
            acceleration: [1.0, -1.0, 0.5],
            angular_velocity: [125.0, -125.0, 62.5],
        };
        let mut lost = Vec::new();
        let found: Vec<Extra> = std::iter::from_fn(|| extras.next_until(i64::MAX, &mut lost)).collect();
        let expected = [
            Extra::Inertial(first),
            Extra::Inertial(zero),
            Extra::Frame(picture(t + 10)),
            Extra::Frame(picture(t + 6000)),
        ];
        let in_order = |extras: &[Extra]| {
            let mut sorted = extras.to_vec();
            sorted.sort_by_key(Extra::start);
            sorted
        };
        assert_eq!((in_order(&found), lost), (in_order(&expected), Vec::new()));
        assert_eq!(extras.names, [LEVELS, SAMPLES]);
        let mut count = 0;
        assert_eq!(recording.visit_frames(|_| count += 1).unwrap(), None);
        assert_eq!(count, 2);
        // The events are unaffected.
        let events = testing::read(&file(&records.concat())).events;
        assert_eq!(
            events.iter().map(|event| (event.t - t, event.x, event.y)).collect::<Vec<_>>(),
            [(0, 5, 7), (8000, 5, 7)]
        );
    }

    #[test]
    fn a_frame_with_missing_pixels_is_dropped() {
        let mut records = frame(100);
        records.remove(8);
        let records = [records, frame(5000), vec![event(9000)]].concat();
        let (_directory, recording) = recording(&records);
        let mut times = Vec::new();
        assert_eq!(recording.visit_frames(|image| times.push(image.exposure)).unwrap(), None);
        assert_eq!(times, [(5005, 6000)]);
    }

    /// The cost of a frame must depend on its own pixels, not on the size of the sensor.
    #[test]
    fn the_cost_of_a_frame_depends_on_its_own_pixels_only() {
        let mut frame = Growing::new(SENSOR);
        let memory = (frame.reset.levels.as_ptr(), frame.exposed.levels.as_ptr());
        let pair = |index: u32| [level(10, 7, RESET, 40 + 4 * (index % 200)), level(10, 7, EXPOSED, 40)];
        let words = (0..100_000).flat_map(pair).zip(0..);
        let frames: Vec<Frame> = words.flat_map(|(word, t)| frame.push(word, t)).flatten().collect();
        // The last frame may still be incomplete.
        assert_eq!(frames.len(), 99_999);
        for (frame, index) in frames.iter().zip(0..) {
            assert_eq!((frame.size, frame.position, frame.pixels[0]), ((1, 1), (10, 7), (index % 200) as u8));
            assert_eq!(frame.exposure, Some((2 * index, 2 * index + 1)));
        }
        assert_eq!(memory, (frame.reset.levels.as_ptr(), frame.exposed.levels.as_ptr()));
        assert_eq!((frame.reset.indices.len(), frame.exposed.indices.len()), (1, 1));
    }

    #[test]
    fn a_frame_may_fill_the_sensor() {
        let pixels = || (0..180).flat_map(|y| (0..240).map(move |x| (x, y)));
        let words = |cycle, value: u32, t| pixels().map(move |(x, y)| [level(x, y, cycle, value), t]);
        let records: Vec<[u32; 2]> = words(RESET, 800, 10).chain(words(EXPOSED, 400, 30)).chain([event(40)]).collect();
        let (_directory, recording) = recording(&records);
        let mut sizes = Vec::new();
        let mut take = |image: TimedImage| {
            let image = image.image.unwrap();
            sizes.push((image.width(), image.height()));
        };
        assert_eq!(recording.visit_frames(&mut take).unwrap(), None);
        assert_eq!(sizes, [(SENSOR.width.into(), SENSOR.height.into())]);
        // Row by row: no moment at which all pixels were exposed.
        let rows = (0..180_u32).flat_map(|row| {
            [(RESET, row), (EXPOSED, row + 5)]
                .map(|(cycle, t)| (0..240).map(move |x| [level(x, row, cycle, 500), 100 + t]))
        });
        let mut rows: Vec<[u32; 2]> = rows.flatten().collect();
        rows.sort_by_key(|[word, t]| (*t, *word & EXPOSED));
        let (_directory, recording) = self::recording(&[rows, vec![event(900)]].concat());
        let mut images = Vec::new();
        assert_eq!(recording.visit_frames(|image| images.push(image.image.err())).unwrap(), None);
        assert_eq!(images, [Some(NoImage::RollingShutter)]);
    }

    #[test]
    fn damage_does_not_panic() {
        let records = [frame(100), sample(3000, [1, -2, 3, -4, 5, -6, 7]), (0..20).map(event).collect()].concat();
        let content = file(&records);
        for cut in 0..content.len() {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording.aedat");
            std::fs::write(&path, &content[..cut]).unwrap();
            if let Ok(recording) = Recording::new(&path, RecordingOptions::default()) {
                let _ = recording.visit_frames(|_| {});
                let _ = recording.open_extras();
            }
        }
    }
}

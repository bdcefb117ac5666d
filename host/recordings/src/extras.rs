//! Frames and IMU samples of a recording.

use std::collections::BTreeMap;
use std::path::Path;

use super::counted::counted;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::options::Damage;
use crate::read_report::ReadReport;

/// An image from the camera's frame sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Timestamp in µs, on the clock of the events. Depending on the program that recorded, it is the start or the
    /// middle of the exposure.
    pub t: i64,
    /// Start and end of the exposure in µs, if the file contains them.
    pub exposure: Option<(i64, i64)>,
    /// Start and end of the sensor's read-out in µs, which includes the exposure, if the file contains them.
    pub readout: Option<(i64, i64)>,
    /// Width and height in pixels.
    pub size: (u16, u16),
    /// Column and row of the sensor at the picture's top-left pixel.
    pub position: (u16, u16),
    /// Number of values per pixel: 1 grey, 2 grey and alpha, 3 blue-green-red, 4 with alpha.
    pub channels: usize,
    /// width · height · channels values, row by row.
    pub pixels: Vec<u8>,
}

impl Frame {
    /// Returns the middle of the exposure in µs; the timestamp if the exposure is not known.
    pub fn middle(&self) -> i64 {
        self.exposure.map_or(self.t, |(start, end)| start.midpoint(end))
    }
}

/// A frame with an unsupported pixel encoding.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnreadFrame {
    /// Timestamp in µs, as in [`Frame::t`].
    pub t: i64,
    /// Name of the encoding, such as `32FC1`.
    pub encoding: String,
}

/// One reading of the IMU, in camera axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialSample {
    /// Timestamp in µs, on the clock of the events.
    pub t: i64,
    /// Temperature in °C.
    pub temperature: f32,
    /// Specific force (acceleration minus gravity) along x, y, z in g. Zeros if it was not measured.
    pub acceleration: [f32; 3],
    /// Angular velocities about x, y, z in °/s. Zeros if they were not measured.
    pub angular_velocity: [f32; 3],
}

/// The streams of a recording in addition to its events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OtherStreams {
    /// `true` if there are frames.
    pub frames: bool,
    /// `true` if there are IMU samples.
    pub imu: bool,
}

/// Time in µs that a DAVIS346 takes to read all pixels of a frame, measured in real recordings. It does so once before
/// the exposure and once after it.
pub const READOUT: i64 = 9200;

/// A frame or an IMU sample.
#[derive(Clone, Debug, PartialEq)]
pub enum Extra {
    /// A frame.
    Frame(Frame),
    /// An IMU sample.
    Inertial(InertialSample),
}

impl Extra {
    /// Time at which the element begins, in µs. A frame begins with its read-out (see [`frame_start`]).
    pub fn start(&self) -> i64 {
        match self {
            Self::Frame(frame) => frame_start(frame),
            Self::Inertial(sample) => sample.t,
        }
    }

    /// Returns the element with all times `shift` µs later.
    pub fn later(mut self, shift: i64) -> Self {
        let move_pair = |times: &mut Option<(i64, i64)>| {
            *times = times.map(|(start, end)| (start.saturating_add(shift), end.saturating_add(shift)));
        };
        match &mut self {
            Self::Frame(frame) => {
                frame.t = frame.t.saturating_add(shift);
                move_pair(&mut frame.exposure);
                move_pair(&mut frame.readout);
            }
            Self::Inertial(sample) => sample.t = sample.t.saturating_add(shift),
        }
        self
    }
}

/// Returns the time in µs at which the read-out of a frame begins. If the frame does not contain it, it is estimated as
/// [`READOUT`] before the exposure.
pub fn frame_start(frame: &Frame) -> i64 {
    let exposure_start = frame.exposure.map_or(frame.t, |times| times.0.min(frame.t));
    frame.readout.map_or(exposure_start.saturating_sub(READOUT), |times| times.0.min(exposure_start))
}

/// Reader of frames and IMU samples, in order of time.
pub trait ReadExtras {
    /// Kinds of streams that this reader returns.
    fn streams(&self) -> OtherStreams;

    /// Time at which the first element begins (µs), if it is known in advance.
    fn first_time(&mut self) -> Option<i64>;

    /// Returns the next element that begins at `end` (µs) or earlier. Elements of a live camera are returned once they
    /// are complete. Elements that cannot be read are left out and described in `lost`.
    fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra>;

    /// `true` if this reader returns the packets of `stream`, which the reader of the events only counts.
    fn reads(&self, stream: &str) -> bool;

    /// Names the streams that are returned, in sentences, if the recording has several.
    fn chosen(&self) -> Vec<String> {
        Vec::new()
    }

    /// Names in a sentence a stream of frames that is not returned because it seems to be from another camera.
    fn passed_over(&self) -> Option<String> {
        None
    }

    /// Describes in a sentence the information that the returned elements lack, for example bits per pixel.
    fn lessened(&self) -> Option<&'static str> {
        None
    }
}

/// Name of both kinds together, for messages.
pub const BOTH: &str = "frames and IMU samples";

/// Returns the element that was read. After an error, returns `None` and adds to `lost` that `what` is missing from
/// here on.
pub fn read_or_report<T>(read: Result<Option<T>, RecordingError>, what: &str, lost: &mut Vec<String>) -> Option<T> {
    read.unwrap_or_else(|error| {
        lost.push(format!("{what} from here on: {error}"));
        None
    })
}

/// Treatment of damaged frames and IMU samples, with the number of skipped ones.
#[derive(Debug)]
pub struct Skipped {
    damage: Damage,
    count: u64,
}

impl Skipped {
    /// Creates a count of zero.
    pub fn new(damage: Damage) -> Self {
        Self { damage, count: 0 }
    }

    /// Counts `error` if it is damage that is to be skipped.
    ///
    /// # Errors
    /// Returns any other `error`.
    pub fn add(&mut self, error: RecordingError) -> Result<(), RecordingError> {
        match (&error.kind, self.damage) {
            (RecordingErrorKind::Damaged { .. }, Damage::Skip) => {
                self.count += 1;
                Ok(())
            }
            _ => Err(error),
        }
    }

    /// Adds the number of skipped packets to `lost`, once.
    pub fn report(&mut self, lost: &mut Vec<String>) {
        let count = std::mem::take(&mut self.count);
        if count > 0 {
            lost.push(format!("{} of {BOTH}", counted(count, "damaged packet", "damaged packets")));
        }
    }
}

/// Counts of frames that were passed over because their encoding is not supported.
#[derive(Debug, Default)]
pub struct UnreadFrames {
    /// Number of frames for each encoding.
    counts: BTreeMap<String, u64>,
}

impl UnreadFrames {
    /// Counts a frame.
    pub fn add(&mut self, frame: UnreadFrame) {
        *self.counts.entry(frame.encoding).or_default() += 1;
    }

    /// `true` if no frame was counted.
    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    /// Adds the number of frames of each encoding to `lost`, once.
    pub fn report(&mut self, lost: &mut Vec<String>) {
        let counts = std::mem::take(&mut self.counts).into_iter();
        lost.extend(counts.map(|(encoding, count)| RecordingErrorKind::FrameEncoding { count, encoding }.to_string()));
    }

    /// Returns an error about the most frequent encoding; `None` if no frame was counted.
    pub fn error(self, path: &Path) -> Option<RecordingError> {
        let (encoding, count) = self.counts.into_iter().max_by_key(|(_, count)| *count)?;
        Some(RecordingError::new(path, RecordingErrorKind::FrameEncoding { count, encoding }))
    }
}

/// Returns `next` if it begins at `end` (µs) or earlier, and replaces it by the result of `read`. Elements that cannot
/// be read are described in `lost`.
pub fn take_until(
    next: &mut Option<Extra>,
    end: i64,
    lost: &mut Vec<String>,
    read: impl FnOnce() -> Result<Option<Extra>, RecordingError>,
) -> Option<Extra> {
    next.as_ref().filter(|extra| extra.start() <= end)?;
    let after = read_or_report(read(), BOTH, lost);
    std::mem::replace(next, after)
}

/// Reader for recordings without frames and IMU samples.
pub struct NoExtras;

impl ReadExtras for NoExtras {
    fn streams(&self) -> OtherStreams {
        OtherStreams::default()
    }

    fn first_time(&mut self) -> Option<i64> {
        None
    }

    fn next_until(&mut self, _: i64, _: &mut Vec<String>) -> Option<Extra> {
        None
    }

    fn reads(&self, _: &str) -> bool {
        false
    }
}

/// Describes the content of a recording that `extras` does not return, in sentences.
pub fn left_out(extras: &dyn ReadExtras, report: &ReadReport) -> Vec<String> {
    let mut left_out = Vec::new();
    for (name, count) in &report.other_packets {
        if !extras.reads(name) {
            let unit = if name.contains('(') { " packets of" } else { "" };
            left_out.push(format!("{count}{unit} {name}"));
        }
    }
    left_out.extend(extras.lessened().map(str::to_owned));
    left_out
}

//! What a recording holds beside events: frames and inertial samples.

use std::collections::BTreeMap;
use std::path::Path;

use super::counted::counted;
use crate::error::{RecordingError, RecordingErrorKind};
use crate::options::Damage;
use crate::read_report::ReadReport;

/// A picture of the camera's frame sensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Time stamp in µs, on the clock of the events. Which moment it stands for depends on the program
    /// that recorded: the start or the middle of the exposure.
    pub t: i64,
    /// Start and end of the exposure in µs, where the file gives them.
    pub exposure: Option<(i64, i64)>,
    /// Start and end of reading the sensor in µs, the exposure between them, where the file gives
    /// them.
    pub readout: Option<(i64, i64)>,
    /// Width and height in pixels.
    pub size: (u16, u16),
    /// Column and row of the sensor at which the picture begins.
    pub position: (u16, u16),
    /// Values per pixel: 1 grey, 2 grey and alpha, 3 blue-green-red, 4 with alpha.
    pub channels: usize,
    /// width · height · channels values, row by row.
    pub pixels: Vec<u8>,
}

/// A frame whose pixels are stored in a way that is not read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnreadFrame {
    /// Time stamp in µs, as that of a [`Frame`].
    pub t: i64,
    /// Name of the encoding, such as `32FC1`.
    pub encoding: String,
}

/// One reading of the inertial measurement unit, in camera axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialSample {
    /// Time stamp in µs, on the clock of the events.
    pub t: i64,
    /// Temperature in °C.
    pub temperature: f32,
    /// Accelerations x, y, z less gravity, in g. Zeros where they were not measured.
    pub acceleration: [f32; 3],
    /// Angular velocities about x, y, z in °/s. Zeros where they were not measured.
    pub angular_velocity: [f32; 3],
}

/// Streams beside that of the events.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct OtherStreams {
    /// Frames.
    pub frames: bool,
    /// Inertial samples.
    pub imu: bool,
}

/// Time that a DAVIS346 takes to read the levels of all pixels of a frame, once before the exposure
/// and once after it, in microseconds: as recordings of real ones show.
pub const READOUT: i64 = 9200;

/// A frame or an inertial sample.
#[derive(Clone, Debug, PartialEq)]
pub enum Extra {
    /// A frame.
    Frame(Frame),
    /// An inertial sample.
    Inertial(InertialSample),
}

impl Extra {
    /// When it begins, in µs.
    pub fn start(&self) -> i64 {
        match self {
            Self::Frame(frame) => frame_start(frame),
            Self::Inertial(sample) => sample.t,
        }
    }

    /// The same, `shift` µs later.
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

/// When a frame begins, in µs: where it does not say when its sensor began to be read, before the
/// exposure by the time that a camera takes for that.
pub fn frame_start(frame: &Frame) -> i64 {
    let exposure_start = frame.exposure.map_or(frame.t, |times| times.0.min(frame.t));
    frame.readout.map_or(exposure_start.saturating_sub(READOUT), |times| times.0.min(exposure_start))
}

/// Hands out frames and inertial samples in order of time.
pub trait ReadExtras {
    /// Which kinds there are.
    fn held(&self) -> OtherStreams;

    /// When the first begins (µs), where that is known beforehand.
    fn first_time(&mut self) -> Option<i64>;

    /// The next one that begins at `end` (µs) or before; those of a camera come when they are complete.
    /// What cannot be read is left out and goes to `lost`.
    fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra>;

    /// Of the packets of other streams that a pass through the events passed over: those read here.
    fn reads(&self, stream: &str) -> bool;

    /// Which streams of the recording are handed out, in sentences, where there may be several.
    fn chosen(&self) -> Vec<String> {
        Vec::new()
    }

    /// What this reader leaves out of what it hands over, in a sentence.
    fn lessened(&self) -> Option<&'static str> {
        None
    }
}

/// What readers of both kinds give.
pub const BOTH: &str = "frames and inertial samples";

/// What was read; why it could not be goes to `lost`, where `what` names those that are given up.
pub fn told<T>(read: Result<Option<T>, RecordingError>, what: &str, lost: &mut Vec<String>) -> Option<T> {
    read.unwrap_or_else(|error| {
        lost.push(format!("{what} from here on: {error}"));
        None
    })
}

/// What to do about damaged frames and inertial samples, and how many were passed over.
#[derive(Debug)]
pub struct Skipped {
    damage: Damage,
    count: u64,
}

impl Skipped {
    /// Nothing was passed over yet.
    pub fn new(damage: Damage) -> Self {
        Self { damage, count: 0 }
    }

    /// Counts `error` if it is to be passed over.
    ///
    /// # Errors
    /// `error`, if it is not.
    pub fn add(&mut self, error: RecordingError) -> Result<(), RecordingError> {
        match (&error.kind, self.damage) {
            (RecordingErrorKind::Damaged { .. }, Damage::Skip) => {
                self.count += 1;
                Ok(())
            }
            _ => Err(error),
        }
    }

    /// Tells `lost`, once, how many were passed over.
    pub fn tell(&mut self, lost: &mut Vec<String>) {
        let count = std::mem::take(&mut self.count);
        if count > 0 {
            lost.push(format!("{} of {BOTH}", counted(count, "damaged packet", "damaged packets")));
        }
    }
}

/// Frames that were passed over because their encoding is not read.
#[derive(Debug, Default)]
pub struct UnreadFrames {
    /// How many there are of each encoding.
    counts: BTreeMap<String, u64>,
}

impl UnreadFrames {
    /// Counts a frame.
    pub fn add(&mut self, frame: UnreadFrame) {
        *self.counts.entry(frame.encoding).or_default() += 1;
    }

    /// `true` if there is none.
    pub fn is_empty(&self) -> bool {
        self.counts.is_empty()
    }

    /// Adds to `lost`, once, how many there are of each encoding.
    pub fn tell(&mut self, lost: &mut Vec<String>) {
        let counts = std::mem::take(&mut self.counts).into_iter();
        lost.extend(counts.map(|(encoding, count)| RecordingErrorKind::FrameEncoding { count, encoding }.to_string()));
    }

    /// The error about the most frequent encoding; `None` if there is no such frame.
    pub fn error(self, path: &Path) -> Option<RecordingError> {
        let (encoding, count) = self.counts.into_iter().max_by_key(|(_, count)| *count)?;
        Some(RecordingError::new(path, RecordingErrorKind::FrameEncoding { count, encoding }))
    }
}

/// Takes `next` if it begins at `end` (µs) or before; `read` gives the one behind it. What cannot be read goes to `lost`.
pub fn take_until(
    next: &mut Option<Extra>,
    end: i64,
    lost: &mut Vec<String>,
    read: impl FnOnce() -> Result<Option<Extra>, RecordingError>,
) -> Option<Extra> {
    next.as_ref().filter(|extra| extra.start() <= end)?;
    let after = told(read(), BOTH, lost);
    std::mem::replace(next, after)
}

/// For a target or a recording that has none.
pub struct NoExtras;

impl ReadExtras for NoExtras {
    fn held(&self) -> OtherStreams {
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

/// What a recording holds that `extras` does not hand over, in sentences.
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

//! Frames and IMU samples of a recording.

use std::collections::BTreeMap;
use std::path::Path;

use super::counted::counted;
use crate::error::{RecordingError, RecordingErrorKind, up_to_damage};
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

    /// Returns the frame with the highest row first, if its rows and its position count from below. `rows` is the height
    /// of the sensor; without it the frame is assumed to begin at the lowest row.
    pub(crate) fn flipped(self, rows: Option<u16>) -> Self {
        let (column, row) = self.position;
        let above = row.saturating_add(self.size.1);
        let row = rows.unwrap_or(above).saturating_sub(above);
        let length = usize::from(self.size.0) * self.channels;
        let pixels = self.pixels.chunks_exact(length.max(1)).rev().flatten().copied().collect();
        Self { position: (column, row), pixels, ..self }
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

/// Reason why an image cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoImage {
    /// Its rows were exposed at different times.
    RollingShutter,
    /// Columns were lost in transmission.
    LostColumns,
    /// It is neither grey nor coloured.
    NotGrey,
    /// Its pixel encoding is not supported.
    UnreadEncoding,
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

/// Name of both kinds together, for messages.
pub(crate) const BOTH: &str = "frames and IMU samples";

/// An element of a recording other than an event.
#[derive(Clone, Debug, PartialEq)]
pub enum Item {
    /// A frame. If it cannot be used for a calibration, with the reason.
    Frame(Frame, Option<NoImage>),
    /// A frame whose encoding is not supported.
    Unread(UnreadFrame),
    /// An IMU sample.
    Inertial(InertialSample),
    /// A damaged packet that is skipped as [`Damage::Skip`] requests.
    Skipped,
}

impl Item {
    /// Turns `error` into a skipped packet if it is damage that is to be skipped.
    ///
    /// # Errors
    /// Returns any other `error`.
    pub fn skipped(error: RecordingError, damage: Damage) -> Result<Self, RecordingError> {
        if error.is_skipped(damage) { Ok(Self::Skipped) } else { Err(error) }
    }
}

/// The frames and IMU samples of a file, in the order in which they are read. Nothing after an error is used.
pub type Items = Box<dyn Iterator<Item = Result<Item, RecordingError>>>;

/// Returns the kinds of streams in `items`. Damage ends the search: it is reported when it is read.
pub fn find_streams(mut items: Items) -> Result<OtherStreams, RecordingError> {
    let mut streams = OtherStreams::default();
    while !(streams.frames && streams.imu) {
        match up_to_damage(items.next().transpose())? {
            Some(Item::Frame(..)) => streams.frames = true,
            Some(Item::Inertial(_)) => streams.imu = true,
            Some(Item::Unread(_) | Item::Skipped) => {}
            None => break,
        }
    }
    Ok(streams)
}

/// Reader of the frames and IMU samples of a recording, in order of time. The default has none.
#[derive(Default)]
pub struct Extras {
    /// Kinds of streams that are returned.
    pub(crate) streams: OtherStreams,
    /// Names under which the reader of the events counts the packets that are returned.
    pub(crate) names: Vec<String>,
    /// Sentences that name the streams that are returned, if the recording has several.
    pub(crate) chosen: Vec<String>,
    /// Sentence about a stream of frames that is not returned because it seems to be from another camera.
    pub(crate) passed_over: Option<String>,
    /// Information that the returned elements lack, for example bits per pixel.
    pub(crate) lessened: Option<&'static str>,
    pub(crate) parts: Vec<Part>,
}

/// Elements in order of time, with the next one read in advance.
pub(crate) struct Part {
    items: Items,
    /// What the elements are, for messages.
    what: &'static str,
    next: Option<Extra>,
    /// Number of damaged packets since the last report.
    skipped: u64,
    unread: UnreadFrames,
    /// Description of the error that ended the part, until it is reported.
    lost: Option<String>,
}

impl Part {
    /// Returns the next element, and reads the one after it.
    fn take(&mut self) -> Option<Extra> {
        let after = loop {
            match self.items.next() {
                Some(Ok(Item::Frame(frame, _))) => break Some(Extra::Frame(frame)),
                Some(Ok(Item::Inertial(sample))) => break Some(Extra::Inertial(sample)),
                Some(Ok(Item::Unread(frame))) => self.unread.add(frame),
                Some(Ok(Item::Skipped)) => self.skipped += 1,
                Some(Err(error)) => {
                    self.lost = Some(format!("{} from here on: {error}", self.what));
                    break None;
                }
                None => break None,
            }
        };
        std::mem::replace(&mut self.next, after)
    }

    /// Adds to `lost`, once, the error that ended the part, and at its end the numbers of elements that were passed over.
    fn report(&mut self, lost: &mut Vec<String>) {
        lost.extend(self.lost.take());
        if self.next.is_none() {
            let skipped = std::mem::take(&mut self.skipped);
            if skipped > 0 {
                lost.push(format!("{} of {BOTH}", counted(skipped, "damaged packet", "damaged packets")));
            }
            self.unread.report(lost);
        }
    }
}

impl Extras {
    /// Creates a reader of `items`, which are of these kinds. The reader of the events counts frames and samples under
    /// `names`.
    pub(crate) fn new(streams: OtherStreams, names: [String; 2], items: Items) -> Self {
        let [frames, samples] = names;
        let names = [Some(frames).filter(|_| streams.frames), Some(samples).filter(|_| streams.imu)];
        let mut extras = Self { streams, names: names.into_iter().flatten().collect(), ..Self::default() };
        extras.add(BOTH, None, items);
        extras
    }

    /// Adds elements that are merged with the others in order of time, and begins to read them. Messages call them
    /// `what`; the reader of the events counts them under `name`.
    pub(crate) fn add(&mut self, what: &'static str, name: Option<String>, items: Items) {
        let mut part = Part { items, what, next: None, skipped: 0, unread: UnreadFrames::default(), lost: None };
        part.take();
        self.streams.frames |= matches!(part.next, Some(Extra::Frame(_)));
        self.streams.imu |= matches!(part.next, Some(Extra::Inertial(_)));
        self.names.extend(name.filter(|_| part.next.is_some() || !part.unread.is_empty()));
        self.parts.push(part);
    }

    /// Adds the elements of the file that continues this recording.
    pub(crate) fn followed_by(mut self, file: Self) -> Self {
        self.streams.frames |= file.streams.frames;
        self.streams.imu |= file.streams.imu;
        self.names.extend(file.names);
        self.lessened = self.lessened.or(file.lessened);
        self.parts.extend(file.parts);
        self
    }

    /// Kinds of streams that this reader returns.
    pub fn streams(&self) -> OtherStreams {
        self.streams
    }

    /// Time at which the next element begins (µs).
    pub fn first_time(&self) -> Option<i64> {
        self.parts.iter().filter_map(|part| part.next.as_ref()).map(Extra::start).min()
    }

    /// Returns the next element that begins at `end` (µs) or earlier. Elements that cannot be read are left out and
    /// described in `lost`.
    pub fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra> {
        self.parts.iter_mut().for_each(|part| part.report(lost));
        let begun = |part: &mut Part| part.next.as_ref().map(Extra::start).filter(|start| *start <= end);
        let begun = self.parts.iter_mut().filter_map(|part| Some((begun(part)?, part)));
        begun.min_by_key(|(start, _)| *start)?.1.take()
    }

    /// Names the streams that are returned, in sentences, if the recording has several.
    pub fn chosen(&self) -> Vec<String> {
        self.chosen.clone()
    }

    /// Names in a sentence a stream of frames that is not returned because it seems to be from another camera.
    pub fn passed_over(&self) -> Option<String> {
        self.passed_over.clone()
    }

    /// Describes the content of a recording that is not returned, in sentences. `report` is the report of its events.
    pub fn left_out(&self, report: &ReadReport) -> Vec<String> {
        let others = report.other_packets.iter().filter(|(name, _)| !self.names.contains(name));
        let counts = others.map(|(name, count)| {
            let unit = if name.contains('(') { " packets of" } else { "" };
            format!("{count}{unit} {name}")
        });
        counts.chain(self.lessened.map(str::to_owned)).collect()
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

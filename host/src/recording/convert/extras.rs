//! What a recording holds beside events.

use std::collections::VecDeque;
use std::iter::Peekable;
use std::path::Path;
use std::vec::IntoIter;

use usb_davis::capture::Capture;
use usb_davis::protocol::{ImuSample, Message};

use super::{CAMERA_STREAMS, ConvertError};
use crate::recording::aedat4::other_streams::{Frame, FrameReader, InertialSample, inertial_samples};
use crate::recording::aedat4::write::OtherStreams;
use crate::recording::davis::Messages;
use crate::recording::davis::dump::READOUT;
use crate::recording::{ReadReport, RecordingError, aedat4};

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
    fn start(&self) -> i64 {
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
fn frame_start(frame: &Frame) -> i64 {
    let exposure_start = frame.exposure.map_or(frame.t, |times| times.0.min(frame.t));
    frame.readout.map_or(exposure_start.saturating_sub(READOUT), |times| times.0.min(exposure_start))
}

/// Hands out frames and inertial samples in order of time.
pub enum Extras {
    /// There are none.
    None,
    /// Those of an AEDAT4 file.
    Aedat4 {
        /// Its frames, of which the next one has been read.
        frames: Box<FrameReader>,
        /// That one.
        next: Option<Frame>,
        /// All its inertial samples.
        samples: Peekable<IntoIter<InertialSample>>,
        /// Which of both the file has.
        held: OtherStreams,
    },
    /// Those of a camera.
    Camera {
        /// The stream.
        messages: Box<Messages>,
        /// What it said before its time came.
        waiting: VecDeque<Extra>,
        /// Whether it may say more.
        more: bool,
        /// Which of both it has.
        held: OtherStreams,
    },
}

impl Extras {
    /// For a target or a recording that has none.
    pub fn none() -> Self {
        Self::None
    }

    /// Those of the recording at `path`.
    pub fn open(path: &Path, format: &str) -> Result<Self, RecordingError> {
        if CAMERA_STREAMS.contains(&format) {
            let held = held_by_camera(path)?;
            let messages = Box::new(Messages::open(path)?);
            return Ok(Self::Camera { messages, waiting: VecDeque::new(), more: true, held });
        }
        if format != aedat4::FORMAT.name {
            return Ok(Self::None);
        }
        let mut frames = Box::new(FrameReader::open(path)?);
        // A damaged packet is reported when its turn comes.
        let next = frames.next_frame().unwrap_or_default();
        let samples = inertial_samples(path).unwrap_or_default();
        let held = OtherStreams { frames: next.is_some(), imu: !samples.is_empty() };
        Ok(Self::Aedat4 { frames, next, samples: samples.into_iter().peekable(), held })
    }

    /// Which kinds there are.
    pub fn held(&self) -> OtherStreams {
        match self {
            Self::None => OtherStreams::default(),
            Self::Aedat4 { held, .. } | Self::Camera { held, .. } => *held,
        }
    }

    /// When the first begins, where that is known beforehand.
    pub fn first_time(&mut self) -> Option<i64> {
        match self {
            Self::None | Self::Camera { .. } => None,
            Self::Aedat4 { next, samples, .. } => {
                let frame = next.as_ref().map(frame_start);
                frame.into_iter().chain(samples.peek().map(|sample| sample.t)).min()
            }
        }
    }

    /// The next one that begins at `end` or before; those of a camera come when they are complete.
    /// What cannot be read is left out and goes to `lost`.
    pub fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra> {
        match self {
            Self::None => None,
            Self::Aedat4 { frames, next, samples, .. } => {
                let frame = next.as_ref().map(frame_start).filter(|start| *start <= end);
                let sample = samples.peek().map(|sample| sample.t).filter(|t| *t <= end);
                if sample.is_some() && frame.is_none_or(|start| sample < Some(start)) {
                    return samples.next().map(Extra::Inertial);
                }
                frame?;
                let after = frames.next_frame().unwrap_or_else(|error| {
                    lost.push(format!("frames from here on: {error}"));
                    None
                });
                std::mem::replace(next, after).map(Extra::Frame)
            }
            Self::Camera { messages, waiting, more, .. } => {
                while *more && waiting.is_empty() {
                    // The reader of the events meets the same error and reports it.
                    *more = messages.next(|message, shift| waiting.extend(extra(&message, shift))).unwrap_or(false);
                }
                if waiting.front().is_some_and(|extra| extra.start() <= end) { waiting.pop_front() } else { None }
            }
        }
    }

    /// What the recording holds that was left out, in sentences.
    pub fn left_out(&self, report: &ReadReport) -> Vec<String> {
        let held = self.held();
        let (mut frames, mut imu) = (held.frames, held.imu);
        let mut left_out = Vec::new();
        for (name, count) in &report.other_packets {
            // Only the first stream of each kind is read.
            let kept = match name.as_str() {
                "frames" => std::mem::take(&mut frames),
                "inertial samples" => std::mem::take(&mut imu),
                name if name.ends_with("(FRME)") => std::mem::take(&mut frames),
                name if name.ends_with("(IMUS)") => std::mem::take(&mut imu),
                _ => false,
            };
            if !kept {
                let unit = if name.contains('(') { " packets of" } else { "" };
                left_out.push(format!("{count}{unit} {name}"));
            }
        }
        if held.frames && matches!(self, Self::Camera { .. }) {
            left_out.push("2 of the 10 bits of the frames' pixels".to_owned());
        }
        left_out
    }
}

fn held_by_camera(path: &Path) -> Result<OtherStreams, RecordingError> {
    let mut messages = Messages::open(path)?;
    let mut held = OtherStreams::default();
    while !(held.frames && held.imu)
        && messages.next(|message, _| match message {
            Message::Frame(_) => held.frames = true,
            Message::Imu(_) => held.imu = true,
            _ => {}
        })?
    {}
    Ok(held)
}

/// A message of the camera as AEDAT4 has it.
fn extra(message: &Message<'_>, shift: i64) -> Option<Extra> {
    let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX).saturating_add(shift);
    match message {
        Message::Frame(frame) => {
            let exposure = frame.exposure_start.zip(frame.exposure_end).map(|(start, end)| (time(start), time(end)));
            Some(Extra::Frame(Frame {
                t: time(frame.exposure_middle().unwrap_or(frame.start)),
                exposure,
                readout: Some((time(frame.start), time(frame.end))),
                size: (frame.region.width, frame.region.height),
                position: (frame.region.x, frame.region.y),
                channels: 1,
                pixels: frame.pixels.iter().map(|pixel| (pixel >> 2).min(255) as u8).collect(),
            }))
        }
        Message::Imu(sample) => Some(Extra::Inertial(inertial_sample(sample, time(sample.time)))),
        _ => None,
    }
}

fn inertial_sample(sample: &ImuSample, t: i64) -> InertialSample {
    InertialSample {
        t,
        temperature: sample.temperature_celsius().unwrap_or(0.0),
        acceleration: sample.acceleration_g().unwrap_or_default(),
        angular_velocity: sample.angular_velocity_degrees().unwrap_or_default(),
    }
}

/// When the recording of a camera began, in µs since 1970, if it says so.
pub fn start(path: &Path, format: &str) -> Result<Option<i64>, ConvertError> {
    if !CAMERA_STREAMS.contains(&format) {
        return Ok(None);
    }
    let capture = Capture::open(path).map_err(|error| ConvertError::Capture { path: path.to_owned(), error })?;
    let start = capture.header().start_unix_ns;
    Ok(i64::try_from(start / 1000).ok().filter(|start| *start > 0))
}

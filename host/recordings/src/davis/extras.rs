//! Frames and IMU samples of a DAVIS346's stream.

use std::collections::VecDeque;
use std::path::Path;

use usb_davis::protocol::{ImuSample, Message, Shutter};

use super::Messages;
use crate::error::RecordingError;
use crate::extras::{Extra, Frame, InertialSample, OtherStreams, ReadExtras};
use crate::options::RecordingOptions;
use crate::pictures::{GreyImage, NoImage, TimedImage};

/// Reader of the frames and IMU samples of a recording.
pub struct CameraExtras {
    messages: Messages,
    /// Elements that were read but not returned yet.
    waiting: VecDeque<Extra>,
    /// `true` until the stream ends.
    more: bool,
    streams: OtherStreams,
}

impl CameraExtras {
    /// Opens the recording at `path`.
    pub fn open(path: &Path, options: &RecordingOptions) -> Result<Self, RecordingError> {
        let streams = find_streams(path, options)?;
        Ok(Self { messages: Messages::open(path, options.device)?, waiting: VecDeque::new(), more: true, streams })
    }
}

impl ReadExtras for CameraExtras {
    fn streams(&self) -> OtherStreams {
        self.streams
    }

    fn first_time(&mut self) -> Option<i64> {
        None
    }

    fn next_until(&mut self, end: i64, _: &mut Vec<String>) -> Option<Extra> {
        let Self { messages, waiting, more, .. } = self;
        while *more && waiting.is_empty() {
            // The reader of the events meets the same error and reports it.
            *more = messages.next(|message, shift| waiting.extend(extra(&message, shift))).unwrap_or(false);
        }
        if waiting.front().is_some_and(|extra| extra.start() <= end) { waiting.pop_front() } else { None }
    }

    fn reads(&self, stream: &str) -> bool {
        (stream == super::FRAMES && self.streams.frames) || (stream == super::INERTIAL && self.streams.imu)
    }

    fn lessened(&self) -> Option<&'static str> {
        self.streams.frames.then_some("2 of the 10 bits of the frames' pixels")
    }
}

fn find_streams(path: &Path, options: &RecordingOptions) -> Result<OtherStreams, RecordingError> {
    let mut messages = Messages::open(path, options.device)?;
    let mut streams = OtherStreams::default();
    while !(streams.frames && streams.imu)
        && messages.next_whole(|message, _| match message {
            Message::Frame(_) => streams.frames = true,
            Message::Imu(_) => streams.imu = true,
            _ => {}
        })?
    {}
    Ok(streams)
}

/// Converts a message of the camera, with times `shift` µs later. Frames are reduced to 8 bits.
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

/// Passes the frames of the recording at `path` to `visit`. The inner result is an error if the frames ended early.
pub fn visit_frames(
    path: &Path,
    options: &RecordingOptions,
    visit: &mut dyn FnMut(TimedImage),
) -> Result<Result<(), RecordingError>, RecordingError> {
    let mut messages = Messages::open(path, options.device)?;
    Ok(loop {
        let more = messages.next(|message, shift| {
            if let Message::Frame(frame) = message {
                visit(camera_frame(&frame, shift));
            }
        });
        match more {
            Ok(true) => {}
            Ok(false) => break Ok(()),
            Err(error) => break Err(error),
        }
    })
}

/// Converts a frame of the camera, with times `shift` µs later.
fn camera_frame(frame: &usb_davis::protocol::Frame<'_>, shift: i64) -> TimedImage {
    let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX).saturating_add(shift);
    let exposure = frame.exposure_start.zip(frame.exposure_end).map(|(start, end)| (time(start), time(end)));
    let image = match frame.shutter {
        // Each column has its own exposure, so a calibration with one pose per frame would be wrong.
        Shutter::Rolling => Err(NoImage::RollingShutter),
        Shutter::Global if frame.damaged_columns > 0 => Err(NoImage::LostColumns),
        Shutter::Global => {
            // Keeps 8 of the 10 bits, as in AEDAT4: the lost ones are below the noise.
            let pixels = frame.pixels.iter().map(|pixel| (pixel >> 2).min(255) as u8).collect();
            let (width, height) = (usize::from(frame.region.width), usize::from(frame.region.height));
            GreyImage::new(width, height, pixels).ok_or(NoImage::NotGrey)
        }
    };
    TimedImage {
        exposure: exposure.unwrap_or((time(frame.start), time(frame.start))),
        exposure_known: exposure.is_some(),
        position: (frame.region.x, frame.region.y),
        image,
    }
}

//! Frames and IMU samples of a DAVIS346's stream.

use std::collections::VecDeque;
use std::path::Path;

use usb_davis::protocol::{Message, Shutter};

use super::{FRAMES, INERTIAL, Messages};
use crate::error::RecordingError;
use crate::extras::{Extras, Frame, InertialSample, Item, Items, find_streams};
use crate::options::RecordingOptions;
use crate::pictures::NoImage;

/// Reader of the frames and IMU samples of a recording.
struct CameraItems {
    messages: Messages,
    /// Elements that were read but not returned yet.
    waiting: VecDeque<Result<Item, RecordingError>>,
    /// `true` until the stream ends.
    more: bool,
}

/// Opens the frames and IMU samples of the recording at `path`.
pub fn items(path: &Path, options: &RecordingOptions) -> Result<Items, RecordingError> {
    Ok(Box::new(CameraItems { messages: Messages::open(path, options.device)?, waiting: VecDeque::new(), more: true }))
}

/// Opens the frames and IMU samples of the recording at `path`, up to an error, which the reader of the events reports.
pub fn open(path: &Path, options: &RecordingOptions) -> Result<Extras, RecordingError> {
    let streams = find_streams(items(path, options)?)?;
    let whole = items(path, options)?.map_while(Result::ok).map(Ok);
    Ok(Extras {
        lessened: streams.frames.then_some("2 of the 10 bits of the frames' pixels"),
        ..Extras::new(streams, [FRAMES, INERTIAL].map(str::to_owned), Box::new(whole))
    })
}

impl Iterator for CameraItems {
    type Item = Result<Item, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let Self { messages, waiting, more } = self;
        while *more && waiting.is_empty() {
            match messages.next(|message, shift| waiting.extend(item(&message, shift).map(Ok))) {
                Ok(is_more) => *more = is_more,
                Err(error) => {
                    *more = false;
                    waiting.push_back(Err(error));
                }
            }
        }
        waiting.pop_front()
    }
}

/// Converts a message of the camera, with times `shift` µs later. Frames are reduced to 8 bits, as in AEDAT4: the others
/// are below the noise.
fn item(message: &Message<'_>, shift: i64) -> Option<Item> {
    let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX).saturating_add(shift);
    match message {
        Message::Frame(frame) => {
            let exposure = frame.exposure_start.zip(frame.exposure_end).map(|(start, end)| (time(start), time(end)));
            let reason = match frame.shutter {
                // Each column has its own exposure, so a calibration with one pose per frame would be wrong.
                Shutter::Rolling => Some(NoImage::RollingShutter),
                Shutter::Global => (frame.damaged_columns > 0).then_some(NoImage::LostColumns),
            };
            let frame = Frame {
                t: time(frame.exposure_middle().unwrap_or(frame.start)),
                exposure,
                readout: Some((time(frame.start), time(frame.end))),
                size: (frame.region.width, frame.region.height),
                position: (frame.region.x, frame.region.y),
                channels: 1,
                pixels: frame.pixels.iter().map(|pixel| (pixel >> 2).min(255) as u8).collect(),
            };
            Some(Item::Frame(frame, reason))
        }
        Message::Imu(sample) => Some(Item::Inertial(InertialSample {
            t: time(sample.time),
            temperature: sample.temperature_celsius().unwrap_or(0.0),
            acceleration: sample.acceleration_g().unwrap_or_default(),
            angular_velocity: sample.angular_velocity_degrees().unwrap_or_default(),
        })),
        _ => None,
    }
}

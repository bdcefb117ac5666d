//! Grey pictures of a recording, with the times of their exposure.

use usb_davis::protocol::{Message, Shutter};

use crate::source::aedat4::other_streams::{Frame, FrameReader};
use crate::source::davis::Messages;
use crate::source::{Recording, SourceError, aedat4, davis};

/// A grey picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GreyImage {
    width: usize,
    /// Values row by row, 0 dark to 255.
    pub pixels: Vec<u8>,
}

impl GreyImage {
    /// A picture of `width` × `height` pixels; `None` if there are not as many, or none.
    pub fn new(width: usize, height: usize, pixels: Vec<u8>) -> Option<Self> {
        (!pixels.is_empty() && Some(pixels.len()) == width.checked_mul(height)).then_some(Self { width, pixels })
    }

    /// Number of columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.pixels.len() / self.width
    }

    /// The value of a pixel of the image.
    pub fn get(&self, x: usize, y: usize) -> Option<u8> {
        if x < self.width { self.pixels.get(y * self.width + x).copied() } else { None }
    }
}

/// A picture of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TimedImage {
    /// Start and end of the exposure in µs on the clock of the recording's events; where the recording
    /// does not give them, both are the time of the picture.
    pub exposure: (i64, i64),
    /// Whether the recording gave the exposure.
    pub exposure_known: bool,
    /// Column and row of the sensor at which the picture begins.
    pub position: (u16, u16),
    /// The picture, or why it cannot be used.
    pub image: Result<GreyImage, &'static str>,
}

impl From<Frame> for TimedImage {
    fn from(frame: Frame) -> Self {
        let (width, height) = (usize::from(frame.size.0), usize::from(frame.size.1));
        let grey = match frame.channels {
            1 => frame.pixels,
            // Blue, green, red (and alpha), weighed as ITU-R BT.601 does.
            3 | 4 => frame
                .pixels
                .chunks_exact(frame.channels)
                .map(|pixel| match *pixel {
                    [blue, green, red, ..] => {
                        let sum = 299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue);
                        ((sum + 500) / 1000).min(255) as u8
                    }
                    _ => 0,
                })
                .collect(),
            _ => Vec::new(),
        };
        Self {
            exposure: frame.exposure.unwrap_or((frame.t, frame.t)),
            exposure_known: frame.exposure.is_some(),
            position: frame.position,
            image: GreyImage::new(width, height, grey).ok_or("no grey or colour picture"),
        }
    }
}

/// Whether recordings of this format can hold frames.
pub fn may_hold_frames(format: &str) -> bool {
    [aedat4::FORMAT.name, davis::FORMAT.name, davis::BARE_FORMAT.name].contains(&format)
}

/// Hands the frames of `recording` to `visit`, in their order. What could not be read is returned in a
/// sentence; it ends the frames, not the calibration.
///
/// # Errors
/// When the file cannot be opened.
pub fn visit_frames(recording: &Recording, mut visit: impl FnMut(TimedImage)) -> Result<Option<String>, SourceError> {
    let format = recording.format();
    if !may_hold_frames(format) {
        return Ok(None);
    }
    if format == aedat4::FORMAT.name {
        let mut reader = FrameReader::open(recording.path())?;
        return Ok(loop {
            match reader.next_frame() {
                Ok(Some(frame)) => visit(frame.into()),
                Ok(None) => break None,
                Err(error) => break Some(format!("frames were read up to their damage only: {error}")),
            }
        });
    }
    let mut messages = Messages::open(recording.path())?;
    Ok(loop {
        let more = messages.next(|message, shift| {
            if let Message::Frame(frame) = message {
                visit(camera_frame(&frame, shift));
            }
        });
        match more {
            Ok(true) => {}
            Ok(false) => break None,
            Err(error) => break Some(format!("frames were read up to their damage only: {error}")),
        }
    })
}

/// A frame as a camera sends it, times `shift` µs later.
fn camera_frame(frame: &usb_davis::protocol::Frame<'_>, shift: i64) -> TimedImage {
    let time = |time: u64| i64::try_from(time).unwrap_or(i64::MAX).saturating_add(shift);
    let exposure = frame.exposure_start.zip(frame.exposure_end).map(|(start, end)| (time(start), time(end)));
    let image = match frame.shutter {
        // Every column has a time of its own; a calibration that gives a frame one pose would be wrong.
        Shutter::Rolling => Err("rolling shutter"),
        Shutter::Global if frame.damaged_columns > 0 => Err("lost columns"),
        Shutter::Global => {
            // 8 of the 10 bits, as AEDAT4 keeps them: what is lost is below the noise.
            let pixels = frame.pixels.iter().map(|pixel| (pixel >> 2).min(255) as u8).collect();
            let (width, height) = (usize::from(frame.region.width), usize::from(frame.region.height));
            GreyImage::new(width, height, pixels).ok_or("no grey or colour picture")
        }
    };
    TimedImage {
        exposure: exposure.unwrap_or((time(frame.start), time(frame.start))),
        exposure_known: exposure.is_some(),
        position: (frame.region.x, frame.region.y),
        image,
    }
}

//! Grey images of a recording, with their exposure times.

use std::path::Path;

use crate::error::RecordingError;
pub use crate::extras::NoImage;
use crate::extras::{Frame, Item, Items, UnreadFrame, UnreadFrames};
use crate::image_file::{ImageFile, Samples};

/// A grey image of 8 bits per pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GreyImage {
    width: usize,
    /// Values row by row, from 0 (dark) to 255.
    pub pixels: Vec<u8>,
}

impl GreyImage {
    /// Creates an image of `width` × `height` pixels; `None` if `pixels` has another length or is empty.
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

    /// Value of a pixel; `None` outside the image.
    pub fn get(&self, x: usize, y: usize) -> Option<u8> {
        if x < self.width { self.pixels.get(y.saturating_mul(self.width).saturating_add(x)).copied() } else { None }
    }
}

/// Reduces 16-bit samples to 8 bits: the highest 8 bits in use, because many cameras use only 10 or 12.
pub fn highest_bits(samples: &[u16]) -> Vec<u8> {
    let highest = samples.iter().copied().max().unwrap_or(0);
    let unused = (16 - highest.leading_zeros()).saturating_sub(8);
    samples.iter().map(|sample| (sample >> unused) as u8).collect()
}

impl Frame {
    /// Returns the image of a file as a frame with the timestamp `t` (µs), without alpha; `None` if a side is longer than
    /// 65535 pixels. Of 16 bits, the highest 8 bits in use are kept.
    pub(crate) fn of_file(ImageFile { size, channels, samples }: ImageFile, t: i64) -> Option<Self> {
        let size = (u16::try_from(size.0).ok()?, u16::try_from(size.1).ok()?);
        let bytes = match samples {
            Samples::Eight(samples) => samples,
            Samples::Sixteen(samples) => highest_bits(&samples),
        };
        let (channels, pixels) = match channels {
            1 => (1, bytes),
            2 => (1, bytes.as_chunks::<2>().0.iter().map(|[grey, _]| *grey).collect()),
            3 => (3, bytes.as_chunks().0.iter().flat_map(|&[red, green, blue]| [blue, green, red]).collect()),
            4 => (3, bytes.as_chunks().0.iter().flat_map(|&[red, green, blue, _]| [blue, green, red]).collect()),
            _ => return None,
        };
        Some(Self { t, exposure: None, readout: None, size, position: (0, 0), channels, pixels })
    }
}

/// Luma of a coloured pixel, with the weights of ITU-R BT.601.
pub fn brightness(red: u8, green: u8, blue: u8) -> u8 {
    let sum = 299 * u32::from(red) + 587 * u32::from(green) + 114 * u32::from(blue);
    ((sum + 500) / 1000).min(255) as u8
}

/// An image of a recording, with its exposure.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TimedImage {
    /// Start and end of the exposure in µs on the clock of the recording's events. If the recording does not contain
    /// them, both are the timestamp of the image.
    pub exposure: (i64, i64),
    /// `true` if the recording contains the exposure.
    pub exposure_known: bool,
    /// Column and row of the sensor at the image's top-left pixel.
    pub position: (u16, u16),
    /// The image, or the reason why it cannot be used.
    pub image: Result<GreyImage, NoImage>,
}

/// Passes the frames among `items`, which are of the file at `path`, to `visit`.
///
/// # Errors
/// If the frames ended early, or some have an unsupported encoding.
pub fn visit_frames(items: Items, path: &Path, visit: &mut dyn FnMut(TimedImage)) -> Result<(), RecordingError> {
    let mut unread = UnreadFrames::default();
    for item in items {
        match item? {
            Item::Frame(frame, None) => visit(frame.into()),
            Item::Frame(frame, Some(reason)) => visit(TimedImage { image: Err(reason), ..frame.into() }),
            Item::Unread(frame) => {
                visit((&frame).into());
                unread.add(frame);
            }
            Item::Inertial(_) | Item::Skipped => {}
        }
    }
    unread.error(path).map_or(Ok(()), Err)
}

impl From<&UnreadFrame> for TimedImage {
    fn from(frame: &UnreadFrame) -> Self {
        let image = Err(NoImage::UnreadEncoding);
        Self { exposure: (frame.t, frame.t), exposure_known: false, position: (0, 0), image }
    }
}

impl From<Frame> for TimedImage {
    fn from(frame: Frame) -> Self {
        let (width, height) = (usize::from(frame.size.0), usize::from(frame.size.1));
        let grey = match frame.channels {
            1 => frame.pixels,
            // Blue, green, red, and alpha.
            3 | 4 => frame
                .pixels
                .chunks_exact(frame.channels)
                .map(|pixel| match *pixel {
                    [blue, green, red, ..] => brightness(red, green, blue),
                    _ => 0,
                })
                .collect(),
            _ => Vec::new(),
        };
        Self {
            exposure: frame.exposure.unwrap_or((frame.t, frame.t)),
            exposure_known: frame.exposure.is_some(),
            position: frame.position,
            image: GreyImage::new(width, height, grey).ok_or(NoImage::NotGrey),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use usb_davis::configuration::Configuration;
    use usb_davis::protocol::{Frame as WireFrame, Region, Shutter};

    use super::*;
    use crate::davis::dump::{COMPRESSION, DumpEncoder, davis346_header};
    use crate::{Recording, RecordingOptions};

    #[test]
    fn frames_are_read_as_sent_and_a_rolling_shutter_is_reported() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.dvraw");
        let header = davis346_header("test", &Configuration::calibration());
        let mut encoder = DumpEncoder::new(File::create(&path).unwrap(), header, COMPRESSION).unwrap();
        let pixels: Vec<u16> = (0..346 * 260).map(|index| (index % 1000) as u16).collect();
        for (start, shutter) in [(0, Shutter::Global), (40_000, Shutter::Rolling)] {
            encoder.frame(&WireFrame {
                shutter,
                start,
                end: start + 22_400,
                exposure_start: Some(start + 9200),
                exposure_end: Some(start + 13_200),
                exposure_cycles: 0,
                region: Region { x: 0, y: 0, width: 346, height: 260 },
                damaged_columns: 0,
                pixels: &pixels,
            });
        }
        encoder.advance(100_000).unwrap();
        encoder.finish().unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        // The number of frames is known at the end of the events.
        let (mut reader, mut batch) = (recording.open().unwrap(), Vec::new());
        assert_eq!(reader.report().frames, None);
        while reader.next_batch(&mut batch).unwrap() {}
        assert_eq!(reader.report().frames, Some(2));
        let mut images = Vec::new();
        assert_eq!(recording.visit_frames(|image| images.push(image)).unwrap(), None);
        let [global, rolling] = &images[..] else { panic!("{} images", images.len()) };
        assert_eq!((global.exposure, global.exposure_known), ((9200, 13_200), true));
        let image = global.image.as_ref().unwrap();
        assert_eq!((image.width(), image.height()), (346, 260));
        assert!(image.pixels.iter().zip(&pixels).all(|(eight, ten)| u16::from(*eight) == ten / 4));
        assert_eq!(rolling.image, Err(NoImage::RollingShutter));
        assert_eq!(recording.image_at(9201).as_ref(), Some(global));
        assert_eq!(recording.image_at(9300), None);
    }

    #[test]
    fn colours_become_grey_and_an_image_of_other_channels_is_rejected() {
        let frame = |channels, pixels| Frame {
            t: 7,
            exposure: None,
            readout: None,
            size: (2, 1),
            position: (3, 4),
            channels,
            pixels,
        };
        let grey = TimedImage::from(frame(3, vec![10, 20, 30, 255, 255, 255]));
        // 0.114 · 10 + 0.587 · 20 + 0.299 · 30 = 21.85.
        assert_eq!(grey.image, GreyImage::new(2, 1, vec![22, 255]).ok_or(NoImage::NotGrey));
        assert_eq!((grey.exposure, grey.exposure_known, grey.position), ((7, 7), false, (3, 4)));
        assert!(TimedImage::from(frame(2, vec![0; 4])).image.is_err());
    }
}

//! Decoder of the image in a message: plain pixels, pixels of a Bayer pattern, or a JPEG or PNG file.

use super::bayer;
use super::fields::{Fields, MessageError, Wire};
use super::message::Kind;
use crate::extras::Frame;
use crate::image_file::{self, ImageFileError, Samples};
use crate::pictures::highest_bits;

/// Format of the pixels of an `Image`. All encodings of `sensor_msgs` that are images are supported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pixels {
    layout: Layout,
    /// Size of a sample in bytes: 1 or 2.
    bytes: usize,
}

/// Layout of the samples of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    /// One grey sample. A separate plane with colours (NV21, NV24) is ignored.
    Grey,
    /// One sample of a Bayer pattern.
    Mosaic,
    /// Two samples: the brightness at this index, and a colour that two pixels share.
    Yuv422 { brightness: usize },
    /// Three or four samples: blue, green, red (or red, green, blue), and alpha.
    Colours { samples: usize, red_first: bool },
}

impl Pixels {
    fn of_encoding(encoding: &[u8]) -> Option<Self> {
        let encoding = encoding.to_ascii_lowercase();
        let colours = |samples, red_first| Layout::Colours { samples, red_first };
        let (layout, bytes) = match encoding.trim_ascii() {
            b"mono8" | b"8uc1" | b"nv21" | b"nv24" => (Layout::Grey, 1),
            b"mono16" | b"16uc1" => (Layout::Grey, 2),
            b"bgr8" | b"8uc3" => (colours(3, false), 1),
            b"bgr16" | b"16uc3" => (colours(3, false), 2),
            b"rgb8" => (colours(3, true), 1),
            b"rgb16" => (colours(3, true), 2),
            b"bgra8" | b"8uc4" => (colours(4, false), 1),
            b"bgra16" | b"16uc4" => (colours(4, false), 2),
            b"rgba8" => (colours(4, true), 1),
            b"rgba16" => (colours(4, true), 2),
            b"bayer_rggb8" | b"bayer_bggr8" | b"bayer_gbrg8" | b"bayer_grbg8" => (Layout::Mosaic, 1),
            b"bayer_rggb16" | b"bayer_bggr16" | b"bayer_gbrg16" | b"bayer_grbg16" => (Layout::Mosaic, 2),
            b"uyvy" | b"yuv422" => (Layout::Yuv422 { brightness: 1 }, 1),
            b"yuyv" | b"yuv422_yuy2" => (Layout::Yuv422 { brightness: 0 }, 1),
            _ => return None,
        };
        Some(Self { layout, bytes })
    }

    /// Number of samples per pixel.
    fn samples(self) -> usize {
        match self.layout {
            Layout::Grey | Layout::Mosaic => 1,
            Layout::Yuv422 { .. } => 2,
            Layout::Colours { samples, .. } => samples,
        }
    }

    fn is_mosaic(self) -> bool {
        self.layout == Layout::Mosaic
    }
}

/// `true` if images of this encoding may be depth images, which contain distances in millimetres or metres.
pub fn may_be_distances(encoding: &str) -> bool {
    ["16UC1", "32FC", "64FC"].iter().any(|of_distances| encoding.starts_with(of_distances))
}

/// Properties of an image message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Time of the image in µs.
    pub t: i64,
    /// Width and height of an `Image` in pixels; `None` for a `CompressedImage`.
    pub size: Option<(u32, u32)>,
    /// Encoding of an `Image`, or format of a `CompressedImage`.
    pub encoding: String,
}

/// Reads the properties of an image message, without its pixels.
pub fn description(kind: Kind, wire: Wire, message: &[u8]) -> Result<Description, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    let t = fields.header()?;
    let size = match kind {
        Kind::Image => {
            let (height, width) = (fields.u32("its size")?, fields.u32("its size")?);
            Some((width, height))
        }
        _ => None,
    };
    let encoding = String::from_utf8_lossy(fields.text("its encoding")?).into_owned();
    Ok(Description { t, size, encoding })
}

/// Returns the encoding of an `Image` if it is not supported for images of an event camera.
pub fn unread_encoding(wire: Wire, message: &[u8]) -> Option<String> {
    let encoding = description(Kind::Image, wire, message).ok()?.encoding;
    if Pixels::of_encoding(encoding.as_bytes()).is_none() {
        return Some(encoding);
    }
    may_be_distances(&encoding).then(|| format!("{encoding} (possibly distances)"))
}

/// Decodes the image of a message of this `kind`; `None` if it is neither grey nor coloured, for example a depth image.
pub fn frame(kind: Kind, wire: Wire, message: &[u8]) -> Result<Option<Frame>, MessageError> {
    match kind {
        Kind::Image => plain(wire, message),
        Kind::CompressedImage => compressed(wire, message),
        Kind::EventArray | Kind::EventPacket | Kind::Imu | Kind::Other => Ok(None),
    }
}

/// Decodes an `Image`.
fn plain(wire: Wire, message: &[u8]) -> Result<Option<Frame>, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    let t = fields.header()?;
    let (height, width) = (fields.u32("its size")?, fields.u32("its size")?);
    let kind = Pixels::of_encoding(fields.text("its encoding")?);
    let big_endian = fields.u8("its byte order")? != 0;
    let step = usize::try_from(fields.u32("its step")?).unwrap_or(usize::MAX);
    let data = fields.bytes("the picture")?;
    let (Some(kind), Ok(columns), Ok(rows)) = (kind, u16::try_from(width), u16::try_from(height)) else {
        return Ok(None);
    };
    let row_bytes = usize::from(columns) * kind.samples() * kind.bytes;
    if step < row_bytes || step == 0 || data.len() < step.saturating_mul(rows.into()) {
        return Err(MessageError::Rows);
    }
    let bytes = data.chunks_exact(step).take(rows.into()).filter_map(|row| row.get(..row_bytes)).flatten().copied();
    let (channels, pixels) = match kind.bytes {
        1 => arranged(bytes.collect(), kind.layout, columns.into()),
        _ => {
            let bytes: Vec<u8> = bytes.collect();
            let number =
                |pair: &[u8; 2]| if big_endian { u16::from_be_bytes(*pair) } else { u16::from_le_bytes(*pair) };
            let samples = bytes.as_chunks().0.iter().map(number).collect();
            let (channels, samples) = arranged(samples, kind.layout, columns.into());
            (channels, highest_bits(&samples))
        }
    };
    Ok(Some(Frame { t, exposure: None, readout: None, size: (columns, rows), position: (0, 0), channels, pixels }))
}

/// Converts samples in rows of `columns` pixels to the samples of a frame. Returns them with the number of channels.
fn arranged<T: bayer::Sample>(samples: Vec<T>, layout: Layout, columns: usize) -> (usize, Vec<T>) {
    match layout {
        Layout::Grey => (1, samples),
        Layout::Mosaic => (1, bayer::grey(&samples, columns)),
        Layout::Yuv422 { brightness } => (1, samples.into_iter().skip(brightness).step_by(2).collect()),
        Layout::Colours { samples: count, red_first } => {
            let pixels = samples.chunks_exact(count).filter_map(|pixel| pixel.first_chunk());
            let in_order = |&[a, b, c]: &[T; 3]| if red_first { [c, b, a] } else { [a, b, c] };
            (3, pixels.flat_map(in_order).collect())
        }
    }
}

/// Decodes a `CompressedImage`. Its format consists of the encoding before compression, a semicolon, and `jpeg` or
/// `png` with the encoding that was compressed (`bayer_rggb8; png compressed`); or only of `jpeg` or `png`.
fn compressed(wire: Wire, message: &[u8]) -> Result<Option<Frame>, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    let t = fields.header()?;
    let format = String::from_utf8_lossy(fields.text("its encoding")?).into_owned();
    let mut picture = match image_file::decode(fields.bytes("the picture")?) {
        Ok(picture) => picture,
        Err(ImageFileError::Unknown) => return Ok(None),
        Err(error) => return Err(MessageError::Picture(error.to_string())),
    };
    // Depth images may also be stored as PNG, with or without a preceding header.
    if format.contains("compressedDepth") {
        return Ok(None);
    }
    let (before, after) = format.split_once(';').unwrap_or_default();
    let is_mosaic = picture.channels == 1
        && Pixels::of_encoding(before.trim().as_bytes()).is_some_and(Pixels::is_mosaic)
        && !after.trim_end().ends_with("mono8")
        && !after.trim_end().ends_with("mono16");
    if is_mosaic && let Ok(columns) = usize::try_from(picture.size.0) {
        picture.samples = match picture.samples {
            Samples::Eight(samples) => Samples::Eight(bayer::grey(&samples, columns)),
            Samples::Sixteen(samples) => Samples::Sixteen(bayer::grey(&samples, columns)),
        };
    }
    Ok(Frame::of_file(picture, t))
}

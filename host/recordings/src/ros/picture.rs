//! The picture of a message: pixels one by one, those behind the colour filters of a sensor, or a file of JPEG or PNG.

use super::bayer;
use super::fields::{Fields, MessageError, Wire};
use super::message::Kind;
use crate::extras::Frame;
use crate::image_file::{self, ImageFile, ImageFileError, Samples};
use crate::pictures::highest_bits;

/// How the pixels of an `Image` are to be read: all encodings of `sensor_msgs` that are pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pixels {
    layout: Layout,
    /// Bytes of a sample: 1 or 2.
    bytes: usize,
}

/// Samples of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layout {
    /// One. Where colours follow the picture in a plane of their own (NV21, NV24), they are left out.
    Grey,
    /// One, behind a colour filter.
    Mosaic,
    /// Brightness at this one of two; the other is a colour, for two pixels in turn.
    Yuv422 { brightness: usize },
    /// Three or four: blue, green, red (or the other way round), and how opaque.
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

    /// Samples of a pixel.
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

/// `true` if a picture of this encoding may be one of distances: those of depth cameras are in millimetres or metres.
pub fn may_be_distances(encoding: &str) -> bool {
    ["16UC1", "32FC", "64FC"].iter().any(|of_distances| encoding.starts_with(of_distances))
}

/// What a message says of its picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Description {
    /// Its time in µs.
    pub t: i64,
    /// Width and height of an `Image` in pixels.
    pub size: Option<(u32, u32)>,
    /// The encoding, or the format of a picture in a file's bytes.
    pub encoding: String,
}

/// Reads all of a message but its picture.
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

/// The encoding of an `Image`, if pictures in it are not read as those of the camera that sent events.
pub fn unread_encoding(wire: Wire, message: &[u8]) -> Option<String> {
    let encoding = description(Kind::Image, wire, message).ok()?.encoding;
    if Pixels::of_encoding(encoding.as_bytes()).is_none() {
        return Some(encoding);
    }
    may_be_distances(&encoding).then(|| format!("{encoding} (perhaps of distances)"))
}

/// The picture of a message of this `kind`; `None` if it is neither grey nor in colour, such as a depth.
pub fn frame(kind: Kind, wire: Wire, message: &[u8]) -> Result<Option<Frame>, MessageError> {
    match kind {
        Kind::Image => plain(wire, message),
        Kind::CompressedImage => compressed(wire, message),
        Kind::EventArray | Kind::EventPacket | Kind::Imu | Kind::Other => Ok(None),
    }
}

/// The picture of an `Image`.
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

/// The samples as a frame has them, rows of `columns` pixels, and how many a pixel has.
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

/// The picture of a `CompressedImage`. Its format names the encoding before it was compressed, a semicolon, `jpeg` or `png`, and what
/// was compressed (`bayer_rggb8; png compressed`), or the last but one of these alone (`jpeg`).
fn compressed(wire: Wire, message: &[u8]) -> Result<Option<Frame>, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    let t = fields.header()?;
    let format = String::from_utf8_lossy(fields.text("its encoding")?).into_owned();
    let ImageFile { size, channels, samples } = match image_file::decode(fields.bytes("the picture")?) {
        Ok(picture) => picture,
        Err(ImageFileError::Unknown) => return Ok(None),
        Err(error) => return Err(MessageError::Picture(error.to_string())),
    };
    let (before, after) = format.split_once(';').unwrap_or_default();
    // Depths are in PNG as well, behind some bytes or not.
    let (true, Ok(columns), Ok(rows)) =
        (!format.contains("compressedDepth"), u16::try_from(size.0), u16::try_from(size.1))
    else {
        return Ok(None);
    };
    let is_mosaic = channels == 1
        && Pixels::of_encoding(before.trim().as_bytes()).is_some_and(Pixels::is_mosaic)
        && !after.trim_end().ends_with("mono8")
        && !after.trim_end().ends_with("mono16");
    let bytes = match samples {
        Samples::Eight(samples) if is_mosaic => bayer::grey(&samples, columns.into()),
        Samples::Eight(samples) => samples,
        Samples::Sixteen(samples) if is_mosaic => highest_bits(&bayer::grey(&samples, columns.into())),
        Samples::Sixteen(samples) => highest_bits(&samples),
    };
    let (channels, pixels) = match channels {
        1 => (1, bytes),
        2 => (1, bytes.as_chunks::<2>().0.iter().map(|[grey, _]| *grey).collect()),
        3 => (3, bytes.as_chunks().0.iter().flat_map(|&[red, green, blue]| [blue, green, red]).collect()),
        4 => (3, bytes.as_chunks().0.iter().flat_map(|&[red, green, blue, _]| [blue, green, red]).collect()),
        _ => return Ok(None),
    };
    Ok(Some(Frame { t, exposure: None, readout: None, size: (columns, rows), position: (0, 0), channels, pixels }))
}

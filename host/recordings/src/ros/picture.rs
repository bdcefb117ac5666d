//! The picture of a message: pixels one by one, those behind the colour filters of a sensor, or a file of JPEG or PNG.

use super::bayer;
use super::fields::{Fields, MessageError, Wire};
use super::message::Kind;
use crate::extras::Frame;
use crate::image_file::{self, ImageFile, ImageFileError, Samples};
use crate::pictures::highest_bits;

/// How the pixels of an `Image` are to be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pixels {
    /// One byte each.
    Grey,
    /// Two bytes each.
    Grey16,
    /// Blue, green, red.
    Bgr,
    /// Red, green, blue.
    Rgb,
    /// Blue, green, red, and how opaque.
    Bgra,
    /// Red, green, blue, and how opaque.
    Rgba,
    /// One byte each, behind a colour filter.
    Bayer,
    /// Two bytes each, behind a colour filter.
    Bayer16,
}

impl Pixels {
    fn of_encoding(encoding: &[u8]) -> Option<Self> {
        match encoding {
            b"mono8" | b"8UC1" => Some(Self::Grey),
            b"mono16" | b"16UC1" => Some(Self::Grey16),
            b"bgr8" | b"8UC3" => Some(Self::Bgr),
            b"rgb8" => Some(Self::Rgb),
            b"bgra8" | b"8UC4" => Some(Self::Bgra),
            b"rgba8" => Some(Self::Rgba),
            b"bayer_rggb8" | b"bayer_bggr8" | b"bayer_gbrg8" | b"bayer_grbg8" => Some(Self::Bayer),
            b"bayer_rggb16" | b"bayer_bggr16" | b"bayer_gbrg16" | b"bayer_grbg16" => Some(Self::Bayer16),
            _ => None,
        }
    }

    /// Bytes of a pixel.
    fn bytes(self) -> usize {
        match self {
            Self::Grey | Self::Bayer => 1,
            Self::Grey16 | Self::Bayer16 => 2,
            Self::Bgr | Self::Rgb => 3,
            Self::Bgra | Self::Rgba => 4,
        }
    }

    fn is_bayer(self) -> bool {
        matches!(self, Self::Bayer | Self::Bayer16)
    }
}

/// Whether a picture of this encoding may be one of distances: those of depth cameras are in millimetres.
pub fn may_be_distances(encoding: &str) -> bool {
    encoding.starts_with("16UC1")
}

/// The encoding of a picture, or the format of one in a file's bytes.
pub fn encoding(kind: Kind, wire: Wire, message: &[u8]) -> Result<String, MessageError> {
    let mut fields = Fields::new(wire, message)?;
    fields.header()?;
    if kind == Kind::Image {
        fields.u32("its size")?;
        fields.u32("its size")?;
    }
    Ok(String::from_utf8_lossy(fields.text("its encoding")?).into_owned())
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
    let row_bytes = usize::from(columns) * kind.bytes();
    if step < row_bytes || step == 0 || data.len() < step.saturating_mul(rows.into()) {
        return Err(MessageError::Rows);
    }
    let rows_of_bytes = data.chunks_exact(step).take(rows.into()).filter_map(|row| row.get(..row_bytes));
    let mut channels = 1;
    let pixels = match kind {
        Pixels::Grey => rows_of_bytes.flatten().copied().collect(),
        Pixels::Bayer => {
            let samples: Vec<u8> = rows_of_bytes.flatten().copied().collect();
            bayer::grey(&samples, columns.into())
        }
        Pixels::Grey16 | Pixels::Bayer16 => {
            let number =
                |pixel: &[u8; 2]| if big_endian { u16::from_be_bytes(*pixel) } else { u16::from_le_bytes(*pixel) };
            let samples: Vec<u16> = rows_of_bytes.flat_map(|row| row.as_chunks::<2>().0).map(number).collect();
            highest_bits(&if kind.is_bayer() { bayer::grey(&samples, columns.into()) } else { samples })
        }
        Pixels::Bgr | Pixels::Rgb => {
            channels = 3;
            let pixels = rows_of_bytes.flat_map(|row| row.as_chunks().0);
            let rgb = kind == Pixels::Rgb;
            pixels.flat_map(|&[a, b, c]| if rgb { [c, b, a] } else { [a, b, c] }).collect()
        }
        Pixels::Bgra | Pixels::Rgba => {
            channels = 3;
            let pixels = rows_of_bytes.flat_map(|row| row.as_chunks().0);
            let rgb = kind == Pixels::Rgba;
            pixels.flat_map(|&[a, b, c, _]| if rgb { [c, b, a] } else { [a, b, c] }).collect()
        }
    };
    Ok(Some(Frame { t, exposure: None, readout: None, size: (columns, rows), position: (0, 0), channels, pixels }))
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
        && Pixels::of_encoding(before.trim().as_bytes()).is_some_and(Pixels::is_bayer)
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

//! Image files: PNG of any kind; JPEG for reading only.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Cursor, Read, Seek, Write};
use std::path::Path;

use png::{BitDepth, ColorType, Transformations};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use evcal_files::FileError;

/// An image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageFile {
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Number of samples per pixel: 1 grey, 2 grey and alpha, 3 red-green-blue, 4 with alpha.
    pub channels: usize,
    /// Samples of all pixels, row by row.
    pub samples: Samples,
}

/// Samples of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Samples {
    /// Samples of 8 bits.
    Eight(Vec<u8>),
    /// Samples of 16 bits.
    Sixteen(Vec<u16>),
}

/// Error while reading an image.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageFileError {
    /// The operating system reported an error.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The PNG is damaged.
    #[error("not a valid PNG: {0}")]
    Png(#[from] png::DecodingError),
    /// The JPEG is damaged.
    #[error("not a valid JPEG: {0}")]
    Jpeg(String),
    /// The stated size is larger than a file of this length can contain.
    #[error("not a valid image: it states a size of {} x {} pixels, too many for a file of {length} bytes", size.0, size.1)]
    TooLarge {
        /// Stated width and height in pixels.
        size: (u32, u32),
        /// Length of the file in bytes.
        length: u64,
    },
    /// The image needs too much memory.
    #[error("an image of {} x {} pixels, which is too large: reduce its size first", size.0, size.1)]
    Memory {
        /// Stated width and height in pixels.
        size: (u32, u32),
    },
    /// The content is neither PNG nor JPEG.
    #[error("neither PNG nor JPEG: convert it to PNG first")]
    Unknown,
}

/// Memory limit of an image in bytes (11 000 x 8000 pixels in colour).
const MOST_BYTES: usize = 1 << 28;
/// Highest compression ratio of Deflate.
const DEFLATE: u64 = 1032;
/// Largest number of samples of a JPEG (26 megapixels in colour), because its decoder needs up to 6 bytes for each.
const JPEG_SAMPLES: u64 = 80_000_000;
/// Largest number of pixels per byte of a JPEG: a block of 64 pixels needs at least one bit.
const JPEG_PIXELS: u64 = 512;

/// Checks that a file of `length` bytes with at most `pixels` pixels per byte can contain an image of `width` ×
/// `height` pixels. The check precedes the allocation of memory for the stated size.
fn check_size(width: u32, height: u32, pixels: u64, length: u64) -> Result<(), ImageFileError> {
    if u64::from(width).saturating_mul(height.into()) > length.saturating_mul(pixels) {
        return Err(ImageFileError::TooLarge { size: (width, height), length });
    }
    Ok(())
}

/// Reads the PNG or JPEG at `path`; the content decides which. Palettes, and samples of less than 8 bits, are expanded
/// to 8 bits.
///
/// # Errors
/// [`ImageFileError`].
pub fn read(path: &Path) -> Result<ImageFile, ImageFileError> {
    let file = File::open(path)?;
    let length = file.metadata()?.len();
    read_from(BufReader::new(file), length)
}

/// Reads a PNG or JPEG from memory.
///
/// # Errors
/// [`ImageFileError`].
pub fn decode(bytes: &[u8]) -> Result<ImageFile, ImageFileError> {
    read_from(Cursor::new(bytes), bytes.len() as u64)
}

fn read_from(mut file: impl BufRead + Seek, length: u64) -> Result<ImageFile, ImageFileError> {
    let mut head = Vec::new();
    file.by_ref().take(8).read_to_end(&mut head)?;
    file.rewind()?;
    if head.starts_with(b"\x89PNG") {
        read_png(file, length)
    } else if head.starts_with(&[0xFF, 0xD8]) {
        read_jpeg(file, length)
    } else {
        Err(ImageFileError::Unknown)
    }
}

fn read_png(file: impl BufRead + Seek, file_length: u64) -> Result<ImageFile, ImageFileError> {
    let mut decoder = png::Decoder::new(file);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let header = reader.info();
    // Samples of less than a byte are expanded to bytes.
    let pixels = DEFLATE * 8 / header.bits_per_pixel().max(1) as u64;
    check_size(header.width, header.height, pixels, file_length)?;
    let (size, is_interlaced) = (header.size(), header.interlaced);
    let length = reader.output_buffer_size().ok_or(png::DecodingError::LimitsExceeded)?;
    if length > MOST_BYTES {
        return Err(ImageFileError::Memory { size });
    }
    let mut bytes = Vec::new();
    if is_interlaced {
        bytes.resize(length, 0);
        reader.next_frame(&mut bytes)?;
    } else {
        // Reads row by row, because the stated size may be wrong.
        while let Some(row) = reader.next_row()? {
            bytes.extend_from_slice(row.data());
        }
    }
    let (color_type, bit_depth) = reader.output_color_type();
    let samples = match bit_depth {
        BitDepth::Sixteen => {
            let pairs = bytes.as_chunks::<2>().0.iter();
            Samples::Sixteen(pairs.map(|pair| u16::from_be_bytes(*pair)).collect())
        }
        _ => Samples::Eight(bytes),
    };
    Ok(ImageFile { size, channels: color_type.samples(), samples })
}

fn read_jpeg(file: impl BufRead + Seek, length: u64) -> Result<ImageFile, ImageFileError> {
    let failed = |error| ImageFileError::Jpeg(format!("{error:?}"));
    let mut decoder = JpegDecoder::new(file);
    decoder.decode_headers().map_err(failed)?;
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let colors = if grey { ColorSpace::Luma } else { ColorSpace::RGB };
    decoder.set_options(DecoderOptions::default().jpeg_set_out_colorspace(colors));
    let size = decoder.dimensions().ok_or_else(|| ImageFileError::Jpeg("it has no size".to_owned()))?;
    let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
    let size = (side(size.0), side(size.1));
    check_size(size.0, size.1, JPEG_PIXELS, length)?;
    let channels = if grey { 1 } else { 3 };
    if u64::from(size.0).saturating_mul(size.1.into()).saturating_mul(channels) > JPEG_SAMPLES {
        return Err(ImageFileError::Memory { size });
    }
    let samples = decoder.decode().map_err(failed)?;
    Ok(ImageFile { size, channels: channels as usize, samples: Samples::Eight(samples) })
}

impl ImageFile {
    /// Writes the image as PNG.
    ///
    /// # Errors
    /// [`FileError`] if it cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), FileError> {
        evcal_files::write_with(path, |file| self.encode_png(file))
    }

    fn encode_png(&self, file: impl Write) -> io::Result<()> {
        let mut encoder = png::Encoder::new(file, self.size.0, self.size.1);
        encoder.set_color(match self.channels {
            1 => ColorType::Grayscale,
            2 => ColorType::GrayscaleAlpha,
            3 => ColorType::Rgb,
            4 => ColorType::Rgba,
            _ => return Err(io::Error::other("a PNG has 1 to 4 channels")),
        });
        match &self.samples {
            Samples::Eight(samples) => {
                let mut writer = encoder.write_header()?;
                writer.write_image_data(samples)?;
                writer.finish()?;
            }
            Samples::Sixteen(samples) => {
                encoder.set_depth(BitDepth::Sixteen);
                let bytes: Vec<u8> = samples.iter().flat_map(|sample| sample.to_be_bytes()).collect();
                let mut writer = encoder.write_header()?;
                writer.write_image_data(&bytes)?;
                writer.finish()?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A flat image has the smallest possible file. Changing one byte of its size makes it too large for that file.
    #[test]
    fn an_image_too_large_for_its_file_is_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("picture.png");
        let samples = Samples::Eight(vec![0; 1000 * 1000]);
        ImageFile { size: (1000, 1000), channels: 1, samples }.write_png(&path).unwrap();
        assert_eq!(read(&path).unwrap().size, (1000, 1000));
        let mut png = std::fs::read(&path).unwrap();
        // Width and height follow the magic and the length and name of the first chunk; its checksum follows 13 bytes
        // later.
        png[16..24].copy_from_slice(&[0, 0, 0xFF, 0xFF, 0, 0, 0xFF, 0xFF]);
        let mut checksum = flate2::Crc::new();
        checksum.update(&png[12..29]);
        png[29..33].copy_from_slice(&checksum.sum().to_be_bytes());
        // The beginning of a grey JPEG.
        let jpeg = [
            &[0xFF, 0xD8, 0xFF, 0xC0, 0, 11, 8, 0x3F, 0xFF, 0x3F, 0xFF, 1, 1, 0x11, 0][..],
            &[0xFF, 0xDA, 0, 8, 1, 1, 0, 0, 63, 0, 0x5F, 0xFF, 0xD9],
        ]
        .concat();
        for (bytes, size) in [(png, 0xFFFF), (jpeg, 0x3FFF)] {
            std::fs::write(&path, &bytes).unwrap();
            let refused = read(&path).unwrap_err();
            let ImageFileError::TooLarge { size: stated, length } = refused else { panic!("{refused}") };
            assert_eq!((stated, length), ((size, size), bytes.len() as u64));
        }
    }

    /// A file of a megabyte must not be able to request a gigabyte.
    #[test]
    fn an_image_that_needs_too_much_memory_is_rejected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("picture.png");
        let samples = Samples::Eight(vec![0; 16]);
        ImageFile { size: (4, 4), channels: 1, samples }.write_png(&path).unwrap();
        let mut png = std::fs::read(&path).unwrap();
        png[16..24].copy_from_slice(&[0, 0, 0xFF, 0xFF, 0, 0, 0xFF, 0xFF]);
        let mut checksum = flate2::Crc::new();
        checksum.update(&png[12..29]);
        png[29..33].copy_from_slice(&checksum.sum().to_be_bytes());
        png.resize(8 << 20, 0);
        std::fs::write(&path, &png).unwrap();
        assert!(matches!(read(&path), Err(ImageFileError::Memory { size: (0xFFFF, 0xFFFF) })));
        // The stated size is allowed, but the rows are missing: memory is allocated as they are read.
        png[16..24].copy_from_slice(&[0, 0, 0x3F, 0xFF, 0, 0, 0x3F, 0xFF]);
        let mut checksum = flate2::Crc::new();
        checksum.update(&png[12..29]);
        png[29..33].copy_from_slice(&checksum.sum().to_be_bytes());
        assert!(matches!(decode(&png), Err(ImageFileError::Png(_))));
        // A grey JPEG of 16383 x 16383 pixels, and zeros after it.
        let mut jpeg = [
            &[0xFF, 0xD8, 0xFF, 0xC0, 0, 11, 8, 0x3F, 0xFF, 0x3F, 0xFF, 1, 1, 0x11, 0][..],
            &[0xFF, 0xDA, 0, 8, 1, 1, 0, 0, 63, 0, 0x5F, 0xFF, 0xD9],
        ]
        .concat();
        jpeg.resize(1 << 20, 0);
        assert!(matches!(decode(&jpeg), Err(ImageFileError::Memory { size: (0x3FFF, 0x3FFF) })));
    }

    #[test]
    fn every_kind_of_png_is_read_back() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("picture.png");
        for channels in 1..=4 {
            let count = 5 * 3 * channels;
            let sixteen = (0..count).map(|index| (index * 1111) as u16).collect();
            for samples in [Samples::Eight((0..count).map(|index| index as u8).collect()), Samples::Sixteen(sixteen)] {
                let picture = ImageFile { size: (5, 3), channels, samples };
                picture.write_png(&path).unwrap();
                assert_eq!(read(&path).unwrap(), picture);
                let whole = std::fs::read(&path).unwrap();
                for length in 0..whole.len() - 12 {
                    std::fs::write(&path, &whole[..length]).unwrap();
                    assert!(read(&path).is_err(), "{length} of {} bytes", whole.len());
                }
            }
        }
    }
}

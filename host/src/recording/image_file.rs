//! Pictures on the disk: PNG of any kind, JPEG for reading.

use std::fs::File;
use std::io::{self, BufReader, Read, Seek, Write};
use std::path::Path;

use png::{BitDepth, ColorType, Transformations};
use zune_jpeg::JpegDecoder;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

use crate::files::{self, FileError};

/// A picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ImageFile {
    /// Width and height in pixels.
    pub size: (u32, u32),
    /// Samples for each pixel: 1 grey, 2 with alpha, 3 red-green-blue, 4 with alpha.
    pub channels: usize,
    /// Channels of pixels, row by row.
    pub samples: Samples,
}

/// Samples of a picture.
#[derive(Clone, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Samples {
    /// Of 8 bits.
    Eight(Vec<u8>),
    /// Of 16 bits.
    Sixteen(Vec<u16>),
}

/// A picture cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ImageFileError {
    /// The system says so.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// It is damaged.
    #[error("not a whole PNG: {0}")]
    Png(#[from] png::DecodingError),
    /// It is damaged.
    #[error("not a whole JPEG: {0}")]
    Jpeg(String),
    /// It is something else.
    #[error("neither PNG nor JPEG: convert it to PNG first")]
    Unknown,
}

/// Reads the PNG or JPEG at `path`, told apart by its content. Palettes and few bits become 8 bits.
///
/// # Errors
/// [`ImageFileError`].
pub fn read(path: &Path) -> Result<ImageFile, ImageFileError> {
    let mut file = BufReader::new(File::open(path)?);
    let mut head = Vec::new();
    file.by_ref().take(8).read_to_end(&mut head)?;
    file.rewind()?;
    if head.starts_with(b"\x89PNG") {
        read_png(file)
    } else if head.starts_with(&[0xFF, 0xD8]) {
        read_jpeg(file)
    } else {
        Err(ImageFileError::Unknown)
    }
}

fn read_png(file: BufReader<File>) -> Result<ImageFile, ImageFileError> {
    let mut decoder = png::Decoder::new(file);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info()?;
    let length = reader.output_buffer_size().ok_or(png::DecodingError::LimitsExceeded)?;
    let mut bytes = vec![0; length];
    let information = reader.next_frame(&mut bytes)?;
    bytes.truncate(information.buffer_size());
    let samples = match information.bit_depth {
        BitDepth::Sixteen => {
            let pairs = bytes.as_chunks::<2>().0.iter();
            Samples::Sixteen(pairs.map(|pair| u16::from_be_bytes(*pair)).collect())
        }
        _ => Samples::Eight(bytes),
    };
    let channels = information.color_type.samples();
    Ok(ImageFile { size: (information.width, information.height), channels, samples })
}

fn read_jpeg(file: BufReader<File>) -> Result<ImageFile, ImageFileError> {
    let failed = |error| ImageFileError::Jpeg(format!("{error:?}"));
    let mut decoder = JpegDecoder::new(file);
    decoder.decode_headers().map_err(failed)?;
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let colors = if grey { ColorSpace::Luma } else { ColorSpace::RGB };
    decoder.set_options(DecoderOptions::default().jpeg_set_out_colorspace(colors));
    let samples = decoder.decode().map_err(failed)?;
    let size = decoder.dimensions().ok_or_else(|| ImageFileError::Jpeg("it has no size".to_owned()))?;
    let side = |side: usize| u32::try_from(side).unwrap_or(u32::MAX);
    let size = (side(size.0), side(size.1));
    Ok(ImageFile { size, channels: if grey { 1 } else { 3 }, samples: Samples::Eight(samples) })
}

impl ImageFile {
    /// Writes the picture as PNG.
    ///
    /// # Errors
    /// [`FileError`] when it cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), FileError> {
        files::write_with(path, |file| self.encode_png(file))
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

    #[test]
    fn every_kind_of_png_comes_back() {
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

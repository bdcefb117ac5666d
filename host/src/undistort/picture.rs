//! Pictures without distortion.

use std::path::{Path, PathBuf};

use image::{DynamicImage, ImageBuffer, ImageError, ImageReader};

use super::PixelMap;
use crate::source::aedat4::other_streams::Frame;

/// A picture could not be undistorted.
#[derive(Debug, thiserror::Error)]
pub enum PictureError {
    /// It cannot be read or written.
    #[error("{}: {error}", path.display())]
    Image {
        /// The picture.
        path: PathBuf,
        /// Why.
        error: ImageError,
    },
    /// It is not of this camera.
    #[error(
        "{} has {} x {} pixels, the calibration is for {} x {}", path.display(), size.0, size.1, sensor.0, sensor.1
    )]
    Size {
        /// The picture.
        path: PathBuf,
        /// Its width and height.
        size: (u32, u32),
        /// Those of the calibrated sensor.
        sensor: (u16, u16),
    },
    /// Its pixels are not whole numbers of 8 or 16 bits.
    #[error("{} has pixels of a kind that is not supported: use 8 or 16 bits", .0.display())]
    Pixels(PathBuf),
}

/// Reads a picture.
///
/// # Errors
/// [`PictureError::Image`].
pub fn read(path: &Path) -> Result<DynamicImage, PictureError> {
    let failed = |error| PictureError::Image { path: path.to_owned(), error };
    let reader =
        ImageReader::open(path).and_then(ImageReader::with_guessed_format).map_err(|error| failed(error.into()))?;
    reader.decode().map_err(failed)
}

/// The picture at `path` of a sensor, undistorted; `back` leads from new to old pixels.
///
/// # Errors
/// [`PictureError`].
pub fn undistort_picture(path: &Path, back: &PixelMap) -> Result<DynamicImage, PictureError> {
    let picture = read(path)?;
    let (sensor, size) = (back.sensor(), (picture.width(), picture.height()));
    if size != (u32::from(sensor.0), u32::from(sensor.1)) {
        return Err(PictureError::Size { path: path.to_owned(), size, sensor });
    }
    let unsupported = || PictureError::Pixels(path.to_owned());
    macro_rules! same_kind {
        ($kind:ident, $buffer:expr, $channels:expr) => {{
            let pixels = remap($buffer.as_raw(), $channels, sensor, (0, 0), back);
            ImageBuffer::from_raw(size.0, size.1, pixels).map(DynamicImage::$kind).ok_or_else(unsupported)
        }};
    }
    match &picture {
        DynamicImage::ImageLuma8(buffer) => same_kind!(ImageLuma8, buffer, 1),
        DynamicImage::ImageLumaA8(buffer) => same_kind!(ImageLumaA8, buffer, 2),
        DynamicImage::ImageRgb8(buffer) => same_kind!(ImageRgb8, buffer, 3),
        DynamicImage::ImageRgba8(buffer) => same_kind!(ImageRgba8, buffer, 4),
        DynamicImage::ImageLuma16(buffer) => same_kind!(ImageLuma16, buffer, 1),
        DynamicImage::ImageLumaA16(buffer) => same_kind!(ImageLumaA16, buffer, 2),
        DynamicImage::ImageRgb16(buffer) => same_kind!(ImageRgb16, buffer, 3),
        DynamicImage::ImageRgba16(buffer) => same_kind!(ImageRgba16, buffer, 4),
        _ => Err(unsupported()),
    }
}

/// Undistorts a frame of a recording in place. A frame of a part of the sensor stays one of that part.
pub fn undistort_frame(frame: &mut Frame, back: &PixelMap) {
    frame.pixels = remap(&frame.pixels, frame.channels, frame.size, frame.position, back);
}

/// Writes a frame as a picture; `false` if it has as many channels as no picture has.
///
/// # Errors
/// [`PictureError::Image`].
pub fn write_frame(frame: &Frame, path: &Path) -> Result<bool, PictureError> {
    let (width, height) = (u32::from(frame.size.0), u32::from(frame.size.1));
    let mut pixels = frame.pixels.clone();
    if frame.channels > 2 {
        // Frames are blue-green-red, pictures the other way round.
        pixels.chunks_exact_mut(frame.channels).for_each(|pixel| pixel.swap(0, 2));
    }
    let picture = match frame.channels {
        1 => ImageBuffer::from_raw(width, height, pixels).map(DynamicImage::ImageLuma8),
        3 => ImageBuffer::from_raw(width, height, pixels).map(DynamicImage::ImageRgb8),
        4 => ImageBuffer::from_raw(width, height, pixels).map(DynamicImage::ImageRgba8),
        _ => None,
    };
    let Some(picture) = picture else { return Ok(false) };
    picture.save(path).map_err(|error| PictureError::Image { path: path.to_owned(), error })?;
    Ok(true)
}

/// A channel of a pixel.
trait Sample: Copy {
    fn value(self) -> f64;
    /// Rounded; a mean of samples is always in range.
    fn nearest(value: f64) -> Self;
}

impl Sample for u8 {
    fn value(self) -> f64 {
        self.into()
    }

    fn nearest(value: f64) -> Self {
        (value + 0.5) as Self
    }
}

impl Sample for u16 {
    fn value(self) -> f64 {
        self.into()
    }

    fn nearest(value: f64) -> Self {
        (value + 0.5) as Self
    }
}

/// The picture of `size` at `position` of the sensor with each pixel taken from where `back` says, black beyond the rim.
fn remap<T: Sample>(pixels: &[T], channels: usize, size: (u16, u16), position: (u16, u16), back: &PixelMap) -> Vec<T> {
    let (width, height) = (usize::from(size.0), usize::from(size.1));
    let sample = |x: i64, y: i64, channel: usize| {
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        if x >= width || y >= height {
            return None;
        }
        pixels.get((y * width + x) * channels + channel).copied().map(T::value)
    };
    let mut output = Vec::with_capacity(pixels.len());
    for (row, column) in (0..size.1).flat_map(|row| (0..size.0).map(move |column| (row, column))) {
        let place = back.get(position.0.saturating_add(column), position.1.saturating_add(row));
        for channel in 0..channels {
            let value = place.map_or(0.0, |[x, y]| {
                let (x, y) = (x - f64::from(position.0), y - f64::from(position.1));
                let (left, top) = (x.floor(), y.floor());
                let (right_share, bottom_share) = (x - left, y - top);
                let at = |dx: i64, dy: i64| sample(left as i64 + dx, top as i64 + dy, channel).unwrap_or(0.0);
                let upper = at(0, 0) * (1.0 - right_share) + at(1, 0) * right_share;
                let lower = at(0, 1) * (1.0 - right_share) + at(1, 1) * right_share;
                upper * (1.0 - bottom_share) + lower * bottom_share
            });
            output.push(T::nearest(value));
        }
    }
    output
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::{Camera, ModelKind};

    use super::*;

    fn pinhole(cx: f64, cy: f64) -> Camera<f64> {
        Camera::from_parameters(ModelKind::Radtan4, &[50.0, 50.0, cx, cy, 0.0, 0.0, 0.0, 0.0]).unwrap()
    }

    #[test]
    fn a_shift_of_the_centre_shifts_the_picture_and_fractions_are_means() {
        let pixels: Vec<u16> = (0..12 * 10).map(|index| (index % 12) * 1000 + (index / 12) * 10).collect();
        let back = PixelMap::new(&pinhole(5.0, 4.0), &pinhole(6.5, 3.0), (12, 10));
        let moved = remap(&pixels, 1, (12, 10), (0, 0), &back);
        for (x, y) in (0..12).flat_map(|x| (0..10).map(move |y| (x, y))) {
            let expected = match (x, y) {
                (_, 0) | (11, _) => 0,
                // Half of the last column, half of the black beyond.
                (10, _) => (11_000 + (y - 1) * 10) / 2,
                _ => x * 1000 + 1500 + (y - 1) * 10,
            };
            assert_eq!(usize::from(moved[y * 12 + x]), expected, "({x}, {y})");
        }
    }

    #[test]
    fn a_part_of_the_sensor_stays_where_it_is() {
        let back = PixelMap::new(&pinhole(5.0, 4.0), &pinhole(6.0, 4.0), (12, 10));
        let pixels: Vec<u8> = (0..3 * 2).collect();
        let mut frame =
            Frame { t: 0, exposure: None, readout: None, size: (3, 2), position: (4, 5), channels: 1, pixels };
        undistort_frame(&mut frame, &back);
        assert_eq!(frame.pixels, [1, 2, 0, 4, 5, 0]);
    }
}

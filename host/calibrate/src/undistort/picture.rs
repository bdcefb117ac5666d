//! Undistortion of pictures.

use evcal_core::sensor::Sensor;
use std::path::{Path, PathBuf};

use super::PixelMap;
use evcal_files::FileError;
use evcal_files::folder::NamesFile;
use event_recordings::extras::Frame;
use event_recordings::image_file::{self, ImageFile, ImageFileError, Samples};

/// A picture could not be undistorted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PictureError {
    /// It cannot be read.
    #[error("{}: {error}", path.display())]
    Read {
        /// The picture.
        path: PathBuf,
        /// The reason.
        error: ImageFileError,
    },
    /// It cannot be written.
    #[error("{0}")]
    Write(#[from] FileError),
    /// Two pictures would have the same name in the folder.
    #[error("two of the pictures would become {}: give one of them another name", .0.display())]
    SameName(PathBuf),
    /// It does not have the size of this camera's sensor.
    #[error(
        "{} has {} x {} pixels, the calibration is for {} x {}", path.display(), size.0, size.1, sensor.width, sensor.height
    )]
    Size {
        /// The picture.
        path: PathBuf,
        /// Its width and height.
        size: (u32, u32),
        /// Size of the calibrated sensor.
        sensor: Sensor,
    },
}

impl evcal_files::remedy::Remedy for PictureError {}

impl NamesFile for PictureError {
    fn file_mut(&mut self) -> Option<&mut PathBuf> {
        match self {
            Self::Write(error) => error.file_mut(),
            _ => None,
        }
    }
}

/// Extensions of pictures.
const EXTENSIONS: [&str; 3] = ["png", "jpg", "jpeg"];

/// Returns `true` if a file is a picture by its name.
pub fn is_picture(path: &Path) -> bool {
    let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
    extension.is_some_and(|extension| EXTENSIONS.contains(&extension.as_str()))
}

/// Returns `true` if `output` is the name of the only picture of `inputs`, and not a folder.
pub fn is_single(inputs: &[PathBuf], output: &Path) -> bool {
    inputs.len() == 1 && output.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"))
}

/// Returns the output names of the pictures `inputs`: the PNG `output` or, if there are several, `NAME.png` in that folder.
///
/// # Errors
/// [`PictureError::SameName`] if two outputs have the same name.
pub fn picture_outputs(inputs: &[PathBuf], output: &Path) -> Result<Vec<PathBuf>, PictureError> {
    if is_single(inputs, output) {
        return Ok(vec![output.to_owned()]);
    }
    let mut paths: Vec<PathBuf> = Vec::new();
    for input in inputs {
        let path = output.join(Path::new(input.file_name().unwrap_or_default()).with_extension("png"));
        if paths.contains(&path) {
            return Err(PictureError::SameName(path));
        }
        paths.push(path);
    }
    Ok(paths)
}

/// Undistorts pictures of a sensor, each to the PNG of the same index in `outputs`, which is overwritten. `back` maps new to old
/// pixels.
///
/// # Errors
/// [`PictureError`]; the pictures before the failed one are written.
pub fn undistort_pictures(inputs: &[PathBuf], outputs: &[PathBuf], back: &PixelMap) -> Result<(), PictureError> {
    for (input, output) in inputs.iter().zip(outputs) {
        undistort_picture(input, back)?.write_png(output)?;
    }
    Ok(())
}

/// Returns the undistorted picture at `path`; `back` maps new to old pixels.
///
/// # Errors
/// [`PictureError`] if it cannot be read or has another size.
fn undistort_picture(path: &Path, back: &PixelMap) -> Result<ImageFile, PictureError> {
    let picture = image_file::read(path).map_err(|error| PictureError::Read { path: path.to_owned(), error })?;
    let (sensor, ImageFile { size, channels, samples }) = (back.sensor(), picture);
    if size != (u32::from(sensor.width), u32::from(sensor.height)) {
        return Err(PictureError::Size { path: path.to_owned(), size, sensor });
    }
    let samples = match samples {
        Samples::Eight(samples) => Samples::Eight(remap(&samples, channels, sensor, (0, 0), back)),
        Samples::Sixteen(samples) => Samples::Sixteen(remap(&samples, channels, sensor, (0, 0), back)),
    };
    Ok(ImageFile { size, channels, samples })
}

/// Undistorts a frame of a recording in place. If the frame covers only a part of the sensor, the undistorted frame
/// covers the same part.
pub fn undistort_frame(frame: &mut Frame, back: &PixelMap) {
    frame.pixels = remap(&frame.pixels, frame.channels, frame.size.into(), frame.position, back);
}

/// Writes a frame as a picture.
///
/// # Errors
/// [`PictureError::Write`].
pub fn write_frame(frame: &Frame, path: &Path) -> Result<(), PictureError> {
    let mut samples = frame.pixels.clone();
    if frame.channels > 2 {
        // Frames are blue-green-red, picture files red-green-blue.
        samples.chunks_exact_mut(frame.channels).for_each(|pixel| pixel.swap(0, 2));
    }
    let size = (u32::from(frame.size.0), u32::from(frame.size.1));
    let picture = ImageFile { size, channels: frame.channels, samples: Samples::Eight(samples) };
    Ok(picture.write_png(path)?)
}

/// A channel of a pixel.
trait Sample: Copy {
    fn value(self) -> f64;
    /// Rounds to the nearest value; a mean of samples is always in range.
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

/// Returns the picture of `size` at `position` of the sensor with each pixel taken from the position in `back`, black outside the
/// picture.
fn remap<T: Sample>(pixels: &[T], channels: usize, size: Sensor, position: (u16, u16), back: &PixelMap) -> Vec<T> {
    let (width, height) = (usize::from(size.width), usize::from(size.height));
    let sample = |x: i64, y: i64, channel: usize| {
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        if x >= width || y >= height {
            return None;
        }
        pixels.get((y * width + x) * channels + channel).copied().map(T::value)
    };
    let mut output = Vec::with_capacity(pixels.len());
    for (row, column) in (0..size.height).flat_map(|row| (0..size.width).map(move |column| (row, column))) {
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
        let back = PixelMap::new(&pinhole(5.0, 4.0), &pinhole(6.5, 3.0), Sensor::new(12, 10));
        let moved = remap(&pixels, 1, Sensor::new(12, 10), (0, 0), &back);
        for (x, y) in (0..12).flat_map(|x| (0..10).map(move |y| (x, y))) {
            let expected = match (x, y) {
                (_, 0) | (11, _) => 0,
                // Half of the last column, half of the black outside.
                (10, _) => (11_000 + (y - 1) * 10) / 2,
                _ => x * 1000 + 1500 + (y - 1) * 10,
            };
            assert_eq!(usize::from(moved[y * 12 + x]), expected, "({x}, {y})");
        }
    }

    #[test]
    fn a_part_of_the_sensor_keeps_its_position() {
        let back = PixelMap::new(&pinhole(5.0, 4.0), &pinhole(6.0, 4.0), Sensor::new(12, 10));
        let pixels: Vec<u8> = (0..3 * 2).collect();
        let mut frame =
            Frame { t: 0, exposure: None, readout: None, size: (3, 2), position: (4, 5), channels: 1, pixels };
        undistort_frame(&mut frame, &back);
        assert_eq!(frame.pixels, [1, 2, 0, 4, 5, 0]);
    }
}

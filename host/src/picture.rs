//! Pictures of windows: events, circles found, and where the model puts the board.

use std::fs::File;
use std::io::{self, BufWriter};
use std::path::Path;

use evcal_core::camera::Camera;
use evcal_core::event::Polarity;
use nalgebra::{Isometry3, Point3, Vector2};

use crate::board::Board;
use crate::event_pixel::EventPixel;
use crate::frames::image::GreyImage;
use crate::reference_frame::ReferenceFrame;

/// Picture pixels for each sensor pixel.
const SCALE: usize = 3;
const WHITE: [u8; 3] = [255, 255, 255];
const ON: [u8; 3] = [220, 50, 47];
const OFF: [u8; 3] = [38, 100, 210];
const FOUND: [u8; 3] = [20, 20, 20];
const ROW_LINE: [u8; 3] = [230, 160, 0];
const MODEL: [u8; 3] = [0, 150, 70];

/// An RGB picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Three bytes a pixel, row by row.
    pub rgb: Vec<u8>,
}

impl Picture {
    fn new(sensor: (u16, u16)) -> Self {
        let (width, height) = (usize::from(sensor.0) * SCALE, usize::from(sensor.1) * SCALE);
        Self { width, height, rgb: WHITE.repeat(width * height) }
    }

    fn set(&mut self, x: f64, y: f64, color: [u8; 3]) {
        if !(x >= 0.0 && y >= 0.0) || x as usize >= self.width || y as usize >= self.height {
            return;
        }
        let first = 3 * (y as usize * self.width + x as usize);
        if let Some(pixel) = self.rgb.get_mut(first..first + 3) {
            pixel.copy_from_slice(&color);
        }
    }

    /// Draws a line between two points in sensor pixels.
    fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, color: [u8; 3]) {
        let steps = ((to - from).norm() * SCALE as f64).ceil().clamp(1.0, 1e4) as usize;
        for step in 0..=steps {
            let point = from + (to - from) * (step as f64 / steps as f64);
            let point = (point + Vector2::repeat(0.5)) * SCALE as f64;
            self.set(point.x, point.y, color);
        }
    }

    fn circle(&mut self, center: Vector2<f64>, radius: f64, color: [u8; 3]) {
        let corner = |index: usize| {
            let angle = index as f64 * std::f64::consts::TAU / 48.0;
            center + Vector2::new(angle.cos(), angle.sin()) * radius
        };
        for index in 0..48 {
            self.line(corner(index), corner(index + 1), color);
        }
    }

    fn events(&mut self, pixels: &[EventPixel]) {
        for pixel in pixels {
            let color = if pixel.polarity() == Polarity::On { ON } else { OFF };
            self.pixel(usize::from(pixel.x()), usize::from(pixel.y()), color);
        }
    }

    /// Fills a pixel of the sensor.
    fn pixel(&mut self, x: usize, y: usize, color: [u8; 3]) {
        for row in 0..SCALE {
            for column in 0..SCALE {
                self.set((x * SCALE + column) as f64, (y * SCALE + row) as f64, color);
            }
        }
    }

    /// Writes the picture as PNG.
    ///
    /// # Errors
    /// What the system said.
    pub fn write_png(&self, path: &Path) -> io::Result<()> {
        let size = |length: usize| u32::try_from(length).map_err(io::Error::other);
        let mut encoder = png::Encoder::new(BufWriter::new(File::create(path)?), size(self.width)?, size(self.height)?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.write_header()?.write_image_data(&self.rgb)?;
        Ok(())
    }
}

/// A reference frame: ON events red, OFF events blue, circles found in black, joined along the rows
/// of the board, and the rims where `camera` at `pose` (`T_world_camera`) puts them in green.
pub fn reference_frame_picture(
    frame: &ReferenceFrame,
    sensor: (u16, u16),
    board: &Board,
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
) -> Picture {
    let mut picture = Picture::new(sensor);
    picture.events(&frame.pixels);
    draw_board(&mut picture, frame, board, camera, pose);
    picture
}

/// The same over one of the camera's own pictures, which begins at pixel `position` of the sensor.
pub fn grey_frame_picture(
    (image, position): (&GreyImage, (u16, u16)),
    frame: &ReferenceFrame,
    sensor: (u16, u16),
    board: &Board,
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
) -> Picture {
    let mut picture = Picture::new(sensor);
    for (index, &value) in image.pixels.iter().enumerate() {
        let (x, y) = (index % image.width(), index / image.width());
        picture.pixel(usize::from(position.0) + x, usize::from(position.1) + y, [value; 3]);
    }
    draw_board(&mut picture, frame, board, camera, pose);
    picture
}

/// Draws the circles of `frame`, and the rims where the model puts them.
fn draw_board(
    picture: &mut Picture,
    frame: &ReferenceFrame,
    board: &Board,
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
) {
    let columns = usize::from(board.pattern.columns.max(1));
    for pair in frame.circles.windows(2) {
        if let [a, b] = pair
            && a.index / columns == b.index / columns
        {
            picture.line(a.center, b.center, ROW_LINE);
        }
    }
    for index in 0..board.circle_count() {
        let center = board.circle_center(index);
        let rim = |step: usize| {
            let angle = step as f64 * std::f64::consts::TAU / 48.0;
            let point = center + Vector2::new(angle.cos(), angle.sin()) * board.radius;
            camera.project(&pose.inverse_transform_point(&Point3::new(point.x, point.y, 0.0)).coords)
        };
        for step in 0..48 {
            if let (Some(from), Some(to)) = (rim(step), rim(step + 1)) {
                picture.line(from, to, MODEL);
            }
        }
    }
    for circle in &frame.circles {
        picture.circle(circle.center, 1.0, FOUND);
    }
}

/// Circles (centre and radius in pixels) over the events of a window.
pub fn circle_picture(pixels: &[EventPixel], circles: &[(Vector2<f64>, f64)], sensor: (u16, u16)) -> Picture {
    let mut picture = Picture::new(sensor);
    picture.events(pixels);
    for &(center, radius) in circles {
        picture.circle(center, radius, FOUND);
        picture.circle(center, 1.0, FOUND);
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_core::event::Event;

    #[test]
    fn events_and_circles_are_where_they_should_be_and_png_reads_back() {
        let event = Event { t: 0, x: 5, y: 7, polarity: Polarity::On };
        let picture = circle_picture(&[EventPixel::new(&event)], &[(Vector2::new(20.0, 15.0), 4.0)], (40, 30));
        let at = |x: usize, y: usize| &picture.rgb[3 * (y * picture.width + x)..][..3];
        assert_eq!(at(5 * SCALE + 1, 7 * SCALE + 1), ON);
        assert_eq!(at((24.5 * SCALE as f64) as usize, (15.5 * SCALE as f64) as usize), FOUND);
        assert_eq!(at(0, 0), WHITE);
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("picture.png");
        picture.write_png(&path).unwrap();
        let decoder = png::Decoder::new(io::BufReader::new(File::open(path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        assert_eq!(bytes, picture.rgb);
    }
}

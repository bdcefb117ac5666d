//! Pictures of windows: their events, the detected circles, and the board as the calibration projects it.

use evcal_core::sensor::Sensor;
use std::collections::BTreeMap;
use std::io;
use std::path::Path;

use evcal_core::camera::Camera;
use evcal_core::event::Polarity;
use nalgebra::{Isometry3, Point3, Vector2};
use rayon::prelude::*;

use evcal_detection::circles::event_pixel::EventPixel;
use evcal_detection::circles::reference_frame::{ReferenceFrame, SeenIn};
use evcal_detection::detection::search::WindowContent;
use evcal_files::FileError;
use evcal_geometry::board::Board;
use event_recordings::pictures::GreyImage;

/// Picture pixels along each side of a sensor pixel, for pictures in files of their own.
const SCALE: f64 = 3.0;
/// Colour of a pixel without events.
pub const WHITE: [u8; 3] = [255, 255, 255];
/// Colour of ON events: blue, as in the style sheets of the report and of the live page.
pub const ON: [u8; 3] = [10, 88, 176];
/// Colour of OFF events: orange, as there.
pub const OFF: [u8; 3] = [176, 68, 0];
/// Colour outside the sensor.
pub const BEYOND: [u8; 3] = [205, 210, 216];
const FOUND: [u8; 3] = [20, 20, 20];
const ROW_LINE: [u8; 3] = [210, 40, 190];
const MODEL: [u8; 3] = [0, 150, 70];

/// An RGB picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Three bytes per pixel, row by row.
    pub rgb: Vec<u8>,
    /// Picture pixels along each side of a sensor pixel.
    scale: f64,
}

impl Picture {
    /// Creates a white picture with `scale` x `scale` pixels for each pixel of the sensor.
    pub fn new(sensor: Sensor, scale: f64) -> Self {
        let side = |pixels: u16| (f64::from(pixels) * scale).round() as usize;
        let (width, height) = (side(sensor.width), side(sensor.height));
        Self { width, height, rgb: WHITE.repeat(width * height), scale }
    }

    /// Creates a picture with the colours that `color` returns for positions on the sensor (px).
    pub fn of_sensor(sensor: Sensor, scale: f64, color: impl Fn(Vector2<f64>) -> [u8; 3] + Sync) -> Self {
        let mut picture = Self::new(sensor, scale);
        let row_bytes = 3 * picture.width.max(1);
        let place = |index: usize| (index as f64 + 0.5) / scale - 0.5;
        picture.rgb.par_chunks_mut(row_bytes).enumerate().for_each(|(row, pixels)| {
            for (column, pixel) in pixels.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                *pixel = color(Vector2::new(place(column), place(row)));
            }
        });
        picture
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
    pub fn line(&mut self, from: Vector2<f64>, to: Vector2<f64>, color: [u8; 3]) {
        let scale = self.scale;
        let steps = ((to - from).norm() * scale).ceil().clamp(1.0, 1e4) as usize;
        for step in 0..=steps {
            let point = from + (to - from) * (step as f64 / steps as f64);
            let point = (point + Vector2::repeat(0.5)) * scale;
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

    /// Draws a grey image whose top left pixel is at `position` of the sensor.
    fn grey(&mut self, image: &GreyImage, position: (u16, u16)) {
        for (index, &value) in image.pixels.iter().enumerate() {
            let (x, y) = (index % image.width(), index / image.width());
            self.pixel(usize::from(position.0) + x, usize::from(position.1) + y, [value; 3]);
        }
    }

    /// Fills a pixel of the sensor.
    fn pixel(&mut self, x: usize, y: usize, color: [u8; 3]) {
        let side = |pixel: usize| {
            let start = |pixel: usize| (pixel as f64 * self.scale).round() as usize;
            start(pixel)..start(pixel + 1)
        };
        let (columns, rows) = (side(x), side(y));
        for row in rows {
            for column in columns.clone() {
                self.set(column as f64, row as f64, color);
            }
        }
    }

    /// Draws the edges of `board` in green, and the detected circles of `frame` in black, joined along the rows.
    /// `project` maps points of the board (m) to pixels of the picture. `place` maps pixels of the sensor to pixels of
    /// the picture, which may be rectified.
    pub fn board(
        &mut self,
        frame: &ReferenceFrame,
        board: &Board,
        project: impl Fn(&Point3<f64>) -> Option<Vector2<f64>>,
        place: impl Fn(Vector2<f64>) -> Option<Vector2<f64>>,
    ) {
        let columns = usize::from(board.lattice().columns.max(1));
        for pair in frame.circles.windows(2) {
            if let [a, b] = pair
                && a.index / columns == b.index / columns
                && let (Some(from), Some(to)) = (place(a.center), place(b.center))
            {
                self.line(from, to, ROW_LINE);
            }
        }
        self.edges(board, project);
        for center in frame.circles.iter().filter_map(|circle| place(circle.center)) {
            self.circle(center, 1.0, FOUND);
        }
    }

    /// Draws the edges of `board` in green; `project` maps points of the board (m) to pixels.
    pub fn edges(&mut self, board: &Board, project: impl Fn(&Point3<f64>) -> Option<Vector2<f64>>) {
        for outline in board.outlines() {
            let images: Vec<_> = outline.iter().map(|point| project(&Point3::new(point.x, point.y, 0.0))).collect();
            for pair in images.windows(2) {
                if let &[Some(from), Some(to)] = pair {
                    self.line(from, to, MODEL);
                }
            }
        }
    }

    /// Writes the picture as a PNG file.
    ///
    /// # Errors
    /// [`FileError`] if the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), FileError> {
        evcal_files::write_with(path, |file| self.encode_png(file))
    }

    /// Returns the picture as a small PNG for a page: each channel keeps as many levels as leave a palette of 256 colours.
    ///
    /// # Errors
    /// The picture is too large for PNG.
    pub fn to_png(&self) -> io::Result<Vec<u8>> {
        let (palette, indices) = [255, 63, 31, 15, 7]
            .into_iter()
            .find_map(|levels| self.indexed(levels))
            .ok_or_else(|| io::Error::other("more than 256 colours"))?;
        let mut bytes = Vec::new();
        let mut encoder = self.encoder(&mut bytes)?;
        encoder.set_color(png::ColorType::Indexed);
        encoder.set_palette(palette);
        encoder.set_filter(png::Filter::NoFilter);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&indices)?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Returns palette and indices of the picture with channels in steps of 255 / `levels`; `None` with more than 256 colours.
    fn indexed(&self, levels: u16) -> Option<(Vec<u8>, Vec<u8>)> {
        let step = |channel: u8| {
            let level = (u16::from(channel) * levels + 127) / 255;
            u8::try_from((level * 255 + levels / 2) / levels).unwrap_or(u8::MAX)
        };
        let mut palette: Vec<u8> = Vec::new();
        let mut known: BTreeMap<[u8; 3], u8> = BTreeMap::new();
        let mut indices = Vec::with_capacity(self.rgb.len() / 3);
        for pixel in self.rgb.as_chunks::<3>().0 {
            let color = pixel.map(step);
            let index = match known.get(&color) {
                Some(&index) => index,
                None => {
                    let index = u8::try_from(known.len()).ok()?;
                    known.insert(color, index);
                    palette.extend(color);
                    index
                }
            };
            indices.push(index);
        }
        Some((palette, indices))
    }

    fn encode_png(&self, to: impl io::Write) -> io::Result<()> {
        let mut encoder = self.encoder(to)?;
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        Ok(writer.finish()?)
    }

    fn encoder<W: io::Write>(&self, to: W) -> io::Result<png::Encoder<'static, W>> {
        let size = |length: usize| u32::try_from(length).map_err(io::Error::other);
        Ok(png::Encoder::new(to, size(self.width)?, size(self.height)?))
    }
}

/// Draws a reference frame: ON events in blue and OFF events in orange, or the image reconstructed from events;
/// detected circles or corners in black, joined along the rows of the board; and in green the edges of the board,
/// projected by `camera` at `pose` (`T_world_camera`).
pub fn reference_frame_picture(
    frame: &ReferenceFrame,
    sensor: Sensor,
    board: &Board,
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
) -> Picture {
    let mut picture = Picture::new(sensor, SCALE);
    match &frame.seen_in {
        SeenIn::Reconstruction(image) => picture.grey(image, (0, 0)),
        _ => picture.events(frame.events().unwrap_or_default()),
    }
    picture.board(frame, board, |point| camera.project(&pose.inverse_transform_point(point).coords), Some);
    picture
}

/// Draws the detected circles and the edges of the board over a picture of the camera, as [`reference_frame_picture`]
/// does. The picture's top left pixel is at `position` of the sensor.
pub fn grey_frame_picture(
    image: &GreyImage,
    position: (u16, u16),
    frame: &ReferenceFrame,
    sensor: Sensor,
    board: &Board,
    camera: &Camera<f64>,
    pose: &Isometry3<f64>,
) -> Picture {
    let mut picture = Picture::new(sensor, SCALE);
    picture.grey(image, position);
    picture.board(frame, board, |point| camera.project(&pose.inverse_transform_point(point).coords), Some);
    picture
}

/// Draws circles (centre and radius in pixels) or corners over the content of a window.
pub fn circle_picture(content: WindowContent, circles: &[(Vector2<f64>, f64)], sensor: Sensor) -> Picture {
    let mut picture = Picture::new(sensor, SCALE);
    match content {
        WindowContent::Events(pixels) => picture.events(pixels),
        WindowContent::Picture(image) => picture.grey(image, (0, 0)),
    }
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
    fn events_and_circles_have_their_positions_and_the_png_file_has_all_pixels() {
        let event = Event { t: 0, x: 5, y: 7, polarity: Polarity::On };
        let pixels = [EventPixel::new(&event)];
        let circles = [(Vector2::new(20.0, 15.0), 4.0)];
        let picture = circle_picture(WindowContent::Events(&pixels), &circles, Sensor::new(40, 30));
        let at =
            |x: f64, y: f64| &picture.rgb[3 * ((y * SCALE) as usize * picture.width + (x * SCALE) as usize)..][..3];
        assert_eq!(at(5.4, 7.4), ON);
        assert_eq!(at(24.5, 15.5), FOUND);
        assert_eq!(at(0.0, 0.0), WHITE);
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("picture.png");
        picture.write_png(&path).unwrap();
        let decoder = png::Decoder::new(io::BufReader::new(std::fs::File::open(path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        assert_eq!(bytes, picture.rgb);
    }

    /// Reads a PNG as red, green and blue.
    fn decoded(png: &[u8]) -> Vec<u8> {
        let mut decoder = png::Decoder::new(io::Cursor::new(png));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().unwrap();
        let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut bytes).unwrap();
        bytes
    }

    #[test]
    fn pictures_of_few_colours_are_exact_and_others_have_fewer_levels() {
        let few = Picture::of_sensor(Sensor::new(200, 90), 1.5, |place| [place.x as u8, 40, 200]);
        assert_eq!((few.width, few.height), (300, 135));
        assert_eq!(decoded(&few.to_png().unwrap()), few.rgb);
        let many = Picture::of_sensor(Sensor::new(256, 256), 1.0, |place| [place.x as u8, place.y as u8, 30]);
        let shown = decoded(&many.to_png().unwrap());
        let largest = many.rgb.iter().zip(&shown).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(largest.is_some_and(|largest| (1..=9).contains(&largest)), "{largest:?}");
    }
}

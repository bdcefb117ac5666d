//! Points of the board in pictures made of light, measured again once a first lens is known: without the fixed pattern of
//! the pixels, and corners of squares with the lens.

use std::borrow::Cow;

use evcal_core::camera::Camera;
use evcal_geometry::board::Board;
use evcal_squares::bearings::Bearings;
use evcal_squares::picture::{Picture, PixelResidual};
use event_recordings::pictures::TimedImage;
use rayon::prelude::*;

use super::corner_fits::CornerFits;
use super::dark_spots::DarkSpot;
use super::dot_fits::DotFits;
use super::pixel_pattern::{PixelPattern, PixelResiduals};
use super::search::BoardPicture;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};

/// Number of pictures that are measured together: few, because the residuals of all their pixels are kept.
const TOGETHER: usize = 16;

/// Measures the points of a board again.
pub struct PointFits(Fits);

enum Fits {
    Corners(CornerFits),
    Dots(DotFits),
}

/// A picture, the board in it, and the residuals of its pixels.
struct Seen<'a> {
    image: Cow<'a, TimedImage>,
    spots: &'a [DarkSpot],
    frame: &'a mut ReferenceFrame,
    residuals: Vec<PixelResidual>,
}

/// The camera with which points are measured again.
pub struct KnownCamera<'a> {
    lens: Bearings,
    pattern: &'a PixelPattern,
}

impl<'a> KnownCamera<'a> {
    /// Prepares a camera with this `pattern` of its pixels.
    pub fn new(camera: &Camera<f64>, pattern: &'a PixelPattern) -> Self {
        let sensor = pattern.sensor();
        Self { lens: Bearings::new(camera, sensor.width.into(), sensor.height.into()), pattern }
    }
}

impl PointFits {
    /// Prepares the fits; `None` for a board whose points cannot be fitted.
    pub fn new(board: &Board) -> Option<Self> {
        match board {
            Board::Squares(board) => CornerFits::new(board).map(|fits| Self(Fits::Corners(fits))),
            Board::Circles(board) => Some(Self(Fits::Dots(DotFits::new(board)))),
        }
    }

    /// Returns the points in words.
    pub fn points(&self) -> &'static str {
        match self.0 {
            Fits::Corners(_) => "corners of squares",
            Fits::Dots(_) => "dots",
        }
    }

    /// Measures the points in `frames` again with the `known` camera, and adds what the pixels show beyond the board to
    /// `beyond`. All frames are of one recording; `pictures` are theirs. If some were not kept, `hand_on` passes all
    /// pictures of the recording in order of time. What cannot be measured is left out.
    ///
    /// # Errors
    /// Errors of `hand_on`.
    pub fn measure_again<T, E>(
        &self,
        known: &KnownCamera<'_>,
        beyond: &mut PixelResiduals,
        frames: &mut [ReferenceFrame],
        pictures: &[BoardPicture],
        hand_on: impl FnOnce(&mut dyn FnMut(TimedImage)) -> Result<T, E>,
    ) -> Result<(), E> {
        let mut waiting: Vec<Seen<'_>> = Vec::new();
        let mut measure = |waiting: &mut Vec<Seen<'_>>| {
            waiting.par_iter_mut().for_each(|seen| seen.frame.circles = self.measure(seen, known).unwrap_or_default());
            for mut seen in waiting.drain(..) {
                let width = seen.image.image.as_ref().map_or(0, |image| image.width());
                beyond.add(&mut seen.residuals, known.pattern, width, position(&seen.image));
            }
        };
        let mut take = |image, spots, frame| {
            waiting.push(Seen { image, spots, frame, residuals: Vec::new() });
            if waiting.len() >= TOGETHER {
                measure(&mut waiting);
            }
        };
        let mut pending = Vec::new();
        for (frame, picture) in frames.iter_mut().zip(pictures) {
            match &picture.kept {
                Some(image) => take(Cow::Borrowed(image), &picture.spots, frame),
                None => pending.push((frame, picture)),
            }
        }
        if !pending.is_empty() {
            let mut pending = pending.into_iter().peekable();
            let mut number = 0;
            hand_on(&mut |image| {
                if let Some((frame, picture)) = pending.next_if(|(_, picture)| picture.number == number) {
                    take(Cow::Owned(image), &picture.spots, frame);
                }
                number += 1;
            })?;
        }
        measure(&mut waiting);
        Ok(())
    }

    /// Returns the points of the board in a picture, and adds the residuals of its pixels.
    fn measure(&self, seen: &mut Seen<'_>, known: &KnownCamera<'_>) -> Option<Vec<ObservedCircle>> {
        let Seen { image, spots, frame, residuals } = seen;
        let position = position(image);
        let grey = image.image.as_ref().ok()?;
        let mut picture = Picture::from_bytes(grey.width(), grey.height(), &grey.pixels)?;
        known.pattern.remove_from(&mut picture, position);
        Some(match &self.0 {
            Fits::Corners(fits) => fits.corners(&picture, position, frame, &known.lens, residuals),
            Fits::Dots(fits) => fits.dots(spots, &picture, position, frame, residuals),
        })
    }
}

/// Returns the column and row of the sensor at the first pixel.
fn position(image: &TimedImage) -> [usize; 2] {
    [image.position.0, image.position.1].map(usize::from)
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use evcal_core::camera::ModelKind;
    use evcal_geometry::numerics::random::normal;
    use event_recordings::pictures::GreyImage;
    use nalgebra::Vector2;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::super::search::{MadeOf, PictureSearch};
    use super::*;

    use evcal_core::sensor::Sensor;

    const SENSOR: Sensor = Sensor::new(150, 110);
    const PICTURES: usize = 40;
    const SPACING: f64 = 22.0;

    /// The middle of the dot in a row and column of the grid: the board moves slowly and turns.
    fn middle(picture: usize, [row, column]: [usize; 2]) -> Vector2<f64> {
        let t = picture as f64;
        let (sin, cos) = (0.004 * t).sin_cos();
        let (x, y) = (SPACING * column as f64, SPACING * row as f64);
        Vector2::new(17.0 + 0.6 * t + cos * x - sin * y, 14.0 + 0.15 * t + sin * x + cos * y)
    }

    /// Passes the pictures of a sensor with a pattern.
    fn show(visit: &mut dyn FnMut(TimedImage)) -> Result<Option<String>, Infallible> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let pixels = SENSOR.pixel_count();
        let pattern: Vec<[f64; 2]> = (0..pixels).map(|_| [1.5 * normal(&mut rng), 0.015 * normal(&mut rng)]).collect();
        for picture in 0..PICTURES {
            let middles: Vec<_> = (0..12).map(|dot| middle(picture, [dot / 4, dot % 4])).collect();
            let mut value = |(pixel, [dark, gain]): (usize, &[f64; 2])| {
                let place = Vector2::new((pixel % 150) as f64, (pixel / 150) as f64);
                let rim = |middle: &Vector2<f64>| 0.5 * libm::erfc(((place - middle).norm() - 6.0) / 1.0);
                let light = 190.0 - 160.0 * middles.iter().map(rim).sum::<f64>();
                (light * (1.0 + gain) + dark + normal(&mut rng)).round() as u8
            };
            let values = pattern.iter().enumerate().map(&mut value).collect();
            let image = GreyImage::new(150, 110, values).unwrap();
            let t = 40_000 * picture as i64;
            visit(TimedImage { exposure: (t, t), exposure_known: true, position: (0, 0), image: Ok(image) });
        }
        Ok(None)
    }

    /// The mean error of a dot in ten neighbouring pictures (px): that of the noise is small.
    fn error(frames: &[ReferenceFrame], pictures: &[BoardPicture]) -> f64 {
        let mut squares = Vec::new();
        for (frames, pictures) in frames.chunks_exact(10).zip(pictures.chunks_exact(10)) {
            for dot in 0..12 {
                let error = |(frame, picture): (&ReferenceFrame, &BoardPicture)| {
                    let circle = frame.circles.iter().find(|circle| circle.index == dot)?;
                    // Which corner of the board is the first does not matter.
                    let middles = (0..12).map(|dot| middle(picture.number, [dot / 4, dot % 4]) - circle.center);
                    middles.min_by(|a, b| a.norm().total_cmp(&b.norm()))
                };
                let errors: Vec<Vector2<f64>> = frames.iter().zip(pictures).filter_map(error).collect();
                squares.push((errors.iter().sum::<Vector2<f64>>() / errors.len() as f64).norm_squared());
            }
        }
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    /// The error of a dot was the same in neighbouring pictures, so it was not in their scatter.
    #[test]
    fn dots_do_not_keep_the_error_of_the_pixels_on_which_they_are() {
        let board: Board = "circles:3x4:22mm:r6mm".parse().unwrap();
        let mut search = PictureSearch::new(&board, MadeOf::Light, 12, 20.0);
        let _ = search.search(0, None, |visit| show(visit));
        let found = search.finish();
        let (mut frames, pictures) = (found.frames, found.pictures);
        assert_eq!(frames.len(), PICTURES);
        let before = error(&frames, &pictures);
        let lens =
            Camera::from_parameters(ModelKind::Radtan4, &[150.0, 150.0, 75.0, 55.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
        let fits = PointFits::new(&board).unwrap();
        let mut pattern = PixelPattern::none(SENSOR);
        for _ in 0..2 {
            let mut seen = PixelResiduals::none(SENSOR);
            let known = KnownCamera::new(&lens, &pattern);
            let _ = fits.measure_again(&known, &mut seen, &mut frames, &pictures, |visit| show(visit));
            pattern = seen.pattern();
        }
        let after = error(&frames, &pictures);
        assert!(before > 0.01 && after < 0.5 * before, "{before} {after}");
    }
}

//! Corners of tags and crossings of squares in pictures made of light, fitted with the lens.
//!
//! The search finds them without knowing the lens. Its corners of tags are biased by blur and by the bend of the tags'
//! sides, its crossings by values between pixels and by the tags beside them (`evcal_squares::print_fit`). Once a first
//! lens is known, the pictures are read again and the corners are fitted with it.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::squares::{Charuco, Checkerboard};
use evcal_geometry::board::{Board, SquareBoard};
use evcal_squares::bearings::Bearings;
use evcal_squares::picture::Picture;
use evcal_squares::print_fit::{PrintFits, SeenPoint};
use event_recordings::pictures::TimedImage;
use nalgebra::Vector2;
use rayon::prelude::*;

use super::search::PICTURES_TOGETHER;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use crate::detection::square_finder::tag_points;

/// Fits the corners on a board of squares.
pub struct CornerFits {
    fits: PrintFits,
    parts: Vec<FittedPart>,
    /// Positions of the points on the board (m).
    board: Vec<Vector2<f64>>,
}

/// A tag or crossing.
struct FittedPart {
    /// The points that its fit yields.
    points: Vec<usize>,
    /// The points from which its fit starts.
    from: Vec<usize>,
}

impl CornerFits {
    /// Prepares the fits; `None` for a board of circles.
    pub fn new(board: &Board) -> Option<Self> {
        let Board::Squares(squares) = board else { return None };
        let raster = squares.raster();
        let points = squares.points();
        let (fits, parts) = match squares {
            SquareBoard::Tags(_) => {
                let part = |corners: [usize; 4]| FittedPart { points: corners.into(), from: corners.into() };
                let parts = tag_points(squares)?.into_iter().map(part).collect();
                (PrintFits::of_tags(&squares.tags(), &raster), parts)
            }
            SquareBoard::Checkerboard(Checkerboard { square, .. }) | SquareBoard::Charuco(Charuco { square, .. }) => {
                let lattice = squares.lattice();
                let (rows, columns) = (usize::from(lattice.rows), usize::from(lattice.columns));
                let near = |place: usize, count: usize| place.saturating_sub(1)..(place + 2).min(count);
                let part = |index: usize| {
                    let from = near(index / columns, rows)
                        .flat_map(|row| near(index % columns, columns).map(move |column| row * columns + column));
                    FittedPart { points: vec![index], from: from.collect() }
                };
                let parts = (0..points.len()).map(part).collect();
                (PrintFits::of_crossings(&points, *square, &raster), parts)
            }
        };
        Some(Self { fits, parts, board: points })
    }

    /// Fits the corners in `frames` again through the lens of `camera`. All frames are of one recording, whose pictures
    /// `hand_on` passes in order of time; `numbers` contains the number of the picture of each frame. What cannot be
    /// fitted is left out.
    ///
    /// # Errors
    /// Errors of `hand_on`.
    pub fn fit_again<T, E>(
        &self,
        camera: &Camera<f64>,
        sensor: Sensor,
        frames: &mut [ReferenceFrame],
        numbers: &[usize],
        hand_on: impl FnOnce(&mut dyn FnMut(TimedImage)) -> Result<T, E>,
    ) -> Result<(), E> {
        let lens = Bearings::new(camera, sensor.width.into(), sensor.height.into());
        let mut pending = frames.iter_mut().zip(numbers).peekable();
        let mut number = 0;
        let mut waiting: Vec<(TimedImage, &mut ReferenceFrame)> = Vec::new();
        let fit = |waiting: &mut Vec<(TimedImage, &mut ReferenceFrame)>| {
            waiting.par_iter_mut().for_each(|(image, frame)| frame.circles = self.corners(image, frame, &lens));
            waiting.clear();
        };
        hand_on(&mut |image| {
            if let Some((frame, _)) = pending.next_if(|(_, of_frame)| **of_frame == number) {
                waiting.push((image, frame));
            }
            number += 1;
            if waiting.len() >= PICTURES_TOGETHER {
                fit(&mut waiting);
            }
        })?;
        fit(&mut waiting);
        Ok(())
    }

    /// Returns the corners in `frame`.
    fn corners(&self, image: &TimedImage, frame: &ReferenceFrame, lens: &Bearings) -> Vec<ObservedCircle> {
        let Ok(grey) = &image.image else { return Vec::new() };
        let Some(picture) = Picture::from_bytes(grey.width(), grey.height(), &grey.pixels) else { return Vec::new() };
        let position = [image.position.0, image.position.1].map(usize::from);
        let origin = Vector2::from(position.map(|place| place as f64));
        let mut by_point: Vec<Option<&ObservedCircle>> = vec![None; self.board.len()];
        for circle in &frame.circles {
            if let Some(place) = by_point.get_mut(circle.index) {
                *place = Some(circle);
            }
        }
        let circle = |index: &usize| by_point.get(*index).copied().flatten();
        let mut circles = Vec::with_capacity(frame.circles.len());
        let mut seen = Vec::new();
        for (number, part) in self.parts.iter().enumerate() {
            let Some(found) = part.points.iter().map(circle).collect::<Option<Vec<_>>>() else { continue };
            seen.clear();
            seen.extend(part.from.iter().filter_map(circle).filter_map(|circle| {
                Some(SeenPoint { board: *self.board.get(circle.index)?, pixel: circle.center - origin })
            }));
            let Some(fitted) = self.fits.fit(&picture, position, Some(lens), number, &seen) else { continue };
            let moved = found.into_iter().zip(fitted.points);
            circles.extend(moved.map(|(corner, at)| ObservedCircle { center: at + origin, ..*corner }));
        }
        circles.sort_by_key(|circle| circle.index);
        circles
    }
}

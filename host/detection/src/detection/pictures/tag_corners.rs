//! Corners of tags in pictures made of light, fitted with the lens.
//!
//! The search finds tags without knowing the lens, and its corners are biased by blur and by the bend of the tags' sides
//! (`evcal_squares::tag_fit`). Once a first lens is known, the pictures are read again and the corners are fitted with it.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use evcal_geometry::board::{Board, SquareBoard};
use evcal_squares::bearings::{Bearings, bend};
use evcal_squares::picture::Picture;
use evcal_squares::tag_fit::{FittedTag, TagFits};
use event_recordings::pictures::TimedImage;
use nalgebra::Vector2;
use rayon::prelude::*;

use super::search::PICTURES_TOGETHER;
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use crate::detection::square_finder::tag_points;

/// Largest number of frames in which lenses are compared.
const MOST_COMPARED: usize = 50;

/// Fits the corners of the tags of a board.
pub struct TagCorners {
    fits: TagFits,
    /// For each tag the indices of the points at its corners.
    points: Vec<[usize; 4]>,
}

impl TagCorners {
    /// Prepares the fits; `None` if the points of the board are not corners of tags.
    pub fn new(board: &Board) -> Option<Self> {
        let Board::Squares(board @ SquareBoard::Tags(_)) = board else { return None };
        Some(Self { fits: TagFits::new(&board.tags(), &board.raster()), points: tag_points(board)? })
    }

    /// Fits the corners in `frames` again through the lens of `camera`. All frames are of one recording, whose pictures
    /// `hand_on` passes in order of time; `numbers` contains the number of the picture of each frame. A tag that cannot
    /// be fitted is left out.
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

    /// Returns by how much the sides of tags in `frames` are bent differently through the lenses of two cameras (px, rms).
    pub fn bend(&self, frames: &[ReferenceFrame], one: &Camera<f64>, other: &Camera<f64>) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for frame in frames.iter().step_by(frames.len().div_ceil(MOST_COMPARED).max(1)) {
            for points in &self.points {
                let point = |index: usize| frame.circles.iter().find(|circle| circle.index == index);
                let [Some(a), Some(b), Some(c), Some(d)] = points.map(point) else { continue };
                if let Some(bend) = bend([a, b, c, d].map(|corner| corner.center), one, other) {
                    sum += bend * bend;
                    count += 1.0;
                }
            }
        }
        if count > 0.0 { f64::sqrt(sum / count) } else { 0.0 }
    }

    /// Returns the corners of the tags in `frame`.
    fn corners(&self, image: &TimedImage, frame: &ReferenceFrame, lens: &Bearings) -> Vec<ObservedCircle> {
        let Ok(grey) = &image.image else { return Vec::new() };
        let Some(picture) = Picture::from_bytes(grey.width(), grey.height(), &grey.pixels) else { return Vec::new() };
        let position = [image.position.0, image.position.1].map(usize::from);
        let origin = Vector2::from(position.map(|place| place as f64));
        let point = |index: usize| frame.circles.iter().find(|circle| circle.index == index);
        let mut circles = Vec::with_capacity(frame.circles.len());
        for (tag, points) in self.points.iter().enumerate() {
            let [Some(a), Some(b), Some(c), Some(d)] = points.map(point) else { continue };
            let corners = [a, b, c, d];
            let start = corners.map(|corner| (corner.center - origin).into());
            let Some(FittedTag { corners: fitted, .. }) = self.fits.fit(&picture, position, Some(lens), tag, &start)
            else {
                continue;
            };
            let moved = corners.into_iter().zip(fitted);
            circles.extend(moved.map(|(corner, at)| ObservedCircle { center: Vector2::from(at) + origin, ..*corner }));
        }
        circles.sort_by_key(|circle| circle.index);
        circles
    }
}

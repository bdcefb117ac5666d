//! Corners of tags and crossings of squares in pictures made of light, fitted with the lens.
//!
//! The search finds them without knowing the lens. Its corners of tags are biased by blur and by the bend of the tags'
//! sides, its crossings by values between pixels and by the tags beside them (`evcal_squares::print_fit`). Once a first
//! lens is known, the pictures are read again and the corners are fitted with it.

use evcal_geometry::board::SquareBoard;
use evcal_geometry::board::squares::{Charuco, Checkerboard};
use evcal_squares::bearings::Bearings;
use evcal_squares::picture::{Picture, PixelResidual};
use evcal_squares::print_fit::{FIRST_BLUR, PrintFits, SeenPoint};
use nalgebra::Vector2;

use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use crate::detection::square_finder::tag_points;

/// Fits the corners on a board of squares.
pub(super) struct CornerFits {
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
    /// Prepares the fits; `None` if a tag has not four points.
    pub(super) fn new(squares: &SquareBoard) -> Option<Self> {
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

    /// Returns the corners of `frame` in its picture, whose first pixel is at `position` of the sensor with this `lens`.
    /// What cannot be fitted is left out. Adds the residuals of the pixels to `residuals`.
    pub(super) fn corners(
        &self,
        picture: &Picture,
        position: [usize; 2],
        frame: &ReferenceFrame,
        lens: &Bearings,
        residuals: &mut Vec<PixelResidual>,
    ) -> Vec<ObservedCircle> {
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
        // The blur is nearly the same in the whole picture.
        let mut blur = FIRST_BLUR;
        for (number, part) in self.parts.iter().enumerate() {
            let Some(found) = part.points.iter().map(circle).collect::<Option<Vec<_>>>() else { continue };
            seen.clear();
            seen.extend(part.from.iter().filter_map(circle).filter_map(|circle| {
                Some(SeenPoint { board: *self.board.get(circle.index)?, pixel: circle.center - origin })
            }));
            let Some(fitted) = self.fits.fit(picture, position, Some(lens), number, &seen, blur) else { continue };
            blur = fitted.blur;
            residuals.extend(fitted.of_pixels);
            let moved = found.into_iter().zip(fitted.points);
            circles.extend(moved.map(|(corner, at)| ObservedCircle { center: at + origin, ..*corner }));
        }
        circles.sort_by_key(|circle| circle.index);
        circles
    }
}

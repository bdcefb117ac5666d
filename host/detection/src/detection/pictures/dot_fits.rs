//! Dots of the board in pictures made of light, measured again without the fixed pattern of the pixels.

use evcal_geometry::board::CircleBoard;
use evcal_squares::picture::{Picture, PixelResidual};
use nalgebra::Vector2;

use super::dark_spots::DarkSpot;
use super::dot::{Surroundings, measure, pixel_residuals};
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};

/// Measures dots again.
pub(super) struct DotFits {
    surroundings: Surroundings,
}

impl DotFits {
    pub(super) fn new(board: &CircleBoard) -> Self {
        Self { surroundings: Surroundings::on(board) }
    }

    /// Returns the dots of `frame` in its `picture` without the pattern, where these `spots` were dark. Adds the residuals of
    /// the pixels to `residuals`.
    pub(super) fn dots(
        &self,
        spots: &[DarkSpot],
        picture: &Picture,
        position: [usize; 2],
        frame: &ReferenceFrame,
        residuals: &mut Vec<PixelResidual>,
    ) -> Vec<ObservedCircle> {
        let origin = Vector2::from(position.map(|place| place as f64));
        let again = |circle: &ObservedCircle| {
            let distance = |center: Vector2<f64>| (center + origin - circle.center).norm();
            let spot = spots.iter().min_by(|a, b| distance(a.center).total_cmp(&distance(b.center)))?;
            let dot = measure(picture, spot, &self.surroundings).ok()?;
            let same = distance(dot.center) < 0.5 * dot.radius;
            same.then(|| {
                residuals.extend(pixel_residuals(picture, spot, &dot, &self.surroundings));
                ObservedCircle { center: dot.center + origin, radius: Some(dot.radius), ..*circle }
            })
        };
        frame.circles.iter().filter_map(again).collect()
    }
}

//! Dots of the board in pictures made of light, measured again without the fixed pattern of the pixels.

use evcal_geometry::board::CircleBoard;
use evcal_squares::picture::{Picture, PixelResidual};
use event_recordings::pictures::GreyImage;
use nalgebra::Vector2;

use super::dark_spots::dark_spots;
use super::dot::{Surroundings, measure, pixel_residuals};
use crate::circles::reference_frame::{ObservedCircle, ReferenceFrame};

/// Measures dots again.
pub(super) struct DotFits {
    surroundings: Surroundings,
    /// Largest radius of a dot (px).
    largest_radius: f64,
}

impl DotFits {
    pub(super) fn new(board: &CircleBoard, largest_radius: f64) -> Self {
        Self { surroundings: Surroundings::on(board), largest_radius }
    }

    /// Returns the dots of `frame` in its picture: they are sought in `image`, and measured in the `picture` without the
    /// pattern. Adds the residuals of the pixels to `residuals`.
    pub(super) fn dots(
        &self,
        image: &GreyImage,
        picture: &Picture,
        position: [usize; 2],
        frame: &ReferenceFrame,
        residuals: &mut Vec<PixelResidual>,
    ) -> Vec<ObservedCircle> {
        let origin = Vector2::from(position.map(|place| place as f64));
        let spots = dark_spots(image, self.largest_radius);
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

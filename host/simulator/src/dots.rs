//! Shapes printed as dots: discs, or shapes that a detector should reject.

use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// The shape of the dots. Their size follows from the board's radius r; they are aligned with the board.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum Dots {
    /// Discs of radius r.
    #[default]
    Circles,
    /// Squares of side 2 r.
    Squares,
    /// Rings of outer radius r and inner radius r / 2.
    Rings,
    /// Squares of side 2 r whose corners are rounded with radius r / 2, as keys of a keyboard.
    Keys,
}

/// Inner radius of a ring, and radius of a key's corners, in radii.
const HALF: f64 = 0.5;

impl Dots {
    /// All shapes.
    pub const ALL: &[Self] = &[Self::Circles, Self::Squares, Self::Rings, Self::Keys];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Circles => "circles",
            Self::Squares => "squares",
            Self::Rings => "rings",
            Self::Keys => "keys",
        }
    }

    /// Returns a short description.
    pub const fn description(self) -> &'static str {
        match self {
            Self::Circles => "Discs",
            Self::Squares => "Squares of the same width, as tags",
            Self::Rings => "Rings, as nuts and washers",
            Self::Keys => "Squares with rounded corners, as keys",
        }
    }

    /// Returns `true` for discs, the shape of a correct board.
    pub(super) fn are_circles(&self) -> bool {
        *self == Self::Circles
    }

    /// Returns the signed distance of `offset` (from the centre) to the shape's edge, positive inside, and the outward
    /// direction there. The scene renders circles without it.
    pub(super) fn depth(self, offset: &Vector2<f64>, radius: f64) -> (f64, Vector2<f64>) {
        let corner = match self {
            Self::Circles | Self::Rings => radius,
            Self::Squares => 0.0,
            Self::Keys => HALF * radius,
        };
        let (outer, normal) = rounded_square(offset, radius, corner);
        if self != Self::Rings {
            return (outer, normal);
        }
        let inner = offset.norm() - HALF * radius;
        if inner < outer { (inner, -normal) } else { (outer, normal) }
    }
}

/// Returns the distance and the direction of [`Dots::depth`] for a square of side 2 `half` with corners of radius
/// `corner`.
fn rounded_square(offset: &Vector2<f64>, half: f64, corner: f64) -> (f64, Vector2<f64>) {
    let signs = offset.map(|value| if value < 0.0 { -1.0 } else { 1.0 });
    let beyond = offset.abs().add_scalar(corner - half);
    let (distance, normal) = if beyond.x > 0.0 && beyond.y > 0.0 {
        let norm = beyond.norm();
        (norm, beyond / norm)
    } else if beyond.x > beyond.y {
        (beyond.x, Vector2::x())
    } else {
        (beyond.y, Vector2::y())
    };
    (corner - distance, normal.component_mul(&signs))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The signed distance decreases fastest in the returned direction, except in the middle of the shape's width.
    #[test]
    fn the_normal_is_the_gradient_of_the_distance() {
        for dots in [Dots::Squares, Dots::Rings, Dots::Keys] {
            for index in 0..2000 {
                let place = Vector2::new(f64::from(index % 50), f64::from(index / 50)) / 20.0;
                let offset = place - Vector2::new(1.2123, 0.9456);
                let (depth, normal) = dots.depth(&offset, 1.0);
                assert!((normal.norm() - 1.0).abs() < 1e-12);
                let step = 1e-6;
                let (out, _) = dots.depth(&(offset + normal * step), 1.0);
                let (aside, _) = dots.depth(&(offset + Vector2::new(-normal.y, normal.x) * step), 1.0);
                assert!((depth - out - step).abs() < 1e-9, "{dots:?} at {offset}");
                assert!((depth - aside).abs() < 1e-9, "{dots:?} at {offset}");
            }
        }
    }

    #[test]
    fn shapes_contain_the_expected_points() {
        let inside = |dots: Dots, x: f64, y: f64| dots.depth(&Vector2::new(x, y), 2.0).0 > 0.0;
        assert!(inside(Dots::Squares, 1.9, -1.9) && !inside(Dots::Squares, 2.1, 0.0));
        assert!(inside(Dots::Keys, 1.9, 0.5) && !inside(Dots::Keys, -1.9, 1.9));
        assert!(inside(Dots::Rings, 0.0, 1.5) && !inside(Dots::Rings, 0.0, 0.9) && !inside(Dots::Rings, 1.5, 1.5));
    }
}

//! The printed circle grid: what the user types for it, and where its circles are.

pub mod homography;
pub mod sheet;

use std::fmt;
use std::str::FromStr;

use evcal_core::pattern::{Layout, Pattern};
use nalgebra::Vector2;

/// A printed circle grid. World coordinates: origin at the first circle, x along a row, y from row
/// to row, z = 0 on the board; a camera in front of it is at z < 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Arrangement and number of the circles.
    pub pattern: Pattern,
    /// Lattice spacing in metres (OpenCV's convention: on an asymmetric board half the distance of
    /// neighbours in a row).
    pub spacing: f64,
    /// Radius of a circle in metres.
    pub radius: f64,
}

/// The form of a board description, shown with every error.
pub const BOARD_FORM: &str = "LAYOUT:ROWSxCOLUMNS:SPACING:rRADIUS with LAYOUT acircles or circles and lengths in mm, cm, m or in, \
     for example acircles:9x4:55mm:r17.5mm";

/// Why a board description was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
#[error("board {text:?}: {reason}; write {BOARD_FORM}")]
pub struct BoardError {
    text: String,
    reason: String,
}

impl Board {
    /// Number of circles on the board.
    pub fn circle_count(&self) -> usize {
        self.pattern.circle_count()
    }

    /// Centre of circle `index` on the board plane, in metres.
    pub fn circle_center(&self, index: usize) -> Vector2<f64> {
        let (x, y) = self.pattern.lattice_position(index);
        Vector2::new(f64::from(x), f64::from(y)) * self.spacing
    }

    /// The circle nearest to `point` (metres on the board plane), if one lies within one lattice
    /// spacing of it in x and y.
    pub fn nearest_circle(&self, point: Vector2<f64>) -> Option<usize> {
        let x = point.x / self.spacing;
        let y = point.y / self.spacing;
        if !(-1.0..=1024.0).contains(&x) || !(-1.0..=1024.0).contains(&y) {
            return None;
        }
        match self.pattern.layout {
            Layout::Symmetric => self.pattern.index_at(x.round() as i32, y.round() as i32),
            Layout::Asymmetric => {
                // The circles sit where x + y is even: a square lattice turned by 45°.
                let diagonal = ((x + y) / 2.0).round();
                let antidiagonal = ((x - y) / 2.0).round();
                self.pattern.index_at((diagonal + antidiagonal) as i32, (diagonal - antidiagonal) as i32)
            }
        }
    }

    /// Distance between neighbouring circle centres, in metres.
    pub fn neighbour_distance(&self) -> f64 {
        match self.pattern.layout {
            Layout::Symmetric => self.spacing,
            Layout::Asymmetric => self.spacing * std::f64::consts::SQRT_2,
        }
    }

    /// Centre of the area that the circles cover, in metres.
    pub fn middle(&self) -> Vector2<f64> {
        let count = self.circle_count();
        (0..count).map(|index| self.circle_center(index)).sum::<Vector2<f64>>() / count as f64
    }
}

fn length(text: &str) -> Option<f64> {
    // "mm" and "cm" end in "m" too, so the longer units are tried first.
    let (number, factor) = [("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254), ("m", 1.0)]
        .iter()
        .find_map(|(unit, factor)| text.strip_suffix(unit).map(|number| (number, *factor)))?;
    let value: f64 = number.trim().parse().ok()?;
    (value.is_finite() && value > 0.0).then_some(value * factor)
}

impl FromStr for Board {
    type Err = BoardError;

    fn from_str(text: &str) -> Result<Self, BoardError> {
        let error = |reason: String| BoardError { text: text.to_owned(), reason };
        let parts: Vec<&str> = text.split(':').collect();
        let &[layout, size, spacing, radius] = parts.as_slice() else {
            return Err(error(format!("has {} part(s) between colons, not 4", parts.len())));
        };
        let layout = match layout {
            "acircles" => Layout::Asymmetric,
            "circles" => Layout::Symmetric,
            other => return Err(error(format!("unknown layout {other:?}"))),
        };
        let count = |part: &str| part.parse::<u8>().ok().filter(|count| (2..=64).contains(count));
        let (rows, columns) = size
            .split_once('x')
            .and_then(|(rows, columns)| Some((count(rows)?, count(columns)?)))
            .ok_or_else(|| error(format!("{size:?} is not ROWSxCOLUMNS with numbers from 2 to 64")))?;
        let spacing =
            length(spacing).ok_or_else(|| error(format!("spacing {spacing:?} is not a length with a unit")))?;
        let radius = radius
            .strip_prefix('r')
            .and_then(length)
            .ok_or_else(|| error(format!("radius {radius:?} is not r and a length with a unit")))?;
        let board = Self { pattern: Pattern { layout, rows, columns }, spacing, radius };
        if 2.0 * radius >= board.neighbour_distance() {
            return Err(error("the circles overlap: is the radius a diameter?".to_owned()));
        }
        Ok(board)
    }
}

impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let layout = match self.pattern.layout {
            Layout::Asymmetric => "acircles",
            Layout::Symmetric => "circles",
        };
        let millimetres = |metres: f64| (metres * 1e9).round() / 1e6;
        write!(
            f,
            "{layout}:{}x{}:{}mm:r{}mm",
            self.pattern.rows,
            self.pattern.columns,
            millimetres(self.spacing),
            millimetres(self.radius)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_the_form_of_the_documentation_and_writes_it_back() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        assert_eq!(board.pattern, Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 });
        assert!((board.spacing - 0.055).abs() < 1e-12 && (board.radius - 0.0175).abs() < 1e-12);
        assert_eq!(board.to_string(), "acircles:9x4:55mm:r17.5mm");
        let same: Board = "acircles:9x4:5.5cm:r0.0175m".parse().unwrap();
        assert_eq!(same.to_string(), board.to_string());
    }

    #[test]
    fn a_typo_gets_the_right_form() {
        for text in [
            "",
            "acircle:9x4:55mm:r17mm",
            "acircles:9x4:55:r17mm",
            "acircles:9:55mm:r17mm",
            "acircles:9x4:55mm:17mm",
            "acircles:9x4:55mm:r55mm",
            "acircles:9x4:-5mm:r1mm",
            "circles:1x4:5mm:r1mm",
            "circles:3x4:nanmm:r1mm",
        ] {
            let message = text.parse::<Board>().unwrap_err().to_string();
            assert!(message.contains("acircles:9x4:55mm:r17.5mm"), "{message}");
        }
    }

    #[test]
    fn the_nearest_circle_is_the_one_a_search_finds() {
        for text in ["acircles:9x4:55mm:r17.5mm", "circles:6x3:40mm:r10mm"] {
            let board: Board = text.parse().unwrap();
            for step in 0..4000 {
                let point = Vector2::new((step % 63) as f64 * 0.0071 - 0.02, (step / 63) as f64 * 0.0083 - 0.02);
                let (distance, nearest) = (0..board.circle_count())
                    .map(|index| ((board.circle_center(index) - point).norm(), index))
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .unwrap();
                if distance < board.radius * 1.1 {
                    assert_eq!(board.nearest_circle(point), Some(nearest), "{text} {point}");
                }
            }
        }
    }
}

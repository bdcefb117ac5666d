//! The order of circles on a board.

use evcal_core::pattern::{Layout, Pattern};
use nalgebra::Vector2;
use opencv::core::{Point2f, Size, Vector};

use super::OpencvError;
use crate::functions;
use crate::threads::call;

/// Calls OpenCV's `findCirclesGrid` on candidate centres (pixels): returns for every circle of the board, in board
/// order, the index of its candidate. `None` if the board was not found.
///
/// OpenCV does not check for a mirrored order; the caller does.
pub fn find_circles_grid(points: &[Vector2<f64>], pattern: Pattern) -> Result<Option<Vec<usize>>, OpencvError> {
    if points.len() < pattern.circle_count() || !points.iter().all(|p| p.x.is_finite() && p.y.is_finite()) {
        return Ok(None);
    }
    let flags = match pattern.layout {
        Layout::Asymmetric => functions::CALIB_CB_ASYMMETRIC_GRID,
        Layout::Symmetric => functions::CALIB_CB_SYMMETRIC_GRID,
    };
    let candidates: Vector<Point2f> = points.iter().map(|point| Point2f::new(point.x as f32, point.y as f32)).collect();
    let size = Size::new(i32::from(pattern.columns), i32::from(pattern.rows));
    let mut centers = Vector::<Point2f>::new();
    // Without a detector OpenCV takes the candidates for the centres of circles.
    let search = || functions::find_circles_grid(&candidates, size, &mut centers, flags, None);
    if !call("findCirclesGrid", search)? {
        return Ok(None);
    }
    // In its second attempt OpenCV transforms the points by a homography and back, so they equal their candidates only
    // up to rounding.
    const ROUNDING: f64 = 0.01;
    let mut order = Vec::with_capacity(centers.len());
    for center in centers {
        let center = Vector2::new(f64::from(center.x), f64::from(center.y));
        let nearest = points
            .iter()
            .enumerate()
            .map(|(index, point)| ((point - center).norm(), index))
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        match nearest {
            Some((distance, index)) if distance < ROUNDING && !order.contains(&index) => order.push(index),
            _ => return Ok(None),
        }
    }
    Ok((order.len() == pattern.circle_count()).then_some(order))
}

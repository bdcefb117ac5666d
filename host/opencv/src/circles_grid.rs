//! The order of circles on a board.

use evcal_core::pattern::{Layout, Pattern};
use nalgebra::Vector2;
use opencv::calib3d;
use opencv::core::{Point2f, Size, Vector};

use super::{OpencvError, SINGLE_THREAD, exception};

/// OpenCV's `findCirclesGrid` on candidate centres (pixels): for every circle of the board, in board
/// order, the index of its candidate. `None` when the board was not found.
///
/// OpenCV does not check that the order is not mirrored; the caller does.
pub fn find_circles_grid(points: &[Vector2<f64>], pattern: Pattern) -> Result<Option<Vec<usize>>, OpencvError> {
    const CALL: &str = "findCirclesGrid";
    SINGLE_THREAD.clone()?;
    if points.len() < pattern.circle_count() || !points.iter().all(|p| p.x.is_finite() && p.y.is_finite()) {
        return Ok(None);
    }
    let flags = match pattern.layout {
        Layout::Asymmetric => calib3d::CALIB_CB_ASYMMETRIC_GRID,
        Layout::Symmetric => calib3d::CALIB_CB_SYMMETRIC_GRID,
    };
    let run = || -> opencv::Result<_> {
        let candidates: Vector<Point2f> = points.iter().map(|p| Point2f::new(p.x as f32, p.y as f32)).collect();
        let mut centers = Vector::<Point2f>::new();
        let size = Size::new(i32::from(pattern.columns), i32::from(pattern.rows));
        let found = calib3d::find_circles_grid(&candidates, size, &mut centers, flags, None)?;
        Ok(found.then_some(centers))
    };
    let Some(centers) = run().map_err(|error| exception(CALL, error))? else { return Ok(None) };
    // The second of OpenCV's attempts returns points that it has moved to and fro through a
    // homography, so they equal their candidates but for rounding.
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

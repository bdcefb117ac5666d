//! Selection of views for a calibration: as different from each other as possible.
//!
//! Every view is a point in a space of features that matter for a camera: position of the board in the image, size, tilt and
//! roll. Views are selected one by one, always the one furthest from all selected ones (Gonzalez 1985), so that any number of
//! first views is a good selection; views with few circles count as nearer than they are.

use evcal_core::sensor::Sensor;
use nalgebra::{Matrix3, SVector, Vector2};

use super::sighting::BoardPoint;
use evcal_geometry::board::Board;
use evcal_geometry::board::homography::homography;

/// Image position (2), scale, foreshortening (2), perspective (2), roll (2).
type Features = SVector<f64, 9>;

/// Weight of perspective relative to positions in the image (in fractions of the sensor): it is small, and determines the focal
/// length.
const PERSPECTIVE_WEIGHT: f64 = 2.0;
/// Weight of roll, which carries little information.
const ROLL_WEIGHT: f64 = 0.3;
/// Largest value of a feature.
const LARGEST_FEATURE: f64 = 5.0;

fn features(points: &[BoardPoint], board: &Board, sensor: Sensor) -> Option<Features> {
    let extent = 0.5 * board.point(board.point_count().checked_sub(1)?).norm();
    let plane: Vec<Vector2<f64>> = points.iter().map(|point| (point.object - board.middle()) / extent).collect();
    let image: Vec<Vector2<f64>> = points.iter().map(|point| point.image).collect();
    let h: Matrix3<f64> = homography(&plane, &image)?;
    let h = h / h[(2, 2)];
    let middle = Vector2::new(h[(0, 2)], h[(1, 2)]);
    let perspective = Vector2::new(h[(2, 0)], h[(2, 1)]);
    // Derivative of the image by the plane at the middle of the board.
    let local = h.fixed_view::<2, 2>(0, 0) - middle * perspective.transpose();
    let determinant = local.determinant();
    let stretch = local.transpose() * local / determinant.abs();
    let roll = local.column(0).normalize();
    let center = points.iter().map(|point| point.image).sum::<Vector2<f64>>() / points.len() as f64;
    let features = Features::from([
        center.x / f64::from(sensor.width),
        center.y / f64::from(sensor.height),
        0.5 * determinant.abs().ln() * 0.5,
        0.5 * (stretch[(0, 0)] - stretch[(1, 1)]),
        stretch[(0, 1)],
        PERSPECTIVE_WEIGHT * perspective.x,
        PERSPECTIVE_WEIGHT * perspective.y,
        ROLL_WEIGHT * roll.x,
        ROLL_WEIGHT * roll.y,
    ]);
    // One view with an extreme homography must not stretch the space.
    features
        .iter()
        .all(|value| value.is_finite())
        .then(|| features.map(|value| value.clamp(-LARGEST_FEATURE, LARGEST_FEATURE)))
}

/// Returns the indices of at most `count` of `views`, the most useful first.
pub fn select_views(views: &[&[BoardPoint]], board: &Board, sensor: Sensor, count: usize) -> Vec<usize> {
    let candidates: Vec<(usize, Features, f64)> = views
        .iter()
        .enumerate()
        .filter_map(|(index, points)| {
            let completeness = points.len() as f64 / board.point_count() as f64;
            Some((index, features(points, board, sensor)?, completeness))
        })
        .collect();
    // Distance to the nearest selected view, times completeness; before the first, the tilt decides.
    let mut merits: Vec<f64> = candidates
        .iter()
        .map(|(_, features, completeness)| features.fixed_rows::<2>(5).norm() * completeness)
        .collect();
    let mut taken = Vec::new();
    while taken.len() < count.min(candidates.len()) {
        let best = merits
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)))
            .and_then(|(position, _)| candidates.get(position).map(|candidate| (position, candidate)));
        let Some((position, (index, chosen, _))) = best else { break };
        let first = taken.is_empty();
        taken.push(*index);
        for (merit, (_, features, completeness)) in merits.iter_mut().zip(&candidates) {
            let distance = (features - chosen).norm() * completeness;
            *merit = if first { distance } else { merit.min(distance) };
        }
        if let Some(merit) = merits.get_mut(position) {
            *merit = f64::NEG_INFINITY;
        }
    }
    taken
}

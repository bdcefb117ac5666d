//! Whether the board in pictures is as it is described: flat, evenly printed, with the stated lengths.
//!
//! The calibration takes every point of the board to be where the description has it. The lens takes up a part of the
//! difference if it is not, and the scatter of the residuals does not show how much. So the positions of all points are
//! estimated, too (Strobl and Hirzinger 2011): alternately each point, from its residuals in all pictures, and the lens with the
//! poses. Position, orientation and size of the board as a whole stay as they are described.

use evcal_core::camera::{Camera, MAX_PARAMETERS};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Matrix3, Point3, SMatrix, SVector, Vector2, Vector3};

use super::bundle::{PictureView, SeenDot, picture_bundle};
use super::calibration::{HUBER, PictureCalibration};
use evcal_geometry::board::Board;

/// Number of alternations. Each carries over a part of what is left.
const ROUNDS: usize = 12;
/// Expected distance of a point from its place, as a share of the board's length: without it, points that few pictures show
/// would go astray.
const EXPECTED: f64 = 0.005;
/// Step of the derivatives by the position of a point (m).
const STEP: f64 = 1e-6;

/// The lens with the board as the pictures show it.
pub struct UnevenBoard {
    /// The lens.
    pub camera: Camera<f64>,
    /// Largest distance of a point from its described place (m).
    pub farthest: f64,
}

/// Estimates the positions of the points of `board` from the pictures of `calibration`. `None` if they do not determine them.
pub fn uneven_board(
    calibration: &PictureCalibration,
    board: &Board,
    sensor: Sensor,
    fixed: &[Option<f64>; MAX_PARAMETERS],
) -> Option<UnevenBoard> {
    let points: Vec<Vector3<f64>> = (0..board.point_count()).map(|index| board.point(index).push(0.0)).collect();
    let first = points.first()?;
    let length = points.iter().map(|point| (point - first).norm()).fold(0.0, f64::max);
    let prior = (calibration.spread.max(1e-3) / (EXPECTED * length)).powi(2);
    let mut shifts = vec![Vector3::zeros(); points.len()];
    let mut camera = calibration.camera;
    let mut poses: Vec<Isometry3<f64>> = calibration.posed.iter().map(|posed| posed.pose.inverse()).collect();
    let mut noise = vec![1.0; poses.len()];
    for _ in 0..ROUNDS {
        let mut sums = vec![(Matrix3::from_diagonal_element(prior), Vector3::zeros()); points.len()];
        for ((posed, pose), noise) in calibration.posed.iter().zip(&poses).zip(&noise) {
            for circle in &posed.circles {
                let (Some(point), Some(shift)) = (points.get(circle.index), shifts.get(circle.index)) else { continue };
                let place = point + shift;
                let Some(seen) = pixel(&camera, pose, place) else { continue };
                let along =
                    |axis: usize| Some((pixel(&camera, pose, place + STEP * Vector3::ith(axis, 1.0))? - seen) / STEP);
                let (Some(x), Some(y), Some(z)) = (along(0), along(1), along(2)) else { continue };
                let jacobian = SMatrix::<f64, 2, 3>::from_columns(&[x, y, z]) / *noise;
                if let Some((normal, right)) = sums.get_mut(circle.index) {
                    *normal += jacobian.transpose() * jacobian;
                    *right += jacobian.transpose() * (circle.center - seen) / *noise;
                }
            }
        }
        for (shift, (normal, right)) in shifts.iter_mut().zip(sums) {
            *shift += normal.cholesky()?.solve(&(right - prior * *shift));
        }
        remove_motion(&points, &mut shifts)?;
        let views: Vec<PictureView> = calibration
            .posed
            .iter()
            .zip(&poses)
            .map(|(posed, pose)| {
                let dots = posed.circles.iter().filter_map(|circle| {
                    let (point, shift) = (points.get(circle.index)?, shifts.get(circle.index)?);
                    let moved = pixel(&camera, pose, point + shift)? - pixel(&camera, pose, *point)?;
                    Some(SeenDot { object: point.xy(), radius: 0.0, image: circle.center - moved })
                });
                PictureView { dots: dots.collect(), pose: *pose }
            })
            .collect();
        let solved = picture_bundle(&camera, &views, sensor, HUBER, fixed)?;
        (camera, poses, noise) = (solved.camera, solved.poses, solved.noise);
    }
    let farthest = shifts.iter().map(Vector3::norm).fold(0.0, f64::max);
    Some(UnevenBoard { camera, farthest })
}

fn pixel(camera: &Camera<f64>, pose: &Isometry3<f64>, place: Vector3<f64>) -> Option<Vector2<f64>> {
    camera.project(&(pose * Point3::from(place)).coords)
}

/// Removes from the shifts of `points` what a motion and a change of size of the whole board would do.
fn remove_motion(points: &[Vector3<f64>], shifts: &mut [Vector3<f64>]) -> Option<()> {
    let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let effect = |point: &Vector3<f64>| {
        let arm = point - middle;
        let turned = -arm.cross_matrix();
        let mut rows = SMatrix::<f64, 3, 7>::zeros();
        rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&turned);
        rows.fixed_view_mut::<3, 1>(0, 6).copy_from(&arm);
        rows
    };
    let (mut normal, mut right) = (SMatrix::<f64, 7, 7>::zeros(), SVector::<f64, 7>::zeros());
    for (point, shift) in points.iter().zip(&*shifts) {
        let rows = effect(point);
        normal += rows.transpose() * rows;
        right += rows.transpose() * shift;
    }
    let motion = normal.cholesky()?.solve(&right);
    for (point, shift) in points.iter().zip(shifts) {
        *shift -= effect(point) * motion;
    }
    Some(())
}

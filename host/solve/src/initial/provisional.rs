//! A camera and poses during a recording: computed quickly, accurate to some tenths of a pixel.

use evcal_core::camera::{Camera, ModelKind};
use evcal_core::sensor::Sensor;
use nalgebra::Isometry3;

use super::InitialSettings;
use super::first_camera::views_differ;
use super::native_start::native_start;
use super::pose::homography_pose;
use super::settings::{HUBER, START_VIEWS};
use super::sighting::BoardPoint;
use super::view_selection::select_views;
use evcal_detection::circles::reference_frame::ObservedCircle;
use evcal_geometry::board::Board;

fn points(circles: &[ObservedCircle], board: &Board) -> Vec<BoardPoint> {
    let point = |circle: &ObservedCircle| BoardPoint { object: board.point(circle.index), image: circle.center };
    circles.iter().map(point).collect()
}

/// Computes a camera of model `kind` from the most different of `views`, each the circles of one window; `None` if they are too
/// few or too similar.
pub fn provisional_camera(
    views: &[&[ObservedCircle]],
    board: &Board,
    sensor: Sensor,
    kind: ModelKind,
    settings: &InitialSettings,
) -> Option<Camera<f64>> {
    let views: Vec<Vec<BoardPoint>> = views.iter().map(|circles| points(circles, board)).collect();
    let views: Vec<&[BoardPoint]> = views.iter().map(Vec::as_slice).collect();
    let chosen: Vec<&[BoardPoint]> = select_views(&views, board, sensor, START_VIEWS)
        .into_iter()
        .filter_map(|position| views.get(position).copied())
        .collect();
    let bundle = native_start(kind, &chosen, sensor, settings)?;
    views_differ(&bundle).ok()?;
    Some(bundle.camera)
}

/// Computes `T_camera_world` of the board whose `circles` the camera sees; `None` if they do not determine it.
pub fn provisional_pose(camera: &Camera<f64>, circles: &[ObservedCircle], board: &Board) -> Option<Isometry3<f64>> {
    homography_pose(camera, &points(circles, board), HUBER).map(|fit| fit.pose)
}

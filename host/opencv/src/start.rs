//! Functions of OpenCV used at the start of a calibration.

use evcal_core::camera::ModelKind;
use evcal_core::grid::GridCandidate;
use evcal_core::pattern::Pattern;
use evcal_core::sensor::Sensor;
use evcal_detection::detection::PlacedCircle;
use evcal_detection::detection::no_board::NoBoard;
use evcal_detection::detection::settings::WholeBoardFinder;
use evcal_solve::initial::{BoardPoint, InitialSettings, PlanarPose, PlanePoint, Start, StartedCamera};
use nalgebra::Vector2;

use crate::opencv_start::opencv_start;
use crate::{find_circles_grid, solve_pnp_ransac_ippe};

/// `calibrateCamera` or `fisheye::calibrate`, and `solvePnPRansac` with IPPE.
#[derive(Clone, Copy, Debug)]
pub struct Opencv;

impl Start for Opencv {
    fn name(&self) -> &'static str {
        "OpenCV"
    }

    fn camera(
        &self,
        kind: ModelKind,
        views: &[&[BoardPoint]],
        sensor: Sensor,
        settings: &InitialSettings,
    ) -> StartedCamera {
        let (camera, opencv) = opencv_start(kind, views, sensor, settings);
        StartedCamera { camera, opencv: Some(opencv) }
    }

    fn plane_pose(&self, points: &[PlanePoint], threshold: f64, iterations: u16) -> Option<PlanarPose> {
        let plane: Vec<[f64; 2]> = points.iter().map(|point| point.plane.into()).collect();
        let image: Vec<[f64; 2]> = points.iter().map(|point| point.image.into()).collect();
        // An exception of OpenCV means that this frame has no pose, and the caller counts such frames.
        let found = solve_pnp_ransac_ippe(&plane, &image, threshold, iterations).ok()??;
        Some(PlanarPose { solutions: found.solutions, inliers: found.inliers })
    }
}

/// `findCirclesGrid`.
pub const WHOLE_BOARD: WholeBoardFinder = WholeBoardFinder(find_whole_board);

fn find_whole_board(candidates: &[GridCandidate<f32>], pattern: &Pattern) -> Result<Vec<PlacedCircle>, NoBoard> {
    if candidates.len() < pattern.circle_count() {
        return Err(NoBoard::TooFewCircles);
    }
    let centers: Vec<Vector2<f64>> = candidates.iter().map(|candidate| candidate.center.cast()).collect();
    let order =
        find_circles_grid(&centers, *pattern).map_err(|_| NoBoard::OpencvFailed)?.ok_or(NoBoard::OpencvFoundNone)?;
    Ok(order.into_iter().enumerate().map(|(index, candidate)| PlacedCircle { index, candidate }).collect())
}

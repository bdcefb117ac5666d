//! The pose of one frame, some of whose circles may be wrong.

use evcal_core::camera::Camera;
use nalgebra::Isometry3;

use super::bundle_adjustment::ImagePoint;
use super::planar_pose::PlanePoint;
use super::pose::{cost, normalised, refine_pose};
use super::settings::{HUBER, InitialSettings};
use super::sighting::BoardPoint;
use super::start::start_of;

/// Ratio of costs up to which IPPE's second solution is refined too.
const RIVAL_COST: f64 = 5.0;

/// Number of RANSAC samples per frame.
const RANSAC_SAMPLES: u16 = 100;

/// Smallest share of a frame's circles that must agree with its pose.
const MIN_INLIER_FRACTION: f64 = 0.6;

/// Pose of a frame by [`robust_pose`].
#[derive(Clone, Debug, PartialEq)]
pub struct FramePose {
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
    /// For each point, `true` if it agrees with the pose.
    pub inliers: Vec<bool>,
    /// Root mean square distance of the agreeing points, in pixels.
    pub rms: f64,
}

/// Reasons why a frame has no pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseError {
    /// PnP found no pose.
    NotFound,
    /// Too few circles agree with the best pose.
    TooFewInliers,
    /// The camera would be behind the board.
    BehindBoard,
    /// The agreeing points are too far from their projections.
    LargeError,
}

/// Estimates the pose of one frame: PnP (IPPE) in RANSAC, refined by least squares with Huber's loss. The second
/// solution of IPPE is refined too if its cost is at most `RIVAL_COST` times as high as the first one's. The better
/// refined one is returned.
pub fn robust_pose(
    camera: &Camera<f64>,
    points: &[BoardPoint],
    settings: &InitialSettings,
) -> Result<FramePose, PoseError> {
    let (before, plane): (Vec<BoardPoint>, Vec<PlanePoint>) = normalised(camera, points).into_iter().unzip();
    let focal = camera.parameters().iter().take(2).sum::<f64>() / 2.0;
    let planar = start_of(settings).plane_pose(&plane, settings.max_circle_error / focal, RANSAC_SAMPLES);
    let planar = planar.ok_or(PoseError::NotFound)?;
    let agreeing: Vec<BoardPoint> = planar.inliers.iter().filter_map(|&inlier| before.get(inlier).copied()).collect();
    // A solution of IPPE is refined only if its cost is at most `RIVAL_COST` times the smallest cost.
    let costs: Vec<f64> = planar.solutions.iter().map(|start| cost(camera, start, &agreeing, HUBER)).collect();
    let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
    let refined = planar
        .solutions
        .iter()
        .zip(&costs)
        .filter(|(_, cost)| **cost <= RIVAL_COST * least)
        .filter_map(|(start, _)| refine_pose(camera, &agreeing, start, HUBER))
        .min_by(|a, b| a.cost.total_cmp(&b.cost))
        .ok_or(PoseError::NotFound)?;
    settle_pose(camera, points, &refined.pose, settings)
}

/// Refines `start` on the points that agree with it until these do not change, and checks the result.
pub fn settle_pose(
    camera: &Camera<f64>,
    points: &[BoardPoint],
    start: &Isometry3<f64>,
    settings: &InitialSettings,
) -> Result<FramePose, PoseError> {
    const ROUNDS: usize = 3;
    let mut pose = *start;
    let mut inliers = Vec::new();
    for _ in 0..ROUNDS {
        let now: Vec<bool> =
            points.iter().map(|point| point.distance(camera, &pose) <= settings.max_circle_error).collect();
        if now == inliers {
            break;
        }
        inliers = now;
        let agreeing: Vec<BoardPoint> =
            points.iter().zip(&inliers).filter(|(_, inlier)| **inlier).map(|(point, _)| *point).collect();
        let enough = MIN_INLIER_FRACTION * points.len() as f64;
        if agreeing.len() < settings.min_circles || (agreeing.len() as f64) < enough {
            return Err(PoseError::TooFewInliers);
        }
        pose = refine_pose(camera, &agreeing, &pose, HUBER).ok_or(PoseError::NotFound)?.pose;
    }
    if pose.inverse().translation.vector.z >= 0.0 {
        return Err(PoseError::BehindBoard);
    }
    let squares: Vec<f64> = points
        .iter()
        .zip(&inliers)
        .filter(|(_, inlier)| **inlier)
        .map(|(point, _)| point.distance(camera, &pose).powi(2))
        .collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    if rms.is_finite() && rms <= settings.max_frame_rms {
        Ok(FramePose { pose, inliers, rms })
    } else {
        Err(PoseError::LargeError)
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;
    use nalgebra::{Point3, Vector2, Vector3};

    use super::*;

    fn camera() -> Camera<f64> {
        Camera::from_parameters(ModelKind::Radtan4, &[345.0, 344.0, 170.0, 127.0, -0.3, 0.09, 1e-3, -5e-4]).unwrap()
    }

    #[test]
    fn outliers_do_not_move_the_pose() {
        let camera = camera();
        let truth = Isometry3::new(Vector3::new(-0.1, -0.2, 0.7), Vector3::new(0.3, -0.4, 0.9));
        let points: Vec<BoardPoint> = (0..36)
            .map(|index| {
                let object = Vector2::new(f64::from(index % 6) * 0.04, f64::from(index / 6) * 0.04);
                let seen = truth * Point3::new(object.x, object.y, 0.0);
                let displaced = if index % 5 == 0 { 15.0 + f64::from(index) } else { 0.0 };
                BoardPoint { object, image: camera.project(&seen.coords).unwrap() + Vector2::new(displaced, 0.0) }
            })
            .collect();
        let found = robust_pose(&camera, &points, &InitialSettings::default()).unwrap();
        assert!((found.pose.to_homogeneous() - truth.to_homogeneous()).norm() < 1e-6);
        for (index, inlier) in found.inliers.iter().enumerate() {
            assert_eq!(*inlier, index % 5 != 0);
        }
    }

    #[test]
    fn a_frame_of_noise_has_no_pose() {
        let points: Vec<BoardPoint> = (0..36)
            .map(|index| BoardPoint {
                object: Vector2::new(f64::from(index % 6) * 0.04, f64::from(index / 6) * 0.04),
                image: Vector2::new(f64::from(index * 7919 % 346), f64::from(index * 104_729 % 260)),
            })
            .collect();
        assert!(robust_pose(&camera(), &points, &InitialSettings::default()).is_err());
        assert_eq!(robust_pose(&camera(), &points[..3], &InitialSettings::default()), Err(PoseError::NotFound));
    }
}

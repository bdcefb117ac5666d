//! Pose of one frame: PnP in RANSAC, then least squares on the reprojection.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, SMatrix, Vector2, Vector3, Vector6};

use super::planar_pose::PlanePoint;
use super::settings::{HUBER, InitialSettings};
use super::sighting::BoardPoint;
use evcal_core::camera::{Camera, ProjectionParameterJacobian};
use evcal_geometry::board::homography::{homography, pose_from_homography};
use evcal_geometry::numerics::huber::{huber_cost, huber_weight};
use evcal_geometry::numerics::levenberg_marquardt::{Costed, Schedule, minimise};
use evcal_geometry::numerics::rigid::step_pose;

/// How a refinement goes.
const SCHEDULE: Schedule =
    Schedule { first_damping: 1e-4, smallest_damping: 1e-9, largest_damping: 1e6, most_steps: 20, smallest_gain: 1e-9 };

/// Smallest z of a bearing whose x/z, y/z PnP can work with (84° from the optical axis).
const MIN_BEARING_Z: f64 = 0.1;

/// Cost, as a multiple of the better one's, up to which IPPE's second solution is followed too.
const RIVAL_COST: f64 = 5.0;

/// Samples of RANSAC for each frame.
const RANSAC_SAMPLES: u16 = 100;

/// Smallest share of a frame's circles that must agree with its pose.
const MIN_INLIER_FRACTION: f64 = 0.6;

/// A reprojection error and what it depends on.
pub struct ReprojectionResidual {
    /// Projected minus observed image point, in pixels.
    pub error: Vector2<f64>,
    /// Its derivative by the step of [`step_pose`].
    pub by_pose: SMatrix<f64, 2, 6>,
    /// Its derivative by the camera's parameters.
    pub by_parameters: ProjectionParameterJacobian<f64>,
}

/// The reprojection error of `point`; `None` outside the camera's domain.
pub fn residual(camera: &Camera<f64>, pose: &Isometry3<f64>, point: &BoardPoint) -> Option<ReprojectionResidual> {
    let turned = pose.rotation * Vector3::new(point.object.x, point.object.y, 0.0);
    let projection = camera.project_with_jacobians(&(turned + pose.translation.vector))?;
    let by_rotation: Matrix3<f64> = -turned.cross_matrix();
    let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
    by_pose.fixed_columns_mut::<3>(0).copy_from(&(projection.by_point * by_rotation));
    by_pose.fixed_columns_mut::<3>(3).copy_from(&projection.by_point);
    Some(ReprojectionResidual {
        error: projection.pixel - point.image,
        by_pose,
        by_parameters: projection.by_parameters,
    })
}

/// Distance in pixels of `point` from its projection; infinite outside the camera's domain.
pub fn distance(camera: &Camera<f64>, pose: &Isometry3<f64>, point: &BoardPoint) -> f64 {
    let seen = pose * Point3::new(point.object.x, point.object.y, 0.0);
    camera.project(&seen.coords).map_or(f64::INFINITY, |pixel| (pixel - point.image).norm())
}

fn cost(camera: &Camera<f64>, pose: &Isometry3<f64>, points: &[BoardPoint], huber: f64) -> f64 {
    points.iter().map(|point| huber_cost(distance(camera, pose, point).powi(2), huber)).sum()
}

/// A pose and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
    /// Sum of Huber's losses, in px².
    pub cost: f64,
}

/// The `T_camera_world` near `start` that minimises Huber's loss of the reprojection errors of
/// `points`; `None` if `start` puts a point outside the camera's domain or the points do not fix it.
pub fn refine_pose(camera: &Camera<f64>, points: &[BoardPoint], start: &Isometry3<f64>, huber: f64) -> Option<Fit> {
    let mut best = Costed { estimate: *start, cost: cost(camera, start, points, huber) };
    if !best.cost.is_finite() || points.len() < 3 {
        return None;
    }
    let linearise = |pose: &Isometry3<f64>| {
        let mut normal = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        for residual in points.iter().filter_map(|point| residual(camera, pose, point)) {
            let weight = huber_weight(residual.error.norm_squared(), huber);
            normal += residual.by_pose.transpose() * residual.by_pose * weight;
            gradient += residual.by_pose.transpose() * residual.error * weight;
        }
        (normal, gradient)
    };
    let mut determined = true;
    minimise(&mut best, &SCHEDULE, linearise, |pose, (normal, gradient), damping| {
        let mut damped = *normal;
        for index in 0..6 {
            damped[(index, index)] *= 1.0 + damping;
        }
        let factor = damped.cholesky();
        determined &= factor.is_some();
        let estimate = step_pose(pose, &-factor?.solve(gradient));
        Some(Costed { estimate, cost: cost(camera, &estimate, points, huber) })
    });
    determined.then_some(Fit { pose: best.estimate, cost: best.cost })
}

/// Those of `points` whose pixel has a bearing before the camera, and their images free of distortion.
fn normalised(camera: &Camera<f64>, points: &[BoardPoint]) -> Vec<(BoardPoint, PlanePoint)> {
    points
        .iter()
        .filter_map(|point| {
            let bearing = camera.unproject(&point.image).filter(|bearing| bearing.z > MIN_BEARING_Z)?;
            Some((*point, PlanePoint { plane: point.object, image: bearing.xy() / bearing.z }))
        })
        .collect()
}

/// Pose from all points by their homography, refined; without a defence against wrong points other than
/// Huber's loss.
pub fn homography_pose(camera: &Camera<f64>, points: &[BoardPoint], huber: f64) -> Option<Fit> {
    let normalised = normalised(camera, points);
    let plane: Vec<Vector2<f64>> = normalised.iter().map(|(_, point)| point.plane).collect();
    let image: Vec<Vector2<f64>> = normalised.iter().map(|(_, point)| point.image).collect();
    refine_pose(camera, points, &pose_from_homography(&homography(&plane, &image)?)?, huber)
}

/// Pose of a frame by [`robust_pose`].
#[derive(Clone, Debug, PartialEq)]
pub struct FramePose {
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
    /// For each point whether it agrees with the pose.
    pub inliers: Vec<bool>,
    /// Root mean square distance of those that agree, in pixels.
    pub rms: f64,
}

/// Why a frame has no pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PoseError {
    /// PnP found none.
    NotFound,
    /// Too few circles agree with the best pose.
    TooFewInliers,
    /// The camera would be behind the board.
    BehindBoard,
    /// The agreeing circles are too far from their projections.
    LargeError,
}

/// Pose of one frame: PnP (IPPE) in RANSAC, refined by least squares with Huber's loss; both solutions
/// of IPPE are followed, the better one counts.
pub fn robust_pose(
    camera: &Camera<f64>,
    points: &[BoardPoint],
    settings: &InitialSettings,
) -> Result<FramePose, PoseError> {
    let (before, plane): (Vec<BoardPoint>, Vec<PlanePoint>) = normalised(camera, points).into_iter().unzip();
    let focal = camera.parameters().iter().take(2).sum::<f64>() / 2.0;
    let planar = settings.start.plane_pose(&plane, settings.max_circle_error / focal, RANSAC_SAMPLES);
    let planar = planar.ok_or(PoseError::NotFound)?;
    let agreeing: Vec<BoardPoint> = planar.inliers.iter().filter_map(|&inlier| before.get(inlier).copied()).collect();
    // The second solution of IPPE counts only where it explains the images almost as well.
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

/// Refines `start` on the points that agree with it until they stay the same, and judges the result.
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
            points.iter().map(|point| distance(camera, &pose, point) <= settings.max_circle_error).collect();
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
        .map(|(point, _)| distance(camera, &pose, point).powi(2))
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
    use super::*;
    use evcal_core::camera::ModelKind;

    fn camera() -> Camera<f64> {
        Camera::from_parameters(ModelKind::Radtan4, &[345.0, 344.0, 170.0, 127.0, -0.3, 0.09, 1e-3, -5e-4]).unwrap()
    }

    #[test]
    fn jacobians_equal_difference_quotients() {
        let pose = Isometry3::new(Vector3::new(-0.1, -0.2, 0.7), Vector3::new(0.3, -0.4, 0.9));
        let point = BoardPoint { object: Vector2::new(0.11, 0.23), image: Vector2::new(170.0, 127.0) };
        let exact = residual(&camera(), &pose, &point).unwrap();
        for index in 0..6 {
            let at = |step: f64| {
                let mut direction = Vector6::zeros();
                direction[index] = step;
                residual(&camera(), &step_pose(&pose, &direction), &point).unwrap().error
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((numeric - exact.by_pose.column(index)).norm() < 1e-5 * exact.by_pose.norm(), "{index}");
        }
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

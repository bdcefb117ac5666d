//! Pose of one frame: PnP in RANSAC, then least squares on the reprojection.

use nalgebra::{Isometry3, Matrix3, Matrix6, Point3, SMatrix, Vector2, Vector3, Vector6};

use super::bundle_adjustment::{ImagePoint, ReprojectionResidual};
use super::planar_pose::PlanePoint;
use super::sighting::BoardPoint;
use evcal_core::camera::Camera;
use evcal_geometry::board::homography::{homography, pose_from_homography};
use evcal_geometry::numerics::huber::{huber_cost, huber_weight};
use evcal_geometry::numerics::levenberg_marquardt::{Costed, Schedule, minimise};
use evcal_geometry::numerics::rigid::step_pose;

/// Schedule of the optimiser.
const SCHEDULE: Schedule =
    Schedule { first_damping: 1e-4, smallest_damping: 1e-9, largest_damping: 1e6, most_steps: 20, smallest_gain: 1e-9 };

/// Smallest z of a bearing whose x/z, y/z PnP can use (84° from the optical axis).
const MIN_BEARING_Z: f64 = 0.1;

impl ImagePoint for BoardPoint {
    fn distance(&self, camera: &Camera<f64>, pose: &Isometry3<f64>) -> f64 {
        let seen = pose * Point3::new(self.object.x, self.object.y, 0.0);
        camera.project(&seen.coords).map_or(f64::INFINITY, |pixel| (pixel - self.image).norm())
    }

    fn residual(&self, camera: &Camera<f64>, pose: &Isometry3<f64>) -> Option<ReprojectionResidual> {
        let turned = pose.rotation * Vector3::new(self.object.x, self.object.y, 0.0);
        let projection = camera.project_with_jacobians(&(turned + pose.translation.vector))?;
        let by_rotation: Matrix3<f64> = -turned.cross_matrix();
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        by_pose.fixed_columns_mut::<3>(0).copy_from(&(projection.by_point * by_rotation));
        by_pose.fixed_columns_mut::<3>(3).copy_from(&projection.by_point);
        Some(ReprojectionResidual {
            error: projection.pixel - self.image,
            by_pose,
            by_parameters: projection.by_parameters,
        })
    }
}

pub fn cost(camera: &Camera<f64>, pose: &Isometry3<f64>, points: &[BoardPoint], huber: f64) -> f64 {
    points.iter().map(|point| huber_cost(point.distance(camera, pose).powi(2), huber)).sum()
}

/// A pose with its cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fit {
    /// `T_camera_world`.
    pub pose: Isometry3<f64>,
    /// Sum of Huber's losses, in px².
    pub cost: f64,
}

/// Returns the `T_camera_world` near `start` that minimises Huber's loss of the reprojection errors of `points`; `None` if
/// `start` puts a point outside the camera's domain or the points do not determine the pose.
pub fn refine_pose(camera: &Camera<f64>, points: &[BoardPoint], start: &Isometry3<f64>, huber: f64) -> Option<Fit> {
    let mut best = Costed { estimate: *start, cost: cost(camera, start, points, huber) };
    if !best.cost.is_finite() || points.len() < 3 {
        return None;
    }
    let linearise = |pose: &Isometry3<f64>| {
        let mut normal = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        for residual in points.iter().filter_map(|point| point.residual(camera, pose)) {
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

/// Returns the `points` whose pixel has a bearing in front of the camera, with their undistorted images.
pub fn normalised(camera: &Camera<f64>, points: &[BoardPoint]) -> Vec<(BoardPoint, PlanePoint)> {
    points
        .iter()
        .filter_map(|point| {
            let bearing = camera.unproject(&point.image).filter(|bearing| bearing.z > MIN_BEARING_Z)?;
            Some((*point, PlanePoint { plane: point.object, image: bearing.xy() / bearing.z }))
        })
        .collect()
}

/// Estimates the pose from all points by their homography, and refines it; only Huber's loss reduces the effect of wrong points.
pub fn homography_pose(camera: &Camera<f64>, points: &[BoardPoint], huber: f64) -> Option<Fit> {
    let normalised = normalised(camera, points);
    let plane: Vec<Vector2<f64>> = normalised.iter().map(|(_, point)| point.plane).collect();
    let image: Vec<Vector2<f64>> = normalised.iter().map(|(_, point)| point.image).collect();
    refine_pose(camera, points, &pose_from_homography(&homography(&plane, &image)?)?, huber)
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
        let exact = point.residual(&camera(), &pose).unwrap();
        for index in 0..6 {
            let at = |step: f64| {
                let mut direction = Vector6::zeros();
                direction[index] = step;
                point.residual(&camera(), &step_pose(&pose, &direction)).unwrap().error
            };
            let numeric = (at(1e-6) - at(-1e-6)) / 2e-6;
            assert!((numeric - exact.by_pose.column(index)).norm() < 1e-5 * exact.by_pose.norm(), "{index}");
        }
    }
}

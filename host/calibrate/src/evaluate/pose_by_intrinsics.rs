//! Derivative of a camera's pose by its intrinsics, when the pose is estimated from the board.
//!
//! With the pixels u(X, c) of the board's circles X in the camera frame, a change of the intrinsics c is compensated by the
//! change of the pose that keeps the pixels where they are, in the least-squares sense.

use evcal_core::camera::Camera;
use evcal_core::sensor::Sensor;
use nalgebra::{DMatrix, Isometry3, Matrix2x3, SMatrix, Vector2, Vector3};

use evcal_geometry::board::Board;

/// Fewest circles that determine a pose.
const FEWEST: usize = 4;
/// Step of a point (m).
const POINT_STEP: f64 = 1e-6;
/// Step of a parameter, relative to its size and to 1.
const STEP: f64 = 1e-6;

/// The camera of a trajectory, with its uncertainty.
#[derive(Clone, Debug)]
pub struct KnownCamera {
    /// The lens.
    pub camera: Camera<f64>,
    /// Width and height of its sensor.
    pub sensor: Sensor,
    /// Covariance of the intrinsics, in their order.
    pub covariance: DMatrix<f64>,
    /// The board in its view.
    pub board: Board,
}

/// Returns the derivatives: three rows of the translation of `T_world_camera` (m, axes of the world), three of its rotation (rad,
/// about the axes of the camera), and a column for each intrinsic parameter; `None` if too few circles are in the image.
pub fn pose_by_intrinsics(known: &KnownCamera, pose: &Isometry3<f64>) -> Option<DMatrix<f64>> {
    let KnownCamera { camera, sensor, board, .. } = known;
    let neighbours = neighbours(camera)?;
    let to_camera = pose.rotation.inverse().to_rotation_matrix().into_inner();
    let mut normal = SMatrix::<f64, 6, 6>::zeros();
    let mut right = DMatrix::zeros(6, neighbours.len());
    let mut seen = 0;
    for index in 0..board.point_count() {
        let center = board.point(index);
        let point = pose.inverse_transform_point(&[center.x, center.y, 0.0].into()).coords;
        let inside = |pixel: &Vector2<f64>| {
            let within = |value: f64, size: u16| (-0.5..f64::from(size) - 0.5).contains(&value);
            within(pixel.x, sensor.width) && within(pixel.y, sensor.height)
        };
        let Some(by_point) = camera.project(&point).filter(inside).and_then(|_| by_point(camera, &point)) else {
            continue;
        };
        let mut by_pose = SMatrix::<f64, 2, 6>::zeros();
        by_pose.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-by_point * to_camera));
        by_pose.fixed_view_mut::<2, 3>(0, 3).copy_from(&(by_point * point.cross_matrix()));
        let mut columns = Vec::with_capacity(neighbours.len());
        for Neighbours { before, after, step } in &neighbours {
            let (Some(before), Some(after)) = (before.project(&point), after.project(&point)) else { break };
            columns.push((after - before) / *step);
        }
        if columns.len() < neighbours.len() {
            continue;
        }
        seen += 1;
        normal += by_pose.tr_mul(&by_pose);
        for (column, by_parameter) in columns.iter().enumerate() {
            let mut sum = right.fixed_view_mut::<6, 1>(0, column);
            sum -= by_pose.tr_mul(by_parameter);
        }
    }
    if seen < FEWEST {
        return None;
    }
    Some(normal.cholesky()?.solve(&right))
}

/// Cameras with one parameter slightly smaller and slightly larger.
struct Neighbours {
    before: Camera<f64>,
    after: Camera<f64>,
    /// Difference of the parameters.
    step: f64,
}

/// Returns the neighbours for each parameter.
fn neighbours(camera: &Camera<f64>) -> Option<Vec<Neighbours>> {
    let parameters = camera.parameters();
    let moved = |index: usize, by: f64| {
        let mut moved = parameters.clone();
        moved.get_mut(index).map(|parameter| *parameter += by)?;
        Camera::from_parameters(camera.kind(), &moved)
    };
    let pair = |(index, value): (usize, &f64)| {
        let step = STEP * value.abs().max(1.0);
        Some(Neighbours { before: moved(index, -step)?, after: moved(index, step)?, step: 2.0 * step })
    };
    parameters.iter().enumerate().map(pair).collect()
}

/// Returns the derivatives of the pixel by the point.
fn by_point(camera: &Camera<f64>, point: &Vector3<f64>) -> Option<Matrix2x3<f64>> {
    let mut by = Matrix2x3::zeros();
    for axis in 0..3 {
        let step = Vector3::ith(axis, POINT_STEP);
        let change = camera.project(&(point + step))? - camera.project(&(point - step))?;
        by.set_column(axis, &(change / (2.0 * POINT_STEP)));
    }
    Some(by)
}

#[cfg(test)]
mod tests {
    use evcal_core::camera::ModelKind;

    use super::*;

    fn known(focal: f64, cx: f64) -> KnownCamera {
        let parameters = [focal, focal, cx, 130.0, -0.3, 0.1, 0.0, 0.0];
        KnownCamera {
            camera: Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap(),
            sensor: (346, 260).into(),
            covariance: DMatrix::zeros(8, 8),
            board: "acircles:9x4:55mm:r17.5mm".parse().unwrap(),
        }
    }

    /// A tilted camera in front of the middle of the board, at a distance of 0.7 m.
    fn pose() -> Isometry3<f64> {
        let middle = known(300.0, 173.0).board.middle();
        let tilt = nalgebra::UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.1));
        let away = tilt * Vector3::new(0.0, 0.0, 0.7);
        Isometry3::from_parts((Vector3::new(middle.x, middle.y, 0.0) - away).into(), tilt)
    }

    #[test]
    fn a_longer_focal_length_moves_the_camera_away() {
        let by = pose_by_intrinsics(&known(300.0, 173.0), &pose()).unwrap();
        // Both focal lengths 1 % longer.
        let change = (by.column(0) + by.column(1)) * 3.0;
        let shift = pose().rotation.inverse() * change.fixed_rows::<3>(0).into_owned();
        assert!((shift - Vector3::new(0.0, 0.0, -0.007)).norm() < 1e-3, "{shift}");
        // The principal point 3 px to the right: the board appears further left, as if the camera were rotated to the right about
        // y by about 3 / 300.
        let change = by.column(2) * 3.0;
        let turn = change.fixed_rows::<3>(3).into_owned();
        assert!((turn - Vector3::new(0.0, 0.01, 0.0)).norm() < 2e-3, "{turn}");
    }

    /// The pose estimated with other intrinsics from the same pixels, by Gauss-Newton, agrees with the derivatives.
    #[test]
    fn a_pose_from_other_intrinsics_agrees_with_the_derivatives() {
        let (was, is) = (known(300.0, 173.0), known(300.3, 172.8));
        let by = pose_by_intrinsics(&was, &pose()).unwrap();
        let predicted = (by.column(0) + by.column(1)) * 0.3 + by.column(2) * -0.2;
        let points: Vec<Vector3<f64>> =
            (0..was.board.point_count()).map(|index| was.board.point(index).push(0.0)).collect();
        let project = |known: &KnownCamera, pose: &Isometry3<f64>, point: &Vector3<f64>| {
            known.camera.project(&pose.inverse_transform_point(&(*point).into()).coords).unwrap()
        };
        let moved = |pose: &Isometry3<f64>, step: &nalgebra::SVector<f64, 6>| {
            let turn = nalgebra::UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned());
            let shift = step.fixed_rows::<3>(0).into_owned();
            Isometry3::from_parts((pose.translation.vector + shift).into(), pose.rotation * turn)
        };
        let mut found = pose();
        for _ in 0..10 {
            let (mut normal, mut right) = (SMatrix::<f64, 6, 6>::zeros(), SMatrix::<f64, 6, 1>::zeros());
            for point in &points {
                let off = project(&was, &pose(), point) - project(&is, &found, point);
                let mut by = SMatrix::<f64, 2, 6>::zeros();
                for axis in 0..6 {
                    let step = nalgebra::SVector::<f64, 6>::ith(axis, 1e-6);
                    let change =
                        project(&is, &moved(&found, &step), point) - project(&is, &moved(&found, &-step), point);
                    by.set_column(axis, &(change / 2e-6));
                }
                normal += by.tr_mul(&by);
                right += by.tr_mul(&off);
            }
            found = moved(&found, &normal.cholesky().unwrap().solve(&right));
        }
        let shift = found.translation.vector - pose().translation.vector;
        let turn = (pose().rotation.inverse() * found.rotation).scaled_axis();
        let (of_shift, of_turn) =
            (predicted.fixed_rows::<3>(0).into_owned(), predicted.fixed_rows::<3>(3).into_owned());
        assert!((shift - of_shift).norm() < 0.02 * shift.norm(), "{shift} {of_shift}");
        assert!((turn - of_turn).norm() < 0.02 * turn.norm(), "{turn} {of_turn}");
    }
}

//! The pose of the second camera that follows from the first camera's pose and the mount, with its derivatives.
//!
//! With `T_world_first` = (R, p), `T_second_first` = (S, s) and a = −Sᵀs, the position of the second camera in the frame of the
//! first: `T_world_second` = (R Sᵀ, p + R a). If the first camera rotates by δ (its axes) and moves by d (world), and the mount
//! rotates by ε (axes of the first camera) and moves by e (axes of the second), the second camera rotates by S (δ − ε), in its
//! own axes, and moves by d + R ((δ − ε) × a) − R Sᵀ e.

use nalgebra::{Matrix3, SMatrix, Vector3};

use super::mount::{LINE_DELAY, MOST, Mount, OFFSET, RATE, ROTATION, TRANSLATION};
use evcal_solve::solve::rows::pose_bin::PoseBin;

/// Number of parameters of a pose: rotation (camera frame), then translation (world).
pub const POSE: usize = 6;
/// Number of parameters that determine the second camera's pose: the pose of the first, then the mount.
pub const CAUSES: usize = POSE + MOST;

/// The second camera at one time.
#[derive(Clone, Debug)]
pub struct Carried {
    /// Its pose; the control points belong to the first camera, and their Jacobians are not used.
    pub pose: PoseBin,
    /// Derivative of its pose by the pose of the first camera and by the mount.
    pub by: SMatrix<f64, POSE, CAUSES>,
}

impl Carried {
    /// Computes the pose for the pose `first` of the first camera at time `t` (s) of the second clock, which is the time of a row
    /// that is `rows` below the middle of a frame.
    pub fn new(first: &PoseBin, mount: &Mount, t: f64, rows: f64) -> Self {
        let second_first = mount.second_first.rotation.to_rotation_matrix().into_inner();
        let aside = mount.second_first.inverse().translation.vector;
        let (rotation, place) = (first.rotation_matrix(), first.translation_vector());
        let turning = Vector3::from(first.angular_velocity);
        let own_rotation = rotation * second_first.transpose();
        // Seconds of the first clock per second of the second.
        let pace = 1.0 - mount.rate;
        let angular_velocity = second_first * turning * pace;
        let velocity = (Vector3::from(first.linear_velocity) + rotation * turning.cross(&aside)) * pace;
        let moved_by_turn = -(rotation * aside.cross_matrix());

        let mut by = SMatrix::<f64, POSE, CAUSES>::zeros();
        let mut put = |row: usize, column: usize, part: Matrix3<f64>| {
            by.fixed_view_mut::<3, 3>(row, column).copy_from(&part);
        };
        put(0, 0, second_first);
        put(3, 0, moved_by_turn);
        put(3, 3, Matrix3::identity());
        put(0, POSE + ROTATION, -second_first);
        put(3, POSE + ROTATION, -moved_by_turn);
        put(3, POSE + TRANSLATION, -own_rotation);
        for (column, factor) in [(OFFSET, -1.0), (RATE, mount.middle - t), (LINE_DELAY, rows * pace)] {
            by.fixed_view_mut::<3, 1>(0, POSE + column).copy_from(&(angular_velocity * (factor / pace)));
            by.fixed_view_mut::<3, 1>(3, POSE + column).copy_from(&(velocity * (factor / pace)));
        }
        let pose = PoseBin {
            rotation: std::array::from_fn(|row| std::array::from_fn(|column| own_rotation[(row, column)])),
            translation: (place + rotation * aside).into(),
            angular_velocity: angular_velocity.into(),
            linear_velocity: velocity.into(),
            ..first.clone()
        };
        Self { pose, by }
    }
}

#[cfg(test)]
mod tests {
    use evcal_solve::trajectory::Trajectory;
    use nalgebra::{Isometry3, Translation3, UnitQuaternion};

    use super::*;
    use crate::second_camera::start::tests::{first_pose, fitted_to};

    const STEP: f64 = 1e-6;
    const T: f64 = 3.2;
    const ROWS: f64 = 0.7;

    /// The first camera, around the time of its clock that corresponds to `T`.
    fn trajectory() -> Trajectory {
        fitted_to(|t| first_pose(t, 1.0), 2.0..3.5)
    }

    /// The pose of the second camera at `T`.
    fn carried(trajectory: &Trajectory) -> Carried {
        let first = PoseBin::new(trajectory, mount().first_time(T)).unwrap();
        Carried::new(&first, &mount(), T, ROWS)
    }

    fn mount() -> Mount {
        let second_first = Isometry3::new(Vector3::new(-0.1, 0.01, 0.02), Vector3::new(0.02, 0.1, -0.3));
        Mount { second_first, offset: 0.5, rate: 1e-3, middle: 2.0, line_delay: Some(2e-5) }
    }

    fn second(first: &Isometry3<f64>, mount: &Mount) -> Isometry3<f64> {
        first * mount.second_first.inverse()
    }

    #[test]
    fn derivatives_agree_with_central_differences() {
        let trajectory = trajectory();
        let carried = carried(&trajectory);
        let at = second(&trajectory.pose(mount().first_time(T)).unwrap(), &mount());
        assert!((carried.pose.translation_vector() - at.translation.vector).norm() < 1e-12);
        assert!((carried.pose.rotation_matrix() - at.rotation.to_rotation_matrix().matrix()).norm() < 1e-12);
        let moved = |cause: usize, step: f64| {
            let mut delta = [0.0; CAUSES];
            delta[cause] = step;
            let (turn, shift) = (Vector3::from_column_slice(&delta[..3]), Vector3::from_column_slice(&delta[3..6]));
            let mount_moved = mount().moved(&delta[POSE..]);
            // If the clock changes, the first camera has another pose.
            let stamp = T - mount().line_delay.unwrap() * ROWS;
            let first = trajectory.pose(mount_moved.first_time(mount_moved.row_time(stamp, ROWS))).unwrap();
            let first = Isometry3::from_parts(
                Translation3::from(first.translation.vector + shift),
                first.rotation * UnitQuaternion::from_scaled_axis(turn),
            );
            second(&first, &mount_moved)
        };
        for cause in 0..CAUSES {
            let (after, before) = (moved(cause, STEP), moved(cause, -STEP));
            let turn = (before.rotation.inverse() * after.rotation).scaled_axis() / (2.0 * STEP);
            let shift = (after.translation.vector - before.translation.vector) / (2.0 * STEP);
            let column = carried.by.column(cause);
            assert!((column.fixed_rows::<3>(0) - turn).norm() < 1e-6, "{cause}: {column} {turn}");
            assert!((column.fixed_rows::<3>(3) - shift).norm() < 1e-6, "{cause}: {column} {shift}");
        }
    }

    #[test]
    fn the_velocity_of_the_second_camera_agrees_with_its_poses() {
        let trajectory = trajectory();
        let carried = carried(&trajectory);
        let at = |t: f64| second(&trajectory.pose(mount().first_time(t)).unwrap(), &mount());
        let (after, before) = (at(T + STEP), at(T - STEP));
        let turn = (before.rotation.inverse() * after.rotation).scaled_axis() / (2.0 * STEP);
        let shift = (after.translation.vector - before.translation.vector) / (2.0 * STEP);
        assert!((Vector3::from(carried.pose.angular_velocity) - turn).norm() < 1e-6);
        assert!((Vector3::from(carried.pose.linear_velocity) - shift).norm() < 1e-6);
        assert!((carried.pose.rotation_matrix() - at(T).rotation.to_rotation_matrix().matrix()).norm() < 1e-12);
    }
}

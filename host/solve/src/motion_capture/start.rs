//! Start of the comparison with motion capture: offset of the clocks, rotations, translations, each with a test of its validity.
//!
//! 1. **Offset**: the rotation rates of camera and marker body are the same whatever their axes. Their correlation over all
//!    shifts must have one clear peak.
//! 2. **Rotation** of the marker body relative to the camera: the one that maps one angular velocity to the other (Wahba's
//!    problem, as in Park and Martin 1994 for hand-eye calibration). The rotation of the board in the room is the mean of the
//!    rotations that follow pose by pose.
//! 3. **Translations and scale**: linear least squares. The scale shows other units, and its sign mirrored axes.
//!
//! If this fails, poses are interpreted as inverse, or with quaternions in another order; an interpretation that fits is named in
//! the error.

use nalgebra::{Isometry3, Matrix3, Quaternion, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

use super::error::MotionCaptureError;
use super::fit::HandEye;
use super::path::Path;
use crate::trajectory::alignment::{ComparedTurns, Offset, Overlap, Series, Turns, check_axes, offset};
use evcal_geometry::numerics::rigid::best_rotation;
use evcal_geometry::timed_pose::TimedPose;

/// Step of the grid on which rotation rates are compared (s).
const STEP: f64 = 0.01;
/// Half the time over which an angular velocity is computed (s).
const WINDOW: f64 = 0.04;
/// Fewest poses in that time.
const FEWEST_POSES: usize = 4;
/// Smallest overlap: as a share of the shorter series, and in seconds.
const OVERLAP: Overlap = Overlap { share: 0.4, seconds: 2.0 };
/// Ratio of the second to the first singular value below which the camera rotated about one axis only.
const ONE_AXIS: f64 = 0.02;
/// Largest unexplained share of the squared angular velocities.
const LEFT: f64 = 0.2;
/// Largest relative difference of lengths.
const SAME_LENGTH: f64 = 0.03;
/// Largest relative difference of lengths in another unit.
const OTHER_UNIT: f64 = 0.1;

/// Result of the start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Offset, rotations, translations.
    pub hand_eye: HandEye,
    /// Largest correlation of the rotation rates.
    pub correlation: f64,
}

/// Returns the angular velocities of a device with these poses.
fn turns(poses: &[TimedPose]) -> Turns {
    let (start, end) = (poses.first().map_or(0.0, |one| one.t), poses.last().map_or(0.0, |one| one.t));
    Series::new(start, end, STEP, |t| angular_velocity(poses, t))
}

/// Returns the slope of the rotation vectors from the middle pose, of the poses within [`WINDOW`] of `t`.
fn angular_velocity(poses: &[TimedPose], t: f64) -> Option<Vector3<f64>> {
    let from = poses.partition_point(|pose| pose.t < t - WINDOW);
    let to = poses.partition_point(|pose| pose.t <= t + WINDOW);
    let near = poses.get(from..to)?;
    let (first, last) = (near.first()?.t, near.last()?.t);
    if near.len() < FEWEST_POSES || first > t - 0.5 * WINDOW || last < t + 0.5 * WINDOW {
        return None;
    }
    let middle = near.get(near.len() / 2)?.pose.rotation;
    let count = near.len() as f64;
    let mean_time = near.iter().map(|pose| pose.t).sum::<f64>() / count;
    let turns = near.iter().map(|pose| (pose.t - mean_time, (middle.inverse() * pose.pose.rotation).scaled_axis()));
    let (product, square) = turns
        .fold((Vector3::zeros(), 0.0), |(product, square), (time, turn)| (product + turn * time, square + time * time));
    (square > 0.0).then(|| product / square)
}

/// Computes a start from the poses of the camera and of the marker body.
///
/// # Errors
/// [`MotionCaptureError`] names the quantity that was not found, and the reason.
pub fn start(camera: &[TimedPose], capture: &[TimedPose]) -> Result<Start, MotionCaptureError> {
    let of_camera = turns(camera);
    of_camera.rates().check()?;
    let path = Path::new(camera)?;
    let find = |capture: &[TimedPose]| {
        let of_body = turns(capture);
        let Offset { seconds: offset, correlation } = offset(&of_camera, &of_body, OVERLAP)?;
        let body_camera = rotation(&of_camera, &of_body, offset)?;
        let hand_eye = translations(&path, capture, offset, body_camera.inverse())?;
        Ok(Start { hand_eye, correlation })
    };
    let read_otherwise = |read: fn(&Isometry3<f64>) -> Isometry3<f64>| {
        let poses: Vec<_> = capture.iter().map(|pose| TimedPose { t: pose.t, pose: read(&pose.pose) }).collect();
        find(&poses).is_ok()
    };
    find(capture).map_err(|error| match error {
        // The rotation rate of a quaternion does not depend on the order of its numbers.
        MotionCaptureError::OtherAxes { .. } if read_otherwise(w_first) => MotionCaptureError::QuaternionOrder,
        MotionCaptureError::OtherAxes { .. } if read_otherwise(Isometry3::inverse) => MotionCaptureError::Inverted,
        MotionCaptureError::OtherAxes { .. } if read_otherwise(conjugate) => MotionCaptureError::Conjugate,
        error => error,
    })
}

/// Returns the pose for a quaternion with w first.
fn w_first(pose: &Isometry3<f64>) -> Isometry3<f64> {
    let [x, y, z, w]: [f64; 4] = pose.rotation.coords.into();
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(x, y, z, w));
    Isometry3::from_parts(pose.translation, rotation)
}

/// Returns the pose for a quaternion of the opposite rotation.
fn conjugate(pose: &Isometry3<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(pose.translation, pose.rotation.inverse())
}

/// Computes `R_body_camera`.
fn rotation(camera: &Turns, body: &Turns, offset: f64) -> Result<UnitQuaternion<f64>, MotionCaptureError> {
    let turns = ComparedTurns::new(camera, body, offset);
    check_axes(&turns.products, ONE_AXIS)?;
    let best = turns.rotation().ok_or(MotionCaptureError::Singular)?;
    let left = 1.0 - 2.0 * best.explained / (turns.of_first + turns.of_second);
    if left > LEFT {
        return Err(MotionCaptureError::OtherAxes { left });
    }
    Ok(best.rotation)
}

/// Unknowns of the linear step: `t_mocap_world`, `t_camera_body` in the capture's lengths, and the scale.
const UNKNOWNS: usize = 7;

fn translations(
    path: &Path,
    capture: &[TimedPose],
    offset: f64,
    camera_body: UnitQuaternion<f64>,
) -> Result<HandEye, MotionCaptureError> {
    let middle = path.start() + offset;
    let pairs: Vec<_> = capture.iter().filter_map(|pose| Some((pose.pose, path.at(pose.t - offset)?.pose))).collect();
    let columns = pairs.iter().flat_map(|(body, camera)| {
        let body = (body.rotation * camera_body.inverse()).to_rotation_matrix().into_inner();
        let camera = camera.rotation.to_rotation_matrix().into_inner();
        (0..3).map(move |axis| (body.column(axis).into_owned(), camera.column(axis).into_owned()))
    });
    let mocap_world = best_rotation(columns);
    let mut matrix = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::zeros();
    let mut right = SVector::<f64, UNKNOWNS>::zeros();
    for (body, camera) in &pairs {
        let mut by = SMatrix::<f64, 3, UNKNOWNS>::zeros();
        by.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        let turned = mocap_world * camera.rotation.to_rotation_matrix();
        by.fixed_view_mut::<3, 3>(0, 3).copy_from(turned.matrix());
        by.fixed_view_mut::<3, 1>(0, 6).copy_from(&(mocap_world * camera.translation.vector));
        matrix += by.tr_mul(&by);
        right += by.tr_mul(&body.translation.vector);
    }
    let solution = matrix.cholesky().ok_or(MotionCaptureError::Singular)?.solve(&right);
    check_scale(solution[6])?;
    let three = |first: usize| Translation3::from(Vector3::from_fn(|axis, _| solution[first + axis]));
    let mocap_world = UnitQuaternion::from_rotation_matrix(&mocap_world);
    Ok(HandEye {
        camera_body: Isometry3::from_parts(three(3), camera_body),
        mocap_world: Isometry3::from_parts(three(0), mocap_world),
        offset,
        drift: 0.0,
        scale: 1.0,
        middle,
    })
}

fn check_scale(scale: f64) -> Result<(), MotionCaptureError> {
    let units = [(1000.0, "millimetres"), (100.0, "centimetres"), (39.37, "inches"), (3.281, "feet")];
    if (scale - 1.0).abs() < SAME_LENGTH {
        return Ok(());
    }
    // Mirrored rotations look like rotations about other axes, but positions show the mirror.
    if (scale + 1.0).abs() < OTHER_UNIT {
        return Err(MotionCaptureError::LeftHanded);
    }
    let unit = units.into_iter().find(|(factor, _)| (scale / factor - 1.0).abs() < OTHER_UNIT);
    Err(match unit {
        Some((_, unit)) => MotionCaptureError::LengthUnit { scale, unit },
        None => MotionCaptureError::Lengths { scale },
    })
}

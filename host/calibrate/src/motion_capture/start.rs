//! A start that cannot fail silently: offset of the clocks, rotations, translations.
//!
//! 1. **Offset**: how fast camera and body turn is the same whatever their axes. Its correlation over all shifts must have one clear
//!    peak.
//! 2. **Rotation** of the body against the camera: the one that carries one angular velocity to the other (Wahba's problem, as
//!    Park and Martin 1994 for hand-eye calibration). The rotation of the board in the room is the mean of those that follow pose
//!    by pose.
//! 3. **Translations and scale**: linear least squares. The scale tells other units, and its sign mirrored axes.
//!
//! Where that fails, poses are read as if they were inverse, or their quaternions in another order: what fits then is told.

use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};

use super::error::MotionCaptureError;
use super::fit::HandEye;
use super::path::Path;
use evcal_geometry::numerics::lag::{NoLag, Rules, lag};
use evcal_geometry::numerics::rigid::best_rotation;
use evcal_geometry::timed_pose::TimedPose;

/// Step of the grid on which turns are compared (s).
const STEP: f64 = 0.01;
/// Half the time over which an angular velocity is taken (s).
const WINDOW: f64 = 0.04;
/// Fewest poses in that time.
const FEWEST_POSES: usize = 4;
/// Smallest correlation that is believed.
const CORRELATION: f64 = 0.9;
/// Share of the best peak that another one must stay below.
const SECOND_PEAK: f64 = 0.9;
/// Nearest another peak may be (s).
const PEAK_DISTANCE: f64 = 0.4;
/// Smallest overlap: as a share of the shorter series, and in seconds.
const OVERLAP: f64 = 0.4;
const FEWEST_SECONDS: f64 = 2.0;
/// Longest capture (s); longer ones have other units.
const LONGEST: f64 = 86_400.0;
/// Root mean square of the angular velocity below which the camera hardly turned (rad/s).
const LEAST_RATE: f64 = 0.08;
/// Second singular value over the first below which the camera turned about one axis.
const ONE_AXIS: f64 = 0.02;
/// Share of the angular velocities' squares that a rotation may leave.
const LEFT: f64 = 0.2;
/// How far lengths may differ, as a share; and from those of another unit.
const SAME_LENGTH: f64 = 0.03;
const OTHER_UNIT: f64 = 0.1;

/// What the start found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// Offset, rotations, translations.
    pub hand_eye: HandEye,
    /// Largest correlation of the turns.
    pub correlation: f64,
}

/// Angular velocities in the axes of what turns, at even times, where they are known.
struct Turns {
    start: f64,
    values: Vec<Option<Vector3<f64>>>,
}

impl Turns {
    fn new(poses: &[TimedPose]) -> Self {
        let (Some(first), Some(last)) = (poses.first(), poses.last()) else {
            return Self { start: 0.0, values: Vec::new() };
        };
        let count = ((last.t - first.t).clamp(0.0, LONGEST) / STEP) as usize + 1;
        let at = |index: usize| angular_velocity(poses, first.t + STEP * index as f64);
        Self { start: first.t, values: (0..count).map(at).collect() }
    }

    fn sizes(&self) -> Vec<Option<f64>> {
        self.values.iter().map(|value| value.map(|w| w.norm())).collect()
    }

    /// Between the grid's times.
    fn at(&self, t: f64) -> Option<Vector3<f64>> {
        let place = (t - self.start) / STEP;
        let below = place.floor();
        if below < 0.0 {
            return None;
        }
        let pair = (self.values.get(below as usize)?, self.values.get(below as usize + 1)?);
        let (Some(before), Some(after)) = pair else { return None };
        Some(before.lerp(after, place - below))
    }
}

/// The slope of the rotation vectors from the middle pose, of the poses within [`WINDOW`] of `t`.
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

/// Finds a start from the poses of the camera and those of the body.
///
/// # Errors
/// [`MotionCaptureError`] says what was not found, and why.
pub fn start(camera: &[TimedPose], capture: &[TimedPose]) -> Result<Start, MotionCaptureError> {
    let of_camera = Turns::new(camera);
    let known: Vec<Vector3<f64>> = of_camera.values.iter().flatten().copied().collect();
    let rate = (known.iter().map(|w| w.norm_squared()).sum::<f64>() / known.len().max(1) as f64).sqrt();
    if rate < LEAST_RATE {
        return Err(MotionCaptureError::LittleRotation { rate: rate.to_degrees() });
    }
    let path = Path::new(camera)?;
    let find = |capture: &[TimedPose]| {
        let of_body = Turns::new(capture);
        let (offset, correlation) = offset(&of_camera, &of_body)?;
        let body_camera = rotation(&of_camera, &of_body, offset)?;
        let hand_eye = translations(&path, capture, (offset, body_camera.inverse()))?;
        Ok(Start { hand_eye, correlation })
    };
    let read_otherwise = |read: fn(&Isometry3<f64>) -> Isometry3<f64>| {
        let poses: Vec<_> = capture.iter().map(|pose| TimedPose { t: pose.t, pose: read(&pose.pose) }).collect();
        find(&poses).is_ok()
    };
    find(capture).map_err(|error| match error {
        // How fast a quaternion turns is the same in any order of its numbers.
        MotionCaptureError::OtherAxes { .. } if read_otherwise(w_first) => MotionCaptureError::QuaternionOrder,
        MotionCaptureError::OtherAxes { .. } if read_otherwise(Isometry3::inverse) => MotionCaptureError::Inverted,
        MotionCaptureError::OtherAxes { .. } if read_otherwise(conjugate) => MotionCaptureError::Conjugate,
        error => error,
    })
}

/// The pose if its quaternion had been written with w first.
fn w_first(pose: &Isometry3<f64>) -> Isometry3<f64> {
    let [x, y, z, w]: [f64; 4] = pose.rotation.coords.into();
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(x, y, z, w));
    Isometry3::from_parts(pose.translation, rotation)
}

/// The pose if its quaternion were that of the opposite rotation.
fn conjugate(pose: &Isometry3<f64>) -> Isometry3<f64> {
    Isometry3::from_parts(pose.translation, pose.rotation.inverse())
}

/// t_mocap − t_events, and the correlation there.
fn offset(camera: &Turns, body: &Turns) -> Result<(f64, f64), MotionCaptureError> {
    let (of_camera, of_body) = (camera.sizes(), body.sizes());
    let known = |sizes: &[Option<f64>]| sizes.iter().flatten().count() as f64;
    let rules = Rules {
        fewest_pairs: (OVERLAP * known(&of_camera).min(known(&of_body))).max(FEWEST_SECONDS / STEP),
        correlation: CORRELATION,
        second_peak: SECOND_PEAK,
        peak_distance: (PEAK_DISTANCE / STEP) as usize,
    };
    let offset_of = |steps: f64| body.start - camera.start + steps * STEP;
    match lag(&of_camera, &of_body, &rules) {
        Ok(found) => Ok((offset_of(found.steps), found.correlation)),
        Err(NoLag::Steady { mean }) => Err(MotionCaptureError::EvenRotation { rate: mean.to_degrees() }),
        Err(NoLag::Unlike { correlation }) => Err(MotionCaptureError::OtherMotion { correlation, wanted: CORRELATION }),
        Err(NoLag::Ambiguous { first, second }) => {
            Err(MotionCaptureError::Ambiguous { first: offset_of(first), second: offset_of(second) })
        }
    }
}

/// `R_body_camera`.
fn rotation(camera: &Turns, body: &Turns, offset: f64) -> Result<UnitQuaternion<f64>, MotionCaptureError> {
    let mut product = Matrix3::zeros();
    let mut squares = 0.0;
    for (index, w) in camera.values.iter().enumerate() {
        let Some(w) = w else { continue };
        let Some(read) = body.at(camera.start + STEP * index as f64 + offset) else { continue };
        product += read * w.transpose();
        squares += w.norm_squared() + read.norm_squared();
    }
    let svd = product.svd(true, true);
    let (Some(left), Some(right)) = (svd.u, svd.v_t) else { return Err(MotionCaptureError::Singular) };
    let sizes = svd.singular_values;
    if sizes[1] < ONE_AXIS * sizes[0] {
        let axis = right.row(0).transpose();
        let axis = ["x axis (to the right)", "y axis (downwards)", "z axis (the line of sight)"][axis.iamax()];
        return Err(MotionCaptureError::OneAxis { axis });
    }
    let determinant = (left * right).determinant().signum();
    let unexplained = 1.0 - 2.0 * (sizes[0] + sizes[1] + determinant * sizes[2]) / squares;
    if unexplained > LEFT {
        return Err(MotionCaptureError::OtherAxes { left: unexplained });
    }
    let matrix = left * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, determinant)) * right;
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix)))
}

/// Unknowns of the linear step: `t_mocap_world`, `t_camera_body` in the capture's lengths, and the scale.
const UNKNOWNS: usize = 7;

fn translations(
    path: &Path,
    capture: &[TimedPose],
    (offset, camera_body): (f64, UnitQuaternion<f64>),
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
    // Turns are mirrored as a whole, so that they look like those about other axes; positions are not.
    if (scale + 1.0).abs() < OTHER_UNIT {
        return Err(MotionCaptureError::LeftHanded);
    }
    let unit = units.into_iter().find(|(factor, _)| (scale / factor - 1.0).abs() < OTHER_UNIT);
    Err(match unit {
        Some((_, unit)) => MotionCaptureError::LengthUnit { scale, unit },
        None => MotionCaptureError::Lengths { scale },
    })
}

//! The first control points of a trajectory: a least-squares fit to the poses of reference frames.
//!
//! The camera centre and, for quaternion splines, the four numbers of the quaternion are fitted by global least squares
//! (*The NURBS Book*, 9.4.1). If the trajectory starts and ends with its poses, its ends are fixed, so that it passes
//! through the first and the last pose. If it reaches beyond them (to the ends of the outer windows), the ends are
//! fitted like the rest, and a slight pull towards constant velocity determines the control points that the poses do
//! not determine. SO(3) splines start from the quaternion fit, then Gauss-Newton steps on the group minimise the
//! squared rotation angles.

mod so3;

use evcal_core::spline::{Knots, quaternion};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use super::{RotationControl, RotationSpline, Trajectory, TrajectoryError, knots};
use evcal_geometry::numerics::banded::BandedCholesky;
use evcal_geometry::timed_pose::TimedPose;

/// The kind of trajectory to fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryShape {
    /// Degree of the spline, 1 to [`evcal_core::spline::MAX_DEGREE`].
    pub degree: usize,
    /// Curve of the rotation.
    pub rotation: RotationSpline,
    /// Requested mean knot spacing in seconds.
    pub knot_spacing: f64,
}

/// Weight of the pull towards constant velocity, relative to a pose. A pose determines its control points with squared basis
/// values of up to 1; the pull matters only where these are far smaller. For a hand-held camera with knots 30 ms apart, its error
/// is below 0.1 mm, and it more than halves the effect of 1 mm of noise 5 ms beyond the last pose.
const SMOOTHNESS: f64 = 1e-2;

/// Fits a trajectory from `start` to `end` (seconds since the start of the recording, like the times of `poses`) to `poses` in
/// the order of time. The number of control points follows from the knot spacing, but is never above the number of poses.
///
/// # Errors
/// Too few poses for the degree; times that do not increase or lie outside `start..=end`; numbers that are not finite.
pub fn fit(
    recording: usize,
    poses: &[TimedPose],
    start: f64,
    end: f64,
    shape: &TrajectoryShape,
) -> Result<Trajectory, TrajectoryError> {
    let count = knots::control_point_count(end - start, shape.knot_spacing, shape.degree, poses.len());
    fit_control_points(recording, poses, start, end, count, shape.degree, shape.rotation)
}

/// Approximates the curve on other clamped knots over the same time, by a fit to samples of it.
///
/// # Errors
/// As for [`fit`].
pub fn on_knots(
    trajectory: &Trajectory,
    knots: Vec<f64>,
    rotation: RotationSpline,
) -> Result<Trajectory, TrajectoryError> {
    /// Samples per span: enough to determine it, and to follow the old curve.
    const SAMPLES: usize = 4;
    let spans = knots.windows(2).filter(|pair| pair[1] > pair[0]);
    let within = spans
        .flat_map(|pair| (0..SAMPLES).map(move |index| pair[0] + (pair[1] - pair[0]) * index as f64 / SAMPLES as f64));
    let poses: Vec<TimedPose> = within
        .chain(std::iter::once(trajectory.end()))
        .filter_map(|t| trajectory.pose(t).map(|pose| TimedPose { t, pose }))
        .collect();
    fit_on_knots(trajectory.recording, &poses, knots, trajectory.degree, rotation)
}

/// Does the same as [`fit`], with the number of control points given.
///
/// # Errors
/// As for [`fit`]; and a `count` outside `degree + 1 ..= poses.len()`.
pub fn fit_control_points(
    recording: usize,
    poses: &[TimedPose],
    start: f64,
    end: f64,
    count: usize,
    degree: usize,
    rotation: RotationSpline,
) -> Result<Trajectory, TrajectoryError> {
    let finite = |pose: &Isometry3<f64>| pose.to_matrix().iter().all(|entry| entry.is_finite());
    if let Some(index) = poses.iter().position(|timed| !finite(&timed.pose)) {
        return Err(TrajectoryError::NotFinite { index });
    }
    let times: Vec<f64> = poses.iter().map(|timed| timed.t).collect();
    let knots = knots::from_times(&times, start, end, count, degree)?;
    fit_on_knots(recording, poses, knots, degree, rotation)
}

/// Does the same as [`fit`], on given clamped knots.
///
/// # Errors
/// As for [`fit`]; and knots that the poses do not determine.
pub fn fit_on_knots(
    recording: usize,
    poses: &[TimedPose],
    knots: Vec<f64>,
    degree: usize,
    rotation: RotationSpline,
) -> Result<Trajectory, TrajectoryError> {
    let times: Vec<f64> = poses.iter().map(|timed| timed.t).collect();
    let design = Design::new(&knots, degree, times)?;

    let centers: Vec<[f64; 3]> = poses.iter().map(|timed| timed.pose.translation.vector.into()).collect();
    let translation = design.fit(&centers)?.into_iter().map(Vector3::from).collect();

    let mut quaternions: Vec<Quaternion<f64>> = poses.iter().map(|timed| timed.pose.rotation.into_inner()).collect();
    quaternion::align_signs(&mut quaternions);
    let coordinates: Vec<[f64; 4]> = quaternions.iter().map(|quaternion| quaternion.coords.into()).collect();
    let control: Vec<Quaternion<f64>> =
        design.fit(&coordinates)?.into_iter().map(|point| Quaternion::from_vector(point.into())).collect();
    let rotation = match rotation {
        RotationSpline::Quaternion => RotationControl::Quaternion(control),
        RotationSpline::So3 => {
            let rotations: Vec<_> = poses.iter().map(|timed| timed.pose.rotation).collect();
            let control = control.into_iter().map(UnitQuaternion::new_normalize).collect();
            RotationControl::So3(design.fit_so3(&rotations, control)?)
        }
    };
    Ok(Trajectory { recording, knots, degree, translation, rotation })
}

/// A pull that makes the velocities between three neighbouring control points equal.
struct EvenPull {
    /// Index of the first of the three.
    first: usize,
    /// Factors of both steps, whose difference should vanish.
    before: f64,
    after: f64,
}

/// Times, knots, and flags of fixed control points.
struct Design<'a> {
    knots: Knots<'a, f64>,
    times: Vec<f64>,
    /// `true` if the first control point is the first sample.
    first_fixed: bool,
    /// `true` if the last control point is the last sample.
    last_fixed: bool,
}

impl<'a> Design<'a> {
    fn new(knots: &'a [f64], degree: usize, times: Vec<f64>) -> Result<Self, TrajectoryError> {
        let knots = Knots::new(knots, degree)?;
        let first_fixed = times.first() == Some(&knots.start());
        let last_fixed = times.last() == Some(&knots.end());
        Ok(Self { knots, times, first_fixed, last_fixed })
    }

    fn is_fixed(&self, control_point: usize) -> bool {
        (control_point == 0 && self.first_fixed)
            || (control_point + 1 == self.knots.control_point_count() && self.last_fixed)
    }

    /// Returns the number of diagonals below the main one, in control points: a sample couples `degree + 1` neighbours, the pull
    /// towards constant velocity three.
    fn bandwidth(&self) -> usize {
        self.knots.degree().max(2)
    }

    /// Returns the pulls towards constant velocity, one for every three neighbouring control points. Empty if both ends are
    /// fixed, because the samples suffice.
    ///
    /// A curve has constant velocity if its control points have it at the Greville abscissae.
    fn smoothness(&self) -> Vec<EvenPull> {
        if self.first_fixed && self.last_fixed {
            return Vec::new();
        }
        let greville = knots::greville(self.knots.as_slice(), self.knots.degree());
        let factors = greville.windows(3).enumerate().map(|(first, three)| {
            let (before, after) = (three[1] - three[0], three[2] - three[1]);
            let scale = 0.5 * (before + after) * SMOOTHNESS.sqrt();
            EvenPull { first, before: scale / before, after: scale / after }
        });
        factors.collect()
    }

    /// Returns the control points of the least-squares curve through `samples`.
    fn fit<const D: usize>(&self, samples: &[[f64; D]]) -> Result<Vec<[f64; D]>, TrajectoryError> {
        let count = self.knots.control_point_count();
        let mut control = vec![[0.0; D]; count];
        if let (true, Some(first), Some(sample)) = (self.first_fixed, control.first_mut(), samples.first()) {
            *first = *sample;
        }
        if let (true, Some(last), Some(sample)) = (self.last_fixed, control.last_mut(), samples.last()) {
            *last = *sample;
        }
        let mut matrix = BandedCholesky::zeros(count, self.bandwidth());
        let mut right = vec![0.0; count * D];
        let mut add = |first: usize, weights: &[f64], mut target: [f64; D]| {
            // The contribution of fixed control points is known.
            let fixed = |index: usize| self.is_fixed(first + index);
            for (index, weight) in weights.iter().enumerate().filter(|(index, _)| fixed(*index)) {
                target.iter_mut().zip(&control[first + index]).for_each(|(target, value)| *target -= weight * value);
            }
            for (row, row_weight) in weights.iter().enumerate().filter(|(row, _)| !fixed(*row)) {
                for (column, weight) in weights.iter().enumerate().take(row + 1).filter(|(column, _)| !fixed(*column)) {
                    matrix.add(first + row, first + column, row_weight * weight);
                }
                for (axis, target) in target.iter().enumerate() {
                    right[axis * count + first + row] += row_weight * target;
                }
            }
        };
        for (&t, sample) in self.times.iter().zip(samples) {
            let basis = self.knots.basis(t)?;
            add(basis.first, &basis.value[..basis.order], *sample);
        }
        for EvenPull { first, before, after } in self.smoothness() {
            add(first, &[before, -before - after, after], [0.0; D]);
        }
        for index in (0..count).filter(|&index| self.is_fixed(index)) {
            matrix.add(index, index, 1.0);
            for (axis, value) in control[index].iter().enumerate() {
                right[axis * count + index] = *value;
            }
        }
        matrix.factor().map_err(|control_point| TrajectoryError::Undetermined { control_point })?;
        matrix.solve_in_place(&mut right);
        for (index, point) in control.iter_mut().enumerate() {
            *point = std::array::from_fn(|axis| right[axis * count + index]);
        }
        Ok(control)
    }
}

#[cfg(test)]
mod tests {
    use evcal_core::spline::rotation::exp;
    use evcal_core::spline::{MAX_DEGREE, SplineError};
    use nalgebra::Translation3;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const BOTH: [RotationSpline; 2] = [RotationSpline::Quaternion, RotationSpline::So3];

    /// Times of frames about 10 ms apart, from `start`.
    fn frame_times(count: usize, start: f64, random: &mut ChaCha8Rng) -> Vec<f64> {
        let mut t = start;
        let mut next = || {
            let now = t;
            t += random.random_range(0.005..0.015);
            now
        };
        (0..count).map(|_| next()).collect()
    }

    fn sampled(times: &[f64], pose: impl Fn(f64) -> Isometry3<f64>) -> Vec<TimedPose> {
        times.iter().map(|&t| TimedPose { t, pose: pose(t) }).collect()
    }

    fn random_vector(random: &mut ChaCha8Rng, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| random.random_range(-size..size))
    }

    /// A hand-held camera: 0.2 m at 1 Hz, 0.4 rad at 0.7 Hz.
    fn hand_held(t: f64) -> Isometry3<f64> {
        let (a, b) = (std::f64::consts::TAU * t, 1.4 * std::f64::consts::PI * t);
        let translation = Vector3::new(0.2 * a.sin(), 0.1 * (a + 1.0).cos(), -0.5 + 0.05 * (2.0 * a).sin());
        let turn = exp(&Vector3::new(0.4 * b.sin(), 0.3 * b.cos(), 0.2 * (b + 2.0).sin()));
        Isometry3::from_parts(translation.into(), turn)
    }

    /// Largest distance (m) and angle (rad) between a trajectory and a motion over its whole length.
    fn largest_error(trajectory: &Trajectory, motion: impl Fn(f64) -> Isometry3<f64>) -> (f64, f64) {
        let (start, end) = (trajectory.start(), trajectory.end());
        (0..=1000).fold((0.0, 0.0), |(distance, angle): (f64, f64), index| {
            let t = (start + (end - start) * f64::from(index) / 1000.0).min(end);
            let (pose, truth) = (trajectory.pose(t).unwrap(), motion(t));
            let error = truth.inverse() * pose;
            let at = (pose.translation.vector - truth.translation.vector).norm();
            (distance.max(at), angle.max(error.rotation.angle()))
        })
    }

    #[test]
    fn a_known_spline_is_recovered_from_its_samples() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        for degree in 1..=MAX_DEGREE {
            let times = frame_times(80, 2.0, &mut random);
            let (start, end) = (times[0], times[79]);
            let knots = knots::from_times(&times, start, end, 30, degree).unwrap();
            let mut rotation = exp(&Vector3::new(2.0, -1.0, 0.5));
            let mut walk = || {
                rotation *= exp(&random_vector(&mut random, 0.1));
                rotation
            };
            let control: Vec<_> = (0..30).map(|_| walk()).collect();
            let translation: Vec<_> = (0..30).map(|_| random_vector(&mut random, 0.1)).collect();
            let truth =
                Trajectory { recording: 4, knots, degree, translation, rotation: RotationControl::So3(control) };
            let poses = sampled(&times, |t| truth.pose(t).unwrap());
            let found = fit_control_points(4, &poses, start, end, 30, degree, RotationSpline::So3).unwrap();
            assert_eq!((found.recording, &found.knots, found.degree), (4, &truth.knots, degree));
            let (distance, angle) = largest_error(&found, |t| truth.pose(t).unwrap());
            assert!(distance < 1e-9 && angle < 1e-9, "degree {degree}: {distance} m, {angle} rad");
        }
    }

    #[test]
    fn motion_at_constant_velocity_is_reproduced() {
        let mut random = ChaCha8Rng::seed_from_u64(2);
        let (velocity, rate) = (Vector3::new(0.3, -0.2, 0.1), Vector3::new(1.0, 2.0, -0.5));
        let first = hand_held(0.3);
        let motion = |t: f64| {
            Isometry3::from_parts(
                Translation3::from(first.translation.vector + velocity * t),
                first.rotation * exp(&(rate * t)),
            )
        };
        for degree in 1..=MAX_DEGREE {
            for (before, after) in [(0.0, 0.0), (0.004, 0.0), (0.0, 0.004), (0.004, 0.006)] {
                let times = frame_times(50, 0.0, &mut random);
                let poses = sampled(&times, motion);
                let (start, end) = (times[0] - before, times[49] + after);
                let found = fit_control_points(0, &poses, start, end, 20, degree, RotationSpline::So3).unwrap();
                let (distance, angle) = largest_error(&found, motion);
                assert!(distance < 1e-11 && angle < 1e-11, "degree {degree}: {distance} m, {angle} rad");
                let middle = found.sample(0.2).unwrap();
                assert!((middle.linear_velocity - velocity).norm() < 1e-9);
                assert!((middle.rotation.angular_velocity - rate).norm() < 1e-9);
                // A sum of quaternions approximates a rotation only to the order of the spline.
                let found = fit_control_points(0, &poses, start, end, 20, degree, RotationSpline::Quaternion).unwrap();
                let (distance, angle) = largest_error(&found, motion);
                assert!(distance < 1e-11, "degree {degree}: {distance} m");
                let longest_span =
                    found.knots.windows(2).fold(0.0, |longest: f64, span| longest.max(span[1] - span[0]));
                let fixed = before + after == 0.0;
                let bound = (rate.norm() * longest_span).powi(degree as i32 + 1);
                assert!(!fixed || angle < bound, "degree {degree}: {angle} rad");
            }
        }
    }

    /// Order `degree + 1` for the camera centre and for quaternions. Rotations of an SO(3) spline do not commute, so
    /// its error contains the square of a step times the change of the step: order 3 at most.
    #[test]
    fn errors_fall_with_the_order_of_the_spline() {
        let times: Vec<f64> = (0..=400).map(|index| f64::from(index) * 0.0025).collect();
        let poses = sampled(&times, hand_held);
        for rotation in BOTH {
            for degree in 2..=4 {
                let error = |spans| {
                    let found = fit_control_points(0, &poses, 0.0, 1.0, spans + degree, degree, rotation).unwrap();
                    largest_error(&found, hand_held)
                };
                let (coarse, fine) = (error(20), error(40));
                let orders = [(coarse.0 / fine.0).log2(), (coarse.1 / fine.1).log2()];
                let turn_order = if rotation == RotationSpline::So3 { 3 } else { degree + 1 };
                assert!((orders[0] - (degree + 1) as f64).abs() < 0.3, "{rotation}, degree {degree}: {orders:?}");
                assert!((orders[1] - turn_order as f64).abs() < 0.3, "{rotation}, degree {degree}: {orders:?}");
            }
        }
    }

    #[test]
    fn fixed_ends_are_reproduced_exactly() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let times = frame_times(40, 1.0, &mut random);
        let poses = sampled(&times, hand_held);
        for rotation in BOTH {
            let found = fit_control_points(0, &poses, times[0], times[39], 9, 3, rotation).unwrap();
            for timed in [poses[0], poses[39]] {
                let pose = found.pose(timed.t).unwrap();
                assert!((pose.translation.vector - timed.pose.translation.vector).norm() < 1e-14);
                assert!(pose.rotation.angle_to(&timed.pose.rotation) < 1e-14);
            }
        }
    }

    /// A board seen rotated by about 180° in the image: quaternions with positive real part jump from one end of the sphere to
    /// the other, and a sum of neighbours would vanish.
    #[test]
    fn sign_changes_of_quaternions_do_not_break_the_trajectory() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let motion = |t: f64| {
            let turn =
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI + (4.0 * t - 1.0).sin());
            Isometry3::from_parts(Vector3::new(0.0, 0.0, -0.5).into(), turn)
        };
        let times = frame_times(60, 0.0, &mut random);
        let mut poses = sampled(&times, motion);
        let mut signs = Vec::new();
        for timed in &mut poses {
            let quaternion = timed.pose.rotation.into_inner();
            let positive = if quaternion.w < 0.0 { -quaternion } else { quaternion };
            signs.push(positive.k > 0.0);
            timed.pose.rotation = UnitQuaternion::new_unchecked(positive);
        }
        assert!(signs.contains(&true) && signs.contains(&false));
        for rotation in BOTH {
            let found = fit_control_points(0, &poses, times[0], times[59], 30, 3, rotation).unwrap();
            let (_, angle) = largest_error(&found, motion);
            assert!(angle < 1e-4, "{rotation}: {angle} rad");
        }
    }

    #[test]
    fn extended_ends_follow_the_motion_without_amplifying_noise() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let times = frame_times(100, 0.0, &mut random);
        let (start, end) = (times[0] - 0.005, times[99] + 0.005);
        let shape = |rotation| TrajectoryShape { degree: 3, rotation, knot_spacing: 0.03 };
        let exact = sampled(&times, hand_held);
        let mut noisy = exact.clone();
        for timed in &mut noisy {
            timed.pose.translation.vector += random_vector(&mut random, 1e-3);
            timed.pose.rotation *= exp(&random_vector(&mut random, 2e-3));
        }
        for rotation in BOTH {
            let found = fit(0, &exact, start, end, &shape(rotation)).unwrap();
            assert_eq!((found.start(), found.end()), (start, end));
            let (distance, angle) = largest_error(&found, hand_held);
            assert!(distance < 1e-4 && angle < 1e-4, "{rotation}: {distance} m, {angle} rad");
            let found = fit(0, &noisy, start, end, &shape(rotation)).unwrap();
            let (distance, angle) = largest_error(&found, hand_held);
            // Half the diagonal of the cube of noise, and as much again beyond the samples.
            assert!(distance < 3.5e-3 && angle < 7e-3, "{rotation}: {distance} m, {angle} rad");
        }
    }

    #[test]
    fn as_few_poses_as_control_points_are_interpolated() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        for rotation in BOTH {
            for count in [4, 5, 11] {
                let times = frame_times(count, 0.0, &mut random);
                let poses = sampled(&times, hand_held);
                let found = fit_control_points(0, &poses, times[0], times[count - 1], count, 3, rotation).unwrap();
                for timed in &poses {
                    let pose = found.pose(timed.t).unwrap();
                    assert!((pose.translation.vector - timed.pose.translation.vector).norm() < 1e-9);
                    assert!(pose.rotation.angle_to(&timed.pose.rotation) < 1e-9);
                }
            }
        }
    }

    #[test]
    fn invalid_poses_are_refused() {
        let poses = sampled(&[0.0, 0.01, 0.02, 0.03], hand_held);
        let shape = TrajectoryShape { degree: 3, rotation: RotationSpline::So3, knot_spacing: 0.02 };
        assert_eq!(fit(0, &poses[..3], 0.0, 0.02, &shape), Err(TrajectoryError::TooFewPoses { degree: 3, found: 3 }));
        assert_eq!(fit(0, &[], 0.0, 1.0, &shape), Err(TrajectoryError::TooFewPoses { degree: 3, found: 0 }));
        let mut broken = poses.clone();
        broken[2].pose.translation.x = f64::NAN;
        assert_eq!(fit(0, &broken, 0.0, 0.03, &shape), Err(TrajectoryError::NotFinite { index: 2 }));
        let sixth = TrajectoryShape { degree: 6, ..shape };
        let many = sampled(&[0.0, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06], hand_held);
        assert_eq!(fit(0, &many, 0.0, 0.06, &sixth), Err(TrajectoryError::Spline(SplineError::Degree)));
    }
}

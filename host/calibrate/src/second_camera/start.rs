//! Start of the calibration of a second camera: offset of the clocks, orientation of the board, and transform, each with a test
//! of its validity.
//!
//! 1. **Offset**: the rotation rates of both cameras are the same whatever their axes. Their correlation over all shifts must
//!    have one clear peak.
//! 2. **Orientation**: with a symmetric board, the cameras may have chosen different orientations. With the right rotation of the
//!    board, the transform between the cameras is constant; with another it is not.
//! 3. **Transform, offset and rate of the clocks** by least squares over pairs of poses, with Huber's loss.
//!
//! If this fails, and the board is its own mirror image, the same is tried as if the second camera's image were mirrored.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion};

use super::error::SecondCameraError;
use super::mount::{COUNT, Mount, OFFSET, RATE, RATE_SIGMA, ROTATION, TRANSLATION};
use super::seen::{Seen, SeenPose, inner_sample, pose_of, rates};
use evcal_geometry::board::symmetry::{Symmetries, Symmetry};
use evcal_geometry::numerics::rigid::best_rotation;
use evcal_geometry::numerics::statistics::{median, quantile};
use evcal_geometry::timed_pose::TimedPose;
use evcal_solve::trajectory::Trajectory;
use evcal_solve::trajectory::alignment::{AlignmentError, Offset, Overlap, ambiguous, offsets};

/// Fewest seconds with the board in view of both cameras.
pub const FEWEST_SECONDS: f64 = 2.0;
/// Smallest overlap: as a share of the shorter recording, and in seconds.
const OVERLAP: Overlap = Overlap { share: 0.25, seconds: FEWEST_SECONDS };
/// Largest number of offsets of the clocks that are tried.
const MOST_OFFSETS: usize = 8;
/// Smallest ratio of the scatter with another orientation, or another offset, to the scatter with the best one.
const CLEARLY: f64 = 3.0;
/// Length (m) that has the same weight as one radian.
const LENGTH: f64 = 0.7;
/// Typical errors of poses with the same weight: rotation (rad) and position (m).
const SPREAD: [f64; 2] = [2e-3, 1e-3];
/// Residual from which a pair counts linearly, in units of these.
const HUBER: f64 = 3.0;
/// Number of rounds of least squares.
const ROUNDS: usize = 12;
/// Change of position (m) and rotation (rad) between the cameras above which the mount is loose, if each pose is accurate.
pub const LOOSE: [f64; 2] = [0.015, 0.015];

/// Largest typical distance of poses from those that the mount predicts, if each may have a time of its own, relative to that with the
/// given times, with which the times scatter.
const EXPLAINED: f64 = 0.5;
/// Smallest scatter of times that is reported (s).
const LEAST_SCATTER: f64 = 1e-3;

/// For a segment of the first and one of the second recording, the index of a rotation of the board.
pub type Turns = BTreeMap<(usize, usize), usize>;

/// Result of the start.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// Transform, offset, rate.
    pub mount: Mount,
    /// Largest correlation of the rotation rates.
    pub correlation: f64,
    /// For overlapping segments of the first and the second recording, the rotation of the board between them.
    pub turns: Turns,
    /// Seconds with the board in view of both cameras.
    pub seconds: f64,
    /// Spread (σ) of the errors of the times of the second camera's poses (s); `None` if times do not explain the distances of poses from those
    /// that the mount predicts.
    pub time_scatter: Option<f64>,
}

/// Poses of both cameras at one time.
struct Pair {
    /// Time of the second clock (s).
    t: f64,
    /// Segments of the first and the second recording.
    segments: (usize, usize),
    /// `T_world_camera`.
    poses: (Isometry3<f64>, Isometry3<f64>),
}

/// Computes a start from the trajectories of the first camera and the motion of the second, each since the start of its
/// recording, with a board of these `symmetries`. `loose` is the largest typical change of position (m) and rotation (rad)
/// between the cameras.
///
/// # Errors
/// [`SecondCameraError`] names the quantity that was not found, and the reason.
pub fn start(
    first: &[Trajectory],
    second: &Seen,
    symmetries: &Symmetries,
    loose: [f64; 2],
) -> Result<Start, SecondCameraError> {
    unmirrored(first, second, &symmetries.rotations, loose).map_err(|error| {
        let mirrored = symmetries.reflection.map(|reflection| second.seen_in_a_mirror(&reflection));
        let matches = |seen| unmirrored(first, &seen, &symmetries.rotations, loose).is_ok();
        if mirrored.is_some_and(matches) { SecondCameraError::Mirrored } else { error }
    })
}

fn unmirrored(
    first: &[Trajectory],
    second: &Seen,
    symmetries: &[Symmetry],
    loose: [f64; 2],
) -> Result<Start, SecondCameraError> {
    let of_first = rates(first);
    of_first.check()?;
    let offsets = offsets(&of_first, &second.rates, OVERLAP, MOST_OFFSETS).map_err(|error| match error {
        // No offset gives both enough time, so there is nothing to compare.
        AlignmentError::OtherMotion { correlation: ..=0.0 } => SecondCameraError::HardlyTogether {
            seconds: [&of_first, &second.rates].map(|rates| rates.known().count() as f64 * rates.step),
            needed: FEWEST_SECONDS,
        },
        error => error.into(),
    })?;
    let step = of_first.step;
    // If the rotation rates agree at several offsets, the transform between the cameras is constant only at the right
    // one.
    let at = |offset: &Offset| start_at(first, second, *offset, symmetries, loose).map(|found| (*offset, found));
    let mut found: Vec<(Offset, Found)> = offsets.iter().filter_map(|offset| at(offset).ok()).collect();
    found.sort_by(|a, b| a.1.scatter.total_cmp(&b.1.scatter));
    match found.as_slice() {
        [] => {
            let first_offset = offsets.first().ok_or(AlignmentError::OtherMotion { correlation: 0.0 })?;
            at(first_offset).map(|(_, found)| found.start)
        }
        [(one, best), (other, next), ..] if next.scatter < CLEARLY * best.scatter.max(1.0) => {
            Err(ambiguous(*one, *other, step).into())
        }
        [(_, best), ..] => Ok(best.start.clone()),
    }
}

/// A start at one offset of the clocks.
struct Found {
    start: Start,
    /// Typical distance of poses from those that the mount predicts, in [`SPREAD`].
    scatter: f64,
}

fn start_at(
    first: &[Trajectory],
    second: &Seen,
    Offset { seconds: offset, correlation }: Offset,
    symmetries: &[Symmetry],
    loose: [f64; 2],
) -> Result<Found, SecondCameraError> {
    let pairs = pairs(first, &second.poses, offset);
    let seconds = pairs.len() as f64 * second.every;
    let (Some(begin), Some(end)) = (pairs.first(), pairs.last()) else {
        return Err(SecondCameraError::TooShort { seconds, needed: FEWEST_SECONDS });
    };
    if seconds < FEWEST_SECONDS {
        return Err(SecondCameraError::TooShort { seconds, needed: FEWEST_SECONDS });
    }
    let middle = 0.5 * (begin.t + end.t);
    let (first_second, turns) = board_orientation(&pairs, symmetries)?;
    let mount = Mount { second_first: first_second.inverse(), offset, rate: 0.0, middle, line_delay: None };
    let seen = pairs.iter().filter_map(|pair| {
        let turn = symmetries.get(*turns.get(&pair.segments)?)?;
        Some(TimedPose { t: pair.t, pose: turn.pose * pair.poses.1 })
    });
    let seen: Vec<TimedPose> = seen.collect();
    let mount = fitted(first, &seen, mount)?;
    let Distances { scatter, time_scatter } = fixed(first, &seen, &mount, loose)?;
    Ok(Found { start: Start { mount, correlation, turns, seconds, time_scatter }, scatter })
}

fn pairs(first: &[Trajectory], second: &[SeenPose], offset: f64) -> Vec<Pair> {
    let pair = |seen: &SeenPose| {
        let (of_first, first) = inner_sample(first, seen.t - offset)?;
        Some(Pair { t: seen.t, segments: (of_first, seen.segment), poses: (pose_of(&first), seen.pose) })
    };
    second.iter().filter_map(pair).collect()
}

/// Returns `T_first_second` of the pairs, with a rotation of the board between them.
fn transforms<'a>(pairs: &'a [&Pair], turn: &'a Symmetry) -> impl Iterator<Item = Isometry3<f64>> + 'a {
    pairs.iter().map(|pair| pair.poses.0.inverse() * turn.pose * pair.poses.1)
}

/// Returns a robust mean of transforms, and their typical distance from it (m, and radians times [`LENGTH`]).
fn middle_of(transforms: &[Isometry3<f64>]) -> (Isometry3<f64>, f64) {
    let along = |axis: usize| {
        let mut values: Vec<f64> = transforms.iter().map(|one| one.translation.vector[axis]).collect();
        median(&mut values, f64::total_cmp).unwrap_or(0.0)
    };
    let translation = Translation3::new(along(0), along(1), along(2));
    let columns = transforms.iter().flat_map(|one| {
        let matrix = one.rotation.to_rotation_matrix().into_inner();
        (0..3).map(move |axis| (matrix.column(axis).into_owned(), Matrix3::identity().column(axis).into_owned()))
    });
    let middle = Isometry3::from_parts(translation, UnitQuaternion::from_rotation_matrix(&best_rotation(columns)));
    let mut distances: Vec<f64> = transforms.iter().map(|one| distance(&middle, one)).collect();
    (middle, median(&mut distances, f64::total_cmp).unwrap_or(f64::INFINITY))
}

fn distance(one: &Isometry3<f64>, other: &Isometry3<f64>) -> f64 {
    let moved = one.inverse() * other;
    moved.translation.vector.norm() + LENGTH * moved.rotation.angle()
}

/// Returns `T_first_second`, and for overlapping segments the rotation of the board between them.
fn board_orientation(pairs: &[Pair], symmetries: &[Symmetry]) -> Result<(Isometry3<f64>, Turns), SecondCameraError> {
    let mut groups: BTreeMap<(usize, usize), Vec<&Pair>> = BTreeMap::new();
    pairs.iter().for_each(|pair| groups.entry(pair.segments).or_default().push(pair));
    let longest = groups.values().max_by_key(|group| group.len()).ok_or(SecondCameraError::Singular)?;
    let mut orientations: Vec<(Isometry3<f64>, f64)> =
        symmetries.iter().map(|turn| middle_of(&transforms(longest, turn).collect::<Vec<_>>())).collect();
    orientations.sort_by(|a, b| a.1.total_cmp(&b.1));
    let (first_second, scatter) = *orientations.first().ok_or(SecondCameraError::Singular)?;
    if orientations.get(1).is_some_and(|other| other.1 < CLEARLY * scatter) {
        return Err(SecondCameraError::SymmetricBoard);
    }
    let nearest = |group: &Vec<&Pair>| {
        let off = |turn: &Symmetry| {
            let mut off: Vec<f64> = transforms(group, turn).map(|one| distance(&first_second, &one)).collect();
            median(&mut off, f64::total_cmp).unwrap_or(f64::INFINITY)
        };
        let orientations = symmetries.iter().map(off).enumerate();
        orientations.min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(index, _)| index)
    };
    Ok((first_second, groups.iter().map(|(segments, group)| (*segments, nearest(group))).collect()))
}

/// Returns the distance of a pose of the second camera from the one that the mount predicts: rotation (rad, axes of the second
/// camera) and position (m, axes of the first), with the derivatives by the parameters.
fn residual(
    first: &[Trajectory],
    seen: &TimedPose,
    mount: &Mount,
) -> Option<(SVector<f64, 6>, SMatrix<f64, 6, COUNT>)> {
    let TimedPose { t, pose: second } = seen;
    let (_, sample) = inner_sample(first, mount.first_time(*t))?;
    let first_second = mount.second_first.inverse();
    let to_first = sample.rotation.rotation.inverse();
    let place = to_first * (second.translation.vector - sample.translation);
    let rotation = (mount.second_first.rotation * (to_first * second.rotation)).scaled_axis();
    let off = place - first_second.translation.vector;
    let mut by = SMatrix::<f64, 6, COUNT>::zeros();
    // The derivative of T_first_second by the rotation equals the derivative by the first camera's rotation with the opposite
    // sign.
    let second_first = mount.second_first.rotation.to_rotation_matrix().into_inner();
    by.fixed_view_mut::<3, 3>(0, ROTATION).copy_from(&second_first);
    by.fixed_view_mut::<3, 3>(3, ROTATION).copy_from(&-first_second.translation.vector.cross_matrix());
    by.fixed_view_mut::<3, 3>(3, TRANSLATION).copy_from(&second_first.transpose());
    let turning = sample.rotation.angular_velocity;
    let later_rotation = -(second_first * turning);
    let later_place = -(turning.cross(&place) + to_first * sample.linear_velocity);
    for (column, factor) in [(OFFSET, -1.0), (RATE, mount.middle - t)] {
        by.fixed_view_mut::<3, 1>(0, column).copy_from(&(later_rotation * factor));
        by.fixed_view_mut::<3, 1>(3, column).copy_from(&(later_place * factor));
    }
    Some((SVector::from_fn(|row, _| if row < 3 { rotation[row] } else { off[row - 3] }), by))
}

fn fitted(first: &[Trajectory], seen: &[TimedPose], mut mount: Mount) -> Result<Mount, SecondCameraError> {
    for _ in 0..ROUNDS {
        let mut normal = SMatrix::<f64, COUNT, COUNT>::zeros();
        let mut gradient = SVector::<f64, COUNT>::zeros();
        normal[(RATE, RATE)] = RATE_SIGMA.powi(-2);
        gradient[RATE] = mount.rate * normal[(RATE, RATE)];
        for pose in seen {
            let Some((residual, by)) = residual(first, pose, &mount) else { continue };
            for (part, spread) in SPREAD.into_iter().enumerate() {
                let (rows, by) = (residual.fixed_rows::<3>(3 * part), by.fixed_rows::<3>(3 * part));
                let size = rows.norm() / spread;
                let weight = if size > HUBER { HUBER / size } else { 1.0 } / (spread * spread);
                normal += by.tr_mul(&by) * weight;
                gradient += by.tr_mul(&rows) * weight;
            }
        }
        let step = -normal.cholesky().ok_or(SecondCameraError::Singular)?.solve(&gradient);
        mount = mount.moved(step.as_slice());
    }
    Ok(mount)
}

/// Distances of poses from those that the mount predicts.
struct Distances {
    /// The typical distance, in [`SPREAD`].
    scatter: f64,
    /// See [`Start`].
    time_scatter: Option<f64>,
}

/// Returns the distances of poses from those that the mount predicts, or an error if the transform changes by more than `loose`.
fn fixed(
    first: &[Trajectory],
    seen: &[TimedPose],
    mount: &Mount,
    loose: [f64; 2],
) -> Result<Distances, SecondCameraError> {
    let residuals: Vec<_> = seen.iter().filter_map(|pose| residual(first, pose, mount)).collect();
    let usual = |part: usize| {
        let mut sizes: Vec<f64> = residuals.iter().map(|(row, _)| row.fixed_rows::<3>(3 * part).norm()).collect();
        median(&mut sizes, f64::total_cmp).unwrap_or(f64::INFINITY)
    };
    let (rotation, distance) = (usual(0), usual(1));
    let time_scatter = time_scatter(&residuals);
    if distance > loose[0] || rotation > loose[1] {
        return Err(match time_scatter {
            Some(seconds) => SecondCameraError::ScatteredTimes { seconds },
            None => SecondCameraError::NotFixed { distance, degrees: rotation.to_degrees() },
        });
    }
    Ok(Distances { scatter: (rotation / SPREAD[0]).hypot(distance / SPREAD[1]), time_scatter })
}

/// Returns the spread (σ) of the errors of times with which poses would be those that the mount predicts, if they then are.
fn time_scatter(residuals: &[(SVector<f64, 6>, SMatrix<f64, 6, COUNT>)]) -> Option<f64> {
    let weights = SVector::<f64, 6>::from_fn(|row, _| 1.0 / SPREAD[row / 3]);
    let (mut given, mut explained, mut times) = (Vec::new(), Vec::new(), Vec::new());
    for (residual, by) in residuals {
        let (residual, later) = (residual.component_mul(&weights), by.column(OFFSET).component_mul(&weights));
        let time = later.dot(&residual) / later.norm_squared();
        given.push(residual.norm());
        explained.push((residual - later * time).norm());
        times.push(time);
    }
    let [given, explained] = [given, explained].map(|mut values| median(&mut values, f64::total_cmp));
    times.sort_by(f64::total_cmp);
    // σ, if the errors have a normal distribution.
    let time = 0.5 * (quantile(&times, 0.84)? - quantile(&times, 0.16)?);
    (time > LEAST_SCATTER && explained? < EXPLAINED * given?).then_some(time)
}

#[cfg(test)]
pub(super) mod tests;

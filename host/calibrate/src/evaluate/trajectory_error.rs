//! Absolute trajectory error, as the TUM RGB-D tools define it (Sturm et al., IROS 2012): distances
//! between true and estimated camera positions at the same time, after the rigid motion, without
//! scale, that brings both trajectories closest (Horn 1987).
//!
//! If both trajectories are in the board's frame, no alignment is needed, so the error without alignment is reported too: it
//! includes a wrong scale or origin that alignment would hide. Clocks may differ by a constant, which [`best_time_shift`]
//! estimates.

use std::fmt;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use serde::Serialize;

use evcal_geometry::numerics::rigid::best_rotation;
use evcal_geometry::numerics::statistics::Statistics;
use evcal_geometry::timed_pose::TimedPose;

/// Method that assigns a true pose to an estimated one.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum Association {
    /// The truth interpolated at the time of the estimate: straight lines and great arcs.
    Interpolated,
    /// The true pose nearest in time, at most `max_difference` seconds away.
    Nearest {
        /// Largest difference of time in seconds (0.02 in the TUM tools).
        max_difference: f64,
    },
}

/// Error of an estimated trajectory.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AbsoluteTrajectoryError {
    /// Seconds added to the times of the estimate.
    pub time_shift: f64,
    /// Number of estimated poses without a true pose.
    pub unmatched: usize,
    /// Distances in metres, without alignment.
    pub direct: Statistics,
    /// Angles in radians between true and estimated orientation, without alignment.
    pub direct_rotation: Statistics,
    /// Distances in metres, after the alignment.
    pub aligned: Statistics,
    /// Rotation of the alignment, which maps estimated positions to true ones, as a rotation vector in radians.
    pub alignment_rotation: [f64; 3],
    /// Translation of the alignment in metres, after the rotation.
    pub alignment_translation: [f64; 3],
    /// Root mean square distance of the true positions from their mean, in metres.
    pub extent: f64,
}

/// Largest ratio of the error after alignment to the extent for two trajectories of one recording.
const RELATED: f64 = 0.3;

impl AbsoluteTrajectoryError {
    /// Returns `true` if the estimate follows the truth, `false` if it is of another recording.
    pub fn is_related(&self) -> bool {
        self.aligned.rmse <= RELATED * self.extent
    }
}

/// Two trajectories that cannot be compared, because they have too few common times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "only {matched} of {estimated} poses have a true pose at their time, 3 are needed: do both use the same clock?"
)]
pub struct TooFewMatches {
    /// Number of poses with a true pose.
    pub matched: usize,
    /// Number of estimated poses.
    pub estimated: usize,
}

/// Compares `estimate`, its times shifted by `time_shift` seconds, with `truth`. Both are in the
/// order of their times.
pub fn trajectory_error(
    truth: &[TimedPose],
    estimate: &[TimedPose],
    association: Association,
    time_shift: f64,
) -> Result<AbsoluteTrajectoryError, TooFewMatches> {
    let pairs: Vec<(Isometry3<f64>, Isometry3<f64>)> = estimate
        .iter()
        .filter_map(|estimated| {
            let t = estimated.t + time_shift;
            let true_pose = match association {
                Association::Interpolated => interpolated(truth, t),
                Association::Nearest { max_difference } => nearest(truth, t, max_difference),
            };
            Some((true_pose?, estimated.pose))
        })
        .collect();
    let few = TooFewMatches { matched: pairs.len(), estimated: estimate.len() };
    if pairs.len() < 3 {
        return Err(few);
    }
    let positions: Vec<_> =
        pairs.iter().map(|(real, guess)| (real.translation.vector, guess.translation.vector)).collect();
    let alignment = rigid_alignment(&positions);
    let statistics = |errors: Vec<f64>| Statistics::new(errors).ok_or(few);
    Ok(AbsoluteTrajectoryError {
        time_shift,
        unmatched: estimate.len() - pairs.len(),
        direct: statistics(positions.iter().map(|(real, guess)| (real - guess).norm()).collect())?,
        direct_rotation: statistics(
            pairs.iter().map(|(real, guess)| real.rotation.angle_to(&guess.rotation)).collect(),
        )?,
        aligned: statistics(
            positions
                .iter()
                .map(|(real, guess)| (real - alignment.rotation * guess - alignment.translation.vector).norm())
                .collect(),
        )?,
        alignment_rotation: alignment.rotation.scaled_axis().into(),
        alignment_translation: alignment.translation.vector.into(),
        extent: extent(&positions),
    })
}

/// Returns the root mean square distance of the first points of the pairs from their mean.
fn extent(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> f64 {
    let count = pairs.len().max(1) as f64;
    let mean = pairs.iter().map(|(real, _)| real).sum::<Vector3<f64>>() / count;
    (pairs.iter().map(|(real, _)| (real - mean).norm_squared()).sum::<f64>() / count).sqrt()
}

/// Returns the shift in seconds, at most `range` to either side, of the times of `estimate` that minimises the root mean square
/// distance from the interpolated truth, without alignment.
///
/// Only poses whose true poses are known for every shift are used; `None` if these are fewer than 3. The minimum of a scan by
/// `range / 100` is refined to 0.1 µs.
pub fn best_time_shift(truth: &[TimedPose], estimate: &[TimedPose], range: f64) -> Option<f64> {
    let (first, last) = (truth.first()?.t, truth.last()?.t);
    let used: Vec<&TimedPose> =
        estimate.iter().filter(|pose| pose.t - range >= first && pose.t + range <= last).collect();
    if used.len() < 3 {
        return None;
    }
    let cost = |shift: f64| -> f64 {
        used.iter()
            .filter_map(|pose| {
                let position = interpolated_position(truth, pose.t + shift)?;
                Some((position - pose.pose.translation.vector).norm_squared())
            })
            .sum()
    };
    const SCAN: i32 = 100;
    let step = range / f64::from(SCAN);
    let start = (-SCAN..=SCAN).map(|index| f64::from(index) * step).min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
    let (mut low, mut high) = ((start - step).max(-range), (start + step).min(range));
    // Golden section (Kiefer 1953): every round keeps this share of the interval.
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let (mut a, mut b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
    let (mut cost_a, mut cost_b) = (cost(a), cost(b));
    // The resolution of times far from zero is coarser: the width then stops shrinking, so the number of rounds is limited.
    let rounds = ((high - low) / 1e-7).max(1.0).log(1.0 / GOLDEN).ceil() as u32;
    for _ in 0..rounds {
        if cost_a < cost_b {
            (high, b, cost_b) = (b, a, cost_a);
            a = high - GOLDEN * (high - low);
            cost_a = cost(a);
        } else {
            (low, a, cost_a) = (a, b, cost_b);
            b = low + GOLDEN * (high - low);
            cost_b = cost(b);
        }
    }
    Some(0.5 * (low + high))
}

/// Returns the poses before and after `t`, and the fraction of the time from the first to the second.
fn neighbours(truth: &[TimedPose], t: f64) -> Option<(&TimedPose, &TimedPose, f64)> {
    let after = truth.partition_point(|pose| pose.t < t);
    let after = after.max(1);
    let (a, b) = (truth.get(after - 1)?, truth.get(after)?);
    (t >= a.t && t <= b.t).then(|| (a, b, (t - a.t) / (b.t - a.t)))
}

fn interpolated(truth: &[TimedPose], t: f64) -> Option<Isometry3<f64>> {
    let (a, b, share) = neighbours(truth, t)?;
    a.pose.try_lerp_slerp(&b.pose, share, 1e-12).or(Some(a.pose))
}

fn interpolated_position(truth: &[TimedPose], t: f64) -> Option<Vector3<f64>> {
    let (a, b, share) = neighbours(truth, t)?;
    Some(a.pose.translation.vector.lerp(&b.pose.translation.vector, share))
}

fn nearest(truth: &[TimedPose], t: f64, max_difference: f64) -> Option<Isometry3<f64>> {
    let after = truth.partition_point(|pose| pose.t < t);
    let candidates = truth.get(after.saturating_sub(1)..(after + 1).min(truth.len()))?;
    let best = candidates.iter().min_by(|a, b| (a.t - t).abs().total_cmp(&(b.t - t).abs()))?;
    ((best.t - t).abs() <= max_difference).then_some(best.pose)
}

/// Returns the rigid motion that aligns the second points with the first (Horn 1987; here by the singular value decomposition of
/// Kabsch 1976).
fn rigid_alignment(pairs: &[(Vector3<f64>, Vector3<f64>)]) -> Isometry3<f64> {
    let count = pairs.len().max(1) as f64;
    let mean_real = pairs.iter().map(|(real, _)| real).sum::<Vector3<f64>>() / count;
    let mean_guess = pairs.iter().map(|(_, guess)| guess).sum::<Vector3<f64>>() / count;
    let directions = pairs.iter().map(|(real, guess)| (real - mean_real, guess - mean_guess));
    let rotation = best_rotation(directions);
    let translation = mean_real - rotation * mean_guess;
    Isometry3::from_parts(Translation3::from(translation), UnitQuaternion::from_rotation_matrix(&rotation))
}

impl fmt::Display for AbsoluteTrajectoryError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "absolute trajectory error over {} poses ({} without truth), time shift {:.1} µs",
            self.direct.count,
            self.unmatched,
            self.time_shift * 1e6
        )?;
        writeln!(f, "  not aligned  mm   {}", self.direct.scaled(1e3))?;
        writeln!(f, "  aligned      mm   {}", self.aligned.scaled(1e3))?;
        write!(f, "  orientation  deg  {}", self.direct_rotation.scaled(1f64.to_degrees()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(t: f64) -> Isometry3<f64> {
        Isometry3::new(
            Vector3::new((3.0 * t).sin(), 0.4 * (5.0 * t).cos(), 0.1 * t),
            Vector3::new(0.3 * t.sin(), 0.2 * t, 0.1),
        )
    }

    fn path(rate: f64, seconds: f64, offset: f64) -> Vec<TimedPose> {
        let count = (rate * seconds) as usize;
        (0..=count)
            .map(|index| {
                let t = index as f64 / rate;
                TimedPose { t: t + offset, pose: pose(t) }
            })
            .collect()
    }

    #[test]
    fn alignment_removes_a_rigid_motion_and_nothing_else() {
        let truth = path(1000.0, 2.0, 0.0);
        let moved = Isometry3::new(Vector3::new(0.3, -0.2, 0.1), Vector3::new(0.4, -1.1, 0.7));
        let estimate: Vec<TimedPose> =
            path(100.0, 2.0, 0.0).iter().map(|p| TimedPose { t: p.t, pose: moved.inverse() * p.pose }).collect();
        let error = trajectory_error(&truth, &estimate, Association::Interpolated, 0.0).unwrap();
        assert!(error.aligned.max < 1e-12, "{error}");
        assert!(error.direct.rmse > 0.1);
        assert!((Vector3::from(error.alignment_translation) - moved.translation.vector).norm() < 1e-12);
        assert!((Vector3::from(error.alignment_rotation) - moved.rotation.scaled_axis()).norm() < 1e-11);
        // The error of a scale is not removed: it is 1 % of the distances from the mean position.
        let larger: Vec<TimedPose> = path(100.0, 2.0, 0.0)
            .iter()
            .map(|p| {
                let mut pose = p.pose;
                pose.translation.vector *= 1.01;
                TimedPose { t: p.t, pose }
            })
            .collect();
        let error = trajectory_error(&truth, &larger, Association::Interpolated, 0.0).unwrap();
        let count = larger.len() as f64;
        let mean = larger.iter().map(|p| p.pose.translation.vector / 1.01).sum::<Vector3<f64>>() / count;
        let spread =
            larger.iter().map(|p| (p.pose.translation.vector / 1.01 - mean).norm_squared()).sum::<f64>() / count;
        assert!((error.aligned.rmse - 0.01 * spread.sqrt()).abs() < 1e-9, "{error}");
        assert!((error.extent * 1.01 - 1.01 * spread.sqrt()).abs() < 1e-9 && error.is_related());
    }

    #[test]
    fn trajectories_of_different_motions_are_not_related() {
        let truth = path(1000.0, 2.0, 0.0);
        let other: Vec<TimedPose> = truth.iter().map(|p| TimedPose { t: p.t, pose: pose(2.0 - p.t * 1.7) }).collect();
        assert!(!trajectory_error(&truth, &other, Association::Interpolated, 0.0).unwrap().is_related());
    }

    #[test]
    fn a_shifted_clock_is_found() {
        let truth = path(1000.0, 3.0, 0.0);
        for shift in [0.0, 0.0123456, -0.0471] {
            let estimate = path(200.0, 3.0, -shift);
            let found = best_time_shift(&truth, &estimate, 0.05).unwrap();
            assert!((found - shift).abs() < 1e-5, "{found} and {shift}");
            let error = trajectory_error(&truth, &estimate, Association::Interpolated, found).unwrap();
            assert!(error.direct.rmse < 2e-5, "{error}");
        }
    }

    #[test]
    fn poses_without_truth_are_counted() {
        let truth = path(100.0, 1.0, 0.0);
        let estimate = path(100.0, 1.0, 0.505);
        let error = trajectory_error(&truth, &estimate, Association::Interpolated, 0.0).unwrap();
        assert_eq!((error.direct.count, error.unmatched), (50, 51));
        let nearest = Association::Nearest { max_difference: 0.006 };
        let error = trajectory_error(&truth, &estimate, nearest, 0.0).unwrap();
        assert_eq!((error.direct.count, error.unmatched), (51, 50));
        let without_overlap = trajectory_error(&truth, &path(100.0, 1.0, 5.0), nearest, 0.0).unwrap_err();
        assert_eq!(without_overlap, TooFewMatches { matched: 0, estimated: 101 });
    }

    #[test]
    fn statistics_agree_with_the_tum_tools() {
        // Computed in another language by Horn's own method, the greatest eigenvector of his 4 × 4 matrix.
        let truth = [
            [0.246, 0.484, 0.59],
            [0.885, 0.48, 0.845],
            [-0.942, -0.069, 0.887],
            [0.298, 0.802, -0.774],
            [-0.062, -0.507, 0.088],
            [0.148, -0.974, -0.567],
        ];
        let estimate = [
            [0.139, 0.642, 0.595],
            [0.727, 0.725, 0.913],
            [-0.843, -0.325, 0.673],
            [0.193, 1.201, -0.659],
            [0.229, -0.315, -0.126],
            [0.624, -0.58, -0.817],
        ];
        let timed = |positions: &[[f64; 3]]| -> Vec<TimedPose> {
            let pose = |(index, &[x, y, z]): (usize, &[f64; 3])| TimedPose {
                t: 0.1 * index as f64,
                pose: Isometry3::translation(x, y, z),
            };
            positions.iter().enumerate().map(pose).collect()
        };
        let nearest = Association::Nearest { max_difference: 0.02 };
        let error = trajectory_error(&timed(&truth), &timed(&estimate), nearest, 0.0).unwrap();
        let close = |figures: Statistics, expected: [f64; 5]| {
            for (value, expected) in
                [figures.rmse, figures.mean, figures.median, figures.std, figures.max].into_iter().zip(expected)
            {
                assert!((value - expected).abs() < 1e-9, "{value} and {expected}");
            }
        };
        close(error.aligned, [0.034143280377, 0.033062077143, 0.034519942593, 0.008524238965, 0.042849273026]);
        close(error.direct, [0.416790914808, 0.390372640328, 0.378557503615, 0.146026943917, 0.666567325932]);
    }
}

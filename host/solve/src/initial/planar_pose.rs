//! Pose of the board plane without OpenCV: IPPE in RANSAC.
//!
//! A homography determines the plane's first-order image at one of its points. Two rotations explain it (Collins & Bartoli 2014,
//! *Infinitesimal Plane-Based Pose Estimation*); the rest of the image shows which of them is right, though only weakly if the
//! plane appears small. Samples of four points yield poses; the pose with which most points agree is fitted again to all that
//! agree (Chum, Matas & Kittler 2003, *Locally Optimized RANSAC*).

use nalgebra::{Isometry3, Matrix2, Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use evcal_geometry::board::homography::{MINIMUM_POINTS, homography};

/// A point of the board plane (m) and its undistorted image x/z, y/z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanePoint {
    /// Point on the board.
    pub plane: Vector2<f64>,
    /// Its image.
    pub image: Vector2<f64>,
}

/// The poses of a plane and the points that agree with them.
#[derive(Clone, Debug, PartialEq)]
pub struct PlanarPose {
    /// `T_camera_world`, the better solution first; a plane that appears small has two that fit almost equally well.
    pub solutions: Vec<Isometry3<f64>>,
    /// Indices of the points that agree with the better one, ascending.
    pub inliers: Vec<usize>,
}

/// Sampling ends early once at least one sample contained no wrong points with this probability.
const CONFIDENCE: f64 = 0.999;

/// Largest number of fits of one pose to the points that agree with it.
const LOCAL_FITS: usize = 3;

/// Returns the squared distance between a point's image and its projection with `pose`; infinite behind the camera.
fn squared_distance(pose: &Isometry3<f64>, point: &PlanePoint) -> f64 {
    let seen = pose * Point3::new(point.plane.x, point.plane.y, 0.0);
    if seen.z > 0.0 { (seen.xy().coords / seen.z - point.image).norm_squared() } else { f64::INFINITY }
}

/// Returns both poses `T_camera_world` of a plane by IPPE, the one that fits better first; empty if the points determine none.
pub fn ippe(points: &[PlanePoint]) -> Vec<Isometry3<f64>> {
    let mean = points.iter().map(|point| point.plane).sum::<Vector2<f64>>() / points.len().max(1) as f64;
    let plane: Vec<Vector2<f64>> = points.iter().map(|point| point.plane - mean).collect();
    let image: Vec<Vector2<f64>> = points.iter().map(|point| point.image).collect();
    let Some(rotations) = homography(&plane, &image).and_then(|h| rotations(&h)) else { return Vec::new() };
    let to_mean = Translation3::new(-mean.x, -mean.y, 0.0);
    let pose = |rotation| Some(Isometry3::from_parts(translation(&rotation, &plane, &image)?, rotation) * to_mean);
    let cost = |pose: &Isometry3<f64>| points.iter().map(|point| squared_distance(pose, point)).sum::<f64>();
    let mut poses: Vec<(Isometry3<f64>, f64)> = rotations
        .into_iter()
        .filter_map(pose)
        .map(|pose| (pose, cost(&pose)))
        .filter(|(_, cost)| cost.is_finite())
        .collect();
    poses.sort_by(|a, b| a.1.total_cmp(&b.1));
    poses.into_iter().map(|(pose, _)| pose).collect()
}

/// Returns the two rotations from a plane to the camera that explain the homography `h` to first order at the plane's origin.
fn rotations(h: &Matrix3<f64>) -> Option<[UnitQuaternion<f64>; 2]> {
    let h = h / h[(2, 2)];
    let origin = Vector2::new(h[(0, 2)], h[(1, 2)]);
    let slope = h.fixed_view::<2, 2>(0, 0) - origin * h.fixed_view::<1, 2>(2, 0);
    // Seen along the ray of the origin, the image is orthographic to first order. There it is the upper left part of the rotation
    // divided by the depth, and the largest singular value of that part is 1.
    let turn = turn_of_axis(&origin.push(1.0));
    let along = turn.fixed_view::<2, 2>(0, 0) - origin * turn.fixed_view::<1, 2>(2, 0);
    let scaled: Matrix2<f64> = along.try_inverse()? * slope;
    let upper = scaled / scaled.singular_values().max();
    // The third row completes the columns to unit length, up to its sign.
    let lack = Matrix2::identity() - upper.transpose() * upper;
    let (x, y) = (lack[(0, 0)].max(0.0).sqrt(), lack[(1, 1)].max(0.0).sqrt().copysign(lack[(0, 1)]));
    let rotation = |x: f64, y: f64| {
        let (first, second) = (upper.column(0).push(x), upper.column(1).push(y));
        let matrix = Matrix3::from_columns(&[first, second, first.cross(&second)]);
        let rotation = Rotation3::from_matrix_unchecked(turn * matrix);
        matrix.iter().all(|value| value.is_finite()).then(|| UnitQuaternion::from_rotation_matrix(&rotation))
    };
    Some([rotation(x, y)?, rotation(-x, -y)?])
}

/// Returns the smallest rotation from the optical axis to `direction`, which is in front of the camera.
fn turn_of_axis(direction: &Vector3<f64>) -> Matrix3<f64> {
    let to = direction.normalize();
    let part = 1.0 / (1.0 + to.z);
    let mixed = -to.x * to.y * part;
    Matrix3::new(1.0 - to.x * to.x * part, mixed, to.x, mixed, 1.0 - to.y * to.y * part, to.y, -to.x, -to.y, to.z)
}

/// Returns the translation at which the plane, rotated by `rotation`, is seen at `image`, by least squares on the projection
/// equations times the depth.
fn translation(
    rotation: &UnitQuaternion<f64>,
    plane: &[Vector2<f64>],
    image: &[Vector2<f64>],
) -> Option<Translation3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (point, seen) in plane.iter().zip(image) {
        let turned = rotation * point.push(0.0);
        for (axis, seen) in [(0, seen.x), (1, seen.y)] {
            let mut row = Vector3::new(0.0, 0.0, -seen);
            row[axis] = 1.0;
            normal += row * row.transpose();
            right += row * (seen * turned.z - turned[axis]);
        }
    }
    Some(Translation3::from(normal.cholesky()?.solve(&right)))
}

/// The points that agree with a pose.
struct Consensus {
    inliers: Vec<usize>,
    /// Sum of their squared distances.
    squares: f64,
}

impl Consensus {
    fn new(pose: &Isometry3<f64>, points: &[PlanePoint], threshold: f64) -> Self {
        let (mut inliers, mut squares) = (Vec::new(), 0.0);
        for (index, point) in points.iter().enumerate() {
            let squared = squared_distance(pose, point);
            if squared <= threshold * threshold {
                inliers.push(index);
                squares += squared;
            }
        }
        Self { inliers, squares }
    }

    fn better_than(&self, other: &Self) -> bool {
        let (own, others) = (self.inliers.len(), other.inliers.len());
        own > others || own == others && self.squares < other.squares
    }

    /// Returns the points themselves.
    fn points(&self, points: &[PlanePoint]) -> Vec<PlanePoint> {
        self.inliers.iter().filter_map(|&index| points.get(index).copied()).collect()
    }

    /// Fits the pose again to the points that agree, as long as that improves it.
    fn settled(mut self, points: &[PlanePoint], threshold: f64) -> Self {
        for _ in 0..LOCAL_FITS {
            let fitted = best_consensus(&ippe(&self.points(points)), points, threshold);
            match fitted.filter(|fitted| fitted.better_than(&self)) {
                Some(better) => self = better,
                None => break,
            }
        }
        self
    }
}

fn best_consensus(poses: &[Isometry3<f64>], points: &[PlanePoint], threshold: f64) -> Option<Consensus> {
    let all = poses.iter().map(|pose| Consensus::new(pose, points, threshold));
    all.reduce(|best, next| if next.better_than(&best) { next } else { best })
}

/// Returns four different indices below `count`, which is at least four.
fn sample(count: usize, random: &mut ChaCha8Rng) -> [usize; MINIMUM_POINTS] {
    let mut chosen = [usize::MAX; MINIMUM_POINTS];
    for place in 0..MINIMUM_POINTS {
        chosen[place] = loop {
            let index = random.random_range(0..count);
            if !chosen.contains(&index) {
                break index;
            }
        };
    }
    chosen
}

/// Estimates the pose of a plane from points that include wrong ones.
///
/// `threshold` is the largest distance of a point that agrees, in the unit of the images (pixels over focal length), `iterations`
/// the largest number of samples. The same `seed` yields the same samples. Returns `None` if [`MINIMUM_POINTS`] points agree with
/// no pose.
pub fn planar_pose(points: &[PlanePoint], threshold: f64, iterations: u16, seed: u64) -> Option<PlanarPose> {
    if points.len() < MINIMUM_POINTS {
        return None;
    }
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut best: Option<Consensus> = None;
    for done in 0..iterations {
        let share = best.as_ref().map_or(0.0, |best| best.inliers.len() as f64 / points.len() as f64);
        let clean = share * share * share * share;
        if libm::pow(1.0 - clean, f64::from(done)) <= 1.0 - CONFIDENCE {
            break;
        }
        let sampled: Vec<PlanePoint> =
            sample(points.len(), &mut random).iter().filter_map(|&index| points.get(index).copied()).collect();
        let found = best_consensus(&ippe(&sampled), points, threshold);
        if let Some(found) = found.filter(|found| best.as_ref().is_none_or(|best| found.better_than(best))) {
            best = Some(found.settled(points, threshold));
        }
    }
    let best = best.filter(|best| best.inliers.len() >= MINIMUM_POINTS)?;
    let solutions = ippe(&best.points(points));
    (!solutions.is_empty()).then_some(PlanarPose { solutions, inliers: best.inliers })
}

#[cfg(test)]
mod tests;

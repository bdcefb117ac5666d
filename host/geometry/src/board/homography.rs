//! Homography between the board plane and an image, and the pose that follows from it.

use nalgebra::{Isometry3, Matrix3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector2, Vector3};

/// Smallest number of points that determines a homography.
pub const MINIMUM_POINTS: usize = 4;

/// Returns the similarity that moves points to mean 0 and root mean square distance √2 (Hartley 1997).
fn normalisation(points: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    let count = points.len() as f64;
    let mean = points.iter().sum::<Vector2<f64>>() / count;
    let square = points.iter().map(|point| (point - mean).norm_squared()).sum::<f64>() / count;
    let scale = (2.0 / square).sqrt();
    (scale.is_finite() && scale > 0.0)
        .then(|| Matrix3::new(scale, 0.0, -scale * mean.x, 0.0, scale, -scale * mean.y, 0.0, 0.0, 1.0))
}

/// Computes the homography from `plane` to `image` by the normalised direct linear transform. Its sign is chosen so
/// that the points lie in front (third coordinate positive). Returns `None` for fewer than [`MINIMUM_POINTS`] points or
/// collinear points.
pub fn homography(plane: &[Vector2<f64>], image: &[Vector2<f64>]) -> Option<Matrix3<f64>> {
    if plane.len() < MINIMUM_POINTS || plane.len() != image.len() {
        return None;
    }
    let (from, to) = (normalisation(plane)?, normalisation(image)?);
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    for (p, q) in plane.iter().zip(image) {
        let p = from * p.push(1.0);
        let q = to * q.push(1.0);
        let zero = Vector3::zeros();
        for row in [[p, zero, p * -q.x], [zero, p, p * -q.y]] {
            let row = SMatrix::<f64, 9, 1>::from_iterator(row.iter().flat_map(|part| part.iter().copied()));
            normal.ger(1.0, &row, &row, 1.0);
        }
    }
    let eigen = normal.symmetric_eigen();
    let mut order: Vec<usize> = (0..9).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    // Two vanishing eigenvalues: collinear points have a family of solutions.
    if eigen.eigenvalues[order[1]] < 1e-9 * eigen.eigenvalues[order[8]] {
        return None;
    }
    let h = eigen.eigenvectors.column(order[0]);
    let h = Matrix3::new(h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], h[8]);
    let h = to.try_inverse()? * h * from;
    let depth: f64 = plane.iter().map(|p| (h * p.push(1.0)).z.signum()).sum();
    let h = if depth < 0.0 { -h } else { h };
    h.iter().all(|value| value.is_finite()).then_some(h)
}

/// Computes `T_camera_world` of the plane z = 0 from its homography to normalised image coordinates.
pub fn pose_from_homography(h: &Matrix3<f64>) -> Option<Isometry3<f64>> {
    let (h1, h2, h3) = (h.column(0).into_owned(), h.column(1).into_owned(), h.column(2).into_owned());
    let scale = 2.0 / (h1.norm() + h2.norm());
    let rotation = Matrix3::from_columns(&[h1 * scale, h2 * scale, h1.cross(&h2) * (scale * scale)]);
    let svd = rotation.svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    if !scale.is_finite() || rotation.determinant() <= 0.0 {
        return None;
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    Some(Isometry3::from_parts(Translation3::from(h3 * scale), rotation))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pose_is_recovered_from_exact_images() {
        let pose = Isometry3::new(Vector3::new(-0.1, -0.2, 0.7), Vector3::new(0.3, -0.4, 0.9));
        let plane: Vec<Vector2<f64>> =
            (0..20).map(|index| Vector2::new(f64::from(index % 5) * 0.05, f64::from(index / 5) * 0.07)).collect();
        let image: Vec<Vector2<f64>> = plane
            .iter()
            .map(|p| {
                let p = pose * nalgebra::Point3::new(p.x, p.y, 0.0);
                Vector2::new(p.x / p.z, p.y / p.z)
            })
            .collect();
        let found = pose_from_homography(&homography(&plane, &image).unwrap()).unwrap();
        assert!((found.to_homogeneous() - pose.to_homogeneous()).norm() < 1e-9);
    }

    #[test]
    fn collinear_points_have_no_homography() {
        let line: Vec<Vector2<f64>> =
            (0..8).map(|index| Vector2::new(f64::from(index), 2.0 * f64::from(index))).collect();
        assert_eq!(homography(&line, &line), None);
        assert_eq!(homography(&line[..3], &line[..3]), None);
        let same = vec![Vector2::new(1.0, 1.0); 8];
        assert_eq!(homography(&same, &line), None);
    }
}

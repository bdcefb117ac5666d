use super::*;
use evcal_geometry::numerics::random::normal;

/// A grid of 7 × 5 points, 40 mm apart, at a pose that differs from view to view.
fn truth(view: u32) -> Isometry3<f64> {
    let wave = |rate: f64| libm::sin(rate * f64::from(view) + rate);
    let rotation = UnitQuaternion::from_euler_angles(0.6 * wave(1.1), 0.6 * wave(2.3), 2.0 * wave(0.7));
    let middle = rotation * Vector3::new(0.12, 0.08, 0.0);
    let position = Vector3::new(0.1 * wave(1.7), 0.08 * wave(0.4), 0.5 + 0.2 * wave(3.1));
    Isometry3::from_parts(Translation3::from(position - middle), rotation)
}

fn seen(pose: &Isometry3<f64>, noise: f64, random: &mut ChaCha8Rng) -> Vec<PlanePoint> {
    let grid = (0..35).map(|index| Vector2::new(f64::from(index % 7), f64::from(index / 7)) * 0.04);
    grid.map(|plane| {
        let point = pose * Point3::new(plane.x, plane.y, 0.0);
        let image = point.xy().coords / point.z + Vector2::new(normal(random), normal(random)) * noise;
        PlanePoint { plane, image }
    })
    .collect()
}

fn pose_distance(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.to_homogeneous() - b.to_homogeneous()).norm()
}

#[test]
fn exact_images_yield_the_pose() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    for view in 0..50 {
        let pose = truth(view);
        let points = seen(&pose, 0.0, &mut random);
        assert!(pose_distance(&ippe(&points)[0], &pose) < 1e-9, "view {view}");
        let corners: Vec<PlanePoint> = [0, 6, 28, 34].map(|index| points[index]).to_vec();
        assert!(pose_distance(&ippe(&corners)[0], &pose) < 1e-8, "view {view}");
    }
}

/// From afar, a tilt to one side and the tilt to the other look the same: the second solution is the plane mirrored at the one
/// that faces the camera.
#[test]
fn a_plane_that_appears_small_has_two_poses_that_fit_equally_well() {
    let rotation = UnitQuaternion::from_euler_angles(0.4, 0.0, 0.0);
    let far = Isometry3::from_parts(Translation3::new(0.0, 0.0, 8.0), rotation) * Translation3::new(-0.12, -0.08, 0.0);
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let poses = ippe(&seen(&far, 0.0, &mut random));
    assert_eq!(poses.len(), 2);
    assert!(pose_distance(&poses[0], &far) < 1e-6);
    let other = UnitQuaternion::from_euler_angles(-0.4, 0.0, 0.0);
    assert!(poses[1].rotation.angle_to(&other) < 0.01, "{}", poses[1]);
    let worst = seen(&far, 0.0, &mut random).iter().map(|point| squared_distance(&poses[1], point)).fold(0.0, f64::max);
    assert!(worst.sqrt() * 345.0 < 0.1, "{worst}");
}

#[test]
fn points_that_determine_no_pose_yield_none() {
    let line = |index: i32| PlanePoint { plane: Vector2::new(f64::from(index), 0.0), image: Vector2::new(0.01, 0.0) };
    let line: Vec<PlanePoint> = (0..10).map(line).collect();
    assert!(ippe(&line).is_empty() && ippe(&line[..3]).is_empty() && ippe(&[]).is_empty());
    assert_eq!(planar_pose(&line, 0.01, 100, 0), None);
    assert_eq!(planar_pose(&line[..3], 0.01, 100, 0), None);
}

/// Four of ten points are wrong: whatever the samples, the correct points are found.
#[test]
fn wrong_points_are_excluded_whatever_the_seed() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let (pixel, bound) = (1.0 / 345.0, 3.0 / 345.0);
    for view in 0..20 {
        let pose = truth(view);
        let mut points = seen(&pose, 0.15 * pixel, &mut random);
        let wrong = |index: usize| index % 5 < 2;
        for (_, point) in points.iter_mut().enumerate().filter(|(index, _)| wrong(*index)) {
            let angle = random.random_range(0.0..std::f64::consts::TAU);
            point.image += Vector2::new(libm::cos(angle), libm::sin(angle)) * (random.random_range(6.0..60.0) * pixel);
        }
        let right: Vec<usize> = (0..points.len()).filter(|&index| !wrong(index)).collect();
        let found: Vec<PlanarPose> = (0..10).map(|seed| planar_pose(&points, bound, 100, seed).unwrap()).collect();
        for found in &found {
            assert_eq!(found.inliers, right, "view {view}");
            assert!(
                pose_distance(&found.solutions[0], &pose) < 0.02,
                "view {view}: {}",
                pose_distance(&found.solutions[0], &pose)
            );
        }
        assert_eq!(planar_pose(&points, bound, 100, 4), Some(found[4].clone()));
    }
}

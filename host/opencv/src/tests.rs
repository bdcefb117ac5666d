use evcal_core::pattern::{Layout, Pattern};
use evcal_core::sensor::Sensor;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2};

use super::*;

const SENSOR: Sensor = Sensor::new(346, 260);

fn object() -> Vec<[f64; 2]> {
    (0..35).map(|index| [f64::from(index % 7) * 0.04, f64::from(index / 7) * 0.04]).collect()
}

fn pose_of_view(view: u32) -> Isometry3<f64> {
    let wave = |rate: f64| (rate * f64::from(view)).sin();
    let tilt = UnitQuaternion::from_euler_angles(0.5 * wave(1.1), 0.5 * wave(2.3), 0.4 * wave(0.7));
    Isometry3::from_parts(Translation3::new(-0.12 + 0.05 * wave(1.7), -0.08 + 0.04 * wave(0.4), 0.4), tilt)
}

/// Returns x/z, y/z of the board's points.
fn normalised(pose: &Isometry3<f64>) -> Vec<[f64; 2]> {
    object()
        .iter()
        .map(|point| pose * nalgebra::Point3::new(point[0], point[1], 0.0))
        .map(|point| [point.x / point.z, point.y / point.z])
        .collect()
}

fn views(distort: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<View> {
    (0..20)
        .map(|view| View {
            object: object(),
            image: normalised(&pose_of_view(view)).into_iter().map(&distort).collect(),
        })
        .collect()
}

fn brown([x, y]: [f64; 2]) -> [f64; 2] {
    let (k1, k2, p1, p2) = (-0.3, 0.1, 1e-3, -2e-3);
    let s = x * x + y * y;
    let d = 1.0 + k1 * s + k2 * s * s;
    let u = x * d + 2.0 * p1 * x * y + p2 * (s + 2.0 * x * x);
    let v = y * d + 2.0 * p2 * x * y + p1 * (s + 2.0 * y * y);
    [345.0 * u + 170.0, 344.0 * v + 127.0]
}

fn equidistant([x, y]: [f64; 2]) -> [f64; 2] {
    let r = x.hypot(y);
    let theta = r.atan();
    let d = theta * (1.0 + 0.02 * theta.powi(2) - 0.01 * theta.powi(4));
    let scale = if r > 0.0 { d / r } else { 1.0 };
    [210.0 * x * scale + 174.0, 209.0 * y * scale + 131.0]
}

#[test]
fn pinhole_calibration_finds_the_camera_and_the_poses() {
    let calibration = calibrate_pinhole(&views(brown), SENSOR, PinholeDistortion::RadialTangential4, None).unwrap();
    let Intrinsics { focal, center, distortion } = &calibration.intrinsics;
    // OpenCV receives points in single precision.
    for (found, truth) in focal.iter().chain(center).zip([345.0, 344.0, 170.0, 127.0]) {
        assert!((found - truth).abs() < 0.01, "{found} {truth}");
    }
    for (found, truth) in distortion.iter().zip([-0.3, 0.1, 1e-3, -2e-3]) {
        assert!((found - truth).abs() < 1e-3, "{found} {truth}");
    }
    assert!(calibration.rms < 1e-3 && calibration.view_rms.iter().all(|rms| *rms < 1e-3));
    for (view, pose) in calibration.poses.iter().enumerate() {
        assert!((pose.to_homogeneous() - pose_of_view(view as u32).to_homogeneous()).norm() < 1e-3);
    }
    let again =
        calibrate_pinhole(&views(brown), SENSOR, PinholeDistortion::RadialTangential8, Some(&calibration.intrinsics));
    assert_eq!(again.unwrap().intrinsics.distortion.len(), 8);
}

#[test]
fn fisheye_calibration_finds_the_camera_and_excludes_an_unsuitable_view() {
    let mut views = views(equidistant);
    // All points of a view coincide: there is no homography, and OpenCV throws an exception.
    let point = views[4].image[0];
    views[4].image.iter_mut().for_each(|image| *image = point);
    let calibration = calibrate_fisheye(&views, SENSOR).unwrap();
    assert!(!calibration.views.contains(&4) && calibration.views.len() >= 14, "{:?}", calibration.views);
    let Intrinsics { focal, center, .. } = calibration.intrinsics;
    for (found, truth) in focal.iter().chain(&center).zip([210.0, 209.0, 174.0, 131.0]) {
        assert!((found - truth).abs() < 0.1, "{found} {truth}");
    }
}

#[test]
fn impossible_calibrations_return_an_error_and_do_not_abort() {
    let line = View {
        object: (0..10).map(|index| [f64::from(index), 0.0]).collect(),
        image: (0..10).map(|index| [f64::from(index), 0.0]).collect(),
    };
    let unequal = View { object: object(), image: vec![[0.0; 2]; 3] };
    let nan = View { object: object(), image: vec![[f64::NAN; 2]; 35] };
    for views in [vec![], vec![line; 5], vec![unequal], vec![nan]] {
        assert!(calibrate_pinhole(&views, SENSOR, PinholeDistortion::RadialTangential5, None).is_err());
        assert!(calibrate_fisheye(&views, SENSOR).is_err());
    }
}

#[test]
fn pnp_finds_the_pose_and_the_outliers() {
    let truth = pose_of_view(3);
    let mut image = normalised(&truth);
    for index in [2, 17, 30] {
        image[index][0] += 0.05;
    }
    let found = solve_pnp_ransac_ippe(&object(), &image, 3.0 / 345.0, 100).unwrap().unwrap();
    let expected: Vec<usize> = (0..35).filter(|index| ![2, 17, 30].contains(index)).collect();
    assert_eq!(found.inliers, expected);
    assert!((found.solutions[0].to_homogeneous() - truth.to_homogeneous()).norm() < 1e-6);
    assert!(solve_pnp_ransac_ippe(&object()[..3], &image[..3], 0.01, 100).is_err());
}

#[test]
fn grid_of_clean_points_is_found_in_board_order() {
    let pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };
    let points: Vec<Vector2<f64>> = (0..pattern.circle_count())
        .map(|index| {
            let (x, y) = pattern.lattice_position(index);
            Vector2::new(60.0 + 24.0 * f64::from(x) + 2.0 * f64::from(y), 30.0 + 20.0 * f64::from(y))
        })
        .collect();
    let shuffled: Vec<Vector2<f64>> = (0..36).map(|index| points[index * 7 % 36]).collect();
    let order = find_circles_grid(&shuffled, pattern).unwrap().unwrap();
    for (index, candidate) in order.into_iter().enumerate() {
        assert_eq!(shuffled[candidate], points[index]);
    }
    assert_eq!(find_circles_grid(&points[..30], pattern), Ok(None));
}

/// OpenBLAS, which many machines use under OpenCV, needs more stack than a thread has by default.
#[test]
fn calibrations_of_opencv_use_their_own_stack() {
    let object: Vec<[f64; 2]> =
        (0..35).map(|index| [f64::from(index % 7) * 0.04, f64::from(index / 7) * 0.04]).collect();
    // A pinhole camera of 345 px; the board is rotated about its y axis by a different angle in each view.
    let view = |index: i32| {
        let (sine, cosine) = (0.15 * f64::from(index - 4)).sin_cos();
        let place = |[x, y]: [f64; 2]| {
            let z = 0.5 - sine * (x - 0.12);
            [345.0 * cosine * (x - 0.12) / z + 172.5, 345.0 * (y - 0.08 + 0.004 * f64::from(index)) / z + 129.5]
        };
        View { object: object.clone(), image: object.iter().map(|&point| place(point)).collect() }
    };
    let views: Vec<View> = (0..9).map(view).collect();
    let calibrate =
        move || calibrate_pinhole(&views, Sensor::new(346, 260), PinholeDistortion::RadialTangential4, None);
    let thread = std::thread::Builder::new().stack_size(64 << 10).spawn(calibrate).unwrap();
    let focal = thread.join().unwrap().unwrap().intrinsics.focal;
    assert!((focal[0] - 345.0).abs() < 0.1 && (focal[1] - 345.0).abs() < 0.1, "{focal:?}");
}

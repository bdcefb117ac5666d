//! One set of tests for every model in [`ModelKind::ALL`].

use nalgebra::{SMatrix, Vector2, Vector3};
use proptest::prelude::*;
use std::string::ToString;
use std::vec::Vec;

use super::*;

const WIDTH: f64 = 346.0;
const HEIGHT: f64 = 260.0;

/// Distortions to try with each model: none, realistic, strong.
fn distortions(kind: ModelKind) -> &'static [&'static [f64]] {
    match kind {
        ModelKind::Radtan4 => {
            &[&[0.0; 4], &[-0.3, 0.1, 0.001, -0.0005], &[0.2, 0.05, -0.003, 0.002], &[-0.25, 0.05, 0.02, 0.015]]
        }
        ModelKind::Radtan => &[&[0.0; 5], &[-0.37, 0.16, 0.0001, -0.0002, -0.03], &[0.1, -0.1, 0.002, 0.001, 0.3]],
        ModelKind::Radtan8 => &[
            &[0.0; 8],
            &[0.5, 0.1, 0.0005, -0.0003, 0.02, 0.8, 0.3, 0.05],
            &[-0.3, 0.05, 0.0, 0.001, 0.0, 0.1, 0.0, 0.0],
            &[3.0, 1.5, 1e-4, 2e-4, 0.1, 3.4, 2.3, 0.4],
        ],
        ModelKind::KannalaBrandt => &[&[0.0; 4], &[-0.02, 0.01, -0.005, 0.001], &[0.1, 0.02, 0.01, 0.002]],
        ModelKind::InverseRadial => &[&[0.0; 5], &[0.3, 0.1, 0.1, 0.05, 0.02], &[-0.2, 0.1, -0.05, 0.0, 0.01]],
        ModelKind::Ucm => &[&[0.0], &[0.35], &[0.5], &[0.68], &[1.0], &[-0.3], &[1.2]],
        ModelKind::Eucm => &[&[0.0, 1.0], &[0.57, 1.12], &[0.65, 0.7], &[0.4, 2.5], &[-0.2, 1.3], &[1.1, 0.8]],
        ModelKind::DoubleSphere => &[&[0.0; 2], &[-0.18, 0.59], &[0.3, 0.4], &[-0.5, 0.7], &[1.0, 0.2], &[1.5, 0.0]],
        ModelKind::Fov => &[&[1e-5], &[0.3], &[0.93], &[1.6]],
        ModelKind::Omni => &[
            &[0.0; 5],
            &[1.2, -0.2, 0.05, 0.001, -0.0005],
            &[0.8, 0.1, -0.02, -0.001, 0.002],
            &[2.5, 0.1, 0.0, 0.0, 0.0],
        ],
    }
}

/// Returns `true` for models of lenses that may see behind the plane Z = 0.
fn is_wide(kind: ModelKind) -> bool {
    use ModelKind::{DoubleSphere, Eucm, Fov, KannalaBrandt, Omni, Ucm};
    matches!(kind, KannalaBrandt | Ucm | Eucm | DoubleSphere | Fov | Omni)
}

/// Returns the focal length on the axis divided by fx.
fn axial_magnification(kind: ModelKind, coefficients: &[f64]) -> f64 {
    match kind {
        ModelKind::DoubleSphere | ModelKind::Omni => 1.0 / (1.0 + coefficients[0]),
        ModelKind::Fov => 2.0 * (coefficients[0] / 2.0).tan() / coefficients[0],
        _ => 1.0,
    }
}

fn parameter_sets(kind: ModelKind) -> impl Iterator<Item = Vec<f64>> {
    // Fisheye lenses have a short focal length: with 110 px the corners of the sensor are 100° off the axis.
    let focal = if kind == ModelKind::KannalaBrandt { 110.0 } else { 345.0 };
    distortions(kind).iter().map(move |coefficients| {
        let focal = focal / axial_magnification(kind, coefficients);
        [focal, focal * 0.99, 170.3, 127.8].iter().chain(coefficients.iter()).copied().collect()
    })
}

fn cameras() -> impl Iterator<Item = Camera<f64>> {
    ModelKind::ALL.iter().flat_map(|&kind| {
        parameter_sets(kind).map(move |parameters| Camera::from_parameters(kind, &parameters).unwrap())
    })
}

fn single(camera: &Camera<f64>) -> Camera<f32> {
    let parameters: Vec<f32> = camera.parameters().iter().map(|&value| value as f32).collect();
    Camera::from_parameters(camera.kind(), &parameters).unwrap()
}

fn sensor() -> impl Iterator<Item = Vector2<f64>> {
    (0..=20).flat_map(|row| {
        (0..=20).map(move |column| {
            Vector2::new(f64::from(column) / 20.0 * (WIDTH - 1.0), f64::from(row) / 20.0 * (HEIGHT - 1.0))
        })
    })
}

/// Returns the columns of central differences of `function` around `at`.
fn differences<const M: usize>(
    at: &[f64],
    step: impl Fn(usize) -> f64,
    function: impl Fn(&[f64]) -> Option<SMatrix<f64, M, 1>>,
) -> Option<Vec<SMatrix<f64, M, 1>>> {
    (0..at.len())
        .map(|index| {
            let moved = |by: f64| {
                let mut moved = at.to_vec();
                moved[index] += by;
                function(&moved)
            };
            let step = step(index);
            Some((moved(step)? - moved(-step)?) / (2.0 * step))
        })
        .collect()
}

fn assert_close<const M: usize>(
    analytic: &SMatrix<f64, M, 1>,
    numeric: &SMatrix<f64, M, 1>,
    tolerance: f64,
    what: &dyn std::fmt::Debug,
) {
    assert!((analytic - numeric).norm() <= tolerance * (1.0 + numeric.norm()), "{what:?}: {analytic} {numeric}");
}

#[test]
fn names_and_parameters_are_consistent() {
    for &kind in ModelKind::ALL {
        assert_eq!(ModelKind::from_name(kind.name()), Some(kind));
        assert_eq!(kind.to_string().parse(), Ok(kind));
        assert_eq!(kind.parameter_names()[..4], ["fx", "fy", "cx", "cy"]);
        assert!(kind.parameter_names().len() <= MAX_PARAMETERS);
        for parameters in parameter_sets(kind) {
            assert_eq!(parameters.len(), kind.parameter_names().len());
            let camera = Camera::from_parameters(kind, &parameters).unwrap();
            assert_eq!(camera.kind(), kind);
            assert_eq!(camera.parameters().as_slice(), parameters);
        }
    }
    assert_eq!(ModelKind::from_name("Radtan"), None);
    assert_eq!("".parse::<ModelKind>(), Err(UnknownModel));
    assert!(UnknownModel.to_string().contains("kannala-brandt"));
}

#[test]
fn unusable_parameters_are_rejected() {
    for &kind in ModelKind::ALL {
        for parameters in parameter_sets(kind) {
            let refused = |parameters: &[f64]| Camera::from_parameters(kind, parameters).is_none();
            assert!(refused(&parameters[1..]));
            assert!(refused(&[]));
            let mut more = parameters.clone();
            more.push(0.0);
            assert!(refused(&more));
            for index in 0..parameters.len() {
                for value in [f64::NAN, f64::INFINITY] {
                    let mut wrong = parameters.clone();
                    wrong[index] = value;
                    assert!(refused(&wrong));
                }
            }
            for value in [0.0, -345.0] {
                let mut wrong = parameters.clone();
                wrong[1] = value;
                assert!(refused(&wrong));
            }
        }
    }
}

#[test]
fn pixels_of_the_sensor_survive_the_round_trip() {
    for camera in cameras() {
        let mut inside = 0;
        for pixel in sensor() {
            let Some(bearing) = camera.unproject(&pixel) else { continue };
            inside += 1;
            assert!((bearing.norm() - 1.0).abs() < 1e-14);
            let again = camera.project(&(bearing * 7.5)).unwrap();
            assert!((again - pixel).norm() < 1e-9, "{camera:?} {pixel} {again}");
        }
        assert!(inside > 350, "{camera:?}: only {inside} pixels have a bearing");
    }
}

#[test]
fn single_precision_agrees_with_double() {
    for camera in cameras() {
        let narrow = single(&camera);
        for pixel in sensor() {
            let Some(wide) = camera.unproject_with_jacobians(&pixel) else { continue };
            // Derivatives of more than a radian per 50 px are near a fold.
            if wide.by_pixel.norm() > 0.02 {
                continue;
            }
            let single_pixel = pixel.map(|value| value as f32);
            let found = narrow.unproject_with_jacobians(&single_pixel).unwrap();
            assert!((found.bearing.cast::<f64>() - wide.bearing).norm() < 3e-6, "{camera:?} {pixel}");
            let difference = (found.by_pixel.cast::<f64>() - wide.by_pixel).norm();
            assert!(difference < 1e-4 * wide.by_pixel.norm(), "{camera:?} {pixel} {difference}");
            let difference = (found.by_parameters.cast::<f64>() - wide.by_parameters).norm();
            assert!(difference < 1e-4 * wide.by_parameters.norm(), "{camera:?} {pixel} {difference}");
            let again = narrow.project(&found.bearing).unwrap();
            assert!((again - single_pixel).norm() < 1e-3, "{camera:?} {pixel} {again}");
            let projected = narrow.project_with_jacobians(&found.bearing).unwrap();
            let expected = camera.project_with_jacobians(&wide.bearing).unwrap();
            let difference = (projected.by_point.cast::<f64>() - expected.by_point).norm();
            assert!(difference < 1e-4 * expected.by_point.norm(), "{camera:?} {pixel} {difference}");
        }
    }
}

/// Compares all derivatives at a pixel with central differences; returns `false` if there was nothing to compare.
fn check_jacobians(camera: &Camera<f64>, pixel: &Vector2<f64>) -> bool {
    let kind = camera.kind();
    let parameters = camera.parameters();
    let Some(unprojection) = camera.unproject_with_jacobians(pixel) else { return false };
    // Close to a fold the inverse is too strongly curved for differences.
    if unprojection.by_pixel.norm() * parameters[0] > 10.0 {
        return false;
    }
    assert_eq!(camera.unproject(pixel), Some(unprojection.bearing));
    // Steps that move a bearing by at most a millionth of a radian, or a pixel by at most 10⁻⁵.
    let bearing_step = |index| 1e-6 / (1.0 + unprojection.by_parameters.column(index).norm());
    let by_pixel = differences(pixel.as_slice(), |_| 1e-5, |at| camera.unproject(&Vector2::new(at[0], at[1])));
    let by_parameters =
        differences(&parameters, bearing_step, |at| Camera::from_parameters(kind, at)?.unproject(pixel));
    let point = unprojection.bearing * 2.0;
    let projection = camera.project_with_jacobians(&point).unwrap();
    assert_eq!(camera.project(&point), Some(projection.pixel));
    if projection.by_point.norm() > 50.0 * parameters[0] {
        return false;
    }
    let point_step = |index| 1e-5 / (1.0 + projection.by_point.column(index).norm());
    let by_point = differences(point.as_slice(), point_step, |at| camera.project(&Vector3::new(at[0], at[1], at[2])));
    let parameter_step = |index| 1e-5 / (1.0 + projection.by_parameters.column(index).norm());
    let projection_by_parameters =
        differences(&parameters, parameter_step, |at| Camera::from_parameters(kind, at)?.project(&point));
    let (Some(by_pixel), Some(by_parameters), Some(by_point), Some(projection_by_parameters)) =
        (by_pixel, by_parameters, by_point, projection_by_parameters)
    else {
        return false;
    };
    let what = (camera, pixel);
    for (index, numeric) in by_pixel.iter().enumerate() {
        assert_close(&unprojection.by_pixel.column(index).into_owned(), numeric, 1e-8, &what);
    }
    for (index, numeric) in by_point.iter().enumerate() {
        assert_close(&projection.by_point.column(index).into_owned(), numeric, 1e-6, &what);
    }
    for index in 0..MAX_PARAMETERS {
        let analytic = unprojection.by_parameters.column(index).into_owned();
        let projected = projection.by_parameters.column(index).into_owned();
        if index < parameters.len() {
            assert_close(&analytic, &by_parameters[index], 1e-7, &what);
            assert_close(&projected, &projection_by_parameters[index], 1e-6, &what);
        } else {
            assert!(analytic.iter().all(|&value| value == 0.0));
            assert!(projected.iter().all(|&value| value == 0.0));
        }
    }
    true
}

#[test]
fn jacobians_agree_with_central_differences() {
    for camera in cameras() {
        let compared = sensor().filter(|pixel| check_jacobians(&camera, pixel)).count();
        assert!(compared > 300, "{camera:?}: only {compared} pixels compared");
    }
}

#[test]
fn the_optical_axis_is_regular() {
    for camera in cameras() {
        let parameters = camera.parameters();
        let centre = Vector2::new(parameters[2], parameters[3]);
        assert_eq!(camera.unproject(&centre), Some(Vector3::z()));
        assert_eq!(camera.project(&Vector3::new(0.0, 0.0, 3.0)), Some(centre));
        assert!(check_jacobians(&camera, &centre));
        for tiny in [1e-300, 1e-160, 1e-20, 1e-9] {
            let projection = camera.project_with_jacobians(&Vector3::new(tiny, -tiny, 1.0)).unwrap();
            let focal = parameters[0] * axial_magnification(camera.kind(), &parameters[4..]);
            assert!((projection.by_point[(0, 0)] - focal).abs() < 1e-6, "{camera:?} {tiny}");
            assert!(projection.by_point.iter().all(|value| value.is_finite()));
        }
    }
}

#[test]
fn nan_and_infinity_have_no_image() {
    for camera in cameras() {
        for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for index in 0..2 {
                let mut pixel = Vector2::new(100.0, 100.0);
                pixel[index] = wrong;
                assert_eq!(camera.unproject(&pixel), None);
                assert!(camera.unproject_with_jacobians(&pixel).is_none());
                let mut point = Vector3::new(0.1, 0.1, 1.0);
                point[index] = wrong;
                assert_eq!(camera.project(&point), None);
                assert!(camera.project_with_jacobians(&point).is_none());
            }
        }
        assert_eq!(camera.project(&Vector3::new(0.1, 0.1, f64::NAN)), None);
        assert_eq!(camera.project(&Vector3::zeros()), None);
    }
}

#[test]
fn points_behind_the_camera_have_no_image_in_pinhole_models() {
    for camera in cameras() {
        assert_eq!(camera.project(&Vector3::new(0.0, 0.0, -1.0)), None);
        if !is_wide(camera.kind()) {
            for z in [0.0, -0.0, -1e-300, -1.0] {
                assert_eq!(camera.project(&Vector3::new(0.1, -0.2, z)), None);
            }
        }
    }
}

/// Moves outwards: pixels must move away from the centre until the domain ends, and no pixel may follow.
#[test]
fn the_domain_is_one_branch() {
    for camera in cameras() {
        let centre = Vector2::new(camera.parameters()[2], camera.parameters()[3]);
        for azimuth in (0..16).map(|index| f64::from(index) * 0.39) {
            let mut farthest = 0.0;
            let mut ended = false;
            for angle in (1..3140).map(|index| f64::from(index) * 1e-3) {
                let (sine, cosine) = angle.sin_cos();
                let point = Vector3::new(azimuth.cos() * sine, azimuth.sin() * sine, cosine);
                match camera.project(&point) {
                    Some(pixel) => {
                        assert!(!ended, "{camera:?}: visible again at {angle}");
                        let distance = (pixel - centre).norm();
                        assert!(distance > farthest, "{camera:?}: folds at {angle}");
                        farthest = distance;
                    }
                    None => ended = true,
                }
            }
            // Far outside there is no pixel, or the pixel of a bearing that projects back to it.
            for distance in [1.001, 1.01, 1.5, 10.0, 1e6] {
                let pixel = centre + Vector2::new(azimuth.cos(), azimuth.sin()) * farthest * distance;
                if let Some(bearing) = camera.unproject(&pixel) {
                    let again = camera.project(&bearing).unwrap();
                    assert!((again - pixel).norm() < 1e-9 * pixel.norm(), "{camera:?} {pixel} {again}");
                }
            }
        }
    }
}

#[test]
fn fisheye_sees_behind_the_image_plane() {
    let camera: Camera<f64> =
        Camera::from_parameters(ModelKind::KannalaBrandt, &[100.0, 100.0, 170.0, 127.0, 0.0, 0.0, 0.0, 0.0]).unwrap();
    for degrees in [89.0_f64, 90.0, 91.0, 120.0, 175.0] {
        let (sine, cosine) = degrees.to_radians().sin_cos();
        let pixel = camera.project(&Vector3::new(sine, 0.0, cosine)).unwrap();
        assert!((pixel.x - 170.0 - 100.0 * degrees.to_radians()).abs() < 1e-10);
        let bearing = camera.unproject(&pixel).unwrap();
        assert!((bearing - Vector3::new(sine, 0.0, cosine)).norm() < 1e-14);
        assert!(check_jacobians(&camera, &pixel));
    }
    assert_eq!(camera.unproject(&Vector2::new(170.0 + 100.0 * 3.15, 127.0)), None);
}

/// Newton's method alone oscillates between two angles here.
#[test]
fn a_fisheye_with_an_inflection_is_inverted() {
    let coefficients =
        [0.009_846_689_147_363_67, 0.189_246_635_868_112_05, 0.194_425_167_183_059_47, -0.088_087_022_348_287_73];
    let parameters: Vec<f64> = [80.0, 72.0, 172.0, 131.0].into_iter().chain(coefficients).collect();
    let camera = Camera::from_parameters(ModelKind::KannalaBrandt, &parameters).unwrap();
    let angles = (1..1500).map(|step| f64::from(step) * 1e-3);
    for angle in angles.chain([1.071_338_912_678_142]) {
        let (sine, cosine) = angle.sin_cos();
        let bearing = Vector3::new(sine, 0.0, cosine);
        let found = camera.unproject(&camera.project(&bearing).unwrap()).unwrap();
        assert!((found - bearing).norm() < 1e-11, "{bearing} {found}");
    }
}

/// With k1 < 0 alone, the model folds at 1 + 3 k1 s = 0.
#[test]
fn barrel_distortion_ends_at_its_fold() {
    let k1 = -0.3_f64;
    let parameters = [345.0, 345.0, 170.0, 127.0, k1, 0.0, 0.0, 0.0];
    let camera = Camera::from_parameters(ModelKind::Radtan4, &parameters).unwrap();
    let fold = (-1.0 / (3.0 * k1)).sqrt();
    assert!(camera.project(&Vector3::new(fold * (1.0 - 1e-9), 0.0, 1.0)).is_some());
    assert_eq!(camera.project(&Vector3::new(fold * (1.0 + 1e-9), 0.0, 1.0)), None);
    let edge = 345.0 * fold * (1.0 + k1 * fold * fold);
    let inside = camera.unproject(&Vector2::new(170.0 + edge * 0.999, 127.0)).unwrap();
    assert!(inside.x / inside.z < fold);
    assert_eq!(camera.unproject(&Vector2::new(170.0 + edge * 1.001, 127.0)), None);
}

fn any_camera() -> impl Strategy<Value = Camera<f64>> {
    let coefficient = prop_oneof![Just(0.0), -0.01..0.01_f64, -0.5..0.5_f64];
    (0..ModelKind::ALL.len(), 80.0..900.0_f64, 0.9..1.1_f64, prop::collection::vec(coefficient, MAX_COEFFICIENTS))
        .prop_filter_map("not invertible at the axis", |(kind, focal, aspect, mut coefficients)| {
            let kind = ModelKind::ALL[kind];
            for (coefficient, name) in coefficients.iter_mut().zip(&kind.parameter_names()[4..]) {
                match *name {
                    "p1" | "p2" => *coefficient *= 0.1,
                    "alpha" => *coefficient = 0.5 + 1.4 * *coefficient,
                    "beta" => *coefficient += 1.0,
                    "xi" => *coefficient *= 3.0,
                    "w" => *coefficient = 5.0 * coefficient.abs(),
                    _ => {}
                }
            }
            coefficients.truncate(kind.parameter_names().len() - 4);
            let parameters: Vec<f64> = [focal, focal * aspect, 172.0, 131.0].into_iter().chain(coefficients).collect();
            Camera::from_parameters(kind, &parameters)
        })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]

    #[test]
    fn any_point_of_the_domain_is_recovered(
        camera in any_camera(),
        azimuth in 0.0..std::f64::consts::TAU,
        angle in 0.0..3.0_f64,
        distance in 0.1..100.0_f64,
    ) {
        let (sine, cosine) = angle.sin_cos();
        let bearing = Vector3::new(azimuth.cos() * sine, azimuth.sin() * sine, cosine);
        let Some(projection) = camera.project_with_jacobians(&(bearing * distance)) else { return Ok(()) };
        // Pixels per radian, in the direction with the least motion.
        let resolution = (projection.by_point * distance).singular_values().min();
        match camera.unproject(&projection.pixel) {
            Some(found) => {
                let tolerance = 1e-12 * (1.0 + projection.pixel.norm()) / resolution + 1e-12;
                prop_assert!((found - bearing).norm() < tolerance, "{camera:?} {bearing} {found} {resolution}");
            }
            None => prop_assert!(resolution < 0.05 * camera.parameters()[0], "{camera:?} {bearing} {resolution}"),
        }
    }

    #[test]
    fn unprojected_pixels_project_to_themselves(camera in any_camera(), x in -1000.0..1346.0_f64, y in -1000.0..1260.0_f64) {
        let pixel = Vector2::new(x, y);
        if let Some(bearing) = camera.unproject(&pixel) {
            let again = camera.project_with_jacobians(&bearing).unwrap();
            // A few roundings of the bearing, converted to pixels.
            let tolerance = 1e-14 * (again.by_point.norm() + pixel.norm());
            prop_assert!((again.pixel - pixel).norm() < tolerance, "{camera:?} {pixel} {again:?}");
        }
    }

    #[test]
    fn jacobians_of_any_camera_agree_with_central_differences(
        camera in any_camera(),
        x in 0.0..345.0_f64,
        y in 0.0..259.0_f64,
    ) {
        check_jacobians(&camera, &Vector2::new(x, y));
    }
}

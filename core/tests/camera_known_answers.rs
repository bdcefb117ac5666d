//! Wide camera models compared with published values, and with each other where one is a special case of another.

use evcal_core::camera::{Camera, ModelKind};
use nalgebra::{Vector2, Vector3};

/// Points in front of the camera, to its side, and behind it.
const POINTS: [[f64; 3]; 4] = [[0.3, -0.2, 1.0], [-1.1, 0.7, 0.5], [0.8, 0.9, -0.2], [0.0, -2.0, 0.1]];

fn camera(kind: ModelKind, parameters: &[f64]) -> Camera<f64> {
    Camera::from_parameters(kind, parameters).unwrap()
}

/// Returns points all around a camera.
fn directions() -> impl Iterator<Item = Vector3<f64>> {
    (0..60).flat_map(|step| {
        let angle = 0.05 * f64::from(step);
        (0..7).map(move |turn| {
            let azimuth = 0.9 * f64::from(turn);
            Vector3::new(azimuth.cos() * angle.sin(), azimuth.sin() * angle.sin(), angle.cos()) * (1.0 + 0.3 * angle)
        })
    })
}

/// Asserts that both cameras have the same pixels, and none at the same points.
fn assert_same(one: &Camera<f64>, other: &Camera<f64>) {
    let mut seen = 0;
    for point in directions() {
        match (one.project(&point), other.project(&point)) {
            (Some(a), Some(b)) => {
                seen += 1;
                assert!((a - b).norm() < 1e-10 * (1.0 + a.norm()), "{one:?} {other:?} {point} {a} {b}");
                let (a, b) = (one.unproject(&a).unwrap(), other.unproject(&a).unwrap());
                assert!((a - b).norm() < 1e-12, "{one:?} {other:?} {a} {b}");
            }
            (None, None) => {}
            (a, b) => panic!("{one:?} {other:?} {point}: {a:?} {b:?}"),
        }
    }
    assert!(seen > 150, "{seen}");
}

/// A model, its parameters, and the pixels of the points.
type Case = (ModelKind, &'static [f64], [[f64; 2]; 4]);

/// The formulas of Usenko et al. (3DV 2018) and of Devernay and Faugeras, exactly as published, evaluated with 40
/// digits (mpmath).
#[test]
fn pixels_agree_with_the_papers() {
    let cases: [Case; 4] = [
        (
            ModelKind::Ucm,
            &[190.5, 189.5, 171.25, 128.75, 0.65],
            [
                [226.15127254449826, 92.34128207460222],
                [-22.298279327029064, 251.270540456838],
                [381.91422242058525, 364.50317016949356],
                [171.25, -154.80020115683809],
            ],
        ),
        (
            ModelKind::Eucm,
            &[190.5, 189.5, 171.25, 128.75, 0.6, 1.1],
            [
                [226.1245147372042, 92.35902697217779],
                [-23.932028865940143, 252.30474172783087],
                [393.0186244927279, 376.93004532306264],
                [171.25, -162.78846153846155],
            ],
        ),
        (
            ModelKind::DoubleSphere,
            &[150.5, 149.5, 171.25, 128.75, -0.2, 0.6],
            [
                [225.34958278851474, 92.92325525190276],
                [-16.508006915241378, 247.4384652593175],
                [374.48434570983136, 355.86944530945027],
                [171.25, -144.74156722378123],
            ],
        ),
        (
            ModelKind::Fov,
            &[190.5, 189.5, 171.25, 128.75, 0.95],
            [
                [230.50182710380045, 89.45613740622858],
                [-34.11663919661062, 258.75183578826244],
                [401.84415826836556, 386.80665152670434],
                [171.25, -174.89326421477358],
            ],
        ),
    ];
    for (kind, parameters, pixels) in cases {
        let camera = camera(kind, parameters);
        for (point, pixel) in POINTS.into_iter().zip(pixels) {
            let (point, pixel) = (Vector3::from(point), Vector2::from(pixel));
            let found = camera.project(&point).unwrap();
            assert!((found - pixel).norm() < 1e-11, "{kind} {point} {found} {pixel}");
            assert!((camera.unproject(&pixel).unwrap() - point.normalize()).norm() < 1e-13, "{kind} {point}");
        }
    }
}

/// Results of `cv2.omnidir.projectPoints` of opencv-contrib-python 5.0.0 for these points: pixel, then for x and y the
/// derivatives with respect to the point, fx and cx (fy and cy), xi, k1, k2, p1, p2.
#[test]
fn omni_is_the_omnidir_of_opencv() {
    let parameters = [420.5, 419.5, 171.25, 128.75, 1.2, -0.15, 0.04, 0.0015, -0.0007];
    let camera = camera(ModelKind::Omni, &parameters);
    let pixels = [
        [226.44591409552726, 92.05111453485947],
        [-31.45313336159893, 257.5950132883464],
        [409.86733684449774, 397.4259245906915],
        [171.0620670278712, -178.60639799982414],
    ];
    #[rustfmt::skip]
    let derivatives = [
        [174.8440360399637, 6.161662389092602, -51.22087833417059, 0.13126257811064745, 1.0, -25.57632327982713,
         1.3916589398091983, 0.034936358638837824, -9.744256720065529, 25.172663193502615],
        [6.143770206457081, 179.44408059369619, 34.045685056802114, -0.08748244449377961, 1.0, 17.00016625281189,
         -0.9255662707094073, -0.023235517160511244, 17.011896467581703, -9.721083695760974],
        [92.24824690814991, 58.29560387971374, 121.33229776633047, -0.482052635818309, 1.0, 118.51088752972059,
         -76.34934200672791, -27.41906753271874, -136.7997117358572, 365.9836443842413],
        [58.295017985610734, 146.77548099910882, -77.23663383040856, 0.30713948340487823, 1.0, -75.44060562240347,
         48.470401643661546, 17.407002877489692, 237.50087854001083, -136.47438542970772],
        [152.2186310913405, -163.72278456726028, -127.87800618730901, 0.5674609675255594, 1.0, -194.29679153951838,
         241.08608584452838, 218.52724271552148, 378.52444382398573, 717.619258082973],
        [-164.4151580603655, 114.00777724148759, -144.62563465476754, 0.6404670431244136, 1.0, -219.74300058000645,
         270.57684812901806, 245.258503232001, 805.07395766511, 377.62426678754343],
        [154.24589234456036, 0.007958251333908603, 0.15916502667817187, -0.00044692740101972937, 1.0,
         0.300707762661458, 0.0, 0.0, 0.0, 268.47567446970885],
        [0.1874860447277765, 5.585671438109867, 111.7134287621972, -0.7326731775919527, 1.0, 211.05827029605555,
         -214.0131099807044, -136.64046146832246, 803.5116202618991, 0.0],
    ];
    for (index, (point, pixel)) in POINTS.into_iter().zip(pixels).enumerate() {
        let (point, pixel) = (Vector3::from(point), Vector2::from(pixel));
        let found = camera.project_with_jacobians(&point).unwrap();
        assert!((found.pixel - pixel).norm() < 1e-10, "{point} {} {pixel}", found.pixel);
        assert!((camera.unproject(&pixel).unwrap() - point.normalize()).norm() < 1e-12, "{point}");
        for row in 0..2 {
            let by_point = found.by_point.row(row);
            let by_parameter = found.by_parameters.row(row);
            // The columns of fx and cx in the first row, of fy and cy in the second; the other two are 0.
            let own = by_point
                .iter()
                .chain([&by_parameter[row], &by_parameter[2 + row]])
                .chain(by_parameter.iter().skip(4))
                .copied();
            for (column, (own, opencv)) in own.zip(derivatives[2 * index + row]).enumerate() {
                assert!((own - opencv).abs() < 1e-9 * (1.0 + opencv.abs()), "{point} {row} {column}: {own} {opencv}");
            }
            assert_eq!([by_parameter[1 - row], by_parameter[3 - row]], [0.0; 2]);
        }
    }
}

#[test]
fn special_cases_are_the_simpler_models() {
    for alpha in [-0.2, 0.0, 0.3, 0.5, 0.64, 0.9, 1.1] {
        let focal = [190.5, 189.5, 171.25, 128.75];
        let ucm = camera(ModelKind::Ucm, &[focal.as_slice(), &[alpha]].concat());
        assert_same(&ucm, &camera(ModelKind::Eucm, &[focal.as_slice(), &[alpha, 1.0]].concat()));
        assert_same(&ucm, &camera(ModelKind::DoubleSphere, &[focal.as_slice(), &[0.0, alpha]].concat()));
        // The limit of the distortion's disc excludes more than the limit of the image.
        if (0.5..1.0).contains(&alpha) {
            let xi = alpha / (1.0 - alpha);
            let longer = [190.5 * (1.0 + xi), 189.5 * (1.0 + xi), 171.25, 128.75];
            assert_same(&ucm, &camera(ModelKind::Omni, &[longer.as_slice(), &[xi, 0.0, 0.0, 0.0, 0.0]].concat()));
        }
    }
    // With alpha = 0 a double sphere camera has only one sphere.
    let first = camera(ModelKind::DoubleSphere, &[300.0, 310.0, 171.25, 128.75, 0.7, 0.0]);
    assert_same(&first, &camera(ModelKind::Omni, &[300.0, 310.0, 171.25, 128.75, 0.7, 0.0, 0.0, 0.0, 0.0]));
}

#[test]
fn without_distortion_all_are_pinhole_cameras() {
    let pinhole = camera(ModelKind::Radtan4, &[300.0, 310.0, 171.25, 128.75, 0.0, 0.0, 0.0, 0.0]);
    let zero: [(ModelKind, &[f64]); 5] = [
        (ModelKind::Ucm, &[0.0]),
        (ModelKind::Eucm, &[0.0, 1.7]),
        (ModelKind::DoubleSphere, &[0.0, 0.0]),
        (ModelKind::Fov, &[0.0]),
        (ModelKind::Omni, &[0.0; 5]),
    ];
    for (kind, coefficients) in zero {
        let straight = camera(kind, &[[300.0, 310.0, 171.25, 128.75].as_slice(), coefficients].concat());
        assert_same(&pinhole, &straight);
    }
}

/// Domains Z > -w d. The domain of the double sphere satisfies (ξ + c)² = w² (1 + 2 ξ c + ξ²) at its end, with c = Z /
/// d₁; for ξ ≥ 0 it contains the domain of the paper and of basalt.
#[test]
fn domains_end_as_the_formulas_predict() {
    let w = |alpha: f64| if alpha <= 0.5 { alpha / (1.0 - alpha) } else { (1.0 - alpha) / alpha };
    let at = |cosine: f64| Vector3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
    // For alpha ≤ ½ images near the end of the domain are infinitely far out.
    for alpha in [0.55, 0.6, 0.8, 0.95] {
        let w = w(alpha);
        let ucm = camera(ModelKind::Ucm, &[190.0, 190.0, 170.0, 130.0, alpha]);
        assert!(ucm.project(&at(-w + 1e-9)).is_some() && ucm.project(&at(-w - 1e-9)).is_none());
        for xi in [-0.7_f64, -0.2, 0.0, 0.4, 0.9] {
            let end = -xi * (1.0 - w * w) - w * (1.0 - xi * xi * (1.0 - w * w)).sqrt();
            let double = camera(ModelKind::DoubleSphere, &[190.0, 190.0, 170.0, 130.0, xi, alpha]);
            let (inside, outside) = (double.project(&at(end + 1e-9)), double.project(&at(end - 1e-9)));
            assert!(inside.is_some() && outside.is_none(), "{alpha} {xi}: {inside:?} {outside:?}");
            let paper = -(w + xi) / (2.0 * w * xi + xi * xi + 1.0).sqrt();
            if xi >= 0.0 {
                assert!(paper >= end - 1e-12 && double.project(&at(paper + 1e-9)).is_some(), "{alpha} {xi}");
            }
        }
    }
}

/// The field-of-view model changes as w² near w = 0.
#[test]
fn small_fields_of_view_are_smooth() {
    let point = Vector3::new(0.5, -0.3, 1.0);
    for w in [1e-7, 1e-5, 1.1e-4, 1.3e-4, 1e-3, 1e-2] {
        let camera = camera(ModelKind::Fov, &[300.0, 300.0, 170.0, 130.0, w]);
        let found = camera.project_with_jacobians(&point).unwrap();
        let square = 0.34_f64;
        let expected = 300.0 * 0.5 * (1.0 / 6.0 - 2.0 / 3.0 * square) * w;
        assert!((found.by_parameters[(0, 4)] - expected).abs() < 300.0 * (w * w * w + 1e-11), "{w}");
    }
    for refused in [-0.1, 3.15, 4.0] {
        assert!(Camera::from_parameters(ModelKind::Fov, &[300.0, 300.0, 170.0, 130.0, refused]).is_none());
    }
}

#[test]
fn invalid_parameters_are_rejected() {
    let refused = |kind, coefficients: &[f64]| {
        Camera::from_parameters(kind, &[[300.0, 300.0, 170.0, 130.0].as_slice(), coefficients].concat()).is_none()
    };
    assert!(refused(ModelKind::Eucm, &[0.5, 0.0]) && refused(ModelKind::Eucm, &[0.5, -1.0]));
    assert!(refused(ModelKind::DoubleSphere, &[-1.0, 0.5]));
    assert!(refused(ModelKind::Omni, &[-1.0, 0.0, 0.0, 0.0, 0.0]));
}

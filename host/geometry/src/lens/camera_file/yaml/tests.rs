use super::*;

fn values(file: CameraFile) -> (String, Vec<f64>, Sensor) {
    let CameraFile { sensor, camera } = file;
    (camera.model.clone(), camera.camera().unwrap().parameters().to_vec(), sensor)
}

fn read(text: &str) -> (String, Vec<f64>, Sensor) {
    values(parse(text).unwrap_or_else(|error| panic!("{text}: {error}")))
}

fn error(text: &str) -> String {
    parse(text).unwrap_err().to_string()
}

/// The form of `cv::FileStorage`.
const OPENCV: &str = "%YAML:1.0\n---\nimage_width: 346\nimage_height: 260\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   \
    cols: 3\n   dt: d\n   data: [ 250.5, 0., 172., 0., 251., 129.5, 0., 0., 1. ]\ndistortion_coefficients: !!opencv-matrix\n   \
    rows: 1\n   cols: 5\n   dt: d\n   data: [ -3.5e-01, 1.2e-01, 1.0e-03, -2.0e-03,\n       4.0e-02 ]\n";

const COEFFICIENTS: &str = "-3.5e-01, 1.2e-01, 1.0e-03, -2.0e-03,\n       4.0e-02";

/// Returns [`OPENCV`] with other coefficients and more lines.
fn opencv(coefficients: &str, more: &str) -> String {
    OPENCV.replace(COEFFICIENTS, coefficients) + more
}

#[test]
fn the_files_of_opencv_ros_and_kalibr_are_cameras() {
    let parameters = vec![250.5, 251.0, 172.0, 129.5, -0.35, 0.12, 0.001, -0.002, 0.04];
    assert_eq!(read(OPENCV), ("radtan".to_owned(), parameters, Sensor::new(346, 260)));
    let ros = "image_width: 640\nimage_height: 480\ncamera_name: dvs\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
        data: [300, 0, 320, 0, 301, 240, 0, 0, 1]\ndistortion_model: equidistant\ndistortion_coefficients:\n  rows: 1\n  \
        cols: 4\n  data: [0.1, 0.02, 0, -0.003]\n";
    let parameters = vec![300.0, 301.0, 320.0, 240.0, 0.1, 0.02, 0.0, -0.003];
    assert_eq!(read(ros), ("kannala-brandt".to_owned(), parameters, Sensor::new(640, 480)));
    let kalibr = "cam0:\n  camera_model: ds\n  intrinsics: [-0.2, 0.6, 157.0, 158.0, 172.0, 129.0]\n  \
        distortion_model: none\n  distortion_coeffs: []\n  resolution: [346, 260]\n  rostopic: /dvs\n";
    let parameters = vec![157.0, 158.0, 172.0, 129.0, -0.2, 0.6];
    assert_eq!(read(kalibr), ("double-sphere".to_owned(), parameters, Sensor::new(346, 260)));
}

/// OpenCV's samples write `fisheye_model` and `xi` without the name of a model. Both were read as `radtan4`: 53 and 90 px.
#[test]
fn a_fisheye_and_an_omnidirectional_camera_of_opencv_are_recognised() {
    let matrix = [250.5, 251.0, 172.0, 129.5];
    let read = |coefficients: &str, more: &str| {
        let (model, parameters, _) = read(&opencv(coefficients, more));
        assert_eq!(parameters[..4], matrix);
        (model, parameters[4..].to_vec())
    };
    let four = "0.1, 0.02, -0.003, 4.e-04";
    let (radtan4, fisheye) = ("radtan4".to_owned(), "kannala-brandt".to_owned());
    let values = vec![0.1, 0.02, -0.003, 4e-4];
    assert_eq!(read(four, "fisheye_model: 1\n"), (fisheye.clone(), values.clone()));
    assert_eq!(read(four, "fisheye_model: 0\n"), (radtan4.clone(), values.clone()));
    assert_eq!(read(four, "distortion_model: \"fisheye\"\n"), (fisheye.clone(), values.clone()));
    assert_eq!(read(four, "distortion_model: \"radtan\"\nfisheye_model: 0\n"), (radtan4, values.clone()));
    let omni = ("omni".to_owned(), [&[0.9], values.as_slice()].concat());
    assert_eq!(read(four, "xi: 0.9\n"), omni);
    assert_eq!(read(four, "xi: !!opencv-matrix\n   rows: 1\n   cols: 1\n   dt: d\n   data: [ 0.9 ]\n"), omni);
    assert_eq!(read(four, "distortion_model: omnidir\nxi: 0.9\n"), omni);
    for (more, part) in [
        ("", "add the line distortion_model"),
        ("fisheye_model: 1\nxi: 0.9\n", "fisheye_model = 1 and xi = a number contradict"),
        ("distortion_model: radtan\nfisheye_model: 1\n", "distortion_model = radtan and fisheye_model = 1 contradict"),
        ("distortion_model: plumb_bob\nxi: 0.9\n", "contradict"),
        ("fisheye_model: 2\n", "fisheye_model = 2"),
        ("fisheye_model: perhaps\n", "fisheye_model = an unknown value"),
        ("distortion_model: omnidir\n", "has no xi"),
        ("xi: many\n", "xi in numbers"),
        ("distortion_model: thin_prism_fisheye\n", "thin_prism_fisheye of 4"),
    ] {
        let error = error(&opencv(four, more));
        assert!(error.contains(part), "{more}: {error}");
    }
    for (coefficients, more, part) in [
        (COEFFICIENTS, "fisheye_model: 1\n", "fisheye of 5"),
        (COEFFICIENTS, "xi: 0.9\n", "omnidir of 5"),
        ("0.1, 0.02", "", "radtan of 2"),
    ] {
        let error = error(&opencv(coefficients, more));
        assert!(error.contains(part), "{more}: {error}");
    }
}

/// A skew and a third row other than 0 0 1 were ignored.
#[test]
fn a_matrix_that_is_more_than_focal_lengths_and_centre_is_rejected_by_name() {
    let with = |matrix: &str| OPENCV.replace("250.5, 0., 172., 0., 251., 129.5, 0., 0., 1.", matrix);
    for (matrix, part) in [
        ("250.5, -3., 172., 0., 251., 129.5, 0., 0., 1.", "a skew of -3 px"),
        ("250.5, 1e-4, 172., 0., 251., 129.5, 0., 0., 1.", "a skew of 0.0001 px"),
        ("250.5, 0., 172., 0.2, 251., 129.5, 0., 0., 1.", "0.2 below fx"),
        ("250.5, 0., 172., 0., 251., 129.5, 1e-3, 0., 1.", "0.001 0 1 as third row"),
        ("250.5, 0., 172., 0., 251., 129.5, 0., -1e-6, 1.", "as third row"),
        ("501., 0., 344., 0., 502., 259., 0., 0., 2.", "0 0 2 as third row"),
        ("250.5, 0., 172., 0., 251., 129.5", "camera matrix of 9 numbers"),
        ("250.5, .Nan, 172., 0., 251., 129.5, 0., 0., 1.", "camera_matrix with data"),
    ] {
        assert!(error(&with(matrix)).contains(part), "{matrix}: {}", error(&with(matrix)));
    }
    // Rounding errors of a product of matrices.
    let rounded = with("250.5, 2.8e-14, 172., -1e-13, 251., 129.5, 1e-18, 0., 1.0000000000000002");
    assert_eq!(read(&rounded), read(OPENCV));
}

/// `calibrateCamera` returns 14 numbers for its rational model, six of them 0.
#[test]
fn twelve_and_fourteen_coefficients_are_eight_if_the_others_are_zero() {
    let eight = "0.5, 0.1, 1e-3, -2e-3, 0.02, 0.8, 0.3, 0.05";
    let expected = read(&opencv(eight, ""));
    assert_eq!((expected.0.as_str(), expected.1[11]), ("radtan8", 0.05));
    for zeros in [", 0., 0., 0., 0.", ", 0., 0., -0., 0., 0., 0."] {
        assert_eq!(read(&opencv(&format!("{eight}{zeros}"), "")), expected);
        let ros = format!(
            "image_width: 346\nimage_height: 260\ncamera_matrix:\n  rows: 3\n  cols: 3\n  \
             data: [250.5, 0, 172, 0, 251, 129.5, 0, 0, 1]\ndistortion_model: rational_polynomial\ndistortion_coefficients:\n  \
             rows: 1\n  cols: 12\n  data: [{eight}{zeros}]\n"
        );
        assert_eq!(read(&ros), expected);
    }
    let mrcal = |count: u8, more: &str| {
        format!(
            "{{\n 'lensmodel': 'LENSMODEL_OPENCV{count}',\n 'intrinsics': [ 250.5, 251, 172, 129.5, {eight}{more},],\n \
             'rt_cam_ref': [ 0, 0, 0, 0, 0, 0,],\n 'imagersize': [ 346, 260,],\n}}\n"
        )
    };
    assert_eq!(read(&mrcal(12, ", 0, 0, 0, 0")), expected);
    assert!(error(&mrcal(12, ", 0, 0, 1e-9, 0")).contains("thin prism or a tilted sensor (s3 = 0.000000001)"));
    // The name states another number than there is.
    assert!(error(&mrcal(12, "")).contains("LENSMODEL_OPENCV12"));
    for (more, part) in [
        (", 0., 2e-3, 0., 0.", "(s2 = 0.002)"),
        (", 0., 0., 0., 0., 0., -0.01", "(tau_y = -0.01)"),
        (", 0., 0.", "of 10 coefficients"),
    ] {
        let error = error(&opencv(&format!("{eight}{more}"), ""));
        assert!(error.contains(part), "{more}: {error}");
    }
}

#[test]
fn cameras_without_distortion_have_zeros() {
    let size = Sensor::new(346, 260);
    let kalibr = |model: &str, distortion: &str, intrinsics: &str| {
        format!(
            "cam0:\n  cam_overlaps: []\n  camera_model: {model}\n  distortion_coeffs: {distortion}\n  intrinsics: {intrinsics}\n  \
             resolution: [346, 260]\n"
        )
    };
    let none = "[]\n  distortion_model: none";
    let pinhole = vec![330.0, 331.0, 172.5, 129.5, 0.0, 0.0, 0.0, 0.0];
    let radtan4 = ("radtan4".to_owned(), pinhole.clone(), size);
    assert_eq!(read(&kalibr("pinhole", none, "[330.0, 331.0, 172.5, 129.5]")), radtan4);
    let omni = vec![630.0, 631.0, 172.5, 129.5, 0.9, 0.0, 0.0, 0.0, 0.0];
    assert_eq!(read(&kalibr("omni", none, "[0.9, 630.0, 631.0, 172.5, 129.5]")), ("omni".to_owned(), omni, size));
    let equidistant = "[-0.1, 0.02, 0.001, 0.002]\n  distortion_model: equidistant";
    let refused = error(&kalibr("omni", equidistant, "[0.9, 630.0, 631.0, 172.5, 129.5]"));
    assert_eq!(refused, "evcal has no model omni with distortion equidistant of 4 coefficients");
    assert!(error(&kalibr("pinhole", "[0.1]\n  distortion_model: none", "[1.0, 1.0, 1.0, 1.0]")).contains("none of 1"));
    let basalt = r#"{"value0": {"intrinsics": [{"camera_type": "pinhole", "intrinsics": {"fx": 330.0, "fy": 331.0, "cx": 172.5,
        "cy": 129.5}}], "resolution": [[346, 260]]}}"#;
    assert_eq!(values(parse_json(basalt).unwrap()), radtan4);
    let mrcal = "{\n    'lensmodel':  'LENSMODEL_PINHOLE',\n\n    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....\n    \
        'intrinsics': [ 330, 331, 172.5, 129.5,],\n    'extrinsics': [ 0, 0, 0, 0, 0, 0,],\n    'imagersize': [ 346, 260,],\n}\n";
    assert_eq!(read(mrcal), radtan4);
    let dv = r#"{"version": "2.0", "cameras": {"C0": {"resolution": ["346", "260"], "principalPoint": ["172.5", "129.5"],
        "focalLength": ["330", "331"], "distortionCoefficients": "", "distortionModel": "none"}}}"#;
    assert_eq!(values(parse_json(dv).unwrap()), radtan4);
}

#[test]
fn messages_of_ros_sensors_of_euroc_and_eight_coefficients_of_basalt_are_cameras() {
    let message = |d: &str, k: &str, more: &str| {
        format!(
            "header:\n  stamp:\n    sec: 0\n    nanosec: 0\n  frame_id: camera\nheight: 260\nwidth: 346\n\
             distortion_model: rational_polynomial\n{d}:\n- 0.5\n- 0.1\n- 0.001\n- -0.002\n- 0.02\n- 0.8\n- 0.3\n- 0.05\n\
             {k}: [250.5, 0.0, 172.0, 0.0, 251.0, 129.5, 0.0, 0.0, 1.0]\n{more}"
        )
    };
    let expected = read(&opencv("0.5, 0.1, 1e-3, -2e-3, 0.02, 0.8, 0.3, 0.05", ""));
    let whole = "binning_x: 0\nbinning_y: 1\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n---\n";
    assert_eq!(read(&message("d", "k", whole)), expected);
    assert_eq!(read(&message("D", "K", "roi:\n  x_offset: 0\n  y_offset: 0\n  height: 260\n  width: 346\n")), expected);
    for (more, part) in [
        ("binning_x: 2\nbinning_y: 2\n", "binned pixels (binning_x = 2)"),
        ("roi:\n  x_offset: 0\n  y_offset: 0\n  height: 130\n  width: 346\n", "region of interest"),
        ("roi:\n  x_offset: 10\n", "region of interest"),
    ] {
        assert!(error(&message("d", "k", more)).contains(part), "{more}: {}", error(&message("d", "k", more)));
    }
    let euroc = "%YAML:1.0\n# General sensor definitions.\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: [1.0]\n\
        rate_hz: 20\nresolution: [752, 480]\ncamera_model: pinhole\nintrinsics: [458.6, 457.3, 367.2, 248.4] #fu, fv, cu, cv\n\
        distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]\n";
    let parameters = vec![458.6, 457.3, 367.2, 248.4, -0.28, 0.07, 0.0002, 1.8e-5];
    assert_eq!(read(euroc), ("radtan4".to_owned(), parameters, Sensor::new(752, 480)));
    assert!(error(&euroc.replace("1.8e-05", "1.8e-05, 0.1")).contains("radial-tangential of 5"));
    let basalt = r#"{"value0": {"T_imu_cam": [], "intrinsics": [{"camera_type": "pinhole-radtan8", "intrinsics": {"fx": 250.5,
        "fy": 251, "cx": 172, "cy": 129.5, "k1": 0.5, "k2": 0.1, "p1": 1e-3, "p2": -2e-3, "k3": 0.02, "k4": 0.8, "k5": 0.3, "k6": 0.05,
        "rpmax": 2.7}}], "resolution": [[346, 260]]}}"#;
    assert_eq!(values(parse_json(basalt).unwrap()), expected);
    assert_eq!(values(parse_json(&basalt.replace(r#", "rpmax": 2.7"#, "").replace("\n", "")).unwrap()), expected);
}

/// mrcal's own files contain its observations as a Python literal.
#[test]
fn the_observations_in_a_file_of_mrcal_are_left_out() {
    let base85 = "P)h>@6aWAK2mk;8Apou;fc=sH0077U000gE6aZ;%baH8Kb7^C9E^csn0RRvH$N&HU{|}~`_^?!#%&()*+-<=";
    let file = |inputs: &str| {
        format!(
            "{{\n    'lensmodel':  'LENSMODEL_OPENCV4',\n    # comment\n    'intrinsics': [ 332.1, 332.6, 172.7, 129.3, -0.33, 0.09, \
             -5.3e-05, -7.9e-05,],\n    'rt_cam_ref': [ 0, 0, 0, 0, 0, 0,],\n    'imagersize': [ 346, 260,],\n    \
             'icam_intrinsics': 0,\n\n    # The optimization inputs contain all the data used to compute this model.\n{inputs}}}\n"
        )
    };
    let expected = read(&file(""));
    assert_eq!(expected.1[7], -7.9e-5);
    for text in [base85.to_owned(), base85.repeat(20_000)] {
        assert_eq!(read(&file(&format!("    'optimization_inputs': b'{text}',\n\n"))), expected);
    }
    assert!(error(&file(&format!("    'optimization_inputs': b'{base85}"))).contains("cannot be read"));
}

#[test]
fn missing_parts_are_named() {
    for (text, part) in [
        ("a: 1\n", "not a camera of OpenCV or ROS"),
        ("", "not a camera of OpenCV or ROS"),
        ("a: [1, 2\n", "cannot be read as JSON or YAML"),
        (&OPENCV.replace("image_width: 346\n", ""), "size of the image"),
        (&OPENCV.replace("distortion_coefficients", "other"), "distortion_coefficients"),
        (&OPENCV.replace("-2.0e-03,\n       4.0e-02", "0, 0, 0"), "of 6 coefficients"),
        (&OPENCV.replace("250.5", "-250.5"), "parameters that its model takes"),
        ("cam0: {intrinsics: [1], camera_model: ds}\n", "intrinsics of its model"),
        ("value0: {intrinsics: [{camera_type: ds, intrinsics: {fx: 1}}]}\n", "intrinsics of its model"),
        ("value0: {}\n", "camera_type"),
        ("cameras: {}\n", "focalLength"),
        ("lensmodel: LENSMODEL_SPLINED_STEREOGRAPHIC\nintrinsics: [1, 1, 1, 1]\n", "LENSMODEL_SPLINED"),
    ] {
        let error = parse(text).unwrap_err().to_string();
        assert!(error.contains(part), "{text}: {error}");
    }
}

/// The causes were hidden: a large file was "not a camera".
#[test]
fn excessive_size_nesting_and_repetition_are_rejected_by_name() {
    let bomb: String =
        (1..20).map(|level| format!("a{level}: &a{level} [{}]\n", format!("*a{},", level - 1).repeat(9))).collect();
    assert_eq!(parse(&format!("a0: &a0 1\n{bomb}")), Err(YamlError::NoYaml(LoadError::Repeats)));
    for nested in ["[", "{a: ", "- ", "? "] {
        assert!(parse(&nested.repeat((1 << 16) / nested.len())).is_err());
    }
    // The points of 60 views, as the calibration sample writes them, and far more than that.
    let points = |count: usize| {
        format!(
            "{OPENCV}image_points: !!opencv-matrix\n   rows: 60\n   cols: 54\n   dt: \"2f\"\n   data: [ {} ]\n",
            "1.23456e+02, ".repeat(count)
        )
    };
    assert_eq!(read(&points(6480)), read(OPENCV));
    assert_eq!(parse(&points(400_000)), Err(YamlError::NoYaml(LoadError::TooLong(LARGEST))));
    assert!(error(&points(400_000)).ends_with("it has more than 4194304 bytes"));
    for text in [format!("<a>{}</a>", " ".repeat(LARGEST)), format!("{{{}}}", " ".repeat(LARGEST))] {
        let parse = if text.starts_with('<') { parse_xml } else { parse_json };
        assert_eq!(parse(&text), Err(YamlError::NoYaml(LoadError::TooLong(LARGEST))));
    }
}

#[test]
fn truncated_files_do_not_panic() {
    for end in 0..OPENCV.len() {
        let _ = parse(&OPENCV[..end]);
    }
}

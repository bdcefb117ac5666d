//! Cameras that a command cannot use are refused with the reason, before anything large is made.

use std::fs;
use std::path::Path;

use super::command::{evcal, fail, stderr, succeed, text};

fn camera(sensor: [u16; 2], fx: f64) -> String {
    let [width, height] = sensor;
    format!(
        r#"{{"sensor": {{"width": {width}, "height": {height}}}, "camera": {{"model": "radtan4", "parameters": {{"fx": {fx:e}, "fy": 250.3, "cx": 172.5, "cy": 129.8, "k1": -0.3, "k2": 0.1, "p1": 0.0, "p2": 0.0}}}}}}"#
    )
}

/// Maps of 34 GB were made before the sizes were compared.
#[test]
fn the_size_of_the_sensor_is_compared_before_tables_are_made() {
    let folder = tempfile::tempdir().unwrap();
    let put = |name: &str, content: &str| {
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        path
    };
    let huge = put("huge.json", &camera([32767, 32767], 250.0));
    let known = put("known.csv", "# sensor 346 x 260\nt_us,x,y,p\n1,2,3,1\n2,3,4,0\n");
    let unknown = put("unknown.csv", "t_us,x,y,p\n1,2,3,1\n2,3,4,0\n");
    let output = folder.path().join("out.csv");
    let undistort = |input: &Path| fail(&["undistort", text(input), "-c", text(&huge), "-o", text(&output)]);
    let differ = undistort(&known);
    assert!(
        differ.contains("of a sensor with 346 x 260 pixels, the calibration of one with 32767 x 32767"),
        "{differ}"
    );
    let large = undistort(&unknown);
    assert!(large.contains("at most 8388608 can be undistorted"), "{large}");
    let header = folder.path().join("table.h");
    let table = fail(&["export", text(&huge), "--c-header", text(&header)]);
    assert!(table.contains("tables are for sensors of up to 16777216"), "{table}");
    assert!(!output.exists() && !header.exists());
}

/// One column of the grid was enough for "the same camera".
#[test]
fn a_camera_that_sees_almost_nothing_is_not_the_same_camera() {
    let folder = tempfile::tempdir().unwrap();
    let [tiny, other] = [("tiny.json", 1e-308), ("other.json", 250.1)].map(|(name, fx)| {
        let path = folder.path().join(name);
        fs::write(&path, camera([346, 260], fx)).unwrap();
        path
    });
    let error = fail(&["compare", text(&tiny), text(&other)]);
    assert!(error.contains("of 2806 points of the sensor, a quarter is needed"), "{error}");
}

/// A skew was dropped, and a dictionary of mrcal that evcal cannot use was "not JSON".
#[test]
fn the_reason_is_the_files_own() {
    let folder = tempfile::tempdir().unwrap();
    let opencv = "%YAML:1.0\n---\nimage_width: 346\nimage_height: 260\ndistortion_model: \"fisheye\"\ncamera_matrix: !!opencv-matrix\n   \
        rows: 3\n   cols: 3\n   dt: d\n   data: [ 200., -2.5, 172., 0., 201., 129.5, 0., 0., 1. ]\n\
        distortion_coefficients: !!opencv-matrix\n   rows: 4\n   cols: 1\n   dt: d\n   data: [ 0.01, 0.02, -0.003, 5e-4 ]\n";
    let mrcal = "{\n    'lensmodel':  'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=30_Ny=20_fov_x_deg=120',\n    \
        'intrinsics': [ 330, 331, 172.5, 129.5, 0.1,],\n    'imagersize': [ 346, 260,],\n}\n";
    let cut = "{\n    'lensmodel':  'LENSMODEL_OPENCV5',\n    'intrinsics': [ 332.1, 332.6";
    let json = r#"{"sensor": {"width": 346, "height": 260}, "camera": {"#;
    for (name, content, part) in [
        ("skew.yml", opencv, "cannot use: evcal has no camera with a skew of -2.5 px"),
        ("splined.cameramodel", mrcal, "evcal has no model LENSMODEL_SPLINED_STEREOGRAPHIC_order=3"),
        ("cut.cameramodel", cut, "cannot be read as JSON or YAML"),
        ("cut.json", json, "EOF while parsing"),
    ] {
        let path = folder.path().join(name);
        fs::write(&path, content).unwrap();
        let error = fail(&["export", text(&path), "--format", "csv"]);
        assert!(error.contains(part), "{name}: {error}");
    }
}

/// Files of an earlier export were left next to new ones when one of the new ones could not be written.
#[test]
fn an_export_that_cannot_be_completed_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let calibration = folder.path().join("camera.json");
    fs::write(&calibration, camera([346, 260], 250.0)).unwrap();
    let exports = folder.path().join("exports");
    let export = |name: &str| {
        evcal(&[
            "export",
            text(&calibration),
            "--format",
            "all",
            "-o",
            text(&exports),
            "--force",
            "--camera-name",
            name,
        ])
    };
    assert!(export("first").status.success());
    let content = || {
        let mut files: Vec<_> = fs::read_dir(&exports).unwrap().map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files.into_iter().map(|file| (fs::read(&file).unwrap_or_default(), file)).collect::<Vec<_>>()
    };
    // The last file has no place: a folder has its name.
    let last = exports.join("svo-camera.yaml");
    fs::remove_file(&last).unwrap();
    fs::create_dir(&last).unwrap();
    let before = content();
    let refused = export("second");
    assert!(!refused.status.success() && stderr(&refused).contains("svo-camera.yaml"), "{}", stderr(&refused));
    assert_eq!(content(), before);
    fs::remove_dir(&last).unwrap();
    assert!(export("second").status.success());
    assert!(fs::read_to_string(&last).unwrap().contains("\"second\""));
    // A file that the user put there stays; a file of an export that the camera does not have goes.
    let [own, stale] = ["mine.txt", "stereo-2.yaml"].map(|name| exports.join(name));
    fs::write(&own, "mine").unwrap();
    fs::write(&stale, "of another camera").unwrap();
    assert!(export("third").status.success());
    assert!(own.exists() && !stale.exists());
    succeed(&["export", text(&exports.join("camera.yaml")), "--format", "csv"]);
}

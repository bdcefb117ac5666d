//! Two simulated cameras on one mount; the second records events or frames. Its pose and clock are estimated correctly, and
//! wrong input is rejected.

use std::fs;
use std::fs::File;
use std::path::{Path, PathBuf};

use evcal_tests::values::{numbers, pose};
use evcal_tests::{BOARD, evcal, made, read_json, session, text};
use event_recordings::encode::Description;
use event_recordings::extras::{Extra, Frame, OtherStreams};
use event_recordings::image_folder::Stamps;
use event_recordings::images::Images;
use event_recordings::ros::BAG_FORMAT;
use event_recordings::{Damage, Recording, RecordingOptions};
use nalgebra::Vector3;
use serde_json::Value;

fn simulation() -> PathBuf {
    made(
        "second-camera",
        &["simulate", "--board", BOARD, "--motion", "fast", "--duration", "9s", "--seed", "32", "--second-camera"],
    )
}

fn calibration() -> PathBuf {
    let folder = simulation();
    let (first, second) = (folder.join("events.aedat4"), folder.join("second.aedat4"));
    made("second-camera-calibrated", &["calibrate", text(&first), "--with", text(&second), "--board", BOARD])
}

/// Checks that the transform is within `metres` and 0.02° of the truth and within 4.5 σ, and that σ is below these bounds.
fn check_transform(found: &Value, truth: &Value, metres: f64) {
    let (is, was) = (pose(&found["T_second_first"]), pose(&truth["T_second_first"]));
    let moved = is.translation.vector - was.translation.vector;
    let turned = (was.rotation.inverse() * is.rotation).scaled_axis();
    let bounds = [("translation_sigma", moved, metres), ("rotation_sigma", turned, 0.02f64.to_radians())];
    for (name, error, bound) in bounds {
        let sigma = Vector3::from_vec(numbers(&found[name]));
        assert!(error.norm() < bound && sigma.amax() < bound, "{name}: off by {error}, σ {sigma}");
        assert!(error.component_div(&sigma).amax() < 4.5, "{name}: off by {error}, σ {sigma}");
    }
}

/// Returns the true clock offset at the time of the estimated one: t_second = clock_offset + t_first (1 + drift).
fn clock_offset(found: &Value, truth: &Value) -> f64 {
    let settings = &truth["settings"];
    let rate = 1e-6 * numbers(&settings["clock_drift"])[0];
    let at = numbers(&found["time_offset_at"])[0];
    at - (at - numbers(&settings["clock_offset"])[0]) / (1.0 + rate)
}

/// Returns the error of the estimated clock offset against `offset`, and its σ (s).
fn offset_error(found: &Value, offset: f64) -> (f64, f64) {
    let of = |name| numbers(&found["time_offset"][name])[0];
    (of("value") - offset, of("sigma"))
}

#[test]
fn the_pose_of_the_second_camera_is_estimated_correctly() {
    let truth = &read_json(&simulation().join("truth.json"))["second_camera"];
    let found = &read_json(&calibration().join("calibration.json"))["second_cameras"][0];
    check_transform(found, truth, 2e-4);
    let read = read_json(&calibration().join("calibration.json"))["input_files"].clone();
    for (index, name) in ["events.aedat4", "second.aedat4"].iter().enumerate() {
        let file = simulation().join(name);
        assert_eq!(read[index]["path"], text(&file));
        assert_eq!(read[index]["bytes"], fs::metadata(&file).unwrap().len());
    }
    // Both cameras have the same pixel latency.
    let (error, sigma) = offset_error(found, clock_offset(found, truth));
    assert!(error.abs() < 4.5 * sigma && error.abs() < 6e-5 && sigma < 6e-5, "{error} ± {sigma}");
    assert!(found["clock_rate"].is_null(), "9 s are too short to state it");
    // The second camera has another lens.
    let focal = |camera: &Value| numbers(&camera["parameters"]["fx"])[0];
    let (lens, was) = (focal(&found["solved_together"][1]["camera"]), focal(&truth["camera"]));
    assert!((lens - was).abs() < 0.3, "{lens} {was}");
}

#[test]
fn the_result_is_in_the_summary_and_the_files() {
    let folder = calibration();
    let report = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(
        report.contains("Second camera</h2>")
            && report.contains("t_second − t_first (s)</th><td class=\"number\" colspan=\"3\">3.21")
    );
    let files = ["camchain-cameras.yaml", "stereo.yaml", "static_transforms.yaml"];
    for name in files {
        assert!(folder.join("exports").join(name).exists() && report.contains(name), "{name}");
    }
}

/// With both lenses fixed to the truth, the transform is at least as accurate.
#[test]
fn intrinsics_can_be_fixed() {
    let folder = simulation();
    let (first, second) = (folder.join("events.aedat4"), folder.join("second.aedat4"));
    let truth = &read_json(&folder.join("truth.json"));
    let lens = folder.join("second-lens.json");
    let of_second = &truth["second_camera"];
    let sensor = &truth["sensor"];
    fs::write(&lens, serde_json::json!({ "sensor": sensor, "camera": of_second["camera"] }).to_string()).unwrap();
    let fixed = ["--camera", text(&folder), "--with-camera", text(&lens)];
    let scratch = tempfile::tempdir().unwrap();
    let result = scratch.path().join("result");
    let options = ["--board", BOARD, "-o", text(&result)];
    let finished = evcal(&[&["calibrate", text(&first), "--with", text(&second)], &fixed[..], &options[..]].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    // The ground truth has no σ.
    assert_eq!(finished.messages().len(), 2, "{}", finished.stderr);
    assert!(
        finished.messages().iter().all(|line| line.contains("contains no σ of the intrinsics")),
        "{}",
        finished.stderr
    );
    let found = &read_json(&result.join("calibration.json"))["second_cameras"][0];
    assert_eq!(found["fixed"], serde_json::json!([true, true]));
    for (solved, was) in [(0, &truth["camera"]), (1, &of_second["camera"])] {
        assert_eq!(&found["solved_together"][solved]["camera"], was);
    }
    let (is, was) = (pose(&found["T_second_first"]), pose(&of_second["T_second_first"]));
    let error = is.translation.vector - was.translation.vector;
    let sigma = Vector3::from_vec(numbers(&found["translation_sigma"]));
    assert!(error.norm() < 2e-4 && error.component_div(&sigma).amax() < 4.5, "off by {error}, σ {sigma}");
    let joint = &read_json(&calibration().join("calibration.json"))["second_cameras"][0];
    let free = Vector3::from_vec(numbers(&joint["translation_sigma"]));
    assert!(sigma.norm() < 1.1 * free.norm(), "{sigma} {free}");

    let other = scratch.path().join("other");
    let rejected = |words: &str, arguments: &[&str]| {
        let options = ["--board", BOARD, "-o", text(&other)];
        let finished = evcal(&[&["calibrate", text(&first)], arguments, &options].concat());
        assert_ne!(finished.code, Some(0));
        assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
    };
    rejected("--camera works only together with --imu, --with or --with-frames", &["--camera", text(&folder)]);
    rejected(
        "there are more --with-camera than --with",
        &["--with", text(&second), "--with-camera", "a", "--with-camera", "b"],
    );
}

#[test]
fn wrong_second_recordings_are_rejected() {
    let folder = simulation();
    let (first, second) = (folder.join("events.aedat4"), folder.join("second.aedat4"));
    let scratch = tempfile::tempdir().unwrap();
    let rejected = |words: &str, arguments: &[&str]| {
        let result = scratch.path().join(words.replace([' ', ':'], "-"));
        let options = ["--board", BOARD, "--accept-any", "-o", text(&result)];
        let finished = evcal(&[&["calibrate"], arguments, &options].concat());
        assert_eq!(finished.code, Some(1), "{}", finished.stderr);
        assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
        result
    };
    rejected("a camera that was already given", &[text(&first), "--with", text(&first)]);
    rejected("give one recording before --with", &[text(&first), text(&second), "--with", text(&second)]);
    // Recognised by its events, not by its name; the first camera is calibrated nevertheless.
    let session = session().join("events.dvraw");
    let copy = scratch.path().join("copy.dvraw");
    fs::copy(&session, &copy).unwrap();
    let result = rejected("already given; give the recording", &[text(&session), "--with", text(&copy)]);
    assert!(result.join("calibration.json").exists());
    let other = made(
        "second-camera-other",
        &["simulate", "--board", BOARD, "--motion", "fast", "--duration", "3s", "--seed", "33"],
    );
    let other = other.join("events.aedat4");
    rejected("recordings of the same session", &[text(&session), "--with", text(&other)]);
}

/// Event pixels without latency, so that the offset contains only the difference of the clocks.
const FRAMES: [&str; 11] =
    ["simulate", "--board", BOARD, "--motion", "fast", "--duration", "5s", "--seed", "41", "--light", "ideal"];

pub(crate) fn frame_simulation() -> PathBuf {
    made("second-frames", &[&FRAMES[..], &["--second-frames"]].concat())
}

fn rolling_simulation() -> PathBuf {
    let settings = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/calibration/rolling-shutter.json");
    made("second-rolling", &[&FRAMES[..], &["--second-camera", text(&settings)]].concat())
}

fn calibrated_with_frames(name: &str, simulation: &Path, options: &[&str]) -> PathBuf {
    let (first, second) = (simulation.join("events.aedat4"), simulation.join("second"));
    made(name, &[&["calibrate", text(&first), "--with", text(&second), "--board", BOARD], options].concat())
}

/// Checks that the transform is within 0.02°, 0.5 mm and 4.5 σ of the truth, and the offset within 0.1 ms.
fn check_frame_camera(found: &Value, truth: &Value, line_delay: f64) {
    check_transform(found, truth, 5e-4);
    // The timestamps are of the first row, whereas the offset refers to the middle row, which is exposed later.
    let rows = 0.5 * (numbers(&found["sensor"]["height"])[0] - 1.0);
    let (error, sigma) = offset_error(found, clock_offset(found, truth) - line_delay * rows);
    assert!(error.abs() < 1e-4 && sigma < 1e-4, "{error} ± {sigma}");
}

#[test]
fn the_pose_of_a_frame_camera_is_estimated_correctly() {
    let simulation = frame_simulation();
    let folder = calibrated_with_frames("second-frames-calibrated", &simulation, &[]);
    let found = &read_json(&folder.join("calibration.json"))["second_cameras"][0];
    let truth = &read_json(&simulation.join("truth.json"))["second_camera"];
    check_frame_camera(found, truth, 0.0);
    let frames = &found["frames"];
    let delay = numbers(&frames["line_delay"]["value"])[0];
    assert!(delay.abs() < 3.0 * numbers(&frames["line_delay"]["sigma"])[0] && delay.abs() < 2e-7, "{frames}");
    assert_eq!((&frames["stamps"], &frames["exposure_known"]), (&"middle".into(), &false.into()));
    assert!(found["from_identity"].is_null());
    let focal = |camera: &Value| numbers(&camera["parameters"]["fx"])[0];
    let (lens, was) = (focal(&found["solved_together"][1]["camera"]), focal(&truth["camera"]));
    assert!((lens - was).abs() < 0.3, "{lens} {was}");
    let report = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(report.contains("a global shutter") && report.contains("stereo.yaml"));
}

/// Writes the events and images of `simulation` into one bag.
fn bag(simulation: &Path) -> PathBuf {
    let path = simulation.join("both.bag");
    let images = Images::open(&simulation.join("second"), None, Damage::Refuse, Stamps::Middle).unwrap().unwrap();
    let mut frames = Vec::new();
    images.visit(|image| frames.push(image)).unwrap();
    let mut reader =
        Recording::new(simulation.join("events.aedat4"), RecordingOptions::default()).unwrap().open().unwrap();
    let sensor = reader.information().sensor.unwrap();
    let others = OtherStreams { frames: true, imu: false };
    let description = Description { sensor, camera_name: "", others, zero: 0 };
    let mut file = || File::create(&path);
    let mut encoder = (BAG_FORMAT.output.unwrap().create)(&mut file, &description).unwrap();
    let mut batch = Vec::new();
    while reader.next_batch(&mut batch).unwrap() {
        encoder.write(&batch).unwrap();
    }
    for frame in frames {
        let image = frame.image.unwrap();
        let size = (image.width() as u16, image.height() as u16);
        let frame = Frame {
            t: frame.exposure.0,
            exposure: None,
            readout: None,
            size,
            position: (0, 0),
            channels: 1,
            pixels: image.pixels,
        };
        assert!(encoder.extra(Extra::Frame(frame)).unwrap());
    }
    encoder.finish().unwrap();
    path
}

/// A bag with the events of the first camera and the images of the second has the same result as the folder.
#[test]
fn an_image_topic_gives_the_same_result_as_a_folder() {
    let simulation = frame_simulation();
    let bag = bag(&simulation);
    let images = ["--with", text(&bag), "--with-stream", "/dvs/image_raw", "--board", BOARD];
    let result = simulation.join("from-the-bag");
    let finished = evcal(&[&["calibrate", text(&bag)], &images[..], &["--force", "-o", text(&result)]].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    let folder = calibrated_with_frames("second-frames-calibrated", &simulation, &[]);
    let [of_bag, of_folder] =
        [result, folder].map(|folder| read_json(&folder.join("calibration.json"))["second_cameras"][0].clone());
    for name in ["T_second_first", "rotation_sigma", "translation_sigma", "time_offset", "frames", "camera"] {
        assert_eq!(of_bag[name], of_folder[name], "{name}");
    }
    assert!(of_bag["recording"].as_str().unwrap().ends_with("both.bag, /dvs/image_raw"), "{}", of_bag["recording"]);

    let rejected = |words: &str, options: &[&str]| {
        let options = [&["calibrate", text(&bag), "--with", text(&bag)], options].concat();
        let scratch = tempfile::tempdir().unwrap();
        let finished = evcal(&[&options[..], &["--board", BOARD, "-o", text(&scratch.path().join("out"))]].concat());
        assert_eq!(finished.code, Some(1), "{}", finished.stderr);
        assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
    };
    rejected("a camera that was already given", &[]);
    rejected("no topic \"/up\"", &["--with-stream", "/up"]);
}

#[test]
fn a_rolling_shutter_is_measured_if_declared_and_rejected_otherwise() {
    let simulation = rolling_simulation();
    let folder = calibrated_with_frames("second-rolling-calibrated", &simulation, &["--rolling-shutter"]);
    let found = &read_json(&folder.join("calibration.json"))["second_cameras"][0];
    let truth = &read_json(&simulation.join("truth.json"))["second_camera"];
    let line_delay = 1e-6 * numbers(&truth["settings"]["frames"]["line_delay"])[0];
    check_frame_camera(found, truth, line_delay);
    let delay = &found["frames"]["line_delay"];
    let error = numbers(&delay["value"])[0] - line_delay;
    assert!(error.abs() < 0.02 * line_delay && error.abs() < 4.5 * numbers(&delay["sigma"])[0], "{delay}");

    let scratch = tempfile::tempdir().unwrap();
    let (first, second) = (simulation.join("events.aedat4"), simulation.join("second"));
    let result = scratch.path().join("undeclared");
    let options = ["--imu", "--board", BOARD, "-o", text(&result)];
    let finished = evcal(&[&["calibrate", text(&first), "--with", text(&second)], &options[..]].concat());
    assert_eq!(finished.code, Some(1));
    // The failure of one does not prevent the attempt at the other.
    for words in ["2 were not calibrated", "the IMU: ", "contains no IMU samples", "add --rolling-shutter"] {
        assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
    }
    // The first camera is calibrated nevertheless.
    assert!(read_json(&result.join("calibration.json"))["second_cameras"].as_array().is_none_or(Vec::is_empty));
}

#[test]
fn wrong_folders_of_frames_are_rejected() {
    let scratch = tempfile::tempdir().unwrap();
    let first = frame_simulation().join("events.aedat4");
    let result = scratch.path().join("result");
    let rejected = |words: &str| {
        let folder = scratch.path().join("cam1");
        let finished =
            evcal(&["calibrate", text(&first), "--with", text(&folder), "--board", BOARD, "-o", text(&result)]);
        assert_eq!(finished.code, Some(1), "{}", finished.stderr);
        assert!(finished.stderr.contains(words), "wanted {words:?}: {}", finished.stderr);
    };
    fs::create_dir(scratch.path().join("cam1")).unwrap();
    rejected("holds no data.csv");
    fs::write(scratch.path().join("cam1/data.csv"), "#timestamp [ns],filename\n1000,1000.png\n").unwrap();
    rejected("data.csv: line 2: there is no file");
}

/// Frames and events of a DAVIS have the same optical centre, so the transform is the identity.
#[test]
fn the_cameras_own_frames_have_the_pose_of_the_events() {
    let recording = session().join("events.dvraw");
    let folder = made("own-frames", &["calibrate", text(&recording), "--board", BOARD, "--with-frames"]);
    let found = &read_json(&folder.join("calibration.json"))["second_cameras"][0];
    assert_eq!(found["from_identity"]["agrees"], true, "{found}");
    let pose = pose(&found["T_second_first"]);
    let [rotation, translation] =
        ["rotation_sigma", "translation_sigma"].map(|name| Vector3::from_vec(numbers(&found[name])));
    assert!(rotation.amax() < 0.1f64.to_radians() && translation.amax() < 1e-3, "σ {rotation} {translation}");
    assert!(pose.rotation.scaled_axis().component_div(&rotation).amax() < 3.5, "{pose} σ {rotation}");
    assert!(pose.translation.vector.component_div(&translation).amax() < 3.5, "{pose} σ {translation}");
}

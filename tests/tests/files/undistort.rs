//! Comparison of `evcal undistort` with OpenCV, on events and images.

use std::fs;
use std::path::{Path, PathBuf};

use evcal_core::event::Event;
use evcal_tests::lens::{KANNALA_BRANDT, Lens, RADTAN};
use evcal_tests::readers::{ask, python};
use evcal_tests::{all_events, evcal, json, read_json, text};
use event_recordings::image_file::{self, ImageFile, Samples};
use event_recordings::{Recording, RecordingOptions};
use serde_json::{Value, json};
use tempfile::TempDir;

/// Returns the folder of a simulated recording of 0.3 s with frames through this lens.
fn recording(lens: &Lens) -> PathBuf {
    lens.simulation("short", &["--motion", "fast", "--duration", "300ms", "--frames"])
}

fn events(path: &Path) -> Vec<Event> {
    let mut reader = Recording::new(path, RecordingOptions::default()).unwrap().open().unwrap();
    all_events(&mut reader)
}

/// Reads the camera matrix (fx 0 cx, 0 fy cy, 0 0 1) and the distortion coefficients of a camera file.
fn matrix_and_distortion(file: &Path) -> (Value, Vec<f64>) {
    let parameters = evcal_tests::camera(file).parameters();
    let [fx, fy, cx, cy] = parameters[..4] else { panic!("four parameters come first") };
    (json!([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), parameters[4..].to_vec())
}

/// Writes an image of smooth waves: bilinear interpolation is nearly exact, and any position error changes grey values.
fn picture(folder: &Path) -> PathBuf {
    let path = folder.join("waves.png");
    let wave = |x: u32, y: u32| 128.0 + 50.0 * (f64::from(x) * 0.13).sin() + 50.0 * (f64::from(y) * 0.11).cos();
    let waves = (0..260).flat_map(|y| (0..346).map(move |x| wave(x, y) as u8)).collect();
    write_grey(&path, (346, 260), waves);
    path
}

fn write_grey(path: &Path, size: (u32, u32), samples: Vec<u8>) {
    ImageFile { size, channels: 1, samples: Samples::Eight(samples) }.write_png(path).unwrap();
}

fn agrees(lens: Lens, alpha: Option<&str>) {
    let folder = TempDir::new().unwrap();
    let source = recording(&lens);
    let (truth, aedat4) = (source.join("truth.json"), source.join("events.aedat4"));
    let camera = ["-c", text(&truth)];
    let alpha_arguments = alpha.map_or(vec![], |alpha| vec!["--alpha", alpha]);
    let undistort = |input: &Path, output: &Path, more: &[&str]| {
        let paths = ["undistort", text(input), "-o", text(output), "--json"];
        json(&[&paths[..], &camera, &alpha_arguments, more].concat())
    };

    let sub_pixel = folder.path().join("sub-pixel.csv");
    let report = undistort(&aedat4, &sub_pixel, &["--subpixel"]);
    let before = events(&aedat4);
    let waves = picture(folder.path());
    let straight = folder.path().join("straight.png");
    undistort(&waves, &straight, &[]);
    let new_file = folder.path().join("sub-pixel.camera.json");
    assert_eq!(read_json(&new_file), read_json(&folder.path().join("straight.camera.json")));

    let (matrix, distortion) = matrix_and_distortion(&truth);
    let (new_matrix, none) = matrix_and_distortion(&new_file);
    assert!(none.iter().all(|value| *value == 0.0));
    let points: Vec<[u16; 2]> = before.iter().take(20_000).map(|event| [event.x, event.y]).collect();
    let question = json!({
        "matrix": matrix, "distortion": distortion, "fisheye": lens.model == "kannala-brandt", "new_matrix": new_matrix,
        "points": points, "picture": waves, "alpha": alpha.unwrap_or("0").parse::<f64>().unwrap(),
    });
    let opencv = ask(&python(), "undistort.py", &question);

    // Events, in order, without those outside the image.
    let expected: Vec<[f64; 2]> = serde_json::from_value(opencv["points"].clone()).unwrap();
    let on_image = |[x, y]: [f64; 2]| (-0.5..345.5).contains(&x) && (-0.5..259.5).contains(&y);
    let lines = fs::read_to_string(&sub_pixel).unwrap();
    let written: Vec<Vec<f64>> = lines
        .lines()
        .filter(|line| line.starts_with(|first: char| first.is_ascii_digit()))
        .map(|line| line.split(',').map(|value| value.parse().unwrap()).collect())
        .collect();
    let mut rows = written.iter();
    let mut outside = 0_u64;
    for (event, expected) in before.iter().zip(&expected) {
        if !on_image(*expected) {
            outside += 1;
            continue;
        }
        let row = rows.next().unwrap();
        assert_eq!((row[0], row[3]), (event.t as f64, f64::from(event.polarity.index() as u8)));
        let distance = (row[1] - expected[0]).hypot(row[2] - expected[1]);
        assert!(distance < 1e-4, "{} {event:?}: {row:?}, {expected:?}", lens.model);
    }
    assert_eq!(report["recording"]["events"], written.len());
    assert_eq!(report["recording"]["events_outside"], before.len() - written.len());
    assert!(alpha == Some("1") || outside > 0, "no event leaves the image");

    // The image.
    let rows: Vec<Vec<f64>> = serde_json::from_value(opencv["picture"].clone()).unwrap();
    let Samples::Eight(found) = image_file::read(&straight).unwrap().samples else { panic!("8 bits stay 8 bits") };
    let differences =
        found.iter().zip(rows.iter().flatten()).map(|(found, expected)| (f64::from(*found) - expected).abs());
    let worst = differences.fold(0.0, f64::max);
    assert_eq!(found.len(), rows.len() * rows[0].len());
    // OpenCV interpolates at multiples of 1/32 px, and both round.
    assert!(worst <= 2.0, "{}: {worst} grey levels", lens.model);
    println!("{} alpha {alpha:?}: {} events, picture within {worst} grey levels", lens.model, written.len());

    if let (Some(_), Some(optimal)) = (alpha, opencv["optimal"].as_array()) {
        // OpenCV inverts its distortion with only five steps of a fixed-point iteration.
        for (row, column) in [(0, 0), (1, 1), (0, 2), (1, 2)] {
            let (ours, theirs) = (new_matrix[row][column].as_f64().unwrap(), optimal[row][column].as_f64().unwrap());
            assert!((ours - theirs).abs() < 0.01 * 346.0, "{row} {column}: {ours} {theirs}");
        }
    }
}

#[test]
fn radtan_keeps_its_matrix() {
    agrees(RADTAN, None);
}

#[test]
fn radtan_without_black_corners() {
    agrees(RADTAN, Some("0"));
}

#[test]
fn radtan_without_lost_pixels() {
    agrees(RADTAN, Some("1"));
}

#[test]
fn kannala_brandt_keeps_its_matrix() {
    agrees(KANNALA_BRANDT, None);
}

#[test]
fn recordings_are_written_in_every_format_with_their_frames() {
    let folder = TempDir::new().unwrap();
    let source = recording(&RADTAN);
    let (truth, aedat4) = (source.join("truth.json"), source.join("events.aedat4"));
    let output = |name: &str| folder.path().join(name);
    let undistort = |name: &str, more: &[&str]| {
        let target = output(name);
        let arguments = ["undistort", text(&aedat4), "-c", text(&truth), "-o", text(&target), "--json"];
        (json(&[&arguments, more].concat()), target)
    };
    let (_, sub_pixel) = undistort("fractions.csv", &["--subpixel"]);
    let lines = fs::read_to_string(sub_pixel).unwrap();
    let fractions: Vec<(i64, f64, f64)> = lines
        .lines()
        .filter_map(|line| {
            let values: Vec<f64> = line.split(',').map_while(|value| value.parse().ok()).collect();
            let &[t, x, y, _] = values.as_slice() else { return None };
            Some((t as i64, x, y))
        })
        .collect();
    assert_eq!(undistort("fractions.h5", &["--subpixel"]).0["recording"]["events"], fractions.len());
    for extension in ["aedat4", "csv", "bin", "dvraw", "bag", "mcap", "raw", "npz", "h5"] {
        // The camera file is named after the recording without its extension, so each recording needs a name of its own.
        let name = format!("{extension}-events.{extension}");
        let (report, path) = undistort(&name, &[]);
        assert_eq!(report["recording"]["events"], fractions.len(), "{name}");
        let contains_frames = ["aedat4", "dvraw", "bag", "mcap"].contains(&extension);
        assert_eq!(report["recording"]["frames"].as_u64().unwrap() > 0, contains_frames, "{name}: {report}");
        if !["bin", "dvraw"].contains(&extension) {
            let written = events(&path);
            assert_eq!(written.len(), fractions.len());
            for (event, &(t, x, y)) in written.iter().zip(&fractions) {
                // The CSV file has four decimals.
                let near = |pixel: u16, position: f64| (f64::from(pixel) - position).abs() <= 0.5 + 1e-4;
                assert!(event.t == t && near(event.x, x) && near(event.y, y), "{name}: {event:?}, {x}, {y}");
            }
        }
    }
    let pictures = output("frames");
    let arguments = ["undistort", text(&aedat4), "-c", text(&truth), "--frames", text(&pictures), "--json"];
    let count = json(&arguments)["pictures"].as_u64().unwrap();
    assert!(count > 0 && fs::read_dir(&pictures).unwrap().count() as u64 == count + 1);
    assert!(pictures.join("camera.json").exists());
}

#[test]
fn wrong_inputs_and_options_are_rejected() {
    let folder = TempDir::new().unwrap();
    let source = recording(&RADTAN);
    let (truth, aedat4) = (source.join("truth.json"), source.join("events.aedat4"));
    let small = folder.path().join("small.png");
    write_grey(&small, (64, 48), vec![0; 64 * 48]);
    let there = folder.path().join("there.csv");
    fs::write(&there, "").unwrap();
    let new = folder.path().join("new.aedat4");
    for (input, output, options, code, part) in [
        (&small, &folder.path().join("o.png"), &[][..], 1, "64 x 48"),
        (&aedat4, &there, &[], 1, "already"),
        (&aedat4, &new, &["--subpixel"], 1, ".h5, .hdf5 or .bin (EventCalib)"),
        (&aedat4, &new, &["--alpha", "2"], 2, "--alpha"),
        (&aedat4, &new, &["--sensor", "640x480"], 1, "640 x 480"),
        (&aedat4, &new, &["--model", "fisheye"], 2, "equidistant"),
    ] {
        let arguments = ["undistort", text(input), "-c", text(&truth), "-o", text(output)];
        let failed = evcal(&[&arguments, options].concat());
        assert!(failed.code == Some(code) && failed.stderr.contains(part), "{options:?}: {failed:?}");
    }
    assert!(!new.exists());
}

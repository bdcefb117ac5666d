//! Every detected circle has the right row and column of the board.

use std::fs;
use std::path::Path;

use evcal_tests::lens::{KANNALA_BRANDT, Lens, RADTAN};
use evcal_tests::{camera, read_json};
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector2};

/// Half the distance between neighbouring columns, which is the distance between rows, in metres.
const SPACING: f64 = 0.055;

/// Reads the lines of a table as numbers, with NaN for empty fields. Comments and the header line are skipped.
fn numbers(file: &Path, separator: char) -> Vec<Vec<f64>> {
    let text = fs::read_to_string(file).unwrap();
    let rows = text.lines().filter(|line| !line.starts_with(|first: char| first == '#' || first.is_alphabetic()));
    let number = |field: &str| if field.is_empty() { f64::NAN } else { field.parse().unwrap() };
    rows.map(|row| row.split(separator).map(number).collect()).collect()
}

/// Reads T_world_camera at each millisecond.
fn poses(file: &Path) -> Vec<Isometry3<f64>> {
    let pose = |row: Vec<f64>| {
        let [t, x, y, z, i, j, k, w] = row.try_into().unwrap();
        let rotation = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
        (t, Isometry3::from_parts(Translation3::new(x, y, z), rotation))
    };
    let poses: Vec<(f64, Isometry3<f64>)> = numbers(file, ' ').into_iter().map(pose).collect();
    assert!(poses.iter().enumerate().all(|(index, (t, _))| (t - 1e-3 * index as f64).abs() < 1e-7));
    poses.into_iter().map(|(_, pose)| pose).collect()
}

fn every_circle_has_the_right_row_and_column(lens: Lens) {
    let (recording, calibration) = (lens.recording(), lens.own_calibration());
    let camera = camera(&recording.join("truth.json"));
    let poses = poses(&recording.join("trajectory.txt"));
    let circles = calibration.join("circles.csv");
    let names = fs::read_to_string(&circles).unwrap();
    let names = names.lines().find(|line| !line.starts_with('#')).unwrap();
    let index = |name: &str| names.split(',').position(|other| other == name).unwrap();
    let [t, column, row, x, y] = ["t_s", "column", "row", "x_px", "y_px"].map(index);
    let mut seen = 0;
    for fields in numbers(&circles, ',') {
        let position = Point3::new((2.0 * fields[column] + fields[row] % 2.0) * SPACING, fields[row] * SPACING, 0.0);
        let pose = &poses[(fields[t] * 1e3).round() as usize];
        let truth = camera.project(&(pose.inverse() * position).coords).unwrap();
        let error = (Vector2::new(fields[x], fields[y]) - truth).norm();
        // Neighbours are at least 20 px away; the pixel latency moves circles by a few pixels.
        assert!(error < 8.0, "{}: {error} px at {} s", lens.model, fields[t]);
        seen += 1;
    }
    assert!(seen > 10_000, "{seen} circles");
    // Otherwise the test would not cover circles that were found with the help of neighbouring frames.
    let result = read_json(&calibration.join("calibration.json"));
    assert!(result["stages"]["detection"]["found_by_neighbours"].as_u64().unwrap() > 0);
}

#[test]
fn radtan() {
    every_circle_has_the_right_row_and_column(RADTAN);
}

#[test]
fn kannala_brandt() {
    every_circle_has_the_right_row_and_column(KANNALA_BRANDT);
}

//! Recordings that are longer than the limit of the joint solve.

use std::collections::BTreeSet;
use std::fs;

use evcal_tests::accuracy::Accuracy;
use evcal_tests::{lens, read_json, text};

/// The joint solve uses two of four seconds, one of each half. The trajectory covers all four with the same accuracy.
#[test]
fn the_trajectory_covers_the_time_outside_the_joint_solve() {
    let directory = tempfile::tempdir().unwrap();
    let settings = directory.path().join("settings.toml");
    fs::write(&settings, "[refinement]\nmost_seconds = 2.0\n").unwrap();
    let lens = lens::RADTAN;
    let (recording, whole) = (lens.recording(), lens.own_calibration());
    let short = lens.calibration_with("limited", &recording, &["--settings", text(&settings)]);
    let result = read_json(&short.join("calibration.json"));
    let chosen = &result["chosen_seconds"];
    assert_eq!(chosen["seconds"], 4);
    let starts: Vec<f64> =
        chosen["chosen"].as_array().unwrap().iter().map(|second| second["start"].as_f64().unwrap()).collect();
    assert!(starts.len() == 2 && starts[0] < 2.0 && starts[1] >= 2.0, "{starts:?}");
    for second in chosen["chosen"].as_array().unwrap() {
        assert!(second["gain"].as_f64().unwrap() > 0.0, "{chosen}");
    }
    // The segments of the joint solve are in the chosen seconds.
    for segment in result["segments"].as_array().unwrap() {
        let middle = 0.5 * (segment["start"].as_f64().unwrap() + segment["end"].as_f64().unwrap());
        assert!(starts.contains(&middle.floor()), "{segment}");
    }
    assert!(read_json(&whole.join("calibration.json")).get("chosen_seconds").is_none());

    // Nearly all poses of the unlimited calibration are in the trajectory, each once.
    let times = |folder: &std::path::Path| -> BTreeSet<String> {
        let file = fs::read_to_string(folder.join("trajectory.txt")).unwrap();
        let lines = file.lines().filter(|line| !line.starts_with('#'));
        let times: Vec<String> = lines.filter_map(|line| Some(line.split(' ').next()?.to_owned())).collect();
        assert!(times.is_sorted_by(|a, b| a.parse::<f64>().unwrap() < b.parse::<f64>().unwrap()));
        times.into_iter().collect()
    };
    let (all, with_others) = (times(&whole), times(&short));
    assert!(with_others.len() as f64 > 0.97 * all.len() as f64, "{} of {}", with_others.len(), all.len());
    assert_eq!(fs::read(whole.join("circles.csv")).unwrap(), fs::read(short.join("circles.csv")).unwrap());

    let accuracy = Accuracy::of(&short, &recording);
    assert!(accuracy.focal < 5e-4 && accuracy.projection_rms < 0.06, "{accuracy:?}");
    assert!(accuracy.position < 1e-3, "{accuracy:?}");
    assert!(fs::read_to_string(short.join("report.html")).unwrap().contains("Seconds in the joint solve"));
}

//! Runs of the examples, which `make programs` builds, and `cargo test -p evcal` before the tests.

use std::path::{Path, PathBuf};
use std::process::Command;

const BOARD: &str = "acircles:9x4:55mm:r17.5mm";

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/board").join(name)
}

/// Runs an example; returns its output.
fn example(name: &str, arguments: &[&Path]) -> String {
    // target/PROFILE/deps/test, target/PROFILE/examples/NAME.
    let test = std::env::current_exe().unwrap();
    let folder = test.ancestors().nth(2).unwrap().join("examples");
    let program = folder.join(format!("{name}{}", std::env::consts::EXE_SUFFIX));
    // `cargo test --test cli` alone does not build them.
    assert!(
        program.exists(),
        "{}: test the whole package, or build its examples in this profile first",
        program.display()
    );
    let output = Command::new(&program).args(arguments).output().unwrap();
    assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn a_calibration_is_near_the_truth_and_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let results = folder.path().join("calibration");
    let printed = example("calibrate", &[&fixture("events.dvraw"), Path::new(BOARD), &results]);
    let truth: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(fixture("truth.json")).unwrap()).unwrap();
    for name in ["fx", "fy", "cx", "cy"] {
        let line = printed.lines().find(|line| line.starts_with(name)).unwrap();
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        let [value, sigma] = numbers.as_slice() else { panic!("{line}") };
        let error = value - truth["camera"]["parameters"][name].as_f64().unwrap();
        assert!(error.abs() < 4.0 * sigma && *sigma < 0.5, "{line}: off by {error}");
    }
    assert!(results.join("calibration.json").exists() && results.join("report.html").exists());
}

#[test]
fn the_board_is_found_and_events_are_moved() {
    let printed = example("detect", &[&fixture("events.dvraw"), Path::new(BOARD)]);
    assert!(printed.lines().count() > 100 && printed.contains("the board was found in"), "{printed}");
    let printed = example("undistort", &[&fixture("events.dvraw"), &fixture("truth.json")]);
    let numbers: Vec<u64> = printed.split_whitespace().filter_map(|word| word.parse().ok()).collect();
    let [kept, all] = numbers.as_slice() else { panic!("{printed}") };
    assert!(kept < all && *kept > all / 2, "{printed}");
}

#[test]
fn a_fisheye_is_simulated() {
    let printed = example("simulate", &[]);
    assert_eq!(printed.lines().filter(|line| line.ends_with(" events")).count(), 4 + 1, "{printed}");
}

//! Compares the wording of `stages.txt` with a snapshot. Other tests check the values.
//!
//! After a deliberate change, `INSTA_UPDATE=always cargo test -p evcal-tests --release stage_texts` writes the new text to
//! `tests/tests/calibration/snapshots`.

use std::fs;

use evcal_tests::session_calibration;

/// Stages whose numbers do not depend on OpenCV, so they are the same on every machine.
const EXACT: [&str; 4] = ["Recording", "Board in time windows", "Circles", "Board in the camera's frames"];

/// Replaces all numbers by `#`, whatever their sign and length, and keeps the indentation.
fn without_numbers(line: &str) -> String {
    let words = line.split_whitespace().map(|word| {
        let number = word.trim_matches(['(', ')', ',', ';', ':']);
        if number.parse::<f64>().is_ok() { word.replace(number, "#") } else { word.to_owned() }
    });
    let indent = line.len() - line.trim_start().len();
    " ".repeat(indent) + &words.collect::<Vec<String>>().join(" ")
}

#[test]
fn stages_of_the_session_in_the_fixtures() {
    let text = fs::read_to_string(session_calibration().join("stages.txt")).unwrap();
    let mut exact = false;
    let lines = text.lines().map(|line| {
        if !line.starts_with(' ') {
            exact = EXACT.iter().any(|stage| line.starts_with(stage));
        }
        if exact { line.to_owned() } else { without_numbers(line) }
    });
    insta::assert_snapshot!(lines.collect::<Vec<String>>().join("\n"));
}

//! Recordings in which the events of two cameras were merged, or those of adjacent pixels binned.

use std::fs;
use std::path::Path;

use evcal_tests::lens::Lens;
use evcal_tests::{BOARD, evcal, read_json, text};
use serde_json::Value;

/// Two lenses that differ by about 1.2 %.
const LENSES: [Lens; 2] = [
    Lens { model: "radtan4", parameters: "332.2,332.0,172.5,129.5,-0.35,0.15,0,0" },
    Lens { model: "radtan4", parameters: "336.1,336.3,173.1,129.0,-0.34,0.14,0,0" },
];

/// Time, column, row and polarity.
type Row = [i64; 4];

fn events_of(simulation: &Path) -> Vec<Row> {
    let file = fs::read_to_string(simulation.join("events.csv")).expect("a file");
    let row = |line: &str| {
        let mut numbers = line.split(',').map(str::parse);
        let mut next = || numbers.next()?.ok();
        Some([next()?, next()?, next()?, next()?])
    };
    file.lines().filter_map(row).collect()
}

/// Returns the verdict on these events of `width` x `height` pixels.
fn verdict(name: &str, mut events: Vec<Row>, [width, height]: [u16; 2]) -> Value {
    events.sort_by_key(|row| row[0]);
    let lines: Vec<String> = events.iter().map(|[t, x, y, p]| format!("{t},{x},{y},{p}\n")).collect();
    let directory = tempfile::tempdir().expect("a folder");
    let (file, folder) = (directory.path().join(format!("{name}.csv")), directory.path().join("result"));
    fs::write(&file, format!("# sensor {width} x {height}\nt_us,x,y,p\n{}", lines.concat())).expect("a file");
    let options = ["--board", BOARD, "--threads", "2", "--accept-any", "-o", text(&folder)];
    let finished = evcal(&[&["calibrate", text(&file)][..], &options].concat());
    assert_eq!(finished.code, Some(0), "{}", finished.stderr);
    let verdict = read_json(&folder.join("calibration.json"))["verdict"].clone();
    if name.ends_with("of-two") {
        let checked = evcal(&["check", text(&file), "--board", BOARD]);
        assert_eq!(checked.stdout.contains("edges appear twice"), has_double_edges(&verdict), "{checked:?}");
    }
    verdict
}

fn has_double_edges(verdict: &Value) -> bool {
    let findings = verdict["findings"].as_array().expect("findings");
    findings.iter().any(|finding| finding["cause"] == "double-edges")
}

/// The camera in between was "usable" at 0.15 px, and 0.8 px from both cameras.
#[test]
fn two_cameras_in_one_stream_are_not_good_and_named() {
    let options = ["--format", "csv", "--duration", "2s", "--motion", "fast", "--seed", "5"];
    let [first, second] = LENSES.map(|lens| events_of(&lens.simulation("merged", &options)));
    assert_ne!(first, second);
    let one = verdict("one-of-two", first.clone(), [346, 260]);
    assert!(!has_double_edges(&one) && one["grade"] != "not-good", "{one:#}");
    // Two by two pixels as one: the image is sound.
    let binned = first.iter().map(|[t, x, y, p]| [*t, x / 2, y / 2, *p]).collect();
    let binned = verdict("binned", binned, [173, 130]);
    assert!(!has_double_edges(&binned) && binned["grade"] != "not-good", "{binned:#}");
    // One by two pixels as one, which the verdict names otherwise.
    let binned = first.iter().map(|[t, x, y, p]| [*t, *x, y / 2, *p]).collect();
    let binned = verdict("binned-in-y", binned, [346, 130]);
    assert!(!has_double_edges(&binned) && binned["grade"] == "usable", "{binned:#}");
    let both = verdict("both-of-two", [first, second].concat(), [346, 260]);
    assert!(has_double_edges(&both) && both["grade"] == "not-good", "{both:#}");
}

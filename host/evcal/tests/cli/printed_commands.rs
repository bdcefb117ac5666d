//! Commands that the program prints can be run as they are printed.

use std::process::{Command, Output};

use crate::command::{fail, succeed, text};

const BOARD: &str = "acircles:9x4:55mm:r17.5mm";

/// Returns the commands in the output of a run: after "next:" or "for example:", or as a line of the help.
fn commands_in(output: &str) -> Vec<&str> {
    let after = |line: &str| -> Option<usize> {
        let marks = ["next: ", "for example: ", "| "];
        let marked = marks.into_iter().find_map(|mark| line.find(&format!("{mark}evcal ")).map(|at| at + mark.len()));
        marked
            .or_else(|| line.starts_with("    evcal ").then_some(4))
            .or_else(|| line.starts_with("  evcal ").then_some(2))
    };
    output.lines().filter_map(|line| line.get(after(line)?..)).collect()
}

/// Asserts that the program accepts every option in the commands of an output.
pub fn assert_accepted(output: &Output) {
    for bytes in [&output.stdout, &output.stderr] {
        let printed = String::from_utf8_lossy(bytes);
        for command in commands_in(&printed) {
            let words = command.strip_prefix("evcal ").unwrap();
            // The help is printed only if all words before it are accepted.
            let line = format!("\"$0\" {words} --help");
            let run = Command::new("sh").args(["-c", &line, env!("CARGO_BIN_EXE_evcal")]).output().unwrap();
            assert!(run.status.success(), "{command}: {}", String::from_utf8_lossy(&run.stderr));
        }
    }
}

#[test]
fn commands_are_found_in_texts() {
    let found = commands_in(
        "a\nnext: evcal check 'a b.csv' --sensor 3x4\n  evcal devices\nRun evcal info.\n    x | evcal live -\n",
    );
    assert_eq!(found, ["evcal check 'a b.csv' --sensor 3x4", "evcal devices", "evcal live -"]);
    assert!(commands_in(&fail(&["calibrate", "nothing.csv", "--board", BOARD, "-o", "/nonexistent/a/b"])).is_empty());
}

/// The next command used to lack the options with which the recording was read, so that it failed, or calibrated with another
/// unit of time.
#[test]
fn the_command_of_a_check_calibrates() {
    let folder = tempfile::tempdir().unwrap();
    let events = folder.path().join("my events.txt");
    let fixture = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/board/events.dvraw");
    let table = folder.path().join("events.csv");
    succeed(&["convert", fixture, text(&table)]);
    // Columns and unit are not those of evcal, and there is no size.
    let rows = std::fs::read_to_string(&table).unwrap();
    let rows = rows.lines().filter(|line| line.starts_with(|letter: char| letter.is_ascii_digit()));
    let row = |line: &str| {
        let mut columns = line.split(',');
        let [t, x, y, p] = std::array::from_fn(|_| columns.next().unwrap());
        format!("{x} {y} {p} {:.3}\n", t.parse::<f64>().unwrap() * 1e-3)
    };
    std::fs::write(&events, rows.map(row).collect::<String>()).unwrap();
    let options = ["--sensor", "346x260", "--columns", "x,y,p,t", "--time-unit", "ms"];
    let checked = succeed(&[&["check", text(&events), "--board", BOARD][..], &options].concat());
    let [command] = commands_in(&checked)[..] else { panic!("{checked}") };
    for option in options {
        assert!(command.contains(option), "{command}");
    }
    let words = command.strip_prefix("evcal").unwrap();
    let run = Command::new("sh")
        .args(["-c", &format!("\"$0\"{words}"), env!("CARGO_BIN_EXE_evcal")])
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(run.status.success(), "{command}: {}", String::from_utf8_lossy(&run.stderr));
    let written = std::fs::read_to_string(folder.path().join("calibration/calibration.json")).unwrap();
    let written: serde_json::Value = serde_json::from_str(&written).unwrap();
    // The true focal length of the fixture is 332.16.
    let fx = written["camera"]["parameters"]["fx"].as_f64().unwrap();
    assert!((fx - 332.16).abs() < 0.5, "{fx}");
}

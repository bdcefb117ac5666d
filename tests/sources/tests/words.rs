//! Libraries say what is wrong, not what to type: no option and no command of the program is in their sources.

use std::fs;
use std::path::{Path, PathBuf};

/// The libraries, of the folder `host`.
const LIBRARIES: &[&str] = &["calibrate", "files", "geometry", "live", "opencv", "recordings", "report", "simulator"];
/// Subcommands of the program.
const COMMANDS: &[&str] = &[
    "board",
    "calibrate",
    "check",
    "compare",
    "convert",
    "detect",
    "devices",
    "emulate",
    "evaluate",
    "export",
    "info",
    "live",
    "record",
    "repeat",
    "simulate",
    "undistort",
];
/// Lines for other programs: of ROS, and names of colours in a style sheet.
const FOREIGN: &[&str] = &["ros2 ", "--frame-id", "var(--", "\"--on\"", "\"--off\"", "\"--third\"", "\"--fourth\""];

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            sources(&entry, found);
        } else if entry.extension().is_some_and(|extension| extension == "rs") {
            found.push(entry);
        }
    }
}

/// Whether a line names a long option, or a command of the program.
fn speaks_of_the_program(line: &str) -> bool {
    let follows = |after: &str, word: &str| {
        after.strip_prefix(word).is_some_and(|rest| !rest.starts_with(|letter: char| letter.is_alphanumeric()))
    };
    let mut options = line.match_indices("--").map(|(place, _)| line[place + 2..].chars().take(2));
    let mut commands = line.match_indices("evcal ").map(|(place, found)| &line[place + found.len()..]);
    options.any(|letters| letters.filter(char::is_ascii_lowercase).count() == 2)
        || commands.any(|after| COMMANDS.iter().any(|command| follows(after, command)))
}

#[test]
fn options_and_commands_are_told_from_other_words() {
    for line in ["give --board X", "as `evcal calibrate` does", "evcal info", "(--fix)"] {
        assert!(speaks_of_the_program(line), "{line}");
    }
    for line in ["a -- b", "// ----", "a--;", "evcal calibrates", "--B"] {
        assert!(!speaks_of_the_program(line), "{line}");
    }
}

#[test]
fn libraries_name_no_option_and_no_command() {
    let host = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../host");
    let mut files = Vec::new();
    LIBRARIES.iter().for_each(|library| sources(&host.join(library).join("src"), &mut files));
    assert!(files.len() > 200, "{}", files.len());
    let mut wrong = String::new();
    for file in files {
        for (number, line) in fs::read_to_string(&file).unwrap().lines().enumerate() {
            if speaks_of_the_program(line) && !FOREIGN.iter().any(|foreign| line.contains(foreign)) {
                wrong += &format!("{}:{}: {}\n", file.display(), number + 1, line.trim());
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong}");
}

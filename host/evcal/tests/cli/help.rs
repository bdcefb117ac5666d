//! Snapshots of the help of every subcommand.
//!
//! After an intended change, `INSTA_UPDATE=always cargo test -p evcal --release help` writes the new texts to
//! `host/evcal/tests/cli/snapshots`.

use assert_cmd::Command;

fn help(arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_evcal"));
    let output = command.args(arguments).arg("--help").output().unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The subcommands, as the overview lists them in groups.
fn subcommands(overview: &str) -> Vec<&str> {
    let lines = overview.lines().skip_while(|line| !line.starts_with("Usage:")).skip(1);
    let listed = lines.take_while(|line| *line != "Options:").filter(|line| line.starts_with("  "));
    listed.filter_map(|line| line.split_whitespace().next()).filter(|name| *name != "help").collect()
}

#[test]
fn help_of_every_subcommand() {
    let overview = help(&[]);
    let names = subcommands(&overview);
    assert!(names.len() >= 16, "{names:?}");
    for name in names {
        insta::assert_snapshot!(name, help(&[name]));
    }
    insta::assert_snapshot!("evcal", overview);
}

/// Without this test, nobody would notice the snapshot of a removed subcommand.
#[test]
fn every_snapshot_is_of_a_subcommand() {
    let overview = help(&[]);
    let mut expected: Vec<String> =
        subcommands(&overview).into_iter().map(|name| format!("cli__help__{name}.snap")).collect();
    expected.push("cli__help__evcal.snap".to_owned());
    expected.sort();
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/cli/snapshots");
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut found: Vec<String> =
        files.filter(|name| name.starts_with("cli__help__") && name.ends_with(".snap")).collect();
    found.sort();
    assert_eq!(found, expected);
}

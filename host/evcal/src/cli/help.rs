//! The help of the program, with its subcommands in groups.

use std::fmt::Write as _;

use clap::CommandFactory as _;

/// Groups of subcommands.
const GROUPS: &[(&str, &[&str])] = &[
    ("Calibrate", &["board", "calibrate", "live"]),
    ("Use a calibration", &["export", "undistort", "compare", "evaluate", "repeat"]),
    ("Cameras and recordings", &["devices", "record", "check", "info", "convert", "detect"]),
    ("Without a camera", &["simulate"]),
    ("This program", &["completions", "man", "help"]),
];

/// Returns the clap command of the program, with its subcommands in groups.
pub fn command() -> clap::Command {
    let mut command = super::Arguments::command();
    command.build();
    let style = command.get_styles().clone();
    let (heading, literal) = (style.get_header(), style.get_literal());
    let mut groups = String::new();
    for (group, names) in GROUPS {
        let _ = writeln!(groups, "{heading}{group}:{heading:#}");
        for subcommand in names.iter().filter_map(|name| command.find_subcommand(name)) {
            let about = subcommand.get_about().map(ToString::to_string).unwrap_or_default();
            let _ = writeln!(groups, "  {literal}{:<12}{literal:#}{about}", subcommand.get_name());
        }
        groups.push('\n');
    }
    let template = format!(
        "{{before-help}}{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{groups}{heading}Options:{heading:#}\n{{options}}{{after-help}}"
    );
    super::Arguments::command().help_template(template)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_subcommand_is_in_one_group_and_has_examples() {
        let mut command = crate::cli::Arguments::command();
        command.build();
        let mut grouped: Vec<&str> = GROUPS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
        grouped.sort_unstable();
        let mut names: Vec<&str> = command.get_subcommands().map(clap::Command::get_name).collect();
        names.sort_unstable();
        assert_eq!(grouped, names);
        for subcommand in command.get_subcommands().filter(|subcommand| subcommand.get_name() != "help") {
            let examples = subcommand.get_after_help().map(ToString::to_string).unwrap_or_default();
            let own = format!("evcal {}", subcommand.get_name());
            assert!(examples.contains(&own), "{own}: {examples}");
        }
    }

    #[test]
    fn examples_are_valid_commands() {
        let mut command = crate::cli::Arguments::command();
        command.build();
        let help: Vec<String> = std::iter::once(&command)
            .chain(command.get_subcommands())
            .filter_map(|one| one.get_after_help().map(ToString::to_string))
            .collect();
        let lines = help.iter().flat_map(|text| text.lines()).map(str::trim).filter(|line| line.starts_with("evcal "));
        let mut count = 0;
        for line in lines {
            // Longer lines would be wrapped on a terminal of unknown width.
            assert!(line.len() <= 96, "{line}");
            let words = line.split(" > ").next().unwrap_or(line).split_whitespace();
            let parsed = crate::cli::Arguments::command().try_get_matches_from(words);
            assert!(parsed.is_ok(), "{line}: {}", parsed.unwrap_err());
            count += 1;
        }
        assert!(count > 20, "{count}");
    }
}

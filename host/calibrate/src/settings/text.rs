//! Descriptions of the settings: the comments of `settings.toml` and the tables of `docs/settings.md`.

use std::fmt::Write as _;

use evcal_core::settings::{Bounds, Group, Kind};
use toml::Table;

use super::Settings;

/// Widest line.
const WIDTH: usize = 100;

/// First comment of a settings file.
const HEAD: &str = "The settings of a calibration. This file, or any part of it, can be given to another one; what is not in it keeps \
                    its default.";

/// Adds the meaning of each value of `settings` to `toml`, before the value.
pub fn commented(settings: &Group, toml: &str) -> String {
    let mut text = String::new();
    comment(&mut text, HEAD);
    let mut group = Some(*settings);
    for line in toml.lines() {
        if let Some(path) = line.strip_prefix('[').and_then(|line| line.strip_suffix(']')) {
            group = path.split('.').try_fold(*settings, |group, name| inner(&group, name));
            text.push('\n');
            if let Some(group) = &group {
                comment(&mut text, group.meaning);
            }
        } else if let (Some(group), Some((name, _))) = (&group, line.split_once(" = ")) {
            let setting = group.settings.iter().find(|setting| setting.name == name);
            text.push('\n');
            if let Some(setting) = setting {
                comment(&mut text, setting.meaning);
                comment(&mut text, &number(&setting.kind));
            }
        }
        if !line.is_empty() {
            text.push_str(line);
            text.push('\n');
        }
    }
    text
}

/// Returns the structure `name` of `group`.
fn inner(group: &Group, name: &str) -> Option<Group> {
    let setting = group.settings.iter().find(|setting| setting.name == name)?;
    if let Kind::Group(inner) = setting.kind { Some(*inner) } else { None }
}

/// Describes unit and bounds of a number, for a comment.
fn number(kind: &Kind) -> String {
    match kind {
        Kind::Number { unit: "", bounds } => format!("A number {}.", allowed(bounds)),
        Kind::Number { unit, bounds } => format!("In {unit}, {}.", allowed(bounds)),
        Kind::Choice | Kind::Group(_) => String::new(),
    }
}

/// Describes the permitted values of a number, with the setting that it must not exceed.
fn allowed(bounds: &Bounds) -> String {
    bounds.up_to.map_or_else(|| bounds.to_string(), |other| format!("{bounds}, at most `{other}`"))
}

/// Adds lines of comment.
fn comment(text: &mut String, words: &str) {
    let mut line = String::new();
    for word in words.split_whitespace() {
        if !line.is_empty() && line.chars().count() + 1 + word.chars().count() > WIDTH - 2 {
            let _ = writeln!(text, "# {line}");
            line.clear();
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line.push_str(word);
    }
    if !line.is_empty() {
        let _ = writeln!(text, "# {line}");
    }
}

/// Marks around the tables in `docs/settings.md`.
const MARKS: [&str; 2] = ["<!-- The tables, made from the code. -->\n", "<!-- End of the tables. -->\n"];

/// Returns the text of `docs/settings.md` with its tables generated again; `None` if the marks around them are missing.
pub fn document(text: &str) -> Option<String> {
    let (before, rest) = text.split_once(MARKS[0])?;
    let (_, after) = rest.split_once(MARKS[1])?;
    let mut tables = String::new();
    sections(&mut tables, "", &Settings::GROUP, &Settings::default().table());
    Some(format!("{before}{}\n{tables}{}{after}", MARKS[0], MARKS[1]))
}

/// Writes the sections of the structures in `group`, which has the name `path` and these default `values`.
fn sections(text: &mut String, path: &str, group: &Group, values: &Table) {
    for setting in group.settings {
        let (Kind::Group(inner), Some(toml::Value::Table(values))) = (&setting.kind, values.get(setting.name)) else {
            continue;
        };
        let path = if path.is_empty() { setting.name.to_owned() } else { format!("{path}.{}", setting.name) };
        let _ = write!(text, "## `[{path}]`\n\n{}\n\n", inner.meaning.trim());
        text.push_str("| name | unit | default | allowed | meaning |\n|---|---|---|---|---|\n");
        for setting in inner.settings {
            let (unit, allowed) = match &setting.kind {
                Kind::Number { unit, bounds } => (if unit.is_empty() { "–" } else { *unit }, allowed(bounds)),
                Kind::Choice => ("–", String::from("–")),
                Kind::Group(_) => continue,
            };
            // Settings that no file contains are not documented.
            let Some(default) = values.get(setting.name) else { continue };
            let (name, meaning) = (setting.name, setting.meaning.trim());
            let _ = writeln!(text, "| `{name}` | {unit} | `{default}` | {allowed} | {meaning} |");
        }
        text.push('\n');
        sections(text, &path, inner, values);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_value_in_a_file_has_a_description() {
        let text = Settings::default().to_commented_toml();
        let cluster = "# DBSCAN over the pixels of one polarity.\n[detection.cluster]\n\n\
                       # Neighbourhood radius ε. It must stay below the gap between the arcs of neighbouring dots.\n\
                       # In px, from 1 to 4.99.\nepsilon = 2.5\n";
        assert!(text.contains(cluster), "{text}");
        assert!(text.contains("# In px, at least 0, at most `max_radius`.\nmin_radius = 2.0\n"), "{text}");
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH));
        let settings = text.lines().filter(|line| line.contains(" = ") && !line.starts_with('#')).count();
        let undocumented = text.split("\n\n").filter(|part| part.contains(" = ") && !part.starts_with('#')).count();
        assert_eq!((settings, undocumented), (Settings::default().to_toml().matches(" = ").count(), 0));
    }

    #[test]
    fn a_document_keeps_the_text_around_its_tables() {
        let text = format!("before\n{}of yesterday\n{}after\n", MARKS[0], MARKS[1]);
        let made = document(&text).unwrap();
        assert!(made.starts_with("before\n") && made.ends_with("after\n") && !made.contains("yesterday"), "{made}");
        assert!(made.contains("| `knot_spacing` | s | `0.0175` | at least 0.0001 |"), "{made}");
        assert_eq!(document(&made).as_deref(), Some(made.as_str()));
        assert_eq!(document("no marks"), None);
    }
}

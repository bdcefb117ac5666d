//! `docs/settings.md` names every setting in the section of its table, with its true default.

use evcal::settings::Settings;
use toml::{Table, Value};

const DOCUMENT: &str = include_str!("../../docs/settings.md");

/// The rows (name, default) of the table below the heading of `section`.
fn documented(section: &str) -> Vec<(&'static str, &'static str)> {
    let heading = format!("## `[{section}]`");
    let lines = DOCUMENT.lines().skip_while(|line| *line != heading).skip(1);
    let rows = lines.take_while(|line| !line.starts_with("## ")).filter(|line| line.starts_with("| `"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split('|').map(|cell| cell.trim().trim_matches('`')).collect();
        (cells[1], cells[3])
    })
    .collect()
}

/// Whether the documented text stands for `value`. Single precision, as some settings are.
fn stands_for(text: &str, value: &Value) -> bool {
    let table: Table = toml::from_str(&format!("value = {text}")).unwrap();
    match (&table["value"], value) {
        (Value::Float(documented), Value::Float(value)) => *documented as f32 == *value as f32,
        (documented, value) => documented == value,
    }
}

/// Checks a table and those in it; gives the number of settings seen.
fn check(section: &str, table: &Table) -> usize {
    let rows = documented(section);
    let mut seen = 0;
    let mut plain = Vec::new();
    for (name, value) in table {
        if let Value::Table(inner) = value {
            let inner_section = if section.is_empty() { name.clone() } else { format!("{section}.{name}") };
            seen += check(&inner_section, inner);
            continue;
        }
        let row = rows.iter().find(|row| row.0 == name);
        let (_, default) = row.unwrap_or_else(|| panic!("docs/settings.md: `{name}` is missing in [{section}]"));
        assert!(stands_for(default, value), "docs/settings.md: [{section}] `{name}` is {value}, not {default}");
        plain.push(name.as_str());
        seen += 1;
    }
    for (name, _) in rows {
        assert!(plain.contains(&name), "docs/settings.md: [{section}] has no setting `{name}`");
    }
    seen
}

#[test]
fn every_setting_is_documented_with_its_default_and_nothing_else_is() {
    let settings: Table = toml::from_str(&Settings::default().to_toml()).unwrap();
    let seen = check("", &settings);
    let rows = DOCUMENT.lines().filter(|line| line.starts_with("| `")).count();
    assert_eq!(seen, rows, "sections of docs/settings.md that are no table of the settings");
}

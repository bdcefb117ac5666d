//! OpenCV's `FileStorage` in its three encodings.
//!
//! The dialects are OpenCV's own: its YAML reader requires the header `%YAML:1.0` and the tag `!!opencv-matrix`, which general
//! YAML readers reject; in XML and JSON a matrix is marked by `type_id`.

use std::fmt::Write as _;

use super::number::{decimal, decimals};

/// A value with a name.
pub struct Entry {
    /// The name: a letter or `_`, then letters, digits, `_` and `-`.
    pub name: String,
    /// The value.
    pub value: Value,
}

/// A value in a `FileStorage`.
pub enum Value {
    /// A whole number.
    Integer(i64),
    /// A real number.
    Real(f64),
    /// A string without quotation marks and markup.
    Word(String),
    /// A matrix of doubles, row by row.
    Matrix {
        /// Its number of rows.
        rows: usize,
        /// Its entries.
        values: Vec<f64>,
    },
    /// More entries.
    Map(Vec<Entry>),
}

impl Value {
    /// Creates a matrix of one row.
    pub fn row(values: &[f64]) -> Self {
        Self::Matrix { rows: 1, values: values.to_vec() }
    }

    /// Creates a matrix of one column.
    pub fn column(values: &[f64]) -> Self {
        Self::Matrix { rows: values.len(), values: values.to_vec() }
    }
}

/// Creates an entry.
pub fn entry(name: impl Into<String>, value: Value) -> Entry {
    Entry { name: name.into(), value }
}

/// Returns the name that OpenCV uses for `name`: other characters become `_`.
pub fn valid_name(name: &str) -> String {
    let allowed = |character: char| character.is_ascii_alphanumeric() || "_-".contains(character);
    let mut valid: String = name.chars().map(|character| if allowed(character) { character } else { '_' }).collect();
    if !valid.starts_with(|first: char| first.is_ascii_alphabetic() || first == '_') {
        valid.insert(0, '_');
    }
    valid
}

/// Writes YAML, with comments first.
pub fn yaml(remarks: &[String], entries: &[Entry]) -> String {
    let mut text = String::from("%YAML:1.0\n---\n");
    for remark in remarks {
        let _ = writeln!(text, "# {remark}");
    }
    yaml_entries(&mut text, entries, 0);
    text
}

fn yaml_entries(text: &mut String, entries: &[Entry], indent: usize) {
    for Entry { name, value } in entries {
        let _ = write!(text, "{:indent$}{name}:", "");
        match value {
            Value::Integer(value) => *text += &format!(" {value}\n"),
            Value::Real(value) => *text += &format!(" {}\n", decimal(*value)),
            Value::Word(word) => *text += &format!(" \"{word}\"\n"),
            Value::Matrix { rows, values } => {
                let (columns, inner) = (values.len() / rows.max(&1), indent + 3);
                let _ = write!(
                    text,
                    " !!opencv-matrix\n{0:inner$}rows: {rows}\n{0:inner$}cols: {columns}\n{0:inner$}dt: d\n{0:inner$}data: [ {1} ]\n",
                    "",
                    decimals(values)
                );
            }
            Value::Map(entries) => {
                *text += "\n";
                yaml_entries(text, entries, indent + 3);
            }
        }
    }
}

/// Writes XML, with a comment.
pub fn xml(remarks: &[String], entries: &[Entry]) -> String {
    let mut text = String::from("<?xml version=\"1.0\"?>\n<opencv_storage>\n");
    for remark in remarks {
        // Two hyphens would end the comment.
        let _ = writeln!(text, "<!-- {} -->", remark.replace("--", "- -"));
    }
    xml_entries(&mut text, entries);
    text + "</opencv_storage>\n"
}

fn xml_entries(text: &mut String, entries: &[Entry]) {
    for Entry { name, value } in entries {
        match value {
            Value::Integer(value) => *text += &format!("<{name}>{value}</{name}>\n"),
            Value::Real(value) => *text += &format!("<{name}>{}</{name}>\n", decimal(*value)),
            Value::Word(word) => *text += &format!("<{name}>\"{word}\"</{name}>\n"),
            Value::Matrix { rows, values } => {
                let columns = values.len() / rows.max(&1);
                let data: Vec<String> = values.iter().map(|value| decimal(*value)).collect();
                let _ = writeln!(
                    text,
                    "<{name} type_id=\"opencv-matrix\">\n  <rows>{rows}</rows>\n  <cols>{columns}</cols>\n  <dt>d</dt>\n  <data>\n    {}</data></{name}>",
                    data.join(" ")
                );
            }
            Value::Map(entries) => {
                let _ = writeln!(text, "<{name}>");
                xml_entries(text, entries);
                let _ = writeln!(text, "</{name}>");
            }
        }
    }
}

/// Writes JSON, with the remarks as `comment`.
pub fn json(remarks: &[String], entries: &[Entry]) -> String {
    let comment = entry("comment", Value::Word(remarks.join("; ")));
    format!("{{\n{}\n}}\n", json_entries([&comment].into_iter().chain(entries), 4))
}

fn json_entries<'a>(entries: impl Iterator<Item = &'a Entry>, indent: usize) -> String {
    let lines = entries.map(|Entry { name, value }| {
        let value = match value {
            Value::Integer(value) => value.to_string(),
            Value::Real(value) => decimal(*value),
            Value::Word(word) => format!("\"{word}\""),
            Value::Matrix { rows, values } => {
                let (columns, inner) = (values.len() / rows.max(&1), indent + 4);
                format!(
                    "{{\n{0:inner$}\"type_id\": \"opencv-matrix\",\n{0:inner$}\"rows\": {rows},\n{0:inner$}\"cols\": {columns},\n{0:inner$}\"dt\": \"d\",\n{0:inner$}\"data\": [ {1} ]\n{0:indent$}}}",
                    "",
                    decimals(values)
                )
            }
            Value::Map(entries) => format!("{{\n{}\n{:indent$}}}", json_entries(entries.iter(), indent + 4), ""),
        };
        format!("{:indent$}\"{name}\": {value}", "")
    });
    lines.collect::<Vec<_>>().join(",\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_that_opencv_refuses_are_changed() {
        for (name, valid) in [("DAVIS346_00000001", "DAVIS346_00000001"), ("3 µm", "_3__m"), ("", "_"), ("-a", "_-a")]
        {
            assert_eq!(valid_name(name), valid);
        }
    }

    #[test]
    fn comments_cannot_end_early() {
        let text = xml(&["a -- b".to_owned()], &[]);
        assert!(text.contains("<!-- a - - b -->"), "{text}");
    }
}

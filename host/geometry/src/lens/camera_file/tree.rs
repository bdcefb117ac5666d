//! Converts JSON and XML of other programs to the same tree as YAML.

use roxmltree::Node;
use serde_json::Value;
use yaml_rust2::Yaml;
use yaml_rust2::yaml::Hash;

/// Largest nesting depth of elements of a camera in XML.
const DEEPEST: usize = 8;

/// Returns the tree of a JSON text.
pub(super) fn of_json(text: &str) -> Result<Yaml, serde_json::Error> {
    Ok(of_value(serde_json::from_str(text)?))
}

fn of_value(value: Value) -> Yaml {
    match value {
        Value::Null => Yaml::Null,
        Value::Bool(value) => Yaml::Boolean(value),
        Value::Number(number) => number.as_i64().map_or_else(|| Yaml::Real(number.to_string()), Yaml::Integer),
        Value::String(text) => Yaml::String(text),
        Value::Array(values) => Yaml::Array(values.into_iter().map(of_value).collect()),
        Value::Object(object) => {
            Yaml::Hash(object.into_iter().map(|(name, value)| (Yaml::String(name), of_value(value))).collect())
        }
    }
}

/// Returns the tree below the root of an XML text, as written by OpenCV's `FileStorage`.
pub(super) fn of_xml(text: &str) -> Result<Yaml, roxmltree::Error> {
    let document = evcal_files::xml::parse(text)?;
    Ok(of_element(document.root_element(), 0))
}

fn of_element(element: Node, depth: usize) -> Yaml {
    let inner: Vec<Node> = element.children().filter(Node::is_element).collect();
    if inner.is_empty() || depth > DEEPEST {
        return of_text(element.text().unwrap_or_default().trim());
    }
    let named = inner.into_iter().map(|node| {
        let name = node.tag_name().name();
        let value = match name {
            "data" => Yaml::Array(node.text().unwrap_or_default().split_whitespace().map(of_text).collect()),
            _ => of_element(node, depth + 1),
        };
        (Yaml::String(name.to_owned()), value)
    });
    Yaml::Hash(named.collect::<Hash>())
}

/// Parses a number, or a word, which `FileStorage` may have quoted.
fn of_text(text: &str) -> Yaml {
    match (text.parse(), text.parse::<f64>()) {
        (Ok(whole), _) => Yaml::Integer(whole),
        (_, Ok(_)) => Yaml::Real(text.to_owned()),
        _ => Yaml::String(text.trim_matches('"').to_owned()),
    }
}

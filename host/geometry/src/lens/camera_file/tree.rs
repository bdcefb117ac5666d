//! JSON and XML of other programs as the tree that their YAML gives.

use roxmltree::Node;
use serde_json::Value;
use yaml_rust2::Yaml;
use yaml_rust2::yaml::Hash;

/// Levels of elements in each other that a camera in XML has at most.
const DEEPEST: usize = 8;

/// The tree of a text in JSON.
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

/// The tree below the root of a text in XML, as OpenCV's `FileStorage` writes it.
pub(super) fn of_xml(text: &str) -> Result<Yaml, roxmltree::Error> {
    let document = roxmltree::Document::parse(text)?;
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

/// A number, or a word, which `FileStorage` may have put in quotes.
fn of_text(text: &str) -> Yaml {
    match (text.parse(), text.parse::<f64>()) {
        (Ok(whole), _) => Yaml::Integer(whole),
        (_, Ok(_)) => Yaml::Real(text.to_owned()),
        _ => Yaml::String(text.trim_matches('"').to_owned()),
    }
}

//! Loading of YAML from other programs within bounds. The parser's recursion is as deep as the nesting of a file, and a
//! few lines that repeat each other (aliases) can fill any memory. Such files are rejected before they are loaded.

use yaml_rust2::parser::{Event, Parser};
use yaml_rust2::{Yaml, YamlLoader};

/// Largest nesting depth of lists and maps.
const DEEPEST: usize = 64;

/// Reason why a document is not loaded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// The text is longer than allowed.
    #[error("it has more than {0} bytes")]
    TooLong(usize),
    /// Lists and maps are nested too deeply.
    #[error("its lists are more than {DEEPEST} levels deep")]
    TooDeep,
    /// The text contains anchors or aliases.
    #[error("it repeats parts of itself (& and *), which is not supported")]
    Repeats,
    /// The text is not valid YAML.
    #[error("{0}")]
    Syntax(String),
}

/// Loads the documents in `text`, which may have up to `longest` bytes.
///
/// # Errors
/// [`LoadError`].
pub fn load(text: &str, longest: usize) -> Result<Vec<Yaml>, LoadError> {
    if text.len() > longest {
        return Err(LoadError::TooLong(longest));
    }
    check(text)?;
    YamlLoader::load_from_str(text).map_err(|error| LoadError::Syntax(error.to_string()))
}

/// Parses `text` event by event, which needs no recursion and little memory, and checks its structure.
fn check(text: &str) -> Result<(), LoadError> {
    let mut parser = Parser::new_from_str(text);
    let mut depth = 0_usize;
    loop {
        // Anchor numbers start at 1.
        let (event, _) = parser.next_token().map_err(|error| LoadError::Syntax(error.to_string()))?;
        match event {
            Event::StreamEnd => return Ok(()),
            Event::Alias(_) | Event::Scalar(_, _, 1.., _) => return Err(LoadError::Repeats),
            Event::SequenceStart(1.., _) | Event::MappingStart(1.., _) => return Err(LoadError::Repeats),
            Event::SequenceStart(..) | Event::MappingStart(..) => depth += 1,
            Event::SequenceEnd | Event::MappingEnd => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > DEEPEST {
            return Err(LoadError::TooDeep);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LONGEST: usize = 1 << 20;

    #[test]
    fn aliases_are_rejected_and_quoted_marks_are_not() {
        let line = |level: usize| format!("a{level}: &a{level} [{}]\n", format!("*a{},", level - 1).repeat(9));
        let bomb: String = (1..20).map(line).collect();
        for text in [&format!("a0: &a0 1\n{bomb}"), "a: &b 1\n", "a: &b [1]\n", "a: &b {c: 1}\n"] {
            assert_eq!(load(text, LONGEST), Err(LoadError::Repeats), "{text}");
        }
        let read = load("# R&D\na: \"b &c *d\"\ne: left&right\n", LONGEST).unwrap();
        assert_eq!((read[0]["a"].as_str(), read[0]["e"].as_str()), (Some("b &c *d"), Some("left&right")));
    }

    #[test]
    fn deep_nesting_is_rejected() {
        for nested in ["[", "{a: ", "- ", "? ", "- [", "? {"] {
            assert!(load(&nested.repeat(LONGEST / nested.len()), LONGEST).is_err(), "{nested}");
        }
        let lists = |depth: usize| format!("{}1{}", "[".repeat(depth), "]".repeat(depth));
        assert!(load(&lists(DEEPEST), LONGEST).is_ok());
        assert_eq!(load(&lists(DEEPEST + 1), LONGEST), Err(LoadError::TooDeep));
        let lines: String = (0..1000).map(|depth| format!("{}a:\n", " ".repeat(depth))).collect();
        assert_eq!(load(&lines, LONGEST), Err(LoadError::TooDeep));
    }

    #[test]
    fn long_text_is_rejected() {
        assert!(load("a: 12\n", 6).is_ok());
        assert_eq!(load("a: 12\n", 5), Err(LoadError::TooLong(5)));
    }
}

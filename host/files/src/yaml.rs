//! YAML of other programs. The parser's stack is as deep as a file is nested, and a few lines that repeat each other fill any
//! memory: such files are refused before they are loaded.

use yaml_rust2::parser::{Event, Parser};
use yaml_rust2::{Yaml, YamlLoader};

/// Levels of lists and maps in each other.
const DEEPEST: usize = 64;

/// Why a text is not loaded.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum LoadError {
    /// Longer than what it is taken for.
    #[error("it has more than {0} bytes")]
    TooLong(usize),
    /// Lists and maps in each other without end.
    #[error("its lists are more than {DEEPEST} levels deep")]
    TooDeep,
    /// Anchors or aliases.
    #[error("it repeats parts of itself (& and *), which is not read")]
    Repeats,
    /// It is no YAML.
    #[error("{0}")]
    Syntax(String),
}

/// The documents in `text`, which may have `longest` bytes.
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

/// Goes through `text` piece by piece, which takes no stack and no memory.
fn check(text: &str) -> Result<(), LoadError> {
    let mut parser = Parser::new_from_str(text);
    let mut depth = 0_usize;
    loop {
        // Anchors have numbers from 1 on.
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
    fn what_repeats_itself_is_refused_and_a_quoted_mark_is_not() {
        let line = |level: usize| format!("a{level}: &a{level} [{}]\n", format!("*a{},", level - 1).repeat(9));
        let bomb: String = (1..20).map(line).collect();
        for text in [&format!("a0: &a0 1\n{bomb}"), "a: &b 1\n", "a: &b [1]\n", "a: &b {c: 1}\n"] {
            assert_eq!(load(text, LONGEST), Err(LoadError::Repeats), "{text}");
        }
        let read = load("# R&D\na: \"b &c *d\"\ne: left&right\n", LONGEST).unwrap();
        assert_eq!((read[0]["a"].as_str(), read[0]["e"].as_str()), (Some("b &c *d"), Some("left&right")));
    }

    #[test]
    fn what_is_nested_without_end_is_refused() {
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
    fn what_is_too_long_is_refused() {
        assert!(load("a: 12\n", 6).is_ok());
        assert_eq!(load("a: 12\n", 5), Err(LoadError::TooLong(5)));
    }
}

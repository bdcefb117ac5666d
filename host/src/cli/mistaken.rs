//! What was probably meant by a command line that clap refuses.

use std::path::Path;

use clap::error::{ContextKind, ContextValue, ErrorKind};

/// Adds to `error`, of the words `words`, what clap does not think of: a recording in place of a subcommand, and a long option with one
/// hyphen.
pub fn explained(mut error: clap::Error, words: impl Iterator<Item = String>) -> clap::Error {
    let tip = match error.kind() {
        ErrorKind::InvalidSubcommand => file_first(&error),
        ErrorKind::UnknownArgument => one_hyphen(&error, words),
        _ => None,
    };
    if let Some(tip) = tip {
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

/// `evcal FILE`.
fn file_first(error: &clap::Error) -> Option<String> {
    let Some(ContextValue::String(word)) = error.get(ContextKind::InvalidSubcommand) else { return None };
    Path::new(word).exists().then(|| format!("what to do with it comes first: 'evcal info {word}'"))
}

/// `-board`, of which clap names `-b` only.
fn one_hyphen(error: &clap::Error, mut words: impl Iterator<Item = String>) -> Option<String> {
    let Some(ContextValue::String(refused)) = error.get(ContextKind::InvalidArg) else { return None };
    let long = |word: &String| {
        word.starts_with(refused.as_str())
            && word.len() > 2
            && word.chars().skip(1).all(|letter| letter.is_alphabetic() || letter == '-')
    };
    let word = words.find(|word| !word.starts_with("--") && long(word))?;
    Some(format!("long options have two hyphens: '-{word}'"))
}

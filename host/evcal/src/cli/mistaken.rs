//! What was probably meant by a command line that clap refuses.

use std::error::Error as _;
use std::path::Path;

use clap::error::{ContextKind, ContextValue, ErrorKind};

use super::advice::advice;

/// Adds to `error`, of the words `words`, what clap does not think of: a recording in place of a subcommand, a long option with one
/// hyphen, and how a board is written.
pub fn explained(mut error: clap::Error, words: impl Iterator<Item = String>) -> clap::Error {
    let tip = match error.kind() {
        ErrorKind::InvalidSubcommand => file_first(&error),
        ErrorKind::UnknownArgument => {
            let words: Vec<String> = words.collect();
            other_program(&error, &words).or_else(|| one_hyphen(&error, words.into_iter()))
        }
        ErrorKind::MissingRequiredArgument => without_board(&error),
        ErrorKind::ValueValidation => error.source().and_then(advice),
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
    Path::new(word).exists().then(|| format!("the subcommand comes first, for example 'evcal info {word}'"))
}

/// A command without its board, of which a newcomer may not know how to write it.
fn without_board(error: &clap::Error) -> Option<String> {
    let Some(ContextValue::Strings(missing)) = error.get(ContextKind::InvalidArg) else { return None };
    let is_board = missing.iter().any(|argument| argument.starts_with("--board"));
    is_board.then(|| {
        "a board is for example '--board acircles:9x4:55mm:r17.5mm'; 'evcal check RECORDING' tells which one is in a recording".to_owned()
    })
}

/// Options of Kalibr, and a recording that `evcal live` is to play.
fn other_program(error: &clap::Error, words: &[String]) -> Option<String> {
    let Some(ContextValue::String(refused)) = error.get(ContextKind::InvalidArg) else { return None };
    let tip = match refused.as_str() {
        "--bag" | "--bags" => "the recording stands alone, without an option: 'evcal calibrate RECORDING'".to_owned(),
        "--target" | "--target-yaml" => "the board is named in words: '--board acircles:9x4:55mm:r17.5mm'".to_owned(),
        "--topic" | "--topics" => "one topic of a bag is read with '--stream TOPIC'".to_owned(),
        "--models" => "the camera model is named with '--model'".to_owned(),
        file if words.first().is_some_and(|word| word == "live") && Path::new(file).exists() => {
            format!("a recording is played with '--replay {file}'")
        }
        number if number.starts_with('-') && number.chars().nth(1).is_some_and(|letter| letter.is_ascii_digit()) => {
            format!("is '{number}' a value below 0? This one has to be above 0, for example 6s")
        }
        _ => return None,
    };
    Some(tip)
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

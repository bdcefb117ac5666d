//! Suggestions for command lines that clap refuses.

use std::path::Path;

use clap::error::{ContextKind, ContextValue, ErrorKind};
use evcal_files::remedy::{Remedy as _, Words};
use evcal_geometry::board::Board;
use event_recordings::RecordingOptions;

use super::board_argument::board_request;
use super::source_arguments::command;

/// Adds a suggestion to an `error` in the command line `words` for mistakes that clap has no suggestion for, such as a recording instead of
/// a subcommand, a long option with one hyphen, or a missing board.
pub fn explained(mut error: clap::Error, words: impl Iterator<Item = String>) -> clap::Error {
    let tip = match error.kind() {
        ErrorKind::InvalidSubcommand => file_first(&error),
        ErrorKind::UnknownArgument => {
            let words: Vec<String> = words.collect();
            other_program(&error).or_else(|| one_hyphen(&error, words.into_iter()))
        }
        ErrorKind::MissingRequiredArgument => without_board(&error),
        ErrorKind::ValueValidation => wrong_board(&error),
        _ => None,
    };
    if let Some(tip) = tip {
        error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
    }
    error
}

/// A file instead of a subcommand: `evcal FILE`.
fn file_first(error: &clap::Error) -> Option<String> {
    let Some(ContextValue::String(word)) = error.get(ContextKind::InvalidSubcommand) else { return None };
    Path::new(word).exists().then(|| {
        let info = command("info", Path::new(word), &RecordingOptions::default(), &[]);
        format!("the subcommand comes first, for example: {info}")
    })
}

/// A command without its board: shows how to write one.
fn without_board(error: &clap::Error) -> Option<String> {
    let Some(ContextValue::Strings(missing)) = error.get(ContextKind::InvalidArg) else { return None };
    let is_board = missing.iter().any(|argument| argument.starts_with("--board"));
    is_board.then(|| {
        "for example '--board acircles:9x4:55mm:r17.5mm'; 'evcal check RECORDING' recognises the board in a recording".to_owned()
    })
}

/// A description of a board that cannot be read.
fn wrong_board(error: &clap::Error) -> Option<String> {
    let option = error.get(ContextKind::InvalidArg)?.to_string();
    let value = error.get(ContextKind::InvalidValue)?.to_string();
    option.starts_with("--board").then(|| board_request(&value).err()?.remedy(&Words::PROGRAM))?
}

/// Options of Kalibr, a board without `--board`, and negative numbers.
fn other_program(error: &clap::Error) -> Option<String> {
    let Some(ContextValue::String(refused)) = error.get(ContextKind::InvalidArg) else { return None };
    let tip = match refused.as_str() {
        "--bag" | "--bags" => "the recording has no option in front: 'evcal calibrate RECORDING'".to_owned(),
        "--target" | "--target-yaml" => "the board is given as '--board acircles:9x4:55mm:r17.5mm'".to_owned(),
        "--topic" | "--topics" => "the topic of a bag is given with '--stream TOPIC'".to_owned(),
        "--models" => "the camera model is given with '--model'".to_owned(),
        board if board.parse::<Board>().is_ok() => format!("the board is given as '--board {board}'"),
        number if number.starts_with('-') && number.chars().nth(1).is_some_and(|letter| letter.is_ascii_digit()) => {
            format!("is '{number}' a value below 0? This one has to be above 0, for example 6s")
        }
        _ => return None,
    };
    Some(tip)
}

/// A long option with one hyphen, such as `-board`, which clap reports as `-b`.
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

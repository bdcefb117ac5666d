//! Printing to standard output, whose reader may close the pipe early (`evcal info … | head`), and to standard error. Control characters from
//! files never reach a terminal: see [`visible`].

use std::borrow::Cow;
use std::fmt::Display;
use std::io::{self, ErrorKind, IsTerminal as _, Write};

use evcal_files::visible;
use serde::Serialize;

use super::Failure;

/// Prints `text` and a line end, with lines no longer than a terminal is wide. A closed pipe is not an error.
pub fn line(text: impl Display) -> super::Outcome {
    styled(visible::lines(&text.to_string()))
}

/// Prints as [`line`] does, but keeps colours of the program. Untrusted parts of `text` must have been made [`visible`] before.
pub fn styled(text: impl Display) -> super::Outcome {
    let mut output = io::stdout().lock();
    let text = text.to_string();
    written(writeln!(output, "{}", wrapped(&text, width(output.is_terminal()))))
}

/// Returns the width of the terminal; nothing if the output is a file or a pipe.
fn width(is_terminal: bool) -> Option<usize> {
    let (width, _) = terminal_size::terminal_size().filter(|_| is_terminal)?;
    Some(usize::from(width.0)).filter(|width| *width >= NARROWEST)
}

/// Width of a terminal below which lines are left as they are.
const NARROWEST: usize = 40;
/// Beginning of a line with a command to copy, which stays in one piece.
const COMMAND: &str = "next: ";
/// Columns in which the text after a label may begin.
const LABELS: std::ops::Range<usize> = 4..20;

/// Largest number of characters of a line. Longer ones quote a file, such as a name of 100 kB.
const LONGEST: usize = 4000;
/// Number of characters at the end of a longer line that are printed, too.
const END: usize = 500;

/// Returns `line` without its middle if it is very long.
fn shortened(line: &str) -> Cow<'_, str> {
    let count = if line.len() > LONGEST { line.chars().count() } else { 0 };
    if count <= LONGEST {
        return Cow::Borrowed(line);
    }
    let place = |number: usize| line.char_indices().nth(number).map_or(line.len(), |(place, _)| place);
    let (start, end) = (&line[..place(LONGEST - END)], &line[place(count - END)..]);
    Cow::Owned(format!("{start} [... {} characters ...] {end}", count - LONGEST))
}

/// Returns `text` with its lines wrapped at `width`. What continues a line is indented further than the line, or as the text after its
/// label is.
fn wrapped(text: &str, width: Option<usize>) -> Cow<'_, str> {
    let Some(width) = width else {
        return match text.len() > LONGEST {
            true => Cow::Owned(text.split('\n').map(shortened).collect::<Vec<_>>().join("\n")),
            false => Cow::Borrowed(text),
        };
    };
    let fit = |line: &str| {
        if line.trim_start().starts_with(COMMAND) {
            return line.to_owned();
        }
        let indentation = " ".repeat(indentation(line));
        textwrap::fill(
            &shortened(line),
            textwrap::Options::new(width).subsequent_indent(&indentation).break_words(false),
        )
    };
    Cow::Owned(text.split('\n').map(fit).collect::<Vec<_>>().join("\n"))
}

/// Returns the indentation of what continues a line.
fn indentation(line: &str) -> usize {
    let start = line.chars().take_while(|letter| *letter == ' ').count();
    let after_label = line.char_indices().skip(start).map(|(at, _)| at).find(|at| line[*at..].starts_with("  "));
    let text = after_label.map(|at| at + line[at..].chars().take_while(|letter| *letter == ' ').count());
    text.filter(|column| LABELS.contains(column)).unwrap_or(start + 2)
}

/// Prints `value` as JSON on one line.
pub fn json(value: &impl Serialize) -> super::Outcome {
    whole(&serde_json::to_string(value).map_err(Failure::plain)?)
}

/// Prints `value` as JSON on several lines.
pub fn pretty(value: &impl Serialize) -> super::Outcome {
    whole(&serde_json::to_string_pretty(value).map_err(Failure::plain)?)
}

/// Prints text for programs, such as JSON, and a line end.
pub fn whole(text: &str) -> super::Outcome {
    written(writeln!(io::stdout().lock(), "{}", visible::lines(text)))
}

/// Prints `text` without adding a line end. Control characters are escaped only if standard output is a terminal. A
/// closed pipe is not an error.
pub fn text(text: &str) -> super::Outcome {
    let mut output = io::stdout().lock();
    written(match output.is_terminal() {
        true => output.write_all(visible::lines(text).as_bytes()),
        false => output.write_all(text.as_bytes()),
    })
}

fn written(written: io::Result<()>) -> super::Outcome {
    match written {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => Err(Failure::plain(format!("standard output: {error}"))),
        _ => Ok(()),
    }
}

/// Prints a message on standard error; ignores errors.
pub fn aside(text: impl Display) {
    detail(format_args!("evcal: {text}"));
}

/// Prints a line that continues the previous message on standard error.
pub fn detail(text: impl Display) {
    let mut output = io::stderr().lock();
    let text = visible::lines(&text.to_string()).into_owned();
    let _ = writeln!(output, "{}", wrapped(&text, width(output.is_terminal())));
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings with a text of 100 kB were quoted whole.
    #[test]
    fn very_long_lines_are_cut_in_their_middle() {
        let text = format!("invalid value {}: give a number\nthe next line", "µ".repeat(100_000));
        let cut = wrapped(&text, None);
        assert!(cut.starts_with("invalid value µµ") && cut.ends_with("µ: give a number\nthe next line"));
        assert!(cut.contains("[... 96029 characters ...]") && cut.chars().count() < LONGEST + 100, "{cut}");
        assert!(wrapped(&text, Some(80)).len() < 3 * LONGEST);
    }

    #[test]
    fn lines_fit_the_terminal_and_commands_stay_in_one_piece() {
        let text = "Good: expected projection error below 0.025 px over the sensor\n  warning: a long sentence about the board that goes on\n  next: evcal check recording.raw --board acircles:9x4:55mm:r17.5mm";
        let expected = "Good: expected projection error below\n  0.025 px over the sensor\n  warning: a long sentence about the board\n    that goes on\n  next: evcal check recording.raw --board acircles:9x4:55mm:r17.5mm";
        assert_eq!(wrapped(text, Some(42)), expected);
        assert_eq!(wrapped(text, None), text);
        let check =
            "file        recording.raw\nnote        times are taken for microseconds, because they are whole numbers";
        let expected = "file        recording.raw\nnote        times are taken for\n            microseconds, because they\n            are whole numbers";
        assert_eq!(wrapped(check, Some(40)), expected);
        // Colours have no width.
        assert_eq!(
            wrapped("\x1b[32mGood: the board is flat and was seen\x1b[0m", Some(40)),
            "\x1b[32mGood: the board is flat and was seen\x1b[0m"
        );
    }
}

//! Text from outside (names of files, cameras and topics, lines of settings) as it may be shown on a terminal: control characters
//! would move its cursor, change its colours or title, or fake a line of the program.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::path::Path;

/// `text` with its control characters written as `\u001b`, except line ends and tabs.
pub fn lines(text: &str) -> Cow<'_, str> {
    escaped(text, |letter| is_control(letter) && !matches!(letter, '\n' | '\t'))
}

/// `name` with all its control characters written as `\u000a`: it stays on one line.
pub fn name(name: &str) -> Cow<'_, str> {
    escaped(name, is_control)
}

/// A path as [`name`] shows it.
pub fn path(path: impl AsRef<Path>) -> String {
    name(&path.as_ref().to_string_lossy()).into_owned()
}

/// Control characters, and those that turn the direction of what follows.
fn is_control(letter: char) -> bool {
    letter.is_control() || matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{2028}' | '\u{2029}')
}

/// In the form that JSON has for them, too.
fn escaped(text: &str, is_escaped: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_escaped) {
        return Cow::Borrowed(text);
    }
    let mut escaped = String::with_capacity(text.len() + 16);
    for letter in text.chars() {
        if is_escaped(letter) {
            // Writing into a String cannot fail.
            let _ = write!(escaped, "\\u{:04x}", u32::from(letter));
        } else {
            escaped.push(letter);
        }
    }
    Cow::Owned(escaped)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_shown_and_all_else_stays() {
        assert_eq!(lines("plain ä µ\n\tσ"), "plain ä µ\n\tσ");
        assert_eq!(lines("\u{1b}]0;x\u{7}a\rb\u{9b}31m\u{7f}\n"), "\\u001b]0;x\\u0007a\\u000db\\u009b31m\\u007f\n");
        assert_eq!(name("a\nb\tc"), "a\\u000ab\\u0009c");
        assert_eq!(path(Path::new("dir/\u{202e}vsc.txt")), "dir/\\u202evsc.txt");
        assert!(matches!(name("plain"), Cow::Borrowed(_)));
    }
}

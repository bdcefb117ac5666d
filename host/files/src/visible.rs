//! Escaping of untrusted text (names of files, cameras and topics, lines of settings) for a terminal. Control
//! characters could move the cursor, change colours or the title, or imitate output of the program.

use std::borrow::Cow;
use std::fmt::Write as _;
use std::path::Path;

/// Returns `text` with control characters written like `\u001b`, except line ends and tabs.
pub fn lines(text: &str) -> Cow<'_, str> {
    escaped(text, |letter| is_control(letter) && !matches!(letter, '\n' | '\t'))
}

/// Returns `name` with all control characters, including line ends, written like `\u000a`.
pub fn name(name: &str) -> Cow<'_, str> {
    escaped(name, is_control)
}

/// Returns a path as text, escaped like [`name`].
pub fn path(path: impl AsRef<Path>) -> String {
    name(&path.as_ref().to_string_lossy()).into_owned()
}

/// `true` for control characters and for characters that change the direction of text.
fn is_control(letter: char) -> bool {
    letter.is_control() || matches!(letter, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{2028}' | '\u{2029}')
}

/// Escapes characters as in JSON.
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
    fn control_characters_are_escaped_and_other_text_is_unchanged() {
        assert_eq!(lines("plain ä µ\n\tσ"), "plain ä µ\n\tσ");
        assert_eq!(lines("\u{1b}]0;x\u{7}a\rb\u{9b}31m\u{7f}\n"), "\\u001b]0;x\\u0007a\\u000db\\u009b31m\\u007f\n");
        assert_eq!(name("a\nb\tc"), "a\\u000ab\\u0009c");
        assert_eq!(path(Path::new("dir/\u{202e}vsc.txt")), "dir/\\u202evsc.txt");
        assert!(matches!(name("plain"), Cow::Borrowed(_)));
    }
}

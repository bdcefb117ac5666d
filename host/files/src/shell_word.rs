//! Quoting of words in a command line that the user can copy.

/// Returns `word` as a shell reads it, in quotes if necessary.
pub fn shell_word(word: &str) -> String {
    let plain = |letter: char| letter.is_alphanumeric() || "-_./:=,+@%".contains(letter);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_special_characters_are_quoted() {
        assert_eq!(shell_word("a/b-1.dvraw"), "a/b-1.dvraw");
        assert_eq!(shell_word("my recording.dvraw"), "'my recording.dvraw'");
        assert_eq!(shell_word("it's"), r"'it'\''s'");
    }
}

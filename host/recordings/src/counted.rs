//! Numbers with the noun that they count, in messages.

/// Returns `count` followed by `one` or `many`, which may contain more of the sentence: `2 events are`.
pub fn counted(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_count_of_one_is_singular() {
        let texts = [0, 1, 2].map(|count| counted(count, "event is", "events are"));
        assert_eq!(texts, ["0 events are", "1 event is", "2 events are"]);
    }
}

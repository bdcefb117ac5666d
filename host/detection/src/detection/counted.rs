//! Formatting of a number with its noun.

/// Formats `count` followed by `one` or `many`, which may continue the sentence: `2 events are`.
pub fn counted(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

//! A number with what it counts, in a sentence.

/// `count` with `one` or `many` behind it, which may be whole parts of a sentence: `2 events are`.
pub fn counted(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

//! A number with what it counts, in a sentence.

/// `count` with `one` or `many` behind it, which may be whole parts of a sentence: `2 events are`.
pub fn counted(count: u64, one: &str, many: &str) -> String {
    format!("{count} {}", if count == 1 { one } else { many })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_one_is_singular() {
        let told = [0, 1, 2].map(|count| counted(count, "event is", "events are"));
        assert_eq!(told, ["0 events are", "1 event is", "2 events are"]);
    }
}

//! Strongly correlated parameters, by name.

/// Absolute correlation from which a pair is reported.
const STRONG: f64 = 0.9;

/// Names of the pose parameters, which come first.
pub(super) const POSE_NAMES: [&str; 6] = [
    "rotation about x",
    "rotation about y",
    "rotation about z",
    "position along x",
    "position along y",
    "position along z",
];

/// Returns a sentence on each pair of strongly correlated parameters; `names` belong to the rows.
pub(super) fn correlated<'a>(
    rows: impl IntoIterator<Item = &'a [f64]>,
    names: impl Iterator<Item = &'static str> + Clone,
) -> Vec<String> {
    let mut pairs = Vec::new();
    for (row, (values, other)) in rows.into_iter().zip(names.clone()).enumerate() {
        let of_row = values.iter().take(row).zip(names.clone());
        let strong = of_row.filter(|(value, _)| value.abs() > STRONG);
        pairs.extend(strong.map(|(value, one)| format!("{one} and {other} are correlated by {value:.2}")));
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_strong_pair_is_named_once() {
        let rows = [[1.0, 0.95, 0.1], [0.95, 1.0, -0.99], [0.1, -0.99, 1.0]];
        let pairs = correlated(rows.iter().map(<[f64; 3]>::as_slice), ["a", "b", "c"].into_iter());
        assert_eq!(pairs, ["a and b are correlated by 0.95", "b and c are correlated by -0.99"]);
    }
}

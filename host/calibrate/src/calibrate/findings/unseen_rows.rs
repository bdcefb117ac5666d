//! Detection of rows and columns of the board that were never found: it may have fewer than stated.

use std::collections::BTreeSet;

use evcal_core::pattern::Pattern;

use crate::advice::Advice;
use crate::quality::verdict::{Cause, Finding, Severity};
use evcal_detection::circles::reference_frame::ReferenceFrame;

/// Fewest reference frames for the check.
const FEWEST: usize = 100;

/// Returns a note if `frames` never have a circle of the first or last rows or columns of `pattern`.
pub(in crate::calibrate) fn finding_on(pattern: Pattern, frames: &[ReferenceFrame]) -> Option<Finding> {
    let columns = usize::from(pattern.columns);
    let indices = || frames.iter().flat_map(|frame| &frame.circles).map(|circle| circle.index);
    let rows = indices().map(|index| index / columns).collect::<BTreeSet<_>>().len();
    let seen_columns = indices().map(|index| index % columns).collect::<BTreeSet<_>>().len();
    let all = (usize::from(pattern.rows), columns);
    (frames.len() >= FEWEST && (rows, seen_columns) != all).then(|| Finding {
        cause: Cause::PartOfBoard,
        severity: Severity::Note,
        reason: format!(
            "of the {}x{} rows and columns of the board only {rows}x{seen_columns} were ever found",
            all.0, all.1
        ),
        advice: Advice::CountRows,
    })
}

#[cfg(test)]
mod tests {
    use evcal_core::pattern::Layout;
    use nalgebra::Vector2;

    use super::*;
    use evcal_detection::circles::reference_frame::{ObservedCircle, SeenIn};

    #[test]
    fn rows_that_were_never_found_are_reported() {
        let board = |rows| Pattern { layout: Layout::Asymmetric, rows, columns: 4 };
        let circle = |index| ObservedCircle { index, t: 0.0, center: Vector2::zeros(), radius: None, velocity: None };
        let frame = ReferenceFrame {
            recording: 0,
            start: 0.0,
            end: 0.0,
            circles: (0..36).map(circle).collect(),
            seen_in: SeenIn::PassedEvents,
        };
        let frames = vec![frame; FEWEST];
        assert_eq!(finding_on(board(9), &frames), None);
        assert_eq!(finding_on(board(11), &frames[1..]), None);
        let reason = finding_on(board(11), &frames).unwrap().reason;
        assert_eq!(reason, "of the 11x4 rows and columns of the board only 9x4 were ever found");
    }
}

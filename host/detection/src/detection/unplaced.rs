//! Windows with more circles than the board and without a position on it: the board may be larger than stated.
//!
//! If a lattice continues next to the stated board, the board fits several positions, or none, and the grid finder rejects it.
//! The fullest such window of each chunk is kept.

use evcal_core::pattern::Pattern;

use crate::circles::reference_frame::{ReferenceFrame, UnorderedFrame};

/// Largest number of windows of a recording that are kept.
const MOST: usize = 256;

/// The windows of one recording.
#[derive(Clone, Debug, PartialEq)]
pub struct UnplacedWindows {
    /// Index of the recording.
    pub(super) recording: usize,
    /// Number of chunks with such a window.
    pub(super) chunks: usize,
    /// Number of chunks without one, but with one that shows all of the stated board.
    pub(super) with_whole_board: usize,
    /// Number of chunks of which one window is kept.
    every: usize,
    pub(super) kept: Vec<UnorderedFrame>,
}

impl UnplacedWindows {
    /// Creates an empty list for recording number `recording`.
    pub fn new(recording: usize) -> Self {
        Self { recording, chunks: 0, with_whole_board: 0, every: 1, kept: Vec::new() }
    }

    /// Adds the fullest unplaced window of the next chunk. `as_stated` is `true` if the chunk shows all of the stated
    /// board.
    pub(super) fn take(&mut self, fullest: Option<UnorderedFrame>, shows_whole_board: bool) {
        let Some(window) = fullest else {
            self.with_whole_board += usize::from(shows_whole_board);
            return;
        };
        if self.chunks.is_multiple_of(self.every) {
            self.kept.push(window);
        }
        self.chunks += 1;
        if self.kept.len() > MOST {
            self.every *= 2;
            let mut place = 0;
            self.kept.retain(|_| {
                place += 1;
                place % 2 == 1
            });
        }
    }
}

/// Returns `true` if at least half of the circles of each row and of each column of `pattern` are there.
pub(super) fn is_whole(frame: &ReferenceFrame, pattern: Pattern) -> bool {
    let (rows, columns) = (usize::from(pattern.rows), usize::from(pattern.columns).max(1));
    let (mut in_rows, mut in_columns) = (vec![0; rows], vec![0; columns]);
    for circle in &frame.circles {
        for count in [in_rows.get_mut(circle.index / columns), in_columns.get_mut(circle.index % columns)] {
            count.into_iter().for_each(|count| *count += 1);
        }
    }
    in_rows.iter().all(|count| 2 * count >= columns) && in_columns.iter().all(|count| 2 * count >= rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_recordings_keep_windows_over_their_whole_length() {
        let mut windows = UnplacedWindows::new(0);
        let window = |start| UnorderedFrame { start, end: start + 0.01, circles: Vec::new() };
        (0..2000).for_each(|chunk| windows.take(Some(window(f64::from(chunk))), false));
        assert_eq!((windows.chunks, windows.every), (2000, 8));
        let starts = windows.kept.iter().map(|window| window.start);
        assert!(starts.eq((0..2000).step_by(8).map(f64::from)));
    }
}

//! Detection of a board that is larger than stated: larger boards are tried on the windows in which the stated one has no
//! position.
//!
//! A window counts for a larger board only if at least half of each of its rows and columns is there, because clutter does not
//! form rows.

use std::cmp::Reverse;

use evcal_core::pattern::Pattern;
use evcal_core::sensor::Sensor;

use super::layout::most_fitting;
use crate::circles::reference_frame::{ReferenceFrame, UnorderedFrame};
use crate::detection::order_frames;
use crate::detection::unplaced::{UnplacedWindows, is_whole};

/// Number of windows on which all larger boards are tried.
const FIRST_SAMPLE: usize = 6;
/// Approximate number of windows on which the best of them is tried.
const SAMPLE: usize = 40;
/// Fewest windows with a larger board for a decision.
const FEWEST: usize = 5;
/// Largest number of additional rows and columns that are tried.
const MOST_MORE: u8 = 3;
/// Largest number of circles of a board, relative to the fullest windows.
const NEARLY_WHOLE: f64 = 1.1;

/// A board that contains the stated one.
#[derive(Clone, Debug, PartialEq)]
pub struct LargerPattern {
    /// Its layout.
    pub pattern: Pattern,
    /// Windows that show all of the board.
    pub frames: Vec<ReferenceFrame>,
}

/// Returns the board that contains `stated`, if most chunks that show all of the stated board show all of the larger one.
pub fn larger_pattern(recordings: &[UnplacedWindows], stated: Pattern, sensor: Sensor) -> Option<LargerPattern> {
    let chunks: usize = recordings.iter().map(|windows| windows.chunks).sum();
    let all = chunks + recordings.iter().map(|windows| windows.with_whole_board).sum::<usize>();
    // Usually it ends here: nothing is tried if the board is as stated.
    if chunks < FEWEST || 2 * chunks <= all {
        return None;
    }
    let kept: usize = recordings.iter().map(|windows| windows.kept.len()).sum();
    let first = recordings.iter().flat_map(|windows| &windows.kept).step_by(kept.div_ceil(FIRST_SAMPLE).max(1));
    let first: Vec<UnorderedFrame> = first.cloned().collect();
    let most = first.iter().map(|window| window.circles.len()).max()? as f64 * NEARLY_WHOLE;
    let tried = larger(stated).into_iter().filter(|pattern| pattern.circle_count() as f64 <= most);
    let pattern = most_fitting(&first, tried, sensor)?;
    let (mut examined, mut frames) = (0, Vec::new());
    for UnplacedWindows { recording, kept: windows, .. } in recordings {
        let sample: Vec<UnorderedFrame> = windows.iter().step_by(kept.div_ceil(SAMPLE).max(1)).cloned().collect();
        examined += sample.len();
        let (found, _) = order_frames(&sample, &pattern, Some(sensor));
        let whole = found.into_iter().filter(|frame| is_whole(frame, pattern));
        frames.extend(whole.map(|frame| ReferenceFrame { recording: *recording, ..frame }));
    }
    // `true` if most of all chunks show the board, extrapolated from the examined ones.
    let most = 2 * frames.len() * chunks > examined * all;
    (frames.len() >= FEWEST && most).then_some(LargerPattern { pattern, frames })
}

/// Returns boards that contain `stated`, the smallest first: if several fit equally well, the first one is taken.
fn larger(stated: Pattern) -> Vec<Pattern> {
    let more = |count: u8| count..=count.saturating_add(MOST_MORE);
    let boards = more(stated.rows)
        .flat_map(|rows| more(stated.columns).map(move |columns| Pattern { rows, columns, ..stated }))
        .filter(|pattern| *pattern != stated);
    let mut boards: Vec<Pattern> = boards.collect();
    // A symmetric board rotated by 90° fits as well. The board whose rows and columns grow more evenly comes first, then the one
    // with more rows.
    boards.sort_by_key(|pattern| {
        let sides_more = [pattern.rows - stated.rows, pattern.columns - stated.columns];
        (pattern.circle_count(), sides_more.into_iter().max(), Reverse(pattern.rows))
    });
    boards
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector2;

    use super::*;
    use crate::circles::reference_frame::UnorderedCircle;
    use evcal_geometry::board::CircleBoard;

    const SENSOR: Sensor = Sensor::new(346, 260);

    fn pattern(text: &str) -> Pattern {
        format!("{text}:55mm:r17.5mm").parse::<CircleBoard>().unwrap().pattern
    }

    /// A window that shows these lattice positions of a tilted board, and two more circles.
    fn window(view: u32, places: impl Iterator<Item = (i32, i32)>) -> UnorderedFrame {
        let part = f64::from(view) / 40.0;
        let (sin, cos) = (0.6 * (part - 0.5)).sin_cos();
        let circle = |center| UnorderedCircle { t: part, center, radius: Some(5.0), velocity: None };
        let seen = places.map(|(x, y)| {
            let point = 18.0 * Vector2::new(f64::from(x) - 3.5, f64::from(y) - 4.0);
            let turned = Vector2::new(cos * point.x - sin * point.y, sin * point.x + cos * point.y);
            let nearer = 1.0 + 0.002 * (part - 0.3) * turned.x + 0.0007 * turned.y;
            circle(turned / nearer + Vector2::new(173.0, 130.0))
        });
        let clutter = [Vector2::new(12.0 + f64::from(view), 9.0), Vector2::new(330.0, 240.0)].map(circle);
        UnorderedFrame { start: part, end: part + 0.01, circles: seen.chain(clutter).collect() }
    }

    fn whole(view: u32, pattern: Pattern) -> UnorderedFrame {
        window(view, (0..pattern.circle_count()).map(|index| pattern.lattice_position(index)))
    }

    /// Returns the result for a recording with `larger` windows of this board and `with_whole_board` chunks of the stated one.
    fn found_pattern(stated: &str, board: &str, larger: u32, with_whole_board: u32) -> Option<(Pattern, usize)> {
        let mut windows = UnplacedWindows::new(3);
        (0..larger).for_each(|view| windows.take(Some(whole(view % 40, pattern(board))), true));
        (0..with_whole_board).for_each(|_| windows.take(None, true));
        let found = larger_pattern(&[UnplacedWindows::new(0), windows], pattern(stated), SENSOR)?;
        assert!(found.frames.iter().all(|frame| frame.recording == 3));
        Some((found.pattern, found.frames.len()))
    }

    #[test]
    fn the_larger_board_is_found() {
        for (stated, board) in [
            ("acircles:8x4", "acircles:9x4"),
            ("acircles:7x4", "acircles:9x4"),
            ("acircles:9x3", "acircles:9x4"),
            ("acircles:9x4", "acircles:10x4"),
            ("circles:6x5", "circles:7x5"),
            ("circles:5x6", "circles:5x7"),
            ("circles:5x5", "circles:7x6"),
        ] {
            let (found, windows) = found_pattern(stated, board, 20, 10).unwrap();
            assert_eq!(found, pattern(board), "{stated} of {board}");
            assert!(windows >= 18, "{stated} of {board}: {windows} windows");
        }
    }

    #[test]
    fn a_larger_board_in_few_windows_is_not_reported() {
        assert_eq!(found_pattern("acircles:8x4", "acircles:9x4", 20, 20), None);
        assert_eq!(found_pattern("acircles:8x4", "acircles:9x4", 4, 0), None);
        assert_eq!(found_pattern("acircles:8x4", "acircles:9x4", 0, 0), None);
    }

    #[test]
    fn clutter_next_to_the_stated_board_is_not_a_larger_one() {
        for (stated, clutter) in [
            // One or two circles of clutter at the positions that one more row or column would have.
            ("acircles:9x4", &[(1, 9)][..]),
            ("acircles:9x4", &[(8, 4)]),
            ("circles:7x6", &[(1, 7), (4, 7)]),
        ] {
            let stated = pattern(stated);
            let places = || (0..stated.circle_count()).map(|index| stated.lattice_position(index));
            let mut windows = UnplacedWindows::new(0);
            (0..30).for_each(|view| windows.take(Some(window(view, places().chain(clutter.iter().copied()))), true));
            assert_eq!(larger_pattern(&[windows], stated, SENSOR), None, "{stated:?} {clutter:?}");
        }
    }
}

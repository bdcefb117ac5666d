//! Runs of core pixels, and the union-find that joins them to clusters.

use super::bitmap::MARGIN;
use super::neighbourhood::Neighbourhood;
use heapless::Vec;

/// No run, or no cluster.
pub(super) const NONE: u16 = u16::MAX;

/// A run of neighbouring pixels of one cluster.
#[derive(Clone, Copy, Debug)]
pub(super) struct Run {
    /// Leftmost column.
    pub(super) x: u16,
    /// Row.
    pub(super) y: u16,
    /// Number of pixels, at least 1.
    pub(super) length: u16,
    /// While clusters grow: an earlier run of the same cluster, or the run itself if it is the first.
    /// Afterwards: the number of the cluster, or [`NONE`].
    pub(super) label: u16,
    /// While clusters are counted: the number of pixels, in the first run of a cluster.
    /// Afterwards: another run of the cluster, or [`NONE`].
    pub(super) next: u16,
}

impl Run {
    /// Rightmost column.
    #[inline(always)]
    pub(super) const fn last(&self) -> u16 {
        self.x.saturating_add(self.length.saturating_sub(1))
    }
}

/// Appends the runs of a word of core pixels that starts at `(x, y)`; `first` is the first run of the row.
///
/// A run within `reach` of the one before it in the row joins its cluster, and continues it if they
/// touch. Returns the number of pixels for which there was no room.
pub(super) fn push_core_runs<const RUNS: usize>(
    runs: &mut Vec<Run, RUNS>,
    first: usize,
    (word_x, y): (usize, u16),
    mut word: u32,
    reach: usize,
) -> u32 {
    while word != 0 {
        let start = word.trailing_zeros();
        let length = (word >> start).trailing_ones();
        let x = word_x as u16 + start as u16;
        let index = runs.len();
        let mut label = index as u16;
        if index > first
            && let Some(previous) = runs.last_mut()
        {
            let gap = x - previous.last();
            if gap == 1 {
                previous.length += length as u16;
                word &= !run_mask(start, length);
                continue;
            }
            if usize::from(gap) <= reach {
                label = previous.label;
            }
        }
        if runs.push(Run { x, y, length: length as u16, label, next: NONE }).is_err() {
            return word.count_ones();
        }
        word &= !run_mask(start, length);
    }
    0
}

/// `length` ones from bit `start`, for 1 ≤ length and start + length ≤ 32.
const fn run_mask(start: u32, length: u32) -> u32 {
    (u32::MAX >> (32 - length)) << start
}

/// The rows above the current one that its neighbourhoods reach.
#[derive(Default)]
pub(super) struct RecentRows {
    rows: [RowRuns; MARGIN],
}

/// The runs `first..end` of row `y`.
#[derive(Clone, Copy, Default)]
struct RowRuns {
    y: u16,
    first: u16,
    end: u16,
}

impl RecentRows {
    /// Joins the runs of row `y`, from `first` to the last, with those above them within reach.
    pub(super) fn join(&mut self, runs: &mut [Run], y: u16, first: usize, neighbourhood: &Neighbourhood) {
        if first == runs.len() {
            return;
        }
        let current = RowRuns { y, first: first as u16, end: runs.len() as u16 };
        for above in &self.rows {
            let dy = usize::from(y - above.y);
            if above.first == above.end || dy > neighbourhood.radius() {
                break;
            }
            join_rows(runs, *above, current, neighbourhood.half_width(dy) as u16);
        }
        self.rows.rotate_right(1);
        if let Some(newest) = self.rows.first_mut() {
            *newest = current;
        }
    }
}

/// Joins the runs of two rows that lie within `reach` columns of each other.
fn join_rows(runs: &mut [Run], above: RowRuns, below: RowRuns, reach: u16) {
    let (mut upper, mut lower) = (above.first, below.first);
    while upper < above.end && lower < below.end {
        let (Some(one), Some(two)) = (runs.get(usize::from(upper)), runs.get(usize::from(lower))) else { return };
        let (one_last, two_last) = (one.last(), two.last());
        let near = two.x <= one_last.saturating_add(reach) && one.x <= two_last.saturating_add(reach);
        if near && one.label != two.label {
            union(runs, upper, lower);
        }
        // The run that ends first can reach no further run of the other row that the other run does
        // not reach within its own row.
        if one_last < two_last {
            upper += 1;
        } else {
            lower += 1;
        }
    }
}

/// Joins the clusters of two runs; the earlier first run becomes the first run of both.
fn union(runs: &mut [Run], one: u16, two: u16) {
    let (one, two) = (find(runs, one), find(runs, two));
    if let Some(later) = runs.get_mut(usize::from(one.max(two))) {
        later.label = one.min(two);
    }
}

/// The first run of a run's cluster. Shortens the way there.
fn find(runs: &mut [Run], run: u16) -> u16 {
    let mut current = run;
    loop {
        let label = runs.get(usize::from(current)).map_or(current, |run| run.label);
        if label == current {
            return current;
        }
        let ahead = runs.get(usize::from(label)).map_or(label, |run| run.label);
        if let Some(run) = runs.get_mut(usize::from(current)) {
            run.label = ahead;
        }
        current = ahead;
    }
}

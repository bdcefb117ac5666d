//! Runs of clustered pixels, and the union-find that joins them to clusters.

use super::bitmap::MARGIN;
use super::neighbourhood::Neighbourhood;
use super::{Cluster, PixelRun};
use core::ops::Range;
use heapless::Vec;
use nalgebra::RealField;

/// Marks the absence of a run or cluster.
pub(super) const NONE: u16 = u16::MAX;

/// Column and row.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    pub(super) x: u16,
    pub(super) y: u16,
}

/// Up to `RUNS` runs of clustered pixels. All zeros when empty.
#[derive(Debug)]
pub(super) struct Runs<const RUNS: usize> {
    runs: Vec<PixelRun, RUNS>,
    /// While clusters grow: an earlier run of the same cluster, or the run itself if it is the first.
    /// Afterwards: the number of the cluster, or [`NONE`].
    labels: [u16; RUNS],
    /// While clusters are counted: the number of pixels, at the first run of a cluster.
    /// Afterwards: another run of the cluster, or [`NONE`].
    next: [u16; RUNS],
}

impl<const RUNS: usize> Runs<RUNS> {
    pub(super) const fn new() -> Self {
        const { assert!(RUNS < NONE as usize, "runs are numbered in 16 bits") };
        Self { runs: Vec::new(), labels: [0; RUNS], next: [0; RUNS] }
    }

    pub(super) fn clear(&mut self) {
        self.runs.clear();
    }

    pub(super) fn len(&self) -> usize {
        self.runs.len()
    }

    /// Appends the runs of a word of core pixels that starts at column `x` of row `y`; `first` is the first run of the
    /// row.
    ///
    /// A run within `reach` of the previous run of the row joins the cluster of that run, and extends it if they touch.
    /// Returns the number of pixels for which there was no room.
    pub(super) fn push_core(&mut self, first: usize, x: usize, y: usize, mut word: u32, reach: usize) -> u32 {
        while word != 0 {
            let start = word.trailing_zeros();
            let length = (word >> start).trailing_ones();
            let run_x = x as u16 + start as u16;
            let last = run_x + (length - 1) as u16;
            let rest = word & !((u32::MAX >> (32 - length)) << start);
            let index = self.runs.len();
            let mut label = index as u16;
            if index > first
                && let Some(previous) = self.runs.last_mut()
            {
                let gap = run_x - previous.last;
                if gap == 1 {
                    previous.last = last;
                    word = rest;
                    continue;
                }
                if usize::from(gap) <= reach {
                    label = self.labels.get(index - 1).copied().unwrap_or(label);
                }
            }
            if !self.push(PixelRun { x: run_x, last, y: y as u16 }, label) {
                return word.count_ones();
            }
            word = rest;
        }
        0
    }

    /// Appends a border pixel to the cluster of the core pixel `core`, whose run is one of `core_runs`. Returns `false`
    /// if there was no room for either pixel.
    pub(super) fn push_border(&mut self, border: Pixel, core: Pixel, core_runs: Range<usize>) -> bool {
        let first = core_runs.start;
        let runs = self.runs.get(core_runs).unwrap_or(&[]);
        let after = runs.partition_point(|run| (run.y, run.x) <= (core.y, core.x));
        let before = after.checked_sub(1).and_then(|before| Some((before, runs.get(before)?)));
        let Some((index, run)) = before else { return false };
        let Some(&label) = self.labels.get(first + index) else { return false };
        let Pixel { x, y } = border;
        run.y == core.y && run.last >= core.x && self.push(PixelRun { x, last: x, y }, label)
    }

    fn push(&mut self, run: PixelRun, label: u16) -> bool {
        let index = self.runs.len();
        if self.runs.push(run).is_err() {
            return false;
        }
        if let Some(place) = self.labels.get_mut(index) {
            *place = label;
        }
        true
    }

    /// Collects the runs from `first` on into clusters of at least `min_pixels`, in the order of their first runs. Of
    /// each cluster only the list of runs is filled in.
    pub(super) fn collect<T: RealField + Copy, const CLUSTERS: usize>(
        &mut self,
        first: usize,
        min_pixels: u16,
        clusters: &mut Vec<Cluster<T>, CLUSTERS>,
    ) -> Dropped {
        let Self { runs, labels, next } = self;
        for (index, run) in runs.iter().enumerate().skip(first) {
            // Labels point backwards, so the label of an earlier run already is the first run of its cluster.
            let earlier = labels.get(index).copied().unwrap_or(NONE);
            let root = labels.get(usize::from(earlier)).copied().unwrap_or(NONE);
            if let (Some(label), Some(pixels)) = (labels.get_mut(index), next.get_mut(index)) {
                *label = root;
                *pixels = 0;
            }
            if let Some(pixels) = next.get_mut(usize::from(root)) {
                *pixels = pixels.saturating_add(run.length());
            }
        }
        let mut dropped = Dropped::default();
        for index in first..runs.len() {
            let root = labels.get(index).copied().unwrap_or(NONE);
            let mut number = labels.get(usize::from(root)).copied().unwrap_or(NONE);
            let Some(next) = next.get_mut(index) else { continue };
            if usize::from(root) == index {
                number = NONE;
                if *next < min_pixels {
                    dropped.too_small += 1;
                } else if clusters.push(Cluster::empty()).is_err() {
                    dropped.over_capacity += 1;
                } else {
                    number = (clusters.len() - 1) as u16;
                }
            }
            if let Some(label) = labels.get_mut(index) {
                *label = number;
            }
            if let Some(cluster) = clusters.get_mut(usize::from(number)) {
                *next = core::mem::replace(&mut cluster.first_run, index as u16);
            }
        }
        dropped
    }

    /// Returns the runs of the list that starts with run `first`.
    pub(super) fn list(&self, first: u16) -> PixelRuns<'_> {
        PixelRuns { runs: &self.runs, next: &self.next, current: first }
    }
}

/// Clusters that were not kept.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Dropped {
    pub(super) too_small: u32,
    pub(super) over_capacity: u32,
}

/// The pixels of a cluster, as runs in no particular order.
#[derive(Clone, Debug)]
pub struct PixelRuns<'a> {
    runs: &'a [PixelRun],
    next: &'a [u16],
    current: u16,
}

impl Iterator for PixelRuns<'_> {
    type Item = PixelRun;

    #[inline]
    fn next(&mut self) -> Option<PixelRun> {
        let index = usize::from(self.current);
        let run = self.runs.get(index)?;
        self.current = self.next.get(index).copied().unwrap_or(NONE);
        Some(*run)
    }
}

/// The rows above the current row that its neighbourhoods reach, nearest first.
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

impl RowRuns {
    /// Returns the runs, each with its number.
    fn numbered(self, runs: &[PixelRun]) -> impl Iterator<Item = (u16, &PixelRun)> {
        let row = runs.get(usize::from(self.first)..usize::from(self.end)).unwrap_or(&[]);
        (self.first..).zip(row)
    }
}

impl RecentRows {
    /// Joins the runs of row `y`, from `first` to the last, with the runs above them within reach.
    pub(super) fn join<const RUNS: usize>(
        &mut self,
        runs: &mut Runs<RUNS>,
        y: usize,
        first: usize,
        neighbourhood: &Neighbourhood,
    ) {
        let row = RowRuns { y: y as u16, first: first as u16, end: runs.runs.len() as u16 };
        if row.first == row.end {
            return;
        }
        for above in &self.rows {
            let dy = y.wrapping_sub(usize::from(above.y));
            if above.first == above.end || dy > neighbourhood.radius() {
                break;
            }
            let reach = neighbourhood.half_width(dy);
            join_rows(*above, row, reach, &runs.runs, &mut runs.labels);
        }
        let mut newer = row;
        for older in &mut self.rows {
            core::mem::swap(older, &mut newer);
        }
    }
}

/// Joins the runs of two rows that lie within `reach` columns of each other.
fn join_rows(upper: RowRuns, lower: RowRuns, reach: usize, runs: &[PixelRun], labels: &mut [u16]) {
    let (mut uppers, mut lowers) = (upper.numbered(runs), lower.numbered(runs));
    let (Some(mut one), Some(mut two)) = (uppers.next(), lowers.next()) else { return };
    loop {
        let (one_x, one_last) = (usize::from(one.1.x), usize::from(one.1.last));
        let (two_x, two_last) = (usize::from(two.1.x), usize::from(two.1.last));
        if two_x <= one_last + reach && one_x <= two_last + reach {
            union(labels, one.0, two.0);
        }
        // The run that ends first needs no comparison with further runs of the other row. If one of them is within its
        // reach, that one is also within reach of the present run of the other row, and both are in one cluster
        // already.
        if one_last < two_last {
            let Some(next) = uppers.next() else { return };
            one = next;
        } else {
            let Some(next) = lowers.next() else { return };
            two = next;
        }
    }
}

/// Joins the clusters of a run and of a later run; the earlier first run becomes the first run of both.
fn union(labels: &mut [u16], earlier: u16, later: u16) {
    let (Some(&one), Some(&two)) = (labels.get(usize::from(earlier)), labels.get(usize::from(later))) else { return };
    if one == two {
        return;
    }
    if two == later {
        // `later` is the first run of its cluster; `earlier` belongs to a cluster that starts before it.
        if let Some(label) = labels.get_mut(usize::from(later)) {
            *label = one;
        }
        return;
    }
    let (one, two) = (find(labels, earlier), find(labels, later));
    if let Some(label) = labels.get_mut(usize::from(one.max(two))) {
        *label = one.min(two);
    }
}

/// Returns the first run of a run's cluster. Shortens the chain of labels on the way.
fn find(labels: &mut [u16], run: u16) -> u16 {
    let mut current = run;
    loop {
        let label = labels.get(usize::from(current)).copied().unwrap_or(current);
        if label == current {
            return current;
        }
        let ahead = labels.get(usize::from(label)).copied().unwrap_or(label);
        if let Some(label) = labels.get_mut(usize::from(current)) {
            *label = ahead;
        }
        current = ahead;
    }
}

//! Knots on a grid whose cells are halved where a curve needs it.
//!
//! A segment is divided into cells of nearly the coarsest spacing; each may be halved several times, down to the finest spacing.
//! All knot vectors of a grid are subsets of its finest one, so that a curve on any of them is also a curve on the finest.

use evcal_core::settings;
use evcal_core::settings::at_least;
use serde::{Deserialize, Serialize};

use super::Trajectory;

settings! {
    /// Range of the knot spacing.
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    #[serde(deny_unknown_fields, default)]
    pub struct KnotSettings {
        /// Smallest distance of knots.
        pub finest: f64 = 0.004375, "s", at_least(1e-4);
        /// Largest distance of knots. If it equals `finest`, knots are even whatever the motion.
        pub coarsest: f64 = 0.07, "s", at_least(1e-4);
    }
}

impl KnotSettings {
    /// Returns the grid of knots over the time of `trajectory`.
    pub fn grid(&self, trajectory: &Trajectory) -> KnotGrid {
        KnotGrid::new(trajectory.start(), trajectory.end(), self.finest, self.coarsest)
    }
}

/// The grid of one segment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnotGrid {
    start: f64,
    end: f64,
    cells: usize,
    levels: usize,
}

impl KnotGrid {
    /// Creates the grid from `start` to `end` (s) with spacings from about `coarsest` down to about `finest` (s).
    pub fn new(start: f64, end: f64, finest: f64, coarsest: f64) -> Self {
        /// More halvings are useless.
        const MOST_LEVELS: f64 = 10.0;
        let levels = (coarsest / finest).log2().round().clamp(0.0, MOST_LEVELS) as usize;
        // A float-to-integer cast saturates, and maps NaN to 0.
        let cells = (((end - start) / (finest * (1_u64 << levels) as f64)).round() as usize).max(1);
        Self { start, end, cells, levels }
    }

    /// Returns the largest number of halvings of a cell.
    pub fn levels(&self) -> usize {
        self.levels
    }

    /// Returns the number of spans of the finest knots.
    pub fn finest_spans(&self) -> usize {
        self.cells << self.levels
    }

    /// Returns the level whose spacing is nearest to `spacing` (s): 0 is the finest one.
    pub fn level_of(&self, spacing: f64) -> usize {
        let finest = (self.end - self.start) / self.finest_spans() as f64;
        (spacing / finest).log2().round().clamp(0.0, self.levels as f64) as usize
    }

    /// Returns clamped knots for a curve of `degree`, every span of the same `level`.
    pub fn even(&self, level: usize, degree: usize) -> Vec<f64> {
        self.uneven(&vec![level; self.finest_spans()], degree)
    }

    /// Returns clamped knots for a curve of `degree`. `level_of_span` contains, for each of the finest spans, the level of the
    /// span that contains it.
    pub fn uneven(&self, level_of_span: &[usize], degree: usize) -> Vec<f64> {
        let spans = self.finest_spans();
        let mut knots = vec![self.start; degree + 1];
        let mut place = 0;
        while let Some(&level) = level_of_span.get(place) {
            place += 1 << level.min(self.levels);
            if place < spans {
                knots.push(self.start + (self.end - self.start) * place as f64 / spans as f64);
            }
        }
        knots.extend(std::iter::repeat_n(self.end, degree + 1));
        knots
    }
}

/// Returns, for each of the finest spans, the level of the span that should contain it, so that the total cost is least. `costs`
/// contains, for each level (0 is the finest), the cost of each finest span on even knots of that level; every span of the chosen
/// knots costs `span_cost` in addition. Neighbouring spans differ by at most one level.
pub fn cheapest_levels(costs: &[Vec<f64>], span_cost: f64) -> Vec<usize> {
    let Some(spans) = costs.first().map(Vec::len) else { return Vec::new() };
    let mut levels = vec![0; spans];
    let mut best: Vec<f64> =
        costs.first().map(|costs| costs.iter().map(|cost| cost + span_cost).collect()).unwrap_or_default();
    for (level, costs) in costs.iter().enumerate().skip(1) {
        let cells = costs.chunks(1 << level).zip(best.chunks(2)).zip(levels.chunks_mut(1 << level));
        best = cells
            .map(|((costs, halves), levels)| {
                let (whole, halved) = (costs.iter().sum::<f64>() + span_cost, halves.iter().sum::<f64>());
                if whole <= halved {
                    levels.fill(level);
                }
                whole.min(halved)
            })
            .collect();
    }
    grade(&mut levels);
    levels
}

/// Halves spans until neighbours differ by at most one level.
fn grade(levels: &mut [usize]) {
    let mut changed = true;
    while std::mem::take(&mut changed) {
        let mut place = 0;
        while let Some(&level) = levels.get(place) {
            let end = (place + (1 << level)).min(levels.len());
            let before = place.checked_sub(1).and_then(|before| levels.get(before)).copied().unwrap_or(level);
            let after = levels.get(end).copied().unwrap_or(level);
            if level > before.min(after) + 1 {
                levels.get_mut(place..end).unwrap_or_default().fill(level - 1);
                changed = true;
            }
            place = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_halved_where_the_cost_falls_and_neighbours_differ_by_one_level() {
        // Four cells of eight spans; in the third, only the finest spans follow the curve.
        let costs: Vec<Vec<f64>> = (0..4)
            .map(|level| (0..32).map(|span| if span / 8 == 2 { f64::from(level) * 10.0 } else { 0.0 }).collect())
            .collect();
        let levels = cheapest_levels(&costs, 1.0);
        assert_eq!(&levels[16..24], &[0; 8]);
        assert_eq!(levels[0], 3);
        for pair in levels.windows(2) {
            assert!(pair[0].abs_diff(pair[1]) <= 1, "{levels:?}");
        }
        let grid = KnotGrid::new(1.0, 2.0, 1.0 / 32.0, 0.25);
        assert_eq!((grid.finest_spans(), grid.levels()), (32, 3));
        let knots = grid.uneven(&levels, 3);
        let finest = grid.even(0, 3);
        assert!(knots.iter().all(|knot| finest.contains(knot)));
        assert_eq!((knots[3], knots[knots.len() - 4]), (1.0, 2.0));
        assert!(knots.windows(2).any(|pair| pair[1] - pair[0] > 0.24));
    }

    #[test]
    fn an_even_level_has_its_spacing() {
        let grid = KnotGrid::new(0.0, 1.0, 0.005, 0.08);
        assert_eq!(grid.level_of(0.01), 1);
        let knots = grid.even(2, 3);
        assert_eq!(knots.len(), grid.finest_spans() / 4 + 7);
        assert!((knots[4] - 4.0 / grid.finest_spans() as f64).abs() < 1e-12);
    }
}

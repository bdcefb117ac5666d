//! Which lattice site is which circle of the board.
//!
//! The lattice basis that growth found is any basis of the image's lattice. A placement is an
//! integer matrix of determinant +1 (in lattice steps) that takes it to the board's axes, and a
//! shift. A board holds exactly the lattice points of a rectangle, so the number of points that a
//! placement explains is the number of points in that rectangle.

use heapless::Vec;
use nalgebra::{Matrix2, RealField, Vector2};

use super::lattice::Lattice;
use super::points::Points;
use super::warp::Warp;
use crate::pattern::{Layout, Pattern};

/// Entries of the change of basis run from -this to this.
const LARGEST_ENTRY: i32 = 2;
/// The board's axes are those that make it a square lattice in space: its scales along two axes are
/// equal but for this factor. For any other axes they differ by 2.6 or more.
const LARGEST_SHEAR: f64 = 1.6;
/// Extent of a lattice in board units that can be handled.
const EXTENT: usize = 192;

/// Maps lattice site (u, v) to the board's lattice position `axes` · (u, v) − `origin`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Placement {
    axes: [[i32; 2]; 2],
    origin: (i32, i32),
    /// Number of points that fall on circles of the board.
    pub inside: usize,
    /// Number of points that fall beside the board.
    pub outside: usize,
    /// Number of points that the next best placement explains.
    pub runner_up: usize,
}

impl Placement {
    /// Index of the circle on the board.
    pub fn circle(&self, pattern: &Pattern, u: i8, v: i8) -> Option<usize> {
        let (x, y) = apply(&self.axes, i32::from(u), i32::from(v));
        pattern.index_at(x - self.origin.0, y - self.origin.1)
    }
}

/// Number of quarter or half turns that map the board onto itself: 1, 2 or 4.
pub(super) fn turns_of(pattern: &Pattern) -> usize {
    match pattern.layout {
        Layout::Symmetric if pattern.rows == pattern.columns => 4,
        Layout::Symmetric => 2,
        Layout::Asymmetric if pattern.rows % 2 == 0 => 2,
        Layout::Asymmetric => 1,
    }
}

/// Largest lattice position of the board in x and y.
pub(super) fn extent_of(pattern: &Pattern) -> (i32, i32) {
    let columns = i32::from(pattern.columns.max(1));
    let width = match pattern.layout {
        Layout::Asymmetric => 2 * columns - 1,
        Layout::Symmetric => columns - 1,
    };
    (width, i32::from(pattern.rows.max(1)) - 1)
}

/// The placement that explains most points. Of the turns that map the board onto itself, the one
/// whose first circle lies nearest to the top left of the image is taken.
pub(super) fn place<T: RealField + Copy, const N: usize>(
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    warp: &Warp<T>,
    pattern: &Pattern,
) -> Option<Placement> {
    let turns = turns_of(pattern);
    let largest_shear = nalgebra::convert(LARGEST_SHEAR);
    let mut best: Option<Placement> = None;
    let mut runner_up = 0;
    for axes in AxesIterator::new(pattern.layout) {
        if !is_first_turn(&axes, turns) || warp.shear(&axes).is_none_or(|shear| shear > largest_shear) {
            continue;
        }
        count_shifts(lattice, pattern, &axes, runner_up.max(1), |origin, inside| match best {
            Some(known) if inside <= known.inside => runner_up = runner_up.max(inside),
            _ => {
                runner_up = best.map_or(runner_up, |known| known.inside.max(runner_up));
                best = Some(Placement { axes, origin, inside, outside: lattice.len() - inside, runner_up: 0 });
            }
        });
    }
    let best = best.map(|best| Placement { runner_up, ..best })?;
    turned_to_top_left(best, lattice, points, pattern, turns)
}

/// Calls `report` with the shift and the number of points inside, for every shift that may explain
/// at least `least` points.
fn count_shifts<const N: usize>(
    lattice: &Lattice<N>,
    pattern: &Pattern,
    axes: &[[i32; 2]; 2],
    least: usize,
    mut report: impl FnMut((i32, i32), usize),
) {
    let (width, height) = extent_of(pattern);
    let mut positions: Vec<(i32, i32), N> = Vec::new();
    for site in lattice.sites() {
        if positions.push(apply(axes, i32::from(site.u), i32::from(site.v))).is_err() {
            return;
        }
    }
    let (Some(columns), Some(rows)) = (
        windows(positions.iter().map(|position| position.0), width, least),
        windows(positions.iter().map(|position| position.1), height, least),
    ) else {
        return;
    };
    for &y in &rows {
        for &x in &columns {
            if pattern.layout == Layout::Asymmetric && (x + y) % 2 != 0 {
                continue;
            }
            let inside = positions
                .iter()
                .filter(|position| (x..=x + width).contains(&position.0) && (y..=y + height).contains(&position.1))
                .count();
            if inside >= least {
                report((x, y), inside);
            }
        }
    }
}

/// The starts of all windows of `length` + 1 that hold at least `least` of the values.
fn windows(values: impl Iterator<Item = i32> + Clone, length: i32, least: usize) -> Option<Vec<i32, EXTENT>> {
    let low = values.clone().min()?;
    let high = values.clone().max()?;
    let mut histogram = [0_u16; EXTENT];
    for value in values {
        *histogram.get_mut(usize::try_from(value - low).ok()?)? += 1;
    }
    let mut starts = Vec::new();
    let mut held = 0_usize;
    for start in low - length..=high {
        let entering = usize::try_from(start + length - low).ok().and_then(|index| histogram.get(index));
        held += usize::from(entering.copied().unwrap_or(0));
        if held >= least {
            starts.push(start).ok()?;
        }
        let leaving = usize::try_from(start - low).ok().and_then(|index| histogram.get(index));
        held = held.saturating_sub(usize::from(leaving.copied().unwrap_or(0)));
    }
    Some(starts)
}

fn board_to_image<T: RealField + Copy>(axes: &[[i32; 2]; 2], image_steps: &Matrix2<T>) -> Matrix2<T> {
    let [[a, b], [c, d]] = axes.map(|row| row.map(f64::from));
    let determinant = a * d - b * c;
    let inverse = Matrix2::new(d, -b, -c, a) / determinant;
    image_steps * inverse.map(nalgebra::convert::<f64, T>)
}

/// Picks, of the turns that map the board onto itself, the one with the first circle at the top left.
fn turned_to_top_left<T: RealField + Copy, const N: usize>(
    placement: Placement,
    lattice: &Lattice<N>,
    points: &Points<T, N>,
    pattern: &Pattern,
    turns: usize,
) -> Option<Placement> {
    let image_steps = lattice.affine(points)?.steps;
    let (width, height) = extent_of(pattern);
    let toward = |placement: &Placement| {
        // From the first circle to the middle of the board; right and down is positive.
        let middle = Vector2::new(nalgebra::convert(f64::from(width)), nalgebra::convert(f64::from(height)));
        (board_to_image(&placement.axes, &image_steps) * middle).sum()
    };
    let mut best = placement;
    let mut turned = placement;
    for _ in 1..turns {
        turned = if turns == 4 { quarter_turn(turned, width) } else { half_turn(turned, width, height) };
        if toward(&turned) > toward(&best) {
            best = turned;
        }
    }
    Some(best)
}

fn half_turn(placement: Placement, width: i32, height: i32) -> Placement {
    let [[a, b], [c, d]] = placement.axes;
    let (x, y) = placement.origin;
    Placement { axes: [[-a, -b], [-c, -d]], origin: (-x - width, -y - height), ..placement }
}

/// (x, y) → (width − y, x), the board being square.
fn quarter_turn(placement: Placement, width: i32) -> Placement {
    let [[a, b], [c, d]] = placement.axes;
    let (x, y) = placement.origin;
    Placement { axes: [[-c, -d], [a, b]], origin: (-y - width, x), ..placement }
}

/// One representative of the turns that map the board onto itself.
fn is_first_turn(axes: &[[i32; 2]; 2], turns: usize) -> bool {
    let (a, c) = (axes[0][0], axes[1][0]);
    match turns {
        4 => a > 0 && c >= 0,
        2 => a > 0 || (a == 0 && c > 0),
        _ => true,
    }
}

fn apply(axes: &[[i32; 2]; 2], u: i32, v: i32) -> (i32, i32) {
    (axes[0][0] * u + axes[0][1] * v, axes[1][0] * u + axes[1][1] * v)
}

/// All changes of basis with small entries.
struct AxesIterator {
    layout: Layout,
    next: i32,
}

impl AxesIterator {
    fn new(layout: Layout) -> Self {
        Self { layout, next: 0 }
    }
}

impl Iterator for AxesIterator {
    type Item = [[i32; 2]; 2];

    fn next(&mut self) -> Option<Self::Item> {
        let count = 2 * LARGEST_ENTRY + 1;
        while self.next < count * count * count * count {
            let mut code = self.next;
            self.next += 1;
            let mut digit = || {
                let entry = code % count - LARGEST_ENTRY;
                code /= count;
                entry
            };
            let (a, b, c, d) = (digit(), digit(), digit(), digit());
            if a * d - b * c != 1 {
                continue;
            }
            return Some(match self.layout {
                Layout::Symmetric => [[a, b], [c, d]],
                // The lattice steps of an asymmetric board are (1, -1) and (1, 1).
                Layout::Asymmetric => [[a + c, b + d], [c - a, d - b]],
            });
        }
        None
    }
}

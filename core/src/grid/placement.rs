//! Assignment of lattice sites to circles of the board.
//!
//! The lattice basis found by growth is an arbitrary basis of the image's lattice. A placement is an integer matrix of
//! determinant +1 (in lattice steps) that maps it to the board's axes, and a shift. A board consists of all lattice
//! points of a rectangle, so a placement explains exactly the points inside that rectangle.

use heapless::Vec;
use nalgebra::RealField;

use super::lattice::{Axes, Lattice};
use super::warp::LatticeImage;
use crate::pattern::{Layout, Pattern};

/// Entries of the change of basis lie between minus and plus this value.
const LARGEST_ENTRY: i32 = 2;
/// Largest ratio of the board's scales along its two axes: the right axes make it a square lattice in space, where the
/// ratio is 1. For any other axes it is 2.6 or more.
const LARGEST_SHEAR: f64 = 1.6;
/// Largest supported extent of a lattice in board units.
const EXTENT: usize = 192;

/// Maps lattice site (u, v) to the board's lattice position `axes` · (u, v) − `origin`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Placement {
    axes: Axes,
    origin: (i32, i32),
    /// Number of points that fall on circles of the board.
    pub inside: usize,
}

impl Placement {
    /// Returns the index of the circle at a lattice site.
    pub fn circle(&self, pattern: &Pattern, u: i8, v: i8) -> Option<usize> {
        let (x, y) = apply(&self.axes, i32::from(u), i32::from(v));
        pattern.index_at(x - self.origin.0, y - self.origin.1)
    }

    /// Returns the lattice site of a circle of the board.
    pub fn site(&self, pattern: &Pattern, circle: usize) -> (i32, i32) {
        let (x, y) = pattern.lattice_position(circle);
        let (x, y) = (x + self.origin.0, y + self.origin.1);
        let [[a, b], [c, d]] = self.axes;
        // The determinant is 1 on symmetric boards and 2 on asymmetric ones, where x and y are both even or both odd.
        let determinant = (a * d - b * c).max(1);
        ((d * x - b * y) / determinant, (a * y - c * x) / determinant)
    }

    /// Returns the placement of the same points on the board rotated by 180°, or by 90° if that maps the board onto
    /// itself.
    pub fn turned(&self, pattern: &Pattern) -> Self {
        let (width, height) = extent_of(pattern);
        let [[a, b], [c, d]] = self.axes;
        let (x, y) = self.origin;
        let (axes, origin) = if turns_of(pattern) == 4 {
            // (x, y) → (width − y, x)
            ([[-c, -d], [a, b]], (-y - width, x))
        } else {
            ([[-a, -b], [-c, -d]], (-x - width, -y - height))
        };
        Self { axes, origin, ..*self }
    }
}

/// Returns the number of rotations by 90° or 180° that map the board onto itself: 1, 2 or 4.
pub(super) fn turns_of(pattern: &Pattern) -> usize {
    match pattern.layout {
        Layout::Symmetric if pattern.rows == pattern.columns => 4,
        Layout::Symmetric => 2,
        Layout::Asymmetric if pattern.rows.is_multiple_of(2) => 2,
        Layout::Asymmetric => 1,
    }
}

/// Returns the largest lattice position of the board in x and y.
pub(super) fn extent_of(pattern: &Pattern) -> (i32, i32) {
    let columns = i32::from(pattern.columns.max(1));
    let width = match pattern.layout {
        Layout::Asymmetric => 2 * columns - 1,
        Layout::Symmetric => columns - 1,
    };
    (width, i32::from(pattern.rows.max(1)) - 1)
}

/// Largest number of axes of a lattice: four rotations of one, and others if the map is poorly determined.
const MOST_AXES: usize = 16;

/// Returns the possible axes of a lattice on a board: changes of basis that make it a square lattice in space. Axes
/// that differ by a rotation that maps the board onto itself are listed once.
pub(super) fn axes_of<T: RealField + Copy>(image: &LatticeImage<T>, pattern: &Pattern) -> Vec<Axes, MOST_AXES> {
    let turns = turns_of(pattern);
    let largest_shear = nalgebra::convert(LARGEST_SHEAR);
    let mut list = Vec::new();
    let entries = -LARGEST_ENTRY..=LARGEST_ENTRY;
    for a in entries.clone() {
        for b in entries.clone() {
            for c in entries.clone() {
                for d in entries.clone() {
                    if a * d - b * c != 1 {
                        continue;
                    }
                    let axes = match pattern.layout {
                        Layout::Symmetric => [[a, b], [c, d]],
                        // The lattice steps of an asymmetric board are (1, -1) and (1, 1).
                        Layout::Asymmetric => [[a + c, b + d], [c - a, d - b]],
                    };
                    let listed =
                        is_first_turn(&axes, turns) && image.shear(&axes).is_some_and(|shear| shear <= largest_shear);
                    if listed && list.push(axes).is_err() {
                        return list;
                    }
                }
            }
        }
    }
    list
}

/// Calls `visit` with every placement along `axes` that explains at least `least` points.
pub(super) fn visit<const N: usize>(
    lattice: &Lattice<N>,
    pattern: &Pattern,
    axes: &[Axes],
    least: usize,
    mut visit: impl FnMut(Placement),
) {
    for &axes in axes {
        count_shifts(lattice, pattern, &axes, least.max(1), |x, y, inside| {
            visit(Placement { axes, origin: (x, y), inside });
        });
    }
}

/// Calls `report` with the shift and the number of points inside, for every shift that may explain at least `least`
/// points.
fn count_shifts<const N: usize>(
    lattice: &Lattice<N>,
    pattern: &Pattern,
    axes: &Axes,
    least: usize,
    mut report: impl FnMut(i32, i32, usize),
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
                report(x, y, inside);
            }
        }
    }
}

/// Returns the starts of all windows of `length` + 1 that contain at least `least` of the values.
fn windows(values: impl Iterator<Item = i32> + Clone, length: i32, least: usize) -> Option<Vec<i32, EXTENT>> {
    let low = values.clone().min()?;
    let high = values.clone().max()?;
    let mut histogram = [0_u16; EXTENT];
    for value in values {
        *histogram.get_mut(usize::try_from(value - low).ok()?)? += 1;
    }
    let mut starts = Vec::new();
    let mut count = 0_usize;
    for start in low - length..=high {
        let entering = usize::try_from(start + length - low).ok().and_then(|index| histogram.get(index));
        count += usize::from(entering.copied().unwrap_or(0));
        if count >= least {
            starts.push(start).ok()?;
        }
        let leaving = usize::try_from(start - low).ok().and_then(|index| histogram.get(index));
        count = count.saturating_sub(usize::from(leaving.copied().unwrap_or(0)));
    }
    Some(starts)
}

/// Of the rotations that map the board onto itself, chooses the one whose first circle lies nearest to the top left of
/// the image.
pub(super) fn turned_to_top_left<T: RealField + Copy>(
    placement: Placement,
    image: &LatticeImage<T>,
    pattern: &Pattern,
) -> Placement {
    let corner = |placement: &Placement| {
        let (u, v) = placement.site(pattern, 0);
        image.at(u, v).map(|place| place.x + place.y)
    };
    let mut best = placement;
    let mut turned = placement;
    for _ in 1..turns_of(pattern) {
        turned = turned.turned(pattern);
        if let (Some(here), Some(there)) = (corner(&turned), corner(&best))
            && here < there
        {
            best = turned;
        }
    }
    best
}

/// Returns `true` for one representative of the rotations that map the board onto itself.
fn is_first_turn(axes: &Axes, turns: usize) -> bool {
    let (a, c) = (axes[0][0], axes[1][0]);
    match turns {
        4 => a > 0 && c >= 0,
        2 => a > 0 || (a == 0 && c > 0),
        _ => true,
    }
}

fn apply(axes: &Axes, u: i32, v: i32) -> (i32, i32) {
    (axes[0][0] * u + axes[0][1] * v, axes[1][0] * u + axes[1][1] * v)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn circles_and_sites_are_inverse() {
        for (layout, rows, columns) in
            [(Layout::Asymmetric, 9, 4), (Layout::Asymmetric, 8, 5), (Layout::Symmetric, 5, 5)]
        {
            let pattern = Pattern { layout, rows, columns };
            let axes = match layout {
                Layout::Asymmetric => [[1, 1], [-1, 1]],
                Layout::Symmetric => [[0, -1], [1, 1]],
            };
            let mut placement = Placement { axes, origin: (-3, 5), inside: 0 };
            for _ in 0..4 {
                for circle in 0..pattern.circle_count() {
                    let (u, v) = placement.site(&pattern, circle);
                    let back = placement.circle(&pattern, u as i8, v as i8);
                    assert_eq!(back, Some(circle), "{pattern:?} {placement:?}");
                }
                if turns_of(&pattern) > 1 {
                    placement = placement.turned(&pattern);
                }
            }
        }
    }

    #[test]
    fn windows_equal_those_of_a_direct_count() {
        let values = [3, -1, 3, 4, 9, 10, 2];
        for length in 0..12 {
            for least in 1..8 {
                let expected: std::vec::Vec<i32> = (-1 - length..=10)
                    .filter(|start| {
                        values.iter().filter(|value| (*start..=start + length).contains(*value)).count() >= least
                    })
                    .collect();
                assert_eq!(windows(values.into_iter(), length, least).unwrap().as_slice(), expected.as_slice());
            }
        }
    }
}

//! The lattice of corners in a picture, whatever the size of the board.

use evcal_core::grid::{GridOptions, GridWorkspace, LatticeSite, find_lattice};
use evcal_core::pattern::{Layout, Pattern};

use super::{CAPACITY, candidates_of, smaller, workspace};
use crate::found_point::FoundPoint;
use crate::picture::Picture;
use crate::saddles::find_saddles;

/// The smallest lattice.
const SMALLEST: Pattern = Pattern { layout: Layout::Symmetric, rows: 3, columns: 4 };
/// A line at the end of a lattice is part of a board if at least this share of its points are corners.
const LEAST_FILLED: f64 = 0.5;

/// A lattice of corners that has at least as many columns as rows.
#[derive(Clone, Debug)]
pub(crate) struct CornerLattice {
    /// Rows of corners.
    pub rows: usize,
    /// Columns of corners.
    pub columns: usize,
    /// The corners by increasing index; indices count row by row.
    pub corners: Vec<FoundPoint>,
}

/// Returns the largest lattice of a picture at each scale.
pub(crate) fn corner_lattices(picture: &Picture) -> Vec<CornerLattice> {
    let mut workspace = workspace();
    let mut lattices: Vec<CornerLattice> = lattice_of(picture, 1.0, &mut workspace).into_iter().collect();
    let (mut scale, mut reduced) = (1.0, smaller(picture));
    while let Some(picture) = reduced {
        scale *= 2.0;
        lattices.extend(lattice_of(&picture, scale, &mut workspace));
        reduced = smaller(&picture);
    }
    lattices
}

/// Returns the lattice in a picture that was reduced by the factor `scale`.
fn lattice_of(picture: &Picture, scale: f32, workspace: &mut GridWorkspace<f64, CAPACITY>) -> Option<CornerLattice> {
    let saddles = find_saddles(picture, CAPACITY);
    let options = GridOptions::new(&SMALLEST, (picture.width() as f64, picture.height() as f64));
    let mut sites = find_lattice(&candidates_of(&saddles), &options, workspace).ok()?.to_vec();
    trim(&mut sites);
    let ([left, right], [top, bottom]) = (range(&sites, |site| site.u)?, range(&sites, |site| site.v)?);
    let steps = |from: i8, to: i8| usize::from(to.abs_diff(from));
    let (wide, high) = (steps(left, right) + 1, steps(top, bottom) + 1);
    let (rows, columns) = (wide.min(high), wide.max(high));
    let corner = |site: &LatticeSite| {
        // After a rotation by 90° v runs along the rows and u against the columns.
        let (x, y) = match wide >= high {
            true => (steps(left, site.u), steps(top, site.v)),
            false => (steps(top, site.v), steps(site.u, right)),
        };
        let pixel = saddles.get(usize::from(site.candidate))?.pixel.map(|place| (place + 0.5) * scale - 0.5);
        Some(FoundPoint { index: y * columns + x, pixel })
    };
    let mut corners: Vec<FoundPoint> = sites.iter().filter_map(corner).collect();
    corners.sort_by_key(|point| point.index);
    Some(CornerLattice { rows, columns, corners })
}

/// Leaves out lines at the ends that are hardly filled: other saddles that continue the lattice by chance.
fn trim(sites: &mut Vec<LatticeSite>) {
    let axes: [fn(&LatticeSite) -> i8; 2] = [|site| site.u, |site| site.v];
    loop {
        let ranges = axes.map(|axis| range(sites, axis));
        let ends = [0, 1].into_iter().flat_map(|axis| {
            let filled = |line: i8| {
                let [first, last] = ranges[1 - axis].unwrap_or_default();
                let count = sites.iter().filter(|site| axes[axis](site) == line).count();
                (count as f64 / (f64::from(last.abs_diff(first)) + 1.0), axis, line)
            };
            ranges[axis].into_iter().flatten().map(filled).collect::<Vec<_>>()
        });
        match ends.min_by(|a, b| a.0.total_cmp(&b.0)) {
            Some((filled, axis, line)) if filled < LEAST_FILLED => sites.retain(|site| axes[axis](site) != line),
            _ => return,
        }
    }
}

/// Returns the smallest and the largest coordinate.
fn range(sites: &[LatticeSite], axis: fn(&LatticeSite) -> i8) -> Option<[i8; 2]> {
    Some([sites.iter().map(axis).min()?, sites.iter().map(axis).max()?])
}

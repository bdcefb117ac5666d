//! Search for the board among circle candidates.

use core::hint::black_box;

use evcal_core::grid::{GridCandidate, GridOptions, GridWorkspace, find_grid, find_grid_near, reorder, symmetry};
use evcal_core::pattern::{Layout, Pattern};
use nalgebra::{RealField, Vector2};

use crate::any;

fn pattern() -> Pattern {
    let layout = if black_box(true) { Layout::Asymmetric } else { Layout::Symmetric };
    Pattern { layout, rows: black_box(1), columns: black_box(1) }
}

/// The board among candidates, anywhere and at an expected position.
#[inline(never)]
pub fn find<T: RealField + Copy>() {
    let mut workspace = GridWorkspace::<T, 64>::new();
    let workspace = black_box(&mut workspace);
    let candidates = [GridCandidate { center: Vector2::new(any::<T>(), any()), radius: any() }; 8];
    let candidates: &[_] = black_box(&candidates);
    let expected = [Some(Vector2::new(any::<T>(), any())), None];
    let expected: &[_] = black_box(&expected);
    let pattern = pattern();
    let options = GridOptions {
        image_size: black_box((1.0, 1.0)),
        minimum_circles: black_box(1),
        minimum_odds: black_box(1.0),
        maximum_outside: black_box(1),
        maximum_scatter: black_box(1.0),
        independent_misses: black_box(true),
    };
    black_box(GridOptions::new(&pattern, black_box((1.0, 1.0))));
    black_box(find_grid(candidates, &pattern, &options, workspace).is_ok());
    black_box(find_grid_near(candidates, &pattern, &options, expected, workspace).is_ok());
}

/// Functions about a board.
#[inline(never)]
pub fn board() {
    let pattern = pattern();
    black_box(pattern.circle_count());
    black_box(pattern.lattice_position(black_box(1)));
    black_box(pattern.index_at(black_box(1), black_box(1)));
    black_box(symmetry(&pattern));
    black_box(reorder(&pattern, black_box(1), black_box(1)));
}

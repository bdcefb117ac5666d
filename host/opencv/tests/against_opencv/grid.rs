//! Comparison of the grid finder with OpenCV's `findCirclesGrid` on complete boards without clutter: both must assign
//! every candidate to the same circle.

#[path = "../../../../core/tests/support/grid_views.rs"]
mod grid_views;

use evcal_core::grid::{GridOptions, GridWorkspace, find_grid, reorder, symmetry};
use evcal_core::pattern::{Layout, Pattern};
use evcal_opencv::find_circles_grid;
use grid_views::{Lens, Random, SIZE, Setting, view};
use nalgebra::Vector2;

const VIEWS: usize = 150;

/// Returns the number of views in which both find the board, in which the orders agree (up to a rotation that maps the
/// board onto itself), and in which OpenCV's order is wrong.
fn compare(setting: &Setting) -> (usize, usize, usize) {
    let pattern = setting.pattern;
    let options = GridOptions::new(&pattern, SIZE);
    let mut workspace = GridWorkspace::<f64, 128>::new();
    let mut random = Random::new(21);
    let (mut both, mut agreeing, mut misread) = (0, 0, 0);
    for _ in 0..VIEWS {
        let view = view(setting, &mut random);
        assert_eq!(view.visible, pattern.circle_count());
        assert!(view.dots.iter().all(Option::is_some));
        assert!(view.truth.iter().all(Option::is_some), "no clutter");
        let centers: Vec<Vector2<f64>> = view.candidates.iter().map(|candidate| candidate.center).collect();
        let Some(reference) = find_circles_grid(&centers, pattern).expect("OpenCV answers") else { continue };
        let Ok(found) = find_grid(&view.candidates, &pattern, &options, &mut workspace) else { continue };
        both += 1;
        let agrees = (0..symmetry(&pattern)).any(|turn| {
            found.circles.iter().all(|circle| {
                let turned = reorder(&pattern, usize::from(circle.board), turn);
                turned.map(|index| reference[index]) == Some(usize::from(circle.candidate))
            })
        });
        agreeing += usize::from(agrees);
        let is_true = (0..symmetry(&pattern)).any(|turn| {
            (0..pattern.circle_count()).all(|index| view.truth[reference[index]] == reorder(&pattern, index, turn))
        });
        misread += usize::from(!is_true);
    }
    (both, agreeing, misread)
}

fn setting(layout: Layout, rows: u8, columns: u8, lens: Lens) -> Setting {
    let pattern = Pattern { layout, rows, columns };
    Setting { pattern, lens, tilt: 40.0, noise: 0.2, clutter: 0, missing: 0, cut: false }
}

#[test]
fn asymmetric_boards_have_the_order_of_opencv() {
    for (rows, columns) in [(9, 4), (11, 4)] {
        let (both, agreeing, misread) = compare(&setting(Layout::Asymmetric, rows, columns, Lens::Radtan));
        assert!(both >= VIEWS * 9 / 10, "{rows}x{columns}: {both} of {VIEWS} found by both");
        assert_eq!((agreeing, misread), (both, 0), "{rows}x{columns}");
    }
}

#[test]
fn a_fisheye_does_not_change_the_order() {
    let (both, agreeing, misread) = compare(&setting(Layout::Asymmetric, 9, 4, Lens::Fisheye));
    // OpenCV expects straight rows: it finds half of the boards in these views, and misreads one.
    assert!(both >= VIEWS / 3, "{both} of {VIEWS} found by both");
    assert!(misread <= 1, "{misread} misread by OpenCV");
    assert_eq!(agreeing, both - misread);
}

#[test]
fn symmetric_boards_have_the_order_of_opencv_up_to_a_rotation() {
    for (rows, columns) in [(6, 3), (5, 4)] {
        let (both, agreeing, misread) = compare(&setting(Layout::Symmetric, rows, columns, Lens::Radtan));
        // OpenCV itself finds less than half of the symmetric boards in these views.
        assert!(both >= VIEWS / 3, "{rows}x{columns}: {both} of {VIEWS} found by both");
        assert_eq!((agreeing, misread), (both, 0), "{rows}x{columns}");
    }
}

use nalgebra::Isometry3;

use super::*;
use crate::board::Board;
use crate::board::symmetry::{Symmetry, symmetries};

fn board(text: &str) -> SquareBoard {
    text.parse().unwrap()
}

/// Returns the board as printed, dark as `#`: the middles of `width` × `height` modules of `module` metres from `low`
/// on.
fn printed(board: &SquareBoard, low: [f64; 2], module: f64, [width, height]: [u32; 2]) -> Vec<String> {
    let raster = board.raster();
    let at = |low: f64, index: u32| low + (f64::from(index) + 0.5) * module;
    let letter = |dark: bool| if dark { '#' } else { '.' };
    (0..height)
        .map(|row| (0..width).map(|column| letter(raster.is_dark_at([at(low[0], column), at(low[1], row)]))).collect())
        .collect()
}

fn close(found: &[Vector2<f64>], expected: &[[f64; 2]]) -> bool {
    found.len() == expected.len()
        && found.iter().zip(expected).all(|(found, [x, y])| (found - Vector2::new(*x, *y)).norm() < 1e-12)
}

#[test]
fn inner_corners_of_a_checkerboard_run_along_its_rows() {
    let points = board("checkerboard:2x3:20mm").points();
    assert!(
        close(&points, &[[0.0, 0.0], [0.02, 0.0], [0.04, 0.0], [0.0, 0.02], [0.02, 0.02], [0.04, 0.02]]),
        "{points:?}"
    );
}

#[test]
fn a_checkerboard_has_one_more_row_and_column_of_squares_than_of_corners() {
    let dark = printed(&board("checkerboard:2x3:20mm"), [-0.02; 2], 0.02, [5, 4]);
    assert_eq!(dark, ["#.#..", ".#.#.", "#.#..", "....."]);
    let light = printed(&board("checkerboard:2x3:20mm:light"), [-0.02; 2], 0.02, [4, 3]);
    assert_eq!(light, [".#.#", "#.#.", ".#.#"]);
}

/// Kalibr's `createGridPoints` for `tagRows: 2, tagCols: 3`: (c div 2)(1 + spacing) size + (c mod 2) size, likewise for rows.
#[test]
fn corners_of_tags_are_at_kalibrs_positions() {
    let (size, spacing) = (0.088, 0.3);
    let mut expected = Vec::new();
    for r in 0..4_u32 {
        for c in 0..6_u32 {
            let place = |index: u32| f64::from(index / 2) * (1.0 + spacing) * size + f64::from(index % 2) * size;
            expected.push([place(c), -place(r)]);
        }
    }
    let points = board("aprilgrid:2x3:88mm:0.3").points();
    assert!(close(&points, &expected), "{points:?}");
}

/// Kalibr's detector puts the corners of tag `id` (bottom left, bottom right, top right, top left) at these points of
/// the grid.
#[test]
fn tags_lie_at_kalibrs_points() {
    for text in ["aprilgrid:2x3:88mm:0.3", "apriltags:3x4:30mm:0.25"] {
        let board = board(text);
        let (points, tags) = (board.points(), board.tags());
        let SquareBoard::Tags(grid) = board else { panic!("{board}") };
        let columns = 2 * usize::from(grid.columns);
        assert_eq!(tags.len(), points.len() / 4);
        for (id, tag) in tags.iter().enumerate() {
            assert_eq!(usize::from(tag.id), id);
            let base = id / (columns / 2) * columns * 2 + id % (columns / 2) * 2;
            let indices = [base + columns, base + columns + 1, base + 1, base];
            assert!(close(&indices.map(|index| points[index]), &tag.corners), "{id}");
        }
    }
}

/// Tag 0 of 36h11 is at the bottom left, as on Kalibr's sheet and in a real recording.
#[test]
fn kalibrs_first_tag_is_upright_at_the_bottom_left() {
    let plain = board("apriltags:2x2:80mm:0.25");
    let rows = printed(&plain, [0.0, -0.08], 0.01, [8, 8]);
    assert_eq!(rows[..4], ["########", "#..#.#.#", "##...#.#", "##..####"]);
}

/// A grid of `kalibr_create_target_pdf`: squares as large as the gap at all corners of tags, a border of two modules.
#[test]
fn an_aprilgrid_has_squares_at_the_corners_of_its_tags() {
    let rows = printed(&board("aprilgrid:1x2:100mm:0.3"), [-0.03, -0.13], 0.01, [29, 16]);
    let gap = "###..........###..........###";
    for row in (0..3).chain(13..16) {
        assert_eq!(rows[row], gap);
    }
    let border = "...##########...##########...";
    for row in [3, 4, 11, 12] {
        assert_eq!(rows[row], border);
    }
    assert_eq!(rows[5].get(..13), Some("...##..#.#.##"));
}

/// Drawn by OpenCV 5.0 as `GridBoard((2, 2), 1.0, 1/3, DICT_APRILTAG_16h5)`.
#[test]
fn a_grid_numbered_downwards_equals_opencvs() {
    let board = board("apriltags:2x2:60mm:0.3333333333333333:16h5:down");
    assert_eq!(printed(&board, [0.0; 2], 0.01, [14, 14]), GRID_BOARD);
    let points = board.points();
    assert!(close(&points[..3], &[[0.0, 0.0], [0.06, 0.0], [0.08, 0.0]]), "{points:?}");
    let tags = board.tags();
    // OpenCV's first corner is the third corner of the tag as printed by AprilTag's authors.
    assert!(close(&[Vector2::zeros()], &tags[0].corners[2..3]));
    assert!((tags[2].corners[2][1] - 0.08).abs() < 1e-12);
}

/// Drawn by OpenCV 5.0 as `CharucoBoard((3, 4), 1.0, 0.75, DICT_4X4_50)`, without and with `setLegacyPattern(True)`.
#[test]
fn charuco_boards_equal_opencvs_drawings() {
    let text = "charuco:4x3:80mm:60mm:DICT_4X4_50";
    assert_eq!(printed(&board(text), [0.0; 2], 0.01, [24, 32]), CURRENT);
    assert_eq!(printed(&board(&format!("{text}:legacy")), [0.0; 2], 0.01, [24, 32]), LEGACY);
    let april = board("charuco:3x3:80mm:60mm:DICT_APRILTAG_16h5");
    assert_eq!(printed(&april, [0.08, 0.0], 0.01, [8, 8]), APRIL_MARKER);
}

/// Top left corners of the markers of `CharucoBoard((4, 6), 1.0, 0.75, …)` according to OpenCV 5.0, in the order of
/// their ids.
#[test]
fn charuco_markers_are_numbered_as_in_opencv() {
    let places = |text: &str| -> Vec<[f64; 2]> { board(text).tags().iter().map(|tag| tag.corners[0]).collect() };
    let current = places("charuco:6x4:1m:0.75m:DICT_5X5_100");
    let even = [[1.125, 0.125], [3.125, 0.125], [0.125, 1.125], [2.125, 1.125], [1.125, 2.125]];
    assert_eq!((current.len(), &current[..5]), (12, &even[..]));
    let legacy = places("charuco:6x4:1m:0.75m:DICT_5X5_100:legacy");
    let odd = [[0.125, 0.125], [2.125, 0.125], [1.125, 1.125], [3.125, 1.125], [0.125, 2.125]];
    assert_eq!((legacy.len(), &legacy[..5]), (12, &odd[..]));
    // OpenCV's boards of (5, 6) and (5, 7) squares, with the columns first.
    assert_eq!(places("charuco:6x5:1m:0.75m:DICT_5X5_100:legacy").len(), 15);
    let seven = places("charuco:7x5:1m:0.75m:DICT_5X5_100");
    assert_eq!((seven.len(), seven[16]), (17, [3.125, 6.125]));
    assert_eq!(places("charuco:7x5:1m:0.75m:DICT_5X5_100:legacy"), seven);
}

/// Corners of `CharucoBoard((5, 7), 0.03, …)` according to OpenCV 5.0: the first, the second, the last.
#[test]
fn charuco_corners_have_opencvs_ids() {
    let points = board("charuco:7x5:30mm:22mm:DICT_5X5_100").points();
    assert_eq!(points.len(), 24);
    assert!(close(&[points[0], points[1], points[23]], &[[0.03, 0.03], [0.06, 0.03], [0.12, 0.18]]), "{points:?}");
}

/// Returns `true` if the raster is the same after this many rotations by 90° about the middle of the points.
fn is_symmetric(board: &SquareBoard, quarters: u8) -> bool {
    let (raster, points) = (board.raster(), board.points());
    let middle = 0.5 * (points[0] + points[points.len() - 1]);
    let turned = |point: Vector2<f64>| (0..quarters).fold(point - middle, |at, _| Vector2::new(-at.y, at.x)) + middle;
    let places = |lines: &[f64]| -> Vec<f64> { lines.windows(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect() };
    let (x, y) = (places(raster.x_lines()), places(raster.y_lines()));
    x.iter().all(|x| {
        y.iter().all(|y| raster.is_dark_at([*x, *y]) == raster.is_dark_at(turned(Vector2::new(*x, *y)).into()))
    })
}

#[test]
fn symmetries_are_the_rotations_after_which_the_print_looks_the_same() {
    for text in [
        "checkerboard:6x9:25mm",
        "checkerboard:9x6:25mm:light",
        "checkerboard:5x7:25mm",
        "checkerboard:6x8:25mm",
        "checkerboard:7x7:25mm",
        "checkerboard:6x6:25mm",
        "checkerboard:6x6:25mm:light",
        "aprilgrid:2x2:30mm:0.3",
        "charuco:5x5:30mm:22mm:DICT_5X5_100",
    ] {
        let board = board(text);
        let expected = (0..4).filter(|quarters| is_symmetric(&board, *quarters)).count();
        let found = symmetries(&Board::Squares(board));
        assert_eq!(found.len(), expected, "{text}");
        assert_eq!(found[0].pose, Isometry3::identity());
        let points = board.points();
        for Symmetry { pose, points: turned } in &found {
            for (point, other) in points.iter().zip(turned) {
                let moved = pose * nalgebra::Point3::new(point.x, point.y, 0.0);
                assert!((moved.coords.xy() - points[usize::from(*other)]).norm() < 1e-12);
            }
        }
    }
}

#[rustfmt::skip]
const CURRENT: [&str; 32] = [
    "########........########",
    "########.######.########",
    "########.#.#..#.########",
    "########.##.#.#.########",
    "########.###..#.########",
    "########.###.##.########",
    "########.######.########",
    "########........########",
    "........########........",
    ".######.########.######.",
    ".######.########.###..#.",
    ".#....#.########.###..#.",
    ".#.##.#.########.###.##.",
    ".#.#.##.########.#..#.#.",
    ".######.########.######.",
    "........########........",
    "########........########",
    "########.######.########",
    "########.#.##.#.########",
    "########.#.##.#.########",
    "########.##.###.########",
    "########.##..##.########",
    "########.######.########",
    "########........########",
    "........########........",
    ".######.########.######.",
    ".##.#.#.########.##...#.",
    ".##.###.########.#.##.#.",
    ".#.##.#.########.#..###.",
    ".#...##.########.#..#.#.",
    ".######.########.######.",
    "........########........",
];

#[rustfmt::skip]
const LEGACY: [&str; 32] = [
    "........########........",
    ".######.########.######.",
    ".#.#..#.########.######.",
    ".##.#.#.########.#....#.",
    ".###..#.########.#.##.#.",
    ".###.##.########.#.#.##.",
    ".######.########.######.",
    "........########........",
    "########........########",
    "########.######.########",
    "########.###..#.########",
    "########.###..#.########",
    "########.###.##.########",
    "########.#..#.#.########",
    "########.######.########",
    "########........########",
    "........########........",
    ".######.########.######.",
    ".#.##.#.########.##.#.#.",
    ".#.##.#.########.##.###.",
    ".##.###.########.#.##.#.",
    ".##..##.########.#...##.",
    ".######.########.######.",
    "........########........",
    "########........########",
    "########.######.########",
    "########.##...#.########",
    "########.#.##.#.########",
    "########.#..###.########",
    "########.#..#.#.########",
    "########.######.########",
    "########........########",
];

#[rustfmt::skip]
const GRID_BOARD: [&str; 14] = [
    "######..######",
    "#..#.#..#.#.##",
    "#.####..##.#.#",
    "#..###..##...#",
    "##.###..##.###",
    "######..######",
    "..............",
    "..............",
    "######..######",
    "##.#.#..#.##.#",
    "##..##..#..#.#",
    "###.##..#.#.##",
    "#..###..###.##",
    "######..######",
];

#[rustfmt::skip]
const APRIL_MARKER: [&str; 8] = [
    "........",
    ".######.",
    ".#..#.#.",
    ".#.####.",
    ".#..###.",
    ".##.###.",
    ".######.",
    "........",
];

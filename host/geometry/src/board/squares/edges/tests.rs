use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::board::squares::SquareBoard;

const BOARDS: [&str; 6] = [
    "checkerboard:3x4:20mm",
    "checkerboard:4x4:20mm:light",
    "aprilgrid:2x2:40mm:0.3",
    "apriltags:2x3:30mm:0.27:25h9:border2:down",
    "charuco:4x5:30mm:22mm:DICT_5X5_100",
    "charuco:4x3:30mm:29mm:DICT_7X7_50:legacy",
];

fn raster(text: &str) -> Raster {
    text.parse::<SquareBoard>().unwrap().raster()
}

/// A side of a cell that separates dark from light, found from the shades on both of its sides.
struct Side1 {
    across: usize,
    position: f64,
    span: [f64; 2],
    dark_is_high: bool,
}

const BIT: f64 = 1e-7;

fn cell_sides(raster: &Raster) -> Vec<Side1> {
    let lines = [raster.x_lines(), raster.y_lines()];
    let mut sides = Vec::new();
    for across in 0..2 {
        for position in lines[across] {
            for pair in lines[1 - across].windows(2) {
                let shade = |off: f64| {
                    let mut point = [0.5 * (pair[0] + pair[1]); 2];
                    point[across] = position + off;
                    raster.is_dark_at(point)
                };
                if shade(-BIT) != shade(BIT) {
                    sides.push(Side1 {
                        across,
                        position: *position,
                        span: [pair[0], pair[1]],
                        dark_is_high: shade(BIT),
                    });
                }
            }
        }
    }
    sides
}

/// The nearest edge, found without the table of [`SquareEdges`].
#[derive(Debug, PartialEq)]
struct Found {
    across: usize,
    position: f64,
    dark_is_high: bool,
    line: [f64; 2],
    width: f64,
}

/// Searches all sides of cells.
fn search(sides: &[Side1], point: [f64; 2], light: [Side; 2], clearance: f64, ends: [f64; 2]) -> Option<Found> {
    let off = |side: &Side1| {
        let along = point[1 - side.across];
        let past = (side.span[0] - along).max(along - side.span[1]).max(0.0);
        (point[side.across] - side.position).hypot(past)
    };
    let faces = |side: &&Side1| side.span[0] <= point[1 - side.across] && point[1 - side.across] <= side.span[1];
    sides.iter().min_by(|a, b| off(a).total_cmp(&off(b))).filter(faces)?;
    // Of the two edges that enclose the point along an axis, the one whose light side is `light`.
    let lit = |across: usize| {
        let facing = |above: bool| {
            let is_there = move |side: &&Side1| side.across == across && (side.position > point[across]) == above;
            sides.iter().filter(faces).filter(is_there).min_by(|a, b| off(a).total_cmp(&off(b)))
        };
        let is_lit = |side: &&Side1| side.dark_is_high == (light[across] == Side::Low);
        [facing(false), facing(true)].into_iter().flatten().find(is_lit)
    };
    let nearest = [lit(0), lit(1)].into_iter().flatten().min_by(|a, b| off(a).total_cmp(&off(b)))?;
    let Side1 { across, position, dark_is_high, .. } = *nearest;
    let along = point[1 - across];
    let distance = off(nearest);
    let other = lit(1 - across).map_or(f64::INFINITY, off);
    // The straight line consists of sides on the same line and of the same shade, end to end.
    let mut line = nearest.span;
    loop {
        let grown = sides
            .iter()
            .filter(|side| side.across == across && side.position == position && side.dark_is_high == dark_is_high)
            .filter(|side| side.span[0] <= line[1] && line[0] <= side.span[1])
            .fold(line, |line, side| [line[0].min(side.span[0]), line[1].max(side.span[1])]);
        if grown == line {
            break;
        }
        line = grown;
    }
    let parallel = sides.iter().filter(|side| side.across == across && side.position != position).filter(faces);
    let width = parallel.map(|side| (side.position - position).abs()).fold(f64::INFINITY, f64::min);
    let is_clear = other >= distance + clearance
        && along - line[0] >= ends[across]
        && line[1] - along >= ends[across]
        && distance <= width;
    is_clear.then_some(Found { across, position, dark_is_high, line, width })
}

#[test]
fn the_nearest_edge_lit_on_one_side_equals_that_of_an_exhaustive_search() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    for text in BOARDS {
        let raster = raster(text);
        let (sides, edges) = (cell_sides(&raster), SquareEdges::new(&raster));
        let mut found = 0;
        for _ in 0..4000 {
            let mut place = |lines: &[f64]| random.random_range(lines[0] - 0.015..lines[lines.len() - 1] + 0.015);
            let point = [place(raster.x_lines()), place(raster.y_lines())];
            for clearance in [0.0, 0.0005, 0.002] {
                let ends = [clearance, 2.0 * clearance];
                let light = [(); 2].map(|()| if random.random() { Side::Low } else { Side::High });
                let edge = edges.nearest(point, light, clearance, ends).map(|index| edges.edges()[index]);
                let same = edge.map(|edge| {
                    let along = point[if edge.across == Axis::X { 1 } else { 0 }];
                    assert!(edge.span[0] <= along && along <= edge.span[1]);
                    Found {
                        across: usize::from(edge.across == Axis::Y),
                        position: edge.position,
                        dark_is_high: edge.dark == Side::High,
                        line: edge.line,
                        width: edge.width(),
                    }
                });
                let expected = search(&sides, point, light, clearance, ends);
                assert_eq!(same, expected, "{text} {point:?} {light:?} {clearance}");
                found += usize::from(expected.is_some());
            }
        }
        assert!(found > 2000, "{text} {found}");
    }
}

#[test]
fn edges_of_a_checkerboard_are_the_sides_of_its_squares() {
    let edges = SquareEdges::new(&raster("checkerboard:2x2:20mm"));
    let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
    // Three rows of squares, dark at the corners: 4 lines with 3 sides; on the outer lines only dark squares have
    // sides.
    assert_eq!(edges.edges().len(), 2 * (2 + 3 + 3 + 2));
    for edge in edges.edges() {
        assert_eq!(edge.span, edge.line);
        assert!(near(edge.span[1] - edge.span[0], 0.02) && near(edge.width(), 0.02), "{edge:?}");
    }
    let outer = edges.edges()[0];
    assert!(near(outer.position, -0.02) && outer.dark == Side::High && outer.light_width == f64::INFINITY);
}

#[test]
fn an_edge_of_a_tag_has_the_widths_on_both_sides() {
    // Tag 0 has a border of one module, then modules 110101 in its first row.
    let edges = SquareEdges::new(&raster("apriltags:1x1:80mm:0.25"));
    let at = |point: [f64; 2]| edges.edges()[edges.nearest(point, [Side::Low; 2], 0.001, [0.001; 2]).unwrap()];
    let side = at([0.001, -0.065]);
    let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
    assert!(side.across == Axis::X && side.dark == Side::High && near(side.position, 0.0), "{side:?}");
    assert!(near(side.dark_width, 0.01) && side.light_width == f64::INFINITY);
    assert!(near(side.line[0], -0.08) && near(side.line[1], 0.0));
    let inner = at([0.0305, -0.065]);
    assert!(near(inner.position, 0.03) && inner.dark == Side::High, "{inner:?}");
    assert!(near(inner.light_width, 0.02) && near(inner.dark_width, 0.01));
}

#[test]
fn points_off_the_board_have_no_edge() {
    let edges = SquareEdges::new(&raster("checkerboard:3x4:20mm"));
    assert!(edges.nearest([-0.021, -0.01], [Side::Low; 2], 0.001, [0.001; 2]).is_some());
    for point in
        [[-0.041, -0.01], [-10.0, -0.01], [0.02, 1e9], [f64::INFINITY, 0.0], [f64::NAN, 0.01], [0.01, f64::NAN]]
    {
        for clearance in [0.0, 0.001] {
            for light in [Side::Low, Side::High] {
                assert_eq!(edges.nearest(point, [light; 2], clearance, [clearance; 2]), None, "{point:?}");
            }
        }
    }
}

#[test]
fn an_empty_raster_has_no_edges() {
    let edges = SquareEdges::new(&Raster::of_dark(&[]));
    assert!(edges.edges().is_empty());
    assert_eq!(edges.nearest([0.0, 0.0], [Side::Low; 2], 0.0, [0.0; 2]), None);
}

//! Checkerboards: saddle points in the order of the board's inner corners.
//!
//! The corners of a board form a symmetric lattice, so the lattice finder of `evcal-core` orders them. A partly visible
//! board is accepted if ends of the board are visible or its position is predicted. The shades around the corners must
//! alternate.

mod lattice;
mod placement;

use evcal_core::grid::{
    FoundGrid, GridCandidate, GridError, GridOptions, GridWorkspace, LatticeSite, find_grid, find_grid_near,
    find_lattice, reorder, symmetry,
};
use evcal_core::pattern::{Layout, Pattern};
use nalgebra::Vector2;

use crate::found_point::FoundPoint;
use crate::picture::Picture;
use crate::saddles::{Saddle, SaddleTest, find_saddles, refine_saddle};
pub(crate) use lattice::{CornerLattice, corner_lattices};
use placement::{LatticeCorner, Placement, place_by_ends};

/// Capacity of the lattice finder in saddles.
const CAPACITY: usize = 512;
/// Smallest fraction of the corners whose shades must match the board.
const LEAST_ALTERNATING: f64 = 0.85;
/// Half the side of the window in which a corner is refined, as a fraction of the distance to its neighbours; and its
/// limits in pixels at the scale at which the corner was found.
const WINDOW: f32 = 0.45;
const WINDOWS: [f32; 2] = [2.0, 6.0];

/// If no board is found, the search is repeated at half the scale, down to this width or height in pixels.
const LEAST_PICTURE: usize = 200;

/// The reason why a picture has no checkerboard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
#[non_exhaustive]
pub enum NoCheckerboard {
    /// Boards must have at least two rows and columns of corners, and at most as many corners as the finder's capacity.
    #[error("boards of {rows} x {columns} inner corners are not supported")]
    BoardSize {
        /// Rows of inner corners.
        rows: u8,
        /// Columns of inner corners.
        columns: u8,
    },
    /// There are fewer saddle points than needed corners.
    #[error("{found} saddle points found, {needed} corners needed")]
    TooFewSaddles {
        /// Saddle points found.
        found: usize,
        /// Corners needed.
        needed: usize,
    },
    /// The saddle points do not form a lattice.
    #[error("the saddle points do not form a lattice")]
    NoLattice,
    /// Too few corners of the board were found.
    #[error("{found} corners of the board found, {needed} needed")]
    TooFewCorners {
        /// Corners found.
        found: usize,
        /// Corners needed.
        needed: usize,
    },
    /// The saddle points scatter too much about a smooth lattice.
    #[error("the saddle points scatter too much to be corners of a flat board")]
    Scattered,
    /// Dark and light squares do not alternate.
    #[error("dark and light squares do not alternate")]
    NotAlternating,
    /// The lattice continues beyond the board: the board has another size.
    #[error("{outside} corners beyond the board: the board has another size")]
    LargerThanBoard {
        /// Corners beyond the board.
        outside: usize,
    },
    /// The board is cut by the border of the picture and fits at several positions.
    #[error("the position of the board is ambiguous: {best} corners fit the best position, {runner_up} the next")]
    PlaceUncertain {
        /// Number of corners that agree with the best position.
        best: usize,
        /// Number of corners that agree with the second best.
        runner_up: usize,
    },
    /// A whole checkerboard is visible, of another size.
    #[error("the board has {rows} x {columns} inner corners, or {columns} x {rows}")]
    OtherSize {
        /// The smaller number of inner corners.
        rows: usize,
        /// The greater number of inner corners.
        columns: usize,
    },
    /// There is a lattice, but not at the expected position.
    #[error("the corners are not at the expected position of the board")]
    NotAsExpected,
}

impl From<GridError> for NoCheckerboard {
    fn from(error: GridError) -> Self {
        match error {
            GridError::TooFewCandidates { usable, needed } => Self::TooFewSaddles { found: usable, needed },
            GridError::TooFewCircles { found, needed } => Self::TooFewCorners { found, needed },
            GridError::NotSmooth => Self::Scattered,
            GridError::WrongBoard { outside } => Self::LargerThanBoard { outside },
            GridError::AmbiguousPlacement { best, runner_up } => Self::PlaceUncertain { best, runner_up },
            GridError::NotAsExpected => Self::NotAsExpected,
            _ => Self::NoLattice,
        }
    }
}

/// Finds the inner corners of a checkerboard with `rows` × `columns` of them, by increasing index; indices count row by
/// row. Some corners may be invisible.
///
/// The order is the same as in OpenCV's `findChessboardCorners`. If one of the counts is odd and the other even, the
/// order is unique: the square outside the first corner is dark. Otherwise the board looks the same after a rotation by
/// 180° (a square board with even counts also after 90°), and several orders are possible. Then the order is the one
/// nearest to `expected`, which contains the positions of the corners in a neighbouring picture by index. Without
/// `expected`, it is the order whose first corner is nearest to the top left.
///
/// `expected` also determines which corners are visible if the border of the picture cuts the board.
///
/// # Errors
/// Returns [`NoCheckerboard`] unless a board is found with certainty.
pub fn find_checkerboard(
    picture: &Picture,
    rows: u8,
    columns: u8,
    expected: Option<&[Option<[f32; 2]>]>,
) -> Result<Vec<FoundPoint>, NoCheckerboard> {
    let pattern = Pattern { layout: Layout::Symmetric, rows, columns };
    if rows < 2 || columns < 2 || pattern.circle_count() * 2 > CAPACITY {
        return Err(NoCheckerboard::BoardSize { rows, columns });
    }
    let mut workspace = workspace();
    let OrderedCorners { corners, scale } = corners_at_scales(picture, &pattern, expected, &mut workspace)?;
    let position = |&(index, saddle): &(usize, Saddle)| {
        let near =
            corners.iter().map(|(_, other)| distance(other.pixel, saddle.pixel)).filter(|&distance| distance > 0.0);
        let spacing = near.fold(f32::INFINITY, f32::min);
        let half = (spacing * WINDOW).clamp(WINDOWS[0], WINDOWS[1] * scale).round() as usize;
        FoundPoint {
            index,
            pixel: refine_saddle(picture, saddle.pixel, half).map_or(saddle.pixel, |position| position.pixel),
        }
    };
    Ok(corners.iter().map(position).collect())
}

// A separate function, so that the temporary workspace is not part of the stack frames of a recursion.
#[inline(never)]
fn workspace() -> Box<GridWorkspace<f64, CAPACITY>> {
    Box::new(GridWorkspace::new())
}

/// Corners of the board by index, and the factor by which the picture was reduced.
struct OrderedCorners {
    corners: Vec<(usize, Saddle)>,
    scale: f32,
}

/// Finds the corners of the board. Blurred corners of a large picture are not saddles within a few pixels, but become
/// saddles in a smaller picture.
fn corners_at_scales(
    picture: &Picture,
    pattern: &Pattern,
    expected: Option<&[Option<[f32; 2]>]>,
    workspace: &mut GridWorkspace<f64, CAPACITY>,
) -> Result<OrderedCorners, NoCheckerboard> {
    let (full, mut scale) = (picture, 1.0);
    let mut reduced: Option<Picture> = None;
    let mut best: Result<OrderedCorners, NoCheckerboard> = Err(NoCheckerboard::NoLattice);
    loop {
        let picture = reduced.as_ref().unwrap_or(full);
        let at_scale = |[x, y]: [f32; 2]| [(x + 0.5) / scale - 0.5, (y + 0.5) / scale - 0.5];
        let expected: Option<Vec<_>> = expected.map(|pixels| pixels.iter().map(|pixel| pixel.map(at_scale)).collect());
        let found = ordered(picture, pattern, expected.as_deref(), workspace).map(|mut corners| {
            for (_, saddle) in &mut corners {
                saddle.pixel = saddle.pixel.map(|place| (place + 0.5) * scale - 0.5);
            }
            OrderedCorners { corners, scale }
        });
        best = match (best, found) {
            (Ok(best), Ok(found)) if found.corners.len() <= best.corners.len() => Ok(best),
            (Ok(best), Err(_)) => Ok(best),
            (_, Ok(found)) => Ok(found),
            (Err(reason), Err(other)) => Err(if scale > 1.0 { reason.max(other) } else { other }),
        };
        reduced = smaller(picture);
        scale *= 2.0;
        let complete = best.as_ref().is_ok_and(|best| best.corners.len() == pattern.circle_count());
        if complete || reduced.is_none() {
            return best;
        }
    }
}

/// Returns the picture at half the scale, if it is large enough for the search.
fn smaller(picture: &Picture) -> Option<Picture> {
    picture.halved().filter(|picture| picture.width().min(picture.height()) >= LEAST_PICTURE)
}

fn candidates_of(saddles: &[Saddle]) -> Vec<GridCandidate<f64>> {
    let candidate = |saddle: &Saddle| GridCandidate { center: Vector2::from(saddle.pixel).cast(), radius: 0.0 };
    saddles.iter().map(candidate).collect()
}

/// Returns the saddles of a picture that are corners of the board, by index.
fn ordered(
    picture: &Picture,
    pattern: &Pattern,
    expected: Option<&[Option<[f32; 2]>]>,
    workspace: &mut GridWorkspace<f64, CAPACITY>,
) -> Result<Vec<(usize, Saddle)>, NoCheckerboard> {
    let saddles = find_saddles(picture, CAPACITY);
    let candidates = candidates_of(&saddles);
    let options = GridOptions::new(pattern, (picture.width() as f64, picture.height() as f64));
    let near = expected.and_then(|expected| {
        let expected: Vec<_> = expected.iter().map(|pixel| pixel.map(|pixel| Vector2::from(pixel).cast())).collect();
        find_grid_near(&candidates, pattern, &options, &expected, workspace).ok()
    });
    let corners = match near.map_or_else(|| find_grid(&candidates, pattern, &options, workspace), Ok) {
        Ok(found) => corners(&found, &saddles),
        Err(reason @ (GridError::AmbiguousPlacement { .. } | GridError::WrongBoard { .. })) => {
            let corner = |site: LatticeSite| {
                let saddle = *saddles.get(usize::from(site.candidate))?;
                Some(LatticeCorner { u: site.u.into(), v: site.v.into(), saddle })
            };
            let lattice = find_lattice(&candidates, &options, workspace)?;
            let lattice: Vec<LatticeCorner> = lattice.into_iter().filter_map(corner).collect();
            match place_by_ends(&lattice, pattern.rows, pattern.columns, &SaddleTest::new(picture)) {
                Placement::Certain(corners) => corners,
                Placement::OtherSize { rows, columns } => return Err(NoCheckerboard::OtherSize { rows, columns }),
                Placement::Uncertain => return Err(reason.into()),
            }
        }
        Err(reason) => return Err(reason.into()),
    };
    oriented(corners, pattern, expected)
}

/// Finds a checkerboard in several pictures of one moment: takes the corners of the picture with most corners, and adds
/// missing ones from the others. Parameters and order are as for [`find_checkerboard`].
///
/// # Errors
/// Returns [`NoCheckerboard`] if no picture has a board, with the reason of the picture that looks most like the board.
pub fn find_checkerboard_in_any(
    pictures: &[Picture],
    rows: u8,
    columns: u8,
    expected: Option<&[Option<[f32; 2]>]>,
) -> Result<Vec<FoundPoint>, NoCheckerboard> {
    let count = usize::from(rows) * usize::from(columns);
    let mut best: Vec<FoundPoint> = Vec::new();
    let mut reason = None;
    for picture in pictures {
        let mut known = vec![None; count];
        for point in &best {
            if let Some(known) = known.get_mut(point.index) {
                *known = Some(point.pixel);
            }
        }
        let found = find_checkerboard(picture, rows, columns, if best.is_empty() { expected } else { Some(&known) });
        match found {
            Ok(mut found) => {
                if found.len() < best.len() {
                    std::mem::swap(&mut found, &mut best);
                }
                best = completed(found, best);
            }
            Err(other) => reason = reason.max(Some(other)),
        }
        if best.len() == count {
            break;
        }
    }
    match reason {
        _ if !best.is_empty() => Ok(best),
        Some(reason) => Err(reason),
        None => Err(NoCheckerboard::NoLattice),
    }
}

/// Adds to `found` the points of `others` that it lacks; sorted by index.
fn completed(mut found: Vec<FoundPoint>, others: Vec<FoundPoint>) -> Vec<FoundPoint> {
    found.extend(others);
    // The sort is stable: of two points with the same index the first stays.
    found.sort_by_key(|point| point.index);
    found.dedup_by_key(|point| point.index);
    found
}

fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn corners(found: &FoundGrid<f64, CAPACITY>, saddles: &[Saddle]) -> Vec<(usize, Saddle)> {
    let corner = |circle: &evcal_core::grid::GridCircle| {
        Some((circle.board.into(), *saddles.get(usize::from(circle.candidate))?))
    };
    found.circles.iter().filter_map(corner).collect()
}

/// Returns the agreement of the shades around the corners with a board: from 1, if the square outside the first corner
/// is dark, to −1, if it is bright.
fn shades(corners: &[(usize, Saddle)], columns: usize) -> f64 {
    let at = |index: usize| {
        corners.binary_search_by_key(&index, |corner| corner.0).ok().and_then(|place| corners.get(place))
    };
    let (mut sum, mut count) = (0_i32, 0_i32);
    for &(index, saddle) in corners {
        let (row, column) = (index / columns, index % columns);
        let direction = |from: Option<usize>, to: Option<usize>| {
            let [from, to] = [from, to].map(|index| index.and_then(at).map(|corner| corner.1.pixel));
            let (from, to) = (from.or(to.map(|_| saddle.pixel))?, to.or(from.map(|_| saddle.pixel))?);
            let length = distance(from, to);
            Some([(to[0] - from[0]) / length, (to[1] - from[1]) / length])
        };
        let along = direction((column > 0).then(|| index - 1), (column + 1 < columns).then_some(index + 1));
        let across = direction(index.checked_sub(columns), Some(index + columns));
        let (Some(along), Some(across)) = (along, across) else { continue };
        // The quadrant between both directions has the same shade as the opposite one.
        let quadrant = libm::atan2f(along[1] + across[1], along[0] + across[0]);
        let bright = libm::cosf(2.0 * (quadrant - saddle.bright)) > 0.0;
        sum += if bright == ((row + column) % 2 == 1) { 1 } else { -1 };
        count += 1;
    }
    f64::from(sum) / f64::from(count.max(1))
}

/// Returns the corners in the order that the shades and the expectation determine, by increasing index.
fn oriented(
    corners: Vec<(usize, Saddle)>,
    pattern: &Pattern,
    expected: Option<&[Option<[f32; 2]>]>,
) -> Result<Vec<(usize, Saddle)>, NoCheckerboard> {
    let turned = |turn: usize| {
        let mut turned: Vec<(usize, Saddle)> =
            corners.iter().filter_map(|&(index, saddle)| Some((reorder(pattern, index, turn)?, saddle))).collect();
        turned.sort_by_key(|corner| corner.0);
        (shades(&turned, pattern.columns.into()), turned)
    };
    let turns: Vec<(f64, Vec<(usize, Saddle)>)> = (0..symmetry(pattern)).map(turned).collect();
    if turns.iter().any(|(shades, _)| shades.abs() < LEAST_ALTERNATING) {
        return Err(NoCheckerboard::NotAlternating);
    }
    let any_dark = turns.iter().any(|(shades, _)| *shades > 0.0);
    let right = turns.into_iter().filter(|(shades, _)| *shades > 0.0 || !any_dark).map(|(_, corners)| corners);
    // Of equally good orders the first one is chosen.
    let cost = |corners: &[(usize, Saddle)]| {
        let Some(expected) = expected else { return top_left(corners, pattern) };
        let off = corners.iter().filter_map(|&(index, saddle)| {
            let expected = expected.get(index).copied().flatten()?;
            Some(f64::from(distance(saddle.pixel, expected)).powi(2))
        });
        off.sum()
    };
    let best = right.map(|corners| (cost(&corners), corners)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.map(|(_, corners)| corners).ok_or(NoCheckerboard::NotAlternating)
}

/// Returns a value that is smaller if the first corner is nearer to the top left: the slope of x + y over the board.
fn top_left(corners: &[(usize, Saddle)], pattern: &Pattern) -> f64 {
    let count = corners.len().max(1) as f64;
    let place = |index: usize| {
        let (x, y) = pattern.lattice_position(index);
        f64::from(x + y)
    };
    let middle = corners.iter().map(|corner| place(corner.0)).sum::<f64>() / count;
    let slope =
        |&(index, saddle): &(usize, Saddle)| (place(index) - middle) * f64::from(saddle.pixel[0] + saddle.pixel[1]);
    -corners.iter().map(slope).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rendering::{View, noisy};

    const SQUARE: f64 = 0.025;

    /// Returns the brightness of a board with `rows` × `columns` inner corners, the first at the origin; `dark` is the
    /// shade of the square outside it.
    fn board(rows: i32, columns: i32, dark: bool) -> impl Fn(f64, f64) -> f32 {
        move |x, y| {
            let (column, row) = ((x / SQUARE).floor() as i32 + 1, (y / SQUARE).floor() as i32 + 1);
            let inside = (0..=columns).contains(&column) && (0..=rows).contains(&row);
            if inside && ((row + column) % 2 == 0) == dark { 0.1 } else { 0.9 }
        }
    }

    fn middle(rows: i32, columns: i32) -> [f64; 2] {
        [f64::from(columns - 1) * SQUARE / 2.0, f64::from(rows - 1) * SQUARE / 2.0]
    }

    fn truth(view: &View, columns: usize, index: usize) -> [f32; 2] {
        view.pixel(Vector2::new((index % columns) as f64 * SQUARE, (index / columns) as f64 * SQUARE))
    }

    /// Returns the root mean square distance from the ground truth in pixels.
    fn error(found: &[FoundPoint], view: &View, columns: usize) -> f32 {
        let square = |point: &FoundPoint| distance(point.pixel, truth(view, columns, point.index)).powi(2);
        (found.iter().map(square).sum::<f32>() / found.len() as f32).sqrt()
    }

    #[test]
    fn corners_are_accurate_and_in_order() {
        for turn in [0.0, 1.6, 3.1, -1.5] {
            let view = View::new(middle(6, 9), 0.45, [0.4, -0.3, turn]);
            let picture = view.render(board(6, 9, true));
            let found = find_checkerboard(&picture, 6, 9, None).unwrap();
            assert!(found.iter().map(|point| point.index).eq(0..54));
            let error = error(&found, &view, 9);
            assert!(error < 0.1, "{error} px");
            // A quarter of the contrast as noise.
            let found = find_checkerboard(&noisy(&picture, 0.2), 6, 9, None).unwrap();
            assert!(found.len() >= 50);
        }
    }

    #[test]
    fn corners_are_found_in_large_blurred_pictures() {
        let view = View::new(middle(6, 9), 0.45, [0.4, -0.3, 0.2]);
        let picture = view.render(board(6, 9, true)).enlarged(4).blurred(3.5);
        let found = find_checkerboard(&picture, 6, 9, None).unwrap();
        let small = |pixel: [f32; 2]| pixel.map(|place| (place + 0.5) / 4.0 - 0.5);
        let found: Vec<FoundPoint> =
            found.iter().map(|point| FoundPoint { pixel: small(point.pixel), ..*point }).collect();
        assert!(found.len() == 54 && error(&found, &view, 9) < 0.15);
    }

    #[test]
    fn the_first_corner_has_the_dark_square() {
        // The same board, described from its other end.
        let view = View::new(middle(6, 9), 0.45, [0.2, 0.1, 0.0]);
        let found = find_checkerboard(&view.render(board(6, 9, false)), 6, 9, None).unwrap();
        let turned: Vec<FoundPoint> =
            found.iter().map(|point| FoundPoint { index: 53 - point.index, ..*point }).collect();
        assert!(error(&turned, &view, 9) < 0.1);
    }

    #[test]
    fn boards_with_rotational_symmetry_follow_the_expectation() {
        let view = View::new(middle(5, 7), 0.4, [0.3, 0.2, 2.4]);
        let picture = view.render(board(5, 7, true));
        let alone = find_checkerboard(&picture, 5, 7, None).unwrap();
        let sum = |pixel: [f32; 2]| pixel[0] + pixel[1];
        assert!(sum(alone[0].pixel) < sum(alone[34].pixel));
        for half_turn in [false, true] {
            let near = view.moved(9.0, -6.0);
            let index = |index: usize| if half_turn { 34 - index } else { index };
            let expected: Vec<_> = (0..35).map(|corner| Some(truth(&near, 7, index(corner)))).collect();
            let found = find_checkerboard(&picture, 5, 7, Some(&expected)).unwrap();
            let found: Vec<_> = found.iter().map(|point| FoundPoint { index: index(point.index), ..*point }).collect();
            assert_eq!(found.len(), 35);
            assert!(error(&found, &view, 7) < 0.1);
        }
    }

    #[test]
    fn a_board_cut_by_the_border_is_placed_by_its_ends() {
        let brightness = board(6, 9, true);
        // Two columns are outside, or some columns on both sides, or a corner of the board.
        for (x, y, turn) in
            [(-110.0, 0.0, 0.0), (100.0, 0.0, 3.0), (110.0, 60.0, 0.1), (-90.0, 60.0, 0.0), (0.0, -80.0, 1.4)]
        {
            let view = View::new(middle(6, 9), 0.35, [0.1, 0.1, turn]).moved(x, y);
            let found = find_checkerboard(&view.render(&brightness), 6, 9, None).unwrap();
            assert!(
                (24..54).contains(&found.len()) && error(&found, &view, 9) < 0.1,
                "{x} {y} {turn}: {}",
                error(&found, &view, 9)
            );
        }
    }

    #[test]
    fn a_board_whose_ends_are_outside_needs_an_expectation() {
        let view = View::new(middle(6, 9), 0.19, [0.1, 0.1, 0.0]);
        let picture = view.render(board(6, 9, true));
        assert!(matches!(find_checkerboard(&picture, 6, 9, None), Err(NoCheckerboard::PlaceUncertain { .. })));
        let near = view.moved(5.0, 4.0);
        let expected: Vec<_> = (0..54).map(|index| Some(truth(&near, 9, index))).collect();
        let found = find_checkerboard(&picture, 6, 9, Some(&expected)).unwrap();
        assert!((24..54).contains(&found.len()) && error(&found, &view, 9) < 0.1);
    }

    #[test]
    fn pictures_of_one_moment_complete_each_other() {
        let view = View::new(middle(6, 9), 0.45, [0.2, -0.3, 0.1]);
        let brightness = board(6, 9, true);
        let hidden = |left: f64, right: f64| {
            view.render(|x, y| if x > left * SQUARE && x < right * SQUARE { 0.5 } else { brightness(x, y) })
        };
        let whole_but_for_one = |x: f64, y: f64| if x.hypot(y) < 0.5 * SQUARE { 0.5 } else { brightness(x, y) };
        let pictures = [view.render(|_, _| 0.5), view.render(whole_but_for_one), hidden(5.5, 9.5)];
        assert_eq!(find_checkerboard(&pictures[1], 6, 9, None).unwrap().len(), 53);
        assert!(find_checkerboard(&pictures[2], 6, 9, None).unwrap().len() < 40);
        let found = find_checkerboard_in_any(&pictures, 6, 9, None).unwrap();
        assert!(found.iter().map(|point| point.index).eq(0..54) && error(&found, &view, 9) < 0.1);
        let none = find_checkerboard_in_any(&pictures[..1], 6, 9, None);
        assert!(matches!(none, Err(NoCheckerboard::TooFewSaddles { found: 0, .. })));
    }

    #[test]
    fn other_patterns_are_rejected_with_their_reason() {
        let view = View::new(middle(6, 9), 0.45, [0.2, -0.3, 0.1]);
        let refused = |picture: &Picture| find_checkerboard(picture, 6, 9, None).unwrap_err();
        let other = |rows, columns| NoCheckerboard::OtherSize { rows, columns };
        assert_eq!(refused(&view.render(board(8, 9, true))), other(8, 9));
        // The numbers of squares instead of corners.
        assert_eq!(find_checkerboard(&view.render(board(6, 9, true)), 7, 10, None), Err(other(6, 9)));
        let dots = |x: f64, y: f64| {
            let off = [x, y].map(|place| (place / SQUARE).round() * SQUARE - place);
            if off[0].hypot(off[1]) < 0.3 * SQUARE { 0.1 } else { 0.9 }
        };
        refused(&view.render(dots));
        assert!(matches!(refused(&view.render(|_, _| 0.5)), NoCheckerboard::TooFewSaddles { found: 0, .. }));
        // Saddles everywhere, but all of the same kind.
        let kites = |x: f64, y: f64| {
            let [a, b] = [x + y, x - y].map(|place| (place / SQUARE).rem_euclid(1.0) - 0.5);
            if a.abs().max(b.abs()) < 0.25 || a.abs().min(b.abs()) > 0.25 { 0.1 } else { 0.9 }
        };
        refused(&view.render(kites));
        let size = NoCheckerboard::BoardSize { rows: 1, columns: 9 };
        assert_eq!(find_checkerboard(&view.render(|_, _| 0.5), 1, 9, None), Err(size));
    }
}

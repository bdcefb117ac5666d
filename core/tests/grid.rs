//! The grid finder on random views of boards, compared with the ground truth.

#[path = "support/grid_views.rs"]
mod grid_views;

use evcal_core::grid::{
    FoundGrid, GridCandidate, GridCircle, GridError, GridOptions, GridWorkspace, LatticeSite, Ordering, find_grid,
    find_grid_near, find_lattice, reorder, symmetry,
};
use evcal_core::pattern::{Layout, Pattern};
use grid_views::{Lens, Random, SIZE, Setting, View, view};
use nalgebra::Vector2;
use proptest::prelude::*;

const BOARD: Pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };
const LENSES: [Lens; 2] = [Lens::Radtan, Lens::Fisheye];

fn asymmetric(rows: u8, columns: u8) -> Pattern {
    Pattern { layout: Layout::Asymmetric, rows, columns }
}

fn symmetric(rows: u8, columns: u8) -> Pattern {
    Pattern { layout: Layout::Symmetric, rows, columns }
}

fn clean(pattern: Pattern, lens: Lens) -> Setting {
    Setting { pattern, lens, tilt: 60.0, noise: 0.2, clutter: 0, missing: 0, cut: false }
}

fn find(candidates: &[GridCandidate<f64>], pattern: &Pattern) -> Result<FoundGrid<f64, 128>, GridError> {
    find_grid(candidates, pattern, &GridOptions::new(pattern, SIZE), &mut GridWorkspace::<f64, 128>::new())
}

/// Returns the view as seen in a mirror.
fn mirrored(mut view: View) -> View {
    for candidate in &mut view.candidates {
        candidate.center.x = SIZE.0 - candidate.center.x;
    }
    view
}

#[derive(Debug, PartialEq, Eq)]
enum Outcome {
    Right,
    /// A false candidate was taken for a missing dot.
    Intruder,
    WrongOrder,
    Refused,
}

fn outcome(view: &View, pattern: &Pattern) -> Outcome {
    let Ok(found) = find(&view.candidates, pattern) else { return Outcome::Refused };
    let truth = |candidate: u16| view.truth[usize::from(candidate)];
    let in_order = (0..symmetry(pattern)).any(|turn| {
        found.circles.iter().all(|circle| {
            let index = truth(circle.candidate);
            index.is_none() || index == reorder(pattern, usize::from(circle.board), turn)
        })
    });
    if !in_order {
        Outcome::WrongOrder
    } else if found.circles.iter().any(|circle| truth(circle.candidate).is_none()) {
        Outcome::Intruder
    } else {
        Outcome::Right
    }
}

/// Counts the outcomes of `count` views: right, intruder, wrong order, rejected.
fn count(setting: &Setting, count: usize) -> [usize; 4] {
    let mut random = Random::new(11);
    let mut counts = [0; 4];
    for _ in 0..count {
        counts[outcome(&view(setting, &mut random), &setting.pattern) as usize] += 1;
    }
    counts
}

#[test]
fn clutter_neither_hides_nor_rotates_the_board() {
    for lens in LENSES {
        for (clutter, least) in [(0, 495), (4, 490), (8, 485), (16, 475)] {
            let [right, _, wrong, _] = count(&Setting { clutter, ..clean(BOARD, lens) }, 500);
            assert!(right >= least, "{lens:?} with {clutter}: {right} of 500 right");
            assert_eq!(wrong, 0, "{lens:?} with {clutter}");
        }
    }
}

#[test]
fn missing_dots_do_not_hide_the_board() {
    for lens in LENSES {
        for (missing, clutter, least) in [(3, 0, 490), (6, 0, 475), (6, 8, 450)] {
            let [right, intruder, wrong, _] = count(&Setting { missing, clutter, ..clean(BOARD, lens) }, 500);
            assert!(right >= least, "{lens:?} -{missing} +{clutter}: {right} of 500 right");
            assert!(intruder <= 10, "{lens:?} -{missing} +{clutter}: {intruder} intruders");
            assert_eq!(wrong, 0, "{lens:?} -{missing} +{clutter}");
        }
    }
}

#[test]
fn difficult_views_are_rejected_rather_than_misread() {
    for lens in LENSES {
        for setting in [
            Setting { missing: 20, ..clean(BOARD, lens) },
            Setting { missing: 12, clutter: 16, ..clean(BOARD, lens) },
            Setting { noise: 1.0, missing: 4, clutter: 8, ..clean(BOARD, lens) },
            Setting { cut: true, missing: 3, clutter: 8, noise: 0.5, ..clean(BOARD, lens) },
        ] {
            let [_, _, wrong, _] = count(&setting, 500);
            assert!(wrong <= 1, "{setting:?}: {wrong} of 500 wrong");
        }
    }
}

/// Circles that move along their row, or lie on the axis of the motion, are missed together.
#[test]
fn lines_missed_as_a_whole_do_not_shift_the_board() {
    let missed: [fn(usize, usize) -> bool; 5] = [
        |row, _| row == 8,
        |row, _| row >= 7,
        |_, column| column == 3,
        |row, column| column == 3 && row % 2 == 1,
        |row, column| row == 0 || column == 0,
    ];
    for (index, missed) in missed.iter().enumerate() {
        for clutter in [0, 4] {
            let mut random = Random::new(16);
            for _ in 0..100 {
                let setting = Setting { clutter, cut: true, ..clean(BOARD, LENSES[index % 2]) };
                let mut view = view(&setting, &mut random);
                let kept: Vec<bool> =
                    view.truth.iter().map(|truth| truth.is_none_or(|circle| !missed(circle / 4, circle % 4))).collect();
                let mut keep = kept.iter();
                view.candidates.retain(|_| *keep.next().unwrap());
                let mut keep = kept.iter();
                view.truth.retain(|_| *keep.next().unwrap());
                assert_ne!(outcome(&view, &BOARD), Outcome::WrongOrder, "lines {index} missed");
            }
        }
    }
}

/// The first row is above the image. One row farther down, the board would have a row that is missing within the image.
#[test]
fn a_row_missing_at_rest_determines_the_end_of_the_board() {
    let pattern = symmetric(7, 6);
    let image_size = (200.0, 200.0);
    let pixel = |circle: usize| {
        let (x, y) = pattern.lattice_position(circle);
        Vector2::new(30.0 + 20.0 * f64::from(x), 20.0 * f64::from(y) - 10.0)
    };
    let visible: Vec<usize> = (0..pattern.circle_count()).filter(|&circle| pixel(circle).y > 0.0).collect();
    let candidates: Vec<_> =
        visible.iter().map(|&circle| GridCandidate { center: pixel(circle), radius: 6.0 }).collect();
    let mut workspace = GridWorkspace::<f64, 128>::new();
    let in_motion = GridOptions::new(&pattern, image_size);
    let found = find_grid(&candidates, &pattern, &in_motion, &mut workspace);
    assert!(matches!(found, Err(GridError::AmbiguousPlacement { .. })), "{found:?}");
    let at_rest = GridOptions { independent_misses: true, ..in_motion };
    let found = find_grid(&candidates, &pattern, &at_rest, &mut workspace).unwrap();
    let circle = |circle: &GridCircle| visible.get(usize::from(circle.candidate)) == Some(&usize::from(circle.board));
    assert!(found.circles.len() == visible.len() && found.circles.iter().all(circle), "{found:?}");
}

#[test]
fn boards_are_found_at_their_expected_position() {
    let shift = Vector2::new(2.0, -1.5);
    for (pattern, cut, least) in [(BOARD, true, 290), (symmetric(6, 5), false, 295), (symmetric(6, 6), true, 290)] {
        let setting = Setting { cut, clutter: 4, ..clean(pattern, Lens::Radtan) };
        let options = GridOptions::new(&pattern, SIZE);
        let mut workspace = GridWorkspace::<f64, 128>::new();
        let mut random = Random::new(14);
        let (mut views, mut right) = (0, 0);
        while views < 300 {
            let view = view(&setting, &mut random);
            if view.visible < options.minimum_circles + 3 {
                continue;
            }
            views += 1;
            let expected: Vec<_> = view.dots.iter().map(|dot| dot.map(|dot| dot + shift)).collect();
            let Ok(found) = find_grid_near(&view.candidates, &pattern, &options, &expected, &mut workspace) else {
                continue;
            };
            assert_eq!(found.ordering, Ordering::Unique);
            for circle in &found.circles {
                let truth = view.truth[usize::from(circle.candidate)];
                assert!(truth.is_none_or(|index| index == usize::from(circle.board)));
            }
            right += 1;
        }
        assert!(right >= least, "{pattern:?}: {right} of 300");
    }
}

#[test]
fn a_board_far_from_its_expected_position_is_rejected() {
    let mut random = Random::new(15);
    let options = GridOptions::new(&BOARD, SIZE);
    let mut workspace = GridWorkspace::<f64, 128>::new();
    for _ in 0..50 {
        let view = view(&clean(BOARD, Lens::Radtan), &mut random);
        let mut find = |expected: &[Option<Vector2<f64>>]| {
            find_grid_near(&view.candidates, &BOARD, &options, expected, &mut workspace)
        };
        // Half a step down a row: equally far from two circles.
        let halfway: Vec<_> = (0..36)
            .map(|index| {
                let (here, next) = (view.dots[index]?, view.dots[if index < 32 { index + 4 } else { index - 4 }]?);
                Some((here + next) * 0.5)
            })
            .collect();
        assert_eq!(find(&halfway), Err(GridError::NotAsExpected));
        // Rotated by 180°, although the board is not.
        let turned: Vec<_> = view.dots.iter().rev().copied().collect();
        assert_eq!(find(&turned), Err(GridError::NotAsExpected));
        assert_eq!(find(&[]), Err(GridError::NotAsExpected));
        assert_eq!(find(&[Some(Vector2::new(f64::NAN, 0.0)); 36]), Err(GridError::NotAsExpected));
    }
}

#[test]
fn symmetric_boards_are_found_up_to_their_rotations() {
    for (pattern, turns) in [(symmetric(6, 3), 2), (symmetric(5, 5), 4), (asymmetric(8, 5), 2)] {
        assert_eq!(symmetry(&pattern), turns);
        let mut random = Random::new(5);
        let mut right = 0;
        for _ in 0..200 {
            let view = view(&Setting { clutter: 3, ..clean(pattern, Lens::Radtan) }, &mut random);
            right += usize::from(outcome(&view, &pattern) == Outcome::Right);
            let Ok(found) = find(&view.candidates, &pattern) else { continue };
            assert_eq!(found.ordering, Ordering::Ambiguous(turns as u8));
        }
        assert!(right >= 194, "{pattern:?}: {right} of 200");
    }
}

#[test]
fn the_first_circle_of_an_ambiguous_board_is_at_the_top_left() {
    let pattern = symmetric(6, 3);
    let mut candidates = Vec::new();
    for index in 0..pattern.circle_count() {
        let (x, y) = pattern.lattice_position(index);
        // Listed from last to first, with the board on its side: rows run to the right.
        let center = Vector2::new(40.0 + 30.0 * f64::from(y), 200.0 - 30.0 * f64::from(x));
        candidates.insert(0, GridCandidate { center, radius: 8.0 });
    }
    let found = find(&candidates, &pattern).unwrap();
    assert_eq!(found.circles.len(), 18);
    // A first circle can be at two corners, (40, 200) and (190, 140), with x + y = 240 and 330. The former is nearer to
    // the top left.
    let first = candidates[usize::from(found.circles[0].candidate)].center;
    assert_eq!(first, Vector2::new(40.0, 200.0));
    let second = candidates[usize::from(found.circles[1].candidate)].center;
    assert_eq!(second, Vector2::new(40.0, 170.0));
}

#[test]
fn a_mirrored_chiral_board_is_rejected() {
    let pattern = asymmetric(8, 5);
    let mut random = Random::new(3);
    for lens in LENSES {
        for clutter in [0, 4] {
            for _ in 0..150 {
                let view = mirrored(view(&Setting { clutter, ..clean(pattern, lens) }, &mut random));
                assert_eq!(outcome(&view, &pattern), Outcome::Refused);
            }
        }
    }
}

/// A board that equals its own mirror image cannot be rejected, because its picture in a mirror is also a valid picture
/// from another viewpoint. The order returned must be the one of that picture.
#[test]
fn the_order_of_the_circles_is_never_mirrored() {
    for pattern in [BOARD, symmetric(6, 3), symmetric(5, 5)] {
        let mut random = Random::new(4);
        let mut found_boards = 0;
        for round in 0..200 {
            let mut view = view(&clean(pattern, Lens::Radtan), &mut random);
            if round % 2 == 1 {
                view = mirrored(view);
            }
            let Ok(found) = find(&view.candidates, &pattern) else { continue };
            found_boards += 1;
            let place = |index: usize| {
                let circle = found.circles.iter().find(|circle| usize::from(circle.board) == index)?;
                Some(view.candidates[usize::from(circle.candidate)].center)
            };
            let columns = usize::from(pattern.columns);
            for row in 0..usize::from(pattern.rows) - 2 {
                // Two circles of a row, and the first two rows further down.
                let (Some(here), Some(right), Some(down)) =
                    (place(row * columns), place(row * columns + 1), place((row + 2) * columns))
                else {
                    continue;
                };
                assert!((right - here).perp(&(down - here)) > 0.0);
            }
        }
        assert!(found_boards >= 195, "{pattern:?}: {found_boards} of 200");
    }
}

#[test]
fn a_lattice_has_the_steps_of_the_board() {
    let pattern = symmetric(6, 9);
    let mut random = Random::new(5);
    for lens in LENSES {
        for _ in 0..20 {
            let view = view(&clean(pattern, lens), &mut random);
            let options = GridOptions::new(&pattern, SIZE);
            let mut workspace = GridWorkspace::<f64, 128>::new();
            let sites = find_lattice(&view.candidates, &options, &mut workspace).unwrap();
            assert!(sites.len() >= 50, "{} sites", sites.len());
            let is_turned = |turn: usize| {
                let shift = |site: &LatticeSite| {
                    let (u, v) = (i32::from(site.u), i32::from(site.v));
                    let turned = [[u, v], [-v, u], [-u, -v], [v, -u]][turn];
                    let (x, y) = pattern.lattice_position(view.truth[usize::from(site.candidate)].unwrap());
                    [x - turned[0], y - turned[1]]
                };
                sites.iter().all(|site| shift(site) == shift(&sites[0]))
            };
            assert!((0..4).any(is_turned));
        }
    }
}

#[test]
fn other_boards_are_rejected() {
    for (shown, sought) in [
        (asymmetric(7, 3), BOARD),
        (BOARD, asymmetric(11, 4)),
        (asymmetric(11, 4), BOARD),
        (asymmetric(10, 4), BOARD),
        (asymmetric(9, 5), BOARD),
        (BOARD, asymmetric(9, 6)),
        (symmetric(6, 6), BOARD),
        (BOARD, symmetric(6, 6)),
        (symmetric(5, 4), symmetric(6, 5)),
        (symmetric(7, 6), symmetric(6, 6)),
    ] {
        let mut random = Random::new(9);
        let accepted = (0..200)
            .filter(|_| find(&view(&clean(shown, Lens::Radtan), &mut random).candidates, &sought).is_ok())
            .count();
        assert_eq!(accepted, 0, "{shown:?} taken for {sought:?}");
    }
}

#[test]
fn no_board_is_found_in_random_points() {
    let mut random = Random::new(2);
    for count in [20, 36, 60, 100, 128] {
        for _ in 0..100 {
            let candidates: Vec<_> = (0..count)
                .map(|_| {
                    let center = Vector2::new(random.uniform(0.0, SIZE.0), random.uniform(0.0, SIZE.1));
                    GridCandidate { center, radius: 0.0 }
                })
                .collect();
            for pattern in [BOARD, symmetric(6, 3), symmetric(5, 5)] {
                assert!(find(&candidates, &pattern).is_err(), "{count} random points taken for {pattern:?}");
            }
        }
    }
}

#[test]
fn the_order_of_the_candidates_does_not_matter() {
    let mut random = Random::new(6);
    for _ in 0..50 {
        let view = view(&Setting { clutter: 8, missing: 3, ..clean(BOARD, Lens::Radtan) }, &mut random);
        let mut shuffled = view.candidates.clone();
        random.shuffle(&mut shuffled);
        let places = |candidates: &[GridCandidate<f64>]| {
            find(candidates, &BOARD).map(|found| {
                let circle = |circle: &evcal_core::grid::GridCircle| {
                    (circle.board, candidates[usize::from(circle.candidate)].center)
                };
                found.circles.iter().map(circle).collect::<Vec<_>>()
            })
        };
        assert_eq!(places(&view.candidates), places(&shuffled));
    }
}

#[test]
fn single_precision_finds_the_same_boards() {
    let mut random = Random::new(8);
    let mut workspace = GridWorkspace::<f32, 64>::new();
    let mut same = 0;
    for index in 0..200 {
        let setting = Setting { clutter: 8, missing: 2, ..clean(BOARD, LENSES[index % 2]) };
        let view = view(&setting, &mut random);
        let single: Vec<_> = view
            .candidates
            .iter()
            .map(|candidate| GridCandidate { center: candidate.center.cast::<f32>(), radius: 0.0 })
            .collect();
        let found = find_grid(&single, &BOARD, &GridOptions::new(&BOARD, SIZE), &mut workspace);
        match (found, find(&view.candidates, &BOARD)) {
            (Ok(single), Ok(double)) => {
                same += 1;
                for circle in &single.circles {
                    let other = double.circles.iter().find(|other| other.board == circle.board);
                    assert!(other.is_none_or(|other| other.candidate == circle.candidate));
                }
            }
            (Err(_), Err(_)) => same += 1,
            _ => {}
        }
    }
    assert!(same >= 196, "{same} of 200");
}

#[test]
fn sets_without_a_board_are_rejected_with_their_reason() {
    let at = |x: f64, y: f64| GridCandidate { center: Vector2::new(x, y), radius: 0.0 };
    assert_eq!(find(&[], &BOARD), Err(GridError::TooFewCandidates { usable: 0, needed: 15 }));
    let line: Vec<_> = (0..36).map(|index| at(f64::from(index) * 7.0, 20.0 + f64::from(index))).collect();
    assert_eq!(find(&line, &BOARD), Err(GridError::NoLattice));
    let twins = vec![at(100.0, 100.0); 60];
    assert_eq!(find(&twins, &BOARD), Err(GridError::TooFewCandidates { usable: 1, needed: 15 }));
    let broken: Vec<_> = (0..60).map(|index| at(f64::NAN, f64::from(index))).collect();
    assert_eq!(find(&broken, &BOARD), Err(GridError::TooFewCandidates { usable: 0, needed: 15 }));
    let many: Vec<_> = (0..129).map(|index| at(f64::from(index), f64::from(index * index % 97))).collect();
    assert_eq!(find(&many, &BOARD), Err(GridError::TooManyCandidates { count: 129, capacity: 128 }));
}

#[test]
fn a_board_among_invalid_and_duplicate_candidates_is_found() {
    let mut random = Random::new(12);
    let mut view = view(&clean(BOARD, Lens::Radtan), &mut random);
    for index in 0..20 {
        let center = match index % 3 {
            0 => Vector2::new(f64::NAN, 5.0),
            1 => Vector2::new(5.0, f64::INFINITY),
            _ => view.candidates[index].center,
        };
        view.candidates.push(GridCandidate { center, radius: f64::NAN });
        let twin = if index % 3 == 2 { view.truth[index] } else { None };
        view.truth.push(twin);
    }
    assert_eq!(outcome(&view, &BOARD), Outcome::Right);
}

proptest! {
    /// No candidates cause a panic, and no index appears twice.
    #[test]
    fn any_input_is_accepted(
        centers in prop::collection::vec((any::<f64>(), any::<f64>()), 0..40),
        lattice in prop::collection::vec((0_i32..9, 0_i32..9), 0..60),
        scale in prop_oneof![Just(0.0), Just(1e-300), Just(1e-3), Just(20.0), Just(1e150), Just(1e300)],
        rows in 0_u8..12,
        columns in 0_u8..12,
        layout in prop_oneof![Just(Layout::Asymmetric), Just(Layout::Symmetric)],
        minimum_circles in 0_usize..20,
        minimum_odds in 0.0..1e4,
    ) {
        let points = centers.into_iter().chain(
            lattice.into_iter().map(|(x, y)| (f64::from(x) * scale, f64::from(y) * scale)),
        );
        let candidates: Vec<_> =
            points.map(|(x, y)| GridCandidate { center: Vector2::new(x, y), radius: x }).collect();
        let pattern = Pattern { layout, rows, columns };
        let options = GridOptions { minimum_circles, minimum_odds, ..GridOptions::new(&pattern, SIZE) };
        let mut workspace = GridWorkspace::<f64, 128>::new();
        if let Ok(found) = find_grid(&candidates, &pattern, &options, &mut workspace) {
            let mut boards: Vec<_> = found.circles.iter().map(|circle| circle.board).collect();
            prop_assert!(boards.is_sorted());
            boards.dedup();
            prop_assert_eq!(boards.len(), found.circles.len());
            prop_assert!(boards.iter().all(|&board| usize::from(board) < pattern.circle_count()));
            let mut used: Vec<_> = found.circles.iter().map(|circle| circle.candidate).collect();
            used.sort_unstable();
            used.dedup();
            prop_assert_eq!(used.len(), found.circles.len());
        }
    }

    /// A full rotation of a board changes nothing, and every rotation is a permutation.
    #[test]
    fn rotations_permute_the_board(rows in 2_u8..12, columns in 2_u8..12, asymmetric_layout: bool, turn in 0_usize..4) {
        let layout = if asymmetric_layout { Layout::Asymmetric } else { Layout::Symmetric };
        let pattern = Pattern { layout, rows, columns };
        let mut turned: Vec<_> = (0..pattern.circle_count()).map(|index| reorder(&pattern, index, turn)).collect();
        turned.sort_unstable();
        prop_assert!(turned.iter().enumerate().all(|(index, turned)| *turned == Some(index)));
        for index in 0..pattern.circle_count() {
            let there = reorder(&pattern, index, turn).and_then(|there| reorder(&pattern, there, 4 - turn));
            prop_assert_eq!(there, Some(index));
        }
    }
}

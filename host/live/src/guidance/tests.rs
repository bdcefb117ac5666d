//! Guidance compared with known answers, and with a simulated person who follows it.

use nalgebra::{DMatrix, Isometry3, Point3, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::board_pose::{BoardPose, candidates, in_image, visible};
use super::hint::{Hint, Seen, choose, errors, half_turn};
use super::*;
use crate::coverage::BOARDS;
use crate::{LiveCoverage, Tilt};
use evcal_calibrate::settings::LiveSettings;
use evcal_detection::circles::reference_frame::SeenIn;
use evcal_geometry::numerics::random::{normal, uniform_in};
use evcal_solve::initial::information::{ProjectionMeasure, prior, view_information};

const SENSOR: Sensor = Sensor::new(346, 260);
const LENS: [f64; 9] = [330.0, 330.0, 172.0, 131.0, -0.35, 0.15, 0.0005, -0.0005, -0.03];
/// Time of one step of the simulated person (s).
const STEP: f64 = 0.1;

fn board() -> Board {
    "acircles:9x4:55mm:r17.5mm".parse().unwrap()
}

fn camera() -> Camera<f64> {
    Camera::from_parameters(ModelKind::Radtan, &LENS).unwrap()
}

fn place(position: [f64; 3], tilt: [f64; 2], roll: f64) -> BoardPose {
    BoardPose { position: position.into(), tilt: tilt.into(), roll }
}

fn seen(place: &BoardPose) -> Seen {
    let pose = place.pose(&board());
    Seen { pose, middle: place.position, pixel: camera().project(&place.position).unwrap() }
}

fn hint(now: &BoardPose, goal: &BoardPose) -> Hint {
    choose(&errors(&seen(now), &seen(goal), 346.0), Hint::Show)
}

#[test]
fn hints_name_the_motion_towards_the_ghost() {
    let ahead = place([0.0, 0.0, 1.0], [0.0, 0.0], 0.0);
    for (goal, expected, words) in [
        (place([0.2, 0.0, 1.0], [0.0, 0.0], 0.0), Hint::Shift(1, 0), "to the right"),
        (place([-0.2, 0.0, 1.0], [0.0, 0.0], 0.0), Hint::Shift(-1, 0), "to the left"),
        (place([0.2, -0.2, 1.0], [0.0, 0.0], 0.0), Hint::Shift(1, -1), "to the upper right"),
        (place([0.0, 0.25, 1.0], [0.0, 0.0], 0.0), Hint::Shift(0, 1), "down"),
        (place([0.0, 0.0, 0.6], [0.0, 0.0], 0.0), Hint::Closer, "closer"),
        (place([0.0, 0.0, 1.5], [0.0, 0.0], 0.0), Hint::Farther, "farther away"),
        (place([0.0, 0.0, 1.0], [0.0, 0.0], 0.8), Hint::Clockwise, "turn it clockwise"),
        (place([0.02, 0.0, 1.03], [0.05, 0.0], 0.1), Hint::Stay, "keep moving here"),
    ] {
        let found = hint(&ahead, &goal);
        assert_eq!((found, found.words(false)), (expected, words), "{goal:?}");
    }
    assert_eq!(Hint::Shift(1, -1).words(true), "to the upper left");
    assert_eq!(Hint::Nearer(Tilt::Left).words(true), "right edge nearer");
}

/// The corners of the edge in a hint come nearer on the way to the ghost.
#[test]
fn the_edge_named_in_a_hint_comes_nearer() {
    let ahead = place([0.0, 0.0, 1.0], [0.0, 0.0], 0.0);
    for tilt in [[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]] {
        let goal = place([0.0, 0.0, 1.0], tilt, 0.0);
        let mut nearest = (f64::INFINITY, Tilt::Left);
        for (side, x, y) in
            [(Tilt::Left, -0.2, 0.0), (Tilt::Right, 0.2, 0.0), (Tilt::Top, 0.0, -0.2), (Tilt::Bottom, 0.0, 0.2)]
        {
            let middle = board().middle();
            let depth = (goal.pose(&board()) * Point3::new(middle.x + x, middle.y + y, 0.0)).z;
            if depth < nearest.0 {
                nearest = (depth, side);
            }
        }
        assert_eq!(hint(&ahead, &goal), Hint::Nearer(nearest.1));
    }
}

#[test]
fn an_upside_down_board_needs_no_rotation() {
    let up = place([0.0, 0.0, 1.0], [0.0, 0.0], 0.0);
    assert_eq!(hint(&up, &place([0.0, 0.0, 1.0], [0.0, 0.0], std::f64::consts::PI)), Hint::Stay);
    assert!((half_turn(3.0) - (3.0 - std::f64::consts::PI)).abs() < 1e-12);
}

#[test]
fn a_hint_stays_until_another_error_is_clearly_larger() {
    let errors = |shift, size| {
        [(Hint::Shift(1, 0), shift), (Hint::Closer, size), (Hint::Nearer(Tilt::Top), 0.0), (Hint::Clockwise, 0.0)]
    };
    assert_eq!(choose(&errors(2.0, 2.5), Hint::Shift(0, 1)), Hint::Shift(1, 0));
    assert_eq!(choose(&errors(2.0, 3.5), Hint::Shift(0, 1)), Hint::Closer);
    assert_eq!(choose(&errors(0.9, 1.1), Hint::Shift(0, 1)), Hint::Closer);
    assert_eq!(choose(&errors(0.9, 0.9), Hint::Closer), Hint::Stay);
    let swing = Hint::Swing(Swing::Sideways);
    assert_eq!((choose(&errors(1.4, 0.9), swing), choose(&errors(1.6, 0.9), swing)), (Hint::Stay, Hint::Shift(1, 0)));
}

/// Eliminating the pose is the same as estimating it: the inverse of the information is a block of the inverse of the
/// whole normal equations, here with numerical derivatives.
#[test]
fn the_information_of_a_view_equals_a_joint_estimate_of_camera_and_pose() {
    let (camera, board) = (camera(), board());
    let at = place([0.05, -0.03, 0.8], [0.4, -0.3], 0.2);
    let pose = at.pose(&board);
    let centers: Vec<Vector2<f64>> = (0..board.point_count()).map(|index| board.point(index)).collect();
    let project = |change: &[f64; 15]| -> Vec<f64> {
        let lens: Vec<f64> = LENS.iter().zip(change).map(|(value, change)| value + change).collect();
        let camera = Camera::from_parameters(ModelKind::Radtan, &lens).unwrap();
        let step = Isometry3::new(
            Vector3::new(change[12], change[13], change[14]),
            Vector3::new(change[9], change[10], change[11]),
        );
        let moved = |point: &Vector2<f64>| camera.project(&(step * (pose * Point3::new(point.x, point.y, 0.0))).coords);
        centers
            .iter()
            .flat_map(|point| {
                let pixel = moved(point).unwrap();
                [pixel.x, pixel.y]
            })
            .collect()
    };
    let columns: Vec<Vec<f64>> = (0..15)
        .map(|index| {
            let (mut more, mut less) = ([0.0; 15], [0.0; 15]);
            (more[index], less[index]) = (1e-5, -1e-5);
            project(&more).iter().zip(project(&less)).map(|(more, less)| (more - less) / 2e-5).collect()
        })
        .collect();
    let jacobian = DMatrix::from_fn(2 * centers.len(), 15, |row, column| columns[column][row]);
    let mut whole = jacobian.transpose() * &jacobian / (0.24 * 0.24);
    let known = prior(&camera);
    (0..9).for_each(|index| whole[(index, index)] += known[(index, index)]);
    let expected = whole.try_inverse().unwrap();
    let found = known + view_information(&camera, &pose, centers.iter().copied()).unwrap();
    let found = found.view((0, 0), (9, 9)).into_owned().try_inverse().unwrap();
    for index in 0..9 {
        assert!((found[(index, index)] / expected[(index, index)] - 1.0).abs() < 1e-3, "{index}");
    }
}

/// More views never increase the uncertainty of the camera, and tilted views are more informative than frontal ones.
#[test]
fn tilted_views_are_more_informative_than_frontal_ones() {
    let (camera, board) = (camera(), board());
    let measure = ProjectionMeasure::new(&camera, SENSOR).unwrap();
    let after = |tilts: [[f64; 2]; 4]| {
        let mut information = prior(&camera);
        let mut before = f64::INFINITY;
        for tilt in tilts {
            let pose = place([0.0, 0.0, 0.9], tilt, 0.0).pose(&board);
            let circles = visible(&camera, &board, SENSOR, &pose).unwrap();
            information += view_information(&camera, &pose, circles.into_iter()).unwrap();
            let sigma = measure.sigma(&information).unwrap();
            assert!(sigma <= before);
            before = sigma;
        }
        before
    };
    assert!(after([[0.6, 0.0], [-0.6, 0.0], [0.0, 0.6], [0.0, -0.6]]) < 0.7 * after([[0.0, 0.0]; 4]));
}

#[test]
fn candidates_are_many_and_visible() {
    let found = candidates(&camera(), &board(), SENSOR);
    assert!((100..360).contains(&found.len()), "{}", found.len());
    for candidate in &found {
        assert!(visible(&camera(), &board(), SENSOR, &candidate.place.pose(&board())).is_some());
    }
    assert!(
        found.iter().any(|candidate| candidate.place.roll > 1.0)
            && found.iter().any(|candidate| candidate.place.roll == 0.0)
    );
}

/// If the image cuts off the first or the last row, the board could be shifted by a row, however many circles remain.
#[test]
fn a_board_with_a_cut_off_end_is_not_visible() {
    let (camera, board) = (camera(), board());
    let seen = |x, z| visible(&camera, &board, SENSOR, &place([x, 0.0, z], [0.0, 0.0], 0.0).pose(&board));
    assert_eq!(seen(0.0, 0.8).map(|circles| circles.len()), Some(board.point_count()));
    for cut in [seen(0.0, 0.55), seen(0.28, 0.8)] {
        assert_eq!(cut, None);
    }
}

/// Behaviour of a simulated person.
#[derive(Clone, Copy)]
enum Follows {
    /// Follows the ghost, with these errors of the hands (rad, m).
    Ghost(f64, f64),
    /// Follows the coverage: moves to the emptiest part of the image, then tilts to the side that is missing.
    Coverage,
    /// Follows nothing, and holds the board frontally.
    Nobody,
}

/// Result of a simulated session.
struct Session {
    /// Time until the expected error was reached (s); the whole time if it was not.
    reached: f64,
    /// Fraction of the time in which the board was seen.
    seen: f64,
    guidance: Guidance,
    coverage: LiveCoverage,
}

/// Simulates a person who moves the board at up to 0.35 m/s and 1 rad/s, with a tremor, for at most `seconds`.
fn session(follows: Follows, target: f64, seconds: f64, seed: u64) -> Session {
    let (camera, board) = (camera(), board());
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut guidance = Guidance::new(&board, SENSOR, &InitialSettings::default()).unwrap();
    let mut coverage = LiveCoverage::new(&LiveSettings::default(), &board, SENSOR);
    let mut at = place([0.0, 0.0, 1.0], [0.0, 0.0], 0.0);
    let (mut goal, mut followed) = (at, None);
    let (mut tremor, mut seen, mut steps) = ([0.0; 6], 0.0, 0.0);
    let mut was_seen = false;
    while steps * STEP < seconds && guidance.sigma().is_none_or(|sigma| sigma > target) {
        let now = steps * STEP;
        steps += 1.0;
        let place = guidance.place();
        let is_new = match follows {
            Follows::Ghost(..) => followed != place,
            _ => (steps as u64) % 20 == 1,
        };
        if is_new {
            followed = place;
            let wanted = match follows {
                Follows::Ghost(..) => place.unwrap_or(goal),
                Follows::Coverage => by_coverage(&coverage, steps as u64, &mut random),
                Follows::Nobody => {
                    let z = uniform_in(&mut random, 0.8, 1.2);
                    self::place([0.12 * normal(&mut random), 0.08 * normal(&mut random), z], [0.0, 0.0], 0.0)
                }
            };
            let (turn, shift) = match follows {
                Follows::Ghost(turn, shift) => (turn, shift),
                _ => (0.05, 0.02),
            };
            let mut shaken = |size: f64| normal(&mut random) * size;
            goal = BoardPose {
                position: wanted.position + Vector3::new(shaken(shift), shaken(shift), shaken(shift)),
                tilt: wanted.tilt + Vector2::new(shaken(turn), shaken(turn)),
                roll: wanted.roll + shaken(turn),
            };
        }
        let way = goal.position - at.position;
        let turn = (goal.tilt - at.tilt).push(goal.roll - at.roll);
        at.position += way * (0.35 * STEP / way.norm().max(1e-9)).min(0.5);
        let turn = turn * (STEP / turn.norm().max(1e-9)).min(0.5);
        at.tilt += turn.xy();
        at.roll += turn.z;
        for (index, part) in tremor.iter_mut().enumerate() {
            *part = 0.8 * *part + normal(&mut random) * if index < 3 { 0.02 } else { 0.006 };
        }
        let real = BoardPose {
            position: at.position + Vector3::new(tremor[3], tremor[4], tremor[5]),
            tilt: at.tilt + Vector2::new(tremor[0], tremor[1]),
            roll: at.roll + tremor[2],
        };
        let window = frame(&camera, &board, &real, now, was_seen, &mut random);
        was_seen = window.is_some();
        if let Some(frame) = window {
            seen += 1.0;
            guidance.add(&frame);
            coverage.add(&frame);
            if let Some(camera) = guidance.camera() {
                coverage.set_focal_length(camera.parameters()[0]);
            }
        }
        guidance.advise(now);
    }
    Session { reached: steps * STEP, seen: seen / steps, guidance, coverage }
}

fn by_coverage(coverage: &LiveCoverage, step: u64, random: &mut ChaCha8Rng) -> BoardPose {
    let summary = coverage.summary();
    let z = uniform_in(random, 0.6, 1.0);
    let emptiest = (0..48).min_by(|a, b| summary.cells[*a].total_cmp(&summary.cells[*b])).unwrap_or(0);
    if summary.covered < 0.8 && (step / 40).is_multiple_of(2) {
        let (x, y) = ((emptiest % 8) as f64 / 8.0 - 0.44, (emptiest / 8) as f64 / 6.0 - 0.42);
        return place([0.75 * x * z, 0.5 * y * z, z], [0.0, 0.0], 0.0);
    }
    let side = summary.tilts.iter().position(|count| *count < 10).unwrap_or((step / 20) as usize % 4);
    let turn = uniform_in(random, 0.5, 0.8);
    let tilt = [[0.0, -turn], [0.0, turn], [turn, 0.0], [-turn, 0.0]][side];
    place([0.08 * normal(random), 0.06 * normal(random), z], tilt, 0.0)
}

/// Returns a window with the board. If the previous window had the board too, the image may cut off an end of it.
fn frame(
    camera: &Camera<f64>,
    board: &Board,
    at: &BoardPose,
    t: f64,
    was_seen: bool,
    random: &mut ChaCha8Rng,
) -> Option<ReferenceFrame> {
    let pose = at.pose(board);
    let find = if was_seen { in_image } else { visible };
    let found = find(camera, board, SENSOR, &pose)?;
    let circles = (0..board.point_count()).filter(|index| found.contains(&board.point(*index))).map(|index| {
        let point = board.point(index);
        let noise = Vector2::new(normal(random), normal(random)) * 0.12;
        let center = camera.project(&(pose * Point3::new(point.x, point.y, 0.0)).coords).unwrap() + noise;
        ObservedCircle { index, t, center, radius: None, velocity: None }
    });
    Some(ReferenceFrame { recording: 0, start: t, end: t, circles: circles.collect(), seen_in: SeenIn::Circles })
}

fn median_time(follows: Follows, target: f64) -> (f64, f64) {
    const SEEDS: u64 = 10;
    let sessions: Vec<Session> = (0..SEEDS).map(|seed| session(follows, target, 120.0, seed)).collect();
    let mut times: Vec<f64> = sessions.iter().map(|session| session.reached).collect();
    times.sort_by(f64::total_cmp);
    (0.5 * (times[4] + times[5]), sessions.iter().map(|session| session.seen).sum::<f64>() / SEEDS as f64)
}

/// Purpose of the guidance: a person who follows the ghost finishes in about half the time of someone who follows the
/// coverage (docs/live.md contains the figures printed here).
#[test]
fn following_the_ghost_is_faster_than_following_the_coverage() {
    let (by_coverage, _) = median_time(Follows::Coverage, 0.05);
    let (by_ghost, seen) = median_time(Follows::Ghost(0.1, 0.02), 0.05);
    let (loosely, seen_loosely) = median_time(Follows::Ghost(0.2, 0.05), 0.05);
    println!(
        "coverage {by_coverage:.1} s; ghost {by_ghost:.1} s, board seen {seen:.2}; loosely {loosely:.1} s, {seen_loosely:.2}"
    );
    assert!(by_ghost <= 0.5 * by_coverage, "{by_ghost} {by_coverage}");
    assert!(loosely <= 0.75 * by_coverage, "{loosely} {by_coverage}");
    assert!(seen >= 0.85, "{seen}");
}

#[test]
fn the_provisional_camera_comes_near_the_true_one() {
    let Session { guidance, .. } = session(Follows::Ghost(0.1, 0.02), 0.1, 60.0, 3);
    let found = guidance.camera().unwrap().parameters();
    for (index, bound) in [(0, 3.0), (1, 3.0), (2, 4.0), (3, 4.0)] {
        assert!((found[index] - LENS[index]).abs() < bound, "{found:?}");
    }
}

/// Without tilts the session never ends.
#[test]
fn frontal_views_are_never_sufficient() {
    let Session { coverage, guidance, .. } = session(Follows::Nobody, 0.001, 90.0, 1);
    assert!(coverage.boards() > 2 * BOARDS, "{}", coverage.boards());
    println!("frontal: {:?}, {:?} px", coverage.missing(), guidance.sigma());
    assert!(!coverage.missing().is_empty());
}

#[test]
fn the_same_windows_give_the_same_hints() {
    let first = session(Follows::Ghost(0.1, 0.02), 0.1, 30.0, 5);
    let second = session(Follows::Ghost(0.1, 0.02), 0.1, 30.0, 5);
    assert_eq!(first.reached, second.reached);
    assert_eq!(first.guidance.ghost(), second.guidance.ghost());
    assert_eq!(first.guidance.sigma(), second.guidance.sigma());
}

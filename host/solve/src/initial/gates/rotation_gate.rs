//! Rotation gate (paper III): the rows of the pattern cannot rotate faster than a hand rotates them.
//!
//! Mirrored boards are removed first. If the board looks the same after a rotation by 180° (or 90°), the grid stage cannot know
//! which circle is the first. Rows are then compared up to such a rotation, and the frames that are kept are chained so that the
//! rows rotate as little as possible from frame to frame.

use std::f64::consts::{PI, TAU};

use evcal_core::pattern::Pattern;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use super::neighbour_vote::{Voter, vote};
use crate::initial::report::DropReason;
use crate::initial::settings::InitialSettings;
use crate::initial::sighting::Sighting;
use evcal_detection::circles::reference_frame::ObservedCircle;
use evcal_geometry::board::Board;
use evcal_geometry::board::symmetry::{Symmetry, symmetries};
use evcal_geometry::numerics::statistics::median;

/// Rotation of a row that noise and perspective explain at any rate (rad).
const ROW_ANGLE_FLOOR: f64 = 0.1;

/// Returns, for each rotation of the board in its plane that maps it onto itself, the new index of every circle. The first one is
/// the identity.
fn board_turns(board: &Board) -> Vec<Vec<usize>> {
    let points = |symmetry: Symmetry| symmetry.points.into_iter().map(usize::from).collect();
    symmetries(board).into_iter().map(points).collect()
}

/// Returns the best-fitting affine map from the board to pixels; `None` for circles in one line.
fn board_map(circles: &[ObservedCircle], board: &Board) -> Option<Matrix2<f64>> {
    let mut normal = Matrix3::zeros();
    let mut right = [Vector3::zeros(), Vector3::zeros()];
    for circle in circles {
        let row = board.point(circle.index).push(1.0);
        normal += row * row.transpose();
        right[0] += row * circle.center.x;
        right[1] += row * circle.center.y;
    }
    let cholesky = normal.cholesky()?;
    let (x, y) = (cholesky.solve(&right[0]), cholesky.solve(&right[1]));
    Some(Matrix2::new(x.x, x.y, y.x, y.y)).filter(|map| map.iter().all(|value| value.is_finite()))
}

/// Returns `true` if the circles appear mirrored. A board seen from its front never does: its x, y and the image's x, y have the
/// same sense of rotation.
fn mirrored(circles: &[ObservedCircle], board: &Board) -> bool {
    board_map(circles, board).is_some_and(|map| map.determinant() < 0.0)
}

/// Returns the direction in the image, in rad, of each row of the pattern with at least two observed circles; `turn` contains the
/// circles' indices.
fn row_angles(circles: &[ObservedCircle], pattern: Pattern, turn: &[usize]) -> Vec<Option<f64>> {
    #[derive(Clone, Copy, Default)]
    struct Row {
        count: f64,
        x: f64,
        center: Vector2<f64>,
        xx: f64,
        x_center: Vector2<f64>,
    }
    let mut rows = vec![Row::default(); usize::from(pattern.rows)];
    for circle in circles {
        let (x, y) = turn.get(circle.index).map_or((0, -1), |&index| pattern.lattice_position(index));
        if let Some(row) = usize::try_from(y).ok().and_then(|y| rows.get_mut(y)) {
            let x = f64::from(x);
            row.count += 1.0;
            row.x += x;
            row.center += circle.center;
            row.xx += x * x;
            row.x_center += circle.center * x;
        }
    }
    rows.iter()
        .map(|row| {
            let direction = row.x_center * row.count - row.center * row.x;
            (row.xx * row.count > row.x * row.x && direction.norm() > 0.0).then(|| direction.y.atan2(direction.x))
        })
        .collect()
}

/// Wraps `angle` to (−period/2, period/2].
fn wrap(angle: f64, period: f64) -> f64 {
    let wrapped = angle.rem_euclid(period);
    if wrapped > period / 2.0 { wrapped - period } else { wrapped }
}

/// Returns the rotation from `a` to `b`, modulo `period`: the median over the rows that both frames have.
fn turn_between(a: &[Option<f64>], b: &[Option<f64>], period: f64) -> Option<f64> {
    let differences: Vec<f64> = a.iter().zip(b).filter_map(|(a, b)| Some((*b)? - (*a)?)).collect();
    // The rows of a board that is rotated by half a turn differ by almost π either way: wrap around the first row's difference,
    // not around zero.
    let first = *differences.first()?;
    let mut around: Vec<f64> = differences.iter().map(|difference| wrap(difference - first, TAU)).collect();
    median(&mut around, f64::total_cmp).map(|median| wrap(first + median, period))
}

/// Result of the gate.
#[derive(Clone, Debug, PartialEq)]
pub struct RotationGate {
    /// For each sighting the reason why it is dropped; `None` if it is kept.
    pub verdicts: Vec<Option<DropReason>>,
    /// Number of kept sightings whose circles were renumbered by a rotation of the board.
    pub turned: usize,
}

/// Checks `sightings` (in the order of recording and time) by the directions of their rows, and numbers the circles of symmetric
/// boards continuously in time.
pub fn rotation_gate(sightings: &mut [Sighting], board: &Board, settings: &InitialSettings) -> RotationGate {
    let pattern = board.lattice();
    let turns = board_turns(board);
    let period = TAU / turns.len() as f64;
    let mirrored: Vec<bool> = sightings.iter().map(|sighting| mirrored(&sighting.circles, board)).collect();
    // Row angles per sighting and rotation.
    let angles: Vec<Vec<Vec<Option<f64>>>> = sightings
        .iter()
        .map(|sighting| turns.iter().map(|turn| row_angles(&sighting.circles, pattern, turn)).collect())
        .collect();
    let upright: Vec<usize> =
        mirrored.iter().enumerate().filter(|(_, mirrored)| !**mirrored).map(|(index, _)| index).collect();
    let voters: Vec<Voter> = upright
        .iter()
        .filter_map(|&index| sightings.get(index))
        .map(|sighting| Voter { recording: sighting.recording, t: sighting.t })
        .collect();
    let agree = |a: usize, b: usize| {
        let elapsed = voters.get(b)?.t - voters.get(a)?.t;
        let bound = ROW_ANGLE_FLOOR + settings.max_row_rate * elapsed.abs();
        let unturned = |index: usize| angles.get(*upright.get(index)?)?.first();
        // The circles of `b` may be numbered from another corner. Each rotation of the board renumbers its rows; the
        // numbering with the smallest angle counts.
        let turn = angles
            .get(*upright.get(b)?)?
            .iter()
            .filter_map(|turned| turn_between(unturned(a)?, turned, TAU))
            .min_by(|a, b| a.abs().total_cmp(&b.abs()))?;
        (bound < 0.4 * period).then_some(turn.abs() <= bound)
    };
    let mut verdicts = vec![Some(DropReason::Mirrored); sightings.len()];
    for (stays, &index) in vote(&voters, agree).into_iter().zip(&upright) {
        if let Some(verdict) = verdicts.get_mut(index) {
            *verdict = (!stays).then_some(DropReason::RowsTurned);
        }
    }
    let turned = if turns.len() > 1 { chain(sightings, &verdicts, &angles, &turns) } else { 0 };
    RotationGate { verdicts, turned }
}

/// Renumbers the circles of the kept sightings so that rows rotate by less than half a period from one to the next; in each
/// recording as many as possible keep their numbers. Returns the number of renumbered sightings.
fn chain(
    sightings: &mut [Sighting],
    verdicts: &[Option<DropReason>],
    angles: &[Vec<Vec<Option<f64>>>],
    turns: &[Vec<usize>],
) -> usize {
    let mut chosen: Vec<Option<usize>> = vec![None; sightings.len()];
    let mut previous: Option<(usize, &[Option<f64>])> = None;
    for (position, sighting) in sightings.iter().enumerate() {
        if verdicts.get(position).copied().flatten().is_some() {
            continue;
        }
        let Some(angles) = angles.get(position) else { continue };
        let before = previous.filter(|(recording, _)| *recording == sighting.recording);
        let turn_from_before = |turned: &[Option<f64>]| {
            before.and_then(|(_, before)| turn_between(before, turned, TAU)).map_or(PI, f64::abs)
        };
        let best = angles
            .iter()
            .enumerate()
            .min_by(|(_, a), (_, b)| turn_from_before(a).total_cmp(&turn_from_before(b)))
            .map(|(turn, _)| turn);
        if let Some(turn) = best {
            chosen[position] = Some(turn);
            previous = angles.get(turn).map(|angles| (sighting.recording, angles.as_slice()));
        }
    }
    let mut renamed = 0;
    let mut start = 0;
    while let Some(first) = sightings.get(start) {
        let recording = first.recording;
        let length = sightings.iter().skip(start).take_while(|sighting| sighting.recording == recording).count();
        // Rotate all frames of the recording back by the rotation that most of them got.
        let mut votes = vec![0_usize; turns.len()];
        for turn in chosen.iter().skip(start).take(length).flatten() {
            votes[*turn] += 1;
        }
        let most = votes.iter().enumerate().max_by_key(|(turn, votes)| (**votes, usize::MAX - turn));
        let back = most.map_or(0, |(turn, _)| turn);
        for (sighting, turn) in sightings.iter_mut().zip(&chosen).skip(start).take(length) {
            let Some(turn) = turn else { continue };
            // Rotations are multiples of a period, so their differences are rotations again.
            let turn = (turn + turns.len() - back) % turns.len();
            if turn == 0 {
                continue;
            }
            renamed += 1;
            for circle in &mut sighting.circles {
                if let Some(&index) = turns.get(turn).and_then(|turn| turn.get(circle.index)) {
                    circle.index = index;
                }
            }
            sighting.circles.sort_by_key(|circle| circle.index);
        }
        start += length;
    }
    renamed
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation2;

    fn sighting(board: &Board, t: f64, angle: f64, rename: impl Fn(usize) -> usize) -> Sighting {
        let rotation = Rotation2::new(angle);
        let mut circles: Vec<ObservedCircle> = (0..board.point_count())
            .map(|index| ObservedCircle {
                index: rename(index),
                t,
                center: rotation * (board.point(index) - board.middle()) * 500.0 + Vector2::new(170.0, 130.0),
                radius: None,
                velocity: None,
            })
            .collect();
        circles.sort_by_key(|circle| circle.index);
        Sighting { frame: 0, recording: 0, t, circles, points: Vec::new() }
    }

    fn identity(index: usize) -> usize {
        index
    }

    #[test]
    fn only_rotations_that_map_the_board_onto_itself_are_symmetries() {
        let turns = |text: &str| board_turns(&text.parse().unwrap()).len();
        assert_eq!(turns("circles:3x6:40mm:r10mm"), 2);
        assert_eq!(turns("circles:5x5:40mm:r10mm"), 4);
        assert_eq!(turns("acircles:9x4:55mm:r10mm"), 1);
        // An even number of rows makes an asymmetric board symmetric.
        assert_eq!(turns("acircles:8x4:55mm:r10mm"), 2);
    }

    #[test]
    fn mirrored_and_rotated_frames_are_dropped_even_if_they_come_first() {
        let board: Board = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        let columns = usize::from(board.lattice().columns);
        let mut sightings: Vec<Sighting> = (0..30)
            .map(|step| {
                let (t, angle) = (f64::from(step) * 0.01, f64::from(step) * 0.05);
                match step {
                    0 | 12 => sighting(&board, t, angle + PI, identity),
                    1 => sighting(&board, t, angle + 1.0, identity),
                    // Reading every row backwards mirrors the board.
                    20 => sighting(&board, t, angle, |index| index / columns * columns + columns - 1 - index % columns),
                    _ => sighting(&board, t, angle, identity),
                }
            })
            .collect();
        let gate = rotation_gate(&mut sightings, &board, &InitialSettings::default());
        for (step, verdict) in gate.verdicts.iter().enumerate() {
            let expected = match step {
                0 | 1 | 12 => Some(DropReason::RowsTurned),
                20 => Some(DropReason::Mirrored),
                _ => None,
            };
            assert_eq!(*verdict, expected, "{step}");
        }
        assert_eq!(gate.turned, 0);
    }

    #[test]
    fn symmetric_boards_are_chained_to_continuous_names() {
        for (text, quarter) in [("circles:3x6:40mm:r10mm", 1), ("circles:5x5:40mm:r10mm", 2)] {
            let board: Board = text.parse().unwrap();
            let turns = board_turns(&board);
            let mut sightings: Vec<Sighting> = (0..60)
                .map(|step| {
                    // Two full rotations of the board, with numbers that change now and then.
                    let turn = &turns[usize::from(step % 7 == 3) * quarter];
                    sighting(&board, f64::from(step) * 0.02, f64::from(step) * 0.2, |index| turn[index])
                })
                .collect();
            // A frame in which the rows have another direction does not break the chain.
            sightings[30] = sighting(&board, 0.6, 6.0 + 0.8, identity);
            let gate = rotation_gate(&mut sightings, &board, &InitialSettings::default());
            assert_eq!(gate.verdicts.iter().filter(|verdict| verdict.is_none()).count(), 59, "{text}");
            assert_eq!(gate.verdicts[30], Some(DropReason::RowsTurned));
            assert_eq!(gate.turned, 9, "{text}");
            for (step, sighting) in sightings.iter().enumerate().filter(|(step, _)| *step != 30) {
                let expected = self::sighting(&board, 0.0, step as f64 * 0.2, identity);
                for (circle, expected) in sighting.circles.iter().zip(&expected.circles) {
                    assert!((circle.center - expected.center).norm() < 1e-9, "{text} {step}");
                }
            }
        }
    }
}

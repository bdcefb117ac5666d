//! A reference frame in the initial stage, with its circles as point pairs.

use std::collections::BTreeMap;

use nalgebra::Vector2;

use evcal_detection::circles::reference_frame::{ObservedCircle, ReferenceFrame};
use evcal_geometry::board::Board;

/// Time difference between a circle and its frame (s) below which the circle is not moved: events have no finer times.
const SAME_TIME: f64 = 1e-6;

fn has_own_time(circle: &ObservedCircle, frame_t: f64) -> bool {
    (circle.t - frame_t).abs() >= SAME_TIME
}

/// A point of the board and its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardPoint {
    /// Point on the board plane, in metres.
    pub object: Vector2<f64>,
    /// Its image in pixels.
    pub image: Vector2<f64>,
}

/// Data of a reference frame in the initial stage.
#[derive(Clone, Debug)]
pub struct Sighting {
    /// Index of the frame in the input.
    pub frame: usize,
    /// Recording of the frame.
    pub recording: usize,
    /// Time of the frame in seconds.
    pub t: f64,
    /// Circles with their own times, ordered by board index.
    pub circles: Vec<ObservedCircle>,
    /// Image of each circle's centre at the time of the frame, in the order of `circles`.
    pub points: Vec<BoardPoint>,
}

impl Sighting {
    /// Keeps the circles whose flag is set.
    pub fn retain(&mut self, keep: &[bool]) {
        let mut flags = keep.iter();
        self.circles.retain(|_| flags.next().copied().unwrap_or(false));
        let mut flags = keep.iter();
        self.points.retain(|_| flags.next().copied().unwrap_or(false));
    }
}

/// Returns the circles that belong to the board and are finite, each index once, in the order of their indices.
fn valid_circles(frame: &ReferenceFrame, board: &Board) -> Vec<ObservedCircle> {
    let finite = |circle: &ObservedCircle| {
        circle.t.is_finite()
            && circle.center.iter().all(|value| value.is_finite())
            && circle.velocity.is_none_or(|velocity| velocity.iter().all(|value| value.is_finite()))
    };
    let mut circles: Vec<_> =
        frame.circles.iter().filter(|circle| circle.index < board.point_count() && finite(circle)).copied().collect();
    circles.sort_by_key(|circle| circle.index);
    circles.dedup_by_key(|circle| circle.index);
    circles
}

/// Returns the sightings of all frames in the order of recording and time, with empty `points`.
pub fn sightings(frames: &[ReferenceFrame], board: &Board) -> Vec<Sighting> {
    let mut sightings: Vec<Sighting> = frames
        .iter()
        .enumerate()
        .map(|(index, frame)| Sighting {
            frame: index,
            recording: frame.recording,
            t: frame.t(),
            circles: valid_circles(frame, board),
            points: Vec::new(),
        })
        .collect();
    sightings.sort_by(|a, b| a.recording.cmp(&b.recording).then(a.t.total_cmp(&b.t)).then(a.frame.cmp(&b.frame)));
    sightings
}

/// Sets the velocity of circles with times of their own to the velocity of the same circle between the neighbouring frames, if
/// the circle file contains none and a neighbour is at most `max_gap` seconds away.
pub fn estimate_velocities(sightings: &mut [Sighting], max_gap: f64) {
    let tracks: Vec<BTreeMap<usize, (f64, Vector2<f64>)>> = sightings
        .iter()
        .map(|sighting| sighting.circles.iter().map(|circle| (circle.index, (circle.t, circle.center))).collect())
        .collect();
    let recordings: Vec<usize> = sightings.iter().map(|sighting| sighting.recording).collect();
    for (position, sighting) in sightings.iter_mut().enumerate() {
        let t = sighting.t;
        let recording = sighting.recording;
        let seen = |position: Option<usize>, circle: &ObservedCircle| {
            let position = position.filter(|&position| recordings.get(position) == Some(&recording))?;
            tracks.get(position)?.get(&circle.index).filter(|(other, _)| (other - circle.t).abs() <= max_gap).copied()
        };
        for circle in sighting.circles.iter_mut().filter(|circle| circle.velocity.is_none() && has_own_time(circle, t))
        {
            let own = (circle.t, circle.center);
            let (t0, center0) = seen(position.checked_sub(1), circle).unwrap_or(own);
            let (t1, center1) = seen(Some(position + 1), circle).unwrap_or(own);
            circle.velocity = (t1 > t0).then(|| (center1 - center0) / (t1 - t0));
        }
    }
}

/// Moves every circle to the time of its frame along its velocity and pairs it with its board point.
///
/// Returns the number of circles whose time differs from their frame's but which have no velocity; they are not moved.
pub fn pair_points(sightings: &mut [Sighting], board: &Board) -> usize {
    let mut without_velocity = 0;
    for sighting in sightings {
        let t = sighting.t;
        without_velocity +=
            sighting.circles.iter().filter(|circle| circle.velocity.is_none() && has_own_time(circle, t)).count();
        sighting.points = sighting
            .circles
            .iter()
            .map(|circle| BoardPoint {
                object: board.point(circle.index),
                image: circle.center + circle.velocity.unwrap_or_default() * (t - circle.t),
            })
            .collect();
    }
    without_velocity
}

#[cfg(test)]
mod tests {
    use super::*;
    use evcal_detection::circles::reference_frame::SeenIn;

    fn frame(t: f64, circles: &[(usize, f64, f64)]) -> ReferenceFrame {
        let circles = circles
            .iter()
            .map(|&(index, t, x)| ObservedCircle {
                index,
                t,
                center: Vector2::new(x, 2.0 * x),
                radius: None,
                velocity: None,
            })
            .collect();
        ReferenceFrame { recording: 0, start: t - 0.5e-3, end: t + 0.5e-3, circles, seen_in: SeenIn::Circles }
    }

    #[test]
    fn circles_reach_the_time_of_their_frame_by_the_motion_between_neighbours() {
        let board: Board = "circles:3x6:40mm:r10mm".parse().unwrap();
        // Circle 1 moves at 100 px/s; circle 2 is seen once.
        let frames = [
            frame(0.00, &[(1, 0.001, 10.1)]),
            frame(0.02, &[(1, 0.022, 12.2), (2, 0.02, 5.0)]),
            frame(0.04, &[(1, 0.04, 14.0)]),
        ];
        let mut sightings = sightings(&frames, &board);
        estimate_velocities(&mut sightings, 0.1);
        assert_eq!(pair_points(&mut sightings, &board), 0);
        let seen: Vec<f64> =
            sightings.iter().flat_map(|sighting| sighting.points.iter().map(|point| point.image.x)).collect();
        for (seen, expected) in seen.iter().zip([10.0, 12.0, 5.0, 14.0]) {
            assert!((seen - expected).abs() < 1e-9, "{seen} {expected}");
        }
    }

    #[test]
    fn a_circle_without_velocity_is_counted_and_invalid_circles_are_dropped() {
        let board: Board = "circles:3x6:40mm:r10mm".parse().unwrap();
        let frames = [frame(0.0, &[(1, 0.001, 10.0), (18, 0.0, 1.0), (3, 0.0, f64::NAN)])];
        let mut sightings = sightings(&frames, &board);
        estimate_velocities(&mut sightings, 0.1);
        assert_eq!(pair_points(&mut sightings, &board), 1);
        assert_eq!(sightings[0].points.len(), 1);
        assert_eq!(sightings[0].points[0].image.x, 10.0);
    }
}

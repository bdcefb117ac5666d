//! The usable candidates, sorted by x, with their nearest neighbours.

use heapless::Vec;
use nalgebra::{RealField, Vector2};

use super::GridCandidate;

/// Number of nearest neighbours stored per point. With circles at a strong slant, or with clutter between them, the
/// four lattice neighbours are not the four nearest.
pub(super) const NEIGHBOURS: usize = 12;

/// Marks an unused entry in an index table.
pub(super) const NONE: u16 = u16::MAX;

/// Points closer than this (in pixels) are duplicates.
const DUPLICATE_DISTANCE: f64 = 1e-3;

#[derive(Clone, Copy, Debug)]
pub(super) struct Point<T> {
    pub position: Vector2<T>,
    /// Radius in pixels, zero when unknown.
    pub radius: T,
    /// Index among the caller's candidates.
    pub candidate: u16,
}

/// The nearest point to a position, and the distance of the next one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest<T> {
    pub point: u16,
    pub distance_squared: T,
    /// Squared distance of the second nearest, if it lies within the search radius too.
    pub second_squared: Option<T>,
}

/// Points sorted by x.
#[derive(Clone, Debug)]
pub(super) struct Points<T, const N: usize> {
    points: Vec<Point<T>, N>,
    neighbours: Vec<[u16; NEIGHBOURS], N>,
}

impl<T: RealField + Copy, const N: usize> Points<T, N> {
    pub const fn new() -> Self {
        Self { points: Vec::new(), neighbours: Vec::new() }
    }

    pub fn len(&self) -> usize {
        self.points.len()
    }

    pub fn get(&self, index: u16) -> Option<&Point<T>> {
        self.points.get(usize::from(index))
    }

    pub fn position(&self, index: u16) -> Option<Vector2<T>> {
        self.get(index).map(|point| point.position)
    }

    /// Returns the neighbours of a point, nearest first.
    pub fn neighbours(&self, index: u16) -> impl Iterator<Item = (u16, &Point<T>)> {
        let list = self.neighbours.get(usize::from(index)).map_or(&[][..], |list| &list[..]);
        list.iter().filter_map(|&neighbour| self.get(neighbour).map(|point| (neighbour, point)))
    }

    /// Copies the candidates, without those whose centre is not finite and without duplicates. Returns `false` if there
    /// are more than `N`.
    pub fn load(&mut self, candidates: &[GridCandidate<T>]) -> bool {
        self.points.clear();
        self.neighbours.clear();
        for (index, candidate) in candidates.iter().enumerate() {
            let position = candidate.center;
            if !position.x.is_finite() || !position.y.is_finite() {
                continue;
            }
            let Ok(index) = u16::try_from(index) else { return false };
            let radius = if candidate.radius.is_finite() { candidate.radius.max(T::zero()) } else { T::zero() };
            if self.points.push(Point { position, radius, candidate: index }).is_err() {
                return false;
            }
            self.sink_last();
        }
        self.drop_duplicates();
        true
    }

    /// Moves the last point to its position among the sorted ones before it.
    fn sink_last(&mut self) {
        let mut end = self.points.len();
        while let Some([.., before, last]) = self.points.get_mut(..end) {
            let (a, b) = (before.position, last.position);
            if a.x < b.x || (a.x == b.x && a.y <= b.y) {
                return;
            }
            core::mem::swap(before, last);
            end -= 1;
        }
    }

    fn drop_duplicates(&mut self) {
        let limit: T = nalgebra::convert(DUPLICATE_DISTANCE);
        let mut kept: Vec<Point<T>, N> = Vec::new();
        for point in &self.points {
            let twin = kept
                .iter()
                .rev()
                .take_while(|other| point.position.x - other.position.x <= limit)
                .any(|other| (point.position - other.position).norm_squared() <= limit * limit);
            if !twin && kept.push(*point).is_err() {
                return;
            }
        }
        self.points = kept;
    }

    /// Fills the table of nearest neighbours.
    pub fn find_neighbours(&mut self) {
        self.neighbours.clear();
        for index in 0..self.points.len() {
            if self.neighbours.push(self.nearest_to(index)).is_err() {
                return;
            }
        }
    }

    fn nearest_to(&self, index: usize) -> [u16; NEIGHBOURS] {
        let mut found = [NONE; NEIGHBOURS];
        let mut distances = [T::max_value().unwrap_or(T::one()); NEIGHBOURS];
        let Some(center) = self.points.get(index).map(|point| point.position) else { return found };
        let mut left = index.checked_sub(1);
        let mut right = index + 1;
        loop {
            let to_left = left.and_then(|at| self.points.get(at)).map(|point| center.x - point.position.x);
            let to_right = self.points.get(right).map(|point| point.position.x - center.x);
            let take_left = match (to_left, to_right) {
                (Some(a), Some(b)) => a <= b,
                (Some(_), None) => true,
                (None, Some(_)) => false,
                (None, None) => break,
            };
            let (at, gap) = if take_left {
                (left.unwrap_or(0), to_left.unwrap_or(T::zero()))
            } else {
                (right, to_right.unwrap_or(T::zero()))
            };
            if gap * gap > distances[NEIGHBOURS - 1] {
                break;
            }
            if take_left {
                left = at.checked_sub(1);
            } else {
                right += 1;
            }
            let Some(point) = self.points.get(at) else { break };
            let distance = (point.position - center).norm_squared();
            if distance < distances[NEIGHBOURS - 1] {
                insert_sorted(&mut found, &mut distances, at as u16, distance);
            }
        }
        found
    }

    /// Returns the point nearest to `position` within `radius`.
    pub fn nearest(&self, position: &Vector2<T>, radius: T) -> Option<Nearest<T>> {
        let from = position.x - radius;
        let to = position.x + radius;
        let start = self.points.partition_point(|point| point.position.x < from);
        let mut best: Option<Nearest<T>> = None;
        for (offset, point) in self.points.get(start..)?.iter().enumerate() {
            if point.position.x > to {
                break;
            }
            let distance_squared = (point.position - position).norm_squared();
            if distance_squared > radius * radius {
                continue;
            }
            let index = (start + offset) as u16;
            best = match best {
                Some(nearest) if nearest.distance_squared <= distance_squared => {
                    let second = nearest.second_squared.map_or(distance_squared, |second| second.min(distance_squared));
                    Some(Nearest { second_squared: Some(second), ..nearest })
                }
                _ => Some(Nearest {
                    point: index,
                    distance_squared,
                    second_squared: best.map(|nearest| nearest.distance_squared),
                }),
            };
        }
        best
    }
}

/// Inserts a point into the list sorted by distance; the last one is dropped.
fn insert_sorted<T: RealField + Copy>(
    found: &mut [u16; NEIGHBOURS],
    distances: &mut [T; NEIGHBOURS],
    point: u16,
    distance: T,
) {
    let mut place = NEIGHBOURS - 1;
    while place > 0 && distances[place - 1] > distance {
        distances[place] = distances[place - 1];
        found[place] = found[place - 1];
        place -= 1;
    }
    distances[place] = distance;
    found[place] = point;
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn load(positions: &[(f64, f64)]) -> Points<f64, 64> {
        let mut points = Points::new();
        let candidates: std::vec::Vec<_> =
            positions.iter().map(|&(x, y)| GridCandidate { center: Vector2::new(x, y), radius: 0.0 }).collect();
        assert!(points.load(&candidates));
        points.find_neighbours();
        points
    }

    #[test]
    fn candidates_that_are_not_finite_and_duplicates_are_dropped() {
        let points = load(&[(1.0, 2.0), (f64::NAN, 1.0), (1.0, 2.0), (0.0, f64::INFINITY), (0.5, 7.0)]);
        assert_eq!(points.len(), 2);
        assert_eq!(points.get(0).map(|point| point.candidate), Some(4));
    }

    proptest! {
        #[test]
        fn searches_agree_with_brute_force(
            positions in prop::collection::vec((0.0..50.0f64, 0.0..50.0f64), 2..60),
            query in (0.0..50.0f64, 0.0..50.0f64),
            radius in 0.1..20.0f64,
        ) {
            let points = load(&positions);
            let query = Vector2::new(query.0, query.1);
            let mut distances: std::vec::Vec<f64> = (0..points.len() as u16)
                .map(|index| (points.position(index).unwrap() - query).norm_squared())
                .filter(|&distance| distance <= radius * radius)
                .collect();
            distances.sort_by(f64::total_cmp);
            let found = points.nearest(&query, radius);
            prop_assert_eq!(found.map(|nearest| nearest.distance_squared), distances.first().copied());
            prop_assert_eq!(found.and_then(|nearest| nearest.second_squared), distances.get(1).copied());

            for index in 0..points.len() as u16 {
                let center = points.position(index).unwrap();
                let mut expected: std::vec::Vec<f64> = (0..points.len() as u16)
                    .filter(|&other| other != index)
                    .map(|other| (points.position(other).unwrap() - center).norm_squared())
                    .collect();
                expected.sort_by(f64::total_cmp);
                expected.truncate(NEIGHBOURS);
                let found: std::vec::Vec<f64> =
                    points.neighbours(index).map(|(_, point)| (point.position - center).norm_squared()).collect();
                prop_assert_eq!(found, expected);
            }
        }
    }
}

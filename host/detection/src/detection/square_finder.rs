//! Search for the points of a board of squares in the pictures of one moment.

use evcal_core::pattern::Pattern;
use evcal_geometry::board::SquareBoard;
use evcal_geometry::board::squares::{Checkerboard, Shade};
use evcal_squares::charuco::find_corners;
use evcal_squares::checkerboard::{NoCheckerboard, find_checkerboard_in_any};
use evcal_squares::found_point::FoundPoint;
use evcal_squares::picture::Picture;
use evcal_squares::tags::{FoundTag, NoTags, TagFinder};
use nalgebra::Vector2;

use super::no_board::NoBoard;

/// Points and tags of a board.
#[derive(Clone, Debug)]
pub struct FoundBoard {
    /// Its points, by rising index.
    pub points: Vec<FoundPoint>,
    /// Its tags, on a board of tags.
    tags: Vec<FoundTag>,
}

impl FoundBoard {
    /// Returns the board after `times` the motion from `before` to this one. What `before` does not contain moves as the rest does on
    /// average.
    pub fn continued(&self, before: &Self, times: f32) -> Self {
        let steps = |from: [f32; 2], to: [f32; 2]| [to[0] - from[0], to[1] - from[1]];
        let of_point = |point: &FoundPoint| {
            let place = before.points.binary_search_by_key(&point.index, |point| point.index).ok()?;
            Some(steps(before.points.get(place)?.pixel, point.pixel))
        };
        let known: Vec<[f32; 2]> = self.points.iter().filter_map(of_point).collect();
        let count = known.len().max(1) as f32;
        let mean = known.iter().fold([0.0; 2], |sum, step| [sum[0] + step[0] / count, sum[1] + step[1] / count]);
        let moved = |place: [f32; 2], step: [f32; 2]| [place[0] + times * step[0], place[1] + times * step[1]];
        let of_tag = |tag: &FoundTag| {
            let place = before.tags.binary_search_by_key(&tag.index, |tag| tag.index).ok();
            let seen = place.and_then(|place| before.tags.get(place));
            let mut corners = tag.corners;
            for (number, corner) in corners.iter_mut().enumerate() {
                let from = seen.and_then(|seen| seen.corners.get(number));
                *corner = moved(*corner, from.map_or(mean, |from| steps(*from, *corner)));
            }
            FoundTag { corners, ..*tag }
        };
        let point =
            |point: &FoundPoint| FoundPoint { pixel: moved(point.pixel, of_point(point).unwrap_or(mean)), ..*point };
        Self { points: self.points.iter().map(point).collect(), tags: self.tags.iter().map(of_tag).collect() }
    }
}

/// Finds the points of one board.
pub struct SquareFinder {
    kind: Kind,
    pattern: Pattern,
}

enum Kind {
    Checkerboard(Checkerboard),
    Tags {
        finder: Box<TagFinder>,
        /// For each tag the indices of the points at its corners.
        corners: Vec<[usize; 4]>,
    },
    Charuco {
        finder: Box<TagFinder>,
        /// The inner corners of its squares, in metres on the board.
        corners: Vec<Vector2<f64>>,
    },
    /// A board with tags that cannot be searched.
    Nothing,
}

impl SquareFinder {
    /// Creates a finder of `board`.
    pub fn new(board: &SquareBoard) -> Self {
        let kind = match board {
            SquareBoard::Checkerboard(board) => Kind::Checkerboard(*board),
            SquareBoard::Tags(_) => tags(board),
            SquareBoard::Charuco(_) => charuco(board),
        };
        Self { kind, pattern: board.lattice() }
    }

    /// Finds the board in the `pictures` of one moment, and combines the points from all of them. `near` is the result
    /// of the previous moment.
    ///
    /// # Errors
    /// [`NoBoard`], the reason why the board is in none of them.
    pub fn find(&self, pictures: &[Picture], near: Option<&FoundBoard>) -> Result<FoundBoard, NoBoard> {
        match &self.kind {
            Kind::Checkerboard(board) => {
                let mut expected = near.map(|found| self.by_index(&found.points));
                // Boards that differ only in the shade of the first square are the same board, rotated by half a turn.
                let is_turned = board.first == Shade::Light && (board.rows + board.columns) % 2 == 1;
                if is_turned && let Some(expected) = &mut expected {
                    expected.reverse();
                }
                let mut points = find_checkerboard_in_any(pictures, board.rows, board.columns, expected.as_deref())?;
                if is_turned {
                    let last = self.pattern.circle_count().saturating_sub(1);
                    points.iter_mut().for_each(|point| point.index = last.saturating_sub(point.index));
                    points.reverse();
                }
                Ok(FoundBoard { points, tags: Vec::new() })
            }
            Kind::Tags { finder, corners } => find_tags(finder, corners, pictures, near),
            Kind::Charuco { finder, corners } => find_charuco(finder, corners, pictures, near),
            Kind::Nothing => Err(NoBoard::NoTags),
        }
    }

    fn by_index(&self, points: &[FoundPoint]) -> Vec<Option<[f32; 2]>> {
        let mut places = vec![None; self.pattern.circle_count()];
        for point in points {
            if let Some(place) = places.get_mut(point.index) {
                *place = Some(point.pixel);
            }
        }
        places
    }
}

/// Returns for each tag of `board` the indices of the points at its corners; `None` if the corners are not points.
pub(super) fn tag_points(board: &SquareBoard) -> Option<Vec<[usize; 4]>> {
    let points = board.points();
    let near = 0.1 * board.module();
    let at = |corner: [f64; 2]| points.iter().position(|point| (point - Vector2::from(corner)).norm() < near);
    let corners = board.tags().into_iter().map(|tag| {
        let [a, b, c, d] = tag.corners.map(at);
        Some([a?, b?, c?, d?])
    });
    corners.collect()
}

/// Prepares the search for the tags of `board`.
fn tags(board: &SquareBoard) -> Kind {
    match (TagFinder::new(&board.tags()), tag_points(board)) {
        (Ok(finder), Some(corners)) => Kind::Tags { finder: Box::new(finder), corners },
        _ => Kind::Nothing,
    }
}

/// Prepares the search for the corners of `board` from its tags.
fn charuco(board: &SquareBoard) -> Kind {
    match TagFinder::new(&board.tags()) {
        Ok(finder) => Kind::Charuco { finder: Box::new(finder), corners: board.points() },
        Err(_) => Kind::Nothing,
    }
}

fn find_tags(
    finder: &TagFinder,
    corners: &[[usize; 4]],
    pictures: &[Picture],
    near: Option<&FoundBoard>,
) -> Result<FoundBoard, NoBoard> {
    let tags = finder.find_in_any(pictures, near.map_or(&[], |near| &near.tags))?;
    let points = tags.iter().zip(tags.iter().filter_map(|tag| corners.get(tag.index)));
    let mut points: Vec<FoundPoint> = points
        .flat_map(|(tag, corners)| corners.iter().zip(tag.corners))
        .map(|(&index, pixel)| FoundPoint { index, pixel })
        .collect();
    points.sort_by_key(|point| point.index);
    Ok(FoundBoard { points, tags })
}

/// Returns the corners in the picture that shows most of them.
fn find_charuco(
    finder: &TagFinder,
    corners: &[Vector2<f64>],
    pictures: &[Picture],
    near: Option<&FoundBoard>,
) -> Result<FoundBoard, NoBoard> {
    let tags = finder.find_in_any(pictures, near.map_or(&[], |near| &near.tags))?;
    let found = pictures.iter().map(|picture| find_corners(picture, finder, &tags, corners));
    let points = found.max_by_key(Vec::len).filter(|points| !points.is_empty()).ok_or(NoBoard::TooFewCorners)?;
    Ok(FoundBoard { points, tags })
}

impl From<NoCheckerboard> for NoBoard {
    fn from(reason: NoCheckerboard) -> Self {
        match reason {
            NoCheckerboard::TooFewSaddles { .. } | NoCheckerboard::TooFewCorners { .. } => Self::TooFewCorners,
            NoCheckerboard::LargerThanBoard { .. } | NoCheckerboard::OtherSize { .. } => Self::OtherCheckerboardSize,
            NoCheckerboard::PlaceUncertain { .. } => Self::PlaceUncertain,
            NoCheckerboard::NotAsExpected => Self::NotAsExpected,
            _ => Self::NoCheckerboard,
        }
    }
}

impl From<NoTags> for NoBoard {
    fn from(reason: NoTags) -> Self {
        match reason {
            NoTags::Mirrored { .. } => Self::MirroredPrint,
            NoTags::Inverted { .. } => Self::Inverted,
            NoTags::OtherBorder { .. } => Self::OtherBorder,
            NoTags::OtherBoard { .. } => Self::OtherTags,
            _ => Self::NoTags,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_continues_its_motion() {
        let point = |index, x, y| FoundPoint { index, pixel: [x, y] };
        let tag = |index, x: f32| FoundTag {
            index,
            corners: [[x, 0.0], [x + 8.0, 0.0], [x + 8.0, 8.0], [x, 8.0]],
            score: 0.9,
        };
        let before = FoundBoard { points: vec![point(0, 10.0, 5.0), point(2, 30.0, 5.0)], tags: vec![tag(1, 20.0)] };
        let last = FoundBoard {
            points: vec![point(0, 12.0, 5.0), point(1, 20.0, 5.0), point(2, 34.0, 6.0)],
            tags: vec![tag(1, 23.0), tag(4, 50.0)],
        };
        let next = last.continued(&before, 0.5);
        // The point in the middle moves as the others do on average.
        assert_eq!(next.points, [point(0, 13.0, 5.0), point(1, 21.5, 5.25), point(2, 36.0, 6.5)]);
        assert_eq!(next.tags[0], tag(1, 24.5));
        assert_eq!(next.tags[1].corners[0], [51.5, 0.25]);
    }
}

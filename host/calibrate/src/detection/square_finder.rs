//! The points of a board of squares in the pictures of one moment.

use evcal_core::pattern::Pattern;
use evcal_geometry::board::SquareBoard;
use evcal_geometry::board::squares::Checkerboard;
use evcal_squares::checkerboard::{NoCheckerboard, find_checkerboard};
use evcal_squares::found_point::FoundPoint;
use evcal_squares::picture::Picture;
use evcal_squares::tags::{FoundTag, NoTags, TagFinder};

use super::no_board::NoBoard;

/// What was found of a board.
#[derive(Clone, Debug, Default)]
pub struct FoundBoard {
    /// Its points, by rising index.
    pub points: Vec<FoundPoint>,
    /// Its tags, on a board of tags.
    tags: Vec<FoundTag>,
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
        /// For each tag the points at its corners.
        corners: Vec<[usize; 4]>,
    },
    /// A board whose tags cannot be looked for.
    Nothing,
}

impl SquareFinder {
    /// Finds `board`.
    pub fn new(board: &SquareBoard) -> Self {
        let kind = match board {
            SquareBoard::Checkerboard(board) => Kind::Checkerboard(*board),
            SquareBoard::Tags(_) => tags(board),
            SquareBoard::Charuco(_) => Kind::Nothing,
        };
        Self { kind, pattern: board.lattice() }
    }

    /// What `pictures` of one moment show of the board together; `near` is what was found a moment before.
    ///
    /// # Errors
    /// Why it is in none of them.
    pub fn find(&self, pictures: &[Picture], near: Option<&FoundBoard>) -> Result<FoundBoard, NoBoard> {
        match &self.kind {
            Kind::Checkerboard(board) => self.find_checkerboard(board, pictures, near),
            Kind::Tags { finder, corners } => find_tags(finder, corners, pictures, near),
            Kind::Nothing => Err(NoBoard::NoTags),
        }
    }

    /// The checkerboard in the picture that shows most of it.
    fn find_checkerboard(
        &self,
        board: &Checkerboard,
        pictures: &[Picture],
        near: Option<&FoundBoard>,
    ) -> Result<FoundBoard, NoBoard> {
        let expected = near.map(|found| self.by_index(&found.points));
        let mut best: Result<Vec<FoundPoint>, NoBoard> = Err(NoBoard::TooFewCorners);
        for picture in pictures {
            let found = find_checkerboard(picture, board.rows, board.columns, expected.as_deref());
            let found = found.map_err(NoBoard::from);
            let is_better = match (&best, &found) {
                (Ok(best), Ok(found)) => found.len() > best.len(),
                (Err(_), _) => true,
                (Ok(_), Err(_)) => false,
            };
            if is_better {
                best = found;
            }
            if best.as_ref().is_ok_and(|points| points.len() == self.pattern.circle_count()) {
                break;
            }
        }
        Ok(FoundBoard { points: best?, tags: Vec::new() })
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

/// How to find the tags of `board`.
fn tags(board: &SquareBoard) -> Kind {
    let tags = board.tags();
    let points = board.points();
    let near = 0.1 * board.module();
    let at = |corner: [f64; 2]| points.iter().position(|point| (point - nalgebra::Vector2::from(corner)).norm() < near);
    let corners = tags.iter().map(|tag| {
        let [a, b, c, d] = tag.corners.map(at);
        Some([a?, b?, c?, d?])
    });
    match (TagFinder::new(&tags), corners.collect::<Option<Vec<_>>>()) {
        (Ok(finder), Some(corners)) => Kind::Tags { finder: Box::new(finder), corners },
        _ => Kind::Nothing,
    }
}

/// Each tag as the picture shows it in which it looks most like itself.
fn find_tags(
    finder: &TagFinder,
    corners: &[[usize; 4]],
    pictures: &[Picture],
    near: Option<&FoundBoard>,
) -> Result<FoundBoard, NoBoard> {
    let mut best: Vec<Option<FoundTag>> = vec![None; corners.len()];
    let mut reason = None;
    for picture in pictures {
        let expected = near.map_or(&[][..], |near| &near.tags);
        match finder.find(picture, expected) {
            Ok(tags) => {
                for tag in tags {
                    if let Some(best) = best.get_mut(tag.index)
                        && best.is_none_or(|best| tag.score > best.score)
                    {
                        *best = Some(tag);
                    }
                }
            }
            Err(error) => reason = reason.max(Some(error)),
        }
    }
    let tags: Vec<FoundTag> = best.into_iter().flatten().collect();
    if tags.is_empty() {
        return Err(reason.map_or(NoBoard::NoTags, NoBoard::from));
    }
    let points = tags.iter().zip(tags.iter().filter_map(|tag| corners.get(tag.index)));
    let mut points: Vec<FoundPoint> = points
        .flat_map(|(tag, corners)| corners.iter().zip(tag.corners))
        .map(|(&index, pixel)| FoundPoint { index, pixel })
        .collect();
    points.sort_by_key(|point| point.index);
    Ok(FoundBoard { points, tags })
}

impl From<NoCheckerboard> for NoBoard {
    fn from(reason: NoCheckerboard) -> Self {
        match reason {
            NoCheckerboard::TooFewSaddles { .. } | NoCheckerboard::TooFewCorners { .. } => Self::TooFewCorners,
            NoCheckerboard::BesideBoard { .. } => Self::CornersBesideBoard,
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
            NoTags::OtherBorder { .. } => Self::OtherBorder,
            NoTags::OtherBoard { .. } => Self::OtherTags,
            _ => Self::NoTags,
        }
    }
}

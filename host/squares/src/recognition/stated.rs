//! Comparison of a stated board of tags with the tags in pictures.
//!
//! The tags of the stated family are searched one by one, wherever they are on the board. Pairs of neighbouring tags then agree
//! with the stated board or contradict it. A board whose numbering begins with another tag, or a ChArUco board of the other
//! layout, agrees with the stated one in most pairs; only tags at its sides contradict it.

use std::collections::{BTreeMap, BTreeSet};

use evcal_geometry::board::squares::family::TagFamily;
use evcal_geometry::board::squares::{Charuco, CharucoLayout, SquareBoard, TagGrid};
use evcal_geometry::board::tag::Tag;
use evcal_geometry::numerics::statistics::median;
use nalgebra::Vector2;

use super::grid::{DIAGONAL, FEWEST_PAIRS, NEIGHBOURS, Pair, TOLERANCE, board_of, pairs_of};
use super::{BORDERS, FAMILIES, FEWEST_MOMENTS, FEWEST_TAGS, Prepared, SeenTag, add_tags, tags_of};
use crate::picture::Picture;
use crate::tags::{FoundTag, TagFinder};

/// Number of moments in which a pair of tags must contradict the stated board; a single one may be a misread tag.
const FEWEST_SIGHTINGS: usize = 2;
/// If the first pictures of a moment show this number of tags, the others are not searched.
const ENOUGH_TAGS: usize = 4 * FEWEST_TAGS;
/// Number of different pairs that must contradict it.
const FEWEST_CONTRADICTIONS: usize = 2;

/// Result of a comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Comparison {
    /// The pictures show too few tags.
    Unclear,
    /// The tags are at their places on the stated board.
    Same {
        /// Measured gap between two tags of a grid divided by the side of a tag, or measured side of a marker of a ChArUco board
        /// divided by the side of a square.
        ratio: f64,
    },
    /// The tags are at their places on this board, whose lengths are not those of the stated one.
    Other(SquareBoard),
}

/// Tags of one family in the pictures of some moments.
pub struct StatedTags {
    stated: SquareBoard,
    family: TagFamily,
    /// For each width of the border in modules, the stated one first, the finder of the tags.
    finders: Vec<(u8, TagFinder)>,
    /// For each width, the tags of each moment that shows enough of them.
    sightings: Vec<Vec<Vec<SeenTag>>>,
}

impl StatedTags {
    /// Prepares the comparison with a board; `None` if it has no tags.
    pub fn new(stated: &SquareBoard) -> Option<Self> {
        let (dictionary, borders) = match stated {
            SquareBoard::Checkerboard(_) => return None,
            SquareBoard::Tags(grid) => {
                let others = BORDERS.into_iter().filter(|border| *border != grid.border);
                (grid.dictionary, std::iter::once(grid.border).chain(others).collect())
            }
            SquareBoard::Charuco(board) => (board.dictionary, vec![1]),
        };
        let family = dictionary.family;
        let searched = FAMILIES.into_iter().find(|(other, _)| *other == family).map_or(0, |(_, count)| count);
        let last = stated.tags().iter().map(|tag| tag.id + 1).max()?;
        let finder = |border: u8| Some((border, TagFinder::new(&tags_of(family, searched.max(last), border)).ok()?));
        let finders: Vec<(u8, TagFinder)> = borders.into_iter().filter_map(finder).collect();
        let sightings = vec![Vec::new(); finders.len()];
        Some(Self { stated: *stated, family, finders, sightings })
    }

    /// Searches the pictures of the next moment.
    pub fn add(&mut self, pictures: &[Picture]) {
        // For each width of the border, the tags seen so far.
        let mut all = vec![BTreeMap::new(); self.finders.len()];
        let mut first = None;
        for (number, picture) in pictures.iter().enumerate() {
            let prepared = Prepared::new(picture);
            // The first picture nearly always shows a board that the others show.
            let enough = if number + 1 == pictures.len() { FEWEST_TAGS } else { ENOUGH_TAGS };
            // The other width is searched only if the pictures do not show tags of the stated one.
            for (((border, finder), sightings), seen) in self.finders.iter().zip(&mut self.sightings).zip(&mut all) {
                add_tags(finder, &prepared, seen);
                let found: Vec<FoundTag> = seen.values().map(|tag: &SeenTag| tag.found).collect();
                let smooth = &first.as_ref().unwrap_or(&prepared).smooth;
                if found.len() >= enough && finder.best_border(smooth.picture(), &found) == usize::from(*border) {
                    sightings.push(std::mem::take(seen).into_values().collect());
                    return;
                }
            }
            first.get_or_insert(prepared);
        }
    }

    /// Returns `true` if the tags contradict all boards that users confuse with the stated one more than the stated one. Pictures
    /// of the middle of a ChArUco board fit both layouts.
    pub fn exclude_variants(&self) -> bool {
        let Some(sightings) = self.sightings.first() else { return false };
        let pairs = Pairs::new(sightings, matches!(self.stated, SquareBoard::Charuco(_)));
        let of_stated = pairs.counts(&self.stated)[1];
        variants(&self.stated).iter().all(|board| pairs.counts(board)[1] > of_stated)
    }

    /// Compares the tags of all moments with the stated board.
    pub fn compare(&self) -> Comparison {
        let borders = self.finders.iter().map(|(border, _)| *border).zip(&self.sightings);
        let Some((border, sightings)) = borders.rev().max_by_key(|(_, sightings)| sightings.len()) else {
            return Comparison::Unclear;
        };
        if sightings.len() < FEWEST_MOMENTS {
            return Comparison::Unclear;
        }
        let is_stated_border = self.finders.first().is_some_and(|(first, _)| *first == border);
        let pairs = Pairs::new(sightings, matches!(self.stated, SquareBoard::Charuco(_)));
        if is_stated_border && pairs.fit(&self.stated) {
            if let Some(better) = variants(&self.stated).into_iter().find(|board| pairs.prefer(board, &self.stated)) {
                return Comparison::Other(better);
            }
            return pairs
                .period
                .map_or(Comparison::Unclear, |period| Comparison::Same { ratio: ratio(&self.stated, period) });
        }
        if pairs.fit_nothing() || is_stated_border && !pairs.contradict(&self.stated) {
            return Comparison::Unclear;
        }
        let variant = variants(&self.stated).into_iter().find(|board| is_stated_border && pairs.fit(board));
        let other = variant.or_else(|| {
            let found = board_of(sightings, self.family, border)?;
            Some(completed(found, &self.stated))
        });
        other.map_or(Comparison::Unclear, Comparison::Other)
    }
}

fn ratio(board: &SquareBoard, period: f64) -> f64 {
    match board {
        SquareBoard::Charuco(_) => 1.0 / period,
        _ => period - 1.0,
    }
}

/// Returns boards that users confuse with a ChArUco board, with tags at other places: the other layout, and rows and columns exchanged.
fn variants(board: &SquareBoard) -> Vec<SquareBoard> {
    let SquareBoard::Charuco(board) = board else { return Vec::new() };
    let layout = match board.layout {
        CharucoLayout::Current => CharucoLayout::Legacy,
        CharucoLayout::Legacy => CharucoLayout::Current,
    };
    let exchanged = Charuco { rows: board.columns, columns: board.rows, ..*board };
    let all = [Charuco { layout, ..*board }, exchanged, Charuco { layout, ..exchanged }].map(SquareBoard::Charuco);
    // Layouts differ only if the number of rows is even.
    all.into_iter().filter(|other| other.tags() != SquareBoard::Charuco(*board).tags()).collect()
}

/// Returns a recognised grid with the rows and the first tag of the stated one, if the pictures showed only a part of it.
fn completed(found: SquareBoard, stated: &SquareBoard) -> SquareBoard {
    let (SquareBoard::Tags(found), SquareBoard::Tags(stated)) = (found, stated) else { return found };
    let last = |grid: &TagGrid| usize::from(grid.first_id) + usize::from(grid.rows) * usize::from(grid.columns);
    if found.columns != stated.columns {
        let is_exchanged = found.columns == stated.rows && found.rows <= stated.columns;
        return SquareBoard::Tags(TagGrid { rows: if is_exchanged { stated.columns } else { found.rows }, ..found });
    }
    let missing_rows = found.first_id.checked_sub(stated.first_id);
    let is_part =
        missing_rows.is_some_and(|ids| ids.is_multiple_of(found.columns.into())) && last(&found) <= last(stated);
    SquareBoard::Tags(match is_part {
        true => TagGrid { rows: stated.rows, first_id: stated.first_id, ..found },
        false => TagGrid { rows: found.rows.max(stated.rows), ..found },
    })
}

/// Pairs of neighbouring tags in all moments.
struct Pairs {
    pairs: Vec<Pair>,
    /// Distance of neighbours in sides of a tag: of tags in a row, or of diagonal ones along each axis.
    period: Option<f64>,
}

impl Pairs {
    fn new(sightings: &[Vec<SeenTag>], are_diagonal: bool) -> Self {
        let pairs: Vec<Pair> = sightings.iter().flat_map(|tags| pairs_of(tags)).collect();
        let distances = |pair: &Pair| {
            let [x, y] = pair.offset.map(f64::abs);
            match are_diagonal {
                true => (DIAGONAL.contains(&x) && (x - y).abs() < TOLERANCE).then_some(0.5 * (x + y)),
                false => (NEIGHBOURS.contains(&x.max(y)) && x.min(y) < TOLERANCE).then_some(x.max(y)),
            }
        };
        let mut distances: Vec<f64> = pairs.iter().filter_map(distances).collect();
        let period = median(&mut distances, f64::total_cmp).filter(|_| distances.len() >= 2 * FEWEST_PAIRS);
        Self { pairs, period }
    }

    /// Returns `true` if too few tags are next to each other.
    fn fit_nothing(&self) -> bool {
        self.period.is_none()
    }

    /// Returns `true` if enough pairs agree with a board, and not enough contradict it.
    fn fit(&self, board: &SquareBoard) -> bool {
        let [agreeing, contradicting] = self.counts(board);
        agreeing >= FEWEST_PAIRS && contradicting < FEWEST_CONTRADICTIONS
    }

    /// Returns `true` if enough pairs contradict a board.
    fn contradict(&self, board: &SquareBoard) -> bool {
        self.counts(board)[1] >= FEWEST_CONTRADICTIONS
    }

    /// Returns `true` if all pairs agree with `board`, and more of them than with `other`, which some contradict.
    fn prefer(&self, board: &SquareBoard, other: &SquareBoard) -> bool {
        let ([agreeing, contradicting], [fewer, of_other]) = (self.counts(board), self.counts(other));
        agreeing >= FEWEST_PAIRS && contradicting == 0 && of_other > 0 && agreeing > fewer
    }

    /// Returns the numbers of different pairs of neighbours that agree with a board, and that contradict it.
    fn counts(&self, board: &SquareBoard) -> [usize; 2] {
        let Some(period) = self.period else { return [0; 2] };
        let tags: BTreeMap<u16, Tag> = board.tags().into_iter().map(|tag| (tag.id, tag)).collect();
        let stated_period = match board {
            SquareBoard::Tags(grid) => 1.0 + grid.spacing,
            SquareBoard::Charuco(board) => board.square / board.marker,
            SquareBoard::Checkerboard(_) => return [0; 2],
        };
        let in_steps = |offset: [f64; 2], period: f64| offset.map(|along| (along / period).round() as i32);
        let mut seen: BTreeMap<([u16; 2], bool), usize> = BTreeMap::new();
        for pair in &self.pairs {
            let steps = in_steps(pair.offset, period);
            let is_near = steps.iter().all(|step| step.abs() <= 1);
            let is_on_lattice =
                pair.offset.iter().zip(steps).all(|(along, step)| (along / period - f64::from(step)).abs() < TOLERANCE);
            if !is_near || !is_on_lattice || steps == [0, 0] {
                continue;
            }
            let stated = pair.ids.map(|id| tags.get(&id));
            let agrees = match stated {
                [Some(from), Some(to)] => in_steps(offset_of(from, to), stated_period) == steps,
                _ => false,
            };
            *seen.entry((pair.ids, agrees)).or_default() += 1;
        }
        let count = |wanted: bool| {
            let often = seen.iter().filter(|((_, agrees), count)| *agrees == wanted && **count >= FEWEST_SIGHTINGS);
            // Each pair occurs in both orders.
            often.map(|(([a, b], _), _)| [*a.min(b), *a.max(b)]).collect::<BTreeSet<_>>().len()
        };
        [count(true), count(false)]
    }
}

/// Returns the position of the second tag relative to the first, as in [`Pair::offset`].
fn offset_of(from: &Tag, to: &Tag) -> [f64; 2] {
    let [top_left, top_right, _, bottom_left] = from.corners.map(Vector2::from);
    let (right, down) = (top_right - top_left, bottom_left - top_left);
    let apart = to.middle() - from.middle();
    [apart.dot(&right) / right.norm_squared(), apart.dot(&down) / down.norm_squared()]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rendering::{View, noisy};

    /// Compares pictures of the `printed` board in five orientations with the `stated` one.
    fn compared(printed: &str, stated: &str) -> Comparison {
        let printed: SquareBoard = printed.parse().unwrap();
        let (bounds, raster) = (printed.bounds(), printed.raster());
        let middle = [0, 1].map(|axis| (bounds.low[axis] + bounds.high[axis]) / 2.0);
        let longer = (bounds.high[0] - bounds.low[0]).max(bounds.high[1] - bounds.low[1]);
        let brightness = |x, y| if raster.is_dark_at([x, y]) { 0.1 } else { 0.9 };
        let mut tags = StatedTags::new(&stated.parse().unwrap()).unwrap();
        for rotation in [[0.3, -0.3, 0.1], [-0.2, 0.3, 0.2], [0.2, 0.1, -0.2], [0.0, 0.3, 0.1]] {
            let picture = View::new(middle, 1.6 * longer, rotation).render_in_parts(3, brightness);
            tags.add(&[noisy(&picture, 0.05)]);
        }
        tags.compare()
    }

    /// Three pictures of the middle of a board ended the comparison, so the trajectory was one square off without a word.
    #[test]
    fn pictures_of_the_middle_do_not_decide_between_layouts() {
        let [current, legacy] = ["", ":legacy"].map(|layout| format!("charuco:6x5:30mm:22mm:DICT_5X5_100{layout}"));
        let (printed, stated): (SquareBoard, SquareBoard) = (current.parse().unwrap(), legacy.parse().unwrap());
        let (bounds, raster) = (printed.bounds(), printed.raster());
        let middle = [0, 1].map(|axis| (bounds.low[axis] + bounds.high[axis]) / 2.0);
        let longer = (bounds.high[0] - bounds.low[0]).max(bounds.high[1] - bounds.low[1]);
        let brightness = |x, y| if raster.is_dark_at([x, y]) { 0.1 } else { 0.9 };
        let add = |tags: &mut StatedTags, distance: f64| {
            for rotation in [[0.3, -0.3, 0.1], [-0.2, 0.3, 0.2], [0.2, 0.1, -0.2], [0.0, 0.3, 0.1]] {
                let picture = View::new(middle, distance * longer, rotation).render_in_parts(3, brightness);
                tags.add(&[noisy(&picture, 0.05)]);
            }
        };
        let mut tags = StatedTags::new(&stated).unwrap();
        add(&mut tags, 0.7);
        assert!(!tags.exclude_variants());
        add(&mut tags, 1.6);
        assert!(!tags.exclude_variants());
        assert_eq!(tags.compare(), Comparison::Other(printed));
        let mut tags = StatedTags::new(&printed).unwrap();
        add(&mut tags, 1.6);
        assert!(tags.exclude_variants() && matches!(tags.compare(), Comparison::Same { .. }));
    }

    #[track_caller]
    fn same(printed: &str, stated: &str, expected: f64) {
        let Comparison::Same { ratio } = compared(printed, stated) else { panic!("{:?}", compared(printed, stated)) };
        assert!((ratio - expected).abs() < 0.01, "{printed} as {stated}: {ratio}");
    }

    #[track_caller]
    fn other(printed: &str, stated: &str) {
        let Comparison::Other(found) = compared(printed, stated) else { panic!("{:?}", compared(printed, stated)) };
        let printed: SquareBoard = printed.parse().unwrap();
        let found = match (found, printed) {
            (SquareBoard::Charuco(found), SquareBoard::Charuco(printed)) => {
                SquareBoard::Charuco(Charuco { square: printed.square, marker: printed.marker, ..found })
            }
            (found, printed) => found.with_length(match printed {
                SquareBoard::Tags(grid) => grid.tag,
                _ => 0.03,
            }),
        };
        assert_eq!(found.to_string(), printed.to_string(), "stated as {stated}");
    }

    /// The second length is measured whatever was stated.
    #[test]
    fn the_second_length_of_a_board_is_measured() {
        same("aprilgrid:4x5:30mm:0.3", "aprilgrid:4x5:30mm:0.3", 0.3);
        same("aprilgrid:4x5:30mm:0.3", "aprilgrid:4x5:30mm:0.01056", 0.3);
        same("apriltags:3x4:30mm:0.25", "apriltags:3x4:30mm:0.2", 0.25);
        same("charuco:5x7:40mm:30mm:DICT_5X5_100", "charuco:5x7:40mm:20mm:DICT_5X5_100", 0.75);
        same("charuco:6x5:40mm:28mm:DICT_4X4_50:legacy", "charuco:6x5:40mm:30mm:DICT_4X4_50:legacy", 0.7);
    }

    /// Stated with the wrong first tag or layout, all but the tags at the sides are at their stated places relative to each other,
    /// one tag or square away.
    #[test]
    fn a_board_that_is_shifted_by_one_tag_or_square_is_another() {
        other("aprilgrid:4x5:30mm:0.3", "aprilgrid:4x5:30mm:0.3:first1");
        other("aprilgrid:4x5:30mm:0.3:first1", "aprilgrid:4x5:30mm:0.3");
        other("apriltags:3x4:30mm:0.25:first4", "apriltags:3x4:30mm:0.25");
        other("charuco:6x5:40mm:30mm:DICT_4X4_100", "charuco:6x5:40mm:30mm:DICT_4X4_100:legacy");
        other("charuco:6x5:40mm:30mm:DICT_4X4_100:legacy", "charuco:6x5:40mm:30mm:DICT_4X4_100");
        other("charuco:8x6:40mm:30mm:DICT_4X4_50:legacy", "charuco:8x6:40mm:30mm:DICT_4X4_50");
        other("charuco:7x5:40mm:30mm:DICT_5X5_50", "charuco:5x7:40mm:30mm:DICT_5X5_50");
    }

    #[test]
    fn tags_in_other_orientations_orders_and_borders_are_another_board() {
        other("aprilgrid:4x5:30mm:0.3:turned180", "aprilgrid:4x5:30mm:0.3");
        other("aprilgrid:4x5:30mm:0.3:border1", "aprilgrid:4x5:30mm:0.3");
        other("apriltags:3x4:30mm:0.25:border2", "apriltags:3x4:30mm:0.25");
        other("apriltags:3x4:30mm:0.25:down:turned180", "apriltags:3x4:30mm:0.25");
        other("apriltags:3x4:30mm:0.25:down:turned180", "apriltags:4x3:30mm:0.25");
    }

    #[test]
    fn boards_of_another_family_are_unclear() {
        assert_eq!(compared("apriltags:3x4:30mm:0.25:25h9", "apriltags:3x4:30mm:0.25"), Comparison::Unclear);
        assert_eq!(compared("checkerboard:6x9:30mm", "aprilgrid:4x5:30mm:0.3"), Comparison::Unclear);
    }
}

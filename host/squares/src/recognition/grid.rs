//! Determines a grid of tags or a ChArUco board from the ids of its tags and their positions relative to each other.

use std::collections::{BTreeMap, BTreeSet};

use evcal_geometry::board::homography::homography;
use evcal_geometry::board::squares::family::{Dictionary, TagFamily};
use evcal_geometry::board::squares::{Charuco, CharucoLayout, SquareBoard, TagGrid, TagOrder};
use evcal_geometry::board::tag::Tag;
use evcal_geometry::numerics::statistics::median;
use nalgebra::{Matrix3, Vector2};

use super::{EXAMPLE_LENGTH, SeenTag};
use crate::tags::middle;

/// Distances of neighbouring tags of a grid, in sides of a tag. Tags in a row of a ChArUco board are farther apart.
pub(super) const NEIGHBOURS: std::ops::Range<f64> = 1.0..2.05;
/// Distances of diagonal neighbours of a ChArUco board along one axis, in sides of a tag.
pub(super) const DIAGONAL: std::ops::Range<f64> = 1.0..1.9;
/// Largest error of a distance along one axis, in sides of a tag.
pub(super) const TOLERANCE: f64 = 0.25;
/// Fewest pairs of neighbouring tags, and their share that must agree.
pub(super) const FEWEST_PAIRS: usize = 4;
const AGREEING: f64 = 0.8;
/// Number of moments in which a tag must be seen.
const FEWEST_SIGHTINGS: usize = 2;
/// Largest error of a measured spacing; usual spacings are multiples of 0.05.
const MEASURED: f64 = 0.02;
/// If the darkness next to the corners of tags is greater than this, the board has dark squares there.
const DARK: f32 = 0.5;

/// Two tags of one picture.
pub(super) struct Pair {
    pub(super) ids: [u16; 2],
    /// Position of the second tag relative to the first, in the first one's orientation and in sides of a tag: x to the
    /// right, y downwards.
    pub(super) offset: [f64; 2],
}

impl Pair {
    /// Returns the id of the second tag minus the id of the first.
    fn step(&self) -> i32 {
        let [first, second] = self.ids;
        i32::from(second) - i32::from(first)
    }
}

/// Returns the board with these tags; `None` if their ids and positions fit neither a grid nor a ChArUco board.
pub(super) fn board_of(sightings: &[Vec<SeenTag>], family: TagFamily, border: u8) -> Option<SquareBoard> {
    let pairs: Vec<Pair> = sightings.iter().flat_map(|tags| pairs_of(tags)).collect();
    let mut counts: BTreeMap<u16, usize> = BTreeMap::new();
    sightings.iter().flatten().for_each(|tag| *counts.entry(tag.id).or_default() += 1);
    counts.retain(|_, count| *count >= FEWEST_SIGHTINGS);
    let ids: Vec<u16> = counts.into_keys().collect();
    let mut darkness: Vec<f32> = sightings.iter().flatten().map(|tag| tag.darkness).collect();
    let corner_squares = median(&mut darkness, f32::total_cmp)? > DARK;
    grid(&pairs, &ids, family, border, corner_squares)
        .map(SquareBoard::Tags)
        .or_else(|| charuco(&pairs, &ids, family).filter(|_| border == 1).map(SquareBoard::Charuco))
}

/// Returns the smallest dictionary of a family that has all tags up to `last`.
fn dictionary_of(family: TagFamily, last: u16) -> Option<Dictionary> {
    Dictionary::all()
        .filter(|dictionary| dictionary.family == family && dictionary.tags > last)
        .min_by_key(|dictionary| dictionary.tags)
}

/// Returns all pairs of the tags of one moment, in both orders.
pub(super) fn pairs_of(tags: &[SeenTag]) -> Vec<Pair> {
    let unit = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]].map(Vector2::from);
    let corners = |tag: &SeenTag| tag.found.corners.map(|corner| Vector2::from(corner).cast::<f64>());
    let maps: Vec<Option<Matrix3<f64>>> = tags.iter().map(|tag| homography(&corners(tag), &unit)).collect();
    let offset = |from: &Option<Matrix3<f64>>, to: &SeenTag| {
        let place = from.as_ref()? * middle(&to.found.corners).push(1.0);
        Some(place.xy() / place.z - Vector2::new(0.5, 0.5))
    };
    let mut pairs = Vec::new();
    for (a, map_a) in tags.iter().zip(&maps) {
        for (b, map_b) in tags.iter().zip(&maps).filter(|(b, _)| b.id != a.id) {
            // The mean of both directions cancels most of the perspective.
            if let (Some(there), Some(back)) = (offset(map_a, b), offset(map_b, a)) {
                pairs.push(Pair { ids: [a.id, b.id], offset: ((there - back) / 2.0).into() });
            }
        }
    }
    pairs
}

/// Returns the most frequent value, if most values agree.
fn common(values: &[i32]) -> Option<i32> {
    let count = |value: &i32| values.iter().filter(|other| *other == value).count();
    let best = values.iter().max_by_key(|value| count(value)).copied()?;
    (values.len() >= FEWEST_PAIRS && count(&best) as f64 >= AGREEING * values.len() as f64).then_some(best)
}

fn grid(pairs: &[Pair], ids: &[u16], family: TagFamily, border: u8, corner_squares: bool) -> Option<TagGrid> {
    let neighbours = |axis: usize| {
        pairs.iter().filter_map(move |pair| {
            let [x, y] = pair.offset;
            let (along, across) = if axis == 0 { (x, y) } else { (y, x) };
            (NEIGHBOURS.contains(&along.abs()) && across.abs() < TOLERANCE).then_some((along, pair))
        })
    };
    let step_along = |(along, pair): (f64, &Pair)| if along > 0.0 { pair.step() } else { -pair.step() };
    // The step of the ids per step to the right, and downwards.
    let step = |axis: usize| {
        let steps: Vec<i32> = neighbours(axis).map(step_along).collect();
        common(&steps)
    };
    let (right, down) = (step(0), step(1));
    let mut periods: Vec<f64> = neighbours(0).chain(neighbours(1)).map(|(along, _)| along.abs()).collect();
    let period = median(&mut periods, f64::total_cmp)?;
    // Single tags that were mistaken for others have no such neighbours.
    let placed: BTreeSet<u16> = [(0, right), (1, down)]
        .into_iter()
        .flat_map(|(axis, step)| neighbours(axis).filter(move |pair| Some(step_along(*pair)) == step))
        .flat_map(|(_, pair)| pair.ids)
        .collect();
    let ids: Vec<u16> = ids.iter().copied().filter(|id| placed.contains(id)).collect();
    let (seen, last) = (*ids.first()?, *ids.last()?);
    let dictionary = dictionary_of(family, last)?;
    let count = last - seen + 1;
    // Directions of the ids in a row, and of the rows, in the orientation of a tag: x to the right, y downwards.
    let (along, across, columns) = match (right, down) {
        (Some(right @ (1 | -1)), Some(down)) if down.abs() > 1 => ([right, 0], [0, down.signum()], down.abs()),
        (Some(right), Some(down @ (1 | -1))) if right.abs() > 1 => ([0, down], [right.signum(), 0], right.abs()),
        // A single row is numbered as if it had rows above it, and a single column as if it had columns to its right.
        (Some(right @ (1 | -1)), None) => ([right, 0], [0, -1], i32::from(count)),
        (None, Some(down @ (1 | -1))) => ([1, 0], [0, down], 1),
        _ => return None,
    };
    let columns = u16::try_from(columns).ok()?;
    // A rotation does not change the handedness of both directions.
    let order = match along[0] * across[1] - along[1] * across[0] {
        1 => TagOrder::Downwards,
        _ => TagOrder::Upwards,
    };
    // Quarter turns, clockwise on the print, from upright.
    let turned: u8 = match along {
        [1, _] => 0,
        [_, -1] => 1,
        [-1, _] => 2,
        _ => 3,
    };
    let usual = if order == TagOrder::Downwards && dictionary.family.is_april() { 2 } else { 0 };
    let turn = (turned + 4 - usual) % 4;
    // Perspective makes the offsets of distant tags inaccurate.
    let near = pairs.iter().filter(|pair| pair.offset.iter().all(|offset| offset.abs() < NEIGHBOURS.end));
    let steps = near.map(|pair| (pair.ids, pair.offset.map(|offset| (offset / period).round() as i32)));
    let places = places(&steps.collect(), &ids);
    let along = |place: &[i32; 2]| place[0] * along[0] + place[1] * along[1];
    // A row begins in the first column, even if its first tag was not in view.
    let left = places.values().map(along).min()?;
    let first = places.iter().map(|(id, place)| i32::from(*id) - (along(place) - left)).min()?;
    let first = u16::try_from(first).ok()?;
    Some(TagGrid {
        rows: u8::try_from((last - first + 1).div_ceil(columns)).ok()?,
        columns: u8::try_from(columns).ok()?,
        tag: EXAMPLE_LENGTH,
        spacing: likely_spacing(period - 1.0),
        corner_squares,
        dictionary,
        border,
        first_id: first,
        order,
        turn,
    })
}

/// Returns the usual spacing near a measured one, or else the measured one rounded to 0.01.
fn likely_spacing(measured: f64) -> f64 {
    let rounded = |steps: f64| (measured * steps).round() / steps;
    let usual = rounded(20.0);
    if (measured - usual).abs() <= MEASURED { usual } else { rounded(100.0) }
}

fn charuco(pairs: &[Pair], ids: &[u16], family: TagFamily) -> Option<Charuco> {
    let dictionary = dictionary_of(family, *ids.last()?)?;
    let diagonal = pairs.iter().filter(|pair| {
        let [x, y] = pair.offset.map(f64::abs);
        DIAGONAL.contains(&x) && (x - y).abs() < TOLERANCE
    });
    let mut ratios: Vec<f64> = diagonal.clone().flat_map(|pair| pair.offset.map(f64::abs)).collect();
    let ratio = median(&mut ratios, f64::total_cmp).filter(|_| ratios.len() >= 2 * FEWEST_PAIRS)?;
    // Steps in squares as printed: OpenCV draws AprilTags rotated by 180°.
    let sign = if dictionary.family.is_april() { -1.0 } else { 1.0 };
    let steps: BTreeMap<[u16; 2], [i32; 2]> =
        diagonal.map(|pair| (pair.ids, pair.offset.map(|offset| (sign * offset / ratio).round() as i32))).collect();
    let places = places(&steps, ids);
    let extent = |axis: usize| {
        let values: Vec<i32> = places.values().filter_map(|place| place.get(axis).copied()).collect();
        Some(values.iter().max()? - values.iter().min()?)
    };
    let (across, down) = (extent(0)?, extent(1)?);
    let sizes = (1..=2).flat_map(|more| (1..=2).map(move |wider| [down + more, across + wider]));
    let mut boards = sizes.flat_map(|[rows, columns]| {
        [CharucoLayout::Current, CharucoLayout::Legacy].into_iter().filter_map(move |layout| {
            let marker = (EXAMPLE_LENGTH / ratio * 1e4).round() / 1e4;
            let (rows, columns) = (u8::try_from(rows).ok()?, u8::try_from(columns).ok()?);
            Some(Charuco { rows, columns, square: EXAMPLE_LENGTH, marker, dictionary, layout })
        })
    });
    boards.find(|board| fits(board, &places))
}

/// Returns the positions of the tags relative to the first one, as sums of `steps` between neighbours.
fn places(steps: &BTreeMap<[u16; 2], [i32; 2]>, ids: &[u16]) -> BTreeMap<u16, [i32; 2]> {
    let mut places: BTreeMap<u16, [i32; 2]> = ids.first().map(|id| (*id, [0, 0])).into_iter().collect();
    let mut open: Vec<u16> = places.keys().copied().collect();
    while let Some(from) = open.pop() {
        let Some(&[x, y]) = places.get(&from) else { continue };
        for ([_, to], [dx, dy]) in steps.range([from, 0]..=[from, u16::MAX]) {
            if ids.contains(to) && !places.contains_key(to) {
                places.insert(*to, [x + dx, y + dy]);
                open.push(*to);
            }
        }
    }
    places
}

/// Returns `true` if the tags of `board` are at these positions, apart from a common shift.
fn fits(board: &Charuco, places: &BTreeMap<u16, [i32; 2]>) -> bool {
    let square = |tag: &Tag| <[f64; 2]>::from(tag.middle()).map(|place| (place / board.square).floor() as i32);
    let tags = SquareBoard::Charuco(*board).tags();
    let printed: BTreeMap<u16, [i32; 2]> = tags.iter().map(|tag| (tag.id, square(tag))).collect();
    let shift = |(id, [x, y]): (&u16, &[i32; 2])| printed.get(id).map(|[column, row]| [column - x, row - y]);
    let shifts: Option<BTreeSet<[i32; 2]>> = places.iter().map(shift).collect();
    shifts.is_some_and(|shifts| shifts.len() == 1) && places.len() >= FEWEST_PAIRS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tags::FoundTag;

    /// An id that was misread in two pictures must not add rows to the board.
    #[test]
    fn a_single_mistaken_id_does_not_change_the_board() {
        let board: SquareBoard = "aprilgrid:3x4:30mm:0.3".parse().unwrap();
        let pixels = |corners: [[f64; 2]; 4]| corners.map(|corner| corner.map(|place| (2000.0 * place) as f32 + 300.0));
        let seen = |id: u16, corners: [[f64; 2]; 4]| SeenTag {
            id,
            found: FoundTag { index: id.into(), corners: pixels(corners), score: 0.9 },
            darkness: 1.0,
        };
        let mut picture: Vec<SeenTag> = board.tags().iter().map(|tag| seen(tag.id, tag.corners)).collect();
        picture[5] = SeenTag { id: 564, ..picture[5] };
        let whole: Vec<SeenTag> = board.tags().iter().map(|tag| seen(tag.id, tag.corners)).collect();
        let found = board_of(&[picture.clone(), whole.clone(), picture, whole], TagFamily::April36h11, 2);
        assert_eq!(found.map(|board| board.to_string()).as_deref(), Some("aprilgrid:3x4:30mm:0.3"));
    }
}

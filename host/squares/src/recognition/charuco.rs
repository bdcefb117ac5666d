//! ChArUco boards, recognised by all their markers together.
//!
//! Markers of a few pixels per module can hardly be read one by one. But the corners of the checkerboard determine the
//! position of each marker, and the markers of a ChArUco board are the first ones of its dictionary, in the order of
//! the squares. Therefore each possible board is compared as a whole: all its markers with all squares in all moments.
//! It is accepted if it correlates clearly better than any other board. Squares without markers all look the same and
//! would correlate too, so the differences between squares are compared.

use evcal_geometry::board::squares::family::{Dictionary, TagFamily};
use evcal_geometry::board::squares::{Charuco, CharucoLayout, SquareBoard};

use super::{EXAMPLE_LENGTH, SeenLattice};
use crate::alignment::SquareMap;
use crate::tags::{normalise, turned};

/// Families of markers.
const FAMILIES: [TagFamily; 10] = [
    TagFamily::Aruco4x4,
    TagFamily::Aruco5x5,
    TagFamily::Aruco6x6,
    TagFamily::Aruco7x7,
    TagFamily::ArucoOriginal,
    TagFamily::ArucoMip36h12,
    TagFamily::April36h11,
    TagFamily::April36h10,
    TagFamily::April25h9,
    TagFamily::April16h5,
];
/// Sides of their inner parts in modules.
const SIDES: [usize; 4] = [4, 5, 6, 7];
/// Sides of a marker that are tried, in percent of the side of a square.
const MARKERS: std::ops::RangeInclusive<u8> = 50..=95;
const MARKER_STEP: usize = 3;
/// Smallest correlation of the best board; and smallest difference and ratio to the correlation of the next best.
const LEAST: f32 = 0.2;
const LEAST_MARGIN: f32 = 0.1;
const LEAST_RATIO: f32 = 1.6;
/// Smallest correlation, in standard deviations of the correlation with as many random modules.
const LEAST_SIGNIFICANCE: f32 = 6.0;
/// Samples along the side of a square, and the share of the side that they cover, for a comparison without known markers.
const SAMPLES: usize = 8;
const SHARE: f64 = 0.7;
/// If the mean correlation of pairs of moments is greater than this, the squares of one shade differ from each other.
const LEAST_DIFFERENT: f32 = 0.2;

/// Rows and columns of corners.
#[derive(Clone, Copy)]
pub(super) struct Size {
    pub rows: usize,
    pub columns: usize,
}

impl Size {
    /// Returns the index in the lattice of the square at (`row`, `column`) of a board rotated by `turn` quarter turns.
    fn cell(self, turn: usize, row: usize, column: usize) -> Option<usize> {
        let (rows, columns) = (self.rows - 1, self.columns - 1);
        let (row, column) = match turn {
            0 => (row, column),
            1 => (column, columns.checked_sub(row + 1)?),
            2 => (rows.checked_sub(row + 1)?, columns.checked_sub(column + 1)?),
            _ => (rows.checked_sub(column + 1)?, row),
        };
        (row < rows && column < columns).then_some(row * columns + column)
    }
}

/// The squares between the corners of a picture row by row, each as samples with mean 0 and norm 1; `None` without all
/// four corners.
type Squares = Vec<Option<Vec<f32>>>;

/// The markers of a board in one orientation, each with the index of its square.
type Markers = Vec<(usize, Vec<f32>)>;

struct Candidate {
    board: Charuco,
    /// Its rotations in quarters that fit the lattice.
    turns: &'static [usize],
}

/// Returns the ChArUco board with corners of this size in the pictures; `None` if no board is clearly better than others.
pub(super) fn read_markers(moments: &[Vec<SeenLattice>], size: Size) -> Option<Charuco> {
    let candidates = candidates(size);
    let mut best: Vec<f32> = vec![-1.0; candidates.len()];
    for side in SIDES {
        let of_side = |candidate: &Candidate| candidate.board.dictionary.family.inner_side() == side;
        let markers: Vec<Vec<Markers>> = candidates
            .iter()
            .map(|candidate| if of_side(candidate) { candidate.markers(size, 0) } else { Vec::new() })
            .collect();
        for percent in MARKERS.step_by(MARKER_STEP) {
            let inner = f64::from(percent) / 100.0 * side as f64 / (side + 2) as f64;
            let squares = all_squares(moments, size, side, inner);
            for (turns, best) in markers.iter().zip(&mut best).filter(|(turns, _)| !turns.is_empty()) {
                *best = best.max(mean_of_best(&squares, turns, difference_correlation));
            }
        }
    }
    let mut order: Vec<(f32, &Candidate)> = best.into_iter().zip(&candidates).collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0));
    let [(score, first), (other, _), ..] = order.as_slice() else { return None };
    let is_clear = *score >= LEAST
        && score - other >= LEAST_MARGIN
        && *score >= LEAST_RATIO * other
        && *score >= LEAST_SIGNIFICANCE / (modules_compared(moments, size, first) as f32).sqrt();
    is_clear.then(|| {
        let marker = EXAMPLE_LENGTH * f64::from(marker_size(moments, size, first)) / 100.0;
        Charuco { marker: (marker * 1e4).round() / 1e4, ..first.board }
    })
}

/// Returns `true` if squares of one shade differ from each other, and in all moments in the same way.
pub(super) fn squares_differ(moments: &[Vec<SeenLattice>], size: Size) -> bool {
    let first: Vec<&[SeenLattice]> = moments.iter().filter_map(|seen| seen.get(..1)).collect();
    let columns = size.columns - 1;
    [0, 1].into_iter().any(|parity| {
        let of_parity = |lattice: &SeenLattice| {
            let mut squares = squares_of(lattice, size, SAMPLES, SHARE);
            let others = squares.iter_mut().enumerate();
            others
                .filter(|(cell, _)| (cell / columns + cell % columns) % 2 != parity)
                .for_each(|(_, square)| *square = None);
            squares
        };
        let squares: Vec<Squares> = first.iter().copied().flatten().map(of_parity).collect();
        let pairs =
            squares.iter().enumerate().flat_map(|(index, a)| squares.iter().skip(index + 1).map(move |b| (a, b)));
        let differences = pairs.map(|(a, b)| {
            // The first corner may be another one in each picture.
            let markers = |turn: usize| -> Markers {
                let in_turn = |(cell, square): (usize, &Option<Vec<f32>>)| {
                    let cell = if turn == 0 { cell } else { a.len() - 1 - cell };
                    let mut square = square.clone()?;
                    if turn > 0 {
                        square.reverse();
                    }
                    Some((cell, square))
                };
                a.iter().enumerate().filter_map(in_turn).collect()
            };
            [0, 2].map(|turn| difference_correlation(&markers(turn), b)).into_iter().fold(-1.0, f32::max)
        });
        let differences: Vec<f32> = differences.collect();
        !differences.is_empty() && differences.iter().sum::<f32>() >= LEAST_DIFFERENT * differences.len() as f32
    })
}

impl Candidate {
    /// Returns the markers between corners for each orientation, with this border in modules.
    fn markers(&self, size: Size, border: u8) -> Vec<Markers> {
        let family = self.board.dictionary.family;
        let side = family.inner_side() + 2 * usize::from(border);
        let tags = SquareBoard::Charuco(self.board).tags();
        // OpenCV draws AprilTags rotated by 180°.
        let upright = if family.is_april() { 2 } else { 0 };
        let of_turn = |turn: &usize| {
            let marker = |id: u16, [column, row]: [usize; 2]| {
                let cell = size.cell(*turn, row.checked_sub(1)?, column.checked_sub(1)?)?;
                let light = family.light(id, border)?;
                let mut values: Vec<f32> = light.into_iter().map(|light| if light { 1.0 } else { 0.0 }).collect();
                normalise(&mut values);
                Some((cell, (0..(4 - turn + upright) % 4).fold(values, |values, _| turned(&values, side))))
            };
            let square = |place: f64| (place / self.board.square) as usize;
            tags.iter().filter_map(|tag| marker(tag.id, <[f64; 2]>::from(tag.middle()).map(square))).collect()
        };
        self.turns.iter().map(of_turn).collect()
    }
}

/// Returns all boards with corners of this size.
fn candidates(size: Size) -> Vec<Candidate> {
    let (rows, columns) = (size.rows + 1, size.columns + 1);
    let sizes: &[([usize; 2], &'static [usize])] = match rows == columns {
        true => &[([rows, columns], &[0, 1, 2, 3])],
        false => &[([rows, columns], &[0, 2]), ([columns, rows], &[1, 3])],
    };
    let mut candidates = Vec::new();
    for family in FAMILIES {
        for ([rows, columns], turns) in sizes {
            let (Ok(high), Ok(wide)) = (u8::try_from(*rows), u8::try_from(*columns)) else { continue };
            let enough = |dictionary: &Dictionary| {
                dictionary.family == family && usize::from(dictionary.tags) >= (rows * columns).div_ceil(2)
            };
            let Some(dictionary) = Dictionary::all().filter(enough).min_by_key(|dictionary| dictionary.tags) else {
                continue;
            };
            // With an odd number of rows both layouts are equal.
            let layouts: &[CharucoLayout] = match rows.is_multiple_of(2) {
                true => &[CharucoLayout::Current, CharucoLayout::Legacy],
                false => &[CharucoLayout::Current],
            };
            candidates.extend(layouts.iter().map(|layout| {
                let (square, marker) = (EXAMPLE_LENGTH, EXAMPLE_LENGTH / 2.0);
                let board = Charuco { rows: high, columns: wide, square, marker, dictionary, layout: *layout };
                Candidate { board, turns }
            }));
        }
    }
    candidates
}

/// Returns the number of compared modules: the sum over the moments, each with the picture that has most.
fn modules_compared(moments: &[Vec<SeenLattice>], size: Size, candidate: &Candidate) -> usize {
    let side = candidate.board.dictionary.family.inner_side();
    let turns = candidate.markers(size, 0);
    let of_picture = |seen: &SeenLattice| {
        let squares = squares_of(seen, size, side, SHARE);
        turns.iter().map(|markers| pairs(markers, &squares).len()).max().unwrap_or(0)
    };
    let of_moment = |seen: &Vec<SeenLattice>| seen.iter().map(of_picture).max().unwrap_or(0);
    moments.iter().map(of_moment).sum::<usize>() * side * side
}

/// Returns the side of the markers in percent of the side of a square.
fn marker_size(moments: &[Vec<SeenLattice>], size: Size, candidate: &Candidate) -> u8 {
    let side = candidate.board.dictionary.family.inner_side() + 2;
    let markers = candidate.markers(size, 1);
    let score = |percent: &u8| {
        let squares = all_squares(moments, size, side, f64::from(*percent) / 100.0);
        mean_of_best(&squares, &markers, correlation)
    };
    let scored = MARKERS.map(|percent| (score(&percent), percent));
    scored.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(*MARKERS.start(), |(_, percent)| percent)
}

/// Returns the squares of all pictures of each moment.
fn all_squares(moments: &[Vec<SeenLattice>], size: Size, side: usize, share: f64) -> Vec<Vec<Squares>> {
    let of_moment = |seen: &Vec<SeenLattice>| seen.iter().map(|seen| squares_of(seen, size, side, share)).collect();
    moments.iter().map(of_moment).collect()
}

/// Returns `side` × `side` samples of the middle of each square, which cover this share of its side.
fn squares_of(seen: &SeenLattice, size: Size, side: usize, share: f64) -> Squares {
    let corners = &seen.lattice.corners;
    let corner = |row: usize, column: usize| {
        let place = corners.binary_search_by_key(&(row * size.columns + column), |point| point.index).ok()?;
        corners.get(place).map(|point| point.pixel.map(f64::from))
    };
    let place = |index: usize| 0.5 + share * ((index as f64 + 0.5) / side as f64 - 0.5);
    let square = |row: usize, column: usize| {
        let [next_row, next_column] = [row + 1, column + 1];
        let map = SquareMap::new(&[
            corner(row, column)?,
            corner(row, next_column)?,
            corner(next_row, next_column)?,
            corner(next_row, column)?,
        ]);
        let at = |index: usize| {
            let [x, y] = map.at(place(index % side), place(index / side));
            seen.picture.bilinear(x as f32, y as f32)
        };
        let mut samples: Vec<f32> = (0..side * side).map(at).collect();
        normalise(&mut samples);
        Some(samples)
    };
    let cells = (0..size.rows - 1).flat_map(|row| (0..size.columns - 1).map(move |column| (row, column)));
    cells.map(|(row, column)| square(row, column)).collect()
}

/// Returns the mean over the moments of the best correlation in any orientation and picture.
fn mean_of_best(moments: &[Vec<Squares>], turns: &[Markers], correlation: fn(&Markers, &Squares) -> f32) -> f32 {
    let best = |pictures: &Vec<Squares>| {
        let all = pictures.iter().flat_map(|squares| turns.iter().map(|markers| correlation(markers, squares)));
        all.fold(-1.0, f32::max)
    };
    moments.iter().map(best).sum::<f32>() / moments.len().max(1) as f32
}

/// Returns the markers whose squares are visible, each with its square.
fn pairs<'a>(markers: &'a Markers, squares: &'a Squares) -> Vec<(&'a [f32], &'a [f32])> {
    let pair = |(cell, marker): &'a (usize, Vec<f32>)| Some((marker.as_slice(), squares.get(*cell)?.as_deref()?));
    markers.iter().filter_map(pair).collect()
}

/// Returns the mean correlation of markers with their squares.
fn correlation(markers: &Markers, squares: &Squares) -> f32 {
    let pairs = pairs(markers, squares);
    let product = |(marker, square): &(&[f32], &[f32])| marker.iter().zip(*square).map(|(a, b)| a * b).sum::<f32>();
    pairs.iter().map(product).sum::<f32>() / pairs.len().max(1) as f32
}

/// Returns the correlation of the differences between markers with those between their squares.
fn difference_correlation(markers: &Markers, squares: &Squares) -> f32 {
    let pairs = pairs(markers, squares);
    let samples = pairs.first().map_or(0, |(marker, _)| marker.len());
    let count = pairs.len().max(1) as f32;
    let (mut product, mut printed, mut seen) = (0.0_f32, 0.0_f32, 0.0_f32);
    for sample in 0..samples {
        let values = || pairs.iter().filter_map(|(marker, square)| Some((marker.get(sample)?, square.get(sample)?)));
        let (marker_sum, square_sum) = values().fold((0.0, 0.0), |(a, b), (marker, square)| (a + marker, b + square));
        for (marker, square) in values() {
            let (a, b) = (marker - marker_sum / count, square - square_sum / count);
            product += a * b;
            printed += a * a;
            seen += b * b;
        }
    }
    product / (printed * seen).sqrt().max(f32::MIN_POSITIVE)
}

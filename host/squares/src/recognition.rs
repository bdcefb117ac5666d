//! Recognises an unknown board of squares: its kind, rows and columns, tags and ratios.
//!
//! 1. The corners of a checkerboard form lattices. If its light squares contain markers, it is a ChArUco board; the markers need
//!    not be readable one by one.
//! 2. Otherwise it is a checkerboard, if its ends are in view.
//! 3. Without such a lattice the tags of all families, with a border of one or two modules, are searched one by one.
//!    The ids and relative positions of neighbouring tags determine a grid of tags or a ChArUco board.
//! 4. If nothing is found, or markers of no dictionary, the mirror images of the pictures are searched for tags and markers.
//!
//! A *moment* is a time at which one or several pictures were made. Pictures do not show lengths, so a recognised board gets an
//! arbitrary size, [`EXAMPLE_LENGTH`].

mod charuco;
mod grid;
pub mod stated;

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet};

use evcal_geometry::board::squares::family::TagFamily;
use evcal_geometry::board::squares::{Checkerboard, Shade, SquareBoard};
use evcal_geometry::board::tag::Tag;
use rayon::prelude::*;

use self::charuco::Size;
use crate::alignment::SquareMap;
use crate::checkerboard::{CornerLattice, NoCheckerboard, corner_lattices, find_checkerboard};
use crate::picture::Picture;
use crate::quads::{Quad, find_quads};
use crate::tags::{FoundTag, Smooth, TagFinder, is_same_place};

/// Side of a square of a recognised board, or of a tag of a grid, in metres.
pub const EXAMPLE_LENGTH: f64 = 0.03;
/// Fewest moments that must show the board.
const FEWEST_MOMENTS: usize = 3;
/// Markers are read only in lattices whose size occurs at this number of moments or more.
const FEWEST_OF_SIZE: usize = 2;
/// Largest number of sizes of lattices in which markers are read.
const MOST_SIZES: usize = 4;
/// Fewest tags that a moment must show to be used.
const FEWEST_TAGS: usize = 3;
/// Distance from a tag, as a share of its side, at which the shades of the gap and of the corner squares are measured.
const MARGIN: f64 = 0.08;
/// Families that are searched, the usual ones first, each with the number of its tags that are searched, from id 0 on (boards use the
/// lowest ids). The more tags are searched, the more look alike.
const FAMILIES: [(TagFamily, u16); 9] = [
    (TagFamily::April36h11, 587),
    (TagFamily::Aruco5x5, 100),
    (TagFamily::Aruco4x4, 100),
    (TagFamily::Aruco6x6, 100),
    (TagFamily::Aruco7x7, 100),
    (TagFamily::ArucoOriginal, 100),
    (TagFamily::ArucoMip36h12, 100),
    (TagFamily::April25h9, 35),
    (TagFamily::April16h5, 30),
];
/// Widths of the dark border of tags that are searched, in modules.
const BORDERS: [u8; 2] = [1, 2];
/// Rows and columns with which the finder of checkerboards is called. If it sees a whole board of another size, its error contains
/// that size ([`NoCheckerboard::OtherSize`]).
const TRIED: [u8; 2] = [4, 5];

/// A board that was recognised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecognisedBoard {
    /// The board. Its square, or a tag of its grid, has [`EXAMPLE_LENGTH`].
    pub board: SquareBoard,
    /// Number of moments that show it.
    pub fitting: usize,
    /// Number of moments.
    pub moments: usize,
    /// `true` if the light squares of a checkerboard contain something that differs from square to square: it may be a ChArUco board
    /// of an unknown dictionary.
    pub has_unknown_markers: bool,
    /// `true` if the pictures show its mirror image.
    pub is_mirrored: bool,
}

impl RecognisedBoard {
    /// Creates the description of a `board` that `fitting` of `moments` show, not mirrored and without unknown markers.
    pub fn new(board: SquareBoard, fitting: usize, moments: usize) -> Self {
        Self { board, fitting, moments, has_unknown_markers: false, is_mirrored: false }
    }
}

/// A tag in a picture.
#[derive(Clone, Copy, Debug)]
struct SeenTag {
    id: u16,
    found: FoundTag,
    /// Darkness next to its corners: 0 as light as the gap next to its sides, 1 as dark as its border.
    darkness: f32,
}

/// The lattice of corners in a picture.
#[derive(Clone)]
struct SeenLattice<'a> {
    picture: &'a Picture,
    lattice: CornerLattice,
}

/// Recognises the board in the pictures of some moments; `None` if no board is found, or if it is ambiguous.
pub fn recognise(moments: &[Vec<Picture>]) -> Option<RecognisedBoard> {
    let lattices = lattices_in(moments);
    let found = recognise_charuco(&lattices)
        .or_else(|| recognise_checkerboard(moments, &lattices))
        .or_else(|| recognise_tags(moments));
    // Mirror images of markers are not in any dictionary.
    if found.is_some_and(|found| !found.has_unknown_markers) {
        return found;
    }
    let mirrored: Vec<Vec<Picture>> =
        moments.iter().map(|pictures| pictures.iter().map(Picture::mirrored).collect()).collect();
    let in_mirror = recognise_charuco(&lattices_in(&mirrored)).or_else(|| match found {
        Some(_) => None,
        None => recognise_tags(&mirrored),
    });
    in_mirror.map(|board| RecognisedBoard { is_mirrored: true, ..board }).or(found)
}

/// Returns the lattices of corners in the pictures of each moment.
fn lattices_in(moments: &[Vec<Picture>]) -> Vec<Vec<SeenLattice<'_>>> {
    let in_picture =
        |picture| corner_lattices(picture).into_iter().map(move |lattice| SeenLattice { picture, lattice });
    moments.par_iter().map(|pictures| pictures.iter().flat_map(in_picture).collect()).collect()
}

/// Returns the lattices of this size, without moments that have none.
fn of_size<'a>(moments: &[Vec<SeenLattice<'a>>], size: [usize; 2]) -> Vec<Vec<SeenLattice<'a>>> {
    let of_moment = |seen: &Vec<SeenLattice<'a>>| {
        let of_size = seen.iter().filter(|seen| [seen.lattice.rows, seen.lattice.columns] == size);
        of_size.cloned().collect::<Vec<_>>()
    };
    moments.iter().map(of_moment).filter(|seen| !seen.is_empty()).collect()
}

fn recognise_charuco(lattices: &[Vec<SeenLattice>]) -> Option<RecognisedBoard> {
    let sizes: BTreeSet<[usize; 2]> =
        lattices.iter().flatten().map(|seen| [seen.lattice.rows, seen.lattice.columns]).collect();
    let mut seen: Vec<([usize; 2], Vec<Vec<SeenLattice>>)> =
        sizes.into_iter().map(|size| (size, of_size(lattices, size))).collect();
    seen.retain(|(_, moments)| moments.len() >= FEWEST_OF_SIZE);
    seen.sort_by_key(|(_, moments)| std::cmp::Reverse(moments.len()));
    seen.into_iter().take(MOST_SIZES).find_map(|([rows, columns], seen)| {
        let board = charuco::read_markers(&seen, Size { rows, columns })?;
        let (fitting, moments) = (seen.len(), lattices.len());
        Some(RecognisedBoard::new(SquareBoard::Charuco(board), fitting, moments))
    })
}

/// A picture, prepared for the search, with its dark quadrilaterals.
struct Prepared {
    smooth: Smooth,
    quads: Vec<Quad>,
}

impl Prepared {
    fn new(picture: &Picture) -> Self {
        Self { smooth: Smooth::new(picture), quads: find_quads(picture) }
    }
}

fn recognise_tags(moments: &[Vec<Picture>]) -> Option<RecognisedBoard> {
    let prepare = |pictures: &Vec<Picture>| pictures.iter().map(Prepared::new).collect::<Vec<_>>();
    // A board must be visible at FEWEST_MOMENTS moments. If they follow each other, every FEWEST_MOMENTS-th moment is
    // enough to find it.
    let sample: Vec<Vec<Prepared>> = moments.par_iter().step_by(FEWEST_MOMENTS).map(prepare).collect();
    let all: OnceCell<Vec<Vec<Prepared>>> = OnceCell::new();
    // The first picture of a moment nearly always shows a board that the others show.
    let first: Vec<&[Prepared]> = sample.iter().map(|pictures| pictures.get(..1).unwrap_or_default()).collect();
    let whole: Vec<&[Prepared]> = sample.iter().map(Vec::as_slice).collect();
    [first, whole].iter().find_map(|sample| {
        FAMILIES.into_iter().find_map(|(family, count)| {
            let scored = BORDERS.into_iter().filter_map(|border| {
                let finder = TagFinder::new(&tags_of(family, count, border)).ok()?;
                let score = sightings_of(&finder, sample).iter().flatten().map(|tag| tag.found.score).sum::<f32>();
                (score > 0.0).then_some((score, border, finder))
            });
            // With the wrong width of the border, fewer tags match, and their correlations are smaller.
            let (_, border, finder) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
            let sightings = sightings_of(&finder, all.get_or_init(|| moments.par_iter().map(prepare).collect()));
            let board = grid::board_of(&sightings, family, border).filter(|_| sightings.len() >= FEWEST_MOMENTS)?;
            Some(RecognisedBoard::new(board, sightings.len(), moments.len()))
        })
    })
}

/// Returns the tags of each moment that shows at least [`FEWEST_TAGS`] of them.
fn sightings_of<P: AsRef<[Prepared]> + Sync>(finder: &TagFinder, prepared: &[P]) -> Vec<Vec<SeenTag>> {
    let seen = prepared.par_iter().map(|pictures| tags_in(finder, pictures.as_ref()));
    seen.filter(|tags| tags.len() >= FEWEST_TAGS).collect()
}

/// Returns the first `count` tags of a family, each at a position of its own.
fn tags_of(family: TagFamily, count: u16, border: u8) -> Vec<Tag> {
    let tag = |id: u16| {
        let left = 2.0 * f64::from(id);
        let corners = [[left, 0.0], [left + 1.0, 0.0], [left + 1.0, 1.0], [left, 1.0]];
        let side = family.inner_side() + 2 * usize::from(border);
        Some(Tag { id, corners, side, light: family.light(id, border)? })
    };
    (0..count).map_while(tag).collect()
}

/// Returns the tags in the pictures of one moment, each from the picture in which it correlates best.
fn tags_in(finder: &TagFinder, pictures: &[Prepared]) -> Vec<SeenTag> {
    let mut seen = BTreeMap::new();
    pictures.iter().for_each(|picture| add_tags(finder, picture, &mut seen));
    seen.into_values().collect()
}

/// Adds the tags of a picture that were not `seen`, or that correlate better in it.
fn add_tags(finder: &TagFinder, Prepared { smooth, quads }: &Prepared, seen: &mut BTreeMap<u16, SeenTag>) {
    let mut in_picture: Vec<FoundTag> = Vec::new();
    for quad in quads {
        // Most quadrilaterals are found several times, with surroundings of different sizes.
        let is_known = in_picture.iter().any(|known| is_same_place(&known.corners, quad));
        if !is_known && finder.has_border(smooth, quad) {
            in_picture.extend(finder.recognised(smooth, quad));
        }
    }
    for found in in_picture {
        let Some(tag) = finder.tags().get(found.index) else { continue };
        if seen.get(&tag.id).is_none_or(|known| known.found.score < found.score) {
            let darkness = darkness_next_to_corners(smooth.picture(), &found, tag.side);
            seen.insert(tag.id, SeenTag { id: tag.id, found, darkness });
        }
    }
}

fn darkness_next_to_corners(picture: &Picture, tag: &FoundTag, side: usize) -> f32 {
    let map = SquareMap::new(&tag.corners.map(|corner| corner.map(f64::from)));
    let at = |[u, v]: [f64; 2]| {
        let [x, y] = map.at(u, v);
        picture.bilinear(x as f32, y as f32)
    };
    let mean = |places: [[f64; 2]; 4]| places.map(at).iter().sum::<f32>() / 4.0;
    let (low, high) = (-MARGIN, 1.0 + MARGIN);
    let module = 0.5 / side as f64;
    let corners = mean([[low, low], [high, low], [low, high], [high, high]]);
    let gaps = mean([[0.5, low], [0.5, high], [low, 0.5], [high, 0.5]]);
    let border = mean([[0.5, module], [0.5, 1.0 - module], [module, 0.5], [1.0 - module, 0.5]]);
    (gaps - corners) / (gaps - border).max(f32::MIN_POSITIVE)
}

fn recognise_checkerboard(moments: &[Vec<Picture>], lattices: &[Vec<SeenLattice>]) -> Option<RecognisedBoard> {
    let [rows, columns] = TRIED;
    let size_in = |picture: &Picture| match find_checkerboard(picture, rows, columns, None) {
        Ok(_) => Some(TRIED.map(usize::from)),
        Err(NoCheckerboard::OtherSize { rows, columns }) => Some([rows, columns]),
        Err(_) => None,
    };
    let sizes: Vec<Vec<[usize; 2]>> =
        moments.par_iter().map(|pictures| pictures.iter().filter_map(size_in).collect()).collect();
    let count = |size: &[usize; 2]| sizes.iter().filter(|sizes| sizes.contains(size)).count();
    let seen: BTreeSet<[usize; 2]> = sizes.iter().flatten().copied().collect();
    let size = seen.into_iter().max_by_key(count)?;
    let fitting = count(&size);
    // Parts of a board, or a pattern that is not a board, have many sizes.
    if fitting < FEWEST_MOMENTS || 2 * fitting <= sizes.iter().filter(|sizes| !sizes.is_empty()).count() {
        return None;
    }
    let [rows, columns] = size;
    let has_unknown_markers = charuco::squares_differ(&of_size(lattices, size), Size { rows, columns });
    let (rows, columns) = (u8::try_from(rows).ok()?, u8::try_from(columns).ok()?);
    let board = Checkerboard { rows, columns, square: EXAMPLE_LENGTH, first: Shade::Dark };
    let found = RecognisedBoard::new(SquareBoard::Checkerboard(board), fitting, moments.len());
    Some(RecognisedBoard { has_unknown_markers, ..found })
}

#[cfg(test)]
mod tests {
    use evcal_geometry::board::Board;
    use evcal_geometry::board::sheet::{Page, board_sheet};
    use evcal_geometry::board::squares::Charuco;
    use evcal_geometry::board::squares::raster::{Raster, Rectangle};

    use super::*;
    use crate::rendering::{View, is_dark, noisy, tag};

    /// Returns the board that is recognised in pictures of a board of this brightness in four orientations. The lens
    /// sees `distance` times the longer side of the board.
    fn recognised(bounds: Rectangle, distance: f64, brightness: impl Fn(f64, f64) -> f32) -> Option<RecognisedBoard> {
        let middle = [0, 1].map(|axis| (bounds.low[axis] + bounds.high[axis]) / 2.0);
        let longer = (bounds.high[0] - bounds.low[0]).max(bounds.high[1] - bounds.low[1]);
        let rotations = [[0.3, -0.3, 0.1], [-0.2, 0.3, 0.2], [0.2, 0.1, -0.2], [0.0, 0.3, 0.1]];
        let picture = |rotation| View::new(middle, distance * longer, rotation).render_in_parts(3, &brightness);
        recognise(&rotations.map(|rotation| vec![noisy(&picture(rotation), 0.05)]))
    }

    fn recognised_print(board: &SquareBoard, distance: f64) -> Option<RecognisedBoard> {
        let raster = board.raster();
        recognised(board.bounds(), distance, |x, y| if raster.is_dark_at([x, y]) { 0.1 } else { 0.9 })
    }

    #[test]
    fn boards_of_every_kind_are_recognised() {
        for (text, distance) in [
            ("checkerboard:6x9:30mm", 1.6),
            ("checkerboard:4x5:30mm", 1.6),
            ("aprilgrid:4x5:30mm:0.3", 1.6),
            ("aprilgrid:4x5:30mm:0.3:border1", 1.6),
            ("apriltags:3x4:30mm:0.25", 1.6),
            ("apriltags:3x4:30mm:0.25:down", 1.6),
            // Tags upright and numbered from the top row, tags drawn by OpenCV in Kalibr's order, and sheets that were turned
            // before the tags were numbered.
            ("apriltags:3x4:30mm:0.25:down:turned180", 1.6),
            ("aprilgrid:4x5:30mm:0.3:turned180", 1.6),
            ("aprilgrid:4x5:30mm:0.3:first7:turned90", 1.6),
            ("apriltags:3x4:30mm:0.25:down:turned270", 1.6),
            ("apriltags:3x4:30mm:0.25:DICT_5X5_50:turned180", 1.6),
            ("apriltags:3x4:30mm:0.25:25h9", 1.6),
            ("charuco:5x7:30mm:22mm:DICT_5X5_50", 1.6),
            ("charuco:4x6:30mm:22mm:DICT_4X4_50:legacy", 1.6),
            // A module of 1.5 pixels.
            ("charuco:8x11:30mm:22mm:DICT_6X6_50", 2.0),
            ("charuco:7x7:30mm:22mm:DICT_APRILTAG_36h11", 2.0),
        ] {
            let board: SquareBoard = text.parse().unwrap();
            let found = recognised_print(&board, distance).unwrap_or_else(|| panic!("{text} is not recognised"));
            // The size of markers is measured, so it is not exact.
            let measured = match (found.board, board) {
                (SquareBoard::Charuco(found), SquareBoard::Charuco(board)) => {
                    assert!((found.marker - board.marker).abs() < 0.002, "{text}: {}", found.marker);
                    SquareBoard::Charuco(Charuco { marker: board.marker, ..found })
                }
                (found, _) => found,
            };
            assert_eq!(measured.to_string(), board.to_string());
            assert!(!found.has_unknown_markers, "{text}");
        }
    }

    /// A mirrored ChArUco board was called a checkerboard, with which the camera is calibrated as its mirror image.
    #[test]
    fn mirror_images_of_tags_and_markers_are_noticed() {
        for text in ["charuco:5x7:30mm:22mm:DICT_5X5_50", "apriltags:3x4:30mm:0.25"] {
            let board: SquareBoard = text.parse().unwrap();
            let (bounds, raster) = (board.bounds(), board.raster());
            let brightness =
                |x: f64, y: f64| if raster.is_dark_at([bounds.low[0] + bounds.high[0] - x, y]) { 0.1 } else { 0.9 };
            let found = recognised(bounds, 1.6, brightness).unwrap_or_else(|| panic!("{text} is not recognised"));
            assert!(found.is_mirrored, "{text}: {found:?}");
            assert_eq!(std::mem::discriminant(&found.board), std::mem::discriminant(&board), "{text}: {found:?}");
        }
    }

    #[test]
    fn unknown_markers_in_a_checkerboard_are_noticed() {
        let board: SquareBoard = "checkerboard:4x6:1m".parse().unwrap();
        let raster = board.raster();
        // Tags of a known family, but in reverse order.
        let squares = (0..5).flat_map(|row| (0..7).map(move |column| (row, column)));
        let light = squares.filter(|(row, column)| (row + column) % 2 == 1);
        let tags: Vec<Tag> = light
            .zip(0..)
            .map(|((row, column), id)| tag(23 - id, 1, column as f64 - 0.85, row as f64 - 0.85, 0.7))
            .collect();
        let brightness = |x: f64, y: f64| {
            let in_tag = |tag: &Tag| {
                let [u, v] = [(x - tag.corners[0][0]) / 0.7, (y - tag.corners[0][1]) / 0.7];
                (0.0..1.0).contains(&u) && (0.0..1.0).contains(&v) && is_dark(tag, u, v)
            };
            if raster.is_dark_at([x, y]) || tags.iter().any(in_tag) { 0.1 } else { 0.9 }
        };
        let found = recognised(board.bounds(), 1.6, brightness).unwrap();
        assert_eq!(found.board.to_string(), "checkerboard:4x6:30mm");
        assert!(found.has_unknown_markers);
    }

    #[test]
    fn other_patterns_are_not_recognised() {
        let bounds = Rectangle { low: [0.0; 2], high: [10.0, 7.0] };
        let inside = |x: f64, y: f64| (0.0..10.0).contains(&x) && (0.0..7.0).contains(&y);
        let dots = |x: f64, y: f64| {
            let is_dot = inside(x, y) && (x.fract() - 0.5).hypot(y.fract() - 0.5) < 0.3;
            if is_dot { 0.1 } else { 0.9 }
        };
        assert_eq!(recognised(bounds, 1.6, dots), None);
        let grey = |_, _| 0.5;
        assert_eq!(recognised(bounds, 1.6, grey), None);
        assert_eq!(recognise(&[]), None);
    }

    /// The QR code on a printed sheet is about as large as a tag of some boards.
    #[test]
    fn the_code_on_a_sheet_is_not_taken_for_a_tag() {
        for (text, paper) in [
            ("checkerboard:6x9:22mm", "a4"),
            ("aprilgrid:3x4:33mm:0.3", "a4"),
            ("apriltags:4x6:25mm:0.25", "a4"),
            ("charuco:5x7:30mm:22mm:DICT_5X5_50", "a4"),
            ("aprilgrid:6x6:32mm:0.3", "a3"),
        ] {
            let board: SquareBoard = text.parse().unwrap();
            let page = Page { paper: paper.parse().unwrap(), margin: 10.0, typed: "--board " };
            let sheet = board_sheet(&Board::Squares(board), &page).unwrap();
            assert!(!sheet.code.is_empty());
            let metres = |at: [f64; 2]| at.map(|value| 1e-3 * value);
            let dark = sheet.rectangles.iter().chain(&sheet.code);
            let dark: Vec<Rectangle> =
                dark.map(|dark| Rectangle { low: metres(dark.low), high: metres(dark.high) }).collect();
            let raster = Raster::of_dark(&dark);
            let bounds = Rectangle { low: [0.0; 2], high: metres(sheet.size) };
            let found = recognised(bounds, 1.3, |x, y| if raster.is_dark_at([x, y]) { 0.1 } else { 0.9 });
            let found = found.unwrap_or_else(|| panic!("{text} is not recognised"));
            assert_eq!(found.fitting, found.moments, "{text}");
            let found = found.board.with_length(match board {
                SquareBoard::Checkerboard(board) => board.square,
                SquareBoard::Tags(grid) => grid.tag,
                SquareBoard::Charuco(board) => board.square,
            });
            let kind = |board: &SquareBoard| match board {
                // The size of markers is measured.
                SquareBoard::Charuco(board) => format!("{} {} {}", board.rows, board.columns, board.dictionary),
                others => others.to_string(),
            };
            assert_eq!(kind(&found), kind(&board));
        }
    }
}

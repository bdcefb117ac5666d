//! Text form of boards of squares.

use std::fmt;
use std::str::FromStr;

use super::family::Dictionary;
use super::{Charuco, CharucoLayout, Checkerboard, Shade, SquareBoard, TagGrid, TagOrder};
use crate::board::circles::{length, millimetres};

/// Reason why the description of a board of squares was rejected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("board {text:?}: {problem}; write {form}")]
pub struct SquareBoardError {
    text: String,
    form: &'static str,
    /// The problem.
    pub problem: SquareBoardProblem,
}

/// Problems of the description of a board of squares.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum SquareBoardProblem {
    /// The kind of board is unknown.
    #[error("{0:?} is not a kind of board of squares")]
    Kind(String),
    /// A kind of board under the name that another program uses.
    #[error("{given} is called {kind} here")]
    OtherName {
        /// The name as given.
        given: String,
        /// Its name in evcal.
        kind: &'static str,
    },
    /// A part is missing.
    #[error("the {0} is missing")]
    Missing(&'static str),
    /// Rows and columns cannot be read.
    #[error("{given:?} is not ROWSxCOLUMNS with numbers from {least} to 64")]
    Size {
        /// The part.
        given: String,
        /// The least number.
        least: u8,
    },
    /// A length cannot be read.
    #[error("{name} {given:?} is not a length with a unit, from 0.001mm to 10m")]
    Length {
        /// Name of the length.
        name: &'static str,
        /// The part.
        given: String,
    },
    /// The spacing cannot be read.
    #[error("spacing {0:?} is not a number from 0.01 to 4: the gap between two tags divided by the size of a tag")]
    Spacing(String),
    /// The spacing is a length instead of a ratio to the tag.
    #[error("the spacing is the gap divided by the size of a tag, here {0}")]
    Gap(String),
    /// The tags do not fit into the squares.
    #[error("the markers do not fit into the squares: the square comes first, then the smaller marker")]
    Marker,
    /// No dictionary has this name.
    #[error("unknown dictionary {0:?}; known are {known}", known = dictionary_names())]
    Dictionary(String),
    /// The dictionary has fewer tags than the board.
    #[error("the board needs {needed} tags, {dictionary} has {has}")]
    TooFewTags {
        /// Number of tags of the board plus the ids before its first.
        needed: usize,
        /// The dictionary.
        dictionary: Dictionary,
        /// Number of tags in the dictionary.
        has: u16,
    },
    /// A part that this kind of board does not have.
    #[error("{0:?} is not a part of this kind of board")]
    Part(String),
}

fn dictionary_names() -> String {
    Dictionary::all().map(|dictionary| dictionary.to_string()).collect::<Vec<_>>().join(", ")
}

const CHECKERBOARD: &str = "checkerboard";
const APRILGRID: &str = "aprilgrid";
const APRILTAGS: &str = "apriltags";
const CHARUCO: &str = "charuco";

const CHECKERBOARD_FORM: &str = "checkerboard:ROWSxCOLUMNS:SQUARE with the numbers of inner corners, for example \
     checkerboard:6x9:25mm; append :light if the square at the top left is white";
const APRILGRID_FORM: &str = "aprilgrid:ROWSxCOLUMNS:TAG:SPACING with the size of a tag and the gap divided by it, for example \
     aprilgrid:6x6:35.2mm:0.3; append :border1, :25h9, :first36, :down or :turned180 for one with another border, family, \
     first id, with rows numbered downwards, or with each tag rotated";
const APRILTAGS_FORM: &str = "apriltags:ROWSxCOLUMNS:TAG:SPACING with the size of a tag and the gap divided by it, for example \
     apriltags:3x4:30mm:0.25; append :border2, :25h9, :first36, :down or :turned180 for one with another border, family, \
     first id, with rows numbered downwards, or with each tag rotated";
const CHARUCO_FORM: &str = "charuco:ROWSxCOLUMNS:SQUARE:MARKER:DICTIONARY with the numbers of squares (OpenCV states the columns \
     first), for example charuco:5x7:30mm:22mm:DICT_5X5_100; append :legacy for a board with an even number of rows from OpenCV \
     before 4.6";
const ANY_FORM: &str = "for example checkerboard:6x9:25mm (inner corners), aprilgrid:6x6:35.2mm:0.3, apriltags:3x4:30mm:0.25 or \
     charuco:5x7:30mm:22mm:DICT_5X5_100";

/// Parts of other programs' names of boards, in lower case without punctuation, with the name in evcal.
const OTHER_NAMES: [(&str, &str); 7] = [
    ("charuco", CHARUCO),
    ("check", CHECKERBOARD),
    ("chess", CHECKERBOARD),
    ("aprilgrid", APRILGRID),
    ("april", APRILTAGS),
    ("aruco", APRILTAGS),
    ("tag", APRILTAGS),
];

/// Returns the kind of board in the first part of a description, under evcal's or another program's name; `None` for
/// boards of circles and everything else.
fn kind_of(given: &str) -> Option<&'static str> {
    let bare: String = given.to_lowercase().chars().filter(|letter| letter.is_alphabetic()).collect();
    OTHER_NAMES.iter().find(|(name, _)| bare.contains(name)).map(|(_, kind)| *kind)
}

/// Returns `true` if the first part of `text` names a kind of board of squares, by any program's name.
pub fn names_squares(text: &str) -> bool {
    text.split(':').next().is_some_and(|given| kind_of(given).is_some())
}

/// The parts of a description after the kind.
struct Parts<'a>(std::str::Split<'a, char>);

impl<'a> Parts<'a> {
    fn next(&mut self, name: &'static str) -> Result<&'a str, SquareBoardProblem> {
        self.0.next().ok_or(SquareBoardProblem::Missing(name))
    }

    fn size(&mut self, least: u8) -> Result<[u8; 2], SquareBoardProblem> {
        let given = self.next("number of rows and columns")?;
        let count = |part: &str| part.parse::<u8>().ok().filter(|count| (least..=64).contains(count));
        let size = given.split_once('x').and_then(|(rows, columns)| Some([count(rows)?, count(columns)?]));
        size.ok_or_else(|| SquareBoardProblem::Size { given: given.to_owned(), least })
    }

    fn length(&mut self, name: &'static str) -> Result<f64, SquareBoardProblem> {
        let given = self.next(name)?;
        length(given).ok_or_else(|| SquareBoardProblem::Length { name, given: given.to_owned() })
    }

    /// Parses the spacing of tags of the size `tag` (m).
    fn spacing(&mut self, tag: f64) -> Result<f64, SquareBoardProblem> {
        let given = self.next("spacing")?;
        let ratio = given.parse::<f64>().ok().filter(|ratio| SPACINGS.contains(ratio));
        ratio.ok_or_else(|| match length(given) {
            Some(gap) => SquareBoardProblem::Gap(format!("{:.4}", gap / tag)),
            None => SquareBoardProblem::Spacing(given.to_owned()),
        })
    }
}

/// Range of the ratio of gap to tag.
pub(super) const SPACINGS: std::ops::RangeInclusive<f64> = 0.01..=4.0;

fn checkerboard(mut parts: Parts<'_>) -> Result<SquareBoard, SquareBoardProblem> {
    let [rows, columns] = parts.size(2)?;
    let mut board = Checkerboard { rows, columns, square: parts.length("size of a square")?, first: Shade::Dark };
    for part in parts.0 {
        board.first = match part {
            "light" => Shade::Light,
            "dark" => Shade::Dark,
            _ => return Err(SquareBoardProblem::Part(part.to_owned())),
        };
    }
    Ok(SquareBoard::Checkerboard(board))
}

/// Returns the usual border of tags in modules, for a grid with or without corner squares.
const fn usual_border(corner_squares: bool) -> u8 {
    if corner_squares { 2 } else { 1 }
}

fn tags(mut parts: Parts<'_>, corner_squares: bool) -> Result<SquareBoard, SquareBoardProblem> {
    let [rows, columns] = parts.size(1)?;
    let tag = parts.length("size of a tag")?;
    let mut grid = TagGrid {
        rows,
        columns,
        tag,
        spacing: parts.spacing(tag)?,
        corner_squares,
        dictionary: Dictionary::APRIL_36H11,
        border: usual_border(corner_squares),
        first_id: 0,
        order: TagOrder::Upwards,
        turn: 0,
    };
    for part in parts.0 {
        match part {
            "border1" => grid.border = 1,
            "border2" => grid.border = 2,
            "up" => grid.order = TagOrder::Upwards,
            "down" => grid.order = TagOrder::Downwards,
            "turned90" => grid.turn = 1,
            "turned180" => grid.turn = 2,
            "turned270" => grid.turn = 3,
            _ => match (part.strip_prefix("first").map(str::parse), part.parse()) {
                (Some(Ok(first)), _) => grid.first_id = first,
                (_, Ok(dictionary)) => grid.dictionary = dictionary,
                _ => return Err(SquareBoardProblem::Part(part.to_owned())),
            },
        }
    }
    let needed = usize::from(grid.first_id) + usize::from(rows) * usize::from(columns);
    enough(needed, grid.dictionary)?;
    Ok(SquareBoard::Tags(grid))
}

fn charuco(mut parts: Parts<'_>) -> Result<SquareBoard, SquareBoardProblem> {
    let [rows, columns] = parts.size(3)?;
    let (square, marker) = (parts.length("size of a square")?, parts.length("size of a marker")?);
    if marker >= square {
        return Err(SquareBoardProblem::Marker);
    }
    let name = parts.next("dictionary")?;
    let dictionary = name.parse().map_err(|_| SquareBoardProblem::Dictionary(name.to_owned()))?;
    let mut board = Charuco { rows, columns, square, marker, dictionary, layout: CharucoLayout::Current };
    for part in parts.0 {
        board.layout = match part {
            "legacy" => CharucoLayout::Legacy,
            "current" => CharucoLayout::Current,
            _ => return Err(SquareBoardProblem::Part(part.to_owned())),
        };
    }
    enough(board.tag_count(), dictionary)?;
    Ok(SquareBoard::Charuco(board))
}

pub(super) fn enough(needed: usize, dictionary: Dictionary) -> Result<(), SquareBoardProblem> {
    match needed <= usize::from(dictionary.tags) {
        true => Ok(()),
        false => Err(SquareBoardProblem::TooFewTags { needed, dictionary, has: dictionary.tags }),
    }
}

impl FromStr for SquareBoard {
    type Err = SquareBoardError;

    fn from_str(text: &str) -> Result<Self, SquareBoardError> {
        let mut parts = text.split(':');
        let given = parts.next().unwrap_or_default();
        let parts = Parts(parts);
        let (form, board) = match given {
            CHECKERBOARD => (CHECKERBOARD_FORM, checkerboard(parts)),
            APRILGRID => (APRILGRID_FORM, tags(parts, true)),
            APRILTAGS => (APRILTAGS_FORM, tags(parts, false)),
            CHARUCO => (CHARUCO_FORM, charuco(parts)),
            _ => match kind_of(given) {
                Some(kind) => (form_of(kind), Err(SquareBoardProblem::OtherName { given: given.to_owned(), kind })),
                None => (ANY_FORM, Err(SquareBoardProblem::Kind(given.to_owned()))),
            },
        };
        board.map_err(|problem| SquareBoardError { text: text.to_owned(), form, problem })
    }
}

fn form_of(kind: &str) -> &'static str {
    match kind {
        CHECKERBOARD => CHECKERBOARD_FORM,
        APRILGRID => APRILGRID_FORM,
        APRILTAGS => APRILTAGS_FORM,
        _ => CHARUCO_FORM,
    }
}

impl fmt::Display for SquareBoard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Checkerboard(board) => board.fmt(f),
            Self::Tags(grid) => grid.fmt(f),
            Self::Charuco(board) => board.fmt(f),
        }
    }
}

impl fmt::Display for Checkerboard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{CHECKERBOARD}:{}x{}:{}mm", self.rows, self.columns, millimetres(self.square))?;
        match self.first {
            Shade::Dark => Ok(()),
            Shade::Light => f.write_str(":light"),
        }
    }
}

impl fmt::Display for TagGrid {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kind = if self.corner_squares { APRILGRID } else { APRILTAGS };
        write!(f, "{kind}:{}x{}:{}mm:{}", self.rows, self.columns, millimetres(self.tag), self.spacing)?;
        if self.dictionary != Dictionary::APRIL_36H11 {
            match self.dictionary.april_name() {
                Some(name) => write!(f, ":{name}")?,
                None => write!(f, ":{}", self.dictionary)?,
            }
        }
        if self.border != usual_border(self.corner_squares) {
            write!(f, ":border{}", self.border)?;
        }
        if self.first_id != 0 {
            write!(f, ":first{}", self.first_id)?;
        }
        if self.order == TagOrder::Downwards {
            f.write_str(":down")?;
        }
        match self.turn % 4 {
            0 => Ok(()),
            quarters => write!(f, ":turned{}", 90 * u16::from(quarters)),
        }
    }
}

impl fmt::Display for Charuco {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (square, marker) = (millimetres(self.square), millimetres(self.marker));
        write!(f, "{CHARUCO}:{}x{}:{square}mm:{marker}mm:{}", self.rows, self.columns, self.dictionary)?;
        match self.layout {
            CharucoLayout::Current => Ok(()),
            CharucoLayout::Legacy => f.write_str(":legacy"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boards_survive_a_round_trip() {
        for text in [
            "checkerboard:6x9:25mm",
            "checkerboard:7x7:25.4mm:light",
            "aprilgrid:6x6:35.2mm:0.3",
            "aprilgrid:5x7:20mm:0.25:25h9:border1:down",
            "apriltags:3x4:30mm:0.25",
            "apriltags:1x2:100mm:1.5:16h5:border2:first7",
            "apriltags:3x4:30mm:0.25:DICT_6X6_250:down",
            "apriltags:3x4:30mm:0.25:down:turned180",
            "aprilgrid:6x6:35.2mm:0.3:border1:first36:turned270",
            "charuco:5x7:30mm:22mm:DICT_5X5_100",
            "charuco:8x11:24mm:18mm:DICT_APRILTAG_36h11:legacy",
            "charuco:10x10:24mm:18mm:DICT_ARUCO_ORIGINAL",
        ] {
            let board: SquareBoard = text.parse().unwrap();
            assert_eq!(board.to_string(), text);
            assert_eq!(board.to_string().parse(), Ok(board));
        }
        let short: SquareBoard = "aprilgrid:6x6:3.52cm:.30:tag36h11:border2:first0:up".parse().unwrap();
        assert_eq!(short.to_string(), "aprilgrid:6x6:35.2mm:0.3");
    }

    #[test]
    fn missing_parts_have_their_usual_values() {
        let read = |text: &str| match text.parse() {
            Ok(SquareBoard::Tags(grid)) => grid,
            other => panic!("{other:?}"),
        };
        let kalibr = read("aprilgrid:6x7:88mm:0.3");
        assert_eq!((kalibr.rows, kalibr.columns, kalibr.border, kalibr.corner_squares), (6, 7, 2, true));
        assert_eq!((kalibr.dictionary, kalibr.first_id, kalibr.order), (Dictionary::APRIL_36H11, 0, TagOrder::Upwards));
        assert!((kalibr.tag - 0.088).abs() < 1e-15 && kalibr.spacing == 0.3);
        let plain = read("apriltags:3x4:30mm:0.25");
        assert_eq!((plain.border, plain.corner_squares), (1, false));
    }

    #[test]
    fn each_mistake_has_its_message_and_the_form_to_write() {
        for (text, problem, form) in [
            ("dots:9x4:55mm", "\"dots\" is not a kind", "charuco:5x7"),
            ("chessboard:6x9:25mm", "chessboard is called checkerboard here", "checkerboard:6x9:25mm"),
            ("Checkerboard:6x9:25mm", "Checkerboard is called checkerboard here", "checkerboard:6x9:25mm"),
            ("april_grid:6x6:35mm:0.3", "april_grid is called aprilgrid here", "aprilgrid:6x6:35.2mm:0.3"),
            ("GridBoard_tags", "is called apriltags here", "apriltags:3x4:30mm:0.25"),
            ("ChArUco:5x7", "ChArUco is called charuco here", "charuco:5x7:30mm"),
            ("checkerboard", "the number of rows and columns is missing", "checkerboard:6x9:25mm"),
            ("checkerboard:6x9", "the size of a square is missing", "checkerboard:6x9:25mm"),
            ("checkerboard:1x9:25mm", "not ROWSxCOLUMNS with numbers from 2 to 64", "checkerboard:6x9:25mm"),
            ("checkerboard:6,9:25mm", "\"6,9\" is not ROWSxCOLUMNS", "checkerboard:6x9:25mm"),
            ("checkerboard:6x9:25", "size of a square \"25\" is not a length", "checkerboard:6x9:25mm"),
            ("checkerboard:6x9:25mm:r5mm", "\"r5mm\" is not a part", "checkerboard:6x9:25mm"),
            ("aprilgrid:6x6:35.2mm", "the spacing is missing", "aprilgrid:6x6:35.2mm:0.3"),
            ("aprilgrid:6x6:35.2mm:30", "spacing \"30\" is not a number", "aprilgrid:6x6:35.2mm:0.3"),
            ("aprilgrid:6x6:35.2mm:nan", "spacing \"nan\" is not a number", "aprilgrid:6x6:35.2mm:0.3"),
            ("aprilgrid:6x6:35.2mm:10.56mm", "here 0.3000", "aprilgrid:6x6:35.2mm:0.3"),
            ("aprilgrid:6x6:35.2mm:0.3:border3", "\"border3\" is not a part", "aprilgrid:6x6:35.2mm:0.3"),
            ("aprilgrid:6x6:35.2mm:0.3:25h9", "needs 36 tags, DICT_APRILTAG_25h9 has 35", "aprilgrid:6x6:35.2mm:0.3"),
            ("apriltags:3x4:30mm:0.25:first576", "needs 588 tags", "apriltags:3x4:30mm:0.25"),
            ("apriltags:3x4:30mm:0.25:first99999", "\"first99999\" is not a part", "apriltags:3x4:30mm:0.25"),
            ("charuco:5x7:22mm:30mm:DICT_5X5_100", "the markers do not fit", "charuco:5x7:30mm:22mm"),
            ("charuco:5x7:30mm:22mm", "the dictionary is missing", "charuco:5x7:30mm:22mm"),
            (
                "charuco:5x7:30mm:22mm:DICT_9X9_50",
                "unknown dictionary \"DICT_9X9_50\"; known are DICT_4X4_50",
                "charuco:5x7",
            ),
            ("charuco:15x15:30mm:22mm:DICT_5X5_100", "needs 112 tags, DICT_5X5_100 has 100", "charuco:5x7"),
        ] {
            let message = text.parse::<SquareBoard>().unwrap_err().to_string();
            let (before, after) = message.split_once("; write ").unwrap();
            assert!(before.contains(problem), "{message}");
            assert!(after.contains(form), "{message}");
        }
    }

    #[test]
    fn boards_of_squares_are_recognised_by_their_first_part() {
        for text in
            ["checkerboard", "chessboard:6x9", "aprilgrid:6x6:24mm:0.3", "ChArUco:5x7", "tags:1x1", "april_6x6.yaml"]
        {
            assert!(names_squares(text), "{text}");
        }
        for text in ["acircles:9x4:55mm:r17.5mm", "circles:5x4", "auto", "", "target.yaml"] {
            assert!(!names_squares(text), "{text}");
        }
    }
}

//! Kalibr's target files: YAML of the target types `aprilgrid`, `checkerboard` and `circlegrid`.

use std::fmt;
use std::fs::File;
use std::io::Read;
use std::path::Path;

use evcal_core::pattern::{Layout, Pattern};
use evcal_files::yaml::{self, LoadError};
use yaml_rust2::Yaml;

use super::family::Dictionary;
use super::text::{SPACINGS, enough};
use super::{Checkerboard, Shade, SquareBoard, SquareBoardProblem, TagGrid, TagOrder};
use crate::board::circles::{LENGTHS, millimetres};
use crate::board::layout_name;

/// Largest size of a file in bytes.
const LARGEST: usize = 1 << 16;

/// Smallest ratio of gap to tag in a target file. With a smaller one, the squares at the corners of tags could not be printed.
const LEAST_SPACING: f64 = 0.05;

/// The board in a target file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Target {
    /// `aprilgrid`, with corner squares and a border of two modules, or `checkerboard`.
    Squares(SquareBoard),
    /// `circlegrid`.
    Circles(CircleTarget),
}

/// A grid of circles without their radius, which target files do not contain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleTarget {
    /// Arrangement and number of the circles.
    pub pattern: Pattern,
    /// Lattice spacing in metres. Kalibr's `spacingMeters` equals OpenCV's: on an asymmetric grid, half the distance of
    /// neighbours in a row.
    pub spacing: f64,
}

/// Formats the description of the board without its radius, such as `acircles:9x4:55mm`.
impl fmt::Display for CircleTarget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}mm", layout_name(&self.pattern), millimetres(self.spacing))
    }
}

/// Reason why a file is not a target file of Kalibr.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {problem}")]
pub struct TargetFileError {
    file: String,
    /// The problem.
    pub problem: TargetProblem,
}

/// Problems of a target file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum TargetProblem {
    /// The file could not be read.
    #[error("{0}")]
    Read(#[from] std::io::Error),
    /// The text is not YAML, or too large for such a file.
    #[error("it is not a target file of Kalibr: {0}")]
    Yaml(#[from] LoadError),
    /// It has no target type.
    #[error("it is not a target file of Kalibr: it has no target_type")]
    NoTarget,
    /// The target type is not known.
    #[error("target_type {0:?} is unknown; supported are aprilgrid, checkerboard and circlegrid")]
    Type(String),
    /// A value is missing.
    #[error("{0} is missing")]
    Missing(&'static str),
    /// A value is out of range.
    #[error("{key} is {given}; it must be {range}")]
    Value {
        /// Its key in the file.
        key: &'static str,
        /// The value in the file.
        given: String,
        /// Its range.
        range: String,
    },
    /// The fields of the checkerboard are not square.
    #[error(
        "rowSpacingMeters is {row} and colSpacingMeters is {column}: only checkerboards of squares can be used, for which both are equal"
    )]
    NotSquare {
        /// Spacing of the rows in metres.
        row: f64,
        /// Spacing of the columns in metres.
        column: f64,
    },
    /// The spacing of the tags is too small for a ratio.
    #[error(
        "tagSpacing is {given}; is that the gap between two tags in metres? It must be the gap divided by tagSize: {ratio:.4} if the gap is {given} m"
    )]
    GapInMetres {
        /// The value in the file.
        given: f64,
        /// The ratio, if it is a gap in metres.
        ratio: f64,
    },
    /// The board needs more tags than the dictionary has.
    #[error("{0}")]
    Tags(SquareBoardProblem),
}

/// Reads a target file.
///
/// # Errors
/// [`TargetFileError`].
pub fn read(path: &Path) -> Result<Target, TargetFileError> {
    let text = || {
        let mut text = String::new();
        // Reading one byte more than allowed shows that the file is too long.
        File::open(path)?.take(LARGEST as u64 + 1).read_to_string(&mut text)?;
        parse(&text)
    };
    text().map_err(|problem| TargetFileError { file: path.display().to_string(), problem })
}

/// Reads the target in the text of a file.
///
/// # Errors
/// [`TargetProblem`].
pub fn parse(text: &str) -> Result<Target, TargetProblem> {
    let documents = yaml::load(text, LARGEST)?;
    let document = documents.first().ok_or(TargetProblem::NoTarget)?;
    match document["target_type"].as_str() {
        Some("aprilgrid") => aprilgrid(document).map(Target::Squares),
        Some("checkerboard") => checkerboard(document).map(Target::Squares),
        Some("circlegrid") => circles(document).map(Target::Circles),
        Some(other) => Err(TargetProblem::Type(other.to_owned())),
        None => Err(TargetProblem::NoTarget),
    }
}

fn aprilgrid(document: &Yaml) -> Result<SquareBoard, TargetProblem> {
    let tag = length(document, "tagSize")?;
    let spacing = number(document, "tagSpacing", SPACINGS, "the gap between two tags divided by the size of a tag")?;
    if spacing < LEAST_SPACING {
        return Err(TargetProblem::GapInMetres { given: spacing, ratio: spacing / tag });
    }
    let first_id = match &document["codeOffset"] {
        Yaml::BadValue => 0,
        value => {
            let id = value.as_i64().and_then(|id| u16::try_from(id).ok());
            id.ok_or_else(|| wrong("codeOffset", value, "the number of the first tag, from 0 on".to_owned()))?
        }
    };
    let grid = TagGrid {
        rows: count(document, "tagRows", 1)?,
        columns: count(document, "tagCols", 1)?,
        tag,
        spacing,
        corner_squares: true,
        dictionary: Dictionary::APRIL_36H11,
        border: 2,
        first_id,
        order: TagOrder::Upwards,
        turn: 0,
    };
    let needed = usize::from(first_id) + usize::from(grid.rows) * usize::from(grid.columns);
    enough(needed, grid.dictionary).map_err(TargetProblem::Tags)?;
    Ok(SquareBoard::Tags(grid))
}

fn checkerboard(document: &Yaml) -> Result<SquareBoard, TargetProblem> {
    let (rows, columns) = (count(document, "targetRows", 2)?, count(document, "targetCols", 2)?);
    let (row, column) = (length(document, "rowSpacingMeters")?, length(document, "colSpacingMeters")?);
    if row != column {
        return Err(TargetProblem::NotSquare { row, column });
    }
    // Kalibr prints a dark square at the bottom left.
    let first = if rows % 2 == 1 && columns % 2 == 1 { Shade::Light } else { Shade::Dark };
    Ok(SquareBoard::Checkerboard(Checkerboard { rows, columns, square: row, first }))
}

fn circles(document: &Yaml) -> Result<CircleTarget, TargetProblem> {
    let is_asymmetric = match &document["asymmetricGrid"] {
        Yaml::BadValue => Err(TargetProblem::Missing("asymmetricGrid")),
        Yaml::Boolean(is_asymmetric) => Ok(*is_asymmetric),
        // Python's YAML accepts these as well.
        Yaml::String(text) if ["true", "yes", "on"].contains(&text.to_lowercase().as_str()) => Ok(true),
        Yaml::String(text) if ["false", "no", "off"].contains(&text.to_lowercase().as_str()) => Ok(false),
        other => Err(wrong("asymmetricGrid", other, "True or False".to_owned())),
    }?;
    Ok(CircleTarget {
        pattern: Pattern {
            layout: if is_asymmetric { Layout::Asymmetric } else { Layout::Symmetric },
            rows: count(document, "targetRows", 2)?,
            columns: count(document, "targetCols", 2)?,
        },
        spacing: length(document, "spacingMeters")?,
    })
}

fn count(document: &Yaml, key: &'static str, least: u8) -> Result<u8, TargetProblem> {
    let value = present(document, key)?;
    let count = value.as_i64().and_then(|count| u8::try_from(count).ok()).filter(|count| (least..=64).contains(count));
    count.ok_or_else(|| wrong(key, value, format!("a number from {least} to 64")))
}

fn length(document: &Yaml, key: &'static str) -> Result<f64, TargetProblem> {
    number(document, key, LENGTHS, "metres")
}

fn number(
    document: &Yaml,
    key: &'static str,
    range: std::ops::RangeInclusive<f64>,
    meaning: &str,
) -> Result<f64, TargetProblem> {
    let value = present(document, key)?;
    let given =
        value.as_f64().or_else(|| value.as_i64().map(|whole| whole as f64)).filter(|value| range.contains(value));
    given.ok_or_else(|| wrong(key, value, format!("a number from {} to {}, {meaning}", range.start(), range.end())))
}

fn present<'a>(document: &'a Yaml, key: &'static str) -> Result<&'a Yaml, TargetProblem> {
    Some(&document[key]).filter(|value| !value.is_badvalue()).ok_or(TargetProblem::Missing(key))
}

fn wrong(key: &'static str, given: &Yaml, range: String) -> TargetProblem {
    let given = match given {
        Yaml::String(text) | Yaml::Real(text) => text.chars().take(40).collect(),
        Yaml::Integer(whole) => whole.to_string(),
        Yaml::Boolean(truth) => truth.to_string(),
        _ => "not a single value".to_owned(),
    };
    TargetProblem::Value { key, given, range }
}

#[cfg(test)]
mod tests {
    use super::*;

    const APRILGRID: &str = "target_type: 'aprilgrid' #gridtype
tagCols: 6               #number of apriltags
tagRows: 7               #number of apriltags
tagSize: 0.088           #size of apriltag, edge to edge [m]
tagSpacing: 0.3          #ratio of space between tags to tagSize
";
    const CHECKERBOARD: &str = "target_type: 'checkerboard' #gridtype
targetCols: 6               #number of internal chessboard corners
targetRows: 7               #number of internal chessboard corners
rowSpacingMeters: 0.06      #size of one chessboard square [m]
colSpacingMeters: 0.06      #size of one chessboard square [m]
";
    const CIRCLEGRID: &str = "target_type: 'circlegrid' #gridtype
targetCols: 4               #number of circles (cols)
targetRows: 11              #number of circles (rows)
spacingMeters: 0.02         #distance between circles [m]
asymmetricGrid: True        #use asymmetric grid (opencv) [bool]
";

    fn squares(text: &str) -> String {
        match parse(text) {
            Ok(Target::Squares(board)) => board.to_string(),
            other => panic!("{other:?}"),
        }
    }

    fn circle_target(text: &str) -> CircleTarget {
        match parse(text) {
            Ok(Target::Circles(target)) => target,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn the_targets_of_kalibrs_documentation_are_read() {
        assert_eq!(squares(APRILGRID), "aprilgrid:7x6:88mm:0.3");
        assert_eq!(squares(CHECKERBOARD), "checkerboard:7x6:60mm");
        assert_eq!(circle_target(CIRCLEGRID).to_string(), "acircles:11x4:20mm");
        let symmetric = CIRCLEGRID.replace("True", "False");
        assert_eq!(circle_target(&symmetric).to_string(), "circles:11x4:20mm");
        assert_eq!(circle_target(&symmetric.replace("False", "no")).to_string(), "circles:11x4:20mm");
        assert_eq!(squares(&APRILGRID.replace("0.088", "1")), "aprilgrid:7x6:1000mm:0.3");
        // Kalibr's readers of other tags than the first ones of the family.
        assert_eq!(squares(&format!("{APRILGRID}codeOffset: 48\n")), "aprilgrid:7x6:88mm:0.3:first48");
    }

    /// Kalibr's asymmetric grid: circle (r, c) at x = (2 c + r mod 2) spacing, y = r spacing.
    #[test]
    fn circles_are_at_kalibrs_positions() {
        let CircleTarget { pattern, spacing } = circle_target(CIRCLEGRID);
        for r in 0..11_i32 {
            for c in 0..4 {
                assert_eq!(pattern.lattice_position((4 * r + c) as usize), (2 * c + r % 2, r));
            }
        }
        assert_eq!(spacing, 0.02);
    }

    /// `kalibr_create_target_pdf` prints square (x, y), counted from the bottom left, dark where x + y is even.
    #[test]
    fn the_square_at_the_bottom_left_is_dark() {
        for (rows, columns) in [(7, 5), (6, 4), (7, 7), (4, 4)] {
            let text = CHECKERBOARD
                .replace("targetCols: 6", &format!("targetCols: {columns}"))
                .replace("targetRows: 7", &format!("targetRows: {rows}"));
            let Ok(Target::Squares(board)) = parse(&text) else { panic!("{text}") };
            let raster = board.raster();
            assert!(raster.is_dark_at([-0.03, 0.06 * f64::from(rows) - 0.03]), "{board}");
        }
    }

    #[test]
    fn impossible_values_are_named() {
        let error_of = |text: &str| parse(text).unwrap_err().to_string();
        for (text, message) in [
            ("", "it has no target_type"),
            ("cam0: {intrinsics: [1, 2]}", "it has no target_type"),
            ("a: [", "it is not a target file of Kalibr"),
            (&APRILGRID.replace("aprilgrid", "apriltag"), "target_type \"apriltag\" is unknown"),
            (&APRILGRID.replace("tagSize", "size"), "tagSize is missing"),
            (&APRILGRID.replace("tagCols: 6", "tagCols: 6.5"), "tagCols is 6.5; it must be a number from 1 to 64"),
            (&APRILGRID.replace("tagCols: 6", "tagCols: 65"), "tagCols is 65"),
            (&APRILGRID.replace("0.088", "88"), "tagSize is 88; it must be a number from 0.000001 to 10, metres"),
            (&APRILGRID.replace("0.088", ".nan"), "tagSize is .nan"),
            (&APRILGRID.replace("0.3", "30"), "tagSpacing is 30"),
            // The gap in metres: 0.3 of 0.088 m.
            (
                &APRILGRID.replace("0.3", "0.0264"),
                "It must be the gap divided by tagSize: 0.3000 if the gap is 0.0264 m",
            ),
            (&format!("{APRILGRID}codeOffset: 560\n"), "the board needs 602 tags"),
            (&format!("{APRILGRID}codeOffset: -1\n"), "codeOffset is -1"),
            (&APRILGRID.replace("0.3", "[1]"), "tagSpacing is not a single value"),
            (&APRILGRID.replace(": 6 ", ": 64 ").replace(": 7 ", ": 64 "), "the board needs 4096 tags"),
            (&CHECKERBOARD.replace("colSpacingMeters: 0.06", "colSpacingMeters: 0.1"), "only checkerboards of squares"),
            (&CIRCLEGRID.replace("True", "2"), "asymmetricGrid is 2; it must be True or False"),
            (&CIRCLEGRID.replace("asymmetricGrid", "asymmetric"), "asymmetricGrid is missing"),
        ] {
            assert!(error_of(text).contains(message), "{}", error_of(text));
        }
    }

    #[test]
    fn files_are_read_and_named_in_errors() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("april_7x6.yaml");
        std::fs::write(&path, APRILGRID).unwrap();
        assert!(matches!(read(&path), Ok(Target::Squares(SquareBoard::Tags(_)))));
        std::fs::write(&path, "#".repeat(LARGEST + 1)).unwrap();
        assert!(matches!(
            read(&path),
            Err(TargetFileError { problem: TargetProblem::Yaml(LoadError::TooLong(_)), .. })
        ));
        let missing = read(&folder.path().join("none.yaml")).unwrap_err().to_string();
        assert!(missing.contains("none.yaml"), "{missing}");
    }
}

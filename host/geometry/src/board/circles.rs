//! The printed circle grid: parsing of its description, and positions of its circles.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use evcal_core::pattern::{Layout, Pattern};
use evcal_files::remedies;
use nalgebra::Vector2;

use super::Board;

/// A printed circle grid. World coordinates: origin at the first circle, x along a row, y from row
/// to row, z = 0 on the board; a camera in front of it is at z < 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircleBoard {
    /// Arrangement and number of the circles.
    pub pattern: Pattern,
    /// Lattice spacing in metres (OpenCV's convention: on an asymmetric board half the distance of
    /// neighbours in a row).
    pub spacing: f64,
    /// Radius of a circle in metres.
    pub radius: f64,
}

/// The form of a board description, shown with every error.
pub const BOARD_FORM: &str = "LAYOUT:ROWSxCOLUMNS:SPACING:rRADIUS with LAYOUT acircles or circles and lengths in mm, cm, m or in, \
     for example acircles:9x4:55mm:r17.5mm";

/// Reason why a board description was rejected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("board {text:?}: {problem}{}", .problem.form())]
pub struct CircleBoardError {
    /// The description as given.
    pub text: String,
    /// The problem.
    pub problem: BoardProblem,
}

remedies! { CircleBoardError, say;
    Self { problem: BoardProblem::NoCircles(_), .. } => "print one with {}", say.board_pdf?;
    Self { problem: BoardProblem::File, .. } => "give recordings without an option, not with {}", say.board;
}

/// Problem of a board description.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum BoardProblem {
    /// A board that is not made of circles.
    #[error("{0} cannot be used, only boards of circles can")]
    NoCircles(&'static str),
    /// A layout under the name that another program uses.
    #[error("{given} is called {} here", layout_word(*layout))]
    OtherName {
        /// The name as given.
        given: String,
        /// The layout that it means.
        layout: Layout,
        /// The corrected description, if everything else is right.
        meant: Option<String>,
    },
    /// A grid that may have either layout.
    #[error(
        "{0} may be either of two layouts: acircles where every other row is shifted (asymmetricGrid: True in Kalibr), else circles"
    )]
    EitherLayout(String),
    /// The name of a file.
    #[error("looks like a file, not like a description")]
    File,
    /// A part is missing or superfluous.
    #[error("has {0} part(s) between colons, not 4")]
    Parts(usize),
    /// The layout is unknown.
    #[error("unknown layout {0:?}")]
    Layout(String),
    /// Rows and columns cannot be read.
    #[error("{0:?} is not ROWSxCOLUMNS with numbers from 2 to 64")]
    Size(String),
    /// The spacing cannot be read.
    #[error("spacing {0:?} is not a length with a unit, from 0.001mm to 10m")]
    Spacing(String),
    /// The radius cannot be read.
    #[error("radius {0:?} is not r and a length with a unit, from 0.001mm to 10m")]
    Radius(String),
    /// A description of a board to recognise has too many or too few parts.
    #[error("a board to recognise is auto:SIDE for squares, or auto:SPACING:rRADIUS for circles")]
    Auto,
    /// Circles of this radius do not fit into this spacing.
    #[error("the circles overlap: is the radius a diameter?")]
    Overlap,
}

impl BoardProblem {
    /// Returns the correct form as a suffix of the message, if it helps.
    fn form(&self) -> String {
        match self {
            Self::NoCircles(_) => String::new(),
            Self::OtherName { meant: Some(board), .. } => format!("; write {board}"),
            Self::Auto => {
                "; write for example auto:25mm or auto:55mm:r17.5mm, or auto alone to print the kind of board"
                    .to_owned()
            }
            _ => format!("; write {BOARD_FORM}"),
        }
    }
}

/// Other kinds of boards, by parts of their names.
const OTHER_BOARDS: [(&str, &str); 6] = [
    ("check", "a checkerboard"),
    ("chess", "a checkerboard"),
    ("charuco", "a ChArUco board"),
    ("aruco", "a board of ArUco tags"),
    ("april", "a board of AprilTags"),
    ("tag", "a board of tags"),
];

/// Other names of circle grids, in lower case without punctuation: first OpenCV's and ROS's names, then names of
/// shifted grids, then names that do not determine the layout.
const OTHER_NAMES: [(&str, Option<Layout>); 7] = [
    ("asym", Some(Layout::Asymmetric)),
    ("acirc", Some(Layout::Asymmetric)),
    ("circlesa", Some(Layout::Asymmetric)),
    ("symmetric", Some(Layout::Symmetric)),
    ("circlegrid", None),
    ("circlesgrid", None),
    ("circle", Some(Layout::Symmetric)),
];

/// Returns the problem of a board whose first part, `given`, is not a known layout.
fn unknown_layout(given: &str, rest: &str) -> BoardProblem {
    let bare: String = given.to_lowercase().chars().filter(|letter| letter.is_alphabetic()).collect();
    match OTHER_NAMES.iter().find(|(name, _)| bare.contains(name)) {
        Some((_, Some(layout))) => {
            let meant = format!("{}:{rest}", layout_word(*layout));
            let meant = meant.parse::<CircleBoard>().is_ok().then_some(meant);
            BoardProblem::OtherName { given: given.to_owned(), layout: *layout, meant }
        }
        Some((_, None)) => BoardProblem::EitherLayout(given.to_owned()),
        None => BoardProblem::Layout(given.to_owned()),
    }
}

/// Returns the problem of a description that does not have the four `parts` of a board; `known` is the layout in its
/// first part, if there is one.
fn not_four_parts(text: &str, parts: &[&str], known: Option<Layout>) -> BoardProblem {
    let is_alone = parts.len() == 1;
    if is_alone && text.contains('.') {
        return BoardProblem::File;
    }
    let (given, rest) = text.split_once(':').unwrap_or((text, ""));
    match known.is_none().then(|| unknown_layout(given, rest)) {
        None | Some(BoardProblem::Layout(_)) => BoardProblem::Parts(parts.len()),
        Some(other_name) => other_name,
    }
}

impl CircleBoard {
    /// Returns the number of circles on the board.
    pub fn circle_count(&self) -> usize {
        self.pattern.circle_count()
    }

    /// Returns the centre of circle `index` on the board plane, in metres.
    pub fn circle_center(&self, index: usize) -> Vector2<f64> {
        let (x, y) = self.pattern.lattice_position(index);
        Vector2::new(f64::from(x), f64::from(y)) * self.spacing
    }

    /// Returns points on the rim of circle `index` as a closed polyline, in metres.
    pub(super) fn rim(&self, index: usize) -> Vec<Vector2<f64>> {
        const STEPS: usize = 48;
        let center = self.circle_center(index);
        let point = |step: usize| {
            let angle = step as f64 * std::f64::consts::TAU / STEPS as f64;
            center + Vector2::new(angle.cos(), angle.sin()) * self.radius
        };
        (0..=STEPS).map(point).collect()
    }

    /// Returns the circle nearest to `point` (metres on the board plane), if it is within one lattice spacing in x and
    /// y.
    pub fn nearest_circle(&self, point: Vector2<f64>) -> Option<usize> {
        let x = point.x / self.spacing;
        let y = point.y / self.spacing;
        if !(-1.0..=1024.0).contains(&x) || !(-1.0..=1024.0).contains(&y) {
            return None;
        }
        match self.pattern.layout {
            Layout::Symmetric => self.pattern.index_at(x.round() as i32, y.round() as i32),
            Layout::Asymmetric => {
                // Circles exist where x + y is even, which is a square lattice rotated by 45°.
                let diagonal = ((x + y) / 2.0).round();
                let antidiagonal = ((x - y) / 2.0).round();
                self.pattern.index_at((diagonal + antidiagonal) as i32, (diagonal - antidiagonal) as i32)
            }
        }
    }

    /// Returns the distance between neighbouring circle centres, in metres.
    pub fn neighbour_distance(&self) -> f64 {
        match self.pattern.layout {
            Layout::Symmetric => self.spacing,
            Layout::Asymmetric => self.spacing * std::f64::consts::SQRT_2,
        }
    }

    /// Returns the centre of the area that the circles cover, in metres.
    pub fn middle(&self) -> Vector2<f64> {
        Board::Circles(*self).middle()
    }

    /// Returns the lowest and highest coordinates of the circle centres, in metres.
    pub fn extent(&self) -> (Vector2<f64>, Vector2<f64>) {
        Board::Circles(*self).extent()
    }

    /// Returns the longer side of the area that the circle centres cover, in metres.
    pub fn longer_side(&self) -> f64 {
        Board::Circles(*self).longer_side()
    }
}

/// Returns layout, rows and columns in the form `acircles:9x4`.
pub fn layout_name(pattern: &Pattern) -> String {
    format!("{}:{}x{}", layout_word(pattern.layout), pattern.rows, pattern.columns)
}

/// Returns the name of a layout in a board's description.
const fn layout_word(layout: Layout) -> &'static str {
    match layout {
        Layout::Asymmetric => "acircles",
        Layout::Symmetric => "circles",
    }
}

/// Range of lengths in metres. A printed description is rounded to nanometres, so within this range it is read back
/// unchanged. Circles ten metres apart are more likely millimetres written as metres.
pub(super) const LENGTHS: RangeInclusive<f64> = 1e-6..=10.0;

pub(super) fn length(text: &str) -> Option<f64> {
    any_length(text).filter(|metres| LENGTHS.contains(metres))
}

/// Parses a length of either sign with its unit (mm, cm, in or m), in metres; returns `None` if the text is not a
/// length.
pub fn any_length(text: &str) -> Option<f64> {
    // "mm" and "cm" end in "m" too, so the longer units are tried first.
    let (number, factor) = [("mm", 1e-3), ("cm", 1e-2), ("in", 0.0254), ("m", 1.0)]
        .iter()
        .find_map(|(unit, factor)| text.strip_suffix(unit).map(|number| (number, *factor)))?;
    let value: f64 = number.trim().parse().ok()?;
    Some(value * factor).filter(|metres| metres.is_finite())
}

/// Parses the radius in `r17.5mm`, in metres.
pub(super) fn radius_of(text: &str) -> Option<f64> {
    text.strip_prefix('r').and_then(length)
}

/// Converts metres to millimetres, rounded as in descriptions.
pub(super) fn millimetres(metres: f64) -> f64 {
    (metres * 1e9).round() / 1e6
}

impl FromStr for CircleBoard {
    type Err = CircleBoardError;

    fn from_str(text: &str) -> Result<Self, CircleBoardError> {
        let error = |problem| CircleBoardError { text: text.to_owned(), problem };
        let parts: Vec<&str> = text.split(':').collect();
        let name = parts.first().map(|name| name.to_lowercase()).unwrap_or_default();
        if let Some((_, kind)) = OTHER_BOARDS.iter().find(|(part, _)| name.contains(part)) {
            return Err(error(BoardProblem::NoCircles(kind)));
        }
        let (given, rest) = text.split_once(':').unwrap_or((text, ""));
        let known = [Layout::Asymmetric, Layout::Symmetric].into_iter().find(|layout| layout_word(*layout) == given);
        let &[_, size, spacing, radius] = parts.as_slice() else {
            return Err(error(not_four_parts(text, &parts, known)));
        };
        let layout = known.ok_or_else(|| error(unknown_layout(given, rest)))?;
        let count = |part: &str| part.parse::<u8>().ok().filter(|count| (2..=64).contains(count));
        let (rows, columns) = size
            .split_once('x')
            .and_then(|(rows, columns)| Some((count(rows)?, count(columns)?)))
            .ok_or_else(|| error(BoardProblem::Size(size.to_owned())))?;
        let spacing = length(spacing).ok_or_else(|| error(BoardProblem::Spacing(spacing.to_owned())))?;
        let radius = radius_of(radius).ok_or_else(|| error(BoardProblem::Radius(radius.to_owned())))?;
        let board = Self { pattern: Pattern { layout, rows, columns }, spacing, radius };
        if 2.0 * radius >= board.neighbour_distance() {
            return Err(error(BoardProblem::Overlap));
        }
        Ok(board)
    }
}

impl fmt::Display for CircleBoard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (spacing, radius) = (millimetres(self.spacing), millimetres(self.radius));
        write!(f, "{}:{spacing}mm:r{radius}mm", layout_name(&self.pattern))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_documented_form_is_read_and_written_back() {
        let board: CircleBoard = "acircles:9x4:55mm:r17.5mm".parse().unwrap();
        assert_eq!(board.pattern, Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 });
        assert!((board.spacing - 0.055).abs() < 1e-12 && (board.radius - 0.0175).abs() < 1e-12);
        assert_eq!(board.to_string(), "acircles:9x4:55mm:r17.5mm");
        let same: CircleBoard = "acircles:9x4:5.5cm:r0.0175m".parse().unwrap();
        assert_eq!(same.to_string(), board.to_string());
    }

    #[test]
    fn an_error_shows_the_correct_form() {
        for text in [
            "",
            "dots:9x4:55mm:r17mm",
            "acircles:9x4:55:r17mm",
            "acircles:9:55mm:r17mm",
            "acircles:9x4:55mm:17mm",
            "acircles:9x4:55mm:r55mm",
            "acircles:9x4:-5mm:r1mm",
            "circles:1x4:5mm:r1mm",
            "circles:3x4:nanmm:r1mm",
            "circles:3x4:1e-9m:r1e-10m",
            "circles:3x4:1e300m:r1m",
            "acircles:9x4:55m:r17.5m",
        ] {
            let message = text.parse::<CircleBoard>().unwrap_err().to_string();
            assert!(message.contains("acircles:9x4:55mm:r17.5mm"), "{message}");
        }
    }

    #[test]
    fn boards_without_circles_are_rejected() {
        for text in ["checkerboard:9x6:25mm", "chessboard:9x6", "aprilgrid:6x6:24mm:0.3", "ChArUco:5x7:30mm:r22mm"] {
            let message = text.parse::<CircleBoard>().unwrap_err().to_string();
            assert!(message.contains("only boards of circles"), "{message}");
        }
    }

    #[test]
    fn names_of_other_programs_are_recognised() {
        let error = |text: &str| text.parse::<CircleBoard>().unwrap_err().to_string();
        let rest = "9x4:55mm:r17.5mm";
        for name in
            ["asymmetric_circles_grid", "asymmetric_circlegrid", "acirclesgrid", "CirclesA", "ACircles", "acircle"]
        {
            let message = error(&format!("{name}:{rest}"));
            assert!(message.ends_with(&format!("is called acircles here; write acircles:{rest}")), "{message}");
            assert!(error(name).contains("is called acircles here; write LAYOUT:"), "{}", error(name));
        }
        for name in ["symmetric", "Circles"] {
            let message = error(&format!("{name}:{rest}"));
            assert!(message.ends_with(&format!("is called circles here; write circles:{rest}")), "{message}");
        }
        for name in ["circlegrid", "circles_grid"] {
            assert!(error(&format!("{name}:{rest}")).contains("asymmetricGrid: True"), "{name}");
        }
        assert!(error("april_6x6.yaml").contains("only boards of circles"));
        assert!(error("target.yaml").contains("looks like a file"));
        assert!(error("recording.aedat4").contains("looks like a file"));
        assert!(error("dots:9x4:55mm:r17.5mm").contains("unknown layout"));
    }

    #[test]
    fn the_nearest_circle_equals_that_of_an_exhaustive_search() {
        for text in ["acircles:9x4:55mm:r17.5mm", "circles:6x3:40mm:r10mm"] {
            let board: CircleBoard = text.parse().unwrap();
            for step in 0..4000 {
                let point = Vector2::new((step % 63) as f64 * 0.0071 - 0.02, (step / 63) as f64 * 0.0083 - 0.02);
                let (distance, nearest) = (0..board.circle_count())
                    .map(|index| ((board.circle_center(index) - point).norm(), index))
                    .min_by(|a, b| a.0.total_cmp(&b.0))
                    .unwrap();
                if distance < board.radius * 1.1 {
                    assert_eq!(board.nearest_circle(point), Some(nearest), "{text} {point}");
                }
            }
        }
    }
}

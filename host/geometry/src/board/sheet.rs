//! Layout of a printed board on a sheet of paper, before it becomes PDF or SVG.
//!
//! Lengths are in millimetres, x to the right and y down from the top-left corner of the sheet. The board's rows run
//! along x, so that the upright print corresponds to the board's own frame as seen by a camera.

pub mod blinking;
mod circles;
mod code;
mod either;
mod letters;
pub mod paper;
pub mod pdf;
mod squares;
pub mod svg;
#[cfg(test)]
mod tests;

use std::fmt;

use evcal_core::pattern::Pattern;
use evcal_files::remedy::{self, Remedy};

use crate::board::squares::raster::Rectangle;
use crate::board::{Board, CircleBoard};
use code::{Code, QUIET};
use paper::{PAPERS, Paper};

/// Smallest white space around the board, to the next mark or text.
const CLEARANCE: f64 = 6.0;
/// Length of the end ticks of a ruler; the other ticks are shorter.
const END_TICK: f64 = 4.0;
const TICK: f64 = 2.5;
/// Distance between the ticks of a ruler.
const TICK_DISTANCE: f64 = 10.0;
/// Longest ruler, within the range of a caliper.
const LONGEST_RULER: f64 = 100.0;
const THIN: f64 = 0.1;
/// Size of the letters.
const LETTER_SIZE: f64 = 2.6;
const LETTER_WIDTH: f64 = letters::ADVANCE / letters::STEPS * LETTER_SIZE;
const LINE_HEIGHT: f64 = 3.6;
/// Size of the numerals at the ticks of a ruler, their width and height, and their distance from ticks.
const NUMERAL_SIZE: f64 = 1.8;
const NUMERAL_WIDTH: f64 = letters::ADVANCE / letters::STEPS * NUMERAL_SIZE;
const NUMERAL_HEIGHT: f64 = 0.6 * NUMERAL_SIZE;
const NUMERAL_GAP: f64 = 0.5;
/// Length of an arrow of the orientation mark.
const ARROW: f64 = 7.0;
/// Ratio of dot radius to spacing if no board is given: 17.5 mm to 55 mm.
const RADIUS_BY_SPACING: f64 = 17.5 / 55.0;
/// Tolerance for rounding errors (mm).
const ROUNDING: f64 = 1e-9;
/// Smallest spacing that is proposed (mm).
const SMALLEST_SPACING: f64 = 2.0;

/// A dot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dot {
    /// Its centre (mm).
    pub center: [f64; 2],
    /// Its radius (mm).
    pub radius: f64,
}

/// The dark parts of a board on a sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct Shapes {
    /// The dots, in the order of the board's circles.
    pub dots: Vec<Dot>,
    /// Rectangles (mm), edge to edge where they touch.
    pub rectangles: Vec<Rectangle>,
    /// Top left corner of the area that they cover (mm).
    pub corner: [f64; 2],
}

/// A board that can be printed. Its `Display` is its description.
pub trait Printable: Copy + fmt::Display {
    /// Returns width and height of the area of the dark parts (mm).
    fn size(&self) -> [f64; 2];

    /// Returns the dark parts, with the top left corner of their area at `corner` (mm).
    fn shapes(&self, corner: [f64; 2]) -> Shapes;

    /// Returns a sentence with the lengths that can be checked with a caliper.
    fn lengths(&self) -> String;

    /// Returns the same board scaled to a `spacing`, or side of a square or tag, in mm.
    fn scaled(&self, spacing: f64) -> Option<Self>;
}

/// A thin line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// One end (mm).
    pub from: [f64; 2],
    /// The other end (mm).
    pub to: [f64; 2],
    /// Its width (mm).
    pub width: f64,
}

/// A line of text.
#[derive(Clone, Debug, PartialEq)]
pub struct Words {
    /// Left end of the base line (mm).
    pub at: [f64; 2],
    /// Size of the letters (mm); a letter is 0.6 times as wide.
    pub size: f64,
    /// The text, in ASCII.
    pub text: String,
}

impl Words {
    /// Returns the corners of each stroke of the letters (mm).
    pub fn strokes(&self) -> Vec<Vec<[f64; 2]>> {
        let step = self.size / letters::STEPS;
        let of_letter = |(letter, place): (char, u32)| {
            let left = f64::from(place) * letters::ADVANCE;
            let corner = move |[x, y]: [f64; 2]| [self.at[0] + (left + x) * step, self.at[1] - y * step];
            letters::strokes(letter).into_iter().map(move |stroke| stroke.into_iter().map(corner).collect())
        };
        self.text.chars().zip(0..).flat_map(of_letter).collect()
    }

    /// Returns the width of the strokes (mm).
    pub fn stroke_width(&self) -> f64 {
        self.size / letters::STEPS * letters::STROKE
    }
}

/// Paper for a board, and text below the board.
#[derive(Clone, Copy, Debug)]
pub struct Page<'a> {
    /// The paper, in either orientation.
    pub paper: Paper,
    /// Smallest white margin along the edges (mm).
    pub margin: f64,
    /// Command to print before the board's description.
    pub typed: &'a str,
}

/// A sheet with a board.
#[derive(Clone, Debug, PartialEq)]
pub struct BoardSheet {
    /// Width and height of the sheet (mm).
    pub size: [f64; 2],
    /// Description of the board on it.
    pub board: String,
    /// Length of both rulers (mm).
    pub ruler: f64,
    /// The dots, in the order of the board's circles.
    pub dots: Vec<Dot>,
    /// The dark rectangles of a board of squares (mm), edge to edge where they touch.
    pub rectangles: Vec<Rectangle>,
    /// The dark modules of a QR code with the first line of text (mm).
    pub code: Vec<Rectangle>,
    /// Rulers and orientation mark.
    pub lines: Vec<Line>,
    /// Text on the sheet.
    pub words: Vec<Words>,
}

/// Error: a board does not fit on the paper.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub struct DoesNotFit<B: Printable = Board> {
    board: B,
    paper: Paper,
    /// Smallest sheet that the board fits on (mm).
    pub needed: [f64; 2],
    /// The board of this layout with the largest spacing that fits on the paper.
    pub largest: Option<B>,
    /// Papers on which the board fits.
    pub papers: Vec<&'static str>,
}

impl<B: Printable> Remedy for DoesNotFit<B> {
    fn remedy(&self, say: &remedy::Words) -> Option<String> {
        let paper = say.paper?;
        Some(match (&self.largest, self.papers.is_empty()) {
            (_, true) => format!("give the size of your paper as {}", paper.with("WIDTHxHEIGHTmm")),
            (Some(largest), false) => format!("print {}, or choose a larger {paper}", say.board.with(largest)),
            (None, false) => format!("choose a larger {paper}"),
        })
    }
}

impl<B: Printable> fmt::Display for DoesNotFit<B> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { board, paper, needed: [width, height], largest, papers } = self;
        write!(f, "{board} does not fit on {paper}: it needs {width:.0} x {height:.0} mm with margins and rulers; ")?;
        match largest {
            Some(largest) => write!(f, "the largest board of this kind that fits is {largest}")?,
            None => write!(f, "this paper is too small for any board of this kind")?,
        }
        if papers.is_empty() {
            write!(f, ", and none of evcal's papers is large enough")
        } else {
            write!(f, "; it fits on {}", papers.join(", "))
        }
    }
}

/// Lays out `board` on a page, in either orientation.
///
/// # Errors
/// Returns [`DoesNotFit`] with the largest board and the papers that would fit.
pub fn board_sheet<B: Printable>(board: &B, page: &Page) -> Result<BoardSheet, DoesNotFit<B>> {
    lay_out(board, page).ok_or_else(|| {
        let fits = |paper: &&Paper| lay_out(board, &Page { paper: **paper, ..*page }).is_some();
        DoesNotFit {
            board: *board,
            paper: page.paper,
            needed: needed(board, page),
            largest: largest_board(board, page),
            papers: PAPERS.iter().filter(fits).map(|paper| paper.name).collect(),
        }
    })
}

/// Returns the board of this `pattern` with the largest spacing, in whole millimetres, that fits on a page.
pub fn board_that_fits(pattern: Pattern, page: &Page) -> Option<CircleBoard> {
    largest_board(&CircleBoard { pattern, spacing: 1.0, radius: RADIUS_BY_SPACING }, page)
}

fn largest_board<B: Printable>(board: &B, page: &Page) -> Option<B> {
    let longest = page.paper.size.into_iter().fold(0.0, f64::max).ceil() as u32;
    let spacings = (1..=longest).rev().map(f64::from).filter(|spacing| *spacing >= SMALLEST_SPACING);
    spacings.filter_map(|spacing| board.scaled(spacing)).find(|board| lay_out(board, page).is_some())
}

/// Width of white space, ruler and mark between the margin and the board: left, top.
const LEFT: f64 = END_TICK + CLEARANCE;
const TOP: f64 = LINE_HEIGHT + CLEARANCE;

/// The strip with ruler, text and QR code between the board and the margin.
struct Strip {
    /// Lines of text.
    text: Vec<String>,
    code: Code,
    /// Distance of the code from the margin, if the margin is narrower than the white space around a code (mm).
    inset: f64,
}

impl Strip {
    /// Returns the strip for a sheet with `across` mm between its margins; `None` if the code would be too large.
    fn new(board: &impl Printable, page: &Page, ruler: f64, across: f64) -> Option<Self> {
        let name = name(board, page);
        let (code, inset) = (Code::of(&name)?, (QUIET - page.margin).max(0.0));
        let text = writing(board, name, ruler, across - code.side - inset - QUIET);
        Some(Self { text, code, inset })
    }

    /// Returns the width of the code with the white space around it (mm).
    fn code_width(&self) -> f64 {
        QUIET + self.code.side + self.inset
    }

    /// Returns the height of the strip with the white space below the board (mm).
    fn height(&self) -> f64 {
        let writing = END_TICK + 1.0 + LINE_HEIGHT * self.text.len() as f64;
        CLEARANCE + writing.max(self.code.side + self.inset)
    }
}

fn needed(board: &impl Printable, page: &Page) -> [f64; 2] {
    let [width, height] = board.size();
    let of = |across: f64| Strip::new(board, page, LONGEST_RULER, across);
    let code_width = of(0.0).map_or(0.0, |strip| strip.code_width());
    let first_line = name(board, page).len() as f64 * LETTER_WIDTH + code_width;
    let inner = (width + LEFT).max(LEFT + TICK_DISTANCE + code_width).max(first_line);
    let below = of(inner).map_or(0.0, |strip| strip.height());
    [inner, height + TOP + below].map(|side| side + 2.0 * page.margin)
}

/// Returns the first line below the board: the description that the user types.
fn name(board: &impl Printable, page: &Page) -> String {
    format!("{}{board}", page.typed)
}

/// Returns the lines below the board, the `name` first, at most `width` mm wide.
fn writing(board: &impl Printable, name: String, ruler: f64, width: f64) -> Vec<String> {
    let sentences = format!(
        "{} Print at 100 %, without scaling: both rulers must measure {ruler} mm between their end lines. Measure them, because \
         programs may scale whatever this file asks (CUPS prints A4 on Letter paper at 85.5 %). If they differ, type the lengths of \
         the board that a caliper measures. The code contains the first line. evcal {}.",
        board.lengths(),
        crate::VERSION
    );
    let most = (width / LETTER_WIDTH).floor().max(1.0) as usize;
    let mut lines = vec![name];
    let mut line = String::new();
    for word in sentences.split(' ') {
        if !line.is_empty() && line.len() + 1 + word.len() > most {
            lines.push(std::mem::take(&mut line));
        }
        if !line.is_empty() {
            line.push(' ');
        }
        line += word;
    }
    lines.push(line);
    lines
}

/// Returns the sheet in the orientation that leaves more room, if the board fits.
fn lay_out(board: &impl Printable, page: &Page) -> Option<BoardSheet> {
    let [short, long] = page.paper.size;
    let sheets = [[short, long], [long, short]].map(|size| draw(board, size, page));
    let room = |(_, room): &(BoardSheet, f64)| *room;
    let best = sheets.into_iter().flatten().reduce(|a, b| if room(&b) > room(&a) { b } else { a });
    best.map(|(sheet, _)| sheet)
}

/// Returns the sheet of this width and height, and the space that remains in the tighter direction (mm).
fn draw(board: &impl Printable, size: [f64; 2], page: &Page) -> Option<(BoardSheet, f64)> {
    let margin = page.margin;
    let [width, height] = board.size();
    let across = size[0] - 2.0 * margin;
    let inner = [across - LEFT, size[1] - 2.0 * margin - TOP];
    // A shorter ruler does not need more lines of text, so the longest one is assumed here.
    let strip = Strip::new(board, page, LONGEST_RULER, across)?;
    let below = strip.height();
    let longest = (inner[0] - strip.code_width()).min(inner[1] - below).min(LONGEST_RULER);
    let ruler = (longest / TICK_DISTANCE).floor() * TICK_DISTANCE;
    let strip = Strip { text: Strip::new(board, page, ruler, across)?.text, ..strip };
    let widest = strip.text.iter().map(String::len).max().unwrap_or(0) as f64 * LETTER_WIDTH + strip.code_width();
    let free = [inner[0] - width, inner[1] - below - height];
    let room = free[0].min(free[1]);
    if ruler < TICK_DISTANCE || widest > across + ROUNDING || room < -ROUNDING {
        return None;
    }
    let corner = [margin + LEFT + free[0] / 2.0, margin + TOP + free[1] / 2.0];
    let Shapes { dots, rectangles, corner } = board.shapes(corner);
    let mut lines = ruler_lines([margin + LEFT, size[1] - margin - below + CLEARANCE], [1.0, 0.0], ruler);
    lines.extend(ruler_lines([margin, margin + TOP], [0.0, 1.0], ruler));
    let mark = [corner[0], corner[1] - CLEARANCE];
    lines.extend(arrow(mark));
    let base = size[1] - margin - below + CLEARANCE + END_TICK + 1.0;
    let code = strip.code.at(size.map(|side| side - margin - strip.inset - strip.code.side));
    let mut words: Vec<Words> = strip
        .text
        .into_iter()
        .zip(1..)
        .map(|(text, line)| Words { at: [margin, base + LINE_HEIGHT * f64::from(line) - 0.8], size: LETTER_SIZE, text })
        .collect();
    let numeral = |at: [f64; 2], text: String| Words { at, size: NUMERAL_SIZE, text };
    let base_line = size[1] - margin - below + CLEARANCE + TICK + NUMERAL_SIZE;
    words.extend(marks(ruler).map(|(along, end)| {
        let text = if end == End::Last { format!("{along} mm") } else { format!("{along}") };
        let width = NUMERAL_WIDTH * text.len() as f64;
        let left = match end {
            End::First => NUMERAL_GAP,
            End::Neither => -0.5 * width,
            End::Last => -width - NUMERAL_GAP,
        };
        numeral([margin + LEFT + along + left, base_line], text)
    }));
    words.extend(marks(ruler).flat_map(|(along, end)| {
        // The numerals at the ends are inside, because the ticks there are longer.
        let down = match end {
            End::First => NUMERAL_GAP + NUMERAL_HEIGHT,
            End::Neither => 0.5 * NUMERAL_HEIGHT,
            End::Last => -NUMERAL_GAP,
        };
        let at = [margin + TICK + NUMERAL_GAP, margin + TOP + along + down];
        let unit = (end == End::Last).then(|| numeral([at[0], at[1] - NUMERAL_SIZE], "mm".to_owned()));
        [Some(numeral(at, format!("{along}"))), unit].into_iter().flatten()
    }));
    words.push(Words { at: [mark[0] + ARROW + 1.5, mark[1] + 0.9], size: LETTER_SIZE, text: "x".to_owned() });
    Some((BoardSheet { size, board: board.to_string(), ruler, dots, rectangles, code, lines, words }, room))
}

/// Returns the lines of a ruler of `length` from `start` along `direction`, the x or y axis, with ticks below it or to
/// the right of it.
fn ruler_lines(start: [f64; 2], direction: [f64; 2], length: f64) -> Vec<Line> {
    let at = |along: f64, across: f64| {
        [
            start[0] + along * direction[0] + across * direction[1],
            start[1] + along * direction[1] + across * direction[0],
        ]
    };
    let ticks = (length / TICK_DISTANCE).round() as u32;
    let mut lines = vec![Line { from: at(0.0, 0.0), to: at(length, 0.0), width: THIN }];
    lines.extend((0..=ticks).map(|tick| {
        let end = if tick == 0 || tick == ticks { END_TICK } else { TICK };
        let along = f64::from(tick) * TICK_DISTANCE;
        Line { from: at(along, 0.0), to: at(along, end), width: THIN }
    }));
    lines
}

/// End of a ruler.
#[derive(Clone, Copy, PartialEq)]
enum End {
    First,
    Neither,
    Last,
}

/// Returns the length from the start of a ruler to each of its ticks (mm), and the end at which the tick is.
fn marks(length: f64) -> impl Iterator<Item = (f64, End)> {
    let ticks = (length / TICK_DISTANCE).round() as u32;
    (0..=ticks).map(move |tick| {
        let end = match tick {
            0 => End::First,
            tick if tick == ticks => End::Last,
            _ => End::Neither,
        };
        (f64::from(tick) * TICK_DISTANCE, end)
    })
}

/// Returns an arrow along a row, above the top left corner of the board; it is too thin to be taken for a part of the
/// board.
fn arrow(start: [f64; 2]) -> [Line; 3] {
    let tip = [start[0] + ARROW, start[1]];
    let line = |from| Line { from, to: tip, width: 2.0 * THIN };
    [line(start), line([tip[0] - 1.5, tip[1] - 0.8]), line([tip[0] - 1.5, tip[1] + 0.8])]
}

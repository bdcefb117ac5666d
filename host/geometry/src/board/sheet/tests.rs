use evcal_core::pattern::Layout;

use super::blinking::blinking_page;
use super::*;
use crate::board::squares::SquareBoard;

const MARGIN: f64 = 10.0;

fn board(text: &str) -> CircleBoard {
    text.parse().unwrap()
}

fn page(paper: Paper) -> Page<'static> {
    Page { paper, margin: MARGIN, typed: "type " }
}

fn paper(text: &str) -> Paper {
    text.parse().unwrap()
}

/// The board on a screen is the printed one, without rulers and text; nothing of the template is left open.
#[test]
fn a_page_shows_the_dark_parts_of_the_board() {
    let dots: CircleBoard = board("acircles:9x4:20mm:r6mm");
    let squares: SquareBoard = "aprilgrid:3x4:30mm:0.3".parse().unwrap();
    let page = |page: String| {
        assert!(!["{svg}", "{board}", "{width}", "{height}"].iter().any(|place| page.contains(place)), "{page}");
        page
    };
    let of_dots = page(blinking_page(&dots));
    assert_eq!(of_dots.matches("<circle").count(), 36);
    assert!(of_dots.contains("--board acircles:9x4:20mm:r6mm -o"));
    let printed = squares.shapes([CLEARANCE; 2]).rectangles.len();
    assert_eq!(page(blinking_page(&squares)).matches('Z').count(), printed);
}

#[test]
fn nothing_overlaps_the_margin_and_marks_do_not_overlap_dots() {
    for (text, paper_name) in [
        ("acircles:9x4:20mm:r6mm", "a4"),
        ("acircles:4x9:13mm:r4mm", "letter"),
        ("circles:5x8:25mm:r8mm", "a3"),
        ("circles:2x2:8mm:r3mm", "120x90mm"),
    ] {
        let sheet = board_sheet(&board(text), &page(paper(paper_name))).unwrap();
        let inside = |[x, y]: [f64; 2], around: f64| {
            let keeps = |at: f64, size: f64| at - around >= MARGIN - 1e-9 && at + around <= size - MARGIN + 1e-9;
            keeps(x, sheet.size[0]) && keeps(y, sheet.size[1])
        };
        assert_eq!(sheet.dots.len(), board(text).circle_count());
        assert!(sheet.dots.iter().all(|dot| inside(dot.center, dot.radius)), "{text}");
        for line in &sheet.lines {
            assert!(inside(line.from, 0.0) && inside(line.to, 0.0), "{text}: {line:?}");
            for dot in &sheet.dots {
                for end in [line.from, line.to] {
                    let away = (end[0] - dot.center[0]).hypot(end[1] - dot.center[1]) - dot.radius;
                    assert!(away >= CLEARANCE - 2.0, "{text}: {line:?} {dot:?}");
                }
            }
        }
        for words in &sheet.words {
            let end = [words.at[0] + words.text.len() as f64 * 0.6 * words.size, words.at[1]];
            assert!(inside(words.at, 0.0) && inside(end, 0.0) && words.text.is_ascii(), "{text}: {words:?}");
            let lowest = sheet.dots.iter().map(|dot| dot.center[1] + dot.radius).fold(0.0, f64::max);
            let may_be_next_to_dots = words.text == "x" || words.size == NUMERAL_SIZE;
            assert!(may_be_next_to_dots || words.at[1] - words.size > lowest + CLEARANCE - 2.0, "{text}");
            for dot in &sheet.dots {
                let near = |at: [f64; 2]| (at[0] - dot.center[0]).hypot(at[1] - dot.center[1]) - dot.radius;
                assert!(near(words.at) > 1.0 && near(end) > 1.0, "{text}: {words:?} {dot:?}");
            }
        }
        // The code has its white space on all sides.
        let low = |axis: usize| sheet.code.iter().map(|dark| dark.low[axis]).fold(1e9, f64::min) - QUIET;
        let [left, top] = [low(0), low(1)];
        assert!(sheet.code.iter().all(|dark| inside(dark.high, 0.0)), "{text}");
        assert!(sheet.dots.iter().all(|dot| dot.center[1] + dot.radius < top - 1.0), "{text}");
        assert!(sheet.lines.iter().all(|line| line.to[0] <= left || line.to[1] <= top), "{text}");
        for words in &sheet.words {
            let right = words.at[0] + words.text.len() as f64 * 0.6 * words.size;
            assert!(right <= left + 1e-9 || words.at[1] <= top, "{text}: {words:?}");
        }
    }
}

/// The first length on the sheet is in the description that the user types, so that nobody types the distance of
/// neighbours as the spacing.
#[test]
fn the_first_line_of_the_sheet_is_the_text_to_type_and_rulers_have_numerals() {
    let sheet = board_sheet(&board("acircles:9x4:20mm:r6mm"), &page(paper("a4"))).unwrap();
    assert_eq!(sheet.words[0].text, "type acircles:9x4:20mm:r6mm");
    assert!(sheet.words[1].text.starts_with("Spacing 20 mm,"), "{:?}", sheet.words[1]);
    let numerals: Vec<&str> =
        sheet.words.iter().filter(|words| words.size == NUMERAL_SIZE).map(|words| words.text.as_str()).collect();
    let inner = ["0", "10", "20", "30", "40", "50", "60", "70", "80", "90"];
    assert_eq!(numerals, [&inner[..], &["100 mm"], &inner, &["100", "mm"]].concat());
    let all: Vec<&str> = sheet.words.iter().map(|words| words.text.as_str()).collect();
    assert!(all.join(" ").contains("CUPS prints A4 on Letter paper at 85.5 %"), "{all:?}");
}

/// Without a margin, the code keeps its distance from the edge of the paper.
#[test]
fn the_code_has_white_space_at_the_edge_of_the_paper() {
    let page = Page { margin: 0.0, ..page(paper("a4")) };
    let sheet = board_sheet(&board("acircles:9x4:20mm:r6mm"), &page).unwrap();
    for axis in 0..2 {
        let high = sheet.code.iter().map(|dark| dark.high[axis]).fold(0.0, f64::max);
        assert!((sheet.size[axis] - high - QUIET).abs() < 1e-9, "{high}");
    }
}

#[test]
fn the_sheet_is_landscape_for_a_wide_board() {
    let upright = board_sheet(&board("acircles:9x4:20mm:r6mm"), &page(paper("a4"))).unwrap();
    let lying = board_sheet(&board("acircles:5x7:19mm:r6mm"), &page(paper("a4"))).unwrap();
    assert_eq!((upright.size, lying.size), ([210.0, 297.0], [297.0, 210.0]));
    assert_eq!(upright.ruler, 100.0);
}

#[test]
fn an_error_names_boards_and_papers_that_fit() {
    let error = board_sheet(&board("acircles:9x4:55mm:r17.5mm"), &page(paper("a4"))).unwrap_err();
    let largest = error.largest.unwrap();
    assert!(board_sheet(&largest, &page(paper("a4"))).is_ok());
    let more = CircleBoard { spacing: largest.spacing + 1e-3, ..largest };
    assert!(board_sheet(&more, &page(paper("a4"))).is_err());
    assert!(error.papers.contains(&"a1") && !error.papers.contains(&"a2"), "{error}");
    let [width, height] = error.needed;
    let exact = Paper { name: "custom", size: [width.min(height), width.max(height)] };
    assert!(board_sheet(&board("acircles:9x4:55mm:r17.5mm"), &page(exact)).is_ok(), "{error}");
    let text = error.to_string();
    assert!(text.contains(&largest.to_string()) && text.contains("fits on a1"), "{text}");
    let huge = board_sheet(&board("circles:9x9:1m:r10cm"), &page(paper("a4"))).unwrap_err().to_string();
    assert!(huge.contains("none of evcal's papers"), "{huge}");
    let tiny = board_sheet(&board("circles:9x9:1m:r10cm"), &page(paper("30x30mm"))).unwrap_err().to_string();
    assert!(tiny.contains("too small for any board"), "{tiny}");
}

#[test]
fn the_default_board_has_the_proportions_of_the_documentation() {
    let pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };
    let fits = board_that_fits(pattern, &page(paper("a4"))).unwrap();
    assert!(fits.spacing >= 0.023 && (fits.radius / fits.spacing - RADIUS_BY_SPACING).abs() < 0.005, "{fits}");
    assert!(fits.to_string().parse::<CircleBoard>().is_ok());
}

const SQUARES: [&str; 5] = [
    "checkerboard:6x9:20mm",
    "aprilgrid:3x3:40mm:0.3",
    "apriltags:2x3:40mm:0.25",
    "apriltags:2x3:40mm:0.25:down",
    "charuco:7x5:25mm:19mm:DICT_5X5_100",
];

fn squares(text: &str) -> SquareBoard {
    text.parse().unwrap()
}

#[test]
fn a_board_of_squares_is_upright_on_its_sheet() {
    for text in SQUARES {
        let board = squares(text);
        let sheet = board_sheet(&board, &page(paper("a4"))).unwrap();
        assert_eq!(sheet.board, text);
        let (raster, bounds) = (board.raster(), board.bounds());
        let far = |pick: fn(f64, f64) -> f64, axis: usize, start: f64| {
            sheet.rectangles.iter().flat_map(|dark| [dark.low[axis], dark.high[axis]]).fold(start, pick)
        };
        let low = [far(f64::min, 0, 1e9), far(f64::min, 1, 1e9)];
        let high = [far(f64::max, 0, 0.0), far(f64::max, 1, 0.0)];
        for axis in 0..2 {
            assert!((high[axis] - low[axis] - (bounds.high[axis] - bounds.low[axis]) * 1e3).abs() < 1e-9, "{text}");
            assert!(low[axis] >= MARGIN + CLEARANCE && high[axis] <= sheet.size[axis] - MARGIN, "{text}");
        }
        // Each position is dark on the sheet if it is dark on the board, and covered once.
        for row in 0..97 {
            for column in 0..89 {
                let share = [(f64::from(column) + 0.37) / 89.0, (f64::from(row) + 0.37) / 97.0];
                let at = |low: [f64; 2], high: [f64; 2], share: [f64; 2]| -> [f64; 2] {
                    std::array::from_fn(|axis| low[axis] + share[axis] * (high[axis] - low[axis]))
                };
                let [x, y] = at(low, high, share);
                let covers =
                    |dark: &&Rectangle| dark.low[0] <= x && x < dark.high[0] && dark.low[1] <= y && y < dark.high[1];
                let expected = raster.is_dark_at(at(bounds.low, bounds.high, share));
                assert_eq!(sheet.rectangles.iter().filter(covers).count(), usize::from(expected), "{text} {share:?}");
            }
        }
    }
}

#[test]
fn a_board_of_squares_that_does_not_fit_is_made_smaller() {
    for text in ["checkerboard:6x9:60mm", "aprilgrid:6x6:88mm:0.3", "charuco:5x7:60mm:44mm:DICT_5X5_100:legacy"] {
        let error = board_sheet(&squares(text), &page(paper("a4"))).unwrap_err();
        let largest = error.largest.unwrap();
        assert!(board_sheet(&largest, &page(paper("a4"))).is_ok());
        assert_eq!(largest.to_string().parse(), Ok(largest));
        let (kind, last) = (text.split(':').take(2), text.split(':').skip(4));
        let written = largest.to_string();
        assert!(written.split(':').take(2).eq(kind) && written.split(':').skip(4).eq(last), "{written}");
        assert!(error.to_string().contains(&written), "{error}");
    }
}

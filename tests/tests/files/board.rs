//! Printed boards: the PDF and SVG files are rendered by other programs. OpenCV finds and measures the dots, measures the rulers and
//! reads the QR code.

use std::fs;
use std::path::{Path, PathBuf};

use evcal_geometry::board::sheet::{Line, Page, board_sheet};
use evcal_geometry::board::{Board, CircleBoard};
use evcal_tests::readers::{ask, python, run};
use evcal_tests::{evcal, json, succeed, text};
use serde_json::{Value, json};
use tempfile::TempDir;

const MILLIMETRES_PER_INCH: f64 = 25.4;

/// Boards, papers and resolutions (dots per inch).
const SHEETS: [(&str, &str, &str, f64); 8] = [
    ("acircles:9x4:23mm:r7.3mm", "a4", "210x297", 300.0),
    ("acircles:4x9:13.5mm:r4mm", "letter", "279.4x215.9", 600.0),
    ("circles:5x8:33mm:r10.5mm", "a3", "420x297", 200.0),
    ("acircles:9x4:55mm:r17.5mm", "600x500mm", "500x600", 150.0),
    ("checkerboard:6x9:22mm", "a4", "297x210", 300.0),
    ("aprilgrid:6x6:22mm:0.3", "a4", "210x297", 300.0),
    ("apriltags:3x4:40mm:0.25:25h9", "letter", "279.4x215.9", 300.0),
    ("charuco:5x7:30mm:22mm:DICT_5X5_100", "a4", "297x210", 300.0),
];

/// Distance from a ruler's line at which only its end ticks, and no numerals, are printed (mm).
const ONLY_ENDS: f64 = 2.8;

/// Renders both files as grey pictures.
fn render(folder: &Path, index: usize, dpi: f64) -> [PathBuf; 2] {
    let base = folder.join(format!("sheet-{index}"));
    let (pdf, svg) = (base.with_extension("pdf"), base.with_extension("svg"));
    let dots = dpi.to_string();
    run(
        "pdftoppm",
        &["-r", &dots, "-gray", "-png", "-singlefile", text(&pdf), text(&folder.join(format!("pdf-{index}")))],
    );
    let of_svg = folder.join(format!("svg-{index}.png"));
    run("rsvg-convert", &["-d", &dots, "-p", &dots, "-o", text(&of_svg), text(&svg)]);
    [folder.join(format!("pdf-{index}.png")), of_svg]
}

#[test]
fn opencv_finds_and_measures_the_requested_board() {
    let folder = TempDir::new().unwrap();
    let mut questions = Vec::new();
    let mut expected = Vec::new();
    for (index, (board, paper, size, dpi)) in SHEETS.into_iter().enumerate() {
        let base = folder.path().join(format!("sheet-{index}"));
        let (pdf, svg) = (base.with_extension("pdf"), base.with_extension("svg"));
        let arguments =
            ["board", "--board", board, "--paper", paper, "--pdf", text(&pdf), "--svg", text(&svg), "--json"];
        let report = json(&arguments);
        let [width, height] = ["width_mm", "height_mm"].map(|side| report[side].as_f64().unwrap());
        assert_eq!(format!("{width}x{height}"), size);
        let words: Vec<&str> = board.split(':').collect();
        let (rows, columns) = words[1].split_once('x').unwrap();
        let rulers = rulers(board, paper, dpi);
        for picture in render(folder.path(), index, dpi) {
            questions.push(json!({
                "file": picture, "layout": words[0], "rulers": rulers,
                "columns": columns.parse::<u32>().unwrap(), "rows": rows.parse::<u32>().unwrap(),
            }));
            expected.push((board, dpi, report.clone()));
        }
        // The size of the page, and the text that names the board.
        let information = run("pdfinfo", &[text(&pdf)]);
        let page = information.lines().find_map(|line| line.strip_prefix("Page size:")).unwrap();
        let points: Vec<f64> = page.split_whitespace().filter_map(|word| word.parse().ok()).collect();
        for (points, side) in points.iter().zip([width, height]) {
            assert!((points - side / MILLIMETRES_PER_INCH * 72.0).abs() < 0.01, "{page}");
        }
        assert!(run("pdftotext", &[text(&pdf), "-"]).contains(&format!("--board {board}\n")));
        // Type, encoding, embedded, subset: the viewer replaces no font.
        let fonts = run("pdffonts", &[text(&pdf)]);
        assert!(fonts.lines().skip(2).all(|font| font.contains(" yes ")) && fonts.lines().count() == 3, "{fonts}");
        let source = fs::read_to_string(&svg).unwrap();
        assert!(source.contains(&format!("--board {board}")) && source.contains("mm\""), "{source}");
    }
    let answers = ask(&python(), "board.py", &Value::Array(questions));
    for (answer, (text, dpi, report)) in answers.as_array().unwrap().iter().zip(&expected) {
        check(answer, text, *dpi, report);
    }
}

/// Returns for both rulers of a sheet the axis along which it lies, and two pixels on its end ticks.
fn rulers(board: &str, paper: &str, dpi: f64) -> Vec<(usize, [f64; 2], [f64; 2])> {
    let page = Page { paper: paper.parse().unwrap(), margin: 10.0, typed: "--board " };
    let sheet = board_sheet(&board.parse::<Board>().unwrap(), &page).unwrap();
    let pixels = |[x, y]: [f64; 2]| [x, y].map(|side| side / MILLIMETRES_PER_INCH * dpi);
    let longest = |line: &&Line| (line.to[0] - line.from[0]).hypot(line.to[1] - line.from[1]) == sheet.ruler;
    let of = |Line { from, to, .. }: &Line| {
        let axis = usize::from(from[0] == to[0]);
        let mut away = [ONLY_ENDS; 2];
        away[axis] = 0.0;
        let beside = |at: &[f64; 2]| pixels([at[0] + away[0], at[1] + away[1]]);
        (axis, beside(from), beside(to))
    };
    sheet.lines.iter().filter(longest).map(of).collect()
}

fn check(answer: &Value, text: &str, dpi: f64, report: &Value) {
    let pixels = |millimetres: f64| millimetres / MILLIMETRES_PER_INCH * dpi;
    assert_eq!(answer["code"], format!("--board {text}"));
    let lengths: Vec<f64> = serde_json::from_value(answer["rulers"].clone()).unwrap();
    let ruler = pixels(report["ruler_mm"].as_f64().unwrap());
    assert!(
        lengths.len() == 2 && lengths.iter().all(|length| (length - ruler).abs() < 1.0),
        "{text}: {lengths:?}, {ruler}"
    );
    let Ok(board) = text.parse::<CircleBoard>() else { return };
    let [width, height] = ["width_mm", "height_mm"].map(|side| pixels(report[side].as_f64().unwrap()));
    let size = ["width", "height"].map(|side| answer[side].as_f64().unwrap());
    assert!((size[0] - width).abs() <= 1.0 && (size[1] - height).abs() <= 1.0, "{text}: {size:?}, {width} x {height}");
    let centers: Vec<[f64; 2]> = serde_json::from_value(answer["centers"].clone()).unwrap();
    let radii: Vec<f64> = serde_json::from_value(answer["radii"].clone()).unwrap();
    assert_eq!(centers.len(), board.circle_count());
    let first: [f64; 2] = serde_json::from_value(report["first_dot_mm"].clone()).unwrap();
    // OpenCV may begin at the other end of a symmetric grid.
    let turned = (centers[0][1] - pixels(first[1])).abs() > pixels(1.0);
    let mut largest: f64 = 0.0;
    for (index, center) in centers.iter().enumerate() {
        let index = if turned { centers.len() - 1 - index } else { index };
        let center_mm = board.circle_center(index) * 1e3;
        let ideal = [first[0] + center_mm.x, first[1] + center_mm.y].map(pixels);
        largest = largest.max((center[0] - ideal[0]).hypot(center[1] - ideal[1]));
    }
    // 0.1 % of the spacing.
    let spacing = pixels(board.spacing * 1e3);
    assert!(largest < 1e-3 * spacing, "{text}: centres are off by {largest} px of {spacing}");
    let radius = pixels(board.radius * 1e3);
    for found in &radii {
        assert!((found / radius - 1.0).abs() < 1e-3, "{text}: {found} px, not {radius}");
    }
    let worst = radii.iter().map(|found| (found / radius - 1.0).abs()).fold(0.0, f64::max);
    println!(
        "{text}: centres within {:.4} % of the spacing, radii within {:.4} %",
        100.0 * largest / spacing,
        100.0 * worst
    );
}

#[test]
fn without_a_board_the_paper_is_filled() {
    let folder = TempDir::new().unwrap();
    let pdf = folder.path().join("board.pdf");
    let printed = succeed(&["board", "--paper", "a3", "--pdf", text(&pdf)]);
    let board = printed.split("--board ").nth(1).unwrap().trim();
    assert!(board.starts_with("acircles:9x4:3"), "{printed}");
    assert!(run("pdftotext", &[text(&pdf), "-"]).contains(board));
}

#[test]
fn a_board_larger_than_the_paper_and_wrong_options_are_rejected() {
    for (arguments, code, part) in [
        (
            &["--board", evcal_tests::BOARD, "--pdf", "/nonexistent/b.pdf"][..],
            1,
            "print --board acircles:9x4:23mm:r7.3mm",
        ),
        (&["--pdf", "/nonexistent/b.pdf"], 1, "/nonexistent/b.pdf"),
        (&["--paper", "a3"], 2, "--pdf"),
        (&["--paper", "b9", "--pdf", "b.pdf"], 2, "600x400mm"),
        (&["--margin=-1", "--svg", "b.svg"], 2, "--margin"),
    ] {
        let failed = evcal(&[&["board"], arguments].concat());
        assert!(failed.code == Some(code) && failed.stderr.contains(part), "{arguments:?}: {failed:?}");
    }
}

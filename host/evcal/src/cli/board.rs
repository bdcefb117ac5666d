//! `evcal board`.

use std::path::{Path, PathBuf};

use evcal_core::pattern::{Layout, Pattern};
use evcal_files::visible;
use evcal_geometry::board::Board;
use evcal_geometry::board::sheet::blinking::blinking_page;
use evcal_geometry::board::sheet::paper::Paper;
use evcal_geometry::board::sheet::pdf::pdf;
use evcal_geometry::board::sheet::svg::svg;
use evcal_geometry::board::sheet::{BoardSheet, Page, board_sheet, board_that_fits};

use super::output_arguments::OutputArguments;
use super::{Failure, print, value};

/// Pattern of the board without `--board`.
const PATTERN: Pattern = Pattern { layout: Layout::Asymmetric, rows: 9, columns: 4 };

/// Arguments of `evcal board`.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("outputs").required(true).multiple(true))]
pub struct Arguments {
    /// Board to print, for example acircles:9x4:23mm:r7.3mm [default: the largest acircles:9x4 that fits]
    #[arg(long, value_parser = super::board_argument::board)]
    board: Option<Board>,
    /// PDF file to write
    #[arg(long, value_name = "FILE", group = "outputs", value_parser = value::output_file())]
    pdf: Option<PathBuf>,
    /// SVG file to write
    #[arg(long, value_name = "FILE", group = "outputs", value_parser = value::output_file())]
    svg: Option<PathBuf>,
    /// HTML page to write: it shows the board blinking on a screen, for a camera at rest
    #[arg(long, value_name = "FILE", group = "outputs", value_parser = value::output_file())]
    blink: Option<PathBuf>,
    #[command(flatten)]
    results: OutputArguments,
    /// Paper: a4, a3, a2, a1, a0, letter, tabloid, or a size such as 600x400mm; portrait or landscape, as the board fits
    #[arg(long, default_value = "a4")]
    paper: Paper,
    /// White margin along the edges, which a printer may cut off (mm)
    #[arg(long, value_name = "MM", default_value = "10", value_parser = value::number(0.0..=100.0, " mm"))]
    margin: f64,
    /// Print the board and the written files as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal board`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let Arguments { paper, margin, .. } = arguments;
    let page = Page { paper: *paper, margin: *margin, typed: "--board " };
    let board = match arguments.board {
        Some(board) => board,
        None => board_that_fits(PATTERN, &page).map(Board::Circles).ok_or_else(|| {
            Failure::plain(format!("{paper} is too small for a board of 9x4 dots: choose a larger --paper"))
        })?,
    };
    let paper_files: Vec<&PathBuf> = arguments.pdf.iter().chain(&arguments.svg).collect();
    // A screen has its own size.
    let sheet = match paper_files.is_empty() {
        true => None,
        false => Some(board_sheet(&board, &page)?),
    };
    let written: Vec<&Path> = paper_files.into_iter().chain(&arguments.blink).map(PathBuf::as_path).collect();
    arguments.results.check(written.iter().copied(), &[])?;
    let of_sheet =
        |path: &'_ Option<PathBuf>, content: fn(&BoardSheet) -> Vec<u8>| path.clone().zip(sheet.as_ref().map(content));
    let pdf = of_sheet(&arguments.pdf, pdf);
    let svg = of_sheet(&arguments.svg, |sheet| svg(sheet).into_bytes());
    let blink = arguments.blink.clone().map(|path| (path, blinking_page(&board).into_bytes()));
    let files = [pdf, svg, blink].into_iter().flatten().collect::<Vec<_>>();
    let files: Vec<(&Path, &[u8])> = files.iter().map(|(path, content)| (path.as_path(), content.as_slice())).collect();
    evcal_files::write_all(&files)?;
    if arguments.json {
        let sheet = sheet.as_ref();
        return print::json(&serde_json::json!({
            "written": written,
            "board": board.to_string(),
            "width_mm": sheet.map(|sheet| sheet.size[0]),
            "height_mm": sheet.map(|sheet| sheet.size[1]),
            "ruler_mm": sheet.map(|sheet| sheet.ruler),
            "first_dot_mm": sheet.and_then(|sheet| sheet.dots.first()).map(|dot| dot.center),
        }));
    }
    for path in written {
        print::line(format!("written to {}", visible::path(path)))?;
    }
    if let Some(BoardSheet { size: [width, height], ruler, .. }) = sheet {
        print::line(format!("{width} x {height} mm: print at 100 % and check that both rulers measure {ruler} mm"))?;
    }
    if let Some(page) = &arguments.blink {
        let page = visible::path(page);
        print::line(format!(
            "open {page} in a browser and set its scale; the camera is at rest for half a second in each of six views"
        ))?;
    }
    print::line(format!("calibrate with --board {board}"))
}

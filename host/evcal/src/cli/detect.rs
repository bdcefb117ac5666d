//! `evcal detect`.

use std::path::PathBuf;

use super::settings::read_settings;
use evcal_calibrate::task::board_choice::recognise_board;
use evcal_core::circle::Extraction;
use evcal_detection::circles::file::{InputKind, open_events};
use evcal_detection::circles::serial::SerialAddress;
use evcal_detection::circles::stream::{self, CircleStream};
use evcal_detection::detection::recognition::recognised::Recognised;
use evcal_detection::detection::search::{
    FoundCircles, SearchFor, search_events_with_progress, search_stream, sensor_of,
};
use evcal_detection::detection::settings::DetectionSettings;
use evcal_geometry::board::request::BoardRequest;
use evcal_report::report::drawing::circle_picture;
use event_recordings::Recording;

use super::calibrate::LISTENING;
use super::circles_only::circles_of;
use super::output_arguments::OutputArguments;
use super::progress::{Waiting, short_name};
use super::source_arguments::{SourceArguments, command};
use super::{Failure, UsageError, print, value};

/// Arguments of `evcal detect`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recording of events, circle stream of a detector, or the serial port of a detector,
    /// serial:PORT?baud=921600&seconds=10&save=FILE
    recording: PathBuf,
    /// Board to find, for example acircles:9x4:55mm:r17.5mm, or auto; without it, all circles
    #[arg(long, value_parser = super::board_argument::board_request)]
    board: Option<BoardRequest>,
    /// Circle extraction: hard or soft [default: hard]
    #[arg(long, value_parser = super::calibrate::extraction)]
    extraction: Option<Extraction>,
    /// Without a board: smallest number of circles in a window that is written
    #[arg(long, default_value_t = 1, value_name = "COUNT", conflicts_with = "board")]
    fewest: usize,
    /// Settings file (TOML)
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    #[command(flatten)]
    source: SourceArguments,
    /// Circle track to write (CSV)
    #[arg(short, long, value_name = "FILE", value_parser = value::output_file())]
    output: Option<PathBuf>,
    /// Picture to write, of the window with most circles (PNG)
    #[arg(long, value_name = "FILE", value_parser = value::output_file())]
    picture: Option<PathBuf>,
    #[command(flatten)]
    results: OutputArguments,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal detect`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let outputs = arguments.output.iter().chain(&arguments.picture).map(PathBuf::as_path);
    arguments.results.check(outputs, &[&arguments.recording])?;
    if let Some(stream) = open_stream(arguments)? {
        let wanted = wanted(arguments, &[], &DetectionSettings::default())?;
        if let Some(BoardRequest::Given(board)) = &arguments.board {
            circles_of(board)?;
        }
        if arguments.picture.is_some() {
            return Err(UsageError("a circle stream contains no events to draw: leave out --picture".to_owned()).into());
        }
        let found = search_stream(stream, arguments.source.sensor, wanted);
        write(arguments, &found)?;
        return print_report(
            arguments,
            &found,
            format!("{} windows with circles received", found.report.windows),
            None,
        );
    }
    let mut settings = read_settings(arguments.settings.as_deref(), None)?;
    settings.detection.extraction = arguments.extraction.unwrap_or(settings.detection.extraction);
    let recording = open_events(&arguments.recording, arguments.source.options())?;
    let sensor = sensor_of(&recording)?;
    let mut waiting = Waiting::new(arguments.json);
    let stage = format!("searching {}", short_name(&arguments.recording));
    waiting.stage(&stage, None);
    let wanted = wanted(arguments, &[&recording], &settings.detection)?;
    let found = search_events_with_progress(&recording, sensor, wanted, &settings.detection, |done| {
        waiting.stage(&stage, done);
    })?;
    waiting.finish();
    write(arguments, &found)?;
    if let (Some(path), Some(best)) = (&arguments.picture, found.best_window()) {
        circle_picture(best.content, &best.circles, sensor).write_png(path)?;
    }
    let report = &found.report;
    let tried = format!("{} events, {} windows tried", report.events, report.windows);
    let idle = format!("{} windows had too few events to be tried", report.too_few_events);
    print_report(arguments, &found, tried, Some(idle))
}

/// Returns the object of the search. Only the layout of the board matters, not its size.
fn wanted(
    arguments: &Arguments,
    recordings: &[&Recording],
    settings: &DetectionSettings,
) -> Result<SearchFor, Failure> {
    Ok(match &arguments.board {
        Some(BoardRequest::Given(board)) => SearchFor::from(board),
        Some(BoardRequest::Recognise(_)) => {
            let found = recognise_board(recordings, settings)?;
            print::aside(format!("recognised board: {found}"));
            match found {
                Recognised::Circles(layout) => SearchFor::Board(layout.pattern),
                Recognised::Squares(found) => SearchFor::Squares(found.board),
            }
        }
        None => SearchFor::Circles(arguments.fewest),
    })
}

/// Reads a circle stream from its file or serial port; `None` if the recording consists of events.
fn open_stream(arguments: &Arguments) -> Result<Option<CircleStream>, Failure> {
    let path = &arguments.recording;
    if SerialAddress::is_address(path) {
        let address = super::calibrate::serial_address(path)?;
        let mut waiting = Waiting::new(arguments.json);
        let stream = address.receive(|message| waiting.part(LISTENING, message, None));
        waiting.finish();
        return Ok(Some(stream?));
    }
    match InputKind::of(path)? {
        InputKind::CircleStream => Ok(Some(stream::read(path)?)),
        _ => Ok(None),
    }
}

fn write(arguments: &Arguments, found: &FoundCircles) -> super::Outcome {
    Ok(arguments.output.as_deref().map_or(Ok(()), |path| found.write_track(path))?)
}

fn print_report(arguments: &Arguments, found: &FoundCircles, tried: String, idle: Option<String>) -> super::Outcome {
    let report = &found.report;
    if arguments.json {
        return print::pretty(report);
    }
    let kind = if arguments.board.is_some() { "with the board" } else { "with enough circles" };
    let mut text: String = found.notes.iter().map(|note| format!("note: {note}\n")).collect();
    text += &format!("{tried}, {} {kind}\n", report.found);
    text.extend(idle.map(|idle| idle + "\n"));
    for (reason, count) in &report.grids_refused {
        text += &format!("rejected windows: {count} ({reason})\n");
    }
    // Squares are found in pictures, without circles.
    text += &match report.circles {
        0 => format!("{} points on boards", report.board_circles),
        circles => format!("{circles} circles, {} of them on boards", report.board_circles),
    };
    if report.found == 0 {
        let board = arguments.board.as_ref().map(BoardRequest::to_string);
        let rest: Vec<&str> = board.iter().flat_map(|board| ["--board", board]).collect();
        let check = command("check", &arguments.recording, &arguments.source.options(), &rest);
        text += &format!("\nnext: {check}");
    }
    print::line(text)
}

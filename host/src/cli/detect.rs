//! `evcal detect`.

use evcal_core::sensor::Sensor;
use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;

use evcal::board::Board;
use evcal::circles::reference_frame::UnorderedFrame;
use evcal::circles::track::{self};
use evcal::detection::{CircleWindow, DetectionReport, DetectionStage, LARGEST_SENSOR};
use evcal::recording::pass::read_recording;
use evcal::recording::{Recording, RecordingOptions};
use evcal::report::drawing::circle_picture;
use evcal::settings::{Extraction, Settings};
use nalgebra::Vector2;

use super::progress::spinner;
use super::{detector, print};

/// Arguments of `evcal detect`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Recording of events, circle stream of a detector, or its serial port,
    /// serial:PORT?baud=921600&seconds=10&save=FILE
    recording: PathBuf,
    /// Board to look for, for example acircles:9x4:55mm:r17.5mm; without it, circles of any kind
    #[arg(long)]
    board: Option<Board>,
    /// Circle extraction: hard or soft [default: hard]
    #[arg(long, value_parser = super::calibrate::extraction)]
    extraction: Option<Extraction>,
    /// Without a board: fewest circles that make a window worth keeping
    #[arg(long, default_value_t = 1, value_name = "COUNT")]
    fewest: usize,
    /// Settings file (TOML)
    #[arg(long, value_name = "FILE")]
    settings: Option<PathBuf>,
    /// Sensor size, where the recording does not tell it, for example 346x260
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = super::sensor)]
    sensor: Option<Sensor>,
    /// Circle-track file to write (CSV)
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Picture of the window with most circles (PNG)
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Print the report as JSON
    #[arg(long)]
    json: bool,
}

/// Runs `evcal detect`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    if let Some(stream) = detector::open_stream(&arguments.recording, arguments.json)? {
        if arguments.picture.is_some() {
            return Err("a circle stream holds no events to paint: leave out --picture".into());
        }
        let wanted = detector::Wanted {
            board: arguments.board.as_ref(),
            fewest: arguments.fewest,
            sensor: arguments.sensor,
            output: arguments.output.as_deref(),
            json: arguments.json,
        };
        return detector::detect(stream, &wanted);
    }
    let mut settings = arguments.settings.as_deref().map(Settings::read).transpose()?.unwrap_or_default();
    settings.detection.extraction = arguments.extraction.unwrap_or(settings.detection.extraction);
    let options = RecordingOptions { sensor: arguments.sensor, ..RecordingOptions::default() };
    let recording = Recording::new(&arguments.recording, options)?;
    let file = arguments.recording.display();
    let sensor = recording
        .open()?
        .information()
        .sensor
        .ok_or_else(|| format!("{file} does not say how many pixels the sensor has: add --sensor WIDTHxHEIGHT"))?;
    if sensor.width > LARGEST_SENSOR.width || sensor.height > LARGEST_SENSOR.height {
        return Err(
            format!("{file}: the sensor is larger than {} x {}", LARGEST_SENSOR.width, LARGEST_SENSOR.height).into()
        );
    }
    let bar = spinner(arguments.json);
    bar.set_message(format!("searching {file}"));
    let mut stage = match &arguments.board {
        Some(board) => DetectionStage::for_board(&settings.detection, sensor, board.pattern, 0),
        None => DetectionStage::for_circles(&settings.detection, sensor, arguments.fewest),
    };
    let pass = read_recording(&recording, &mut |events| stage.push(events))?;
    bar.finish_and_clear();
    let origin = pass.first;
    let notes = pass.to_report().notes;
    let report = match &arguments.board {
        Some(board) => {
            let (frames, report) = stage.into_frames();
            if let Some(path) = &arguments.output {
                let mut output = BufWriter::new(create(path)?);
                track::write(&mut output, &frames, &board.pattern, origin)?;
            }
            let fullest = frames.iter().rev().max_by_key(|frame| frame.circles.len());
            if let (Some(path), Some(frame)) = (&arguments.picture, fullest) {
                let circles: Vec<(Vector2<f64>, f64)> =
                    frame.circles.iter().map(|circle| (circle.center, circle.radius.unwrap_or(1.0))).collect();
                circle_picture(frame.events().unwrap_or_default(), &circles, sensor).write_png(path)?;
            }
            report
        }
        None => {
            let (windows, report) = stage.into_circles();
            if let Some(path) = &arguments.output {
                let frames: Vec<UnorderedFrame> = windows.iter().map(CircleWindow::to_frame).collect();
                track::write_unordered(&mut BufWriter::new(create(path)?), &frames, origin)?;
            }
            let fullest = windows.iter().rev().max_by_key(|window| window.circles.len());
            if let (Some(path), Some(window)) = (&arguments.picture, fullest) {
                circle_picture(&window.pixels, &window.circles, sensor).write_png(path)?;
            }
            report
        }
    };
    tell(arguments, &report, &notes)
}

fn create(path: &PathBuf) -> Result<File, String> {
    File::create(path).map_err(|error| format!("{}: {error}", path.display()))
}

fn tell(arguments: &Arguments, report: &DetectionReport, notes: &[String]) -> super::Outcome {
    if arguments.json {
        return print::line(serde_json::to_string_pretty(report)?);
    }
    let found = if arguments.board.is_some() { "held the board" } else { "held enough circles" };
    let mut text: String = notes.iter().map(|note| format!("note: {note}\n")).collect();
    text += &format!("{} events, {} windows tried, {} {found}\n", report.events, report.windows, report.found);
    text += &format!("{} windows had too few events to be tried\n", report.too_few_events);
    for (reason, count) in &report.grids_refused {
        text += &format!("{count} windows refused: {reason}\n");
    }
    print::line(format!("{text}{} circles, {} of them on boards", report.circles, report.board_circles))
}

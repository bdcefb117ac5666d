//! `evcal check`.

use std::path::PathBuf;

use evcal_calibrate::advice::Advice;
use evcal_calibrate::check::{Checked, check};
use evcal_calibrate::settings::Settings;
use evcal_calibrate::task::PictureUse;
use evcal_calibrate::task::board_choice::BoardChoiceError;
use evcal_detection::circles::file::open_events;
use evcal_files::remedy::Words;
use evcal_geometry::board::request::{BoardRequest, PrintSize};
use serde::Serialize;

use super::calibrate::{board_in, confirmed};
use super::progress::{Waiting, short_name};
use super::source_arguments::{SourceArguments, command};
use super::{Negative, print};

/// Arguments of `evcal check`.
#[derive(clap::Args)]
pub struct Arguments {
    /// A recording of events
    recording: PathBuf,
    /// Board to look for, for example acircles:9x4:55mm:r17.5mm; without it, or with auto, rows and columns are recognised
    #[arg(long, value_parser = super::board_argument::board_request)]
    board: Option<BoardRequest>,
    #[command(flatten)]
    source: SourceArguments,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

/// The result of a check, and the next step.
#[derive(Serialize)]
struct WithNext {
    #[serde(flatten)]
    checked: Checked,
    next: String,
}

/// Runs `evcal check`.
pub fn run(arguments: &Arguments) -> super::Outcome {
    let recording = open_events(&arguments.recording, arguments.source.options())?;
    let mut waiting = Waiting::new(arguments.json);
    waiting.stage(&format!("examining {}", short_name(&arguments.recording)), None);
    let settings = Settings::default();
    let board = match &arguments.board {
        // The result names the lengths to measure.
        None | Some(BoardRequest::Recognise(PrintSize::Unknown)) => None,
        Some(request) => {
            let files = std::slice::from_ref(&arguments.recording);
            let board = board_in(request, files, recording.options(), &settings.detection)?;
            match confirmed(&board, &[&recording], PictureUse::default(), &settings.detection) {
                // The result of the check describes another board.
                Err(BoardChoiceError::Other { .. }) => Some(board.into()),
                confirmed => Some(confirmed?),
            }
        }
    };
    let (board, of_board) = board.map_or((None, None), |stated| (Some(stated.board), stated.finding));
    let checked = check(&recording, board.as_ref(), of_board.as_ref(), &settings.detection, &settings.frames)?;
    waiting.finish();
    let next = match &checked.next {
        Advice::Calibrate { recording, options, board } => {
            command("calibrate", recording, options, &["--board", board, "-o", "calibration"])
        }
        next => next.worded(&Words::PROGRAM),
    };
    let is_ready = checked.is_ready();
    match arguments.json {
        true => print::json(&WithNext { checked, next })?,
        false => print::line(format!("{checked}\nnext: {next}"))?,
    }
    if is_ready { Ok(()) } else { Err(Negative::Recording.into()) }
}

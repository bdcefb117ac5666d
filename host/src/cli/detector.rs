//! Detectors elsewhere, whose circle streams come from a file or a serial port.

use evcal_core::sensor::Sensor;
use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use evcal::board::Board;
use evcal::calibrate::input::Input;
use evcal::circles::serial::SerialAddress;
use evcal::circles::stream::{self, CircleStream};
use evcal::circles::track::{self, CircleFrames};
use evcal::detection::{DetectionReport, order_frames};
use evcal::recording::{RecordingKind, RecordingOptions, sniff};

use super::progress::spinner;
use super::{UsageError, print};

/// Opens a recording, or listens to a serial port. What comes from a port is saved to `folder` unless its
/// address says where, so that a calibration that fails can be tried again.
pub fn open_input(
    path: &Path,
    options: &RecordingOptions,
    board: &Board,
    folder: &Path,
    silent: bool,
) -> Result<Input, Box<dyn Error>> {
    if !SerialAddress::is_address(path) {
        return Ok(Input::open(path, options, board)?);
    }
    let mut address = address(path)?;
    if address.save.is_none() {
        std::fs::create_dir_all(folder).map_err(|error| format!("{}: {error}", folder.display()))?;
        let port = address.port.rsplit(['/', '\\']).next().unwrap_or_default();
        address.save = Some(folder.join(format!("{port}.circles")));
    }
    let bar = spinner(silent);
    let input = Input::listen(&address, board, |message| bar.set_message(message.to_owned()));
    bar.finish_and_clear();
    Ok(input?)
}

/// The circle stream that `path` is; `None` if it is a recording.
pub fn open_stream(path: &Path, silent: bool) -> Result<Option<CircleStream>, Box<dyn Error>> {
    if SerialAddress::is_address(path) {
        let bar = spinner(silent);
        let stream = address(path)?.receive(|message| bar.set_message(message.to_owned()));
        bar.finish_and_clear();
        return Ok(Some(stream?));
    }
    match sniff(path)? {
        RecordingKind::CircleStream => Ok(Some(stream::read(path)?)),
        _ => Ok(None),
    }
}

fn address(path: &Path) -> Result<SerialAddress, UsageError> {
    path.to_string_lossy().parse().map_err(|error: evcal::circles::serial::SerialError| UsageError(error.to_string()))
}

/// What `evcal detect` is to find in a stream, and where to write it.
pub struct Wanted<'a> {
    /// The board; without it, windows with circles.
    pub board: Option<&'a Board>,
    /// Without a board: fewest circles of a window.
    pub fewest: usize,
    /// Sensor size, if the user gives it.
    pub sensor: Option<Sensor>,
    /// Circle track to write.
    pub output: Option<&'a Path>,
    /// Print the report as JSON.
    pub json: bool,
}

/// The device has found the circles; what is left is the board.
pub fn detect(stream: CircleStream, wanted: &Wanted) -> super::Outcome {
    let CircleStream { track, sensor, .. } = stream;
    let (origin, notes) = (track.time_origin_us, track.notes);
    let CircleFrames::Unordered(frames) = track.frames else { return Ok(()) };
    let create = |path: &Path| File::create(path).map_err(|error| format!("{}: {error}", path.display()));
    let mut output = wanted.output.map(create).transpose()?.map(BufWriter::new);
    let report = match wanted.board {
        Some(board) => {
            let (ordered, report) = order_frames(&frames, &board.pattern, wanted.sensor.or(sensor));
            if let Some(output) = &mut output {
                track::write(output, &ordered, &board.pattern, origin)?;
            }
            report
        }
        None => {
            let enough: Vec<_> = frames.iter().filter(|frame| frame.circles.len() >= wanted.fewest).collect();
            if let Some(output) = &mut output {
                track::write_unordered(output, enough.iter().copied(), origin)?;
            }
            DetectionReport {
                windows: frames.len() as u64,
                found: enough.len() as u64,
                circles: track.circles as u64,
                ..DetectionReport::default()
            }
        }
    };
    if wanted.json {
        return print::line(serde_json::to_string_pretty(&report)?);
    }
    for note in notes {
        print::line(format!("note: {note}"))?;
    }
    let found = if wanted.board.is_some() { "held the board" } else { "held enough circles" };
    print::line(format!("{} windows with circles came, {} {found}", report.windows, report.found))?;
    for (reason, count) in &report.grids_refused {
        print::line(format!("{count} windows refused: {reason}"))?;
    }
    print::line(format!("{} circles, {} of them on boards", report.circles, report.board_circles))
}

//! Files of a failed calibration: the reason, the stages reached, the detections, and a picture.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::report::drawing::circle_picture;
use evcal_calibrate::calibrate::Task;
use evcal_calibrate::calibrate::error::CalibrateError;
use evcal_calibrate::calibrate::input::Input;
use evcal_calibrate::detection::DetectionReport;
use evcal_calibrate::detection::search::{FoundCircles, SearchFor, search_events, sensor_of};
use evcal_files::FileError;

/// File name of the text.
pub const TEXT: &str = "failure.txt";
/// File name of the picture of the window with most circles.
pub const PICTURE: &str = "failure.png";

/// A calibration that failed.
#[derive(Clone, Debug, Serialize)]
pub struct Failure {
    /// The error.
    pub error: String,
    /// The stages that were started, in order; the last one failed.
    pub stages: Vec<String>,
    /// Detections of the board, or of circles if no board was found; `None` if the recording was not searched.
    pub seen: Option<Seen>,
    /// Files with further information.
    pub files: Vec<PathBuf>,
}

/// Detections in a recording.
#[derive(Clone, Debug, Serialize)]
pub struct Seen {
    /// The recording.
    pub file: String,
    /// Number of windows by result.
    pub windows: DetectionReport,
    /// Circles in the window with most of them.
    pub most_circles: usize,
}

/// Returns `true` if a file of a folder, given by its path in it, is one that [`write_failure`] writes.
pub fn is_failure(file: &Path) -> bool {
    [TEXT, PICTURE].iter().any(|name| Path::new(name) == file)
}

/// Describes a failed calibration, and writes the detections, if there are any, into `folder`. `why` is the error in
/// the words of the program.
///
/// # Errors
/// [`FileError`] names the file that could not be written.
pub fn write_failure(
    folder: &Path,
    task: &Task,
    error: &CalibrateError,
    why: String,
    stages: Vec<String>,
) -> Result<Failure, FileError> {
    let mut failure = Failure { error: why, stages, seen: None, files: Vec::new() };
    if !error.is_of_what_was_seen() {
        return Ok(failure);
    }
    let found = task.inputs.iter().find_map(|input| look_again(input, task, error));
    if let Some((file, found, picture)) = found {
        let most_circles = found.best_window().map_or(0, |window| window.circles.len());
        let windows = match error {
            // The report of the search for the board contains the reason, not just the circles found.
            CalibrateError::NoPattern(nowhere) => nowhere.report().clone(),
            _ => found.report,
        };
        failure.seen = Some(Seen { file, windows, most_circles });
        if let Some(picture) = picture {
            let path = folder.join(PICTURE);
            evcal_files::write(&path, &picture)?;
            failure.files.push(path);
        }
    }
    let path = folder.join(TEXT);
    failure.files.insert(0, path.clone());
    evcal_files::write(&path, text(&failure, task).as_bytes())?;
    Ok(failure)
}

/// Searches for the board again, or for circles if no board was found, and draws the window with most of them.
fn look_again(input: &Input, task: &Task, error: &CalibrateError) -> Option<(String, FoundCircles, Option<Vec<u8>>)> {
    let Input::Events(recording) = input else { return None };
    let wanted = match error {
        CalibrateError::NoPattern(_) if task.board.circles().is_some() => SearchFor::Circles(1),
        _ => SearchFor::from(task.board),
    };
    // A recording that can no longer be read is not searched.
    let sensor = sensor_of(recording).ok()?;
    let found = search_events(recording, sensor, wanted, &task.settings.detection).ok()?;
    let picture =
        found.best_window().and_then(|best| circle_picture(best.content, &best.circles, sensor).to_png().ok());
    Some((input.name(), found, picture))
}

fn text(failure: &Failure, task: &Task) -> String {
    let mut text = format!("evcal {}\n", crate::VERSION);
    if !task.command_line.is_empty() {
        let _ = writeln!(text, "{}", task.command_line);
    }
    let _ = writeln!(text, "\nfailed: {}\n\nwhat was done, up to the failure:", failure.error);
    for stage in &failure.stages {
        let _ = writeln!(text, "  {stage}");
    }
    if let Some(Seen { file, windows, most_circles }) = &failure.seen {
        let _ = writeln!(text, "\nwhat was seen in {file}, board {}:", task.board);
        let tried = windows.windows;
        let _ = writeln!(text, "  {} events, {tried} windows tried, {} with the board", windows.events, windows.found);
        let _ = writeln!(text, "  {} circles, {most_circles} in the window with most", windows.circles);
        if windows.too_few_events > 0 {
            let _ = writeln!(text, "  {} windows had too few events to be tried", windows.too_few_events);
        }
        for (reason, count) in &windows.grids_refused {
            let _ = writeln!(text, "  {count} windows refused: {reason}");
        }
        for (reason, count) in &windows.pairs_refused {
            let _ = writeln!(text, "  {count} pairs of clusters are no circle: {reason}");
        }
    }
    if failure.files.iter().any(|file| file.ends_with(PICTURE)) {
        let _ = writeln!(text, "\n{PICTURE}: that window, its events in red (ON) and blue (OFF), its circles in black");
    }
    text
}

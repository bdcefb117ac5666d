//! The files that a failed calibration writes: the error, the stages that it reached, what was found in the recording,
//! and a picture.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::report::drawing::circle_picture;
use evcal_calibrate::task::Task;
use evcal_calibrate::task::error::CalibrateError;
use evcal_calibrate::task::input::Input;
use evcal_detection::detection::DetectionReport;
use evcal_detection::detection::search::{FoundCircles, SearchFor, search_events, sensor_of};
use evcal_files::FileError;

/// File with the text.
pub const TEXT: &str = "failure.txt";
/// File with a picture of the window with most circles.
pub const PICTURE: &str = "failure.png";

/// A calibration that failed.
#[derive(Clone, Debug, Serialize)]
pub struct Failure {
    /// The error in words.
    pub error: String,
    /// Stages in their order; the last one failed.
    pub stages: Vec<String>,
    /// Detections in the first recording; `None` if the error does not depend on the content of recordings.
    pub seen: Option<Seen>,
    /// Files with more details.
    pub files: Vec<PathBuf>,
}

/// Detections in a recording.
#[derive(Clone, Debug, Serialize)]
pub struct Seen {
    /// The recording.
    pub file: String,
    /// Counts of windows with the board, and of the others by reason.
    pub windows: DetectionReport,
    /// Number of circles in the window with most circles.
    pub most_circles: usize,
}

/// Returns `true` if [`write_failure`] writes a file with this path inside its folder.
pub fn is_failure(file: &Path) -> bool {
    [TEXT, PICTURE].iter().any(|name| Path::new(name) == file)
}

/// Describes a failed calibration, and writes the description into `folder` if the error depends on what the recordings
/// show. `why` is the error in the words of the program.
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
    if !error.is_explained_by_content() {
        return Ok(failure);
    }
    if let (CalibrateError::NoPattern(nowhere), None, Some(input)) = (error, task.board.circles(), task.inputs.first())
    {
        // Another search for a board of squares would take long and find nothing either.
        failure.seen = Some(Seen { file: input.name(), windows: nowhere.report().clone(), most_circles: 0 });
    } else if let Some((file, found, picture)) = task.inputs.iter().find_map(|input| search_again(input, task, error)) {
        let most_circles = found.best_window().map_or(0, |window| window.circles.len());
        let windows = match error {
            // The search for the board explains the failure; the second search was for single circles.
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

/// Searches the recording once more, for the board, or for circles if the board was not found, and draws the window with most circles.
fn search_again(input: &Input, task: &Task, error: &CalibrateError) -> Option<(String, FoundCircles, Option<Vec<u8>>)> {
    let Input::Events(recording) = input else { return None };
    let wanted = match error {
        CalibrateError::NoPattern(_) if task.board.circles().is_some() => SearchFor::Circles(1),
        _ => SearchFor::from(task.board),
    };
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
    let _ = writeln!(text, "\nfailed: {}\n\nstages up to the failure:", failure.error);
    for stage in &failure.stages {
        let _ = writeln!(text, "  {stage}");
    }
    if let Some(Seen { file, windows, most_circles }) = &failure.seen {
        let _ = writeln!(text, "\nfound in {file} with the board {}:", task.board);
        let tried = windows.windows;
        let _ = writeln!(text, "  {} events, {tried} windows tried, {} with the board", windows.events, windows.found);
        let _ = writeln!(text, "  {} circles, at most {most_circles} per window", windows.circles);
        if windows.too_few_events > 0 {
            let _ = writeln!(text, "  {} windows had too few events to be tried", windows.too_few_events);
        }
        for (reason, count) in &windows.grids_refused {
            let _ = writeln!(text, "  rejected windows: {count} ({reason})");
        }
        for (reason, count) in &windows.pairs_refused {
            let _ = writeln!(text, "  {count} pairs of clusters are not circles: {reason}");
        }
    }
    if failure.files.iter().any(|file| file.ends_with(PICTURE)) {
        let _ = writeln!(
            text,
            "\n{PICTURE}: the window with most circles: ON events in blue, OFF events in orange, circles in black"
        );
    }
    text
}

//! The folder that a calibration writes.

use std::fmt::Write as _;
use std::io;
use std::path::{Path, PathBuf};

use super::summary::summary;
use crate::board::Board;
use crate::calibrate::Task;
use crate::calibrate::calibrated::{Calibrated, Evidence};
use crate::calibrate::input::Input;
use crate::circles::reference_frame::ReferenceFrame;
use crate::circles::track;
use crate::export::content::ExportFormat;
use crate::export::{kalibr, opencv, ros};
use crate::initial::PosedFrame;
use crate::recording::pictures::image_at;
use crate::report::drawing::{Picture, grey_frame_picture, reference_frame_picture};
use crate::report::report;
use crate::result::calibrated_camera::CalibratedCamera;
use crate::result::calibration_file::CalibrationFile;
use crate::result::stage_report::stage_report;
use crate::trajectory::Trajectory;
use crate::trajectory::timed_pose::TimedPose;
use crate::trajectory::tum;

/// Rate at which trajectories are written (Hz).
pub const TRAJECTORY_RATE: f64 = 200.0;

/// Folder of files for other programs.
const EXPORTS: &str = "exports";

/// Formats that every calibration is written in, and the folder of each; `evcal export` writes the others.
const FOR_OTHERS: &[(ExportFormat, &str)] = &[(opencv::YAML, ""), (ros::FORMAT, EXPORTS), (kalibr::FORMAT, EXPORTS)];

/// What was written, for the terminal.
pub struct Written {
    /// The content of `calibration.json`.
    pub json: String,
    /// A few lines with the result.
    pub summary: String,
    /// What every stage took in and gave out.
    pub stage_report: String,
}

/// A result file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{file}: {error}")]
pub struct OutputError {
    file: String,
    error: io::Error,
}

/// Writes `calibration.json`, `camera.yaml`, `exports` (ROS and Kalibr), `trajectory.txt`, `settings.toml`,
/// `circles.csv`, `stages.txt`, `report.html` and pictures of a good and a bad reference frame into `folder`, which is created. Of
/// several recordings, each has its own clock: those after the first have their own `trajectory-2.txt`,
/// `circles-2.csv` and so on.
///
/// # Errors
/// [`OutputError`] names the file that could not be written.
pub fn write_folder(folder: &Path, calibrated: &Calibrated, task: &Task) -> Result<Written, OutputError> {
    let put = |path: PathBuf, content: &[u8]| {
        std::fs::write(&path, content).map_err(|error| OutputError { file: path.display().to_string(), error })
    };
    std::fs::create_dir_all(folder).map_err(|error| OutputError { file: folder.display().to_string(), error })?;
    let calibration = CalibrationFile::new(calibrated, task.board);
    let json = serde_json::to_string_pretty(&calibration)
        .map_err(|error| OutputError { file: "calibration.json".to_owned(), error: error.into() })?;
    let stage_report = stage_report(calibrated);
    let mut summary = summary(&calibration);
    put(folder.join("calibration.json"), json.as_bytes())?;
    put(folder.join("settings.toml"), task.settings.to_toml().as_bytes())?;
    put(folder.join("stages.txt"), stage_report.as_bytes())?;
    put(folder.join("report.html"), report(calibrated, task).as_bytes())?;
    let mut circles = Vec::new();
    for (recording, start) in calibrated.starts.iter().enumerate() {
        let of_recording = |name: &str, extension: &str| match recording {
            0 => format!("{name}.{extension}"),
            _ => format!("{name}-{}.{extension}", recording + 1),
        };
        let name = of_recording("trajectory", "txt");
        let poses =
            trajectory(calibrated, recording, *start).map_err(|error| OutputError { file: name.clone(), error })?;
        put(folder.join(name), &poses)?;
        let frames = calibrated.frames().iter().filter(|frame| frame.recording == recording);
        let name = of_recording("circles", "csv");
        circles.clear();
        track::write(&mut circles, frames, &task.board.pattern, (start * 1e6).round() as i64)
            .map_err(|error| OutputError { file: name.clone(), error })?;
        put(folder.join(name), &circles)?;
    }
    let pictures = match &calibrated.evidence {
        Evidence::Events(_) => window_examples(calibrated, task.board),
        Evidence::Pictures(_) => picture_examples(calibrated, task),
    };
    for (name, picture) in pictures {
        let path = folder.join(name);
        picture.write_png(&path).map_err(|error| OutputError { file: path.display().to_string(), error })?;
    }
    let camera = CalibratedCamera::new(calibrated, task.board);
    let exports = Path::new(EXPORTS);
    std::fs::create_dir_all(folder.join(exports))
        .map_err(|error| OutputError { file: folder.join(exports).display().to_string(), error })?;
    for (format, place) in FOR_OTHERS {
        let name = if *place == EXPORTS { exports.join(format.file) } else { format.file.into() };
        match format.export(&camera) {
            Ok(exported) => {
                put(folder.join(&name), exported.text.as_bytes())?;
                if let Some(refit) = exported.refit {
                    let _ = write!(summary, "\n{}: {refit}", name.display());
                }
            }
            Err(error) => {
                let _ = write!(summary, "\nno {}: {error}", name.display());
            }
        }
    }
    Ok(Written { json, summary, stage_report })
}

/// The reference frames with the smallest and the largest error of the initial model.
fn window_examples(calibrated: &Calibrated, board: &Board) -> Vec<(&'static str, Picture)> {
    best_and_worst(calibrated.posed().filter(|(_, frame)| frame.events().is_some()), |posed, frame| {
        Some(reference_frame_picture(frame, calibrated.sensor, board, calibrated.camera(), &posed.pose))
    })
}

/// The camera's own pictures with the smallest and the largest error, as far as they can be read again.
fn picture_examples(calibrated: &Calibrated, task: &Task) -> Vec<(&'static str, Picture)> {
    best_and_worst(calibrated.posed(), |posed, frame| {
        let Some(Input::Events(recording)) = task.inputs.get(frame.recording) else { return None };
        let exposure = (calibrated.starts.get(frame.recording)? + frame.start) * 1e6;
        let picture = image_at(recording, exposure.round() as i64)?;
        let image = (picture.image.as_ref().ok()?, picture.position);
        Some(grey_frame_picture(image, frame, calibrated.sensor, task.board, calibrated.camera(), &posed.pose))
    })
}

/// Draws the frames with the smallest and the largest error.
fn best_and_worst<'a>(
    frames: impl Iterator<Item = (&'a PosedFrame, &'a ReferenceFrame)>,
    draw: impl Fn(&PosedFrame, &ReferenceFrame) -> Option<Picture>,
) -> Vec<(&'static str, Picture)> {
    let mut ranked: Vec<_> = frames.collect();
    ranked.sort_by(|a, b| a.0.rms.total_cmp(&b.0.rms));
    let named = [("good-frame.png", ranked.first()), ("bad-frame.png", ranked.last())];
    named
        .into_iter()
        .filter_map(|(name, frame)| frame.and_then(|(posed, frame)| Some((name, draw(posed, frame)?))))
        .collect()
}

/// The poses of one recording, which begins at `start` seconds of its own clock: along the trajectories, or those of
/// the pictures.
fn trajectory(calibrated: &Calibrated, recording: usize, start: f64) -> io::Result<Vec<u8>> {
    let poses: Vec<TimedPose> = match &calibrated.evidence {
        Evidence::Events(events) => {
            let of_recording = events.refined.state.trajectories.iter().filter(|one| one.recording == recording);
            of_recording.flat_map(|trajectory| sampled(trajectory, start)).collect()
        }
        Evidence::Pictures(_) => calibrated
            .posed()
            .filter(|(_, frame)| frame.recording == recording)
            .map(|(posed, frame)| TimedPose { t: frame.t() + start, pose: posed.pose })
            .collect(),
    };
    let mut text = Vec::new();
    tum::write(&mut text, &poses)?;
    Ok(text)
}

fn sampled(trajectory: &Trajectory, start: f64) -> impl Iterator<Item = TimedPose> {
    let first = (trajectory.start() * TRAJECTORY_RATE).ceil() as i64;
    let last = (trajectory.end() * TRAJECTORY_RATE).floor() as i64;
    (first..=last).filter_map(move |step| {
        let t = step as f64 / TRAJECTORY_RATE;
        trajectory.pose(t).map(|pose| TimedPose { t: t + start, pose })
    })
}

//! Writes the folder of a calibration.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::failure::is_failure;
use super::input_files::input_files;
use super::summary::Summary;
use crate::report::drawing::{Picture, grey_frame_picture, reference_frame_picture};
use crate::report::{ResultFile, Sections, sections};
use evcal_calibrate::calibrate::calibrated::{Calibrated, Evidence};
use evcal_calibrate::export::content::ExportFormat;
use evcal_calibrate::export::{inertial, kalibr, opencv, ros, second_camera};
use evcal_calibrate::picture_calibration::calibration::PictureSource;
use evcal_calibrate::quality::poses::{PoseSettings, UncertainPose, csv, determined, sampled_poses};
use evcal_calibrate::result::calibrated_camera::CalibratedCamera;
use evcal_calibrate::result::calibration_file::{CalibrationFile, InputFile};
use evcal_calibrate::result::stage_report::stage_report;
use evcal_calibrate::task::Task;
use evcal_calibrate::task::input::Input;
use evcal_calibrate::task::step::Step;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::circles::track::{self, TrackSource};
use evcal_files::FileError;
use evcal_files::folder::{FolderError, OutputFolder};
use evcal_files::remedies;
use evcal_geometry::board::Board;
use evcal_geometry::timed_pose::TimedPose;
use evcal_geometry::tum;
use evcal_solve::initial::PosedFrame;
use event_recordings::RecordingError;

/// Subfolder with the files for other programs.
const EXPORTS: &str = "exports";
/// Subfolders of a result.
pub const FOLDERS: &[&str] = &[EXPORTS];

/// Formats that every calibration is exported to, with the subfolder of each. The other formats are exported on demand.
const FOR_OTHERS: &[(ExportFormat, &str)] = &[(opencv::YAML, ""), (ros::FORMAT, EXPORTS), (kalibr::FORMAT, EXPORTS)];

/// Files that a result has once, whatever the number of recordings.
const FILES: [&str; 6] =
    ["calibration.json", "settings.toml", "stages.txt", "report.html", "good-frame.png", "bad-frame.png"];
/// Name and extension of the poses of a recording; from the second recording on, a number is in between.
const TRAJECTORY: (&str, &str) = ("trajectory", "txt");
/// Name and extension of the file with the same poses and their standard deviations.
const POSES: (&str, &str) = ("trajectory", "csv");
/// Name and extension of the circles of a recording.
const CIRCLES: (&str, &str) = ("circles", "csv");

/// Text about a written result, for a terminal.
pub struct Written {
    /// The content of `calibration.json`, on one line.
    pub json: String,
    /// The result in words.
    pub summary: Summary,
    /// Input, output and rejected data of each stage.
    pub stage_report: String,
}

/// Returns `true` if [`write_folder`] writes a file with this path inside its folder.
pub fn is_result(file: &Path) -> bool {
    let numbered = |name: &str, extension: &str| {
        let rest = file.to_str().and_then(|file| file.strip_prefix(name)?.strip_suffix(extension)?.strip_suffix('.'));
        rest.is_some_and(|rest| {
            let number = rest.strip_prefix('-').unwrap_or(rest);
            number.len() + 1 >= rest.len() && number.chars().all(|digit| digit.is_ascii_digit())
        })
    };
    FILES.iter().any(|name| Path::new(name) == file)
        || FOR_OTHERS.iter().any(|(format, place)| Path::new(place).join(format.file) == file)
        || inertial::names().any(|name| Path::new(EXPORTS).join(name) == file)
        || file.strip_prefix(EXPORTS).is_ok_and(|name| name.to_str().is_some_and(second_camera::is_file))
        || numbered(TRAJECTORY.0, TRAJECTORY.1)
        || numbered(POSES.0, POSES.1)
        || numbered(CIRCLES.0, CIRCLES.1)
}

/// Reasons why a result was not written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum WriteError {
    /// The folder cannot be used.
    #[error("{0}")]
    Folder(#[from] FolderError),
    /// A file cannot be written.
    #[error("{0}")]
    File(#[from] FileError),
}

remedies! { WriteError, say;
    Self::Folder(error) => error.remedy(say);
}

/// Writes the result of `task` as [`write_folder`] does, into a folder without an earlier result.
///
/// # Errors
/// [`WriteError`] if the folder contains a result, or a file cannot be written.
pub fn write_new_folder(folder: impl AsRef<Path>, calibrated: &Calibrated, task: &Task) -> Result<Written, WriteError> {
    let folder = OutputFolder::open_new(folder.as_ref(), is_result)?;
    folder.check_paths(is_result, FOLDERS)?;
    Ok(write_folder(&folder, calibrated, task, &mut |_| {})?)
}

/// Writes `calibration.json`, `camera.yaml`, `exports` (ROS and Kalibr), `trajectory.txt`, `trajectory.csv`,
/// `settings.toml`, `circles.csv`, `stages.txt`, `report.html` and pictures of a good and a bad reference frame into
/// `folder`, and removes the files of earlier results and failures from it. Each recording has its own clock: from the
/// second on, a recording has its own `trajectory-2.txt`, `circles-2.csv` and so on. `progress` receives the progress
/// of the report, which takes most of the time.
///
/// # Errors
/// [`FileError`] names the file that could not be written.
pub fn write_folder(
    folder: &OutputFolder,
    calibrated: &Calibrated,
    task: &Task,
    progress: &mut (dyn FnMut(Step) + Send),
) -> Result<Written, FileError> {
    let mut report_progress = |done| progress(Step { text: "report", done: Some(done) });
    folder.replace(
        |file| is_result(file) || is_failure(file),
        |folder| {
            let (written, sections) = rayon::join(
                || write_files(folder, calibrated, task),
                || sections(calibrated, task, &mut report_progress),
            );
            let (written, inputs) = written?;
            write_report(folder, sections, &inputs)?;
            Ok(written)
        },
    )
}

fn write_report(folder: &Path, sections: Sections, inputs: &[InputFile]) -> Result<(), FileError> {
    evcal_files::write(&folder.join("report.html"), sections.finish(inputs, &results_in(folder)).as_bytes())
}

/// Writes all files except the report; returns the text for a terminal, and the files that the calibration was made from.
fn write_files(folder: &Path, calibrated: &Calibrated, task: &Task) -> Result<(Written, Vec<InputFile>), FileError> {
    let put = |path: PathBuf, content: &[u8]| evcal_files::write(&path, content);
    let calibration = CalibrationFile {
        command: (!task.command_line.is_empty()).then(|| task.command_line.to_owned()),
        input_files: input_files(calibrated, task).map_err(changed)?,
        ..CalibrationFile::new(calibrated, task.board, task.words)
    };
    let failed = |error: serde_json::Error| FileError::new(&folder.join("calibration.json"), error.into());
    let json = serde_json::to_string(&calibration).map_err(failed)?;
    let stage_report = stage_report(calibrated);
    let mut notes = Vec::new();
    put(folder.join("calibration.json"), serde_json::to_string_pretty(&calibration).map_err(failed)?.as_bytes())?;
    put(folder.join("settings.toml"), task.settings.to_commented_toml().as_bytes())?;
    put(folder.join("stages.txt"), stage_report.as_bytes())?;
    let mut distances = None;
    for (recording, start) in calibrated.starts.iter().enumerate() {
        let of_recording = |(name, extension): (&str, &str)| match recording {
            0 => format!("{name}.{extension}"),
            _ => format!("{name}-{}.{extension}", recording + 1),
        };
        let poses = poses(calibrated, recording, *start, &task.settings.poses);
        let determined: Vec<TimedPose> = match &calibrated.evidence {
            Evidence::Events(_) => determined(&poses).collect(),
            Evidence::Pictures(_) => poses.iter().map(|pose| pose.pose).collect(),
        };
        distances = determined.iter().map(|pose| distance(pose, task.board)).fold(distances, nearest_and_farthest);
        evcal_files::write_with(&folder.join(of_recording(TRAJECTORY)), |file| {
            tum::write(file, "T_world_camera", &determined)
        })?;
        if calibrated.events().is_some() {
            evcal_files::write_with(&folder.join(of_recording(POSES)), |file| csv::write(file, &poses))?;
        }
        if 2 * determined.len() < poses.len() {
            let (certain, all) = (of_recording(TRAJECTORY), of_recording(POSES));
            let (kept, count) = (determined.len(), poses.len());
            notes.push(format!(
                "{certain} contains {kept} of {count} poses; the others are too uncertain. {all} contains all"
            ));
        }
        let frames = frames(calibrated, recording);
        let source = TrackSource { sensor: Some(calibrated.sensor), time_origin_us: (start * 1e6).round() as i64 };
        evcal_files::write_with(&folder.join(of_recording(CIRCLES)), |file| {
            track::write(file, frames, &task.board.lattice(), source)
        })?;
    }
    match &calibrated.evidence {
        Evidence::Pictures(pictures) if pictures.report.source == PictureSource::Frames => {
            write_picture_examples(folder, calibrated, task)?;
        }
        Evidence::Events(_) | Evidence::Pictures(_) => write_window_examples(folder, calibrated, task.board)?,
    }
    let camera = CalibratedCamera::new(calibrated, task.board);
    let exports = Path::new(EXPORTS);
    let place = folder.join(exports);
    std::fs::create_dir_all(&place).map_err(|error| FileError::new(&place, error))?;
    for (format, place) in FOR_OTHERS {
        let name = if *place == EXPORTS { exports.join(format.file) } else { format.file.into() };
        match format.export(&camera) {
            Ok(exported) => {
                put(folder.join(&name), exported.text.as_bytes())?;
                if let Some(note) = exported.note {
                    notes.push(format!("{}: {note}", name.display()));
                }
            }
            Err(error) => {
                notes.push(format!("no {}: {error}", name.display()));
            }
        }
    }
    for (name, text) in
        calibration.inertial.iter().flat_map(|unit| inertial::files(&camera, unit, &calibration.second_cameras))
    {
        put(folder.join(exports).join(name), text.as_bytes())?;
    }
    match second_camera::files(&camera, &calibration.second_cameras) {
        Ok(files) => {
            for (name, text) in files {
                put(folder.join(exports).join(name), text.as_bytes())?;
            }
        }
        Err(error) => {
            notes.push(format!("no exports for several cameras: {error}"));
        }
    }
    let distances = distances.map(|(nearest, farthest)| nearest..=farthest);
    let summary = Summary::new(&calibration, distances, notes);
    let CalibrationFile { input_files, .. } = calibration;
    Ok((Written { json, summary, stage_report }, input_files))
}

/// Converts an error about an input.
fn changed(error: RecordingError) -> FileError {
    FileError::new(&error.path, std::io::Error::other(error.kind))
}

/// Lists the result files in `folder`, sorted by name.
pub fn results_in(folder: &Path) -> Vec<ResultFile> {
    let entries = [PathBuf::new(), EXPORTS.into()].into_iter().flat_map(|place| {
        let entries = std::fs::read_dir(folder.join(&place)).into_iter().flatten().flatten();
        entries.map(move |entry| (place.join(entry.file_name()), entry.metadata()))
    });
    let results = entries.filter(|(name, _)| is_result(name)).filter_map(|(name, metadata)| {
        let name = name.to_str()?.replace(std::path::MAIN_SEPARATOR, "/");
        Some(ResultFile { name, length: metadata.ok()?.len() })
    });
    let mut results: Vec<ResultFile> = results.collect();
    results.sort_by(|a, b| a.name.cmp(&b.name));
    results
}

/// Returns the distance of the camera from the centre of the board in metres.
fn distance(pose: &TimedPose, board: &Board) -> f64 {
    (pose.pose.translation.vector - board.middle().push(0.0)).norm()
}

fn nearest_and_farthest(known: Option<(f64, f64)>, distance: f64) -> Option<(f64, f64)> {
    let (nearest, farthest) = known.unwrap_or((distance, distance));
    Some((nearest.min(distance), farthest.max(distance)))
}

/// Writes pictures of the reference frames with the smallest and the largest error of the initial model.
fn write_window_examples(folder: &Path, calibrated: &Calibrated, board: &Board) -> Result<(), FileError> {
    write_best_and_worst(folder, calibrated.posed().filter(|(_, frame)| frame.is_shown()), |posed, frame| {
        let pose = calibrated.best_pose(posed, frame);
        Some(reference_frame_picture(frame, calibrated.sensor, board, calibrated.camera(), &pose))
    })
}

/// Writes the camera's own pictures with the smallest and the largest error, if they can be read again.
fn write_picture_examples(folder: &Path, calibrated: &Calibrated, task: &Task) -> Result<(), FileError> {
    write_best_and_worst(folder, calibrated.posed(), |posed, frame| {
        let Some(Input::Events(recording)) = task.inputs.get(frame.recording) else { return None };
        let exposure = (calibrated.starts.get(frame.recording)? + frame.start) * 1e6;
        let picture = recording.image_at(exposure.round() as i64)?;
        let (image, position) = (picture.image.as_ref().ok()?, picture.position);
        let (sensor, camera) = (calibrated.sensor, calibrated.camera());
        Some(grey_frame_picture(image, position, frame, sensor, task.board, camera, &posed.pose))
    })
}

/// Draws the frames with the smallest and the largest error, and writes them one after the other, because such pictures are large.
fn write_best_and_worst<'a>(
    folder: &Path,
    frames: impl Iterator<Item = (&'a PosedFrame, &'a ReferenceFrame)>,
    draw: impl Fn(&PosedFrame, &ReferenceFrame) -> Option<Picture>,
) -> Result<(), FileError> {
    let mut ranked: Vec<_> = frames.collect();
    ranked.sort_by(|a, b| a.0.rms.total_cmp(&b.0.rms));
    for (name, frame) in [("good-frame.png", ranked.first()), ("bad-frame.png", ranked.last())] {
        if let Some(picture) = frame.and_then(|(posed, frame)| draw(posed, frame)) {
            picture.write_png(&folder.join(name))?;
        }
    }
    Ok(())
}

/// Returns all frames of one recording in the order of time.
fn frames(calibrated: &Calibrated, recording: usize) -> impl Iterator<Item = Cow<'_, ReferenceFrame>> {
    let others = calibrated.events().map_or(&[][..], |events| &events.other_windows);
    let mut others = others.iter().filter(move |window| window.recording == recording).peekable();
    let mut frames = calibrated.frames().iter().filter(move |frame| frame.recording == recording).peekable();
    std::iter::from_fn(move || {
        let other = others.next_if(|other| frames.peek().is_none_or(|frame| other.start < frame.start));
        other.map(|other| Cow::Owned(other.without_events())).or_else(|| frames.next().map(Cow::Borrowed))
    })
}

/// Returns the poses of one recording, which begins at `start` seconds of its own clock: samples of the trajectories, or one pose per
/// picture.
pub fn poses(calibrated: &Calibrated, recording: usize, start: f64, settings: &PoseSettings) -> Vec<UncertainPose> {
    let mut poses = match &calibrated.evidence {
        Evidence::Events(events) => {
            let (state, left_out) = (&events.refined.state, &events.refined.left_out);
            let mut poses = sampled_poses(state, &events.quality.poses, left_out, recording, settings);
            let followed = events.followed.iter().filter(|interval| interval.recording == recording);
            poses.extend(followed.flat_map(|interval| &interval.poses).copied());
            poses.sort_by(|a, b| a.pose.t.total_cmp(&b.pose.t));
            // Adjacent intervals share the window at their border. The pose of the joint solve comes first and is kept.
            poses.dedup_by(|later, earlier| later.pose.t == earlier.pose.t);
            poses
        }
        Evidence::Pictures(_) => calibrated
            .posed()
            .filter(|(_, frame)| frame.recording == recording)
            .map(|(posed, frame)| UncertainPose { pose: TimedPose { t: frame.t(), pose: posed.pose }, sigma: None })
            .collect(),
    };
    poses.iter_mut().for_each(|pose| pose.pose.t += start);
    poses
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_a_result_are_recognised_by_name() {
        for name in ["calibration.json", "camera.yaml", "exports/camchain.yaml", "trajectory.txt", "circles-12.csv"] {
            assert!(is_result(Path::new(name)), "{name}");
        }
        for name in
            ["recording.dvraw", "trajectory-mine.txt", "circles-2.csv.bak", "mine/calibration.json", "ttyACM0.circles"]
        {
            assert!(!is_result(Path::new(name)), "{name}");
        }
    }
}

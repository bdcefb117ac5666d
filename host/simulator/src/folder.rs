//! Writes the folder of a simulation.

use std::path::{Path, PathBuf};

use evcal_core::camera::Camera;

use super::davis::{DavisDescription, DavisSettings, DavisTruth};
use super::frame_camera;
use super::motion_capture::{MotionCaptureDescription, MotionCaptureSettings};
use super::recording::{self, RecordingFormat};
use super::second_camera::{SecondCamera, SecondCameraDescription, recording_name};
use super::truth::Truth;
use super::{EventCounts, Simulation};
use evcal_files::FileError;
use evcal_files::folder::{NamesFile, OutputFolder};
use evcal_geometry::lens::camera_file::CameraDescription;
use evcal_geometry::tum;
use event_recordings::encode::WriteError;
use event_recordings::image_folder::{IMAGES, TABLE};

/// Rate of the poses in the trajectory file in hertz.
const TRAJECTORY_RATE: f64 = 1000.0;
const TRUTH: &str = "truth.json";
const TRAJECTORY: &str = "trajectory.txt";
const FRAMES: &str = "frames.csv";
const INERTIA: &str = "imu.csv";
const MOTION_CAPTURE: &str = "motion_capture.txt";

/// A simulation with the format of its recording.
pub struct SimulatedRecording<'a> {
    /// The simulation.
    pub simulation: &'a Simulation,
    /// The lens of the simulation.
    pub camera: &'a Camera<f64>,
    /// The lens of the frames, if it differs.
    pub frame_camera: Option<&'a Camera<f64>>,
    /// Frames and IMU samples.
    pub davis: DavisSettings,
    /// Motion capture of the camera, if enabled.
    pub motion_capture: Option<MotionCaptureSettings>,
    /// A second camera, if enabled.
    pub second_camera: Option<&'a SecondCamera>,
    /// Format of the recording.
    pub format: RecordingFormat,
}

impl SimulatedRecording<'_> {
    /// Returns the number of simulated slices of all cameras.
    pub fn slice_count(&self) -> usize {
        self.simulation.slice_count() * if self.second_camera.is_some() { 2 } else { 1 }
    }
}

/// Result of writing a folder.
#[derive(Clone, Debug)]
pub struct WrittenFolder {
    /// The files.
    pub files: Vec<PathBuf>,
    /// The content of `truth.json`.
    pub truth: Truth,
    /// Number of events.
    pub counts: EventCounts,
    /// Frames and IMU samples.
    pub davis: DavisTruth,
}

/// Error: a file of the folder could not be written.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SimulatedFolderError {
    /// Input or output failed.
    #[error("{0}")]
    File(#[from] FileError),
    /// The recording cannot be written.
    #[error("{}: {error}", path.display())]
    Recording {
        /// The recording.
        path: PathBuf,
        /// The reason.
        error: WriteError,
    },
}

impl evcal_files::remedy::Remedy for SimulatedFolderError {}

impl NamesFile for SimulatedFolderError {
    fn file_mut(&mut self) -> Option<&mut PathBuf> {
        Some(match self {
            Self::File(error) => &mut error.path,
            Self::Recording { path, .. } => path,
        })
    }
}

/// Returns the subfolders that [`write_folder`] creates.
pub fn folders(second_camera: Option<&SecondCamera>) -> &'static [&'static str] {
    match second_camera.and_then(SecondCamera::frames) {
        Some(_) => &[frame_camera::FOLDER],
        None => &[],
    }
}

/// Returns `true` if a file of a folder is one that [`write_folder`] writes.
pub fn is_result(file: &Path) -> bool {
    let others = [TRUTH, TRAJECTORY, FRAMES, INERTIA, MOTION_CAPTURE];
    let is_recording = |format: &RecordingFormat| {
        Path::new(&format.file_name()) == file || Path::new(&recording_name(*format)) == file
    };
    let frames = Path::new(frame_camera::FOLDER);
    let is_image = file.parent() == Some(&frames.join(IMAGES)) && file.extension().is_some_and(|one| one == "png");
    let is_table = file == frames.join(TABLE);
    is_image
        || is_table
        || RecordingFormat::ALL.iter().any(is_recording)
        || others.iter().any(|name| Path::new(name) == file)
}

/// Simulates, and writes the results into `folder`:
///
/// - `events.aedat4` (or `.dvraw`, `.csv`, `.bin`, `.raw`), `truth.json` and `trajectory.txt` (TUM, 1000 poses per
///   second);
/// - with frames `frames.csv`, with IMU samples `imu.csv`, with motion capture `motion_capture.txt` (TUM,
///   `T_mocap_body`);
/// - with a second camera `second.aedat4` (or `.csv`, `.bin`, `.raw`), or the folder `second` if it takes frames.
///
/// Files of an earlier simulation are removed once all files of this one are written. `progress` is called with the
/// number of finished slices, of [`SimulatedRecording::slice_count`] in total.
///
/// # Errors
/// [`SimulatedFolderError`] names the file that could not be written.
pub fn write_folder(
    folder: &OutputFolder,
    recorded: &SimulatedRecording,
    progress: impl FnMut(usize),
) -> Result<WrittenFolder, SimulatedFolderError> {
    let mut written = folder.replace(is_result, |new| write_files(new, recorded, progress))?;
    for file in &mut written.files {
        *file = folder.path().join(&*file);
    }
    Ok(written)
}

/// Writes the files into `folder`; returns their names in it.
fn write_files(
    folder: &Path,
    recorded: &SimulatedRecording,
    mut progress: impl FnMut(usize),
) -> Result<WrittenFolder, SimulatedFolderError> {
    let SimulatedRecording { simulation, camera, frame_camera, davis, motion_capture, second_camera, format } =
        recorded;
    let name = PathBuf::from(format.file_name());
    let path = folder.join(&name);
    let (counts, davis_truth) = recording::write(simulation, davis, &path, *format, &mut progress)
        .map_err(|error| SimulatedFolderError::Recording { path, error })?;
    let mut written = vec![name];
    let mut truth = Truth::new(camera, simulation, counts);
    truth.motion_capture = motion_capture.map(MotionCaptureDescription::new);
    if *davis != DavisSettings::default() {
        let frame_camera = frame_camera.map(CameraDescription::new);
        truth.davis = Some(DavisDescription { settings: *davis, frame_camera, imu_bias: davis_truth.bias });
    }
    if let Some(second) = second_camera {
        let done = simulation.slice_count();
        let (name, description) = write_second(folder, simulation, second, *format, |more| progress(done + more))?;
        written.push(name);
        truth.second_camera = Some(description);
    }
    let mut put = |name: &str, content: &[u8]| {
        evcal_files::write(&folder.join(name), content)?;
        written.push(name.into());
        Ok::<(), FileError>(())
    };
    let text =
        serde_json::to_string_pretty(&truth).map_err(|error| FileError::new(&folder.join(TRUTH), error.into()))?;
    put(TRUTH, (text + "\n").as_bytes())?;
    let mut trajectory = Vec::new();
    tum::write(&mut trajectory, "T_world_camera", &simulation.trajectory(TRAJECTORY_RATE))
        .map_err(|error| FileError::new(&folder.join(TRAJECTORY), error))?;
    put(TRAJECTORY, &trajectory)?;
    if let Some(capture) = motion_capture {
        let mut text = Vec::new();
        tum::write(&mut text, "T_mocap_body", &capture.capture(simulation))
            .map_err(|error| FileError::new(&folder.join(MOTION_CAPTURE), error))?;
        put(MOTION_CAPTURE, &text)?;
    }
    if davis.frames.is_some() {
        put(FRAMES, davis_truth.frames_csv().as_bytes())?;
    }
    if davis.imu.is_some() {
        put(INERTIA, davis_truth.imu_csv().as_bytes())?;
    }
    Ok(WrittenFolder { files: written, truth, counts, davis: davis_truth })
}

/// Writes the recording of a second camera: a file, or a folder for a camera with frames. Returns its name in `folder`.
fn write_second(
    folder: &Path,
    simulation: &Simulation,
    second: &SecondCamera,
    format: RecordingFormat,
    progress: impl FnMut(usize),
) -> Result<(PathBuf, SecondCameraDescription), SimulatedFolderError> {
    if let Some(frames) = second.frames() {
        let name = PathBuf::from(frame_camera::FOLDER);
        let files = second.write_frames(simulation, frames, &folder.join(&name), progress)?;
        // One of the files is the table.
        let count = files.len().saturating_sub(1);
        return Ok((name, SecondCameraDescription::new(second, EventCounts::default(), Some(count))));
    }
    let name = PathBuf::from(recording_name(format));
    let path = folder.join(&name);
    let counts = second
        .write(simulation, &path, format, progress)
        .map_err(|error| SimulatedFolderError::Recording { path, error })?;
    Ok((name, SecondCameraDescription::new(second, counts, None)))
}

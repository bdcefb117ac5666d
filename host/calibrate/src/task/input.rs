//! Input of a calibration: recordings of events, circles that were found before, or frames.

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use evcal_core::sensor::Sensor;

use evcal_detection::circles::file::InputKind;
use evcal_detection::circles::reference_frame::ReferenceFrame;
use evcal_detection::circles::serial::{SerialAddress, SerialError};
use evcal_detection::circles::stream;
use evcal_detection::circles::track::{self, CircleFrames, CircleTrack, CircleTrackError, TrackSource};
use evcal_detection::detection::{DetectionReport, order_frames};
use evcal_files::remedies;
use evcal_files::visible;
use evcal_geometry::board::Board;
use evcal_geometry::numerics::statistics::median;
use event_recordings::continued::chains;
use event_recordings::image_folder::Stamps;
use event_recordings::images::{Images, ImagesError};
use event_recordings::pass::{Batch, Pass, read_while};
use event_recordings::{Files, ReadReport, Recording, RecordingError, RecordingOptions, options_for};

/// Time between frames of circles (s) above which a hand-held board moves in ways that the frames do not show.
const MOST_BETWEEN_CIRCLES: f64 = 0.05;

/// One input: events, circles or frames.
#[derive(Clone)]
pub enum Input {
    /// A recording of events.
    Events(Recording),
    /// Frames of a camera without events.
    Images(Images),
    /// Reference frames from a circle track or circle stream, times from `start`.
    Circles {
        /// The file or port.
        path: PathBuf,
        /// Sensor size in pixels, if a device reported it.
        sensor: Option<Sensor>,
        /// Its frames; their recording number is set by the calibration.
        frames: Vec<ReferenceFrame>,
        /// Start of the frames' times on the clock of the file, in seconds.
        start: f64,
        /// Assumptions made when the file was read.
        notes: Vec<String>,
        /// Report of the grid finder on circles without a position on the board.
        detection: DetectionReport,
        /// The file, if it is one.
        files: Files,
    },
}

impl From<Recording> for Input {
    fn from(recording: Recording) -> Self {
        Self::Events(recording)
    }
}

impl Input {
    /// Returns the name of the file or port.
    pub fn name(&self) -> String {
        match self {
            Self::Events(recording) => match recording.files().len() {
                1 => visible::path(recording.path()),
                count => format!("{} and {} files that continue it", visible::path(recording.path()), count - 1),
            },
            Self::Images(images) => images.name(),
            Self::Circles { path, .. } => visible::path(path),
        }
    }

    /// Returns the name of the file or port without its folders, for progress messages.
    pub fn short_name(&self) -> String {
        let name = self.path().file_name().unwrap_or(self.path().as_os_str());
        visible::path(name)
    }

    fn path(&self) -> &Path {
        match self {
            Self::Events(recording) => recording.path(),
            Self::Images(images) => images.path(),
            Self::Circles { path, .. } => path,
        }
    }

    /// Returns the files that are read.
    pub fn source_files(&self) -> &Files {
        match self {
            Self::Events(recording) => recording.source_files(),
            Self::Images(images) => images.source_files(),
            Self::Circles { files, .. } => files,
        }
    }

    /// Returns the files that were read: of a live camera, the dump that it has written.
    pub fn files_read(&self) -> Files {
        match self {
            Self::Events(recording) if recording.source_files().is_empty() => {
                Files::new(recording.files().into_iter().map(Path::to_owned))
            }
            input => input.source_files().clone(),
        }
    }

    /// Returns `true` if these are circles in frames so far apart in time that no trajectory connects them, each frame seen at one moment.
    pub fn has_only_views(&self) -> bool {
        let Self::Circles { frames, .. } = self else { return false };
        let at_one_moment = |frame: &ReferenceFrame| {
            frame
                .circles
                .windows(2)
                .all(|pair| pair.first().map(|circle| circle.t) == pair.last().map(|circle| circle.t))
        };
        if !frames.iter().all(at_one_moment) {
            return false;
        }
        let mut gaps: Vec<f64> =
            frames.windows(2).filter_map(|pair| Some(pair.last()?.t() - pair.first()?.t())).collect();
        median(&mut gaps, f64::total_cmp).is_some_and(|gap| gap > MOST_BETWEEN_CIRCLES)
    }

    /// Joins files of events that continue each other into one recording, at the index of the first of them.
    pub fn join(inputs: Vec<Self>) -> Vec<Self> {
        let events = |(place, input): (usize, &Self)| match input {
            Self::Events(recording) => Some((place, recording.clone())),
            _ => None,
        };
        let (places, recordings): (Vec<usize>, Vec<Recording>) = inputs.iter().enumerate().filter_map(events).unzip();
        let chains = if recordings.len() > 1 { chains(&recordings.iter().collect::<Vec<_>>()) } else { Vec::new() };
        let mut joined: Vec<Option<Self>> = inputs.into_iter().map(Some).collect();
        for chain in chains {
            let files = chain.iter().filter_map(|place| recordings.get(*place).cloned()).collect();
            let given: Vec<usize> = chain.iter().filter_map(|place| places.get(*place).copied()).collect();
            for place in &given {
                if let Some(input) = joined.get_mut(*place) {
                    *input = None;
                }
            }
            if let Some(input) = given.iter().min().and_then(|first| joined.get_mut(*first)) {
                *input = Recording::chain(files).map(Self::Events);
            }
        }
        joined.into_iter().flatten().collect()
    }

    /// Returns `true` if both are read from one file.
    pub fn is_of_file_of(&self, other: &Self) -> bool {
        let file = |input: &Self| input.path().canonicalize().unwrap_or_else(|_| input.path().to_owned());
        file(self) == file(other)
    }

    /// Opens the recording of another camera on the mount: images (`stamps` is the meaning of their timestamps, see
    /// [`Images::open`]), or any input of [`Input::open`]. `stream` is its stream or topic; without it, the options
    /// determine the stream of events.
    ///
    /// # Errors
    /// [`InputError`] if it is neither, or cannot be read.
    pub fn open_other(
        path: &Path,
        stream: Option<&str>,
        stamps: Stamps,
        options: &RecordingOptions,
        board: &Board,
    ) -> Result<Self, InputError> {
        if let Some(images) = Images::open(path, stream, options.damage, stamps)? {
            return Ok(Self::Images(images));
        }
        // The options were given for the first camera's recording, so some of them may not apply to this one.
        let options = options_for(path, options);
        let stream = stream.map(str::to_owned).or_else(|| options.stream.clone());
        Self::open(path, &RecordingOptions { stream, ..options }, board)
    }

    /// Opens frames, each of which is a view with its own pose: images, whose timestamps do not matter, or any input of
    /// [`Input::open`]. `options` may name the topic of images in a bag.
    ///
    /// # Errors
    /// [`InputError`] if it is neither, or cannot be read.
    pub fn open_views(path: &Path, options: &RecordingOptions, board: &Board) -> Result<Self, InputError> {
        match Images::open_views(path, options.stream.as_deref(), options.damage)? {
            Some(images) => Ok(Self::Images(images)),
            None => Self::open(path, options, board),
        }
    }

    /// Opens a recording, a circle track or a circle stream, whichever `path` is. Circles without a position on the board are
    /// ordered by the grid finder.
    ///
    /// # Errors
    /// [`InputError`] if it is neither, or cannot be read.
    pub fn open(path: &Path, options: &RecordingOptions, board: &Board) -> Result<Self, InputError> {
        match InputKind::of(path)? {
            InputKind::Events => Ok(Self::Events(Recording::new(path, options.clone())?)),
            InputKind::CircleTrack => {
                let files = Files::new([path.to_owned()]);
                Ok(Self::from_track(path, track::read(path, &board.lattice(), 0)?, board, files))
            }
            InputKind::CircleStream => {
                let files = Files::new([path.to_owned()]);
                Ok(Self::from_track(path, stream::read(path)?.track, board, files))
            }
        }
    }

    /// Listens to a serial port; `progress` gets a text on what was received.
    ///
    /// # Errors
    /// [`SerialError`] if no circle is received.
    pub fn listen(address: &SerialAddress, board: &Board, progress: impl FnMut(&str)) -> Result<Self, SerialError> {
        let stream = address.receive(progress)?;
        Ok(Self::from_track(Path::new(&address.to_string()), stream.track, board, Files::default()))
    }

    fn from_track(path: &Path, track: CircleTrack, board: &Board, files: Files) -> Self {
        let TrackSource { sensor, time_origin_us } = track.source;
        let (frames, detection) = match track.frames {
            CircleFrames::Ordered(frames) => (frames, DetectionReport::default()),
            CircleFrames::Unordered(frames) => order_frames(&frames, &board.lattice(), sensor),
        };
        let start = time_origin_us as f64 * 1e-6;
        Self::Circles { path: path.to_owned(), sensor, frames, start, notes: track.notes, detection, files }
    }
}

/// Passes the events of an input to `visit`, with times from its first event, until `visit` breaks. Circles have no events.
///
/// # Errors
/// [`RecordingError`] if the recording cannot be read, or changed since it was opened.
pub fn read_events(
    inputs: &[Input],
    index: usize,
    visit: &mut dyn FnMut(Batch) -> ControlFlow<()>,
) -> Result<Pass, RecordingError> {
    let Some(Input::Events(recording)) = inputs.get(index) else {
        let report = ReadReport::default();
        return Ok(Pass {
            count: 0,
            first: 0,
            last: 0,
            camera_name: None,
            began: None,
            assumptions: Vec::new(),
            report,
            damage: None,
        });
    };
    // The checksums are of the content that is read here: both fail if a file changes.
    std::thread::scope(|scope| {
        let checksums = scope.spawn(|| recording.source_files().checksums().map(|_| ()));
        let pass = read_while(recording, visit);
        let checked = checksums.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        checked.and(pass)
    })
}

/// Reasons why an input could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// It is not a recording that can be read.
    #[error("{0}")]
    Source(#[from] RecordingError),
    /// It is an invalid circle track, or a circle stream without circles.
    #[error("{0}")]
    Circles(#[from] CircleTrackError),
    /// Its images cannot be read.
    #[error("{0}")]
    Images(#[from] ImagesError),
}

remedies! { InputError, say;
    Self::Source(error) => error.remedy(say);
    Self::Images(error) => error.remedy(say);
}

//! Recording a live camera: every transfer goes to the disk as it comes, whatever else happens.
//!
//! The loop runs on the calling thread and does little: write, count, hand a transfer over. What
//! takes longer belongs on another thread (see [`crate`]). Between camera and loop lies the
//! queue of `usb_davis::device`, which holds more than two seconds of the camera's top rate.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::Serialize;
use usb_davis::configuration::Streams;
use usb_davis::device::{Camera, DeviceError, Queue, Stream, StreamError};
use usb_davis::dump::{Compression, DumpError, DumpWriter, Growth, Transfer};
use usb_davis::protocol::Decoder;
use usb_davis::registers::Register;

/// Longest wait for a transfer: how often the watcher is asked at least.
const PATIENCE: Duration = Duration::from_millis(50);
/// Time between two [`Moment::Status`].
const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// What to record.
#[derive(Clone, Debug)]
pub struct RecordingPlan {
    /// What the camera sends.
    pub streams: Streams,
    /// Transfers under way, and memory for those that wait.
    pub queue: Queue,
    /// For how long; without it, until the watcher or the camera ends it.
    pub duration: Option<Duration>,
    /// Is told how far the file is written, for those who read it meanwhile.
    pub growth: Growth,
}

/// How a recording goes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RecordingStatus {
    /// Time since it began in seconds.
    pub seconds: f64,
    /// Bytes of the camera's stream that are in the file.
    pub bytes: u64,
    /// Pixel events in them.
    pub events: u64,
    /// Events per second since the status before.
    pub event_rate: f64,
    /// Events that the camera dropped since it was started, by its own counters.
    pub dropped: u64,
}

/// What the watcher of a recording is told.
#[derive(Clone, Copy, Debug)]
pub enum Moment<'a> {
    /// A transfer came and is on the disk.
    Transfer(&'a Transfer<'a>),
    /// Once a second: how it goes.
    Status(&'a RecordingStatus),
    /// Nothing came for a while.
    Silence,
}

/// Why a recording ended.
#[derive(Debug, thiserror::Error)]
pub enum Ending {
    /// The watcher wanted it.
    #[error("stopped")]
    Asked,
    /// Its time was over.
    #[error("the time is over")]
    Duration,
    /// The camera went away or failed.
    #[error("{0}")]
    Camera(StreamError),
    /// The file could not be written any more, most often because the disk is full.
    #[error("the recording could not be written any more: {0}")]
    File(DumpError),
}

impl Ending {
    /// Whether it ended as planned.
    pub fn is_good(&self) -> bool {
        matches!(self, Self::Asked | Self::Duration)
    }
}

/// What was recorded.
#[derive(Debug)]
pub struct RecorderReport {
    /// The file.
    pub path: PathBuf,
    /// How it went, as of the end.
    pub status: RecordingStatus,
    /// Transfers in the file.
    pub transfers: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Faults in the stream.
    pub faults: u64,
    /// Transfers that failed on the bus: what they would have brought is lost.
    pub failed: u64,
    /// Transfers that could not be queued at once because this computer was too slow.
    pub starved: u64,
    /// Why it ended.
    pub ending: Ending,
}

/// Why nothing was recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file is there already.
    #[error("{} is there already and is not overwritten: choose another name", .0.display())]
    Exists(PathBuf),
    /// The file cannot be made.
    #[error("{}: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Why.
        error: DumpError,
    },
    /// The camera cannot be started.
    #[error("{0}")]
    Camera(#[from] DeviceError),
}

/// Records what `camera` sends into a new file at `path`, until the time is over, `watch` breaks or
/// the camera ends. Whatever came is in the file then; the report says why it ended.
///
/// # Errors
/// [`RecordingError`] if it cannot begin.
pub fn record(
    camera: &mut Camera,
    path: &Path,
    plan: &RecordingPlan,
    watch: impl FnMut(Moment<'_>) -> ControlFlow<()>,
) -> Result<RecorderReport, RecordingError> {
    let recorded = record_file(camera, path, plan, watch);
    plan.growth.end();
    recorded
}

fn record_file(
    camera: &mut Camera,
    path: &Path,
    plan: &RecordingPlan,
    mut watch: impl FnMut(Moment<'_>) -> ControlFlow<()>,
) -> Result<RecorderReport, RecordingError> {
    let failed = |error: DumpError| RecordingError::File { path: path.to_owned(), error };
    if fs::symlink_metadata(path).is_ok() {
        return Err(RecordingError::Exists(path.to_owned()));
    }
    // Only a camera that runs makes a file: a start that failed can be tried again with the same name.
    let mut stream = camera.start(plan.streams, plan.queue)?;
    let file = File::create_new(path).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => RecordingError::Exists(path.to_owned()),
        _ => failed(error.into()),
    })?;
    let dump = DumpWriter::new(file, stream.header(), Compression::None).map_err(|error| {
        // Without a header it is of no use, and in the way of the next one.
        let _ = fs::remove_file(path);
        failed(error)
    })?;
    let mut dump = dump.told_to(plan.growth.clone());
    let mut counter = Decoder::new(stream.header().registers.layout());
    let mut progress = Progress::default();
    let ending = run(&mut stream, &mut dump, &mut counter, &mut progress, plan, &mut watch);
    // All that came is in the file already.
    let _ = stream.stop();
    let (file_bytes, ending) = close(dump, path, stream.drop_counters(), ending);
    let statistics = stream.statistics();
    let counts = counter.counts();
    Ok(RecorderReport {
        path: path.to_owned(),
        status: RecordingStatus { dropped: stream.dropped().events, ..progress.status(counts.events) },
        transfers: progress.transfers,
        file_bytes,
        faults: counts.anomalies.total(),
        failed: statistics.failed,
        starved: statistics.starved,
        ending,
    })
}

/// Finishes the file, or cuts it behind its last whole record if it cannot be written any more. Its
/// length, and why the recording ended.
fn close(mut dump: DumpWriter<File>, path: &Path, counters: Vec<(Register, u32)>, ending: Ending) -> (u64, Ending) {
    let mut whole = dump.bytes();
    let closed = match ending {
        Ending::File(error) => Err(error),
        ending => dump
            .registers(counters)
            .and_then(|()| {
                whole = dump.bytes();
                dump.finish()
            })
            .and_then(|file| Ok(file.sync_all().and_then(|()| file.metadata())?.len()))
            .map(|length| (length, ending)),
    };
    closed.unwrap_or_else(|error| {
        // Should it fail, a reader passes over what is left of the last record.
        let _ = OpenOptions::new().write(true).open(path).and_then(|file| file.set_len(whole));
        (whole, Ending::File(error))
    })
}

/// Takes transfers until the end, and what is under way then.
fn run(
    stream: &mut Stream<'_>,
    dump: &mut DumpWriter<File>,
    counter: &mut Decoder,
    progress: &mut Progress,
    plan: &RecordingPlan,
    watch: &mut impl FnMut(Moment<'_>) -> ControlFlow<()>,
) -> Ending {
    let mut wanted = None;
    loop {
        let go_on = match stream.next(PATIENCE) {
            Ok(Some(transfer)) => {
                if let Err(error) = dump.transfer(&transfer) {
                    return Ending::File(error);
                }
                progress.transfers += 1;
                progress.bytes += transfer.payload.len() as u64;
                if transfer.gap_before {
                    counter.gap(|_| {});
                }
                counter.decode(transfer.payload, |_| {});
                watch(Moment::Transfer(&transfer))
            }
            Ok(None) => watch(Moment::Silence),
            Err(StreamError::Stopped) => return wanted.unwrap_or(Ending::Asked),
            Err(error) => return Ending::Camera(error),
        };
        if wanted.is_some() {
            continue;
        }
        let mut end = go_on.is_break().then_some(Ending::Asked);
        if progress.is_due() {
            // Should the camera be gone, the next transfer tells.
            let dropped = stream.read_dropped().unwrap_or_else(|_| stream.dropped()).events;
            let status = progress.status(counter.counts().events);
            if watch(Moment::Status(&RecordingStatus { dropped, ..status })).is_break() {
                end = end.or(Some(Ending::Asked));
            }
        }
        if plan.duration.is_some_and(|duration| progress.began.elapsed() >= duration) {
            end = end.or(Some(Ending::Duration));
        }
        if end.is_some() {
            wanted = end;
            // What is under way still comes, then `Stopped`, also if the camera did not answer.
            let _ = stream.stop();
        }
    }
}

/// What is in the file so far, and the clock of a recording.
struct Progress {
    transfers: u64,
    bytes: u64,
    began: Instant,
    /// When the latest status was made, and how many events there were then.
    told: Instant,
    told_events: u64,
}

impl Default for Progress {
    fn default() -> Self {
        let now = Instant::now();
        Self { transfers: 0, bytes: 0, began: now, told: now, told_events: 0 }
    }
}

impl Progress {
    fn is_due(&self) -> bool {
        self.told.elapsed() >= STATUS_INTERVAL
    }

    fn status(&mut self, events: u64) -> RecordingStatus {
        let span = self.told.elapsed().as_secs_f64();
        let event_rate = if span > 0.0 { (events - self.told_events) as f64 / span } else { 0.0 };
        (self.told, self.told_events) = (Instant::now(), events);
        let (seconds, bytes) = (self.began.elapsed().as_secs_f64(), self.bytes);
        RecordingStatus { seconds, bytes, events, event_rate, dropped: 0 }
    }
}

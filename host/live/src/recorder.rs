//! Recording of a live camera: every transfer is written to the disk as it arrives, whatever else happens.
//!
//! The loop runs on the calling thread and does little: it writes, counts, and passes a transfer on. Longer work
//! belongs on another thread (see [`crate`]). Between camera and loop is the queue of `usb_davis::device`, which stores
//! more than two seconds at the camera's top rate.

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

/// Longest wait for a transfer, and thus the longest time between calls of the watcher.
const PATIENCE: Duration = Duration::from_millis(50);
/// Time between two [`Moment::Status`].
const STATUS_INTERVAL: Duration = Duration::from_secs(1);

/// Settings of a recording.
#[derive(Clone, Debug)]
pub struct RecordingPlan {
    /// Streams of the camera.
    pub streams: Streams,
    /// Number of queued transfers, and memory for waiting ones.
    pub queue: Queue,
    /// Duration; without it, the watcher or the camera ends the recording.
    pub duration: Option<Duration>,
    /// Progress of the file, for readers that follow it.
    pub growth: Growth,
}

/// Progress of a recording.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct RecordingStatus {
    /// Time since the start in seconds.
    pub seconds: f64,
    /// Bytes of the camera's stream in the file.
    pub bytes: u64,
    /// Pixel events in these bytes.
    pub events: u64,
    /// Events per second since the previous status.
    pub event_rate: f64,
    /// Events that the camera dropped since its start, by its own counters.
    pub dropped: u64,
}

/// Notification to the watcher of a recording.
#[derive(Clone, Copy, Debug)]
pub enum Moment<'a> {
    /// A transfer arrived and is on the disk.
    Transfer(&'a Transfer<'a>),
    /// The progress, once a second.
    Status(&'a RecordingStatus),
    /// Nothing arrived for a while.
    Silence,
}

/// Reason why a recording ended.
#[derive(Debug, thiserror::Error)]
pub enum Ending {
    /// The watcher ended it.
    #[error("stopped")]
    Requested,
    /// The duration was reached.
    #[error("the time is over")]
    Duration,
    /// The camera was removed or failed.
    #[error("{0}")]
    Camera(StreamError),
    /// The file could not be written, usually because the disk is full.
    #[error("the recording could not be written any more: {0}")]
    File(DumpError),
}

impl Ending {
    /// Returns `true` if the recording ended as planned.
    pub fn is_good(&self) -> bool {
        matches!(self, Self::Requested | Self::Duration)
    }
}

/// Result of a recording.
#[derive(Debug)]
pub struct RecorderReport {
    /// The file.
    pub path: PathBuf,
    /// Progress at the end.
    pub status: RecordingStatus,
    /// Transfers in the file.
    pub transfers: u64,
    /// Bytes of the file.
    pub file_bytes: u64,
    /// Faults in the stream.
    pub faults: u64,
    /// Transfers that failed on the bus; their data are lost.
    pub failed: u64,
    /// Transfers that could not be queued at once because this computer was too slow.
    pub starved: u64,
    /// Reason of the end.
    pub ending: Ending,
}

/// Reason why nothing was recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file already exists.
    #[error("{} is there already and is not overwritten: choose another name", .0.display())]
    Exists(PathBuf),
    /// The file cannot be created.
    #[error("{}: {error}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The reason.
        error: DumpError,
    },
    /// The camera cannot be started.
    #[error("{0}")]
    Camera(#[from] DeviceError),
}

impl evcal_files::remedy::Remedy for RecordingError {}

/// Records the transfers of `camera` into a new file at `path`, until the time is over, `watch` breaks or the camera
/// ends. All received transfers are then in the file; the report contains the reason of the end.
///
/// # Errors
/// [`RecordingError`] if the recording cannot start.
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
    // The file is created only once the camera runs, so a failed start can be repeated with the same name.
    let mut stream = camera.start(plan.streams, plan.queue)?;
    let file = File::create_new(path).map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => RecordingError::Exists(path.to_owned()),
        _ => failed(error.into()),
    })?;
    let dump = DumpWriter::new(file, stream.header(), Compression::None).map_err(|error| {
        // A file without a header is useless and would prevent another attempt.
        let _ = fs::remove_file(path);
        failed(error)
    })?;
    let mut dump = dump.with_growth(plan.growth.clone());
    let mut counter = Decoder::new(stream.header().registers.layout());
    let mut progress = Progress::default();
    let ending = run(&mut stream, &mut dump, &mut counter, &mut progress, plan, &mut watch);
    // All transfers are already in the file.
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

/// Finishes the file, or truncates it after its last whole record if it cannot be written any more. Returns its length,
/// and the reason of the end.
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
        // If this fails, a reader skips the rest of the last record.
        let _ = OpenOptions::new().write(true).open(path).and_then(|file| file.set_len(whole));
        (whole, Ending::File(error))
    })
}

/// Records transfers until the end; transfers in progress at the end are recorded too.
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
            Err(StreamError::Stopped) => return wanted.unwrap_or(Ending::Requested),
            Err(error) => return Ending::Camera(error),
        };
        if wanted.is_some() {
            continue;
        }
        let mut end = go_on.is_break().then_some(Ending::Requested);
        if progress.is_due() {
            // If the camera is gone, the next transfer reports it.
            let dropped = stream.read_dropped().unwrap_or_else(|_| stream.dropped()).events;
            let status = progress.status(counter.counts().events);
            if watch(Moment::Status(&RecordingStatus { dropped, ..status })).is_break() {
                end = end.or(Some(Ending::Requested));
            }
        }
        if plan.duration.is_some_and(|duration| progress.began.elapsed() >= duration) {
            end = end.or(Some(Ending::Duration));
        }
        if end.is_some() {
            wanted = end;
            // Transfers in progress still arrive, then `Stopped`, even if the camera did not answer.
            let _ = stream.stop();
        }
    }
}

/// Content of the file so far, and the clock of a recording.
struct Progress {
    transfers: u64,
    bytes: u64,
    began: Instant,
    /// Time of the latest status, and number of events at that time.
    last_status: Instant,
    last_events: u64,
}

impl Default for Progress {
    fn default() -> Self {
        let now = Instant::now();
        Self { transfers: 0, bytes: 0, began: now, last_status: now, last_events: 0 }
    }
}

impl Progress {
    fn is_due(&self) -> bool {
        self.last_status.elapsed() >= STATUS_INTERVAL
    }

    fn status(&mut self, events: u64) -> RecordingStatus {
        let span = self.last_status.elapsed().as_secs_f64();
        let event_rate = if span > 0.0 { (events - self.last_events) as f64 / span } else { 0.0 };
        (self.last_status, self.last_events) = (Instant::now(), events);
        let (seconds, bytes) = (self.began.elapsed().as_secs_f64(), self.bytes);
        RecordingStatus { seconds, bytes, events, event_rate, dropped: 0 }
    }
}

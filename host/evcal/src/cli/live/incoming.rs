//! A recording that arrives during the session: on standard input, or in a file that another program writes.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use evcal_core::sensor::Sensor;
use evcal_detection::detection::search::SearchError;
use evcal_files::folder::OutputFolder;
use evcal_files::visible;
use event_recordings::{FileFormat, Recording, RecordingOptions};
use usb_davis::dump::Growth;

use super::super::Failure;
use super::super::interrupt::Interrupt;

/// Time between two looks at the length of a followed file.
const LOOK: Duration = Duration::from_millis(10);
/// A followed file that has not grown for this time is complete. A camera at rest still sends noise.
const COMPLETE: Duration = Duration::from_secs(10);
/// Largest number of bytes that are stored at a time.
const BLOCK: usize = 1 << 16;

/// A recording that is still being written.
pub struct Incoming {
    /// The recording, read as it grows.
    pub recording: Recording,
    /// Its sensor.
    pub sensor: Sensor,
    growth: Growth,
    /// Reason why standard input could not be stored any more.
    failed: Arc<Mutex<Option<String>>>,
}

impl Incoming {
    /// Follows the file at `path`, which another program is writing. It ends after [`COMPLETE`] without a further byte, or with a signal.
    pub fn follow(path: &Path, options: RecordingOptions, interrupt: &Interrupt) -> Result<Self, Failure> {
        let growth = Growth::default();
        let (file, watched, interrupt) = (path.to_owned(), growth.clone(), interrupt.clone());
        thread::Builder::new().name("following".to_owned()).spawn(move || {
            let (mut length, mut grew) = (0, Instant::now());
            while grew.elapsed() < COMPLETE && !interrupt.is_asked() {
                let now = fs::metadata(&file).map_or(length, |metadata| metadata.len());
                if now > length {
                    (length, grew) = (now, Instant::now());
                    watched.set(length);
                }
                thread::sleep(LOOK);
            }
            watched.end();
        })?;
        let recording = Recording::growing(path, options, growth.clone())?;
        Ok(Self { sensor: sensor(&recording)?, recording, growth, failed: Arc::default() })
    }

    /// Stores standard input in `folder`, under a name for its format, and reads it as it arrives.
    pub fn standard_input(
        folder: &OutputFolder,
        options: RecordingOptions,
        interrupt: &Interrupt,
    ) -> Result<Self, Failure> {
        let unnamed = folder.path().join("recording");
        let mut file = create(&unnamed)?;
        let (growth, failed) = (Growth::default(), Arc::new(Mutex::new(None)));
        let (written, failure) = (growth.clone(), Arc::clone(&failed));
        // A signal ends the recording also while no byte arrives.
        let (waiting, interrupted) = (growth.clone(), interrupt.clone());
        thread::Builder::new().name("signalled".to_owned()).spawn(move || {
            while !interrupted.is_asked() {
                thread::sleep(LOOK);
            }
            waiting.end();
        })?;
        thread::Builder::new().name("storing".to_owned()).spawn(move || {
            if let Err(error) = store(&mut io::stdin().lock(), &mut file, &written) {
                *failure.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
            }
            written.end();
        })?;
        let opened = || -> Result<(&FileFormat, Sensor), Failure> {
            let recording = Recording::growing(&unnamed, options.clone(), growth.clone())?;
            Ok((recording.format(), sensor(&recording)?))
        };
        // What cannot be read is of no use, and would be in the way of the next attempt.
        let (format, sensor) = opened().inspect_err(|_| {
            let _ = fs::remove_file(&unnamed);
        })?;
        let extension = format.output.and_then(|output| output.extensions.first());
        let path = extension.map_or_else(|| unnamed.clone(), |extension| unnamed.with_extension(extension));
        let is_free = path != unnamed && !path.exists();
        let path = if is_free && fs::rename(&unnamed, &path).is_ok() { path } else { unnamed };
        Ok(Self { recording: Recording::growing(path, options, growth.clone())?, sensor, growth, failed })
    }

    /// Path of the recording.
    pub fn path(&self) -> &Path {
        self.recording.path()
    }

    /// Ends the recording: later bytes are not read. Fails if standard input could not be stored.
    pub fn end(&self) -> super::super::Outcome {
        self.growth.end();
        match self.failed.lock().unwrap_or_else(PoisonError::into_inner).take() {
            None => Ok(()),
            Some(error) => Err(Failure::plain(format!(
                "standard input could not be stored any more: {error}; the part before is in {}",
                visible::path(self.path())
            ))),
        }
    }
}

/// Returns the sensor of `recording`, which cannot be read ahead to guess it.
fn sensor(recording: &Recording) -> Result<Sensor, Failure> {
    let unknown = || SearchError::SensorUnknown { file: visible::path(recording.path()), likely: None };
    Ok(recording.open()?.information().sensor.ok_or_else(unknown)?)
}

/// Creates the file; it must not exist.
fn create(path: &Path) -> Result<File, Failure> {
    File::create_new(path).map_err(|error| {
        let file = visible::path(path);
        Failure::plain(match error.kind() {
            io::ErrorKind::AlreadyExists => {
                format!("{file} is there already and is not overwritten: choose another folder with -o")
            }
            _ => format!("{file}: {error}"),
        })
    })
}

/// Copies `input` to `output` until it ends, or the recording has.
fn store(input: &mut impl Read, output: &mut File, growth: &Growth) -> io::Result<()> {
    let mut block = vec![0; BLOCK];
    let mut length = 0;
    loop {
        let count = match input.read(&mut block) {
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        if count == 0 || growth.has_ended() {
            return Ok(());
        }
        output.write_all(block.get(..count).unwrap_or_default())?;
        length += count as u64;
        growth.set(length);
    }
}

//! Decoding of files that continue each other as one recording.

use std::collections::VecDeque;

use evcal_core::event::Event;

use crate::error::RecordingError;
use crate::extras::{Extra, OtherStreams, ReadExtras};
use crate::read_report::ReadReport;
use crate::reader::{Decode, RecordingInformation};

/// Opens the decoder of a file when called.
pub type OpenDecoder = Box<dyn FnOnce() -> Result<Box<dyn Decode>, RecordingError> + Send>;

/// Decoder of several files, one after the other.
pub struct ChainDecoder {
    /// Files that have not been opened yet.
    files: VecDeque<OpenDecoder>,
    /// Number of all files.
    count: usize,
    now: Box<dyn Decode>,
    information: RecordingInformation,
    /// Number of frames in the files read so far, if each file reported one.
    frames: Option<u64>,
}

impl ChainDecoder {
    /// Starts with `first`, followed by `others`.
    pub fn new(first: Box<dyn Decode>, others: impl Iterator<Item = OpenDecoder>) -> Self {
        let (files, information) = (VecDeque::from_iter(others), first.information().clone());
        Self { count: files.len() + 1, files, now: first, information, frames: Some(0) }
    }
}

impl Decode for ChainDecoder {
    fn information(&self) -> &RecordingInformation {
        &self.information
    }

    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        if self.now.decode(batch, report)? {
            return Ok(true);
        }
        self.frames = self.frames.zip(report.frames.take()).map(|(before, here)| before + here);
        match self.files.pop_front() {
            Some(next) => {
                self.now = next()?;
                Ok(true)
            }
            None => {
                report.frames = self.frames;
                Ok(false)
            }
        }
    }

    fn done(&self) -> Option<f64> {
        let before = self.count - self.files.len() - 1;
        Some((before as f64 + self.now.done()?) / self.count as f64)
    }
}

/// Reader of the frames and IMU samples of several files, one after the other.
pub struct ChainExtras {
    /// Reader of each file.
    pub files: Vec<Box<dyn ReadExtras>>,
}

impl ReadExtras for ChainExtras {
    fn streams(&self) -> OtherStreams {
        let has_any = |part: fn(&OtherStreams) -> bool| self.files.iter().any(|file| part(&file.streams()));
        OtherStreams { frames: has_any(|streams| streams.frames), imu: has_any(|streams| streams.imu) }
    }

    fn first_time(&mut self) -> Option<i64> {
        self.files.first_mut()?.first_time()
    }

    fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra> {
        self.files.iter_mut().find_map(|file| file.next_until(end, lost))
    }

    fn reads(&self, stream: &str) -> bool {
        self.files.iter().any(|file| file.reads(stream))
    }

    fn chosen(&self) -> Vec<String> {
        self.files.first().map_or_else(Vec::new, |file| file.chosen())
    }

    fn passed_over(&self) -> Option<String> {
        self.files.first()?.passed_over()
    }

    fn lessened(&self) -> Option<&'static str> {
        self.files.iter().find_map(|file| file.lessened())
    }
}

//! Decoding of files that continue each other as one recording.

use std::collections::VecDeque;

use evcal_core::event::Event;

use crate::error::RecordingError;
use crate::format::OpenResult;
use crate::read_report::ReadReport;
use crate::reader::{Decode, Opened};

/// Opens a file for its events when called.
pub type OpenFile = Box<dyn FnOnce() -> OpenResult + Send>;

/// Decoder of several files, one after the other.
pub struct ChainDecoder {
    /// Files that have not been opened yet.
    files: VecDeque<OpenFile>,
    /// Number of all files.
    count: usize,
    now: Box<dyn Decode>,
    /// Number of frames in the files read so far, if each file reported one.
    frames: Option<u64>,
}

impl ChainDecoder {
    /// Starts with `first`, followed by `others`.
    pub fn open(first: Opened, others: impl Iterator<Item = OpenFile>) -> Opened {
        let files = VecDeque::from_iter(others);
        Opened::new(first.information, Self { count: files.len() + 1, files, now: first.decoder, frames: Some(0) })
    }
}

impl Decode for ChainDecoder {
    fn decode(&mut self, batch: &mut Vec<Event>, report: &mut ReadReport) -> Result<bool, RecordingError> {
        if self.now.decode(batch, report)? {
            return Ok(true);
        }
        self.frames = self.frames.zip(report.frames.take()).map(|(before, here)| before + here);
        match self.files.pop_front() {
            Some(next) => {
                self.now = next()?.decoder;
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

//! Frames and inertial samples in order of time.

use std::iter::Peekable;
use std::path::Path;
use std::vec::IntoIter;

use super::describe;
use super::other_streams::{FrameReader, INERTIAL, inertial_samples};
use super::packets::PacketReader;
use crate::recording::RecordingError;
use crate::recording::extras::{Extra, Frame, InertialSample, OtherStreams, ReadExtras, frame_start};

/// Those of an AEDAT4 file.
pub struct Aedat4Extras {
    frames: FrameReader,
    /// The next frame, which has been read.
    next: Option<Frame>,
    samples: Peekable<IntoIter<InertialSample>>,
    held: OtherStreams,
    /// The streams of both, as [`describe`] names them.
    streams: Vec<String>,
}

impl Aedat4Extras {
    /// Those of the file at `path`.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        let mut frames = FrameReader::open(path)?;
        // A damaged packet is reported when its turn comes.
        let next = frames.next_frame().unwrap_or_default();
        let samples = inertial_samples(path).unwrap_or_default();
        let held = OtherStreams { frames: next.is_some(), imu: !samples.is_empty() };
        let packets = PacketReader::open(path)?;
        let mut streams = packets.header().streams.iter();
        let inertial = streams.find(|stream| stream.type_identifier == INERTIAL).map(describe);
        let streams = frames.stream().filter(|_| held.frames).into_iter();
        let streams = streams.chain(inertial.filter(|_| held.imu)).collect();
        Ok(Self { frames, next, samples: samples.into_iter().peekable(), held, streams })
    }
}

impl ReadExtras for Aedat4Extras {
    fn held(&self) -> OtherStreams {
        self.held
    }

    fn first_time(&mut self) -> Option<i64> {
        let frame = self.next.as_ref().map(frame_start);
        frame.into_iter().chain(self.samples.peek().map(|sample| sample.t)).min()
    }

    fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra> {
        let frame = self.next.as_ref().map(frame_start).filter(|start| *start <= end);
        let sample = self.samples.peek().map(|sample| sample.t).filter(|t| *t <= end);
        if sample.is_some() && frame.is_none_or(|start| sample < Some(start)) {
            return self.samples.next().map(Extra::Inertial);
        }
        frame?;
        let after = self.frames.next_frame().unwrap_or_else(|error| {
            lost.push(format!("frames from here on: {error}"));
            None
        });
        std::mem::replace(&mut self.next, after).map(Extra::Frame)
    }

    fn reads(&self, stream: &str) -> bool {
        self.streams.iter().any(|read| read == stream)
    }
}

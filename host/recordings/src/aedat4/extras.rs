//! Frames and IMU samples of AEDAT4, in order of time.

use std::path::Path;

use super::other_streams::{FrameReader, InertialReader};
use crate::error::RecordingError;
use crate::extras::{Extra, Frame, InertialSample, OtherStreams, ReadExtras, frame_start, read_or_report};
use crate::options::RecordingOptions;

/// Reader of the frames and IMU samples of a file.
pub struct Aedat4Extras {
    frames: FrameReader,
    samples: InertialReader,
    /// The next frame and sample, already read.
    frame: Option<Frame>,
    sample: Option<InertialSample>,
    streams: OtherStreams,
    /// Descriptions of errors in the first frame and sample.
    lost: Vec<String>,
    /// The streams that are read, as [`super::describe`] names them.
    stream_names: Vec<String>,
}

impl Aedat4Extras {
    /// Opens the file at `path`, for the camera whose events are read.
    pub fn open(path: &Path, options: &RecordingOptions) -> Result<Self, RecordingError> {
        let (mut frames, mut samples) = (FrameReader::open(path, options)?, InertialReader::open(path, options)?);
        let mut lost = Vec::new();
        let frame = read_or_report(frames.next_frame(), "frames", &mut lost);
        let sample = read_or_report(samples.next_sample(), "IMU samples", &mut lost);
        let streams = OtherStreams { frames: frame.is_some(), imu: sample.is_some() };
        let stream_names = frames.stream().filter(|_| streams.frames || frames.has_unread()).into_iter();
        let stream_names = stream_names.chain(samples.stream().filter(|_| streams.imu)).collect();
        Ok(Self { frames, samples, frame, sample, streams, lost, stream_names })
    }
}

impl ReadExtras for Aedat4Extras {
    fn streams(&self) -> OtherStreams {
        self.streams
    }

    fn first_time(&mut self) -> Option<i64> {
        let frame = self.frame.as_ref().map(frame_start);
        frame.into_iter().chain(self.sample.map(|sample| sample.t)).min()
    }

    fn next_until(&mut self, end: i64, lost: &mut Vec<String>) -> Option<Extra> {
        lost.append(&mut self.lost);
        if self.frame.is_none() {
            self.frames.report_skipped(lost);
        }
        if self.sample.is_none() {
            self.samples.report_skipped(lost);
        }
        let frame = self.frame.as_ref().map(frame_start).filter(|start| *start <= end);
        let sample = self.sample.map(|sample| sample.t).filter(|t| *t <= end);
        if sample.is_some() && frame.is_none_or(|start| sample < Some(start)) {
            let after = read_or_report(self.samples.next_sample(), "IMU samples", lost);
            return std::mem::replace(&mut self.sample, after).map(Extra::Inertial);
        }
        frame?;
        let after = read_or_report(self.frames.next_frame(), "frames", lost);
        std::mem::replace(&mut self.frame, after).map(Extra::Frame)
    }

    fn reads(&self, stream: &str) -> bool {
        self.stream_names.iter().any(|read| read == stream)
    }
}

#[cfg(test)]
mod tests {
    use std::fs::File;

    use evcal_core::event::{Event, Polarity};
    use evcal_core::sensor::Sensor;

    use super::*;
    use crate::aedat4::header::Compression;
    use crate::aedat4::write::Encoder;
    use crate::convert::{TimeOrigin, convert};
    use crate::encode::Encode;
    use crate::encode::OutputFormat;
    use crate::{Damage, Recording};

    /// dv-processing stamps frames at the start of their exposure, and its newer versions write only the duration.
    #[test]
    fn a_bag_stamps_frames_in_the_middle_of_their_exposure() {
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        let (start, end) = (1_000_000_i64, 1_020_000_i64);
        let frame = Frame {
            t: start,
            exposure: Some((start, end)),
            readout: None,
            size: (2, 1),
            position: (0, 0),
            channels: 1,
            pixels: vec![3, 4],
        };
        let (sensor, others) = (Sensor::new(346, 260), OtherStreams { frames: true, imu: false });
        let file = File::create(path("whole.aedat4")).unwrap();
        let mut encoder = Encoder::with_streams(file, Compression::None, sensor, "", others).unwrap();
        let event = |t| Event { t, x: 1, y: 2, polarity: Polarity::On };
        encoder.write(&[event(start - 20_000), event(end + 20_000)]).unwrap();
        encoder.frame(&frame).unwrap();
        encoder.finish().unwrap();
        let mut content = std::fs::read(path("whole.aedat4")).unwrap();
        let times: Vec<usize> = [start, end]
            .into_iter()
            .flat_map(|time| {
                let places = content.windows(8).enumerate().filter(move |(_, bytes)| *bytes == time.to_le_bytes());
                places.map(|(place, _)| place).collect::<Vec<_>>()
            })
            .collect();
        // The time of the frame, the start and the end of its exposure; the table at the end repeats the first.
        assert_eq!((times[1] - times[0], times[times.len() - 1] - times[0]), (24, 32));
        for place in [times[1], times[times.len() - 1]] {
            content[place..place + 8].fill(0xff);
        }
        std::fs::write(path("duration.aedat4"), content).unwrap();
        for name in ["whole.aedat4", "duration.aedat4"] {
            let first = |path: &Path| {
                let recording = Recording::new(path, RecordingOptions::default()).unwrap();
                recording.open_extras().unwrap().next_until(i64::MAX, &mut Vec::new())
            };
            assert_eq!(first(&path(name)), Some(Extra::Frame(frame.clone())));
            let recording = Recording::new(path(name), RecordingOptions::default()).unwrap();
            for output in ["a.aedat4", "a.bag", "a.mcap"] {
                let format = OutputFormat::from_extension(Path::new(output)).unwrap();
                convert(&recording, &path(output), format, TimeOrigin::Kept, |_| {}).unwrap();
                let expected = match output {
                    "a.aedat4" => frame.clone(),
                    _ => Frame { t: 1_010_000, exposure: None, ..frame.clone() },
                };
                assert_eq!(first(&path(output)), Some(Extra::Frame(expected)), "{name} to {output}");
            }
        }
    }

    /// Samples must not be read all at once, and a damaged packet must not lose the others.
    #[test]
    fn samples_are_read_packet_by_packet() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording.aedat4");
        let sample = |t| InertialSample { t, temperature: 1.0, acceleration: [2.0; 3], angular_velocity: [3.0; 3] };
        // Packets cover 10 ms.
        let samples: Vec<InertialSample> = (0..30).map(|index| sample(1000 * index)).collect();
        let (sensor, others) = (Sensor::new(346, 260), OtherStreams { frames: false, imu: true });
        let file = File::create(&path).unwrap();
        let mut encoder = Encoder::with_streams(file, Compression::None, sensor, "", others).unwrap();
        encoder.imu(&samples).unwrap();
        encoder.finish().unwrap();

        let read = |damage| {
            let options = RecordingOptions { damage, ..RecordingOptions::default() };
            let (mut extras, mut lost) = (Aedat4Extras::open(&path, &options).unwrap(), Vec::new());
            assert_eq!(extras.first_time(), Some(0));
            let read: Vec<Extra> = std::iter::from_fn(|| extras.next_until(i64::MAX, &mut lost)).collect();
            (read, lost)
        };
        let all: Vec<Extra> = samples.into_iter().map(Extra::Inertial).collect();
        assert_eq!(read(Damage::Refuse), (all.clone(), Vec::new()));

        let mut content = std::fs::read(&path).unwrap();
        let packets: Vec<usize> =
            content.windows(5).enumerate().filter(|(_, bytes)| bytes == b"IMUS\x06").map(|(at, _)| at).collect();
        assert_eq!(packets.len(), 3);
        content[packets[1]] = b'X';
        std::fs::write(&path, content).unwrap();
        let (before, lost) = read(Damage::Refuse);
        assert_eq!(before, all[..10]);
        assert!(lost.len() == 1 && lost[0].contains("IMU samples from here on"), "{lost:?}");
        let (around, lost) = read(Damage::Skip);
        assert_eq!(around, [&all[..10], &all[20..]].concat());
        assert_eq!(lost, ["1 damaged packet of frames and IMU samples"]);
    }
}

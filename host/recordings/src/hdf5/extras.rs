//! Frames and IMU samples in HDF5, in the layout of MVSEC's files. `image_raw` contains images of 8 bits, and
//! `imu` three accelerations in m/s² and three angular rates in rad/s, as in ROS. Their times are in `image_raw_ts` and
//! `imu_ts`.

use std::path::{Path, PathBuf};

use hdf5_reader::error::Error;
use hdf5_reader::{Dataset, SliceInfo, SliceInfoElem};

use super::layout::{Found, TimedDataset};
use super::{arrange, choose, structure, table};
use crate::error::{RecordingError, RecordingErrorKind, Usable};
use crate::extras::{Extras, Frame, InertialSample, Item, Items, OtherStreams, READOUT};
use crate::numbers::{Number, written};
use crate::options::{Damage, RecordingOptions, TimeUnit};
use crate::ros::GRAVITY;

/// Names in reports.
pub const FRAMES: &str = "frames";
pub const SAMPLES: &str = "IMU samples";

/// Largest number of times that are kept in memory (an hour at 1 kHz).
const MOST_TIMES: u64 = 4_000_000;

/// Largest number of pixels of an image.
const MOST_PIXELS: u64 = 1 << 24;

/// Frames or samples, in file order.
struct Timed {
    data: Dataset,
    /// Times in µs.
    times: Vec<i64>,
    next: usize,
}

impl Timed {
    fn open(TimedDataset { data, times }: TimedDataset, unit: TimeUnit, offset: i64) -> Option<Self> {
        let mut numbers = table::numbers(&times, MOST_TIMES)?;
        numbers.truncate(written(numbers.iter(), |time| time.value() == 0.0));
        let times: Option<Vec<i64>> = numbers.iter().map(|time| time.microseconds(unit)).collect();
        let mut times: Vec<i64> = times?.iter().map(|time| time.saturating_add(offset)).collect();
        times.truncate(usize::try_from(*data.shape().first()?).ok()?);
        Some(Self { data, times, next: 0 })
    }

    fn time(&self) -> Option<i64> {
        self.times.get(self.next).copied()
    }

    /// Skips an element that cannot be read, together with the rest of its chunk. An array without chunks is
    /// unreadable only if the file is cut off, so the rest of it is skipped.
    fn pass_over(&mut self) {
        let side = self.data.chunks().and_then(|sides| usize::try_from(*sides.first()?).ok());
        self.next = side.map_or(self.times.len(), |side| (self.next / side.max(1) + 1).saturating_mul(side.max(1)));
    }

    fn frame(&self, t: i64) -> Result<Frame, Error> {
        let side = |axis: usize| self.data.shape().get(axis).copied().unwrap_or(0);
        let (height, width) = (side(1), side(2));
        let too_large = || Error::InvalidData("images larger than any sensor".to_owned());
        if height.checked_mul(width).is_none_or(|pixels| pixels > MOST_PIXELS) {
            return Err(too_large());
        }
        let all = |side: u64| SliceInfoElem::Slice { start: 0, end: side, step: 1 };
        let selections = vec![SliceInfoElem::Index(self.next as u64), all(height), all(width)];
        let pixels = self.data.read_slice::<u8>(&SliceInfo { selections })?.into_iter().collect();
        let size = u16::try_from(width).ok().zip(u16::try_from(height).ok());
        let size = size.ok_or_else(too_large)?;
        Ok(Frame { t, exposure: None, readout: None, size, position: (0, 0), channels: 1, pixels })
    }

    fn sample(&self, t: i64) -> Result<InertialSample, Error> {
        let numbers = table::row(&self.data, self.next as u64)?;
        let &[ax, ay, az, gx, gy, gz] = numbers.as_slice() else {
            return Err(Error::InvalidData("IMU samples that do not have six numbers".to_owned()));
        };
        let three = |numbers: [Number; 3], scale: f64| numbers.map(|number| (number.value() * scale) as f32);
        Ok(InertialSample {
            t,
            temperature: 0.0,
            acceleration: three([ax, ay, az], 1.0 / GRAVITY),
            angular_velocity: three([gx, gy, gz], 180.0 / std::f64::consts::PI),
        })
    }
}

/// Reader of the frames and samples that belong to the events being read, in order of time.
struct Reader {
    path: PathBuf,
    frames: Option<Timed>,
    samples: Option<Timed>,
    damage: Damage,
}

impl Reader {
    fn open(path: &Path, options: &RecordingOptions) -> Result<Self, RecordingError> {
        let Found { table, offset, frames, samples, .. } = choose(path, options)?.0;
        let unit = arrange(path, table, options, &mut Vec::new())?.unit.unit;
        let offset = offset.and_then(|offset| offset.microseconds(unit)).unwrap_or(0);
        let open = |found: Option<TimedDataset>| Timed::open(found?, unit, offset);
        Ok(Self { path: path.to_owned(), frames: open(frames), samples: open(samples), damage: options.damage })
    }
}

impl Iterator for Reader {
    type Item = Result<Item, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        let frame = self.frames.as_ref().and_then(Timed::time);
        let sample = self.samples.as_ref().and_then(Timed::time);
        let (timed, read) = match (frame, sample, &mut self.frames, &mut self.samples) {
            (Some(frame), sample, Some(frames), _)
                if sample.is_none_or(|sample| frame.saturating_sub(READOUT) <= sample) =>
            {
                let read = frames.frame(frame).map(|frame| Item::Frame(frame, None));
                (frames, read)
            }
            (_, Some(sample), _, Some(samples)) => {
                let read = samples.sample(sample).map(Item::Inertial);
                (samples, read)
            }
            _ => return None,
        };
        Some(match read {
            Ok(item) => {
                timed.next += 1;
                Ok(item)
            }
            Err(error) => {
                timed.pass_over();
                Item::skipped(damaged(&self.path, &error), self.damage)
            }
        })
    }
}

/// Opens the frames of the file at `path`.
pub fn frames(path: &Path, options: &RecordingOptions) -> Result<Items, RecordingError> {
    Ok(Box::new(Reader { samples: None, ..Reader::open(path, options)? }))
}

/// Opens the frames and IMU samples of the file at `path`.
pub fn open(path: &Path, options: &RecordingOptions) -> Result<Extras, RecordingError> {
    let reader = Reader::open(path, options)?;
    let streams = OtherStreams { frames: reader.frames.is_some(), imu: reader.samples.is_some() };
    Ok(Extras::new(streams, [FRAMES, SAMPLES].map(str::to_owned), Box::new(reader)))
}

/// Converts an error about frames or samples.
fn damaged(path: &Path, error: &Error) -> RecordingError {
    match structure(path, error) {
        RecordingError { kind: RecordingErrorKind::Damaged { byte, .. }, path } => RecordingError::damaged(
            &path,
            byte,
            format!("frames or IMU samples cannot be read: {error}"),
            Usable::Before,
        ),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::super::structure::tests::shaped;
    use super::super::structure::{Number, group, superblock};
    use crate::extras::Extra;
    use crate::{Damage, Recording, RecordingOptions};

    /// Builds a file with four events, two samples, and two images whose data are missing.
    fn without_pictures() -> Vec<u8> {
        const NUMBER: Number = Number::Integer { size: 8, is_signed: true };
        let arrays: [(&str, &[u64], Vec<i64>); 7] = [
            ("t_us", &[4], vec![100, 200, 300, 400]),
            ("x", &[4], vec![1, 2, 3, 4]),
            ("y", &[4], vec![1, 2, 3, 2]),
            ("p", &[4], vec![0, 1, 0, 1]),
            ("image_raw_ts", &[2], vec![150, 250]),
            ("imu_ts", &[2], vec![160, 260]),
            ("imu", &[2, 6], (0..12).collect()),
        ];
        let (mut bytes, mut objects) = (vec![0; 48], Vec::new());
        for (name, sides, numbers) in arrays {
            let address = bytes.len() as u64;
            bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
            objects.push((name, bytes.len() as u64));
            bytes.extend(shaped(NUMBER, sides, address));
        }
        objects.push(("image_raw", bytes.len() as u64));
        bytes.extend(shaped(Number::Integer { size: 1, is_signed: false }, &[2, 4, 5], 1 << 40));
        let left = bytes.len() as u64;
        bytes.extend(group(&objects, &[]));
        let root = bytes.len() as u64;
        bytes.extend(group(&[("left", left)], &[]));
        let length = bytes.len() as u64;
        bytes.splice(..48, superblock(root, length));
        bytes
    }

    fn read(damage: Damage) -> (Vec<i64>, Vec<String>) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, without_pictures()).unwrap();
        let recording = Recording::new(&path, RecordingOptions { damage, ..RecordingOptions::default() }).unwrap();
        let (mut extras, mut lost) = (recording.open_extras().unwrap(), Vec::new());
        assert!(extras.streams().frames && extras.streams().imu);
        let read: Vec<Extra> = std::iter::from_fn(|| extras.next_until(i64::MAX, &mut lost)).collect();
        let samples = read.iter().map(|extra| match extra {
            Extra::Inertial(sample) => sample.t,
            Extra::Frame(_) => panic!("a picture that is not there"),
        });
        (samples.collect(), lost)
    }

    /// Damage must not look like the end of the file.
    #[test]
    fn a_damaged_first_frame_is_reported() {
        let (samples, lost) = read(Damage::Refuse);
        assert!(samples.is_empty() && lost.len() == 1 && lost[0].contains("cannot be read"), "{samples:?} {lost:?}");
    }

    #[test]
    fn samples_are_read_if_damaged_frames_are_skipped() {
        let lost = "1 damaged packet of frames and IMU samples".to_owned();
        assert_eq!(read(Damage::Skip), (vec![160, 260], vec![lost]));
    }
}

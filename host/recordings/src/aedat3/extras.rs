//! Frames and IMU samples of AEDAT 3. In 3.0 rows count from below.
//!
//! | packet | layout of an event |
//! |---|---|
//! | 2, frames | u32 (bit 0 valid, 1–3 channels), i32 times in µs: start and end of the frame, start and end of the exposure; i32 width, height, column, row; u16 values, red before blue |
//! | 3, IMU samples | u32 (bit 0 valid), i32 time in µs; f32 accelerations x, y, z in g, rates x, y, z in °/s, °C |

use std::path::Path;

use super::packets::{PacketHead, name, next_head, time};
use super::{Decoder, other_name, start};
use crate::error::{RecordingError, up_to_damage};
use crate::extras::{Extras, Frame, InertialSample, Item, Items, OtherStreams};
use crate::options::RecordingOptions;

const FRAMES: i16 = 2;
const SAMPLES: i16 = 3;
/// Number of bytes of a frame before its pixels.
const FRAME_HEAD: usize = 36;
const SAMPLE: usize = 36;
/// Size limit of a frame or sample in bytes (64 MiB); a larger one is treated as damage.
const LARGEST: u64 = 1 << 26;

impl Decoder {
    fn upright(&self, frame: Frame) -> Frame {
        if self.from_below.is_some() { frame.flipped(self.from_below) } else { frame }
    }

    /// Returns the head of the next complete packet of frames or samples.
    fn next_packet(&mut self) -> Result<Option<PacketHead>, RecordingError> {
        while let Some(head) = next_head(&mut self.file, &mut None)?.filter(|head| head.length == head.wanted) {
            if matches!(head.kind, FRAMES | SAMPLES) && self.header.is_of(self.source, head.source) {
                return Ok(Some(head));
            }
            self.file.seek(self.file.position() + head.length)?;
        }
        Ok(None)
    }

    fn next_item(&mut self) -> Result<Option<Item>, RecordingError> {
        loop {
            let begun = match self.begun.take() {
                None => self.next_packet()?,
                begun => begun,
            };
            let Some(head) = begun else { return Ok(None) };
            if head.size == 0 || head.size > head.length || head.size > LARGEST {
                self.file.seek(self.file.position() + head.length)?;
                if head.size > LARGEST && head.length > 0 {
                    let what =
                        format!("a packet of {} states a size of {} bytes per element", name(head.kind), head.size);
                    return Err(self.file.damaged(head.byte, what));
                }
                continue;
            }
            self.file.read(&mut self.part, head.size)?;
            self.begun = Some(head.without(head.size));
            if self.part.first().is_none_or(|flags| flags & 1 == 0) {
                continue;
            }
            let item = match head.kind {
                FRAMES => frame(&head, &self.part).map(|frame| Item::Frame(self.upright(frame), None)),
                _ => sample(&head, &self.part).map(Item::Inertial),
            };
            let damaged = || self.file.damaged(head.byte, format!("a packet of {} is damaged", name(head.kind)));
            return item.map(Some).ok_or_else(damaged);
        }
    }
}

impl Iterator for Decoder {
    type Item = Result<Item, RecordingError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.next_item().transpose()
    }
}

fn frame(head: &PacketHead, event: &[u8]) -> Option<Frame> {
    let (start, pixels) = event.split_first_chunk::<FRAME_HEAD>()?;
    let [info, times @ .., width, height, x, y] = start.as_chunks::<4>().0 else { return None };
    let [start, end, exposure_start, exposure_end] =
        times.try_into().ok().map(|times: [_; 4]| times.map(|t| time(head, t)))?;
    let side = |bytes: &[u8; 4]| u16::try_from(i32::from_le_bytes(*bytes)).ok();
    let (size, position) = ((side(width)?, side(height)?), (side(x)?, side(y)?));
    let channels = usize::from(info[0] >> 1 & 7);
    let values = usize::from(size.0) * usize::from(size.1) * channels;
    // Keeps the upper 8 of 16 bits.
    let upper = || pixels.as_chunks::<2>().0.get(..values).map(|values| values.iter().map(|[_, upper]| *upper));
    let pixels = match channels {
        1 => upper()?.collect(),
        3 | 4 => {
            let mut pixels: Vec<u8> = upper()?.collect();
            pixels.chunks_exact_mut(channels).for_each(|pixel| pixel.swap(0, 2));
            pixels
        }
        _ => return None,
    };
    let exposure = (exposure_start, exposure_end);
    let t = exposure_start.midpoint(exposure_end);
    Some(Frame { t, exposure: Some(exposure), readout: Some((start, end)), size, position, channels, pixels })
}

fn sample(head: &PacketHead, event: &[u8]) -> Option<InertialSample> {
    let [_, t, numbers @ ..] = event.first_chunk::<SAMPLE>()?.as_chunks::<4>().0 else { return None };
    let &[ax, ay, az, gx, gy, gz, temperature] = numbers else { return None };
    let three = |values: [[u8; 4]; 3]| values.map(f32::from_le_bytes);
    Some(InertialSample {
        t: time(head, *t),
        temperature: f32::from_le_bytes(temperature),
        acceleration: three([ax, ay, az]),
        angular_velocity: three([gx, gy, gz]),
    })
}

/// Opens the frames and IMU samples of the file at `path`. The reader of the events reports an invalid header.
pub fn items(path: &Path, options: &RecordingOptions) -> Result<Items, RecordingError> {
    Ok(Box::new(begin(path, options)?.into_iter().flatten()))
}

/// Opens the file at `path` as it is now, even if it is still being written.
fn begin(path: &Path, options: &RecordingOptions) -> Result<Option<Decoder>, RecordingError> {
    start(path, &RecordingOptions { growth: None, ..options.clone() })
}

/// Opens the frames and IMU samples of the file at `path`.
pub fn open(path: &Path, options: &RecordingOptions) -> Result<Extras, RecordingError> {
    let Some(mut heads) = begin(path, options)? else { return Ok(Extras::default()) };
    let mut streams = OtherStreams::default();
    while !(streams.frames && streams.imu)
        && let Some(head) = up_to_damage(heads.next_packet())?
    {
        streams.frames |= head.kind == FRAMES;
        streams.imu |= head.kind == SAMPLES;
        heads.file.seek(heads.file.position() + head.length)?;
    }
    let name = |kind| other_name(&heads.header, kind, heads.source.unwrap_or_default());
    Ok(Extras::new(streams, [FRAMES, SAMPLES].map(name), items(path, options)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::extras::Extra;
    use crate::{Recording, RecordingOptions, testing};

    fn packet(kind: i16, turns: i32, events: &[Vec<u8>]) -> Vec<u8> {
        let (size, count) = (events[0].len() as i32, events.len() as i32);
        let mut bytes = [kind.to_le_bytes(), 1_i16.to_le_bytes()].concat();
        [size, 4, turns, count, count, count].iter().for_each(|number: &i32| bytes.extend(number.to_le_bytes()));
        bytes.extend(events.concat());
        bytes
    }

    fn numbers(numbers: &[i32]) -> Vec<u8> {
        numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
    }

    fn frame_event(channels: i32, valid: i32, pixels: &[u16]) -> Vec<u8> {
        let width = pixels.len() as i32 / channels / 2;
        let head = [channels << 1 | valid, 100, 200, 110, 191, width, 2, 5, 6];
        [numbers(&head), pixels.iter().flat_map(|value| value.to_le_bytes()).collect()].concat()
    }

    fn sample_event(t: i32) -> Vec<u8> {
        let values = [0.5_f32, -1.0, 0.25, 10.0, -20.0, 30.0, 25.5].map(f32::to_le_bytes);
        [numbers(&[1, t]), values.concat()].concat()
    }

    fn file() -> Vec<u8> {
        let packets = [
            packet(1, 0, &[numbers(&[3 << 17 | 4 << 2 | 3, 90])]),
            packet(
                2,
                1,
                &[frame_event(1, 0, &[0; 6]), frame_event(1, 1, &[0x0100, 0x0200, 0x03ff, 0x0400, 0x0500, 0xff00])],
            ),
            packet(3, 1, &[sample_event(300), sample_event(301)]),
            packet(2, 1, &[frame_event(3, 1, &[0x0100, 0x0200, 0x0300, 0x0400, 0x0500, 0x0600])]),
            packet(1, 1, &[numbers(&[3 << 17 | 4 << 2 | 3, 310])]),
        ];
        let lines = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n#!END-HEADER\r\n";
        [lines.to_vec(), packets.concat()].concat()
    }

    fn recording(content: &[u8]) -> (tempfile::TempDir, Recording) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, content).unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        (directory, recording)
    }

    #[test]
    fn frames_and_samples_are_decoded() {
        let (_directory, recording) = recording(&file());
        let mut extras = recording.open_extras().unwrap();
        assert_eq!(extras.streams(), OtherStreams { frames: true, imu: true });
        let t = |t: i64| (1 << 31) + t;
        let grey = Frame {
            t: t(150),
            exposure: Some((t(110), t(191))),
            readout: Some((t(100), t(200))),
            size: (3, 2),
            position: (5, 6),
            channels: 1,
            pixels: vec![1, 2, 3, 4, 5, 255],
        };
        let coloured = Frame { size: (1, 2), channels: 3, pixels: vec![3, 2, 1, 6, 5, 4], ..grey.clone() };
        let sample = |time| InertialSample {
            t: t(time),
            temperature: 25.5,
            acceleration: [0.5, -1.0, 0.25],
            angular_velocity: [10.0, -20.0, 30.0],
        };
        let expected =
            [Extra::Frame(grey), Extra::Inertial(sample(300)), Extra::Inertial(sample(301)), Extra::Frame(coloured)];
        assert_eq!(extras.next_until(t(99), &mut Vec::new()), None);
        let mut lost = Vec::new();
        let found: Vec<Extra> = std::iter::from_fn(|| extras.next_until(i64::MAX, &mut lost)).collect();
        assert_eq!((found.as_slice(), lost), (expected.as_slice(), Vec::new()));
        assert_eq!(extras.names, ["frames (2)", "IMU samples (3)"]);
        let mut count = 0;
        assert_eq!(recording.visit_frames(|_| count += 1).unwrap(), None);
        assert_eq!(count, 2);
    }

    /// In 3.0 the first row is the lowest one, and the header has no end mark.
    #[test]
    fn frames_of_3_0_are_flipped() {
        let content = file();
        let packets = content.windows(2).position(|bytes| bytes == b"\n\x01").unwrap() + 1;
        let lines = b"#!AER-DAT3.0\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n";
        let (_directory, recording) = recording(&[lines, &content[packets..]].concat());
        let mut extras = recording.open_extras().unwrap();
        let found: Vec<Extra> = std::iter::from_fn(|| extras.next_until(i64::MAX, &mut Vec::new())).collect();
        let Some(Extra::Frame(grey)) = found.first() else { panic!("a frame first") };
        assert_eq!((&grey.pixels[..], grey.position), (&[4, 5, 255, 1, 2, 3][..], (5, 260 - 6 - 2)));
        let Some(Extra::Frame(coloured)) = found.last() else { panic!("a frame last") };
        assert_eq!(coloured.pixels, [6, 5, 4, 3, 2, 1]);
        assert_eq!(found.len(), 4);
    }

    /// A packet may be as large as its file, so its frames must not be read at once.
    #[test]
    fn frames_of_a_packet_are_read_one_by_one() {
        let good = frame_event(1, 1, &[0x0100, 0x0200, 0x0300, 0x0400, 0x0500, 0x0600]);
        let mut bad = good.clone();
        bad[20] = 4;
        let lines = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n#!END-HEADER\r\n";
        let frames = packet(2, 0, &[good.clone(), good.clone(), bad, good.clone()]);
        let (_directory, recording) = recording(&[&lines[..], &frames].concat());
        let mut count = 0;
        let lost = recording.visit_frames(|_| count += 1).unwrap().unwrap();
        assert!(count == 2 && lost.contains("frames is damaged"), "{count} {lost}");
        let mut packets = begin(recording.path(), &RecordingOptions::default()).unwrap().unwrap();
        packets.next().unwrap().unwrap();
        assert_eq!(packets.part.len(), good.len());
    }

    /// Damage must not look like the end of the file.
    #[test]
    fn a_damaged_first_frame_is_reported() {
        let mut bad = frame_event(1, 1, &[0x0100, 0x0200, 0x0300, 0x0400, 0x0500, 0x0600]);
        bad[20] = 4;
        let lines = b"#!AER-DAT3.1\r\n#Format: RAW\r\n#Source 1: DAVIS346\r\n#!END-HEADER\r\n";
        let (_directory, recording) = recording(&[&lines[..], &packet(2, 0, &[bad])].concat());
        let (mut extras, mut lost) = (recording.open_extras().unwrap(), Vec::new());
        assert_eq!((extras.next_until(0, &mut lost), extras.next_until(i64::MAX, &mut lost)), (None, None));
        assert!(lost.len() == 1 && lost[0].contains(&format!("byte {}", lines.len())), "{lost:?}");
    }

    /// The reader must not allocate whatever size the head of a packet states.
    #[test]
    fn frames_that_are_too_large_are_damage() {
        let (directory, _) = recording(&file());
        let path = directory.path().join("recording");
        let (byte, size) = (file().len() as u64, LARGEST as i32 + 1);
        let head = [2_i16.to_le_bytes(), 1_i16.to_le_bytes()].concat();
        let head = [head, numbers(&[size, 4, 0, 1, 1, 1])].concat();
        std::fs::write(&path, [file(), head].concat()).unwrap();
        let sparse = std::fs::OpenOptions::new().append(true).open(&path).unwrap();
        sparse.set_len(byte + 28 + size as u64).unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        let mut count = 0;
        let lost = recording.visit_frames(|_| count += 1).unwrap().unwrap();
        assert!(count == 2 && lost.contains(&format!("byte {byte}")) && lost.contains("67108865 bytes"), "{lost}");
    }

    #[test]
    fn a_frame_larger_than_its_event_is_damage() {
        let mut content = file();
        let width = content.windows(8).rposition(|bytes| bytes == [3, 0, 0, 0, 2, 0, 0, 0]).unwrap();
        content[width] = 4;
        let (_directory, recording) = recording(&content);
        let lost = recording.visit_frames(|_| {}).unwrap().unwrap();
        assert!(lost.contains("frames is damaged") && lost.contains("byte"), "{lost}");
    }

    #[test]
    fn damage_does_not_panic() {
        testing::check_damage(&file());
    }
}

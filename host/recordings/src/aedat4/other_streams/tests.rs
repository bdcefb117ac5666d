//! Tests of the frames and IMU samples of AEDAT4.

use std::fs::File;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::*;
use crate::aedat4::header::Compression;
use crate::aedat4::write::Encoder;
use crate::convert::{TimeOrigin, convert};
use crate::encode::{Encode, OutputFormat};
use crate::extras::{Extra, OtherStreams};
use crate::{Damage, Recording};

/// Builds a FlatBuffer with one table of i64 fields 0 to 4, a format byte, four i16 and a vector of bytes.
pub fn frame_bytes(format: u8, [width, height, x, y]: [i16; 4], pixels: &[u8]) -> Vec<u8> {
    let mut bytes = 40u32.to_le_bytes().to_vec();
    bytes.extend_from_slice(b"FRME");
    // vtable of 11 fields at 8, 26 bytes long: t, frame start and end (absent), exposure, format...
    for entry in [26u16, 48, 4, 0, 0, 12, 20, 28, 30, 32, 34, 36, 40] {
        bytes.extend_from_slice(&entry.to_le_bytes());
    }
    bytes.resize(40, 0);
    bytes.extend_from_slice(&32i32.to_le_bytes());
    for t in [1000i64, 900, 1100] {
        bytes.extend_from_slice(&t.to_le_bytes());
    }
    bytes.extend_from_slice(&[format, 0]);
    for value in [width, height, x, y] {
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.resize(40 + 40, 0);
    bytes.extend_from_slice(&4u32.to_le_bytes());
    bytes.extend_from_slice(&(pixels.len() as u32).to_le_bytes());
    bytes.extend_from_slice(pixels);
    bytes
}

fn parse(bytes: &[u8]) -> Result<Frame, Malformed> {
    parse_any(bytes).map(Result::unwrap)
}

fn parse_any(bytes: &[u8]) -> Result<Result<Frame, UnreadFrame>, Malformed> {
    flatbuffer::root(bytes, b"FRME").and_then(|table| frame(&table))
}

#[test]
fn a_frame_is_read() {
    let expected = Frame {
        t: 1000,
        exposure: Some((900, 1100)),
        readout: None,
        size: (3, 2),
        position: (5, 6),
        channels: 1,
        pixels: vec![1, 2, 3, 4, 5, 6],
    };
    assert_eq!(parse(&frame_bytes(0, [3, 2, 5, 6], &[1, 2, 3, 4, 5, 6])).unwrap(), expected);
    assert_eq!(parse(&frame_bytes(16, [1, 1, 0, 0], &[1, 2, 3])).unwrap().channels, 3);
}

/// Frames of jAER have 16 bits, of which 10 are used.
#[test]
fn frames_of_sixteen_bits_are_read_and_others_are_named() {
    let ten: Vec<u8> = [1000_u16, 500, 4, 0].into_iter().flat_map(u16::to_le_bytes).collect();
    assert_eq!(parse(&frame_bytes(2, [2, 2, 0, 0], &ten)).unwrap().pixels, [250, 125, 1, 0]);
    let coloured: Vec<u8> = [0x0100_u16, 0x0200, 0xff00].into_iter().flat_map(u16::to_le_bytes).collect();
    let frame = parse(&frame_bytes(18, [1, 1, 0, 0], &coloured)).unwrap();
    assert_eq!((frame.channels, frame.pixels), (3, vec![1, 2, 255]));
    for (format, name) in [(1, "8SC1"), (3, "16SC1"), (5, "32FC1"), (21, "32FC3"), (7, "16FC1"), (32, "8UC5")] {
        let unread = parse_any(&frame_bytes(format, [1, 1, 0, 0], &[0; 4])).unwrap().unwrap_err();
        assert_eq!((unread.t, unread.encoding.as_str()), (1000, name));
    }
}

#[test]
fn a_frame_that_contradicts_itself_is_rejected() {
    for (format, size, pixels) in
        [(0, [3, 2, 0, 0], 5), (0, [-3, 2, 0, 0], 6), (2, [3, 2, 0, 0], 6), (16, [3, 2, 0, 0], 6)]
    {
        assert!(parse(&frame_bytes(format, size, &vec![0; pixels])).is_err());
    }
    let bytes = frame_bytes(0, [3, 2, 0, 0], &[0; 6]);
    for length in 0..bytes.len() {
        assert!(parse(&bytes[..length]).is_err());
    }
}

/// Otherwise a packet of some kilobytes could give 16 million samples, one for each zero in such a vector.
#[test]
fn more_tables_than_a_packet_can_hold_are_rejected() {
    let packet = |identifier: &[u8; 4], count: usize| {
        // The vtable is at 8, the root table at 16, the vector at 24.
        let mut bytes = [&16u32.to_le_bytes()[..], identifier].concat();
        bytes.extend([6u16, 8, 4, 0].into_iter().flat_map(u16::to_le_bytes));
        bytes.extend([8, 4, count as u32].into_iter().flat_map(u32::to_le_bytes));
        bytes.resize(28 + 4 * count, 0);
        bytes
    };
    assert!(inertial_packet(&packet(b"IMUS", 1000)).is_err());
    assert!(tables(&packet(b"IMUS", 1000), b"IMUS").is_err() && tables(&packet(b"TRIG", 1000), b"TRIG").is_err());
    let two = Elements { count: 2, times_us: Some((0, 0)), unread: None };
    assert_eq!(tables(&packet(b"TRIG", 2), b"TRIG"), Ok(two));
}

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
        let (mut extras, mut lost) = (open_extras(&path, &options).unwrap(), Vec::new());
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

//! Tests with files of every container: events, frames and samples of their messages.

mod damage;
mod database;
mod files;
mod limits;
mod order;
mod picture;
mod repetition;
mod split_imu;

use std::io::Cursor;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use self::files::{
    Message, Messages, START, bag, event_array, event_packet, events, image, imu, mcap, packed_one_by_one, sized_image,
};
use super::ImageTopic;
use super::fields::Wire;
use super::write::{BAG_OUTPUT, MCAP_OUTPUT};
use crate::encode::{Description, OutputFormat, WriteError};
use crate::extras::{Extra, Frame, InertialSample, OtherStreams};
use crate::image_file::{ImageFile, Samples};
use crate::pictures::NoImage;
use crate::testing::{self, Outcome};
use crate::{Damage, Recording, RecordingOptions};

/// Returns two messages of events, an image and a sample between them, and another message.
fn messages(wire: Wire) -> Messages {
    let slash = |ros1, ros2| if wire == Wire::Ros1 { ros1 } else { ros2 };
    let array = slash("dvs_msgs/EventArray", "dvs_msgs/msg/EventArray");
    vec![
        ("/info", slash("std_msgs/String", "std_msgs/msg/String"), vec![1, 2, 3]),
        ("/dvs/events", array, event_array(wire, &events(0, 4))),
        (
            "/dvs/image_raw",
            slash("sensor_msgs/Image", "sensor_msgs/msg/Image"),
            image(wire, START + 1000, "mono8", 4, &[1, 2, 3, 0, 4, 5, 6, 0]),
        ),
        ("/dvs/imu", slash("sensor_msgs/Imu", "sensor_msgs/msg/Imu"), imu(wire, START + 1500)),
        ("/dvs/events", array, event_array(wire, &events(4, 3))),
    ]
}

fn files(of: impl Fn(Wire) -> Messages) -> Vec<Vec<u8>> {
    let bags = ["none", "bz2", "lz4"].map(|compression| bag(compression, &of(Wire::Ros1)));
    let mcaps = ["-", "", "lz4", "zstd"].map(|compression| mcap(compression, &of(Wire::Cdr)));
    bags.into_iter().chain(mcaps).chain([database::bag(&of(Wire::Cdr))]).collect()
}

#[test]
fn every_container_gives_events_frames_and_samples() {
    for content in files(messages) {
        let Outcome { events: read, information, report, error } = testing::read(&content);
        assert_eq!((read, error), (events(0, 7), None));
        assert_eq!(information.unwrap().sensor, Some(Sensor::new(346, 260)));
        assert!(report.truncated.is_none());
        let names: Vec<&str> = report.other_packets.keys().filter_map(|name| name.split(' ').next()).collect();
        assert_eq!(names, ["/dvs/image_raw", "/dvs/imu", "/info"]);

        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        let streams = recording.streams().unwrap();
        let counts = streams.iter().map(|stream| (stream.packets, stream.elements, stream.times_us));
        let expected = [
            (1, 1, None),
            (2, 7, Some((START, START + 3000))),
            (1, 1, Some((START + 1000, START + 1000))),
            (1, 1, Some((START + 1500, START + 1500))),
        ];
        assert_eq!(counts.collect::<Vec<_>>(), expected);

        let mut extras = recording.open_extras().unwrap();
        assert!(extras.streams().frames && extras.streams().imu);
        let (Some(Extra::Frame(frame)), Some(Extra::Inertial(sample))) =
            (extras.next_until(i64::MAX, &mut Vec::new()), extras.next_until(i64::MAX, &mut Vec::new()))
        else {
            panic!("a frame, then a sample")
        };
        assert_eq!((frame.t, frame.size, frame.pixels), (START + 1000, (3, 2), vec![1, 2, 3, 4, 5, 6]));
        assert_eq!((sample.t, sample.acceleration), (START + 1500, [1.0, 0.0, -1.0]));
        assert!((sample.angular_velocity[1] - 57.295_78).abs() < 1e-4);
    }
}

/// Returns packets of events in two encodings, in two topics.
fn packets(wire: Wire) -> Messages {
    let name = "event_camera_msgs/msg/EventPacket";
    let compressed = [0x0000_u16, 0x1001, 0x2003, 0x3804, 0x3005];
    vec![
        ("/a", name, event_packet(wire, "libcaer_cmp", 1_000_000, &compressed)),
        ("/b", name, event_packet(wire, "evt3", 0, &[0x8001, 0x6002, 0x0007])),
        ("/b", name, event_packet(wire, "evt3", 0, &[0x2003, 0xa001])),
        ("/a", name, event_packet(wire, "libcaer_cmp", 2_000_000, &compressed)),
    ]
}

#[test]
fn a_topic_is_chosen_by_name() {
    let event = |t, y, polarity| Event { t, x: 3, y, polarity };
    for content in files(packets) {
        let options = |name: &str| RecordingOptions { stream: Some(name.to_owned()), ..RecordingOptions::default() };
        let (on, off) = (Polarity::On, Polarity::Off);
        let a = [event(1001, 4, on), event(1001, 5, off), event(2001, 4, on), event(2001, 5, off)];
        assert_eq!(testing::read(&content).events, a);
        assert_eq!(testing::read_with(&content, options("/a")).events, a);
        let b = testing::read_with(&content, options("/b"));
        assert_eq!((b.events, b.report.other_packets.get("triggers")), (vec![event(4098, 7, off)], Some(&1)));
        assert!(b.information.unwrap().notes.iter().any(|note| note.contains("sensor's clock")));
        let error = testing::read_with(&content, options("/c")).error.unwrap();
        assert!(error.contains("/a (event_camera_msgs/msg/EventPacket), /b"), "{error}");
    }
}

/// A launch file that gives both cameras of a rig the same topic.
#[test]
fn cameras_on_one_topic_are_told_apart_by_their_frames() {
    let of = |frame: &[u8], message: Vec<u8>| {
        let at = message.windows(6).position(|bytes| bytes == b"camera").unwrap();
        [&message[..at], frame, &message[at + 6..]].concat()
    };
    let rig = |frames: [&'static [u8]; 6]| {
        move |wire: Wire| -> Messages {
            let name = if wire == Wire::Ros1 { "dvs_msgs/EventArray" } else { "dvs_msgs/msg/EventArray" };
            let message = |(index, frame): (usize, &[u8])| of(frame, event_array(wire, &events(2 * index as i64, 2)));
            frames.into_iter().enumerate().map(|one| ("/dvs/events", name, message(one))).collect()
        }
    };
    let [left, right]: [&[u8]; 2] = [b"cam_le", b"cam_ri"];
    let of_messages = |numbers: [i64; 3]| numbers.into_iter().flat_map(|number| events(2 * number, 2)).collect();
    for content in files(rig([left, right, right, left, left, right])) {
        let Outcome { events: read, information, report, error } = testing::read(&content);
        let left: Vec<Event> = of_messages([0, 3, 4]);
        assert_eq!((read, error), (left, None));
        assert_eq!(report.other_packets.values().sum::<u64>(), 3);
        let notes = information.unwrap().notes;
        assert!(notes.iter().any(|note| note.contains("cam_le") && note.contains("cam_ri")), "{notes:?}");
        let options = RecordingOptions { stream: Some("cam_ri".to_owned()), ..RecordingOptions::default() };
        let right: Vec<Event> = of_messages([1, 2, 5]);
        assert_eq!(testing::read_with(&content, options).events, right);
    }
    // A driver that numbers its frames.
    for content in files(rig([b"img_01", b"img_02", b"img_03", b"img_04", b"img_05", b"img_06"])) {
        assert_eq!(testing::read(&content).events, events(0, 12));
    }
}

/// Some drivers send triggers as event packets.
#[test]
fn packets_in_an_unsupported_encoding_are_skipped() {
    let name = "event_camera_msgs/msg/EventPacket";
    let with = |second: &'static str| {
        move |wire: Wire| -> Messages {
            vec![
                ("/trigger", name, event_packet(wire, "trigger", 0, &[1, 2, 3, 4])),
                ("/events", name, event_packet(wire, second, 1_000_000, &[0x0000, 0x1001, 0x2003, 0x3804])),
            ]
        }
    };
    for content in files(with("libcaer_cmp")) {
        let outcome = testing::read(&content);
        assert_eq!((outcome.error, outcome.events.len()), (None, 1));
    }
    for content in files(with("secret")) {
        let error = testing::read(&content).error.unwrap();
        assert!(error.contains("/trigger") && error.contains("\"trigger\", which is not supported"), "{error}");
    }
}

/// Returns a PNG of two rows of three pixels with consecutive values.
fn png() -> Vec<u8> {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("picture.png");
    let samples = Samples::Eight(vec![1, 2, 3, 4, 5, 6]);
    ImageFile { size: (3, 2), channels: 1, samples }.write_png(&path).unwrap();
    std::fs::read(path).unwrap()
}

fn compressed_image(wire: Wire, t: i64, format: &str, bytes: &[u8]) -> Vec<u8> {
    Message::new(wire, t).text(format).bytes(bytes).finish()
}

/// A topic and its content: events, or the encoding of images.
type TopicContent = (&'static str, &'static str);

/// Returns messages of these topics. Images have two rows of three pixels.
fn images_of(topics: &[TopicContent], wire: Wire) -> Messages {
    let message = |(index, (topic, encoding)): (usize, &TopicContent)| match *encoding {
        "events" => (*topic, "dvs_msgs/msg/EventArray", event_array(wire, &events(0, 3))),
        "png" => {
            let message = compressed_image(wire, START + 1000 * index as i64, "mono8; png compressed ", &png());
            (*topic, "sensor_msgs/msg/CompressedImage", message)
        }
        encoding => {
            let step = if encoding == "mono16" { 6 } else { 3 };
            let pixels: Vec<u8> = (1..=2 * step as u8).collect();
            (*topic, "sensor_msgs/msg/Image", image(wire, START + 1000 * index as i64, encoding, step, &pixels))
        }
    };
    topics.iter().enumerate().map(message).collect()
}

#[test]
fn the_named_topic_of_images_is_read_or_the_only_one() {
    let (one, two) = (("/left", "mono8"), ("/right", "mono16"));
    let (with_events, packed) = (("/dvs", "events"), ("/left/compressed", "png"));
    type Expected = Result<Option<&'static str>, &'static str>;
    let cases: [(&[TopicContent], Option<&str>, Expected); 11] = [
        (&[one, one, one], None, Ok(Some("/left"))),
        (&[one, two], None, Err("several topics (/left (sensor_msgs/msg/Image), /right")),
        (&[one, two], Some("/right"), Ok(Some("/right"))),
        (&[packed, packed], None, Ok(Some("/left/compressed"))),
        (&[one, packed], None, Err("/left/compressed (sensor_msgs/msg/CompressedImage)")),
        (&[one, packed, with_events], Some("/left/compressed"), Ok(Some("/left/compressed"))),
        (&[with_events, one], None, Ok(None)),
        (&[one, with_events], Some("/left"), Ok(Some("/left"))),
        (&[one, with_events], Some("/dvs"), Ok(None)),
        (&[one, with_events], Some("/up"), Err("no topic \"/up\" with events or images; it has /dvs")),
        (&[("/depth", "32FC1")], None, Err("\"32FC1\", which is not supported; convert them to mono, bgr, rgb")),
    ];
    for (topics, wanted, expected) in cases {
        for content in files(|wire| images_of(topics, wire)) {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording");
            std::fs::write(&path, &content).unwrap();
            match (ImageTopic::open(&path, wanted, Damage::Refuse), expected) {
                (Ok(Some(images)), Ok(Some(topic))) => {
                    assert!(images.name().ends_with(&format!(", {topic}")));
                    assert_eq!(images.sensor(), Sensor::new(3, 2));
                    let mut times = Vec::new();
                    assert_eq!(images.visit(|image| times.push(image.exposure.0)).unwrap(), None);
                    let of_topic = topics.iter().enumerate().filter(|(_, (name, _))| *name == topic);
                    assert!(times.iter().copied().eq(of_topic.map(|(index, _)| START + 1000 * index as i64)));
                }
                (Ok(None), Ok(None)) => {}
                (Err(error), Err(part)) => assert!(error.to_string().contains(part), "{error}"),
                (found, _) => panic!("{topics:?} {wanted:?}: {found:?}"),
            }
        }
    }
}

#[test]
fn images_without_increasing_timestamps_are_rejected() {
    let still = |wire| {
        let message = || ("/left", "sensor_msgs/msg/Image", image(wire, START, "mono8", 3, &[1, 2, 3, 4, 5, 6]));
        vec![message(), message()]
    };
    for content in files(still) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let images = ImageTopic::open(&path, None, Damage::Refuse).unwrap().unwrap();
        let error = images.visit(|_| {}).unwrap_err().to_string();
        assert!(error.contains("image 2 of /left") && error.contains("stamp each image"), "{error}");
    }
}

#[test]
fn a_damaged_message_is_named_or_skipped() {
    for wire in [Wire::Ros1, Wire::Cdr] {
        let array = "dvs_msgs/msg/EventArray";
        let mut bad = event_array(wire, &events(2, 2));
        bad.truncate(bad.len() - 3);
        let parts = [event_array(wire, &events(0, 2)), bad, event_array(wire, &events(4, 2))];
        let messages: Messages = parts.into_iter().map(|message| ("/events", array, message)).collect();
        let content = if wire == Wire::Ros1 { bag("none", &messages) } else { mcap("zstd", &messages) };
        let outcome = testing::read(&content);
        // Events of the damaged message before the damage are read.
        assert_eq!(outcome.events, events(0, 3));
        let error = outcome.error.unwrap();
        assert!(error.contains("byte") && error.contains("/events") && error.contains("an event"), "{error}");
        let skip = RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() };
        let outcome = testing::read_with(&content, skip);
        assert_eq!((outcome.error, outcome.report.damaged_packets), (None, 1));
        assert_eq!(outcome.events, [events(0, 3), events(4, 2)].concat());
    }
}

/// A bag contains cameras and IMUs of several makers. The topics that are related to the events by name are read,
/// whichever topic comes first.
#[test]
fn frames_and_samples_are_from_the_camera_whose_events_are_read() {
    let of_rig = |wire: Wire| -> Messages {
        let grey = |t: i64, value: u8| image(wire, t, "mono8", 3, &[value; 6]);
        let array = "dvs_msgs/msg/EventArray";
        vec![
            // A depth image, and an image of another camera, of which only the size matches.
            ("/rig/left/depth/image_raw", "sensor_msgs/msg/Image", image(wire, START, "16UC1", 6, &[9; 12])),
            ("/camera/color/image_raw", "sensor_msgs/msg/Image", image(wire, START, "rgb8", 9, &[9; 18])),
            ("/body/imu", "sensor_msgs/msg/Imu", imu(wire, START + 1)),
            ("/rig/left/image_raw", "sensor_msgs/msg/Image", grey(START + 2, 1)),
            ("/rig/right/image_raw", "sensor_msgs/msg/Image", grey(START + 3, 2)),
            ("/rig/left/events", array, event_array(wire, &events(0, 2))),
            ("/rig/right/events", array, event_array(wire, &events(2, 2))),
            ("/rig/right/imu", "sensor_msgs/msg/Imu", imu(wire, START + 7)),
            ("/rig/left/imu", "sensor_msgs/msg/Imu", imu(wire, START + 8)),
        ]
    };
    for content in files(of_rig) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        for (stream, times) in [(None, [2, 8]), (Some("/rig/left/events"), [2, 8]), (Some("/rig/right/events"), [3, 7])]
        {
            let options = RecordingOptions { stream: stream.map(str::to_owned), ..RecordingOptions::default() };
            let mut reader = Recording::new(&path, options).unwrap().open_extras().unwrap();
            let found: Vec<i64> = std::iter::from_fn(|| reader.next_until(i64::MAX, &mut Vec::new()))
                .map(|extra| match extra {
                    Extra::Frame(frame) => frame.t - START,
                    Extra::Inertial(sample) => sample.t - START,
                })
                .collect();
            assert_eq!(found, times, "{stream:?}");
            let side = if times == [2, 8] { "left" } else { "right" };
            let chosen = [
                format!("frames are read from /rig/{side}/image_raw"),
                format!("IMU samples are read from /rig/{side}/imu"),
            ];
            assert!(reader.chosen().iter().zip(&chosen).all(|(note, part)| note.starts_with(part.as_str())));
        }
    }
}

/// A bag may contain the events of the right camera but only the frames of the left one.
#[test]
fn frames_of_the_other_side_of_a_rig_are_not_read() {
    const PAIRS: [[&str; 3]; 6] = [
        ["/davis/events_l", "/davis/image_l", "/davis/image_r"],
        ["/stereo/L/events", "/stereo/left/image_raw", "/stereo/R/image_raw"],
        ["/rig/left/events", "/rig/left/image_raw", "/rig/right/image_raw"],
        ["/rig/cam0/events", "/rig/cam0/image_raw", "/rig/cam1/image_raw"],
        ["/rig/event_cam_0/events", "/rig/event_cam_0/image_raw", "/rig/event_cam_1/image_raw"],
        ["/rig/dvs_front/events", "/rig/aps/image_raw", "/rig/dvs_rear/image_raw"],
    ];
    let chosen = |content: &[u8]| {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, content).unwrap();
        let extras = Recording::new(&path, RecordingOptions::default()).unwrap().open_extras().unwrap();
        (extras.streams().frames, extras.passed_over().unwrap_or_default())
    };
    for [events_topic, own, other] in PAIRS {
        let with = |frames: &'static str| {
            files(move |wire: Wire| -> Messages {
                vec![
                    (events_topic, "dvs_msgs/msg/EventArray", event_array(wire, &events(0, 2))),
                    (frames, "sensor_msgs/msg/Image", image(wire, START + 2, "mono8", 3, &[9; 6])),
                ]
            })
        };
        for content in with(other) {
            let (frames, named) = chosen(&content);
            assert!(!frames && named.contains("to another camera"), "{other}: {named}");
        }
        for content in with(own) {
            assert!(chosen(&content).0, "{own}");
        }
    }
}

/// If a program enlarges frames, they look like frames of another camera.
#[test]
fn frames_larger_than_the_sensor_are_named() {
    let enlarged = |wire: Wire| -> Messages {
        let image = sized_image(wire, START + 2, [692, 2], "mono8", 692, &[9; 1384]);
        vec![
            ("/dvs/events", "dvs_msgs/msg/EventArray", event_array(wire, &events(0, 2))),
            ("/dvs/image_raw", "sensor_msgs/msg/Image", image),
        ]
    };
    for content in files(enlarged) {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let extras = Recording::new(&path, RecordingOptions::default()).unwrap().open_extras().unwrap();
        let named = extras.passed_over().unwrap();
        assert!(!extras.streams().frames && named.contains("692 x 2 pixels are larger than the sensor"), "{named}");
    }
}

/// Frames must not be dropped silently.
#[test]
fn frames_in_an_unsupported_encoding_are_reported() {
    let encodings = [("16SC1", "16SC1"), ("32FC1", "32FC1"), ("16UC1", "16UC1 (possibly distances)")];
    for (encoding, expected) in encodings {
        let of_camera = |wire: Wire| -> Messages {
            let (step, bytes) = if encoding == "32FC1" { (12, vec![9; 24]) } else { (6, vec![9; 12]) };
            vec![
                ("/dvs/events", "dvs_msgs/msg/EventArray", event_array(wire, &events(0, 2))),
                ("/dvs/image_raw", "sensor_msgs/msg/Image", image(wire, START + 2, encoding, step, &bytes)),
                ("/dvs/image_raw", "sensor_msgs/msg/Image", image(wire, START + 9, "mono8", 3, &[9; 6])),
            ]
        };
        files(of_camera).iter().for_each(|content| check_unread(content, expected));
    }
}

/// Checks that the first of two frames is named as unread, with this encoding.
fn check_unread(content: &[u8], expected: &str) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("recording");
    std::fs::write(&path, content).unwrap();
    let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
    let named: Vec<Option<String>> = recording.streams().unwrap().into_iter().map(|stream| stream.unread).collect();
    assert_eq!(named, [None, Some(expected.to_owned())]);
    let mut images = Vec::new();
    let note = recording.visit_frames(|image| images.push(image.image)).unwrap().unwrap();
    assert!(note.contains(&format!("1 frame is in an unsupported encoding ({expected})")), "{note}");
    assert_eq!((images.len(), &images[0]), (2, &Err(NoImage::UnreadEncoding)));
    let (mut reader, mut lost) = (recording.open_extras().unwrap(), Vec::new());
    assert_eq!(std::iter::from_fn(|| reader.next_until(i64::MAX, &mut lost)).count(), 1);
    assert!(lost.len() == 1 && lost[0].contains(expected), "{lost:?}");
    assert!(!reader.chosen().iter().any(|sentence| sentence.starts_with("frames are read")));
}

/// A file may be cut within a chunk, even within its first one.
#[test]
fn messages_of_a_cut_chunk_are_read_up_to_the_cut() {
    let parts = |wire: Wire| -> Messages {
        (0..2).map(|part| ("/e", "dvs_msgs/msg/EventArray", event_array(wire, &events(100 * part, 100)))).collect()
    };
    for content in [bag("none", &parts(Wire::Ros1)), mcap("", &parts(Wire::Cdr))] {
        let outcome = testing::read(&content[..content.len() * 7 / 10]);
        assert!(outcome.events == events(0, 100), "{} events", outcome.events.len());
        assert!(outcome.report.truncated.is_some());
        // Cut within the first message.
        let error = testing::read(&content[..content.len() / 4]).error.unwrap();
        assert!(error.contains("no events precede it"), "{error}");
    }
}

#[test]
fn arrays_of_other_drivers_are_read() {
    for type_name in ["dv_ros_msgs/EventArray", "samsung_event_msgs/EventArray"] {
        let content = bag("none", &vec![("/e", type_name, event_array(Wire::Ros1, &events(0, 9)))]);
        assert_eq!(testing::read(&content).events, events(0, 9), "{type_name}");
    }
}

#[test]
fn individually_compressed_messages_are_read() {
    let messages = || packed_one_by_one(messages(Wire::Cdr));
    for content in [database::bag(&messages()), mcap("", &messages()), mcap("lz4", &messages())] {
        let outcome = testing::read(&content);
        assert_eq!((outcome.events, outcome.error), (events(0, 7), None));
        let streams = {
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording");
            std::fs::write(&path, &content).unwrap();
            Recording::new(&path, RecordingOptions::default()).unwrap().streams().unwrap()
        };
        assert_eq!(streams.iter().map(|stream| stream.elements).collect::<Vec<_>>(), [1, 7, 1, 1]);
        let mut cut = content.clone();
        let start = cut.windows(4).rposition(|bytes| bytes == [0x28, 0xb5, 0x2f, 0xfd]).unwrap();
        cut[start + 4..start + 12].fill(0xff);
        let error = testing::read(&cut).error;
        assert!(error.is_none_or(|error| error.contains("damaged")));
    }
}

/// Drivers that are starting send messages without events and without the size of the sensor. If no camera is
/// connected, they send no other messages.
#[test]
fn messages_without_events_do_not_determine_the_sensor() {
    let of = |wire: Wire| -> Messages {
        let array = "dvs_msgs/msg/EventArray";
        let mut empty = Message::new(wire, 99);
        [0_u32; 3].iter().for_each(|number| _ = empty.number(number.to_le_bytes()));
        let empty = empty.finish();
        let silent = || ("/right/events", array, event_array(wire, &[]));
        vec![
            silent(),
            ("/left/events", array, empty),
            silent(),
            ("/left/events", array, event_array(wire, &events(0, 7))),
        ]
    };
    for content in files(of) {
        let outcome = testing::read(&content);
        assert_eq!((outcome.events, outcome.error), (events(0, 7), None));
        assert_eq!(outcome.information.unwrap().sensor, Some(Sensor::new(346, 260)));
        let right = RecordingOptions { stream: Some("/right/events".to_owned()), ..RecordingOptions::default() };
        let outcome = testing::read_with(&content, right);
        assert_eq!((outcome.events.len(), outcome.error), (0, None));
    }
}

/// Creates the folder of a bag with these files, listed in its metadata in this order.
fn folder(files: &[(&str, Vec<u8>)], prefix: &str) -> tempfile::TempDir {
    let directory = tempfile::tempdir().unwrap();
    let mut metadata = "rosbag2_bagfile_information:\n  version: 5\n  relative_file_paths:\n".to_owned();
    for (name, content) in files {
        std::fs::write(directory.path().join(name), content).unwrap();
        metadata += &format!("    - {prefix}{name}\n");
    }
    std::fs::write(directory.path().join("metadata.yaml"), metadata).unwrap();
    directory
}

/// Reads the folder. Returns its events, the report, and the error.
fn read_folder(path: &std::path::Path) -> (Vec<Event>, crate::ReadReport, Option<String>) {
    let mut reader = match Recording::new(path, RecordingOptions::default()).and_then(|recording| recording.open()) {
        Ok(reader) => reader,
        Err(error) => return (Vec::new(), Default::default(), Some(error.to_string())),
    };
    let (mut all, mut batch) = (Vec::new(), Vec::new());
    let error = loop {
        match reader.next_batch(&mut batch) {
            Ok(true) => all.extend_from_slice(&batch),
            Ok(false) => break None,
            Err(error) => break Some(error.to_string()),
        }
    };
    (all, reader.report().clone(), error)
}

/// Its metadata used to be read as a table of events.
#[test]
fn the_metadata_of_a_bag_is_read_as_its_folder() {
    let directory = folder(&[("b_0.mcap", mcap("zstd", &messages(Wire::Cdr)))], "");
    let whole = read_folder(directory.path());
    assert!(!whole.0.is_empty());
    assert_eq!(read_folder(&directory.path().join("metadata.yaml")), whole);
    // Other metadata are not.
    let other = tempfile::tempdir().unwrap();
    std::fs::write(other.path().join("metadata.yaml"), "version: 5\n").unwrap();
    assert!(read_folder(&other.path().join("metadata.yaml")).2.is_some());
}

#[test]
fn a_split_bag_is_one_recording() {
    let array = "dvs_msgs/msg/EventArray";
    let second: Messages = vec![
        ("/other", "std_msgs/msg/String", vec![1]),
        ("/dvs/imu", "sensor_msgs/msg/Imu", imu(Wire::Cdr, START + 5000)),
        ("/dvs/events", array, event_array(Wire::Cdr, &events(7, 5))),
    ];
    let first = messages(Wire::Cdr);
    for prefix in ["", "bag/"] {
        // The list determines the order, not the names.
        let parts = [("b_1.mcap", mcap("zstd", &first)), ("b_0.mcap", mcap("", &second))];
        let directory = folder(&parts, prefix);
        let (read, report, error) = read_folder(directory.path());
        assert_eq!((read, error), (events(0, 12), None));
        assert!(report.truncated.is_none());
        let recording = Recording::new(directory.path(), RecordingOptions::default()).unwrap();
        let counts: Vec<(String, u64)> =
            recording.streams().unwrap().into_iter().map(|stream| (stream.name, stream.elements)).collect();
        let count = |name: &str| counts.iter().find(|(known, _)| known.starts_with(name)).unwrap().1;
        assert_eq!((count("/dvs/events"), count("/dvs/imu"), count("/other")), (12, 2, 1));
        let mut extras = recording.open_extras().unwrap();
        assert_eq!(std::iter::from_fn(|| extras.next_until(i64::MAX, &mut Vec::new())).count(), 3);
        assert_eq!(extras.chosen().len(), 2);
    }
    let damaged = mcap("zstd", &first);
    let directory =
        folder(&[("a.mcap", damaged[..damaged.len() - 60].to_vec()), ("b.db3", database::bag(&second))], "");
    let (read, report, error) = read_folder(directory.path());
    assert!(read.ends_with(&events(7, 5)) && error.is_none(), "{error:?}");
    assert!(report.truncated.unwrap().lost.contains("a.mcap"));
}

#[test]
fn missing_files_in_the_folder_of_a_bag_are_named() {
    let first = database::bag(&messages(Wire::Cdr));
    let directory = folder(&[("a.db3", first.clone()), ("b.db3", first.clone())], "");
    std::fs::remove_file(directory.path().join("b.db3")).unwrap();
    let (read, _, error) = read_folder(directory.path());
    assert_eq!(read, events(0, 7));
    assert!(error.unwrap().contains("b.db3"));
    let (_, _, error) = read_folder(folder(&[], "").path());
    assert!(error.unwrap().contains("relative_file_paths"));
    // A folder that contains itself.
    let directory = folder(&[], "");
    std::fs::write(directory.path().join("metadata.yaml"), "rosbag2_bagfile_information: {relative_file_paths: [.]}")
        .unwrap();
    assert!(read_folder(directory.path()).2.unwrap().contains("is a folder"));
    let packed = zstd::stream::encode_all(Cursor::new(&first), 3).unwrap();
    let (_, _, error) = read_folder(folder(&[("a.db3.zstd", packed)], "").path());
    assert!(error.unwrap().contains("is a Zstandard file"));
    let (_, _, error) = read_folder(folder(&[("a.csv", b"t,x,y,p\n1,2,3,1\n".to_vec())], "").path());
    assert!(error.unwrap().contains("in a format other than those of bags"));
}

/// Written files list their topics, so the absence of frames is known without reading all messages.
#[test]
fn the_list_of_topics_matches_the_messages() {
    let extras = [Extra::Inertial(InertialSample {
        t: START + 10,
        temperature: 0.0,
        acceleration: [1.0, 0.0, 0.0],
        angular_velocity: [0.0; 3],
    })];
    for (output, open) in [
        (&BAG_OUTPUT, super::chunked::open::<super::bag::Bag> as super::container::OpenContainer),
        (&MCAP_OUTPUT, super::chunked::open::<super::mcap::Mcap>),
    ] {
        let content = written(output, &events(0, 7), &extras).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let mut container = open(&path).unwrap();
        let listed: Vec<String> = container.listed().unwrap().into_iter().map(|topic| topic.name).collect();
        // Listing does not change the position of reading.
        let mut met = Vec::new();
        while let Some(head) = container.next().unwrap() {
            met.push(container.topics()[head.topic].name.clone());
        }
        assert!(met.len() == 2 && met.iter().all(|name| listed.contains(name)), "{met:?} {listed:?}");
        // A file without its end has no list.
        std::fs::write(&path, &content[..content.len() / 2]).unwrap();
        assert!(open(&path).unwrap().listed().is_none());
    }
}

#[test]
fn files_without_events_list_their_content() {
    let only = |wire| messages(wire).into_iter().filter(|(name, ..)| *name == "/info").collect();
    for content in files(only) {
        let error = testing::read(&content).error.unwrap();
        assert!(error.contains("holds no events, only") && error.contains("/info (std_msgs"), "{error}");
    }
}

#[test]
fn a_database_with_a_write_ahead_log_is_rejected_with_advice() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bag.db3");
    std::fs::write(&path, database::bag(&messages(Wire::Cdr))).unwrap();
    std::fs::write(directory.path().join("bag.db3-wal"), [0; 32]).unwrap();
    let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
    let error = recording.open().err().unwrap().to_string();
    assert!(error.contains("bag.db3-wal") && error.contains("wal_checkpoint"), "{error}");
}

#[test]
fn long_messages_of_a_database_continue_in_other_pages() {
    let long = |wire| vec![("/e", "dvs_msgs/msg/EventArray", event_array(wire, &events(0, 200)))];
    let content = database::bag(&long(Wire::Cdr));
    assert_eq!(testing::read(&content).events, events(0, 200));
}

/// Writes events with frames and samples in between. Returns the content of the file.
fn written(output: &OutputFormat, events: &[Event], extras: &[Extra]) -> Result<Vec<u8>, WriteError> {
    let file = tempfile::NamedTempFile::new().unwrap();
    let others = OtherStreams { frames: true, imu: true };
    let sensor = Sensor::new(346, 260);
    let description = Description { sensor, camera_name: "", others, zero: 0 };
    let mut encoder = (output.create)(&mut || file.reopen(), &description)?;
    encoder.write(events)?;
    for extra in extras {
        assert!(encoder.extra(extra.clone())?);
    }
    encoder.finish()?;
    Ok(std::fs::read(file.path()).unwrap())
}

#[test]
fn written_files_are_read_back() {
    let frame = Frame {
        t: START + 7,
        exposure: None,
        readout: None,
        size: (3, 2),
        position: (0, 0),
        channels: 1,
        pixels: vec![1, 2, 3, 4, 5, 255],
    };
    let colours = Frame { t: START + 50_000, channels: 3, pixels: (0..18).collect(), ..frame.clone() };
    let sample = InertialSample {
        t: START + 60_000,
        temperature: 0.0,
        acceleration: [1.0, -1.0 / 3.0, 1e-3],
        angular_velocity: [0.1, -200.0 / 7.0, 500.0],
    };
    let extras = [Extra::Frame(frame), Extra::Frame(colours), Extra::Inertial(sample)];
    let mixed = |index: i64| (index as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40;
    let many: Vec<Event> = (0..200_000)
        .map(|index| Event {
            t: START + index / 3 + index / 5000 * 20_000,
            x: (mixed(index) % 346) as u16,
            y: (mixed(index) / 346 % 260) as u16,
            polarity: if mixed(index) & 1 == 0 { Polarity::Off } else { Polarity::On },
        })
        .collect();
    for output in [&BAG_OUTPUT, &MCAP_OUTPUT] {
        for events in [&many[..], &many[..1], &[]] {
            let content = written(output, events, &extras).unwrap();
            let outcome = testing::read(&content);
            if !events.is_empty() {
                assert_eq!((outcome.events.as_slice(), outcome.error), (events, None), "{}", output.name);
                assert_eq!(outcome.information.unwrap().sensor, Some(Sensor::new(346, 260)));
            }
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording");
            std::fs::write(&path, &content).unwrap();
            let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
            let mut reader = recording.open_extras().unwrap();
            let found = std::iter::from_fn(|| reader.next_until(i64::MAX, &mut Vec::new()));
            assert_eq!(found.collect::<Vec<_>>(), extras, "{}", output.name);
        }
    }
}

/// Pixels with two values (grey and alpha) must not be written as three.
#[test]
fn frames_are_written_without_alpha() {
    for (channels, written_channels, left_out) in [(2, 1, 1), (4, 3, 3)] {
        let bytes: Vec<u8> = (0..6 * channels as u8).collect();
        let kept = bytes.iter().copied().filter(|byte| usize::from(*byte) % channels != left_out).collect();
        let (t, size, position) = (START + 7, (3, 2), (0, 0));
        let frame = Frame { t, exposure: None, readout: None, size, position, channels, pixels: bytes };
        let expected = Frame { channels: written_channels, pixels: kept, ..frame.clone() };
        for output in [&BAG_OUTPUT, &MCAP_OUTPUT] {
            let content = written(output, &events(0, 7), &[Extra::Frame(frame.clone())]).unwrap();
            let directory = tempfile::tempdir().unwrap();
            let path = directory.path().join("recording");
            std::fs::write(&path, &content).unwrap();
            let mut reader = Recording::new(&path, RecordingOptions::default()).unwrap().open_extras().unwrap();
            let found = reader.next_until(i64::MAX, &mut Vec::new());
            assert_eq!(found, Some(Extra::Frame(expected.clone())), "{}", output.name);
        }
    }
}

#[test]
fn times_outside_the_range_of_ros_are_rejected() {
    let event = |t| [Event { t, x: 0, y: 0, polarity: Polarity::On }];
    for (output, t) in [(&BAG_OUTPUT, -1), (&MCAP_OUTPUT, -1), (&BAG_OUTPUT, 1 << 53), (&MCAP_OUTPUT, 1 << 51)] {
        let error = written(output, &event(t), &[]).unwrap_err().to_string();
        assert!(error.contains(&t.to_string()), "{error}");
    }
}

#[test]
fn damage_loses_as_little_as_possible() {
    let few = |wire: Wire| {
        let array = "dvs_msgs/msg/EventArray";
        (0..3).map(|index| ("/e", array, event_array(wire, &events(3 * index, 3)))).collect()
    };
    for content in files(few) {
        testing::check_damage(&content);
    }
    // The same for files with frames and samples.
    for content in [bag("none", &messages(Wire::Ros1)), mcap("", &messages(Wire::Cdr))] {
        let mut changed = content.clone();
        for position in 0..changed.len() {
            changed[position] ^= 0xff;
            let outcome = testing::read(&changed);
            assert!(outcome.events.is_sorted_by_key(|event| event.t));
            changed[position] ^= 0xff;
        }
    }
}

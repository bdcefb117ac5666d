//! Tests of messages that are not stored in order of their times of recording.

use super::files::{bag_record, mcap_record, mcap_text};
use super::*;

const ARRAY: &str = "dvs_msgs/msg/EventArray";

/// A message, with its time of recording before it.
type Recorded = (i64, (&'static str, &'static str, Vec<u8>));

/// Forty messages of ten events, 5 ms each, with an image and a sample in every fourth; and their times of recording.
fn numbered(wire: Wire) -> Vec<Recorded> {
    let mut messages = Vec::new();
    for index in 0..40 {
        let t = START + 5000 * index;
        messages.push((t + 4900, ("/dvs/events", ARRAY, event_array(wire, &events(10 * index, 10)))));
        if index % 4 == 0 {
            let pixels = [index as u8; 8];
            messages.push((t + 4901, ("/dvs/image_raw", "sensor_msgs/msg/Image", image(wire, t, "mono8", 4, &pixels))));
            messages.push((t + 4902, ("/dvs/imu", "sensor_msgs/msg/Imu", imu(wire, t))));
        }
    }
    messages
}

/// Orders of storage: as recorded, neighbours exchanged, the second half first, reversed, and the first messages last.
fn orders(count: usize) -> [Vec<usize>; 5] {
    let exchanged = (0..count).map(|place| if place ^ 1 < count { place ^ 1 } else { place });
    let halves = (count / 2..count).chain(0..count / 2);
    let turned = (3..count).chain(0..3);
    [(0..count).collect(), exchanged.collect(), halves.collect(), (0..count).rev().collect(), turned.collect()]
}

fn nanoseconds(t: i64) -> [u8; 8] {
    (t * 1000).to_le_bytes()
}

/// Builds an MCAP file with chunks of `side` messages and, if it is `indexed`, a summary.
fn mcap_of(messages: &Messages, times: &[i64], side: usize, indexed: bool) -> Vec<u8> {
    let mut bytes = b"\x89MCAP0\r\n".to_vec();
    let mut names: Vec<&str> = Vec::new();
    let (mut described, mut index) = (Vec::new(), Vec::new());
    for (part, times) in messages.chunks(side).zip(times.chunks(side)) {
        let mut records = Vec::new();
        for ((name, type_name, message), time) in part.iter().zip(times) {
            let known = names.iter().position(|known| known == name);
            let number = (known.unwrap_or(names.len()) as u16 + 1).to_le_bytes();
            if known.is_none() {
                names.push(name);
                let schema = [&number[..], &mcap_text(type_name), &mcap_text("ros2msg"), &mcap_text("")].concat();
                let channel = [&number[..], &number, &mcap_text(name), &mcap_text("cdr"), &[0; 4]].concat();
                let both = [mcap_record(3, &schema), mcap_record(4, &channel)].concat();
                records.extend(&both);
                described.extend(both);
            }
            records.extend(mcap_record(5, &[&number[..], &[0; 4], &nanoseconds(*time), &[0; 8], message].concat()));
        }
        let span = [nanoseconds(*times.iter().min().unwrap()), nanoseconds(*times.iter().max().unwrap())].concat();
        let mut crc = flate2::Crc::new();
        crc.update(&records);
        let length = (records.len() as u64).to_le_bytes();
        let head = [&span[..], &length, &crc.sum().to_le_bytes(), &mcap_text(""), &length].concat();
        let place = (bytes.len() as u64).to_le_bytes();
        bytes.extend(mcap_record(6, &[head, records].concat()));
        index.extend(mcap_record(8, &[&span[..], &place, &[0; 40]].concat()));
    }
    bytes.extend(mcap_record(15, &[0; 4]));
    let summary = bytes.len() as u64;
    if indexed {
        let count = (messages.chunks(side).count() as u32).to_le_bytes();
        bytes.extend([described, index, mcap_record(11, &[&[0; 22][..], &count, &[0; 20]].concat())].concat());
    }
    bytes
        .extend(mcap_record(2, &[if indexed { summary.to_le_bytes() } else { [0; 8] }, [0; 8], [0; 8]].concat()[..20]));
    bytes.extend(b"\x89MCAP0\r\n");
    bytes
}

/// Builds a bag with chunks of `side` messages and, if it is `indexed`, an index.
fn bag_of(messages: &Messages, times: &[i64], side: usize, indexed: bool) -> Vec<u8> {
    let ros = |t: i64| [((t / 1_000_000) as u32).to_le_bytes(), ((t % 1_000_000 * 1000) as u32).to_le_bytes()].concat();
    let magic = b"#ROSBAG V2.0\n";
    let first = |index: u64| {
        let count = (messages.chunks(side).count() as u32).to_le_bytes();
        bag_record(&[("op", &[3]), ("index_pos", &index.to_le_bytes()), ("chunk_count", &count)], &[b' '; 20])
    };
    let mut bytes = [magic.to_vec(), first(0)].concat();
    let mut names: Vec<&str> = Vec::new();
    let (mut connections, mut index) = (Vec::new(), Vec::new());
    for (part, times) in messages.chunks(side).zip(times.chunks(side)) {
        let mut chunk = Vec::new();
        for ((name, type_name, message), time) in part.iter().zip(times) {
            let known = names.iter().position(|known| known == name);
            let number = (known.unwrap_or(names.len()) as u32).to_le_bytes();
            if known.is_none() {
                names.push(name);
                let data = bag_record(&[("topic", name.as_bytes()), ("type", type_name.as_bytes())], &[]);
                let head = [("op", &[7_u8][..]), ("conn", &number), ("topic", name.as_bytes())];
                let connection = bag_record(&head, &data[4..data.len() - 4]);
                chunk.extend(&connection);
                connections.extend(connection);
            }
            chunk.extend(bag_record(&[("op", &[2]), ("conn", &number), ("time", &ros(*time))], message));
        }
        let place = (bytes.len() as u64).to_le_bytes();
        let size = (chunk.len() as u32).to_le_bytes();
        bytes.extend(bag_record(&[("op", &[5]), ("compression", b"none"), ("size", &size)], &chunk));
        bytes.extend(bag_record(&[("op", &[4]), ("count", &[2, 0, 0, 0])], &[0; 24]));
        let (start, end) = (ros(*times.iter().min().unwrap()), ros(*times.iter().max().unwrap()));
        let head = [("op", &[6_u8][..]), ("chunk_pos", &place), ("start_time", &start), ("end_time", &end)];
        index.extend(bag_record(&head, &[]));
    }
    if indexed {
        let place = bytes.len() as u64;
        bytes.extend([connections, index].concat());
        bytes[magic.len()..magic.len() + first(0).len()].copy_from_slice(&first(place));
    }
    bytes
}

#[test]
fn messages_are_read_in_order_of_their_times() {
    for wire in [Wire::Ros1, Wire::Cdr] {
        let all = numbered(wire);
        for (number, order) in orders(all.len()).into_iter().enumerate() {
            let times: Vec<i64> = order.iter().map(|place| all[*place].0).collect();
            let stored: Messages = order.iter().map(|place| all[*place].1.clone()).collect();
            let mut files = Vec::new();
            for side in [1, 2, 7, 100] {
                for indexed in [true, false] {
                    files.push(match wire {
                        Wire::Ros1 => bag_of(&stored, &times, side, indexed),
                        Wire::Cdr => mcap_of(&stored, &times, side, indexed),
                    });
                }
            }
            if wire == Wire::Cdr {
                files.push(database::indexed_bag(&stored, &times));
            }
            for (file, content) in files.into_iter().enumerate() {
                let case = format!("{wire:?}, order {number}, file {file}");
                let outcome = testing::read(&content);
                assert_eq!(outcome.error, None, "{case}");
                assert!(outcome.events == events(0, 400), "{case}: {} events", outcome.events.len());
                let report = outcome.report;
                assert_eq!(
                    (report.sorted, report.steps_back, report.clock_resets, report.strays),
                    (0, 0, 0, 0),
                    "{case}"
                );
                assert_eq!(report.other_packets.values().sum::<u64>(), 20, "{case}");
                let directory = tempfile::tempdir().unwrap();
                let path = directory.path().join("recording");
                std::fs::write(&path, &content).unwrap();
                let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
                let mut extras = recording.open_extras().unwrap();
                let mut lost = Vec::new();
                let read: Vec<i64> = std::iter::from_fn(|| extras.next_until(i64::MAX, &mut lost))
                    .map(|extra| match extra {
                        Extra::Frame(frame) => frame.t,
                        Extra::Inertial(sample) => sample.t,
                    })
                    .collect();
                let expected: Vec<i64> = (0..10).flat_map(|index| [START + 20_000 * index; 2]).collect();
                assert_eq!((read, lost), (expected, Vec::new()), "{case}");
            }
        }
    }
}

/// Returns a message with events whose header has the time `t` in µs.
fn stamped(t: i64, mut message: Vec<u8>) -> Vec<u8> {
    let time = [((t / 1_000_000) as u32).to_le_bytes(), ((t % 1_000_000 * 1000) as u32).to_le_bytes()].concat();
    // The number of the message, or the four bytes of the encapsulation, precede it.
    message[4..12].copy_from_slice(&time);
    message
}

/// The computer's clock was set back while it recorded.
#[test]
fn messages_keep_the_order_of_the_file_if_the_clock_was_set_back() {
    for wire in [Wire::Ros1, Wire::Cdr] {
        let name = if wire == Wire::Ros1 { "dvs_msgs/EventArray" } else { "dvs_msgs/msg/EventArray" };
        let message = |index: i64| {
            let events = events(10 * index, 10);
            let t = events[9].t;
            (if index < 20 { t } else { t - 90_000 }, ("/dvs/events", name, stamped(t, event_array(wire, &events))))
        };
        let (times, stored): (Vec<i64>, Messages) = (0..40).map(message).unzip();
        let mut files: Vec<Vec<u8>> = [1, 2, 7]
            .map(|side| match wire {
                Wire::Ros1 => bag_of(&stored, &times, side, true),
                Wire::Cdr => mcap_of(&stored, &times, side, true),
            })
            .into();
        if wire == Wire::Cdr {
            files.push(database::indexed_bag(&stored, &times));
        }
        for content in files {
            let outcome = testing::read(&content);
            assert_eq!(outcome.error, None);
            assert!(outcome.events == events(0, 400), "{} events", outcome.events.len());
            let report = outcome.report;
            assert_eq!((report.sorted, report.steps_back, report.clock_resets), (0, 0, 0), "{wire:?}");
        }
    }
}

/// A damaged chunk of a file that is not in order, and a file that ends early.
#[test]
fn damage_in_a_file_out_of_order_loses_only_its_chunk() {
    let all = numbered(Wire::Cdr);
    let order = &orders(all.len())[2];
    let times: Vec<i64> = order.iter().map(|place| all[*place].0).collect();
    let stored: Messages = order.iter().map(|place| all[*place].1.clone()).collect();
    let content = mcap_of(&stored, &times, 6, true);
    let whole = testing::read(&content).events;
    for cut in (content.len() / 8..content.len()).step_by(content.len() / 8) {
        let outcome = testing::read(&content[..cut]);
        // Behind the last chunk there is only a summary.
        let is_whole = outcome.events.len() == whole.len();
        assert!(outcome.report.truncated.is_some() || outcome.error.is_some() || is_whole, "{cut}");
        assert!(outcome.events.is_sorted_by_key(|event| event.t), "{cut}");
    }
    // The second chunk: the first one describes the topics.
    let length = u64::from_le_bytes(content[9..17].try_into().unwrap()) as usize;
    let chunk = 17 + length;
    assert_eq!(content[chunk], 6);
    let mut damaged = content.clone();
    // In the content of the chunk, behind its head of 53 bytes.
    damaged[chunk + 9 + 60] ^= 1;
    let options = RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() };
    let outcome = testing::read_with(&damaged, options);
    assert_eq!((outcome.error, outcome.report.damaged_packets), (None, 1));
    assert!(outcome.events.len() < whole.len() && outcome.events.iter().all(|event| whole.contains(event)));
    let error = testing::read(&damaged).error.unwrap();
    assert!(error.contains(&format!("byte {chunk}: a chunk is damaged: its checksum is")), "{error}");
}

/// Every single bit of a chunk.
#[test]
fn every_flipped_bit_of_a_chunk_is_noticed() {
    let all = numbered(Wire::Cdr);
    let (times, stored): (Vec<i64>, Messages) = all.into_iter().take(4).unzip();
    let content = mcap_of(&stored, &times, 4, true);
    let start = content.windows(9).position(|bytes| bytes[0] == 6 && bytes[3..] == [0; 6]).unwrap() + 9;
    let length = u64::from_le_bytes(content[start - 8..start].try_into().unwrap()) as usize;
    // Behind the times and the checksum, of which 0 means that there is none.
    for position in (start + 28..start + length).step_by(5) {
        let mut damaged = content.clone();
        damaged[position] ^= 1 << (position % 8);
        assert!(testing::read(&damaged).error.is_some(), "{position}");
    }
}

#[test]
fn a_missing_log_and_a_journal_of_a_database_are_named() {
    let messages: Messages = numbered(Wire::Cdr).into_iter().map(|(_, message)| message).collect();
    let directory = tempfile::tempdir().unwrap();
    let (path, log, journal) = ("a.db3", "a.db3-wal", "a.db3-journal");
    let [path, log, journal] = [path, log, journal].map(|name| directory.path().join(name));
    let mut content = database::bag(&messages);
    let notes = || testing::read_file(&path, RecordingOptions::default()).information.unwrap().notes;
    std::fs::write(&path, &content).unwrap();
    assert!(!notes().iter().any(|note| note.contains("write-ahead log")));
    (content[18], content[19]) = (2, 2);
    std::fs::write(&path, &content).unwrap();
    assert!(notes().iter().any(|note| note.contains("write-ahead log") && note.contains("-wal")));
    // An empty log is that of a program that has the database open.
    std::fs::write(&log, b"").unwrap();
    assert!(!notes().iter().any(|note| note.contains("write-ahead log")));
    // A journal whose head was cleared is not needed.
    std::fs::write(&journal, [0; 512]).unwrap();
    assert_eq!(testing::read_file(&path, RecordingOptions::default()).error, None);
    std::fs::write(&journal, b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7rest").unwrap();
    let error = testing::read_file(&path, RecordingOptions::default()).error.unwrap();
    assert!(error.contains("a.db3-journal"), "{error}");
}

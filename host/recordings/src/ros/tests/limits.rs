//! Tests of sizes that a file states wrongly: they must neither fill the memory nor prevent reading the valid content.

use std::fs::{File, OpenOptions};
use std::path::PathBuf;

use super::super::bag::Bag;
use super::super::chunked::open;
use super::super::container::{LONGEST_RECORD, OpenContainer};
use super::super::folder as folders;
use super::super::mcap::Mcap;
use super::files::{bag_record, mcap_record, mcap_text};
use super::*;

/// A few bytes that state a decompressed size of 4 GB must not allocate as much.
#[test]
fn a_chunk_with_too_large_a_stated_size_is_rejected() {
    let mut content = bag("bz2", &messages(Wire::Ros1));
    let size = content.windows(5).position(|bytes| bytes == b"size=").unwrap() + 5;
    content[size..size + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    let error = testing::read(&content).error.unwrap();
    assert!(error.contains("4294967295 bytes"), "{error}");
}

/// Creates a sparse file with this content, followed by zeros that use no disk space.
fn sparse(content: &[u8], zeros: u64) -> (tempfile::TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("recording");
    std::fs::write(&path, content).unwrap();
    let file: File = OpenOptions::new().append(true).open(&path).unwrap();
    file.set_len(content.len() as u64 + zeros).unwrap();
    (directory, path)
}

/// Returns a bag and an MCAP file without their ends, each with seven events.
fn beginnings() -> [Vec<u8>; 2] {
    let mut mcap = mcap("zstd", &messages(Wire::Cdr));
    // Removes the end of the data, the footer and the mark.
    mcap.truncate(mcap.len() - (9 + 4) - (9 + 20) - 8);
    [bag("lz4", &messages(Wire::Ros1)), mcap]
}

/// The reader must not allocate whatever length the head of a record states.
#[test]
fn records_that_are_too_long_are_named_and_not_read() {
    let claimed = LONGEST_RECORD + 1;
    let of_bag = |operation: u8| {
        let mut record = bag_record(&[("op", &[operation]), ("compression", b"none"), ("conn", &[0; 4])], &[]);
        record.truncate(record.len() - 4);
        [record, (claimed as u32).to_le_bytes().to_vec()].concat()
    };
    let of_mcap = |kind: u8| [&[kind][..], &claimed.to_le_bytes()].concat();
    let [bag, mcap] = beginnings();
    let files = [2, 5, 7].map(|operation| (&bag, of_bag(operation)));
    let files = files.into_iter().chain([3, 4, 5, 6].map(|kind| (&mcap, of_mcap(kind))));
    for (beginning, record) in files {
        let (_directory, path) = sparse(&[beginning.as_slice(), &record].concat(), claimed);
        let outcome = testing::read_file(&path, RecordingOptions::default());
        assert_eq!(outcome.events, events(0, 7));
        let error = outcome.error.unwrap();
        let expected = [format!("byte {}", beginning.len()), format!("{claimed} bytes")];
        assert!(expected.iter().all(|part| error.contains(part)), "{error}");
        // The content after it can be read.
        let skip = RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() };
        let outcome = testing::read_file(&path, skip);
        assert_eq!((outcome.events, outcome.error, outcome.report.damaged_packets), (events(0, 7), None, 1));
    }
    let (_directory, path) = sparse(&[&bag[..], &(claimed as u32).to_le_bytes()].concat(), claimed);
    let error = testing::read_file(&path, RecordingOptions::default()).error.unwrap();
    assert!(error.contains(&format!("byte {}", bag.len())) && error.contains("the header of a record"), "{error}");
    // The content after it cannot be found.
    let skip = RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() };
    let outcome = testing::read_file(&path, skip);
    assert_eq!((outcome.events, outcome.error, outcome.report.damaged_packets), (events(0, 7), None, 0));
    assert_eq!(outcome.report.truncated.map(|truncated| truncated.byte), Some(bag.len() as u64));
}

/// Unused records may have any length.
#[test]
fn long_records_that_are_not_needed_are_skipped() {
    let length = LONGEST_RECORD + 1;
    let [bag, mcap] = beginnings();
    let mut index = bag_record(&[("op", &[4])], &[]);
    index.truncate(index.len() - 4);
    let index = [index, (length as u32).to_le_bytes().to_vec()].concat();
    let attachment = [&[9][..], &length.to_le_bytes()].concat();
    for content in [[bag, index].concat(), [mcap, attachment].concat()] {
        let (_directory, path) = sparse(&content, length);
        let outcome = testing::read_file(&path, RecordingOptions::default());
        assert_eq!((outcome.events, outcome.error), (events(0, 7), None));
    }
}

/// The stated size plus one must not overflow.
#[test]
fn a_chunk_of_the_largest_size_is_damaged() {
    let [_, beginning] = beginnings();
    let chunk = [&[0; 16][..], &u64::MAX.to_le_bytes(), &[0; 4], &mcap_text(""), &0_u64.to_le_bytes()].concat();
    let outcome = testing::read(&[beginning, mcap_record(6, &chunk)].concat());
    assert_eq!(outcome.events, events(0, 7));
    assert!(outcome.error.unwrap().contains("its decompressed size is not 18446744073709551615 bytes"));
}

/// The time per connection and per message must not grow with the number of connections.
#[test]
fn many_connections_are_found_quickly() {
    const COUNT: u32 = 60_000;
    let topic = |number: u32| format!("/t{}", number % 20_000);
    let mut bag = b"#ROSBAG V2.0\n".to_vec();
    let mut mcap =
        [b"\x89MCAP0\r\n".to_vec(), mcap_record(3, &[&[1, 0][..], &mcap_text("a/B"), &[0; 8]].concat())].concat();
    for number in 0..COUNT {
        // Numbers are neither in order nor without gaps.
        let id = number.wrapping_mul(0x9E37_79B1);
        let name = topic(number);
        let data = bag_record(&[("type", b"a/B")], &[]);
        let head: [(&str, &[u8]); 3] = [("op", &[7]), ("conn", &id.to_le_bytes()), ("topic", name.as_bytes())];
        bag.extend(bag_record(&head, &data[4..data.len() - 4]));
        let channel = [&(number as u16).to_le_bytes()[..], &[1, 0], &mcap_text(&name), &mcap_text("cdr"), &[0; 4]];
        mcap.extend(mcap_record(4, &channel.concat()));
    }
    for number in (0..COUNT).rev() {
        let id = number.wrapping_mul(0x9E37_79B1);
        bag.extend(bag_record(&[("op", &[2]), ("conn", &id.to_le_bytes()), ("time", &[0; 8])], &[]));
        mcap.extend(mcap_record(5, &[&(number as u16).to_le_bytes()[..], &[0; 20]].concat()));
    }
    mcap.extend(mcap_record(15, &[0; 4]));
    // A bag merges connections of the same name into one topic; MCAP does not.
    for (content, open, topics) in [(bag, open::<Bag> as OpenContainer, 20_000), (mcap, open::<Mcap>, COUNT)] {
        let (_directory, path) = sparse(&content, 0);
        let mut container = open(&path).unwrap();
        for number in (0..COUNT).rev() {
            let head = container.next().unwrap().unwrap();
            assert_eq!(head.topic as u32, number % topics);
            assert_eq!(container.topics()[head.topic].name, topic(number));
        }
        assert!(container.next().unwrap().is_none());
        assert_eq!(container.topics().len() as u32, topics);
    }
}

/// Builds an MCAP file with channels of this type and these names, numbered from 0, and an empty message in each.
fn channels(type_name: &str, names: impl Iterator<Item = String>) -> Vec<u8> {
    let schema = [&[1, 0][..], &mcap_text(type_name), &[0; 8]].concat();
    let mut bytes = mcap_record(3, &schema);
    for (number, name) in names.enumerate() {
        let id = (number as u16).to_le_bytes();
        bytes.extend(mcap_record(4, &[&id[..], &[1, 0], &mcap_text(&name), &mcap_text("cdr"), &[0; 4]].concat()));
        bytes.extend(mcap_record(5, &[&id[..], &[0; 20]].concat()));
    }
    bytes
}

/// The time per topic must not grow with the number of topics in the folder.
#[test]
fn many_topics_of_a_folder_are_merged_by_name() {
    const COUNT: usize = 60_000;
    let file = |step: usize| {
        let names = (0..COUNT).map(|number| format!("/t{}", number * step % COUNT));
        [&b"\x89MCAP0\r\n"[..], &channels("a/B", names), &mcap_record(15, &[0; 4])].concat()
    };
    // 7 and 60 000 have no common factor, so the second file has the same names in another order.
    let directory = folder(&[("a.mcap", file(1)), ("b.mcap", file(7))], "");
    let mut container = folders::opener(directory.path()).unwrap().unwrap()(directory.path()).unwrap();
    for number in (0..COUNT).chain((0..COUNT).map(|number| number * 7 % COUNT)) {
        assert_eq!(container.next().unwrap().unwrap().topic, number);
    }
    assert!(container.next().unwrap().is_none());
    assert_eq!(container.topics().len(), COUNT);
}

/// The time per message must not grow with the number of topics.
#[test]
fn the_related_imu_is_found_among_many() {
    const COUNT: u16 = 60_000;
    let units = channels("sensor_msgs/msg/Imu", (0..COUNT).map(|number| format!("/t{number}/imu")));
    let schema = [&[2, 0][..], &mcap_text("dvs_msgs/msg/EventArray"), &[0; 8]].concat();
    let id = COUNT.to_le_bytes();
    let channel = [&id[..], &[2, 0], &mcap_text("/t777/events"), &mcap_text("cdr"), &[0; 4]].concat();
    let message = [&id[..], &[0; 20], &event_array(Wire::Cdr, &events(0, 7))].concat();
    let sample = [&777_u16.to_le_bytes()[..], &[0; 20], &imu(Wire::Cdr, START)].concat();
    let records =
        [mcap_record(5, &sample), mcap_record(3, &schema), mcap_record(4, &channel), mcap_record(5, &message)];
    let (records, start) = (records.concat(), b"\x89MCAP0\r\n");
    let content = [&start[..], &units, &records, &mcap_record(15, &[0; 4])].concat();
    let (_directory, path) = sparse(&content, 0);
    let reader = Recording::new(&path, RecordingOptions::default()).unwrap().open_extras().unwrap();
    let chosen = reader.chosen();
    assert!(chosen.len() == 1 && chosen[0].contains("/t777/imu ("), "{chosen:?}");
}

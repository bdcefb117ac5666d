//! Tests of reading after damage, and of the messages about it.

use std::ops::Range;

use super::*;

const ARRAY: &str = "dvs_msgs/msg/EventArray";
const PAGE: usize = 512;

fn skip() -> RecordingOptions {
    RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() }
}

/// Returns messages with `each` events, `count` messages in all.
fn arrays(wire: Wire, count: i64, each: i64) -> Messages {
    (0..count).map(|index| ("/e", ARRAY, event_array(wire, &events(each * index, each)))).collect()
}

/// Checks a file with `all` events that is damaged at `byte`. Without skipping, the events before the `lost` ones are
/// read; with skipping, also the events after them. The damage counts as `packets` damaged packets. If that is 0, the
/// rest of the file is reported missing instead.
fn check(content: &[u8], byte: usize, lost: Range<i64>, all: i64, packets: u64) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("recording");
    std::fs::write(&path, content).unwrap();
    let elements = |options| Recording::new(&path, options).unwrap().streams().unwrap()[0].elements;

    let outcome = testing::read(content);
    assert_eq!(outcome.events, events(0, lost.start));
    let error = outcome.error.unwrap();
    assert!(error.contains(&format!("byte {byte}")), "{error}");
    assert_eq!(elements(RecordingOptions::default()), lost.start as u64);

    let outcome = testing::read_with(content, skip());
    assert_eq!(outcome.error, None);
    assert_eq!(outcome.events, [events(0, lost.start), events(lost.end, all - lost.end)].concat());
    assert_eq!(outcome.report.damaged_packets, packets);
    let truncated = outcome.report.truncated.map(|truncated| truncated.byte);
    assert_eq!(truncated, (packets == 0).then_some(byte as u64));
    assert_eq!(elements(skip()), outcome.events.len() as u64);
}

/// Returns the offsets of the database pages that contain its messages.
fn leaves(database: &[u8]) -> Vec<usize> {
    let pages = database.chunks(PAGE).enumerate().skip(3);
    pages.filter(|(_, page)| page[0] == 13).map(|(number, _)| number * PAGE).collect()
}

/// Damage must not cost more than the messages of one page.
#[test]
fn a_damaged_page_of_a_database_loses_only_its_own_messages() {
    let content = database::bag(&arrays(Wire::Cdr, 10, 3));
    let leaf = leaves(&content)[4];
    let mut damaged = content.clone();
    damaged[leaf] = 99;
    check(&damaged, leaf, 12..15, 30, 1);

    // A row that begins after the end of its page.
    let mut damaged = content.clone();
    damaged[leaf + 8..leaf + 10].fill(0xff);
    check(&damaged, leaf, 12..15, 30, 1);

    // The page that lists the others refers to itself, or to a page that does not exist.
    let root = 2 * PAGE;
    let pointer = root + 12 + 2 * 4;
    let cell = root + usize::from(u16::from_be_bytes([content[pointer], content[pointer + 1]]));
    for number in [3_u32, 0, 999] {
        let mut damaged = content.clone();
        damaged[cell..cell + 4].copy_from_slice(&number.to_be_bytes());
        check(&damaged, root, 12..15, 30, 1);
    }

    // Without this list, the other pages cannot be found.
    let mut damaged = content;
    damaged[pointer..pointer + 2].fill(0xff);
    check(&damaged, root, 12..30, 30, 0);
}

#[test]
fn only_a_message_without_its_rest_is_lost() {
    let mut content = database::bag(&arrays(Wire::Cdr, 3, 40));
    let leaf = leaves(&content)[1];
    // The number of the page with the rest of the message.
    content[leaf + PAGE - 4..leaf + PAGE].fill(0xff);
    check(&content, leaf, 40..80, 120, 1);
}

#[test]
fn a_bag_record_without_an_operation_is_skipped() {
    let content = bag("none", &arrays(Wire::Ros1, 20, 3));
    let mut chunks = content.windows(4).enumerate().filter(|(_, bytes)| bytes == b"op=\x05");
    let operation = chunks.nth(2).unwrap().0;
    let record = operation - 8;
    let mut damaged = content.clone();
    damaged[operation..operation + 2].fill(b'x');
    check(&damaged, record, 12..18, 60, 1);

    // The beginning of the next record is unknown.
    for length in [0_u32, 5] {
        let mut damaged = content.clone();
        damaged[record..record + 4].copy_from_slice(&length.to_le_bytes());
        check(&damaged, record, 12..60, 60, 0);
    }
}

#[test]
fn an_unreadable_file_of_a_split_bag_is_named() {
    let (mut first, second) = (database::bag(&arrays(Wire::Cdr, 4, 3)), arrays(Wire::Cdr, 8, 3).split_off(4));
    let pointer = 2 * PAGE + 12 + 2 * 2;
    first[pointer..pointer + 2].fill(0xff);
    let directory = folder(&[("a.db3", first), ("b.mcap", mcap("zstd", &second))], "");
    let outcome = testing::read_file(directory.path(), skip());
    assert_eq!((outcome.events, outcome.error), ([events(0, 6), events(12, 12)].concat(), None));
    let truncated = outcome.report.truncated.unwrap();
    assert!(truncated.byte == 2 * PAGE as u64 && truncated.lost.contains("a.db3"), "{truncated}");
    assert_eq!(outcome.report.damaged_packets, 0);
}

/// Returns frames, the first of which is invalid, a sample, and events.
fn with_bad_frame(wire: Wire) -> Messages {
    let grey = |t, step| ("/dvs/image_raw", "sensor_msgs/msg/Image", image(wire, t, "mono8", step, &[1; 6]));
    vec![
        // The rows would be shorter than three pixels.
        grey(START, 2),
        grey(START + 1, 3),
        ("/dvs/imu", "sensor_msgs/msg/Imu", imu(wire, START + 2)),
        ("/dvs/events", ARRAY, event_array(wire, &events(0, 7))),
    ]
}

/// Returns the times of frames and samples after [`START`], the messages about losses, and the number of images.
fn extras(content: &[u8], options: RecordingOptions) -> (Vec<i64>, Vec<String>, usize) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("recording");
    std::fs::write(&path, content).unwrap();
    let recording = Recording::new(&path, options).unwrap();
    let (mut reader, mut lost) = (recording.open_extras().unwrap(), Vec::new());
    let time = |extra| match extra {
        Extra::Frame(frame) => frame.t - START,
        Extra::Inertial(sample) => sample.t - START,
    };
    let times = std::iter::from_fn(|| reader.next_until(i64::MAX, &mut lost).map(time)).collect();
    let mut pictures = 0;
    recording.visit_frames(|_| pictures += 1).unwrap();
    (times, lost, pictures)
}

/// Damage must not look like the end of the file.
#[test]
fn a_damaged_first_frame_is_reported_or_skipped() {
    for content in files(with_bad_frame) {
        let (times, lost, pictures) = extras(&content, RecordingOptions::default());
        assert_eq!((times, pictures), (Vec::new(), 0));
        assert!(lost.len() == 1 && lost[0].contains("/dvs/image_raw is damaged"), "{lost:?}");
        let skipped = "1 damaged packet of frames and IMU samples".to_owned();
        assert_eq!(extras(&content, skip()), (vec![1, 2], vec![skipped], 1));
    }
}

#[test]
fn frames_after_a_damaged_chunk_or_page_are_read() {
    let frames = |wire: Wire| -> Messages {
        let frame = |t| ("/dvs/image_raw", "sensor_msgs/msg/Image", image(wire, START + t, "mono8", 3, &[1; 6]));
        let mut messages = vec![("/dvs/events", ARRAY, event_array(wire, &events(0, 7)))];
        messages.extend((1..=5).map(frame));
        messages
    };
    let mut damaged_bag = bag("none", &frames(Wire::Ros1));
    let mut chunks = damaged_bag.windows(4).enumerate().filter(|(_, bytes)| bytes == b"op=\x05");
    let second = chunks.nth(1).unwrap().0;
    damaged_bag[second..second + 2].fill(b'x');
    let mut damaged_database = database::bag(&frames(Wire::Cdr));
    let leaf = leaves(&damaged_database)[2];
    damaged_database[leaf] = 99;
    for (content, before, all) in [(damaged_bag, vec![1], vec![1, 4, 5]), (damaged_database, vec![1], vec![1, 3, 4, 5])]
    {
        let (times, lost, pictures) = extras(&content, RecordingOptions::default());
        assert_eq!((times, lost.len(), pictures), (before, 1, 1));
        let pictures = all.len();
        // The reader of the events counts the damage.
        assert_eq!(extras(&content, skip()), (all, Vec::new(), pictures));
    }
}

/// The events before damage at the beginning of a bag "can be used", although there are none.
#[test]
fn damage_before_the_first_event_promises_no_events() {
    let mut content = bag("none", &messages(Wire::Ros1));
    content[13..17].copy_from_slice(&4_u32.to_le_bytes());
    let error = testing::read(&content).error.unwrap();
    assert!(error.contains("byte 13") && error.ends_with("; no events are before it"), "{error}");
}

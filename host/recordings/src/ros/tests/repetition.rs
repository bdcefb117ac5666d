//! Tests of messages that repeat their content: a few kilobytes must not become gigabytes of events.

use super::*;

const PACKET: &str = "event_camera_msgs/msg/EventPacket";

/// A packet is decoded in pieces. Column, first row and overflows of the clock continue from one piece to the next.
#[test]
fn long_packets_are_decoded_like_short_ones() {
    const GROUPS: usize = 50_000;
    let event = |t, y| Event { t, x: 3, y, polarity: Polarity::On };
    let compressed = [0x0000_u16, 0x1001, 0x2003].into_iter().chain([0x4808, 0x50ff].repeat(GROUPS));
    let rows = (0..GROUPS).flat_map(|_| (8..16).map(|y| event(1001, y)));
    // A time that falls by more than half of its range in the middle.
    let record = |index: usize| [(3 << 17 | 7 << 2 | 3_u32), if index < GROUPS / 3 { 0x7fff_fff0 } else { 5 }];
    let plain = (0..GROUPS).flat_map(record).flat_map(|word| [word as u16, (word >> 16) as u16]);
    let overflow = (0..GROUPS).map(|index| event(1000 + if index < GROUPS / 3 { 0x7fff_fff0 } else { 0x8000_0005 }, 7));
    let evt3 = [0x8001_u16, 0x6002, 0x0007].into_iter().chain([0x3803, 0x4001].repeat(GROUPS));
    let vectors = (0..GROUPS).map(|_| event(4098, 7));
    let cases: [(&str, Vec<u16>, Vec<Event>); 3] = [
        ("libcaer_cmp", compressed.collect(), rows.collect()),
        ("libcaer", plain.collect(), overflow.collect()),
        ("evt3", evt3.collect(), vectors.collect()),
    ];
    for (encoding, words, expected) in cases {
        for content in files(|wire| vec![("/a", PACKET, event_packet(wire, encoding, 1_000_000, &words))]) {
            let outcome = testing::read(&content);
            assert_eq!(outcome.error, None);
            assert!(outcome.events == expected, "{encoding}: {} events", outcome.events.len());
        }
    }
}

/// Twelve events per two bytes, and a thousand times smaller in the file.
#[test]
fn a_file_cannot_have_more_events_than_its_size_allows() {
    let words: Vec<u16> = [0x8001_u16, 0x6002, 0x0007, 0x3803].into_iter().chain([0x4fff].repeat(3 << 20)).collect();
    let content = mcap("zstd", &vec![("/a", PACKET, event_packet(Wire::Cdr, "evt3", 0, &words))]);
    assert!(content.len() < 10_000, "{}", content.len());
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("recording");
    std::fs::write(&path, &content).unwrap();
    let sensor = Some(Sensor::new(32_767, 32_767));
    let recording = Recording::new(&path, RecordingOptions { sensor, ..RecordingOptions::default() }).unwrap();
    let (mut reader, mut batch, mut count, mut largest) = (recording.open().unwrap(), Vec::new(), 0, 0);
    let error = loop {
        match reader.next_batch(&mut batch) {
            Ok(more) => {
                assert!(more, "the file is refused");
                count += batch.len();
                largest = largest.max(batch.len());
            }
            Err(error) => break error.to_string(),
        }
    };
    let most = (1 << 24) + 32 * content.len();
    assert!(error.contains(&format!("more than {most} events in {} bytes", content.len())), "{error}");
    assert!(count <= most + (1 << 20) && largest < 1 << 20, "{count} events, {largest} at once");
    assert!(recording.streams().unwrap_err().to_string().contains("more than"));
}

/// `check` used the events before the limit, in several passes of 4 s each.
#[test]
fn a_repetition_is_no_recording_with_damage() {
    let words: Vec<u16> = [0x8001_u16, 0x6002, 0x0007, 0x3803].into_iter().chain([0x4fff].repeat(3 << 20)).collect();
    let mut messages: Messages = vec![("/a", PACKET, event_packet(Wire::Cdr, "evt3", 0, &words[..100]))];
    messages.extend((0..12).map(|_| ("/i", "sensor_msgs/msg/Image", vec![0; 31 << 20])));
    for content in
        [mcap("zstd", &vec![("/a", PACKET, event_packet(Wire::Cdr, "evt3", 0, &words))]), mcap("zstd", &messages)]
    {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("recording");
        std::fs::write(&path, &content).unwrap();
        let recording = Recording::new(&path, RecordingOptions::default()).unwrap();
        let error = crate::pass::read_recording(&recording, &mut |_| {}).err().unwrap();
        assert!(error.kind.is_repetition() && error.to_string().ends_with("its content is a repetition"), "{error}");
    }
}

/// The files of a bag folder count, not the folder itself.
#[test]
fn a_folder_may_have_as_many_events_as_its_files_allow() {
    // More events than a file without content may have.
    const VECTORS: usize = 3 << 19;
    let words: Vec<u16> = [0x8001_u16, 0x6002, 0x0007, 0x3803].into_iter().chain([0x4fff].repeat(VECTORS)).collect();
    let directory =
        folder(&[("b_0.mcap", mcap("", &vec![("/a", PACKET, event_packet(Wire::Cdr, "evt3", 0, &words))]))], "");
    let streams = Recording::new(directory.path(), RecordingOptions::default()).unwrap().streams().unwrap();
    assert_eq!(streams.iter().map(|stream| stream.elements).sum::<u64>(), 12 * VECTORS as u64);
}

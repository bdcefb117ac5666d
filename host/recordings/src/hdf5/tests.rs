//! Tests with chunked files, built byte by byte, and with damage.

use std::io::Write;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;

use super::structure::tests::{chunked, filled, shaped, virtual_array};
use super::structure::{Number, dataset, group, superblock};
use super::write;
use crate::testing::{self, Outcome};
use crate::write::EventWriter;
use crate::{Damage, Recording, RecordingOptions};

/// Numbers per chunk.
const SIDE: usize = 100;
/// Message of the filter pipeline: version, number of filters; then for the filter its number, flags, and number of
/// values.
const DEFLATE: [u8; 8] = [2, 1, 1, 0, 0, 0, 0, 0];

fn events(count: i64) -> Vec<Event> {
    let polarity = |index: i64| if index % 3 == 0 { Polarity::On } else { Polarity::Off };
    let event = |index: i64| Event {
        t: 5 + 37 * index,
        x: (index * 7 % 346) as u16,
        y: (index * 11 % 260) as u16,
        polarity: polarity(index),
    };
    (0..count).map(event).collect()
}

/// Returns a tree of chunks (version 1, a single node) from their lengths and addresses.
fn tree(chunks: &[(usize, u64)]) -> Vec<u8> {
    let nowhere = u64::MAX.to_le_bytes();
    let mut bytes = [&b"TREE\x01\x00"[..], &(chunks.len() as u16).to_le_bytes(), &nowhere, &nowhere].concat();
    let key = |length: usize, index: usize| {
        let offset = ((index * SIDE) as u64).to_le_bytes();
        [&(length as u32).to_le_bytes()[..], &[0; 4], &offset, &[0; 8]].concat()
    };
    for (index, (length, address)) in chunks.iter().enumerate() {
        bytes.extend(key(*length, index));
        bytes.extend(address.to_le_bytes());
    }
    bytes.extend(key(0, chunks.len()));
    // The rest of the node is not read.
    bytes
}

/// Builds a file with the columns t, x, y and p of `events` in chunks, which are the last part of the file: first all
/// of t, then all of x, and so on. The second value is the offsets of the chunks.
fn file(events: &[Event], filters: &[u8]) -> (Vec<u8>, Vec<Vec<usize>>) {
    let columns: [(&str, u8, Vec<Vec<u8>>); 4] = [
        ("t", 8, events.iter().map(|event| event.t.to_le_bytes().to_vec()).collect()),
        ("x", 2, events.iter().map(|event| event.x.to_le_bytes().to_vec()).collect()),
        ("y", 2, events.iter().map(|event| event.y.to_le_bytes().to_vec()).collect()),
        ("p", 1, events.iter().map(|event| vec![event.polarity.index() as u8]).collect()),
    ];
    let pack = |numbers: &[Vec<u8>], size: u8| {
        let mut bytes = numbers.concat();
        bytes.resize(SIDE * usize::from(size), 0);
        let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(&bytes).unwrap();
        encoder.finish().unwrap()
    };
    let packed: Vec<Vec<Vec<u8>>> =
        columns.iter().map(|(_, size, numbers)| numbers.chunks(SIDE).map(|part| pack(part, *size)).collect()).collect();
    let build = |start: usize| {
        let mut bytes = vec![0; 48];
        let (mut objects, mut offsets, mut end) = (Vec::new(), Vec::new(), start);
        for ((name, size, _), chunks) in columns.iter().zip(&packed) {
            let starts: Vec<usize> = chunks
                .iter()
                .scan(end, |end, chunk| {
                    *end += chunk.len();
                    Some(*end - chunk.len())
                })
                .collect();
            end += chunks.iter().map(Vec::len).sum::<usize>();
            let address = bytes.len() as u64;
            let list: Vec<(usize, u64)> =
                chunks.iter().zip(&starts).map(|(chunk, start)| (chunk.len(), *start as u64)).collect();
            bytes.extend(tree(&list));
            objects.push((*name, bytes.len() as u64));
            let numbers = Number::Integer { size: *size, is_signed: *name == "t" };
            bytes.extend(chunked(numbers, events.len() as u64, SIDE as u32, address, filters));
            offsets.push(starts);
        }
        let columns = bytes.len() as u64;
        bytes.extend(group(&objects, &[]));
        let root = bytes.len() as u64;
        bytes.extend(group(&[("events", columns)], &[("width", 346), ("height", 260)]));
        bytes.splice(..48, superblock(root, end as u64));
        (bytes, offsets)
    };
    let start = build(0).0.len();
    let (head, offsets) = build(start);
    ([head, packed.concat().concat()].concat(), offsets)
}

#[test]
fn times_continue_after_a_counter_wrap() {
    for (kept, wrap) in testing::KEPT.into_iter().zip([1 << 32, 1 << 31, 1 << 31]) {
        let events = testing::events_around(wrap);
        let wrapped: Vec<Event> = events.iter().map(|event| Event { t: kept(event.t), ..*event }).collect();
        testing::check_wrap(&file(&wrapped, &DEFLATE).0, &file(&events, &DEFLATE).0);
    }
}

#[test]
fn events_before_and_after_a_damaged_chunk_are_kept() {
    let events = events(1050);
    let (content, offsets) = file(&events, &DEFLATE);
    let Outcome { events: whole, error, information, .. } = testing::read(&content);
    assert_eq!((whole.as_slice(), error), (events.as_slice(), None));
    assert_eq!(information.unwrap().sensor, Some(Sensor::new(346, 260)));
    for (column, chunk) in [(0, 0), (0, 3), (2, 3), (3, 10)] {
        let mut damaged = content.clone();
        damaged[offsets[column][chunk]..][..6].fill(0x5a);
        let outcome = testing::read(&damaged);
        let (before, behind) = (chunk * SIDE, (chunk + 1) * SIDE);
        if before > 0 {
            assert_eq!(outcome.events, events[..before]);
            assert!(outcome.error.unwrap().contains(&format!("event {}", before + 1)));
        } else {
            assert!(outcome.error.is_some() && outcome.events.is_empty());
        }
        let skip = RecordingOptions { damage: Damage::Skip, ..RecordingOptions::default() };
        let outcome = testing::read_with(&damaged, skip);
        if before > 0 {
            assert_eq!((outcome.error, outcome.report.damaged_packets), (None, 1));
            assert_eq!(outcome.events, [&events[..before], &events[behind.min(events.len())..]].concat());
        }
    }
}

/// A program that reserves space first and is ended early leaves such a file.
#[test]
fn reserved_space_is_not_read_as_events() {
    let all = events(1050);
    let nothing = Event { t: 0, x: 0, y: 0, polarity: Polarity::Off };
    for room in [2, 50, 40_000] {
        let (content, _) = file(&[all.as_slice(), &vec![nothing; room]].concat(), &DEFLATE);
        let outcome = testing::read(&content);
        assert_eq!((outcome.events.as_slice(), outcome.error), (all.as_slice(), None));
        assert_eq!((outcome.report.unwritten, outcome.report.clock_resets), (room as u64, 0));
    }
}

/// A few bytes can announce a practically endless number of events.
#[test]
fn arrays_without_any_bytes_end_immediately() {
    const MANY: u64 = 1 << 44;
    let numbers = Number::Integer { size: 8, is_signed: true };
    let mut bytes = vec![0; 48];
    let objects = ["t", "x", "y", "p"].map(|name| {
        let offset = bytes.len() as u64;
        bytes.extend(dataset(numbers, Some(MANY), u64::MAX));
        (name, offset)
    });
    let root = bytes.len() as u64;
    bytes.extend(group(&objects, &[]));
    let length = bytes.len() as u64;
    bytes.splice(..48, superblock(root, length));
    let outcome = testing::read(&bytes);
    assert_eq!((outcome.events.len(), outcome.report.unwritten), (0, MANY));
}

#[test]
fn a_cut_file_is_read_up_to_its_end() {
    let events = events(1050);
    let (content, offsets) = file(&events, &DEFLATE);
    // Within the fourth chunk of the last column.
    let cut = offsets[3][3] + 1;
    let Outcome { events: read, report, error, .. } = testing::read(&content[..cut]);
    assert_eq!((read.as_slice(), error), (&events[..3 * SIDE], None));
    let truncated = report.truncated.unwrap();
    assert_eq!(truncated.byte, cut as u64);
    assert!(
        truncated.lost.contains("750 events") && truncated.lost.contains(&content.len().to_string()),
        "{truncated}"
    );
    // Before the tree of chunks.
    let error = testing::read(&content[..500]).error.unwrap();
    assert!(error.contains("byte 500") && error.contains("nothing can be read, because"), "{error}");
}

#[test]
fn an_unsupported_compression_is_named() {
    for (number, name) in
        [(32026_u16, "Blosc 2 (filter 32026)"), (32008, "Bitshuffle (filter 32008)"), (40000, "filter id 40000")]
    {
        let [low, high] = number.to_le_bytes();
        // Registered filters have the length of a name after their number.
        let (content, _) = file(&events(50), &[2, 1, low, high, 0, 0, 0, 0, 0, 0]);
        let error = testing::read(&content).error.unwrap();
        assert!(error.contains(name) && error.contains("is not supported"), "{error}");
    }
}

/// MATLAB's files begin with a user block of 512 bytes.
#[test]
fn a_user_block_is_skipped() {
    let (content, _) = file(&events(250), &DEFLATE);
    for power in 9..16 {
        let mut block = b"MATLAB 7.3 MAT-file".to_vec();
        block.resize(1 << power, b' ');
        let outcome = testing::read(&[block.as_slice(), &content].concat());
        assert_eq!((outcome.events.as_slice(), outcome.error), (events(250).as_slice(), None), "{power}");
    }
}

#[test]
fn damage_loses_as_little_as_possible() {
    testing::check_damage(&file(&events(120), &DEFLATE).0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("events.h5");
    let mut writer = EventWriter::create(&path, write::OUTPUT, Sensor::new(346, 260), "").unwrap();
    writer.write(&events(40)).unwrap();
    writer.finish().unwrap();
    testing::check_damage(&std::fs::read(path).unwrap());
}

#[test]
fn other_arrays_are_not_taken_for_events() {
    let whole = Number::Integer { size: 8, is_signed: true };
    let content = |names: &[&str]| {
        let mut bytes = vec![0; 48];
        let objects: Vec<(&str, u64)> = names
            .iter()
            .map(|name| {
                let address = bytes.len() as u64;
                bytes.extend([7_i64, 9].map(i64::to_le_bytes).as_flattened());
                let offset = bytes.len() as u64;
                bytes.extend(dataset(whole, Some(2), address));
                (*name, offset)
            })
            .collect();
        let root = bytes.len() as u64;
        bytes.extend(group(&objects, &[]));
        let length = bytes.len() as u64;
        bytes.splice(..48, superblock(root, length));
        bytes
    };
    assert!(
        testing::read(&content(&["t", "x", "y"]))
            .error
            .unwrap()
            .contains("holds no events, only groups without arrays")
    );
    let error = testing::read(&content(&["t", "x", "y", "p"])).error.unwrap();
    assert!(error.contains("polarity is 7"), "{error}");
}

/// An array: its name, its shape and its numbers.
type Array<'a> = (&'a str, &'a [u64], Vec<i64>);

const WHOLE: Number = Number::Integer { size: 8, is_signed: true };

/// Builds a file of groups of arrays.
fn groups(groups: &[(&str, &[Array])]) -> Vec<u8> {
    let mut bytes = vec![0; 48];
    let mut offsets = Vec::new();
    for (name, arrays) in groups {
        let mut objects = Vec::new();
        for (name, sides, numbers) in *arrays {
            let address = bytes.len() as u64;
            bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
            objects.push((*name, bytes.len() as u64));
            bytes.extend(match (*sides, numbers.is_empty()) {
                ([], _) => virtual_array(WHOLE, 5),
                (_, true) => dataset(WHOLE, Some(0), address),
                (sides, false) => shaped(WHOLE, sides, address),
            });
        }
        offsets.push((*name, bytes.len() as u64));
        bytes.extend(group(&objects, &[]));
    }
    let root = bytes.len() as u64;
    bytes.extend(group(&offsets, &[]));
    let length = bytes.len() as u64;
    bytes.splice(..48, superblock(root, length));
    bytes
}

/// Returns the arrays of the times of `events`, multiplied by `scale` and named `t`, and of their x, y and p.
fn four<'a>(t: &'a str, scale: i64, events: &[Event], sides: &'a [u64]) -> [Array<'a>; 4] {
    let numbers = |number: fn(&Event) -> i64| events.iter().map(number).collect::<Vec<_>>();
    let times = events.iter().map(|event| event.t * scale).collect();
    [
        (t, sides, times),
        ("x", sides, numbers(|event| event.x.into())),
        ("y", sides, numbers(|event| event.y.into())),
        ("p", sides, numbers(|event| event.polarity.index() as i64)),
    ]
}

#[test]
fn polarities_of_0_and_255_are_read() {
    let events = events(50);
    let [t, x, y, (name, sides, polarities)] = four("t_us", 1, &events, &[50]);
    let polarities = polarities.into_iter().map(|polarity| polarity * 255).collect();
    let outcome = testing::read(&groups(&[("events", &[t, x, y, (name, sides, polarities)])]));
    assert_eq!((outcome.error, outcome.events), (None, events));
}

/// Nanoseconds must not be taken for microseconds.
#[test]
fn the_name_of_the_times_gives_their_unit() {
    let events = events(50);
    for (name, scale) in [("t_ns", 1000), ("t_us", 1), ("timestamps", 1)] {
        let outcome = testing::read(&groups(&[("events", &four(name, scale, &events, &[50]))]));
        assert_eq!((outcome.events.as_slice(), outcome.error), (events.as_slice(), None), "{name}");
        let guessed = outcome.information.unwrap().notes.iter().any(|note| note.contains("times are taken for"));
        assert_eq!(guessed, name == "timestamps", "{name}");
    }
}

/// eventify stores the events of each frame by pixel.
#[test]
fn events_out_of_order_are_sorted() {
    let all = events(500);
    let mut given = all.clone();
    given.chunks_mut(50).for_each(<[Event]>::reverse);
    let outcome = testing::read(&groups(&[("events", &four("t_us", 1, &given, &[500]))]));
    assert_eq!((outcome.error, outcome.report.sorted, outcome.report.steps_back), (None, 490, 0));
    assert!(outcome.events == all);
}

#[test]
fn columns_of_different_lengths_are_named() {
    let all = events(50);
    let mut arrays = four("t_us", 1, &all, &[50]);
    (arrays[1].1, arrays[3].1) = (&[20], &[40]);
    arrays[1].2.truncate(20);
    arrays[3].2.truncate(40);
    let outcome = testing::read(&groups(&[("events", &arrays)]));
    assert_eq!((outcome.events.as_slice(), outcome.error), (&all[..20], None));
    let notes = outcome.information.unwrap().notes;
    assert!(notes.iter().any(|note| note.contains("(t_us 50, x 20, y 50, p 40): the first 20 of each")), "{notes:?}");
}

/// A first group without events is skipped.
#[test]
fn the_first_group_with_events_is_read() {
    let (events, nothing) = (events(50), Event { t: 0, x: 0, y: 0, polarity: Polarity::Off });
    let right = four("t", 1, &events, &[50]);
    for (left, sides) in [(vec![], [0]), (vec![nothing; 7], [7])] {
        let content = groups(&[("left", &four("t", 1, &left, &sides)), ("right", &right)]);
        let outcome = testing::read(&content);
        assert_eq!((outcome.events.as_slice(), outcome.error), (events.as_slice(), None));
        let notes = outcome.information.unwrap().notes;
        assert!(notes[0].contains("of right are read, the first") && notes[0].contains("left, right"), "{notes:?}");
        let left = RecordingOptions { stream: Some("left".to_owned()), ..RecordingOptions::default() };
        assert!(testing::read_with(&content, left).events.is_empty());
    }
}

#[test]
fn reserved_space_with_another_fill_value_is_not_read_as_events() {
    let events = events(50);
    let mut arrays = four("t", 1, &events, &[53]);
    arrays.iter_mut().for_each(|(_, _, numbers)| numbers.extend([-1; 3]));
    let outcome = testing::read(&groups(&[("events", &arrays)]));
    assert_eq!((outcome.events, outcome.error), (events, None));
    assert_eq!((outcome.report.unwritten, outcome.report.out_of_range), (3, 0));
}

/// A pose has four columns, one of which could be a time and one a polarity.
#[test]
fn matrices_are_not_streams() {
    let identity: Vec<i64> = (0..16).map(|index| i64::from(index % 5 == 0)).collect();
    let (rows, events) = (events(50), events(50));
    let rows = rows.iter().flat_map(|event| [event.t, event.x.into(), event.y.into(), event.polarity.index() as i64]);
    let pose: &[Array] = &[("pose", &[4, 4], identity.clone()), ("projection", &[3, 4], identity[..12].to_vec())];
    let content = groups(&[("calib", pose), ("stream", &[("rows", &[50, 4], rows.collect())])]);
    assert_eq!(testing::read(&content).events, events);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("poses.h5");
    std::fs::write(&path, &content).unwrap();
    let streams = Recording::new(&path, RecordingOptions::default()).unwrap().streams().unwrap();
    assert_eq!(streams.iter().map(|stream| stream.name.as_str()).collect::<Vec<_>>(), ["stream/rows"]);
    assert!(testing::read(&groups(&[("calib", pose)])).error.unwrap().contains("holds no events"));
}

/// The file is intact, so the message must not suggest damage.
#[test]
fn virtual_arrays_are_reported() {
    let arrays = ["t", "x", "y", "p"].map(|name| (name, &[][..], Vec::new()));
    let error = testing::read(&groups(&[("events", &arrays)])).error.unwrap();
    assert!(error.contains("is a virtual HDF5 file"), "{error}");
}

/// The time per array must not grow with the number of arrays.
#[test]
fn the_events_are_found_among_thousands_of_arrays() {
    const COUNT: usize = 4000;
    let number = Number::Integer { size: 4, is_signed: true };
    let mut content = vec![0; super::structure::SUPERBLOCK as usize];
    // Rows t, x, y, p.
    let rows: Vec<u8> = (0..40_i32)
        .flat_map(|row| [1000 + 37 * row, row * 7 % 300, row * 11 % 200, row % 2])
        .flat_map(i32::to_le_bytes)
        .collect();
    let data = content.len() as u64;
    content.extend(rows);
    let array = content.len() as u64;
    content.extend(shaped(number, &[40, 4], data));
    let names: Vec<String> =
        (0..COUNT).map(|index| if index == COUNT - 1 { "events".to_owned() } else { format!("pose{index}") }).collect();
    let objects: Vec<(&str, u64)> = names.iter().map(|name| (name.as_str(), array)).collect();
    let root = content.len() as u64;
    content.extend(group(&objects, &[]));
    let head = superblock(root, content.len() as u64);
    content[..head.len()].copy_from_slice(&head);
    let outcome = testing::read(&content);
    assert_eq!((outcome.events.len(), outcome.error), (40, None));
    assert!(outcome.information.unwrap().notes.iter().any(|note| note.starts_with("the events of events are read")));
}

/// A few kilobytes that state 2^40 events, all equal to the fill value.
#[test]
fn endless_fill_values_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("endless.h5");
    let number = |size| Number::Integer { size, is_signed: false };
    let mut content = vec![0; super::structure::SUPERBLOCK as usize];
    let mut objects = Vec::new();
    for (name, size, value) in [("t", 8, 5_u64), ("x", 2, 3), ("y", 2, 4), ("p", 1, 1)] {
        objects.push((name, content.len() as u64));
        content.extend(filled(number(size), 1 << 40, value));
    }
    let events = content.len() as u64;
    content.extend(group(&objects, &[]));
    let root = content.len() as u64;
    content.extend(group(&[("events", events)], &[("width", 346), ("height", 260)]));
    let head = superblock(root, content.len() as u64);
    content[..head.len()].copy_from_slice(&head);
    std::fs::write(&path, &content).unwrap();
    let mut reader = Recording::new(&path, RecordingOptions::default()).unwrap().open().unwrap();
    let (mut batch, mut count) = (Vec::new(), 0);
    let error = loop {
        match reader.next_batch(&mut batch) {
            Ok(more) => {
                assert!(more && count < 20_000_000, "{count} events");
                count += batch.len();
            }
            Err(error) => break error.to_string(),
        }
    };
    assert!(error.contains(&format!("in {} bytes, which no recording has", content.len())), "{error}");
}

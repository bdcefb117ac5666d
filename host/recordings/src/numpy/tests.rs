//! Tests with arrays as NumPy writes them, built byte by byte.

use std::io::Write as _;

use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use rawzip::{CompressionMethod, ZipArchiveWriter};

use super::header::MAGIC;
use crate::image_folder::Stamps;
use crate::images::Images;
use crate::testing::{self, Outcome};
use crate::write::EventWriter;
use crate::{Damage, ReadReport, RecordingOptions, TimeUnit};

fn array(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let order = if fortran { "True" } else { "False" };
    let text = format!("{{'descr': {descr}, 'fortran_order': {order}, 'shape': {shape}, }}\n");
    [MAGIC, &[1, 0], &(text.len() as u16).to_le_bytes(), text.as_bytes(), data].concat()
}

fn events(count: i64) -> Vec<Event> {
    let on = |index: i64| if index % 3 == 0 { Polarity::On } else { Polarity::Off };
    (0..count)
        .map(|index| Event { t: 1_000_001 + index * 70, x: 300 + index as u16, y: index as u16, polarity: on(index) })
        .collect()
}

fn bit(event: &Event) -> u8 {
    event.polarity.index() as u8
}

/// The events as records that `record` makes.
fn records(descr: &str, events: &[Event], record: impl Fn(&Event) -> Vec<u8>) -> Vec<u8> {
    array(descr, false, &format!("({},)", events.len()), &events.iter().flat_map(record).collect::<Vec<_>>())
}

fn assert_events(outcome: Outcome, expected: &[Event]) {
    assert_eq!((outcome.events.as_slice(), outcome.error), (expected, None));
    assert_eq!(outcome.report.truncated, None);
}

#[test]
fn structured_arrays_of_every_program_are_read_by_their_names() {
    let events = events(40);
    let (t, x, y) = (
        |event: &Event| event.t.to_le_bytes(),
        |event: &Event| event.x.to_le_bytes(),
        |event: &Event| event.y.to_le_bytes(),
    );
    let dv = "[('timestamp', '<i8'), ('x', '<i2'), ('y', '<i2'), ('polarity', '|i1'), ('', '|V3')]";
    let metavision = "[('x', '<u2'), ('y', '<u2'), ('p', '<i2'), ('', '|V2'), ('t', '<i8')]";
    let tonic = "[('x', '<i2'), ('y', '<i2'), ('t', '<i8'), ('p', '|b1')]";
    let faery = "[('t', '<u8'), ('x', '<u2'), ('y', '<u2'), (('p', 'on'), '|b1')]";
    for content in [
        records(dv, &events, |event| [&t(event)[..], &x(event), &y(event), &[bit(event), 9, 9, 9]].concat()),
        records(metavision, &events, |event| [&x(event)[..], &y(event), &[bit(event), 0, 9, 9], &t(event)].concat()),
        records(tonic, &events, |event| [&x(event)[..], &y(event), &t(event), &[bit(event)]].concat()),
        records(faery, &events, |event| [&t(event)[..], &x(event), &y(event), &[bit(event)]].concat()),
    ] {
        assert_events(testing::read(&content), &events);
    }
    let nanoseconds = "[('t_ns', '>u8'), ('x', '>f4'), ('y', '|u1'), ('pol', '<u4')]";
    let content = records(nanoseconds, &events, |event| {
        let polarity = if event.polarity == Polarity::On { 1 } else { u32::MAX };
        let time = event.t as u64 * 1000 + 400;
        [&time.to_be_bytes()[..], &f32::from(event.x).to_be_bytes(), &[event.y as u8], &polarity.to_le_bytes()].concat()
    });
    let outcome = testing::read(&content);
    assert_eq!(outcome.information.as_ref().unwrap().notes, [""; 0]);
    assert_events(outcome, &events);
}

/// 255 in an unsigned column is -1 next to 1, but ON next to 0.
#[test]
fn polarities_are_read_from_any_two_numbers() {
    let events = events(60);
    for (kind, off, on, notes) in [
        ("|u1", 0_i16, 255, 1),
        ("|u1", 255, 1, 0),
        ("|u1", 1, 2, 1),
        ("<i2", 0, 255, 1),
        ("<i2", -1, 1, 0),
        ("|i1", -128, 127, 1),
    ] {
        let descr = format!("[('t_us', '<i8'), ('x', '<u2'), ('y', '<u2'), ('p', '{kind}')]");
        let size = if kind == "<i2" { 2 } else { 1 };
        let content = records(&descr, &events, |event| {
            let number = if event.polarity == Polarity::On { on } else { off };
            let pixel = [event.x.to_le_bytes(), event.y.to_le_bytes()].concat();
            [&event.t.to_le_bytes()[..], &pixel, &number.to_le_bytes()[..size]].concat()
        });
        let outcome = testing::read(&content);
        assert_eq!(outcome.information.as_ref().unwrap().notes.len(), notes, "{kind} {off} {on}");
        assert_events(outcome, &events);
    }
}

/// Returns columns of numbers, row by row or column by column.
fn columns(events: &[Event], by_rows: bool) -> Vec<u8> {
    let row = |event: &Event| [event.x.into(), event.y.into(), f64::from(bit(event)) * 2.0 - 1.0, event.t as f64 / 1e6];
    let rows: Vec<[f64; 4]> = events.iter().map(row).collect();
    if by_rows {
        return rows.iter().flatten().flat_map(|value| value.to_le_bytes()).collect();
    }
    (0..4).flat_map(|column| rows.iter().flat_map(move |row| row[column].to_le_bytes())).collect()
}

#[test]
fn tables_of_numbers_are_read_in_every_memory_order() {
    let events = events(50);
    for (shape, fortran, by_rows) in
        [("(50, 4)", false, true), ("(50, 4)", true, false), ("(4, 50)", false, false), ("(4, 50)", true, true)]
    {
        let content = array("'<f8'", fortran, shape, &columns(&events, by_rows));
        let outcome = testing::read(&content);
        let notes = &outcome.information.as_ref().unwrap().notes;
        assert!(notes.iter().any(|note| note.contains("x,y,p,t")), "{shape} {notes:?}");
        assert!(notes.iter().any(|note| note.contains("seconds")), "{shape} {notes:?}");
        assert_events(outcome, &events);
    }
}

#[test]
fn times_continue_after_a_counter_wrap() {
    let records = |events: &[Event], time: &str, bytes: &dyn Fn(i64) -> Vec<u8>| {
        let descr = format!("[('t', '{time}'), ('x', '<u2'), ('y', '<u2'), ('p', '|u1')]");
        let record = |event: &Event| {
            [&bytes(event.t)[..], &event.x.to_le_bytes(), &event.y.to_le_bytes(), &[bit(event)]].concat()
        };
        records(&descr, events, record)
    };
    let unsigned = |t: i64| (t as u32).to_le_bytes().to_vec();
    let signed = |t: i64| (t as i32).to_be_bytes().to_vec();
    let real = |t: i64| f64::from(t as u32).to_le_bytes().to_vec();
    let cases: [(_, _, &dyn Fn(i64) -> Vec<u8>); 3] =
        [(1 << 32, "<u4", &unsigned), (1 << 31, ">i4", &signed), (1 << 32, "<f8", &real)];
    for (wrap, time, bytes) in cases {
        let events = testing::events_around(wrap);
        let whole = records(&events, "<i8", &|t| t.to_le_bytes().to_vec());
        testing::check_wrap(&records(&events, time, bytes), &whole);
    }
}

#[test]
fn options_take_precedence() {
    let options = RecordingOptions {
        columns: Some("-,t,p,x,y".parse().unwrap()),
        time_unit: Some(TimeUnit::Milliseconds),
        ..RecordingOptions::default()
    };
    let data: Vec<u8> = [7, 1, 0, 3, 4, 7, 2, 1, 5, 6_i32].into_iter().flat_map(i32::to_le_bytes).collect();
    let content = array("'<i4'", false, "(2, 5)", &data);
    let expected =
        [Event { t: 1000, x: 3, y: 4, polarity: Polarity::Off }, Event { t: 2000, x: 5, y: 6, polarity: Polarity::On }];
    assert_events(testing::read_with(&content, options), &expected);
    let error = testing::read(&content).error.unwrap();
    assert!(error.contains("5 fields"), "{error}");
}

#[test]
fn arrays_that_are_not_events_are_reported() {
    for (content, part) in [
        (array("'<f8'", false, "(3,)", &[0; 24]), "shape [3]"),
        (array("'|O'", false, "(3, 4)", &[0; 24]), "holds elements that are not numbers"),
        (
            array("'<f2'", false, "(3, 4)", &[0; 24]),
            "holds floating-point numbers of 16 bits, which are not supported: write it",
        ),
        (array("[('t', '<i8'), ('x', '<i2'), ('z', '<i2')]", false, "(1,)", &[0; 12]), "t, x, z"),
        (
            array("[('t', '<U4'), ('x', '<i2'), ('y', '<i2'), ('p', '<i2')]", false, "(1,)", &[0; 22]),
            "its array t holds",
        ),
        (array("'<f8'", false, "(1, 4)", &[0xff; 32]), "not clear"),
        (MAGIC.to_vec(), "is incomplete"),
    ] {
        let error = testing::read(&content).error.unwrap();
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn an_array_shorter_than_stated_is_cut_off() {
    let events = events(5);
    let table = columns(&events, true);
    for shape in ["(6, 4)", "(1152921504606846, 4)"] {
        let content = array("'<f8'", false, shape, &table[..4 * 32 + 7]);
        let outcome = testing::read(&content);
        assert_eq!((outcome.events.as_slice(), outcome.error), (&events[..4], None));
        assert_eq!(outcome.report.truncated.unwrap().byte, content.len() as u64 - 7);
    }
}

/// A batch must not need more memory if its records are long.
#[test]
fn batches_of_long_records_are_short() {
    let events = events(150);
    let descr = "[('t', '<i8'), ('x', '<u2'), ('y', '<u2'), ('p', '|u1'), ('', '|V60000')]";
    let content = records(descr, &events, |event| {
        let numbers = [&event.t.to_le_bytes()[..], &event.x.to_le_bytes(), &event.y.to_le_bytes(), &[bit(event)]];
        [numbers.concat(), vec![0; 60_000]].concat()
    });
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("long.npy");
    std::fs::write(&path, &content).unwrap();
    let mut decoder = super::open_array(&path, &RecordingOptions::default()).unwrap().decoder;
    let (mut batch, mut report) = (Vec::new(), ReadReport::default());
    assert!(decoder.decode(&mut batch, &mut report).unwrap());
    assert_eq!(batch, events[..(1 << 22) / 60_013]);
    assert_events(testing::read(&content), &events);
}

#[test]
fn reserved_space_is_not_read_as_events() {
    let events = events(5);
    let mut table = columns(&events, true);
    table.extend([0; 3 * 32]);
    let outcome = testing::read(&array("'<f8'", false, "(8, 4)", &table));
    assert_eq!((outcome.events.as_slice(), outcome.error, outcome.report.unwritten), (events.as_slice(), None, 3));
    table.truncate(5 * 32);
    table.extend([-1.0_f64; 2 * 4].map(f64::to_le_bytes).as_flattened());
    let outcome = testing::read(&array("'<f8'", false, "(7, 4)", &table));
    assert_eq!((outcome.events, outcome.error, outcome.report.unwritten), (events, None, 2));
}

/// Returns an archive of these arrays.
fn archive(compress: bool, members: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = ZipArchiveWriter::new(Vec::new());
    for (name, content) in members {
        let method = if compress { CompressionMethod::DEFLATE } else { CompressionMethod::STORE };
        let (mut entry, config) = archive.new_file(*name).compression_method(method).start().unwrap();
        let descriptor = if compress {
            let encoder = flate2::write::DeflateEncoder::new(&mut entry, flate2::Compression::default());
            let mut writer = config.wrap(encoder);
            writer.write_all(content).unwrap();
            let (encoder, descriptor) = writer.finish().unwrap();
            encoder.finish().unwrap();
            descriptor
        } else {
            let mut writer = config.wrap(&mut entry);
            writer.write_all(content).unwrap();
            writer.finish().unwrap().1
        };
        entry.finish(descriptor).unwrap();
    }
    archive.finish().unwrap()
}

/// Returns the arrays t, x, y and p, among others.
fn four(events: &[Event]) -> Vec<(&'static str, Vec<u8>)> {
    let shape = format!("({},)", events.len());
    let of = |descr: &str, bytes: Vec<u8>| array(descr, false, &shape, &bytes);
    vec![
        ("t_offset.npy", array("'<i8'", false, "(1,)", &[0; 8])),
        ("x.npy", of("'<u2'", events.iter().flat_map(|event| event.x.to_le_bytes()).collect())),
        ("readme.txt", b"arrays".to_vec()),
        ("y.npy", of("'<u2'", events.iter().flat_map(|event| event.y.to_le_bytes()).collect())),
        ("p.npy", of("'|b1'", events.iter().map(bit).collect())),
        ("t.npy", of("'<i8'", events.iter().flat_map(|event| event.t.to_le_bytes()).collect())),
    ]
}

#[test]
fn archives_are_read_by_the_names_of_their_arrays() {
    let (events, table) = (events(40), columns(&events(30), true));
    for compress in [false, true] {
        assert_events(testing::read(&archive(compress, &four(&events))), &events);
        let two = [
            ("left.npy", array("'<f8'", false, "(30, 4)", &table)),
            ("right.npy", array("'<f8'", false, "(10, 4)", &table[..320])),
        ];
        let two = archive(compress, &two);
        assert_events(testing::read(&two), &events[..30]);
        let right = |name: &str| RecordingOptions { stream: Some(name.to_owned()), ..RecordingOptions::default() };
        assert_events(testing::read_with(&two, right("right")), &events[..10]);
        let error = testing::read_with(&two, right("up")).error.unwrap();
        assert!(error.contains("left, right"), "{error}");
    }
}

/// evlib's columns and pandas give durations or dates.
#[test]
fn durations_and_dates_have_a_unit() {
    let events = events(40);
    let all = |t: &dyn Fn(&Event) -> i64, descr: &str| {
        let mut arrays = four(&events);
        let times = events.iter().flat_map(|event| t(event).to_le_bytes()).collect::<Vec<_>>();
        arrays.last_mut().unwrap().1 = array(descr, false, "(40,)", &times);
        archive(true, &arrays)
    };
    for (descr, scale) in [("'<m8[us]'", 1), ("'<m8[ns]'", 1000), ("'<M8[ns]'", 1000)] {
        let outcome = testing::read(&all(&|event| event.t * scale, descr));
        assert!(!outcome.information.as_ref().unwrap().notes.iter().any(|note| note.contains("taken for")));
        assert_events(outcome, &events);
    }
    let descr = "[('t', '<m8[ns]'), ('x', '<i2'), ('y', '<i2'), ('polarity', '|i1')]";
    let record = |event: &Event| {
        [&(event.t * 1000).to_le_bytes()[..], &event.x.to_le_bytes(), &event.y.to_le_bytes(), &[bit(event)]].concat()
    };
    assert_events(testing::read(&records(descr, &events, record)), &events);
    // A unit of no fixed length.
    assert!(testing::read(&all(&|event| event.t, "'<m8[M]'")).error.is_some());
}

/// EVIMO's archives: x and y in one array, times in seconds, and also a Python dictionary and matrices of four columns.
#[test]
fn archives_of_evimo_are_read() {
    let events = events(40);
    let (count, two) = (format!("({}, 1)", events.len()), format!("({}, 2)", events.len()));
    let xy = |by_rows: bool| -> Vec<u8> {
        let (x, y) = (|event: &Event| event.x.to_le_bytes(), |event: &Event| event.y.to_le_bytes());
        if by_rows {
            events.iter().flat_map(|event| [x(event), y(event)].concat()).collect()
        } else {
            events.iter().map(x).chain(events.iter().map(y)).flatten().collect()
        }
    };
    let others =
        || [("K.npy", array("'<f8'", false, "(3, 3)", &[0; 72])), ("meta.npy", array("'|O'", false, "()", &[0; 9]))];
    for (prefix, fortran) in [("dataset_events_", false), ("events_", true)] {
        let named = |name: &str| format!("{prefix}{name}.npy");
        let (t, p, both) = (named("t"), named("p"), named("xy"));
        let times = events.iter().flat_map(|event| (event.t as f64 / 1e6).to_le_bytes()).collect::<Vec<_>>();
        let members = [
            (both.as_str(), array("'<u2'", fortran, &two, &xy(!fortran))),
            (p.as_str(), array("'|u1'", false, &count, &events.iter().map(bit).collect::<Vec<_>>())),
            (t.as_str(), array("'<f8'", false, &count, &times)),
        ];
        let content = archive(true, &[&others()[..], &members].concat());
        let outcome = testing::read(&content);
        assert!(outcome.information.as_ref().unwrap().notes.iter().any(|note| note.contains("seconds")));
        assert_events(outcome, &events);
    }
    // An array of four columns.
    let attitude = array("'<f8'", false, "(9, 4)", &[0.5_f64.to_le_bytes(); 36].concat());
    let one =
        [("attitude.npy", attitude.clone()), ("events.npy", array("'<f8'", false, "(40, 4)", &columns(&events, true)))];
    assert_events(testing::read(&archive(false, &[&others()[..], &one].concat())), &events);
    // The same with a name that does not help.
    let one = [("attitude.npy", attitude), ("stream.npy", array("'<f8'", false, "(40, 4)", &columns(&events, true)))];
    assert_events(testing::read(&archive(false, &[&others()[..], &one].concat())), &events);
    let mut half = four(&events);
    half[4].1 = array("'<f2'", false, "(40,)", &[0; 80]);
    let error = testing::read(&archive(false, &half)).error.unwrap();
    assert!(error.contains("array p holds floating-point numbers of 16 bits"), "{error}");
}

/// EVIMO's second version has a file for each array.
#[test]
fn arrays_in_separate_files_are_read_together() {
    let events = events(40);
    let column = |number: fn(&Event) -> u16| -> Vec<u8> {
        array("'<u2'", false, "(40,)", &events.iter().flat_map(|event| number(event).to_le_bytes()).collect::<Vec<_>>())
    };
    let xy: Vec<u8> = events.iter().flat_map(|event| [event.x.to_le_bytes(), event.y.to_le_bytes()].concat()).collect();
    let times: Vec<u8> = events.iter().flat_map(|event| (event.t as f64 / 1e6).to_le_bytes()).collect();
    let (t, xy) = (array("'<f8'", false, "(40,)", &times), array("'<u2'", false, "(40, 2)", &xy));
    let p = array("'|u1'", false, "(40,)", &events.iter().map(bit).collect::<Vec<_>>());
    let (x, y) = (column(|event| event.x), column(|event| event.y));
    let evimo = vec![("t", t.clone()), ("xy", xy), ("p", p.clone())];
    for (front, files) in
        [("dataset_events_", evimo.clone()), ("events_", vec![("t", t), ("x", x), ("y", y), ("p", p)]), ("", evimo)]
    {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(format!("{front}{name}.npy"));
        files.iter().for_each(|(name, content)| std::fs::write(path(name), content).unwrap());
        // A file of another recording, and one that is not part of a recording.
        std::fs::write(folder.path().join("other_t.npy"), b"t").unwrap();
        std::fs::write(folder.path().join("dataset_info.npz"), b"PK").unwrap();
        for (name, _) in &files {
            assert_events(testing::read_file(&path(name), RecordingOptions::default()), &events);
        }
        assert_events(testing::read_file(folder.path(), RecordingOptions::default()), &events);
        // The folder is not taken for a folder of images.
        assert!(Images::open(folder.path(), None, Damage::Refuse, Stamps::default()).unwrap().is_none());
        std::fs::write(path("p"), &files[0].1[..40]).unwrap();
        let error = testing::read_file(&path("t"), RecordingOptions::default()).error.unwrap();
        assert!(error.contains(&format!("{front}p.npy: byte 0")), "{error}");
        std::fs::remove_file(path("p")).unwrap();
        let error = testing::read_file(&path("t"), RecordingOptions::default()).error.unwrap();
        assert!(error.contains("an array of shape [40]"), "{error}");
    }
}

/// Nobody writes to the FIFO, so a reader that opened it would wait for ever.
#[cfg(unix)]
#[test]
fn a_fifo_in_place_of_an_array_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(format!("dataset_events_{name}.npy"));
    let times: Vec<u8> = (0..40).flat_map(|t: i64| t.to_le_bytes()).collect();
    std::fs::write(path("t"), array("'<i8'", false, "(40,)", &times)).unwrap();
    std::fs::write(path("p"), array("'|u1'", false, "(40,)", &[1; 40])).unwrap();
    assert!(std::process::Command::new("mkfifo").arg(path("xy")).status().unwrap().success());
    for recording in [folder.path().to_owned(), path("t")] {
        let error = testing::read_file(&recording, RecordingOptions::default()).error.unwrap();
        assert!(error.contains("dataset_events_xy.npy"), "{error}");
    }
}

#[test]
fn an_array_without_rows_is_reported() {
    for (shape, data) in [("(0, 4)", &[][..]), ("(5, 4)", &[0; 160])] {
        let error = testing::read(&array("'<f8'", false, shape, data)).error.unwrap();
        assert!(error.contains("its array has no rows"), "{error}");
    }
}

#[test]
fn archives_without_events_list_their_content() {
    let mut unequal = four(&events(3));
    unequal[1].1 = array("'<u2'", false, "(2,)", &[0; 4]);
    for (members, part) in [
        (vec![("picture.png", vec![1])], "is a ZIP file, which is not supported"),
        (vec![("xl/workbook.xml", vec![1])], "is a spreadsheet file, which is not supported"),
        (vec![("a.npy", array("'<f8'", false, "(3,)", &[0; 24]))], "holds no events, only a; give the path"),
        (unequal, "x has 2 elements"),
    ] {
        let error = testing::read(&archive(true, &members)).error.unwrap();
        assert!(error.contains(part), "{error}");
    }
}

#[test]
fn a_changed_number_in_an_archive_is_found_by_its_checksum() {
    let mut content = archive(false, &four(&events(40)));
    let needle = 1_000_001_i64.to_le_bytes();
    let position = content.windows(8).position(|window| window == needle).unwrap();
    content[position] ^= 1;
    let error = testing::read(&content).error.unwrap();
    assert!(error.contains("checksum"), "{error}");
}

#[test]
fn written_files_are_read_with_their_sensor() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("events.npz");
    for count in [0, 1, 40_000] {
        let events: Vec<Event> = events(100)
            .into_iter()
            .cycle()
            .take(count)
            .enumerate()
            .map(|(index, event)| Event { t: -5 + index as i64, ..event })
            .collect();
        let mut writer = EventWriter::create(&path, super::OUTPUT, Sensor::new(400, 260), "").unwrap();
        events.chunks(999).for_each(|part| writer.write(part).unwrap());
        writer.finish().unwrap();
        let outcome = testing::read(&std::fs::read(&path).unwrap());
        assert_eq!(outcome.information.as_ref().unwrap().sensor, Some(Sensor::new(400, 260)));
        assert_events(outcome, &events);
    }
}

#[test]
fn damage_loses_as_little_as_possible() {
    let events = events(12);
    testing::check_damage(&array("'<f8'", false, "(12, 4)", &columns(&events, true)));
    testing::check_damage(&array("'<f8'", true, "(12, 4)", &columns(&events, false)));
    for compress in [false, true] {
        testing::check_damage(&archive(compress, &four(&events)));
    }
}

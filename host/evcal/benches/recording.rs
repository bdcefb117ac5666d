//! Time to read a recording of a million events, by format.

use divan::Bencher;
use divan::counter::ItemsCount;
use evcal_core::event::{Event, Polarity};
use evcal_core::sensor::Sensor;
use event_recordings::encode::OutputFormat;
use event_recordings::write::EventWriter;
use event_recordings::{Recording, RecordingOptions, aedat4, event_calib, text};

fn main() {
    divan::main();
}

const EVENTS: u32 = 1_000_000;
const FORMATS: [OutputFormat; 5] =
    [aedat4::OUTPUT_UNCOMPRESSED, aedat4::OUTPUT_ZSTANDARD, aedat4::OUTPUT, text::OUTPUT, event_calib::OUTPUT];

/// Events at random pixels, about one per microsecond.
fn events() -> Vec<Event> {
    (0..EVENTS)
        .map(|index| {
            let scattered = index.wrapping_mul(2_654_435_761);
            Event {
                t: 1_643_243_628_737_093 + i64::from(index),
                x: (scattered >> 8) as u16 % 346,
                y: (scattered >> 16) as u16 % 260,
                polarity: if scattered >> 31 == 0 { Polarity::Off } else { Polarity::On },
            }
        })
        .collect()
}

#[divan::bench(args = 0..FORMATS.len())]
fn read(bencher: Bencher, format: usize) {
    let format = FORMATS[format];
    let directory = tempfile::tempdir().expect("a temporary directory");
    let path = directory.path().join("recording");
    let mut writer = EventWriter::create(&path, format, Sensor::new(346, 260), "camera").expect("a file");
    writer.write(&events()).expect("space");
    writer.finish().expect("space");
    let recording = Recording::new(path, RecordingOptions::default()).expect("a recording");
    bencher.counter(ItemsCount::new(EVENTS)).bench(|| {
        let mut reader = recording.open().expect("a recording");
        let mut batch = Vec::new();
        let mut sum = 0;
        while reader.next_batch(&mut batch).expect("events") {
            sum += batch.iter().map(|event| u64::from(event.x)).sum::<u64>();
        }
        sum
    });
}

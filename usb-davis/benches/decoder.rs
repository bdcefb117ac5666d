//! Throughput of the decoder and encoder: `cargo bench -p usb-davis --bench decoder`.
use std::hint::black_box;

use divan::Bencher;
use divan::counter::{BytesCount, ItemsCount};
use usb_davis::protocol::{Decoder, Encoder, Frame, Layout, Message, Polarity, PolarityEvent, Region, Shutter};

fn main() {
    divan::main();
}

/// About a millisecond of work per sample, so that the fastest sample was not interrupted.
const EVENTS: usize = 100_000;

/// Returns events at random pixels; on average `per_microsecond` of them share a timestamp.
fn events(per_microsecond: f64) -> Vec<PolarityEvent> {
    let mut state = 0x9E37_79B9_7F4A_7C15u64;
    let mut random = move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        state
    };
    let mut time = 0.0;
    (0..EVENTS)
        .map(|_| {
            time += (random() % 1000) as f64 / 500.0 / per_microsecond;
            let polarity = if random() & 1 == 0 { Polarity::Off } else { Polarity::On };
            PolarityEvent { time: time as u64, x: (random() % 346) as u16, y: (random() % 260) as u16, polarity }
        })
        .collect()
}

fn stream(per_microsecond: f64) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(Layout::DAVIS346);
    for event in events(per_microsecond) {
        encoder.event(&event, &mut bytes).expect("events are in order");
    }
    bytes
}

/// Decodes events into a vector; the argument is the event rate in millions per second.
#[divan::bench(args = [0.1, 1.0, 12.0], sample_count = 300)]
fn decode_events(bencher: Bencher, per_microsecond: f64) {
    let bytes = stream(per_microsecond);
    let mut events: Vec<PolarityEvent> = Vec::with_capacity(EVENTS);
    bencher.counter(BytesCount::of_slice(&bytes)).counter(ItemsCount::new(EVENTS)).bench_local(|| {
        events.clear();
        let mut decoder = Decoder::new(Layout::DAVIS346);
        for transfer in black_box(&bytes).chunks(8192) {
            decoder.decode(transfer, |message| {
                if let Message::Events(new) = message {
                    events.extend_from_slice(new);
                }
            });
        }
        events.len()
    });
}

/// Decodes a full frame with global shutter.
#[divan::bench(sample_count = 300)]
fn decode_frames(bencher: Bencher) {
    let pixels: Vec<u16> = (0..346 * 260).map(|index| (index % 1024) as u16).collect();
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(Layout::DAVIS346);
    let frame = Frame {
        shutter: Shutter::Global,
        start: 0,
        end: 20_000,
        exposure_start: Some(8_000),
        exposure_end: Some(12_000),
        exposure_cycles: 120_960,
        region: Region { x: 0, y: 0, width: 346, height: 260 },
        damaged_columns: 0,
        pixels: &pixels,
    };
    encoder.frame(&frame, &mut bytes).expect("in order");
    let mut memory = vec![0; 346 * 260];
    bencher.counter(BytesCount::of_slice(&bytes)).bench_local(|| {
        let mut frames = 0;
        let mut decoder = Decoder::with_frames(Layout::DAVIS346, &mut memory[..]);
        for transfer in black_box(&bytes).chunks(8192) {
            decoder.decode(transfer, |message| frames += usize::from(matches!(message, Message::Frame(_))));
        }
        frames
    });
}

/// Encodes the same events.
#[divan::bench(sample_count = 300)]
fn encode_events(bencher: Bencher) {
    let events = events(1.0);
    let mut bytes = Vec::with_capacity(8 * EVENTS);
    bencher.counter(ItemsCount::new(EVENTS)).bench_local(|| {
        bytes.clear();
        let mut encoder = Encoder::new(Layout::DAVIS346);
        for event in black_box(&events) {
            encoder.event(event, &mut bytes).expect("events are in order");
        }
        bytes.len()
    });
}

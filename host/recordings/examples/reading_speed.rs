//! How fast recordings are read on one core: `cargo run --release -p event-recordings --example reading_speed FILE...`.
//!
//! Each file is read three times; the fastest counts. The time is that of the processor where the system tells it (Linux), so other
//! programs on the computer matter little.

use std::error::Error;
use std::time::Instant;

use evcal_core::sensor::Sensor;
use event_recordings::{Recording, RecordingOptions};

/// Seconds that this thread was on a processor, else seconds that passed.
fn seconds(start: &Instant) -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| start.elapsed().as_secs_f64(), |nanoseconds| nanoseconds * 1e-9)
}

fn main() -> Result<(), Box<dyn Error>> {
    let start = Instant::now();
    println!("{:<24} {:>10} {:>12} {:>8}", "format", "events", "bytes/event", "Mev/s");
    for path in std::env::args().skip(1) {
        let options = RecordingOptions { sensor: Some(Sensor::new(1280, 800)), ..RecordingOptions::default() };
        let recording = Recording::new(&path, options)?;
        let (mut fastest, mut events) = (f64::INFINITY, 0);
        for _ in 0..3 {
            let before = seconds(&start);
            let mut reader = recording.open()?;
            let mut batch = Vec::new();
            while reader.next_batch(&mut batch)? {}
            fastest = fastest.min(seconds(&start) - before);
            events = reader.report().events;
        }
        let bytes = std::fs::metadata(&path)?.len() as f64 / events.max(1) as f64;
        let speed = events as f64 / fastest * 1e-6;
        println!("{:<24} {events:>10} {bytes:>12.1} {speed:>8.1}   {path}", recording.format().name);
    }
    Ok(())
}

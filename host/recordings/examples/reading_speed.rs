//! Measures the reading speed on one core: `cargo run --release -p event-recordings --example reading_speed FILE...`.
//!
//! Each file is read three times, and the fastest pass counts. On Linux the program measures CPU time, so that other
//! programs have little influence.

use std::error::Error;
use std::time::Instant;

use evcal_core::sensor::Sensor;
use event_recordings::{Recording, RecordingOptions};

/// Returns the CPU time of this thread in seconds, or the elapsed time if the system does not report it.
fn seconds(start: &Instant) -> f64 {
    let schedule = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = schedule.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
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

//! Opens a recording of any format and prints its number of events, its duration, and its event rate.
//!
//! ```sh
//! cargo run --release -p event-recordings --example read_events -- recording.aedat4
//! ```

use std::error::Error;

use event_recordings::{Recording, RecordingOptions};

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args_os().nth(1).ok_or("give the path of a recording")?;
    let recording = Recording::new(path, RecordingOptions::default())?;
    let mut reader = recording.open()?;
    let (mut events, mut count, mut span) = (Vec::new(), 0, None);
    while reader.next_batch(&mut events)? {
        count += events.len();
        if let (Some(first), Some(last)) = (events.first(), events.last()) {
            span = Some((span.map_or(first.t, |(start, _)| start), last.t));
        }
    }
    let seconds = span.map_or(0.0, |(start, end)| (end - start) as f64 * 1e-6);
    println!("{}: {count} events in {seconds:.6} s", recording.format().name);
    if seconds > 0.0 {
        println!("{:.0} events per second", count as f64 / seconds);
    }
    Ok(())
}

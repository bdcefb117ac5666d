//! Records the first usable DAVIS346 for ten seconds into a `.dvraw` file, and counts its events at the same time.
//!
//! ```text
//! cargo run --release -p usb-davis --example record -- recording.dvraw
//! ```

use std::error::Error;
use std::fs::File;
use std::time::{Duration, Instant};

use usb_davis::configuration::{Configuration, Streams};
use usb_davis::device::{Camera, Queue, Selector, StreamError};
use usb_davis::dump::{Compression, DumpWriter};
use usb_davis::protocol::Decoder;

const DURATION: Duration = Duration::from_secs(10);

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).ok_or("name the file to write: record OUT.dvraw")?;
    let mut camera = Camera::open(&Selector::default())?;
    camera.configure(&Configuration::calibration())?;
    let mut stream = camera.start(Streams::EVENTS, Queue::default())?;
    let mut dump = DumpWriter::new(File::create_new(path)?, stream.header(), Compression::None)?;
    let mut decoder = Decoder::new(stream.header().registers.layout());
    let end = Instant::now() + DURATION;
    loop {
        match stream.next(Duration::from_millis(100)) {
            Ok(Some(transfer)) => {
                dump.transfer(&transfer)?;
                if transfer.gap_before {
                    decoder.gap(|_| {});
                }
                decoder.decode(transfer.payload, |_| {});
            }
            Ok(None) => {}
            Err(StreamError::Stopped) => break,
            Err(error) => {
                // All earlier transfers are in the file.
                eprintln!("{error}");
                break;
            }
        }
        if Instant::now() >= end {
            // Transfers under way still arrive, followed by `Stopped`.
            stream.stop()?;
        }
    }
    dump.registers(stream.drop_counters())?;
    dump.finish()?;
    let (counts, dropped) = (decoder.counts(), stream.dropped());
    println!("{} events, {} dropped by the camera", counts.events, dropped.events);
    Ok(())
}

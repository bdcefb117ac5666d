//! The detector: reads a file of events and writes the circle stream, both by semihosting.
//!
//! Arguments: EVENTS STREAM FORMAT, where FORMAT is `evt2` or `packed`. Prints the results as `name=value`.
#![no_std]
#![no_main]

use core::ffi::CStr;

use evcal_core::sensor::Sensor;
use evcal_core::window::Progress;
use evcal_detector::{Pipeline, Settings, Source, Storage, row_bytes, row_count};
use qemu::{InstructionCounter, stack_bytes};
use semihosting::fs::File;
use semihosting::io::{Read, Write};
use semihosting::{experimental::env, println, process};
use static_cell::ConstStaticCell;

/// Storage for a DAVIS346 and windows of 4000 events.
static STORAGE: ConstStaticCell<Storage<{ row_bytes(346) }, { row_count(260) }, 2048, 128, 4000, 1452, 512>> =
    ConstStaticCell::new(Storage::new());
static INPUT: ConstStaticCell<[u8; 1024]> = ConstStaticCell::new([0; 1024]);

#[cfg_attr(target_arch = "arm", cortex_m_rt::entry)]
#[cfg_attr(target_arch = "riscv32", riscv_rt::entry)]
fn main() -> ! {
    match run() {
        Ok(()) => process::exit(0),
        Err(reason) => {
            println!("detector: {reason}");
            process::exit(1)
        }
    }
}

fn run() -> Result<(), &'static str> {
    let arguments = env::args::<512>().map_err(|_| "no arguments")?;
    let mut arguments = (&arguments).skip(1).map_while(Result::ok);
    let mut path = || {
        let argument = arguments.next()?;
        let mut path = [0; 256];
        path.get_mut(..argument.len())?.copy_from_slice(argument.as_bytes());
        (argument.len() < path.len()).then_some(path)
    };
    let usage = "usage: EVENTS STREAM evt2|packed";
    let (input, output, format) = (path().ok_or(usage)?, path().ok_or(usage)?, path().ok_or(usage)?);
    let text = |bytes| CStr::from_bytes_until_nul(bytes).map_err(|_| usage);
    let mut source = match text(&format)?.to_bytes() {
        b"evt2" => Source::evt2(),
        b"packed" => Source::packed(),
        _ => return Err(usage),
    };
    let mut input = File::open(text(&input)?).map_err(|_| "cannot open the events")?;
    let mut output = File::create(text(&output)?).map_err(|_| "cannot create the stream")?;

    let settings = Settings::new("evcal in QEMU", Sensor { width: 346, height: 260 }, 36);
    let mut pipeline = Pipeline::new(settings, STORAGE.take()).map_err(|_| "the sensor is too large")?;
    let counter = InstructionCounter::start().ok_or("no counter")?;
    let mut send = |frame: &[u8]| output.write_all(frame).is_ok();
    let (mut all, mut detecting, mut reporting, mut events_detected) = (0, 0, 0, 0);
    let mut last_us = 0;
    pipeline.announce(last_us, &mut send);
    let buffer = INPUT.take();
    loop {
        let length = input.read(buffer).map_err(|_| "cannot read the events")?;
        if length == 0 {
            break;
        }
        let bytes = buffer.get(..length).unwrap_or_default();
        // Whole words, as from a DMA channel; incomplete words at the end of a file are ignored.
        let (words, _) = bytes.as_chunks::<4>();
        counter.measure(&mut all, || {
            for &word in words {
                let Some(event) = source.push_word(u32::from_le_bytes(word)) else { continue };
                last_us = event.t;
                let mut progress = pipeline.push(event);
                while progress == Progress::Complete {
                    counter.measure(&mut detecting, || pipeline.detect());
                    events_detected += pipeline.window_events();
                    progress = counter.measure(&mut reporting, || pipeline.report(&mut send));
                }
            }
        });
    }
    pipeline.count_undecodable(source.undecodable());
    pipeline.send_statistics(last_us, &mut send);

    let statistics = pipeline.statistics();
    println!("events={}", statistics.events);
    println!("windows={}", statistics.windows);
    println!("windows_sent={}", statistics.windows_sent);
    println!("events_detected={events_detected}");
    println!("instructions_detecting={detecting}");
    println!("instructions_reporting={reporting}");
    println!("instructions_else={}", all.saturating_sub(detecting + reporting));
    println!("stack_bytes={}", stack_bytes());
    Ok(())
}

//! Counts the instructions that DBSCAN and the circles take for windows of 4000 events.
//!
//! Argument: EVENTS, a file of EVT 2.0 words. Each window consists of 4000 events. Prints `name=value`.
#![no_std]
#![no_main]

use core::ffi::CStr;

use evcal_core::cluster::{row_bytes, row_count};

use evcal_core::detector::{Detector, DetectorSettings};
use evcal_core::sensor::Sensor;
use evcal_core::window::{EventStorage, Progress, WindowBuffer, WindowSettings};
use evcal_detector::Source;
use qemu::InstructionCounter;
use semihosting::fs::File;
use semihosting::io::Read;
use semihosting::{experimental::env, println, process};
use static_cell::ConstStaticCell;

const EVENTS: usize = 4000;
const SENSOR: Sensor = Sensor { width: 346, height: 260 };

static DETECTOR: ConstStaticCell<Detector<f32, { row_bytes(346) }, { row_count(260) }, 2048, 128>> =
    ConstStaticCell::new(Detector::new());
static STORAGE: ConstStaticCell<EventStorage<EVENTS>> = ConstStaticCell::new(EventStorage::new());

#[cfg_attr(target_arch = "arm", cortex_m_rt::entry)]
#[cfg_attr(target_arch = "riscv32", riscv_rt::entry)]
fn main() -> ! {
    match run() {
        Ok(()) => process::exit(0),
        Err(reason) => {
            println!("window: {reason}");
            process::exit(1)
        }
    }
}

fn run() -> Result<(), &'static str> {
    let arguments = env::args::<512>().map_err(|_| "no arguments")?;
    let argument = (&arguments).nth(1).and_then(Result::ok).ok_or("usage: EVENTS")?;
    let mut path = [0; 256];
    path.get_mut(..argument.len()).ok_or("the path is too long")?.copy_from_slice(argument.as_bytes());
    let path = CStr::from_bytes_until_nul(&path).map_err(|_| "the path is too long")?;
    let mut input = File::open(path).map_err(|_| "cannot open the events")?;

    // A window ends when the storage is full.
    let one_window =
        WindowSettings { step: 1_000_000, gap: 0, fewest_events: EVENTS as u32, ..WindowSettings::default() };
    let mut windows = WindowBuffer::new(one_window, 0, STORAGE.take());
    let detector = DETECTOR.take();
    let settings = DetectorSettings::default();
    let counter = InstructionCounter::start().ok_or("no counter")?;
    let mut source = Source::evt2();
    let (mut count, mut circles, mut instructions) = (0_u32, 0, 0);
    let mut buffer = [0; 256];
    loop {
        let length = input.read(&mut buffer).map_err(|_| "cannot read the events")?;
        if length == 0 {
            break;
        }
        for &byte in buffer.get(..length).unwrap_or_default() {
            let Some(event) = source.push(byte) else { continue };
            if windows.push(event) == Progress::Collecting {
                continue;
            }
            let detection = counter.measure(&mut instructions, || detector.detect(SENSOR, windows.events(), &settings));
            circles += detection.map_err(|_| "the sensor is too large")?.circles.circles;
            count += 1;
            // Continue with the next event.
            windows.restart(event.t);
            windows.push(event);
        }
    }
    println!("windows={count}");
    println!("circles_per_window={}", circles / count.max(1));
    println!("instructions_per_event={}", instructions / (u64::from(count.max(1)) * EVENTS as u64));
    Ok(())
}

//! Does the same as `qemu/src/bin/detector.rs`, on the host: both must write the same bytes.

use std::error::Error;
use std::io::Write;
use std::process::ExitCode;
use std::{env, fs, io};

use evcal_core::sensor::Sensor;
use evcal_core::window::Progress;
use evcal_detector::{Pipeline, Settings, Source, Storage, row_bytes, row_count};

fn main() -> ExitCode {
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("detector-on-host: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [input, output, format] = arguments.as_slice() else {
        return Err("usage: EVENTS STREAM evt2|packed".into());
    };
    let mut source = match format.as_str() {
        "evt2" => Source::evt2(),
        "packed" => Source::packed(),
        _ => return Err("the format must be evt2 or packed".into()),
    };
    let bytes = fs::read(input)?;
    let mut output = io::BufWriter::new(fs::File::create(output)?);
    let mut storage = Box::new(Storage::<{ row_bytes(346) }, { row_count(260) }, 2048, 128, 4000, 1452, 512>::new());
    let settings = Settings::new("evcal in QEMU", Sensor { width: 346, height: 260 }, 36);
    let mut pipeline = Pipeline::new(settings, &mut storage)?;
    let mut send = |frame: &[u8]| output.write_all(frame).is_ok();
    let mut last_us = 0;
    pipeline.announce(last_us, &mut send);
    for byte in bytes {
        let Some(event) = source.push(byte) else { continue };
        last_us = event.t;
        let mut progress = pipeline.push(event);
        while progress == Progress::Complete {
            pipeline.detect();
            progress = pipeline.report(&mut send);
        }
    }
    pipeline.count_undecodable(source.undecodable());
    pipeline.send_statistics(last_us, &mut send);
    println!("{:#?}", pipeline.statistics());
    output.flush()?;
    Ok(())
}

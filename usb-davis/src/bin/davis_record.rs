//! Records a DAVIS346 into a `.dvraw` file; a minimal program that uses the camera.
//!
//! `davis-record` lists cameras; `davis-record OUT.dvraw [SECONDS] [frames] [bytes=LIMIT]` records for that time or
//! until that many bytes were received. It prints one line of JSON with the result. Exit status: 0 if the recording is
//! complete, 1 otherwise.

use std::error::Error;
use std::fs::File;
use std::process::ExitCode;
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use usb_davis::configuration::{Configuration, Streams};
use usb_davis::device::{Availability, Camera, Queue, Selector, StreamError, list};
use usb_davis::dump::{Compression, DumpWriter};

fn cameras() -> Result<Value, Box<dyn Error>> {
    let cameras = list()?.into_iter().map(|camera| {
        let state = match camera.availability {
            Availability::Ready { logic, patch } => format!("ready, logic {logic}.{patch}"),
            Availability::Unavailable(error) => error.to_string(),
        };
        let (serial, firmware) = (&camera.identity.serial, camera.identity.firmware());
        json!({
            "bus": camera.bus, "address": camera.address, "serial": serial, "firmware": firmware, "state": state
        })
    });
    Ok(cameras.collect())
}

fn record(path: &str, duration: Duration, limit: u64, streams: Streams) -> Result<(Value, bool), Box<dyn Error>> {
    let mut camera = Camera::open(&Selector::default())?;
    camera.configure(&Configuration::calibration())?;
    // The file is created only once the camera runs.
    let mut stream = camera.start(streams, Queue::default())?;
    let mut dump = DumpWriter::new(File::create(path)?, stream.header(), Compression::None)?;
    let end = Instant::now() + duration;
    let error = loop {
        match stream.next(Duration::from_millis(50)) {
            Ok(Some(transfer)) => dump.transfer(&transfer)?,
            Ok(None) => {}
            Err(error) => break error,
        }
        if Instant::now() >= end || stream.statistics().bytes >= limit {
            stream.stop()?;
        }
    };
    stream.stop()?;
    let statistics = stream.statistics();
    dump.registers(stream.drop_counters())?;
    dump.finish()?;
    let report = json!({
        "bytes": statistics.bytes, "transfers": statistics.transfers, "starved": statistics.starved,
        "failed": statistics.failed, "dropped": stream.dropped().events, "end": error.to_string()
    });
    Ok((report, error == StreamError::Stopped))
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match arguments[..] {
        [] => cameras().map(|cameras| (cameras, true)),
        [path, ref rest @ ..] => {
            let seconds: f64 = rest.iter().find_map(|seconds| seconds.parse().ok()).unwrap_or(10.0);
            let duration = Duration::from_secs_f64(seconds.clamp(0.0, 1e6));
            let limit = rest.iter().find_map(|limit| limit.strip_prefix("bytes=")?.parse().ok()).unwrap_or(u64::MAX);
            let streams = if rest.contains(&"frames") { Streams::ALL } else { Streams::EVENTS };
            record(path, duration, limit, streams)
        }
    };
    match result {
        Ok((report, whole)) => {
            println!("{report}");
            if whole { ExitCode::SUCCESS } else { ExitCode::FAILURE }
        }
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}

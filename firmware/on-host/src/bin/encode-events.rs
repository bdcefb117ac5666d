//! Converts a CSV recording of `evcal simulate --format csv` (its title begins with `t,x,y,p`) to the words of a sensor.
//!
//! Times count from the recording's first event.

use std::error::Error;
use std::io::{BufRead, Write};
use std::process::ExitCode;
use std::{env, fs, io};

use evcal_core::decode::{Evt2Encoder, PackedEncoder};
use evcal_core::event::{Event, Polarity};

fn main() -> ExitCode {
    match run() {
        Ok(count) => {
            println!("events={count}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("encode-events: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run() -> Result<u64, Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [input, output, format] = arguments.as_slice() else {
        return Err("usage: EVENTS.csv WORDS evt2|packed".into());
    };
    let input = io::BufReader::new(fs::File::open(input)?);
    let mut output = io::BufWriter::new(fs::File::create(output)?);
    let (mut evt2, mut packed) = (Evt2Encoder::new(), PackedEncoder::new());
    let mut origin_us = None;
    let mut count = 0;
    for (number, line) in input.lines().enumerate() {
        let line = line?;
        if !line.starts_with(|first: char| first.is_ascii_digit()) {
            continue;
        }
        let event = parse(&line).ok_or_else(|| format!("line {}: not an event: {line}", number + 1))?;
        let event = Event { t: event.t - *origin_us.get_or_insert(event.t), ..event };
        let words = match format.as_str() {
            "evt2" => evt2.encode(event)?,
            "packed" => packed.encode(event)?,
            _ => return Err("the format must be evt2 or packed".into()),
        };
        for word in &words {
            output.write_all(&word.to_le_bytes())?;
        }
        count += 1;
    }
    output.flush()?;
    Ok(count)
}

fn parse(line: &str) -> Option<Event> {
    let mut fields = line.split(',');
    let (t, x, y) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
    let polarity = if fields.next()? == "1" { Polarity::On } else { Polarity::Off };
    Some(Event { t, x, y, polarity })
}

//! A camera's stream from one file to another, transfer by transfer, without decoding it.

use std::fs::File;
use std::path::Path;

use usb_davis::capture::Capture;
use usb_davis::dump::DumpWriter;

use super::{ConversionReport, ConvertError};
use crate::recording::davis::dump::COMPRESSION;

/// Copies the transfers of the recording at `from` into a new dump at `to`.
pub fn copy(from: &Path, to: &Path) -> Result<ConversionReport, ConvertError> {
    let unreadable = |error| ConvertError::Capture { path: from.to_owned(), error };
    let mut capture = Capture::open(from).map_err(unreadable)?;
    let failed = |error| ConvertError::Write { path: to.to_owned(), error };
    let file = File::create_new(to).map_err(|error| failed(error.into()))?;
    let failed_dump = |error| ConvertError::Write { path: to.to_owned(), error: super::WriteError::Dump(error) };
    let mut dump = DumpWriter::new(file, capture.header(), COMPRESSION).map_err(failed_dump)?;
    let mut report = ConversionReport::default();
    loop {
        match capture.next_transfer() {
            Ok(Some(transfer)) => dump.transfer(&transfer).map_err(failed_dump)?,
            Ok(None) => break,
            Err(error) => {
                report.error = Some(unreadable(error).to_string());
                break;
            }
        }
        report.transfers += 1;
    }
    // Registers that were read or written while recording, such as the counters of drops.
    let before = capture.header().registers.clone();
    let changed = capture.registers().iter().filter(|&(register, value)| before.get(register) != Some(value));
    let changed: Vec<_> = changed.collect();
    if !changed.is_empty() {
        dump.registers(changed).map_err(failed_dump)?;
    }
    dump.finish().map_err(failed_dump)?;
    let damage = capture.damage();
    if damage.places > 0 || damage.unfinished > 0 {
        report.lost.push(format!(
            "{} damaged places and an unfinished end of {} bytes in the recording: they are gaps in the output",
            damage.places, damage.unfinished
        ));
    }
    Ok(report)
}

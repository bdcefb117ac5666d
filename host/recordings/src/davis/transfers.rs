//! Copying of a camera's stream, transfer by transfer, without decoding it.

use std::fs::File;

use usb_davis::capture::Capture;
use usb_davis::dump::DumpWriter;

use super::dump::COMPRESSION;
use crate::counted::counted;
use crate::encode::{CopiedTransfers, WriteError};

/// Copies the transfers of `capture` into a new dump.
pub fn copy(capture: &mut Capture, file: File) -> Result<CopiedTransfers, WriteError> {
    let mut dump = DumpWriter::new(file, capture.header(), COMPRESSION)?;
    let mut copied = CopiedTransfers::default();
    loop {
        match capture.next_transfer() {
            Ok(Some(transfer)) => dump.transfer(&transfer)?,
            Ok(None) => break,
            Err(error) => {
                copied.error = Some(error);
                break;
            }
        }
        copied.transfers += 1;
    }
    // Includes registers that were read or written during the recording, such as the counters of dropped events.
    let before = capture.header().registers.clone();
    let changed = capture.registers().iter().filter(|&(register, value)| before.get(register) != Some(value));
    let changed: Vec<_> = changed.collect();
    if !changed.is_empty() {
        dump.registers(changed)?;
    }
    dump.finish()?;
    let damage = capture.damage();
    if damage.places > 0 || damage.unfinished > 0 {
        let places = counted(damage.places, "damaged place", "damaged places");
        let end = counted(damage.unfinished, "byte", "bytes");
        let damage = match (damage.places, damage.unfinished) {
            (_, 0) => places,
            (0, _) => format!("an incomplete end of {end}"),
            _ => format!("{places} and an incomplete end of {end}"),
        };
        copied.lost = Some(format!("the recording has {damage}, which the output contains as gaps"));
    }
    Ok(copied)
}

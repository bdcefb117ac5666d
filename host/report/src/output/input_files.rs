//! Sizes and checksums of the files that a calibration was made from.

use evcal_calibrate::calibrate::calibrated::Calibrated;
use evcal_calibrate::result::calibration_file::InputFile;
use evcal_calibrate::task::Task;
use evcal_calibrate::task::input::Input;
use evcal_files::visible;
use event_recordings::{Checksum, Files, RecordingError};
use rayon::prelude::*;

/// Returns the files of the inputs of `task` and of the devices of `calibrated`, its result, with the checksums of what was read.
/// Serial ports are left out.
///
/// # Errors
/// When a file has changed since it was opened.
pub fn input_files(calibrated: &Calibrated, task: &Task) -> Result<Vec<InputFile>, RecordingError> {
    let of_devices = calibrated.device_files().cloned();
    let files: Vec<Files> = task.inputs.iter().map(Input::files_read).chain(of_devices).collect();
    let checked = |files: &Files| {
        let checksums = files.checksums()?;
        files.check()?;
        Ok(checksums)
    };
    let mut all: Vec<Checksum> = Vec::new();
    for checksum in files.par_iter().map(checked).collect::<Result<Vec<_>, _>>()?.into_iter().flatten() {
        // Two cameras may be topics of one file.
        if all.iter().all(|known| known.path != checksum.path) {
            all.push(checksum);
        }
    }
    let file = |Checksum { path, bytes, sha256 }| InputFile { path: visible::path(&path), bytes, sha256 };
    Ok(all.into_iter().map(file).collect())
}

//! Sizes and checksums of the files that a calibration was made from.

use std::path::Path;

use evcal_calibrate::result::calibration_file::InputFile;
use evcal_calibrate::task::Task;
use evcal_calibrate::task::input::Input;
use evcal_files::visible;
use event_recordings::{Checksum, Files, RecordingError};
use rayon::prelude::*;

/// Returns the files of the inputs of `task`, with the checksums of what was read. Serial ports are left out.
///
/// # Errors
/// When a file has changed since it was opened.
pub fn input_files(task: &Task) -> Result<Vec<InputFile>, RecordingError> {
    let of_input = |input: &Input| {
        let files = match input {
            // A dump that a live camera has written.
            Input::Events(recording) if recording.source_files().is_empty() => {
                Files::new(recording.files().into_iter().map(Path::to_owned))
            }
            input => input.source_files().clone(),
        };
        let checksums = files.checksums()?;
        files.check()?;
        Ok(checksums)
    };
    let all = task.inputs.par_iter().map(of_input).collect::<Result<Vec<_>, _>>()?;
    let file = |Checksum { path, bytes, sha256 }| InputFile { path: visible::path(&path), bytes, sha256 };
    Ok(all.into_iter().flatten().map(file).collect())
}

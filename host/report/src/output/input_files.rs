//! Sizes and checksums of the files that a calibration was made from.

use std::fs::File;
use std::io;
use std::path::Path;

use evcal_calibrate::calibrate::Task;
use evcal_calibrate::calibrate::input::Input;
use evcal_calibrate::result::calibration_file::InputFile;
use evcal_files::visible;
use rayon::prelude::*;
use sha2::{Digest, Sha256};

/// Reads the inputs of `task` once more for their checksums. Serial ports, folders and files that cannot be read any more are left out.
pub fn input_files(task: &Task) -> Vec<InputFile> {
    let paths: Vec<&Path> = task.inputs.iter().flat_map(paths).filter(|path| path.is_file()).collect();
    paths.par_iter().filter_map(|path| input_file(path).ok()).collect()
}

fn paths(input: &Input) -> Vec<&Path> {
    match input {
        Input::Events(recording) => recording.files(),
        Input::Images(images) => vec![images.path()],
        Input::Circles { path, .. } => vec![path],
    }
}

fn input_file(path: &Path) -> io::Result<InputFile> {
    let mut sum = Sha256::new();
    let bytes = io::copy(&mut File::open(path)?, &mut sum)?;
    let digits = sum.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(InputFile { path: visible::path(path), bytes, sha256: digits })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The checksum of "abc" in FIPS 180-2, appendix B.
    #[test]
    fn checksums_are_those_of_sha256sum() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        let file = input_file(&path).unwrap();
        assert_eq!(file.bytes, 3);
        assert_eq!(file.sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }
}
